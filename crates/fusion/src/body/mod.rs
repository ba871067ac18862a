//! The whole body: an IMU on each segment at most, one skeleton, live.
//!
//! In: samples of the worn IMUs at one time, with the time since the ones before; how each sits on its segment
//! ([`SensorMount`]). Out: a [`BodyEstimate`]: segment orientations, joint angles, their uncertainty, and the health of every
//! sensor with the reason. What wears no sensor it infers, and keeps it apart from what sensors show. It never stops the rest of the body because one
//! sensor fails, and never allocates per sample.
//!
//! ```text
//! torso, pelvis:  sensor ──> ahrs ────────────────────────────> segment orientation, and the base of its limbs
//! leaves:         sensor ──> ahrs ────────────────────────────> segment orientation
//!                 (head, hands, feet, shoulders; a shoulder moves the joint of its arm)
//! half a limb:    sensor ──> ahrs ────────────────────────────> segment orientation
//! limbs:          sensor ──> ahrs ── heading only ──┐
//!                 sensor ── gyro, accelerometer ────┴> limb ──> joint angles ──> segment orientations
//! ```
//! How the sensors of limbs sit, and how long thighs and upper arms are, their filters learn from the movements, beginning with what a calibration has found;
//! what was given as exact stays. A sensor that does not fit any more has slipped, and how it sits is found anew.
//!
//! The heading of a limb's sensor comes through its own orientation filter, whose eleven states tell a disturbance
//! of the room from a magnet on the sensor; the limb sees it as an azimuth that cannot tilt anything. Without
//! a magnetometer the headings hold by the gyros, the hinges of elbow and knee and rests; [`Heading::Held`] says so.

mod anchor;
mod angles;
mod assign;
mod block;
mod calibrate;
#[cfg(test)]
mod few_tests;
mod girdle;
#[cfg(test)]
mod girdle_tests;
mod guide;
#[cfg(test)]
mod guide_tests;
mod health;
mod infer;
mod inverse;
#[cfg(test)]
mod learnt_tests;
mod legs;
mod limbs;
mod links;
#[cfg(test)]
mod links_tests;
mod moving;
mod places;
mod posture;
mod sensor;
mod skeleton;
mod spread;
#[cfg(test)]
mod spread_tests;
mod taps;
#[cfg(test)]
mod tests;
mod travel;
mod whole;
mod worn;
#[cfg(test)]
mod worn_tests;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

pub use anchor::Anchor;
pub use angles::{ANGLE_NAMES, ANGLES, angles, joint_angles, joint_rotation, of_joint, to_right};
pub use assign::{AssignError, Assignment, assign};
pub use block::{Block, BlockKind, Movement, Recorded};
pub use calibrate::{Calibrated, CalibrationError, Contradiction, REPEAT_DEG, calibrate};
pub use guide::{Guide, Thoroughness};
pub use infer::{completed, joints_between};
pub use inverse::{Figure, Follower, Tracked};
pub use limbs::{elbow, knee};
pub use places::{Misplaced, Places, Trackers};
pub use posture::orientations;
pub use skeleton::{BodySegment, Limb, SEGMENTS, Skeleton, upright};
pub use spread::{AngleSpread, independent};
pub use taps::DoubleTap;
pub use travel::{FootContact, Travel};
pub use whole::{WHOLE, WholeSegment, inner_angles, t_pose, whole, whole_t_pose};

use super::ahrs::{ImuSample, Params};
use super::faults::Cause;
use super::limb::{Base, LimbNoise};
use infer::Inference;
use limbs::LimbFilter;
use links::Links;
use posed_geometry::GRAVITY_M_S2;
use sensor::{Sensor, share};
use travel::TravelFilter;
use worn::Worn;

/// Samples of the whole body at one time, sensor axes, by [`BodySegment::index`]; `None` where no sensor is worn or none
/// came.
pub type BodySamples = [Option<ImuSample>; SEGMENTS];

/// How well people look straight ahead with all of their segments, rad: a heading that somebody asserts is wrong by that.
const AHEAD_RAD: f64 = 0.05;
/// Nothing at its end shows how long a shank is: it is to its thigh as in the body that was given. By so much of it people differ in that.
const CRURAL_SHARE: f64 = 0.03;
/// Without a sample for so long the last rate goes on, s; then the segment holds still.
const HOLD_S: f64 = 0.1;
/// So long after its first sample, or after a gap that the last angular velocity did not bridge, a sensor's orientation is
/// worth comparing, s: its specific forces have levelled it.
const SETTLED_S: f64 = 3.0;

/// And so long after it a leg's posture does not leap any more, s.
const LEGS_S: f64 = 1.0;

/// For so long a heading that is to come from the field is waited for, s.
const FIELD_S: f64 = 1.0;

/// How one sensor sits on its segment: given, or found by [`calibrate::calibrate`]. The filters take it as exact; what is stated of angles knows better.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct SensorMount {
    /// Turns sensor coordinates into segment coordinates (sensor-to-segment alignment).
    pub q_segment_sensor: UnitQuaternion<f64>,
    /// Where it sits, segment frame, m.
    pub offset_m: Vector3<f64>,
    /// Without a magnetometer: what turns the sensor's level frame into the room, rad; absent: as if the first sample
    /// found the body in a posture that looks along the room's x.
    pub heading_rad: Option<f64>,
    /// How well it is known: standard deviations of rotations about the segment's axes, rad. Zero where it was given.
    #[serde(default)]
    pub sigma_rad: Vector3<f64>,
}

impl SensorMount {
    /// One that is exact.
    pub fn exact(q_segment_sensor: UnitQuaternion<f64>, offset_m: Vector3<f64>) -> Self {
        Self { q_segment_sensor, offset_m, heading_rad: None, sigma_rad: Vector3::zeros() }
    }

    /// How well it is known, root mean square about an axis, rad.
    fn rms_rad(&self) -> f64 {
        (self.sigma_rad.norm_squared() / 3.0).sqrt()
    }

    /// Covariance of its rotation, rad², segment's axes.
    fn rotation_rad2(&self) -> Matrix3<f64> {
        Matrix3::from_diagonal(&self.sigma_rad.component_mul(&self.sigma_rad))
    }
}

/// What the movements of a limb have shown of one of its segments, beginning with what a calibration had found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Learnt {
    /// How well it is known how its sensor sits, root mean square about an axis, rad.
    pub mounting_sigma_rad: f64,
    /// By how much its sensor sits otherwise than the body began with, rad: a strap has slipped, or the pose was not held so well.
    pub turned_rad: f64,
    /// Length of a thigh, an upper arm or a shank and its standard deviation, m; absent for a forearm, whose end nothing shows.
    pub length_m: Option<[f64; 2]>,
}

/// What the body's filters assume; the defaults serve all IMUs of MEMS class.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BodyParams {
    /// Of every sensor's orientation filter; limbs take samples as instantaneous ones, too.
    pub ahrs: Params,
    /// Of the limbs' filters.
    pub limb: LimbNoise,
}

impl Default for BodyParams {
    fn default() -> Self {
        Self { ahrs: Params::instantaneous(), limb: LimbNoise::default() }
    }
}

/// Where the body's heading comes from: by the sensor of the torso, else of the pelvis, else the first that is worn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub enum Heading {
    /// Nothing has been measured.
    #[default]
    Unknown,
    /// From a field that is believed.
    Field,
    /// Held by the gyros for so long, s: no magnetometer, or a field that is not believed.
    Held(f64),
}

/// The body at one time, room frame (z up). What it is worth: `docs/body.md`.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct BodyEstimate {
    /// Segment to room; `None` where no sensor shows it.
    pub orientations: [Option<UnitQuaternion<f64>>; SEGMENTS],
    /// The same of all segments; what no sensor shows is as [`completed`] infers it.
    pub posture: [UnitQuaternion<f64>; SEGMENTS],
    /// Root mean square of its expected error about an axis, rad; of limbs with two sensors, relative to the trunk. Filter and systematic
    /// errors of calibrated sensors; soft tissue is not in it. Of an inferred segment how far people depart from what is inferred. Pi where nothing is known.
    pub sigma_rad: [f64; SEGMENTS],
    /// Angles in the order of [`ANGLE_NAMES`], rad; `None` for a joint that does not lie between two known segments. Beside an inferred segment they are as good as
    /// the spread says.
    pub angles_rad: [Option<f64>; ANGLES],
    /// How uncertain the angles are.
    pub spread: AngleSpread,
    /// What is wrong with the sensor on each segment, if anything, the gravest alone. It takes no sensor out of the estimate.
    pub faults: [Option<Cause>; SEGMENTS],
    /// Where the heading comes from.
    pub heading: Heading,
    /// Its standard deviation, rad: a calibrated magnetometer's, or how far gyros that a rest has calibrated drift since a field last identified it, or since it
    /// was reset. Pi where it is unknown.
    pub heading_sigma_rad: f64,
    /// Where the hips are by the feet; `None` unless sensors have shown the pelvis and both legs.
    pub travel: Option<Travel>,
}

impl Default for BodyEstimate {
    fn default() -> Self {
        Self {
            orientations: [None; SEGMENTS],
            posture: [upright(); SEGMENTS],
            sigma_rad: [std::f64::consts::PI; SEGMENTS],
            angles_rad: [None; ANGLES],
            spread: AngleSpread::default(),
            faults: [None; SEGMENTS],
            heading: Heading::Unknown,
            heading_sigma_rad: std::f64::consts::PI,
            travel: None,
        }
    }
}

impl BodyEstimate {
    /// The hips' mid-point in the room, m: where the feet have brought it, else above the room's origin with the lower ankle at its height over
    /// the floor.
    pub fn pelvis_m(&self, skeleton: &Skeleton) -> Vector3<f64> {
        self.travel.map_or_else(|| skeleton.standing_m(&self.posture), |travel| travel.pelvis_m)
    }
}

/// Angular velocity, rad/s, and specific force, m/s², of a segment in its axes.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Motion {
    angular_velocity_rad_s: Vector3<f64>,
    specific_force_m_s2: Vector3<f64>,
}

/// The filters of a body, live: IMUs in, a [`BodyEstimate`] out, without delay. Method: `docs/methods/body.md`; accuracy:
/// `docs/body.md`.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct BodyFilter {
    sensors: [Option<Sensor>; SEGMENTS],
    limbs: [LimbFilter; 4],
    /// Last motion of torso and pelvis, for a lost sample.
    last_motions: [Option<Motion>; 2],
    held_s: f64,
    skeleton: Skeleton,
    travel: TravelFilter,
    /// Since something else said last where the body is, s.
    unanchored_s: f64,
    /// Whether something else has ever identified the heading.
    heading_anchored: bool,
    worn: Worn,
    /// Under which segment the samples of each segment's sensor are pushed: another one where two were swapped.
    taken_from: [usize; SEGMENTS],
    links: Links,
    estimate: BodyEstimate,
}

impl BodyFilter {
    /// A body that has seen nothing; `mounts` by [`BodySegment::index`]. It copies what it needs of `skeleton` and `params`.
    pub fn new(skeleton: &Skeleton, mounts: &[Option<SensorMount>; SEGMENTS], params: &BodyParams) -> Self {
        Self {
            sensors: mounts.map(|mount| mount.map(|mount| Sensor::new(mount, &params.ahrs))),
            limbs: Limb::ALL.map(|limb| LimbFilter::new(limb, skeleton, mounts, params)),
            last_motions: [None; 2],
            held_s: 0.0,
            skeleton: *skeleton,
            travel: TravelFilter::new(skeleton),
            unanchored_s: 0.0,
            heading_anchored: false,
            worn: Worn::default(),
            taken_from: std::array::from_fn(|index| index),
            links: Links::default(),
            estimate: BodyEstimate::default(),
        }
    }

    /// How the sensors sit, by [`BodySegment::index`] of the segment that their samples are pushed under: those of limbs as their movements have shown it so far.
    pub fn mounts(&self) -> [Option<SensorMount>; SEGMENTS] {
        let mut mounts = [None; SEGMENTS];
        for (sensor, from) in self.sensors.iter().zip(self.taken_from) {
            mounts[from] = sensor.as_ref().map(|sensor| sensor.mount);
        }
        mounts
    }

    /// Under which segment the samples of each segment's sensor are pushed, both by [`BodySegment::index`]: another one where movements have shown that two
    /// sensors were swapped.
    pub fn taken_from(&self) -> &[usize; SEGMENTS] {
        &self.taken_from
    }

    /// What the movements have shown of the segments of limbs, by [`BodySegment::index`]; `None` for all other segments, for one without a sensor, and where the
    /// mountings of the limb were given as exact.
    pub fn learnt(&self) -> [Option<Learnt>; SEGMENTS] {
        let mut all = [None; SEGMENTS];
        for (limb, filter) in Limb::ALL.into_iter().zip(&self.limbs) {
            let [_, upper, lower] = limb.segments();
            if !filter.is_whole() {
                continue;
            }
            for segment in [upper, lower] {
                let Some(sensor) = &self.sensors[segment.index()] else { continue };
                let mount = &sensor.mount;
                all[segment.index()] = sensor.is_learnt().then(|| Learnt {
                    mounting_sigma_rad: mount.rms_rad(),
                    turned_rad: mount.q_segment_sensor.angle_to(&sensor.began.q_segment_sensor),
                    length_m: self.length_m(segment),
                });
            }
        }
        all
    }

    /// Length of a thigh or an upper arm as movements have shown it, and of a shank as its thigh shows it, each with its standard deviation, m; `None` for all others, and where
    /// it was given as exact.
    fn length_m(&self, segment: BodySegment) -> Option<[f64; 2]> {
        let limb = Limb::ALL.iter().position(|limb| limb.segments()[1..].contains(&segment))?;
        let [upper_m, sigma_m] = self.limbs[limb].upper_length_m()?;
        match segment {
            BodySegment::ForearmR | BodySegment::ForearmL => None,
            BodySegment::ShankR | BodySegment::ShankL => {
                let share = self.skeleton.shank_m / self.skeleton.thigh_m;
                let shank_m = share * upper_m;
                Some([shank_m, libm::hypot(share * sigma_m, CRURAL_SHARE * shank_m)])
            }
            _ => Some([upper_m, sigma_m]),
        }
    }

    /// Lengths as the movements have shown them so far, beginning with those that the body was given; both sides are alike.
    pub fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }

    /// Lets every sensor wait for a field, for a second at most: magnetometers are slower than gyros, and limbs that begin with a
    /// heading of chance find no way back.
    pub fn await_field(&mut self) {
        self.sensors.iter_mut().flatten().for_each(|sensor| sensor.patience_s = FIELD_S);
    }

    /// Takes the samples of one time, `dt_s` after the ones before, s, and returns the estimate at that time. A time that
    /// does not rise changes nothing. A missing sample is coasted for 0.1 s; after 0.5 s the sensor levels anew.
    pub fn push(&mut self, samples: &BodySamples, dt_s: f64) -> &BodyEstimate {
        self.push_aged(samples, &[0.0; SEGMENTS], dt_s)
    }

    /// As [`Self::push`], for sensors that do not measure at the same time: `ages_s` states how long before the time of the
    /// estimate each sample was taken, s, at least 0.
    pub fn push_aged(&mut self, samples: &BodySamples, ages_s: &[f64; SEGMENTS], dt_s: f64) -> &BodyEstimate {
        if !dt_s.is_finite() || dt_s <= 0.0 {
            return &self.estimate;
        }
        let samples = &self.taken_from.map(|from| samples[from]);
        for ((sensor, sample), from) in self.sensors.iter_mut().zip(samples).zip(self.taken_from) {
            if let Some(sensor) = sensor {
                sensor.push(sample.as_ref(), ages_s[from], dt_s);
            }
        }
        let orientations =
            self.sensors.each_ref().map(|sensor| sensor.as_ref().and_then(Sensor::orientation));
        let bases = [BodySegment::Torso, BodySegment::Pelvis].map(|trunk| self.base(trunk, samples));
        let hung = Limb::ALL.map(|limb| self.hung(limb, &bases[limb.segments()[0].index()], samples));
        for ((limb, filter), base) in Limb::ALL.into_iter().zip(&mut self.limbs).zip(&hung) {
            let [_, upper, lower] = limb.segments();
            let sensors = [&self.sensors[upper.index()], &self.sensors[lower.index()]];
            let own = [orientations[upper.index()], orientations[lower.index()]];
            let pair = [samples[upper.index()], samples[lower.index()]];
            let reports = filter.push(base, sensors, own, pair, dt_s);
            for (which, segment) in [upper, lower].into_iter().enumerate() {
                if let Some(sensor) = &mut self.sensors[segment.index()] {
                    filter.refine(which, &mut sensor.mount);
                }
            }
            if filter.holds() {
                share(&mut self.sensors, lower, limb.end());
            }
            for ((segment, report), sample) in [upper, lower].into_iter().zip(reports).zip(pair) {
                if let (Some(sensor), Some(sample), Some(nis)) =
                    (&mut self.sensors[segment.index()], sample, report.gyro_nis)
                {
                    // The filter lets the joints' angular velocities go where the gyros say: what is left, it cannot explain.
                    let left = nis.sqrt() * report.gyro_sigma_rad_s;
                    sensor.watch.innovation(sample.gyro_rad_s.norm(), left, report.accel_gated, dt_s);
                }
            }
        }
        self.publish(&orientations, &bases, dt_s);
        self.link(samples, dt_s);
        let mut skeleton = self.skeleton;
        skeleton.learn(|segment| self.length_m(segment).map(|[length_m, _]| length_m));
        self.skeleton = skeleton;
        self.unanchored_s += dt_s;
        let heading_rad = self.estimate.heading_sigma_rad;
        self.estimate.travel = match self.legs(samples) {
            Some(legs) => Some(self.travel.push(&legs, heading_rad, dt_s)),
            None => self.travel.pause(heading_rad),
        };
        if self.worn.is_due(dt_s) {
            self.watch_straps(samples);
        }
        &self.estimate
    }

    /// Whether the heading of the sensor on this segment is held by its gyro alone: it has begun, and no sample of it had a field.
    pub fn drifts(&self, segment: BodySegment) -> bool {
        self.sensors[segment.index()].as_ref().is_some_and(|sensor| sensor.started && !sensor.magnetometer)
    }

    /// The person looks so far to the left of the room's x, rad, upright, arms hanging or raised to the side: the headings of these segments' sensors, by
    /// [`BodySegment::index`], begin anew from that, where no field identifies them. Limbs begin anew with them; of one whose other sensor is not meant that one
    /// goes on from where the limb has it. False where none of them drifts.
    pub fn reset_heading(&mut self, of: &[bool; SEGMENTS], heading_rad: f64) -> bool {
        let before = self.estimate.orientations;
        let meant = |segment: BodySegment| of[segment.index()];
        let mut done = false;
        for segment in BodySegment::ALL.into_iter().filter(|segment| meant(*segment)) {
            if let (true, Some(sensor)) = (self.drifts(segment), &mut self.sensors[segment.index()]) {
                sensor.look(heading_rad);
                self.links.assert(segment);
                done = true;
            }
        }
        for (limb, filter) in Limb::ALL.into_iter().zip(&mut self.limbs) {
            let [_, upper, lower] = limb.segments();
            for (one, other) in [(upper, lower), (lower, upper)] {
                let kept = before[other.index()].filter(|_| meant(one) && !meant(other));
                if let (Some(q), Some(sensor)) = (kept, &mut self.sensors[other.index()]) {
                    sensor.look(yaw_from_upright(&q));
                }
            }
            if done && (meant(upper) || meant(lower)) {
                filter.restart();
            }
        }
        if done && BodySegment::ALL.into_iter().filter(|segment| self.drifts(*segment)).all(meant) {
            self.held_s = 0.0;
        }
        done
    }

    /// The latest estimate; nothing known before the first [`Self::push`].
    pub fn estimate(&self) -> &BodyEstimate {
        &self.estimate
    }

    /// Motion of torso or pelvis, which its limbs hang on.
    fn base(&mut self, trunk: BodySegment, samples: &BodySamples) -> Base {
        let last = &mut self.last_motions[trunk.index()];
        let Some(sensor) = &self.sensors[trunk.index()] else { return Base::room() };
        let Some(q_room_base) = sensor.orientation() else { return Base::room() };
        let known = Base {
            q_room_base,
            angular_velocity_sigma_rad_s: 0.01,
            specific_force_sigma_m_s2: 0.2,
            ..Base::room()
        };
        let Some(sample) = samples[trunk.index()].filter(health::usable) else {
            *last = last.filter(|_| sensor.behind_s <= HOLD_S);
            let gravity = q_room_base.inverse() * Vector3::z() * GRAVITY_M_S2;
            return match *last {
                Some(Motion { angular_velocity_rad_s, specific_force_m_s2 }) => {
                    Base { angular_velocity_rad_s, specific_force_m_s2, ..known }
                }
                // Nothing from the trunk for long: it stands, as far as anybody knows.
                None => Base { specific_force_m_s2: gravity, ..known },
            };
        };
        let mount = &sensor.mount.q_segment_sensor;
        let angular_velocity_rad_s = mount * (sample.gyro_rad_s - sensor.ahrs.bias_rad_s());
        let specific_force_m_s2 = mount * sample.accel_m_s2;
        *last = Some(Motion { angular_velocity_rad_s, specific_force_m_s2 });
        Base {
            angular_velocity_rad_s,
            accel_rad_s2: mount * sensor.accel_rad_s2,
            specific_force_m_s2,
            ..known
        }
    }

    fn publish(&mut self, own: &[Option<UnitQuaternion<f64>>; SEGMENTS], bases: &[Base; 2], dt_s: f64) {
        let out = &mut self.estimate;
        // By its own sensor alone, if any; limbs that know better follow.
        for segment in BodySegment::ALL {
            out.orientations[segment.index()] = own[segment.index()];
            if let Some(sensor) = &self.sensors[segment.index()] {
                out.sigma_rad[segment.index()] = sensor.systematic_rad(self.held_s, self.links.rad2(segment));
            }
        }
        let spreads = self.limbs.each_ref().map(LimbFilter::spread);
        let limbs = Limb::ALL.into_iter().zip(&self.limbs).zip(&spreads);
        for ((limb, filter), spread) in limbs.filter(|((_, filter), _)| filter.is_whole()) {
            let [trunk, upper, lower] = limb.segments();
            let q_room_base = bases[trunk.index()].q_room_base;
            let relative = filter.orientations();
            for (k, segment) in [upper, lower].into_iter().enumerate() {
                out.orientations[segment.index()] = relative[k].map(|q| q_room_base * q);
                // The filter knows of noise and of its own mountings alone; the other errors of both sensors last.
                let sensors = [trunk, segment].map(|s| self.sensors[s.index()].as_ref());
                let limb_rad = spread.map_or(std::f64::consts::PI, |spread| spread.sigma_rad[k]);
                let drift_rad2 = self.links.between_rad2(trunk, segment);
                let trunk = sensors[0].map_or(0.0, |sensor| sensor.systematic_rad(self.held_s, 0.0));
                let own = sensors[1].map_or(0.0, |sensor| sensor.unmounted_rad(self.held_s, drift_rad2));
                out.sigma_rad[segment.index()] = libm::hypot(libm::hypot(limb_rad, trunk), own);
            }
        }
        let inferred = Inference::of(&out.orientations);
        out.posture = inferred.orientations;
        inferred.judge(&out.orientations, &mut out.sigma_rad);
        // A sensor that is silent yet is no reason to infer an angle.
        let worn = self.sensors.each_ref().map(Option::is_some);
        let shown = inferred.between(&out.orientations, &worn);
        out.angles_rad = angles(&shown);
        self.estimate.spread = self.spread(&shown, &inferred.joints_rad2, &spreads);
        let out = &mut self.estimate;
        for segment in BodySegment::ALL {
            let index = segment.index();
            // Who has just begun or come back does not know yet how it is turned; nor does what hangs on it.
            let settled = std::iter::successors(Some(segment), |s| s.parent())
                .filter_map(|s| self.sensors[s.index()].as_ref())
                .all(|sensor| sensor.settled_s >= SETTLED_S);
            let Some(sensor) = &mut self.sensors[index] else { continue };
            let body = out.orientations[index].filter(|_| settled);
            sensor.watch.agrees(own[index], body, sensor.magnetometer, dt_s);
            let swapped = (self.taken_from[index] != index).then_some(Cause::Swapped);
            out.faults[index] = sensor.watch.fault().or(swapped);
        }
        for (limb, filter) in Limb::ALL.into_iter().zip(&mut self.limbs) {
            let [_, upper, lower] = limb.segments();
            for (which, segment) in [upper, lower].into_iter().enumerate() {
                filter.watch(which, out.faults[segment.index()] == Some(Cause::Misfit), dt_s);
            }
        }
        let first = BodySegment::ALL
            .into_iter()
            .filter_map(|segment| Some((segment, self.sensors[segment.index()].as_ref()?)))
            .find(|(_, sensor)| sensor.started);
        out.heading = match first {
            None => Heading::Unknown,
            Some((_, sensor)) if sensor.magnetometer && !sensor.ahrs.magnetic_disturbance() => {
                self.held_s = 0.0;
                Heading::Field
            }
            Some(_) => {
                self.held_s += dt_s;
                Heading::Held(self.held_s)
            }
        };
        out.heading_sigma_rad = first.map_or(std::f64::consts::PI, |(segment, sensor)| {
            let [_, heading] = sensor.lasting_rad2(self.held_s, self.links.rad2(segment));
            heading.sqrt().min(std::f64::consts::PI)
        });
    }
}

/// By how far a segment is turned about the vertical from a body that looks along the room's x, rad: the twist of its rotation
/// from upright, which sitting, bowing and raised arms leave alone.
pub(crate) fn yaw_from_upright(segment: &UnitQuaternion<f64>) -> f64 {
    let rotation = segment * upright().inverse();
    2.0 * libm::atan2(rotation.k, rotation.w)
}
