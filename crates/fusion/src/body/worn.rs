//! Whether the sensors of arms and legs sit on the segments that they are said to sit on, and whether the body faces the way that its calibration found.
//!
//! In: what trunk, limbs, hands and feet measured at one time, and how they were said to sit. Out: [`Verdict`], once movements leave no doubt that it is
//! otherwise: static poses cannot show it, for who stands upright is nearly his own mirror image. It never guesses: sensors that move alike stay where they are.
//!
//! A joint has one acceleration, by whichever of its two segments' sensors it is asked: where both are carried to it they agree, if they sit on these segments. Every
//! sensor of both arms (or legs) is held against the trunk as the upper segment of either side, and against every other as the lower one; each way of wearing them
//! costs what its joints disagree by, and one is believed that is better than every other by far, if every joint that it changes fits better by far. Right and left differ by where they hang on the trunk, once it turns:
//! that place is estimated with the sensor's own, which nobody knows better than to some centimetres either. Elbows and knees bend one way: where all that bend do so
//! backwards, the body faces the other way, which is how arms that were swapped make a T-pose look.

use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector3, Vector6};
use posed_state::Plain;

use super::links::Links;
use super::moving::Moving;
use super::skeleton::{BodySegment, Limb, SEGMENTS, Skeleton};
use super::{BodyFilter, BodySamples, SETTLED_S, SensorMount, health, joint_angles};

/// It looks at samples so far apart, s.
const PERIOD_S: f64 = 0.05;
/// And thinks about them so seldom, s.
const VERDICT_S: f64 = 0.5;
/// What was seen is forgotten in so long, s.
const MEMORY_S: f64 = 60.0;
/// What joints disagree by is one error for so long, s.
const CORRELATED_S: f64 = 0.5;
/// A trunk or limb that turns more slowly shows nothing, rad/s.
const SLOW_RAD_S: f64 = 0.5;
/// Sensors, places and joints are so good at best, m/s².
const FLOOR_M_S2: f64 = 0.5;
/// How well it is known where a sensor sits, and where a limb hangs on the trunk, m.
const PLACE_M: f64 = 0.03;
/// Logarithm of the odds from which there is no doubt.
const SURE: f64 = 12.0;
/// What a joint disagrees by (mean square) has to become so many times smaller. If its sensors are exchanged, the difference between how both limbs move is in it; where that
/// is less than what is left of wrong places, lengths and skin, a movement does not show who is who, however often it is repeated: it is wrong in the same way each time.
const FITS_BETTER: f64 = 2.0;
/// An elbow or a knee is bent beyond this, rad; for so long at least it was seen to, s, and so many times longer than the other way.
const BENT_RAD: f64 = 0.6;
const BENT_S: f64 = 2.0;
const ONE_WAY: f64 = 10.0;

/// Right and left upper, right and left lower segment of arms and of legs, then what ends them.
const ARMS: Group = Group {
    trunk: BodySegment::Torso,
    limbs: [Limb::ArmR, Limb::ArmL],
    ends: [BodySegment::HandR, BodySegment::HandL],
};
const LEGS: Group = Group {
    trunk: BodySegment::Pelvis,
    limbs: [Limb::LegR, Limb::LegL],
    ends: [BodySegment::FootR, BodySegment::FootL],
};

/// Two limbs that may be taken for one another.
#[derive(Clone, Copy)]
struct Group {
    trunk: BodySegment,
    limbs: [Limb; 2],
    ends: [BodySegment; 2],
}

impl Group {
    /// Where the right and the left limb hang on the trunk, from its sensor, m.
    fn joints_m(&self, skeleton: &Skeleton, mounts: &[Option<SensorMount>; SEGMENTS]) -> [Vector3<f64>; 2] {
        let trunk_m = mounts[self.trunk.index()].map_or_else(Vector3::zeros, |mount| mount.offset_m);
        self.limbs.map(|limb| skeleton.joint_in_parent_m(limb.segments()[1]) - trunk_m)
    }

    /// Right upper, right lower, left upper, left lower.
    fn segments(&self) -> [BodySegment; 4] {
        let [_, upper_r, lower_r] = self.limbs[0].segments();
        let [_, upper_l, lower_l] = self.limbs[1].segments();
        [upper_r, lower_r, upper_l, lower_l]
    }
}

/// Where sensors sit instead, and whether the body faces the other way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Verdict {
    /// By segment: the segment that its sensor was said to sit on.
    pub(super) taken_from: [usize; SEGMENTS],
    /// All segments are turned by half a turn about their length against what was found.
    pub(super) faces_back: bool,
}

/// What is remembered of both limbs: squares of what joints disagree by, m²/s⁴, and how long they bent which way, s.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
struct Pair {
    /// Where each sensor would hang on the trunk.
    hung: [Hung; 4],
    /// Of the lower joint of both sides, by the sensor above and the sensor below.
    lower: [[[f64; 4]; 4]; 2],
    /// Of the last joint of both sides, by the sensor above and the sensor of the right and the left end.
    end: [[[f64; 2]; 4]; 2],
    /// How long it was looked at, s.
    seen_s: f64,
    ends_s: f64,
    /// How long a joint with these sensors above and below was bent forwards and backwards.
    bent_s: [[[f64; 2]; 4]; 4],
}

/// Derivative of the specific force by its place in the segment, with the room's axes for the force, 1/s².
fn lever_in_room(moving: &Moving) -> Matrix3<f64> {
    moving.q_room_segment.to_rotation_matrix() * moving.lever()
}

/// Normal equations of where on the trunk a limb hangs, if this sensor sits on its upper segment: unknown are by how much the sensor sits elsewhere, and where the joint
/// is relative to the trunk's sensor, m.
#[derive(Clone, Debug, PartialEq, Plain)]
struct Hung {
    normal: Matrix6<f64>,
    right: Vector6<f64>,
    square: f64,
}

impl Default for Hung {
    fn default() -> Self {
        Self { normal: Matrix6::zeros(), right: Vector6::zeros(), square: 0.0 }
    }
}

impl Hung {
    fn push(&mut self, upper: &Moving, upper_m: &Vector3<f64>, trunk: &Moving, keep: f64, dt_s: f64) {
        let apart = upper.at(&-upper_m) - trunk.at(&Vector3::zeros());
        let mut by = Matrix3x6::zeros();
        by.fixed_columns_mut::<3>(0).copy_from(&-lever_in_room(upper));
        by.fixed_columns_mut::<3>(3).copy_from(&lever_in_room(trunk));
        self.normal = self.normal * keep + by.transpose() * by * dt_s;
        self.right = self.right * keep + by.transpose() * apart * dt_s;
        self.square = self.square * keep + apart.norm_squared() * dt_s;
    }

    /// Twice the negative logarithm of the likelihood that it hangs about there, m, but for what is the same wherever it does; of `seen_s`.
    fn cost(&self, joint_m: &Vector3<f64>, seen_s: f64) -> f64 {
        let known = PLACE_M.powi(-2);
        let mut expected = Vector6::zeros();
        expected.fixed_rows_mut::<3>(3).copy_from(joint_m);
        // What the best place leaves is the noise, but it is no better than the floor.
        let mut variance = FLOOR_M_S2 * FLOOR_M_S2;
        let mut cost = 0.0;
        for _ in 0..2 {
            let scale = 1.0 / (variance * CORRELATED_S);
            let information = self.normal * scale + Matrix6::identity() * known;
            let toward = self.right * scale + expected * known;
            let Some(best) = information.cholesky().map(|c| c.solve(&toward)) else { return 0.0 };
            let left = self.square - 2.0 * self.right.dot(&best) + best.dot(&(self.normal * best));
            cost = left * scale + (best - expected).norm_squared() * known;
            variance = variance.max(left / seen_s.max(1e-9));
        }
        cost + 3.0 * seen_s / CORRELATED_S * libm::log(variance)
    }
}

/// The evidence of one body.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub(super) struct Worn {
    arms: Pair,
    legs: Pair,
    since_s: f64,
    asked_s: f64,
}

impl Worn {
    /// Whether the samples of this time, `dt_s` after the last, are looked at.
    pub(super) fn is_due(&mut self, dt_s: f64) -> bool {
        self.since_s += dt_s;
        self.since_s >= PERIOD_S
    }

    /// Takes what the sensors show; [`Self::is_due`] has said that it is time.
    pub(super) fn push(
        &mut self,
        shown: &[Option<Moving>; SEGMENTS],
        mounts: &[Option<SensorMount>; SEGMENTS],
        skeleton: &Skeleton,
    ) {
        let dt_s = std::mem::replace(&mut self.since_s, 0.0);
        self.asked_s += dt_s;
        self.arms.push(&ARMS, shown, mounts, skeleton, dt_s);
        self.legs.push(&LEGS, shown, mounts, skeleton, dt_s);
    }

    /// What movements have shown; `None` where all is as it was said, or nothing says otherwise for certain.
    pub(super) fn verdict(
        &mut self,
        skeleton: &Skeleton,
        mounts: &[Option<SensorMount>; SEGMENTS],
    ) -> Option<Verdict> {
        if self.asked_s < VERDICT_S {
            return None;
        }
        self.asked_s = 0.0;
        let groups = [(ARMS, &self.arms), (LEGS, &self.legs)]
            .map(|(group, pair)| (group, pair, pair.costs(&group.joints_m(skeleton, mounts))));
        let bends = groups
            .each_ref()
            .map(|(_, pair, costs)| pair.bends(pair.likely(costs, AS_SAID).unwrap_or(AS_SAID).limbs));
        let count = |way: Bends| bends.iter().flatten().filter(|bends| **bends == way).count();
        let faces_back = count(Bends::Back) >= 2 && count(Bends::Fore) == 0;
        let mut taken_from: [usize; SEGMENTS] = std::array::from_fn(|index| index);
        for (group, pair, costs) in groups {
            // What hangs on the right of somebody who faces the other way hangs on the left. A body was found to face the way in which its arms were raised.
            let said = if faces_back && group.trunk == BodySegment::Pelvis {
                AS_SAID.other_way_round()
            } else {
                AS_SAID
            };
            let found = pair.likely(&costs, said);
            let order = if faces_back { found.map(Order::other_way_round) } else { found };
            let Order { limbs, ends } = order.unwrap_or(AS_SAID);
            let segments = group.segments();
            for (segment, sensor) in segments.iter().zip(limbs) {
                taken_from[segment.index()] = segments[sensor].index();
            }
            for (end, sensor) in group.ends.iter().zip(ends) {
                taken_from[end.index()] = group.ends[sensor].index();
            }
        }
        let as_said = taken_from.iter().enumerate().all(|(segment, from)| segment == *from);
        (faces_back || !as_said).then_some(Verdict { taken_from, faces_back })
    }
}

impl BodyFilter {
    /// Whether movements show that calibrated sensors sit on other segments than was said; they count where they sit from then on.
    pub(super) fn watch_straps(&mut self, samples: &BodySamples) {
        let began = self.sensors.each_ref().map(|sensor| {
            let began = sensor.as_ref()?.began;
            (began.sigma_rad != Vector3::zeros()).then_some(began)
        });
        let shown = std::array::from_fn(|index| {
            let (sensor, began) = (self.sensors[index].as_ref()?, began[index]?);
            let sample = samples[index].filter(health::usable)?;
            let q = &began.q_segment_sensor;
            let q_room_segment = sensor.orientation()? * sensor.mount.q_segment_sensor * q.inverse();
            (sensor.settled_s >= SETTLED_S).then(|| sensor.moving(&sample, q, q_room_segment))
        });
        self.worn.push(&shown, &began, &self.skeleton);
        if let Some(verdict) = self.worn.verdict(&self.skeleton, &began) {
            self.reseat(&verdict);
        }
    }

    /// Sensors sit where movements have shown, as they were found to sit by poses: in those all segments stand alike.
    fn reseat(&mut self, verdict: &Verdict) {
        let before = std::mem::take(&mut self.sensors);
        self.sensors = std::array::from_fn(|index| {
            let mut sensor = before[verdict.taken_from[index]].clone()?;
            sensor.reseat(before[index].as_ref().map_or(sensor.began.offset_m, |worn| worn.began.offset_m));
            if verdict.faces_back {
                sensor.face_back();
            }
            Some(sensor)
        });
        self.taken_from = verdict.taken_from.map(|from| self.taken_from[from]);
        let mounts = self.sensors.each_ref().map(|sensor| sensor.as_ref().map(|sensor| sensor.mount));
        self.limbs.iter_mut().for_each(|limb| limb.remount(&self.skeleton, &mounts));
        self.last_motions = [None; 2];
        self.worn = Worn::default();
        self.links = Links::default();
    }
}

/// Of all orders that may be the right one, because none is better by far, that with the fewest sensors somewhere else; `None` where two have as few.
fn fewest(costs: &[f64; ORDERS], said: Order) -> Option<Order> {
    let best = costs.iter().copied().fold(f64::INFINITY, f64::min);
    let mut likely = Order::all().zip(costs).filter(|(_, cost)| **cost - best <= 2.0 * SURE);
    let (first, _) = likely.next()?;
    let mut found = (first.displaced(said), Some(first));
    for (order, _) in likely {
        let count = order.displaced(said);
        if count < found.0 {
            found = (count, Some(order));
        } else if count == found.0 {
            found.1 = None;
        }
    }
    found.1
}

/// Which way a joint bends.
#[derive(Clone, Copy, PartialEq)]
enum Bends {
    Fore,
    Back,
    Unknown,
}

/// Which sensor sits on the right upper, right lower, left upper and left lower segment, and on the right and the left end; each by where it was said to sit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Order {
    limbs: [usize; 4],
    ends: [usize; 2],
}

const AS_SAID: Order = Order { limbs: [0, 1, 2, 3], ends: [0, 1] };
/// How many orders there are.
const ORDERS: usize = 48;

impl Order {
    /// All there are.
    fn all() -> impl Iterator<Item = Self> {
        let limbs = (0..256).map(|code| [code & 3, code >> 2 & 3, code >> 4 & 3, code >> 6 & 3]);
        let each_once = limbs.filter(|limbs| (0..4).all(|sensor| limbs.contains(&sensor)));
        each_once.flat_map(|limbs| [[0, 1], [1, 0]].map(|ends| Self { limbs, ends }))
    }

    /// How many sensors sit somewhere else than was said.
    fn displaced(self, said: Self) -> usize {
        let elsewhere = |sensors: &[usize], said: &[usize]| {
            sensors.iter().zip(said).filter(|(sensor, said)| sensor != said).count()
        };
        elsewhere(&self.limbs, &said.limbs) + elsewhere(&self.ends, &said.ends)
    }

    /// The sensors on the upper, the lower and the last segment of one side.
    fn meet(self, side: usize) -> [usize; 3] {
        [self.limbs[2 * side], self.limbs[2 * side + 1], self.ends[side]]
    }

    /// With right and left exchanged.
    fn other_way_round(self) -> Self {
        let [a, b, c, d] = self.limbs;
        Self { limbs: [c, d, a, b], ends: [self.ends[1], self.ends[0]] }
    }
}

impl Pair {
    fn push(
        &mut self,
        group: &Group,
        shown: &[Option<Moving>; SEGMENTS],
        mounts: &[Option<SensorMount>; SEGMENTS],
        skeleton: &Skeleton,
        dt_s: f64,
    ) {
        let segments = group.segments();
        let of = |segment: BodySegment| Some((shown[segment.index()]?, mounts[segment.index()]?.offset_m));
        let Some((trunk, _)) = of(group.trunk) else { return };
        let [Some(a), Some(b), Some(c), Some(d)] = segments.map(of) else { return };
        let worn = [a, b, c, d];
        let turns = |shown: &Moving| shown.angular_velocity_rad_s.norm() > SLOW_RAD_S;
        if !worn.iter().any(|(shown, _)| turns(shown)) {
            return;
        }
        // Where a sensor would be carried to if it sat where the one of this segment is said to sit.
        let near = |segment: usize, sensor: usize| worn[sensor].0.at(&-worn[segment].1);
        let far = |segment: usize, sensor: usize| {
            worn[sensor].0.at(&(skeleton.end_in_segment_m(segments[segment]) - worn[segment].1))
        };
        let keep = 1.0 - dt_s / MEMORY_S;
        for (sensor, hung) in self.hung.iter_mut().enumerate() {
            // Upper segments come first on each side.
            hung.push(&worn[sensor].0, &worn[sensor & 2].1, &trunk, keep, dt_s);
        }
        let add = |sum: &mut f64, apart: Vector3<f64>| *sum = *sum * keep + apart.norm_squared() * dt_s;
        self.seen_s = self.seen_s * keep + dt_s;
        for side in 0..2 {
            let (upper, lower) = (2 * side, 2 * side + 1);
            let below: [Vector3<f64>; 4] = std::array::from_fn(|sensor| near(lower, sensor));
            for sensor in 0..4 {
                let above = far(upper, sensor);
                for (sum, below) in self.lower[side][sensor].iter_mut().zip(&below) {
                    add(sum, above - below);
                }
            }
        }
        if let [Some((right, right_m)), Some((left, left_m))] = group.ends.map(of) {
            self.ends_s = self.ends_s * keep + dt_s;
            for (side, end_m) in [right_m, left_m].into_iter().enumerate() {
                let ends = [right.at(&-end_m), left.at(&-end_m)];
                for sensor in 0..4 {
                    let above = far(2 * side + 1, sensor);
                    for (sum, end) in self.end[side][sensor].iter_mut().zip(&ends) {
                        add(sum, above - end);
                    }
                }
            }
        }
        for above in 0..4 {
            for below in (0..4).filter(|below| *below != above) {
                let rotation = worn[above].0.q_room_segment.inverse() * worn[below].0.q_room_segment;
                let [flexion_rad, ..] = joint_angles(segments[1], &rotation);
                for (sum, bent) in self.bent_s[above][below]
                    .iter_mut()
                    .zip([flexion_rad > BENT_RAD, flexion_rad < -BENT_RAD])
                {
                    *sum = *sum * keep + if bent { dt_s } else { 0.0 };
                }
            }
        }
    }

    /// Twice the negative logarithm of the likelihood of every order, but for what is the same for all; `joints_m` are where the right and the left limb hang on the
    /// trunk, from its sensor.
    fn costs(&self, joints_m: &[Vector3<f64>; 2]) -> [f64; ORDERS] {
        // Disagreements whose size nobody knows, but that joints, places and sensors are no better than the floor.
        let apart = |square: f64, seen_s: f64| {
            let variance = square / seen_s.max(1e-9) + FLOOR_M_S2 * FLOOR_M_S2;
            3.0 * seen_s / CORRELATED_S * libm::log(variance)
        };
        let hung = joints_m.map(|joint_m| self.hung.each_ref().map(|hung| hung.cost(&joint_m, self.seen_s)));
        let mut costs = [f64::INFINITY; ORDERS];
        for (sum, Order { limbs: [a, b, c, d], ends: [e, f] }) in costs.iter_mut().zip(Order::all()) {
            *sum = hung[0][a]
                + hung[1][c]
                + apart(self.lower[0][a][b], self.seen_s)
                + apart(self.lower[1][c][d], self.seen_s)
                + apart(self.end[0][b][e], self.ends_s)
                + apart(self.end[1][d][f], self.ends_s);
        }
        costs
    }

    /// The order that is likely the right one.
    fn likely(&self, costs: &[f64; ORDERS], said: Order) -> Option<Order> {
        fewest(costs, said).filter(|order| self.fits_better(*order, said))
    }

    /// Whether every lower and last joint at which other sensors meet than was said fits better by far with them. Limbs that are exchanged as a whole keep their joints:
    /// where they hang says what they are.
    fn fits_better(&self, order: Order, said: Order) -> bool {
        let better = |found: f64, said: f64, seen_s: f64| {
            let floor = FLOOR_M_S2 * FLOOR_M_S2 * seen_s;
            said + floor > FITS_BETTER * (found + floor)
        };
        [0, 1].into_iter().all(|side| {
            let (meet, met) = (order.meet(side), said.meet(side));
            let old = |joint: usize| {
                [0, 1].iter().any(|side| said.meet(*side)[joint..joint + 2] == meet[joint..joint + 2])
            };
            let ([a, b, c], [above, below, end]) = (meet, met);
            (old(0) || better(self.lower[side][a][b], self.lower[side][above][below], self.seen_s))
                && (old(1) || better(self.end[side][b][c], self.end[side][below][end], self.ends_s))
        })
    }

    /// Which way the joints of both limbs bend, where the sensors sit in this order.
    fn bends(&self, [a, b, c, d]: [usize; 4]) -> [Bends; 2] {
        [[a, b], [c, d]].map(|[above, below]| {
            let [fore_s, back_s] = self.bent_s[above][below];
            if fore_s > BENT_S && fore_s > ONE_WAY * back_s {
                Bends::Fore
            } else if back_s > BENT_S && back_s > ONE_WAY * fore_s {
                Bends::Back
            } else {
                Bends::Unknown
            }
        })
    }
}
