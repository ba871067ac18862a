//! Where the hips are in the room, from the feet that stand on it.
//!
//! In: orientations of pelvis, thighs, shanks and feet, and what their sensors measure. Out: the hips' mid-point in the room and how likely
//! each foot stands ([`Travel`]). It never turns a segment, and it stops where a segment of the legs is not known.
//!
//! ```text
//! pelvis:  specific force ──────────────────────────────────────┐ predicts
//! points:  speed (hips' velocity and posture) ─┐                v
//!          acceleration (shank's or foot's) ───┴> contact ──> axis (three of them): hips' position and velocity
//!                                         posture: point from pelvis ┘ holds a foot that stands where it is
//! ```
//! A Kalman filter with footholds (Bloesch et al. 2012, without their rotation, which the body's filters know). A foot that wears a sensor stands by its heel
//! and by its ball, each with a foothold of its own: while the heel rises the ball holds the body. Of any other foot what stands is the ankle: one
//! that rolls over its ball lifts it, counts as moving, and the pelvis's accelerometer bridges the tenths of a second until the
//! other foot stands. Axes of the room are independent of one another: each has a filter of its own.
//!
//! The floor is level as long as footholds lie within [`STEP_M`] of one another in height: less than that is what wrong lengths and tilts
//! make. Two in a row that are both above it, or both below, are a new floor: stairs, and slopes steeper than that a step, are followed.

mod axis;
mod contact;
#[cfg(test)]
mod tests;

use nalgebra::{UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::skeleton::Skeleton;
use axis::{Axis, POSITION, VELOCITY, foothold};
use contact::Contact;
use posed_geometry::GRAVITY_M_S2;

/// Of a point that stands, from the pelvis, m: posture and skin.
const POINT_M: f64 = 0.01;
/// A point that moves says less: as if it were wrong by what it does in this time, s. One that stands, or is about to leave, moves no faster than its foot turns about the
/// other end of its sole: what seems to go faster shows that the body's velocity is not known, and not that the point is loose.
const LOOSE_S: f64 = 0.3;
/// Nobody jumps for longer, s. Beyond, the velocity is nothing and the lower ankle where an ankle stands to so much, m/s, m, at each time.
const JUMP_S: f64 = 1.0;
const ROLLS_M_S: f64 = 1.0;
const FLOOR_M: f64 = 0.3;
/// A pelvis that rests by its own sensor goes no faster, m/s.
const RESTS_M_S: f64 = 0.02;
/// A foot that has come down lies still after so long, s.
const LANDED_S: f64 = 0.08;
/// How fast a point that stands may seem to go, m/s, and beyond how many standard deviations of that the body's velocity was lost.
const RESTING_M_S: f64 = 0.1;
const LOST: f64 = 3.0;
/// Footholds whose heights differ by less are on one floor, m, and this is how level a floor is.
const STEP_M: f64 = 0.04;
const LEVEL_M: f64 = 0.005;
/// What shows the ball of a foot: how fast its heel rises against it at least, m/s; what its place is wrong by for so long is one error, s.
const ROLLS_OVER_M_S: f64 = 0.3;
const BALL_CORRELATED_S: f64 = 0.1;
/// A ball that stands goes up and down by so much, m/s.
const BALL_M_S: f64 = 0.06;
/// How well it is known at first how far the ball lies ahead of the ankle, and within which bounds it is believed, of that way.
const BALL_SHARE: f64 = 0.2;
const BALL_BOUNDS: [f64; 2] = [0.6, 1.4];

/// What each step adds at random to the place, m; and what lengths of legs that are a little wrong make of the way, as a share.
const PER_STEP_M: f64 = 0.02;
const LENGTHS: f64 = 0.015;
/// What is known of the place where the body begins, m.
const PLACED_M: f64 = 0.02;
/// Who says that the body is farther from where the feet have brought it than so many standard deviations is not believed, for so long at most, s; what was lost of
/// that comes back so much slower.
const GATE: f64 = 4.0;
const PATIENCE_S: f64 = 5.0;
const REGAINED: f64 = 0.1;

/// Where a body is, and what it stands on.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Travel {
    /// The hips' mid-point, room, m.
    pub pelvis_m: Vector3<f64>,
    /// Standard deviation of each level axis of it, m, from where something else said last where it is, or else from where it began. Where the legs are not
    /// known it is that of before.
    pub sigma_m: f64,
    /// How likely the right and the left foot stand; `None` while a segment of the legs is not known: the body stays where it was.
    pub contacts: Option<[FootContact; 2]>,
}

/// How likely a foot stands on the floor, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct FootContact {
    /// Any part of it: its heel or its ball, or of a foot without a sensor its ankle, which shows a foot that lies flat.
    pub foot: f64,
    /// Its heel and its toes, which stand by their ball; `None` where the foot wears no sensor.
    pub sole: Option<[f64; 2]>,
}

/// What the filter sees of one time; all vectors in room axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Legs {
    /// From the hips' mid-point to the pelvis's sensor, m.
    pub sensor_m: Vector3<f64>,
    /// What that sensor measures, m/s²; `None` where it said nothing at this time.
    pub specific_force_m_s2: Option<Vector3<f64>>,
    /// Whether it rests by what it measures.
    pub rests: bool,
    /// From the hips' mid-point to the right and the left ankle, m.
    pub ankles_m: [Vector3<f64>; 2],
    /// What may stand of the right and the left foot.
    pub feet: [Foot; 2],
}

/// What may stand of a foot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Foot {
    /// No sensor is on it.
    Ankle(Point),
    /// Its heel and its ball.
    Sole([Point; 2]),
}

/// A point of a foot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    /// From the hips' mid-point, m.
    pub at_m: Vector3<f64>,
    /// By the sensor of its segment, m/s²; `None` where it is not known.
    pub accel_m_s2: Option<Vector3<f64>>,
    /// Of its foot, rad/s; `None` where that is not known.
    pub turns_rad_s: Option<Vector3<f64>>,
}

/// How far the ball of a foot lies ahead of its ankle, m, and the variance of that, m².
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Ball {
    ahead_m: f64,
    variance_m2: f64,
}

/// The filter.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct TravelFilter {
    /// Ankle to floor, m.
    foot_m: f64,
    /// What the ball's way ahead of the ankle is by proportion, m, and heel to ankle.
    usual_ball_m: f64,
    heel_m: f64,
    balls: [Ball; 2],
    axes: [Axis; 3],
    begun: bool,
    /// From the hips' mid-point to the pelvis's sensor, as last seen, m.
    sensor_from_hips_m: Vector3<f64>,
    /// Heel and ball, or ankle, of both feet, and whether it is heel and ball.
    contacts: [[Contact; 2]; 2],
    soled: [bool; 2],
    /// Height of the floor that was stood on last, m.
    floor_m: f64,
    /// By how much the last foothold was above it, m; 0 if it was level with it.
    risen_m: f64,
    /// For so long no foot has stood, s.
    aloft_s: f64,
    /// Where it was placed last, or began, room, m, with its variance, and how many steps were made since.
    placed_m: Vector3<f64>,
    placed_m2: f64,
    steps: f64,
    /// For so long still the feet are believed against what else says where the body is, s; 0 as long as nothing has.
    patience_s: f64,
}

impl TravelFilter {
    /// A body of these lengths that has not moved yet.
    pub(super) fn new(skeleton: &Skeleton) -> Self {
        let [heel_m, ball_m] = skeleton.sole_m();
        let sigma_m = BALL_SHARE * ball_m;
        Self {
            foot_m: skeleton.foot_m,
            usual_ball_m: ball_m,
            heel_m,
            balls: [Ball { ahead_m: ball_m, variance_m2: sigma_m * sigma_m }; 2],
            axes: [Axis::new(0.0); 3],
            begun: false,
            sensor_from_hips_m: Vector3::zeros(),
            contacts: [[Contact::UNKNOWN; 2]; 2],
            soled: [false; 2],
            floor_m: 0.0,
            risen_m: 0.0,
            aloft_s: 0.0,
            placed_m: Vector3::zeros(),
            placed_m2: PLACED_M * PLACED_M,
            steps: 0.0,
            patience_s: 0.0,
        }
    }

    /// From the ankle to the heel and the ball of the right (0) or left (1) foot, foot's axes, m.
    pub(super) fn sole_m(&self, side: usize) -> [Vector3<f64>; 2] {
        [-self.heel_m, self.balls[side].ahead_m].map(|ahead_m| Vector3::new(ahead_m, -self.foot_m, 0.0))
    }

    /// From heel to ball, m.
    fn sole_length_m(&self, side: usize) -> f64 {
        self.balls[side].ahead_m + self.heel_m
    }

    /// Takes the legs of one time, `dt_s` after the last, s; their headings are known to `heading_rad` (standard deviation).
    pub(super) fn push(&mut self, legs: &Legs, heading_rad: f64, dt_s: f64) -> Travel {
        if !self.begun {
            let height_m = self.foot_m - lower_m(&legs.ankles_m);
            self.place_at(Vector3::new(0.0, 0.0, height_m), legs.sensor_m);
        }
        self.sensor_from_hips_m = legs.sensor_m;
        let accel_m_s2 = legs.specific_force_m_s2.map(|force| force - Vector3::z() * GRAVITY_M_S2);
        for (k, axis) in self.axes.iter_mut().enumerate() {
            axis.predict(accel_m_s2.map(|accel| (accel[k], accel.norm())), dt_s);
        }
        let velocity_m_s = Vector3::from_fn(|k, _| self.axes[k].value(VELOCITY));
        let velocity_m2_s2 = self.axes.iter().map(|axis| axis.variance(VELOCITY)).sum::<f64>() / 3.0;
        for (side, foot) in legs.feet.iter().enumerate() {
            let soled = matches!(foot, Foot::Sole(_));
            if self.soled[side] != soled {
                self.soled[side] = soled;
                self.contacts[side] = [Contact::UNKNOWN; 2];
            }
            let (points, height_m) = match foot {
                Foot::Ankle(ankle) => (std::slice::from_ref(ankle), self.foot_m),
                Foot::Sole(points) => (points.as_slice(), 0.0),
            };
            let mut speeds_m_s = [None; 2];
            let stood = self.foot_stands(side);
            for (which, point) in points.iter().enumerate() {
                let at_m = point.at_m - legs.sensor_m;
                let contact = &mut self.contacts[side][which];
                let last_m = contact.last_m.replace(at_m);
                let speed_m_s = last_m.map(|last_m| velocity_m_s + (at_m - last_m) / dt_s);
                contact.push(
                    speed_m_s.map(|speed| (speed, velocity_m2_s2)),
                    point.accel_m_s2,
                    point.turns_rad_s,
                    dt_s,
                );
                speeds_m_s[which] = speed_m_s;
            }
            if !stood && self.foot_stands(side) {
                self.steps += 1.0;
            }
            for (which, point) in points.iter().enumerate() {
                self.stand(side, which, point, &legs.sensor_m, speeds_m_s[which], height_m);
            }
            if let [Some(heel_m_s), Some(ball_m_s)] = speeds_m_s {
                self.see_ball(side, heel_m_s.z, ball_m_s.z, dt_s);
            }
        }
        if legs.rests {
            self.axes.iter_mut().for_each(|axis| axis.observe(VELOCITY, 0.0, RESTS_M_S * RESTS_M_S));
        }
        let aloft = !legs.rests && (0..2).all(|side| !self.foot_stands(side));
        self.aloft_s = if aloft { self.aloft_s + dt_s } else { 0.0 };
        if self.aloft_s > JUMP_S {
            self.land(&legs.ankles_m);
        }
        let contacts = [0, 1].map(|side| {
            let [first, second] = self.contacts[side].map(|contact| contact.probability);
            match self.soled[side] {
                true => FootContact { foot: first.max(second), sole: Some([first, second]) },
                false => FootContact { foot: first, sole: None },
            }
        });
        let pelvis_m = self.sensor_m() - legs.sensor_m;
        Travel { pelvis_m, sigma_m: self.sigma_m(&pelvis_m, heading_rad), contacts: Some(contacts) }
    }

    /// Something else says where the hips' mid-point is, room, m, known to `sigma_m`, `dt_s` after it did so before; `sensor_m` from there to the pelvis's sensor.
    /// `agreed`: several say the same. Where it is then, with its standard deviation along an axis, m; `None` where the feet are believed instead.
    pub(super) fn anchor(
        &mut self,
        at: (Vector3<f64>, f64),
        agreed: bool,
        sensor_m: Vector3<f64>,
        heading_rad: f64,
        dt_s: f64,
    ) -> Option<(Vector3<f64>, f64)> {
        let (at_m, sigma_m) = at;
        let before_m = self.sensor_m() - sensor_m;
        let (known_m2, noise_m2) = (self.sigma_m(&before_m, heading_rad).powi(2), sigma_m * sigma_m);
        let off_m = at_m - before_m;
        let believed = agreed || off_m.norm_squared() < GATE * GATE * (known_m2 + noise_m2);
        if self.begun && believed {
            self.patience_s = (self.patience_s + REGAINED * dt_s).min(PATIENCE_S);
            let gain = known_m2 / (known_m2 + noise_m2);
            self.place_at(before_m + off_m * gain, sensor_m);
            // What it is wrong by lasts, and does not average out.
            self.placed_m2 = ((1.0 - gain) * known_m2).max(noise_m2);
        } else {
            self.patience_s -= dt_s;
            if self.begun && self.patience_s > 0.0 {
                return None;
            }
            self.patience_s = 0.0;
            self.place_at(at_m, sensor_m);
            self.placed_m2 = noise_m2;
        }
        Some((self.placed_m, self.placed_m2.sqrt()))
    }

    /// The whole body is turned so far to the left about its hips, rad.
    pub(super) fn turn(&mut self, by_rad: f64) {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by_rad);
        let [x, y, _] = &mut self.axes;
        axis::turn([x, y], by_rad);
        self.contacts.iter_mut().flatten().for_each(|contact| {
            contact.last_m = contact.last_m.map(|last_m| turned * last_m);
        });
        self.sensor_from_hips_m = turned * self.sensor_from_hips_m;
    }

    /// A segment of the legs is not known at this time: the body stays where it is, and begins anew from there. `None` before it has begun.
    pub(super) fn pause(&mut self, heading_rad: f64) -> Option<Travel> {
        if self.contacts.iter().flatten().any(|contact| contact.last_m.is_some()) {
            let at_m = self.sensor_m();
            self.axes = [0, 1, 2].map(|k| Axis::new(at_m[k]));
            self.contacts = [[Contact::UNKNOWN; 2]; 2];
        }
        let pelvis_m = self.sensor_m() - self.sensor_from_hips_m;
        self.begun.then(|| Travel { pelvis_m, sigma_m: self.sigma_m(&pelvis_m, heading_rad), contacts: None })
    }

    /// Of a place that feet have brought the hips to: a random walk of steps, and a way whose length and direction are a little wrong. What of these goes
    /// round comes back.
    fn sigma_m(&self, pelvis_m: &Vector3<f64>, heading_rad: f64) -> f64 {
        let away_m = (pelvis_m - self.placed_m).xy().norm();
        let way_m2 = (LENGTHS * LENGTHS + heading_rad * heading_rad) * away_m * away_m;
        (self.placed_m2 + self.steps * PER_STEP_M * PER_STEP_M + way_m2).sqrt()
    }

    /// The hips' mid-point is there, room, m; `sensor_m` from there to the pelvis's sensor.
    pub(super) fn place_at(&mut self, pelvis_m: Vector3<f64>, sensor_m: Vector3<f64>) {
        let moved_m = pelvis_m + sensor_m - self.sensor_m();
        for (k, axis) in self.axes.iter_mut().enumerate() {
            axis.shift(moved_m[k]);
        }
        if self.begun {
            self.floor_m += moved_m.z;
        }
        self.begun = true;
        self.sensor_from_hips_m = sensor_m;
        (self.placed_m, self.placed_m2, self.steps) = (pelvis_m, PLACED_M * PLACED_M, 0.0);
    }

    fn sensor_m(&self) -> Vector3<f64> {
        Vector3::from_fn(|k, _| self.axes[k].value(POSITION))
    }

    fn foot_stands(&self, side: usize) -> bool {
        self.contacts[side].iter().take(1 + usize::from(self.soled[side])).any(Contact::stands)
    }

    /// A point that stands holds the pelvis's sensor, which is so far from the hips' mid-point, m.
    fn stand(
        &mut self,
        side: usize,
        which: usize,
        point: &Point,
        sensor_m: &Vector3<f64>,
        speed_m_s: Option<Vector3<f64>>,
        height_m: f64,
    ) {
        let contact = self.contacts[side][which];
        if !contact.stands() {
            return;
        }
        if let Some(speed_m_s) = speed_m_s {
            self.doubt(&speed_m_s);
        }
        let at_m = point.at_m - sensor_m;
        let foothold = foothold(side, which);
        if contact.before_s == 0.0 {
            for (k, axis) in self.axes.iter_mut().enumerate() {
                axis.begin(foothold, at_m[k], POINT_M * POINT_M);
            }
        }
        if contact.before_s < LANDED_S && contact.stood_s >= LANDED_S {
            self.level(foothold, height_m);
        }
        let rolls_m_s =
            point.turns_rad_s.map_or(f64::INFINITY, |turns| turns.norm() * self.sole_length_m(side));
        let loose_m = LOOSE_S * speed_m_s.map_or(0.0, |speed| speed.norm().min(rolls_m_s));
        // It counts as much as the point, and this very time, make it likely to stand: the probability lags by some hundredths of a second.
        let noise_m2 = (POINT_M * POINT_M + loose_m * loose_m) / (contact.probability * contact.now);
        for (k, axis) in self.axes.iter_mut().enumerate() {
            axis.hold(foothold, at_m[k], noise_m2);
        }
    }

    /// A point that stands seems to go so fast, m/s: more than the body's velocity is thought to be wrong by, and that was lost. It is found again from the
    /// footholds within some hundredths of a second, instead of dragging them along.
    fn doubt(&mut self, speed_m_s: &Vector3<f64>) {
        let known_m2_s2: f64 = self.axes.iter().map(|axis| axis.variance(VELOCITY)).sum();
        if speed_m_s.norm_squared() > LOST * LOST * (known_m2_s2 + 3.0 * RESTING_M_S * RESTING_M_S) {
            let variance_m2_s2 = speed_m_s.norm_squared() / 3.0;
            self.axes.iter_mut().for_each(|axis| axis.doubt(VELOCITY, variance_m2_s2));
        }
    }

    /// How fast heel and ball of a foot that rolls over its ball go up shows where along the sole it does not: there it stands.
    fn see_ball(&mut self, side: usize, heel_m_s: f64, ball_m_s: f64, dt_s: f64) {
        let [heel, ball] = self.contacts[side];
        let rises_m_s = heel_m_s - ball_m_s;
        if heel.stands() || !ball.stands() || rises_m_s < ROLLS_OVER_M_S {
            return;
        }
        let sole_m = self.sole_length_m(side);
        let Ball { ahead_m, variance_m2 } = &mut self.balls[side];
        let seen_m = sole_m * heel_m_s / rises_m_s - self.heel_m;
        let noise_m = BALL_M_S * sole_m / rises_m_s;
        let gain = *variance_m2 / (*variance_m2 + noise_m * noise_m * BALL_CORRELATED_S / dt_s);
        *variance_m2 *= 1.0 - gain;
        let [least, most] = BALL_BOUNDS.map(|bound| bound * self.usual_ball_m);
        *ahead_m = (*ahead_m + gain * (seen_m - *ahead_m)).clamp(least, most);
    }

    /// No foot has stood for longer than anybody jumps: who sits on wheels, or whose feet are not seen to stand, is about where and as high as before.
    fn land(&mut self, ankles_m: &[Vector3<f64>; 2]) {
        for axis in &mut self.axes {
            axis.observe(VELOCITY, 0.0, ROLLS_M_S * ROLLS_M_S);
        }
        let height_m = self.floor_m + self.foot_m - lower_m(ankles_m);
        self.axes[2].observe(POSITION, height_m, FLOOR_M * FLOOR_M);
    }

    /// A point that stands so high above the floor has stood for a while: its foothold is as high as the one before, unless it clearly is not.
    fn level(&mut self, foothold: usize, height_m: f64) {
        let height = &mut self.axes[2];
        let floor_m = height.value(foothold) - height_m;
        let risen_m = floor_m - self.floor_m;
        if risen_m.abs() < STEP_M {
            height.observe(foothold, self.floor_m + height_m, LEVEL_M * LEVEL_M);
            self.risen_m = 0.0;
        } else if risen_m * self.risen_m > 0.0 {
            (self.floor_m, self.risen_m) = (floor_m, risen_m);
        } else {
            // One alone may be a stone, or wrong.
            self.risen_m = risen_m;
        }
    }
}

/// Height of the lower ankle, m.
fn lower_m([right, left]: &[Vector3<f64>; 2]) -> f64 {
    right.z.min(left.z)
}
