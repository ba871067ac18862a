//! Truth: where every part of every simulated body is, at any time.
//!
//! What comes in: a description ([`Motion`], as in the stage file) or a file of real motion. What goes
//! out: poses of named segments in the room, twice continuously differentiable in time, so that a
//! simulated IMU on them would feel no jumps. (Where a file of motion begins and is held at its end, only the
//! velocity is continuous.) It knows no sensors and no devices.

mod file;
mod imu_calibration;
mod person;
mod pole;
mod scripted;
mod spline;

use std::path::Path;
use std::sync::Arc;

use crate::body::take::{Take, TakeError};
use crate::body::{SEGMENTS, Strap};
use crate::random::{Purpose, Random};
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

pub use crate::bvh::{Bvh, BvhError};
pub use crate::motion_file::FileError;
pub use file::{Ending, File, Tracks, Up};
pub use imu_calibration::ImuCalibration;
pub use person::Person;
pub use pole::Pole;
pub(crate) use scripted::quaternion;
pub use scripted::{Curl, Orbit, Screw, Still, Walk};

/// How a body moves, as it stands in a stage file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Motion {
    /// Does not move.
    Still(Still),
    /// Wanders on a closed curve of harmonics, turning as it goes.
    Orbit(Orbit),
    /// Turns to and fro about an axis while it advances along it.
    Screw(Screw),
    /// Bends and straightens the elbow of a two-segment arm.
    Curl(Curl),
    /// Walks around an ellipse: pelvis, torso and both legs.
    Walk(Walk),
    /// A pole with sensors, moved through a box: for calibrating a field.
    Pole(Pole),
    /// Placed in one direction after the other: for calibrating an IMU.
    ImuCalibration(ImuCalibration),
    /// A whole person, as body-worn sensors know one.
    Person(Person),
    /// Poses from a CSV file or joints from a BVH file.
    File(File),
}

impl Motion {
    /// Whether its periods are above 0 and its places are numbers. Not every key is checked, and a file is not opened.
    ///
    /// # Errors
    /// A sentence that names the first key that makes no sense.
    pub fn check(&self) -> Result<(), String> {
        let above_zero = |key: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(format!("{key} = {value} should be above 0"))
            }
        };
        let finite = |key: &str, values: &[f64]| {
            let good = values.iter().all(|value| value.is_finite());
            if good { Ok(()) } else { Err(format!("{key} should hold ordinary numbers")) }
        };
        match self {
            Self::Still(still) => finite("position_m", &still.position_m),
            Self::Orbit(orbit) => {
                above_zero("period_s", orbit.period_s)?;
                above_zero("turn_period_s", orbit.turn_period_s)?;
                finite("center_m", &orbit.center_m)?;
                finite("radius_m", &orbit.radius_m)
            }
            Self::Screw(screw) => {
                above_zero("period_s", screw.period_s)?;
                above_zero("axis", Vector3::from(screw.axis).norm())
                    .map_err(|_| "axis has no direction".to_owned())?;
                finite("point_m", &screw.point_m)
            }
            Self::Curl(curl) => {
                above_zero("period_s", curl.period_s)?;
                finite("shoulder_m", &curl.shoulder_m)?;
                if curl.pause_s >= 0.0 { Ok(()) } else { Err("pause_s should not be below 0".to_owned()) }
            }
            Self::Walk(walk) => {
                above_zero("step_m", walk.step_m)?;
                finite("center_m", &walk.center_m)
            }
            Self::Pole(pole) => {
                above_zero("period_s", pole.period_s)?;
                above_zero("turn_period_s", pole.turn_period_s)?;
                finite("center_m", &pole.center_m)?;
                finite("reach_m", &pole.reach_m)
            }
            Self::ImuCalibration(imu_calibration) => {
                above_zero("rest_s", imu_calibration.rest_s)?;
                above_zero("turn_s", imu_calibration.turn_s)?;
                finite("position_m", &imu_calibration.position_m)
            }
            Self::Person(person) => {
                above_zero("height_m", person.height_m)?;
                above_zero("follows_rate_hz", person.follows_rate_hz.unwrap_or(1.0))?;
                finite("heading_deg", &[person.heading_deg])?;
                if !(0.0..=90.0).contains(&person.strap_deg) {
                    return Err(format!("strap_deg = {} should be from 0 to 90", person.strap_deg));
                }
                if !(0.0..=5.0).contains(&person.skin_deg_per_m_s2) {
                    return Err(format!(
                        "skin_deg_per_m_s2 = {} should be from 0 to 5",
                        person.skin_deg_per_m_s2
                    ));
                }
                finite("position_m", &person.position_m)
            }
            Self::File(file) => {
                above_zero("speed", file.speed)?;
                above_zero("unit_m", file.unit_m.unwrap_or(1.0))
            }
        }
    }
}

/// Linear velocity of a segment's origin and angular velocity of the segment, both in room axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist {
    /// Linear velocity, m/s.
    pub linear_m_s: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular_rad_s: Vector3<f64>,
}

/// A body in motion: named segments with a pose at each time. No randomness: the same motion gives the same poses.
#[derive(Clone, Debug)]
pub struct Body {
    motion: Motion,
    /// The tracks of a [`Motion::File`].
    tracks: Option<Arc<Tracks>>,
    /// The recordings that a [`Motion::Person`] follows.
    take: Option<Arc<Take>>,
    /// How the straps of what a [`Motion::Person`] wears wander, by segment.
    straps: Option<Arc<[Strap; SEGMENTS]>>,
    /// By how much the skin turns what it wears with the acceleration, by segment: segment axes, rad per m/s².
    skin: Option<Arc<[Matrix3<f64>; SEGMENTS]>>,
}

impl Body {
    /// Makes a motion ready; reads its file, if it has one, relative to `folder`.
    ///
    /// The numbers of the motion are taken as they are: [`Motion::check`] judges them.
    ///
    /// # Errors
    /// The file cannot be read or holds no motion; the error names line and column of what is wrong in its text.
    pub fn new(motion: Motion, folder: &Path) -> Result<Self, TakeError> {
        let tracks = match &motion {
            Motion::File(file) => Some(Arc::new(Tracks::read(file, folder)?)),
            _ => None,
        };
        let take = match &motion {
            Motion::Person(person) if !person.follows.is_empty() => {
                let take = Take::read(&person.follows, folder, person.follows_rate_hz, person.height_m)?;
                Some(Arc::new(take))
            }
            _ => None,
        };
        let straps = match &motion {
            Motion::Person(person) if person.strap_deg > 0.0 => {
                let strap = |segment| {
                    let mut random = Random::new(0, Purpose::Strap(segment));
                    Strap::draw(person.strap_deg.to_radians(), &mut random)
                };
                Some(Arc::new(std::array::from_fn(strap)))
            }
            _ => None,
        };
        let skin = match &motion {
            Motion::Person(person) if person.skin_deg_per_m_s2 > 0.0 => {
                let skin = |segment| {
                    let mut random = Random::new(0, Purpose::Skin(segment));
                    Matrix3::from_fn(|_, _| person.skin_deg_per_m_s2.to_radians() * random.normal())
                };
                Some(Arc::new(std::array::from_fn(skin)))
            }
            _ => None,
        };
        Ok(Self { motion, tracks, take, straps, skin })
    }

    /// Names of its segments, in the order of their indices.
    pub fn segments(&self) -> Vec<&str> {
        match &self.motion {
            Motion::Still(_) | Motion::Orbit(_) | Motion::Screw(_) | Motion::ImuCalibration(_) => {
                vec!["body"]
            }
            Motion::Pole(_) => vec!["pole"],
            Motion::Curl(_) => Curl::SEGMENTS.to_vec(),
            Motion::Walk(_) => Walk::SEGMENTS.to_vec(),
            Motion::Person(_) => Person::SEGMENTS.to_vec(),
            Motion::File(_) => self.tracks.iter().flat_map(|tracks| tracks.names()).collect(),
        }
    }

    /// Pose of the `segment`-th segment in the room (segment to room, m) at `t_s`, which may be any time.
    ///
    /// # Panics
    /// If a person or a file has no such segment; other bodies then give the pose of one that they have.
    pub fn pose(&self, segment: usize, t_s: f64) -> Isometry3<f64> {
        match &self.motion {
            Motion::Still(still) => still.pose(),
            Motion::Orbit(orbit) => orbit.pose(t_s),
            Motion::Screw(screw) => screw.pose(t_s),
            Motion::Curl(curl) => curl.pose(segment, t_s),
            Motion::Walk(walk) => walk.pose(segment, t_s),
            Motion::Pole(pole) => pole.pose(t_s),
            Motion::ImuCalibration(imu_calibration) => imu_calibration.pose(t_s),
            Motion::Person(person) => person.pose(self.take.as_deref(), segment, t_s),
            Motion::File(_) => {
                self.tracks.as_ref().map_or_else(Isometry3::identity, |tracks| tracks.pose(segment, t_s))
            }
        }
    }

    /// How what is worn on a segment has turned on it since it was put on: straps wander.
    pub(crate) fn strap(&self, segment: usize, t_s: f64) -> UnitQuaternion<f64> {
        self.straps.as_ref().map_or_else(UnitQuaternion::identity, |straps| {
            UnitQuaternion::from_scaled_axis(straps[segment].turned_rad(t_s))
        })
    }

    /// How the skin has turned what is worn at a point of a segment, m: at once with how that point is accelerated, and not at rest. The point itself stays.
    pub(crate) fn skin(&self, segment: usize, at_m: &Vector3<f64>, t_s: f64) -> UnitQuaternion<f64> {
        /// Step of the differences, five points.
        const H_S: f64 = 2e-3;
        let Some(skin) = &self.skin else { return UnitQuaternion::identity() };
        let pose = self.pose(segment, t_s);
        let offset_m = |n: f64| {
            let moved = self.pose(segment, t_s + n * H_S);
            (moved.translation.vector - pose.translation.vector)
                + (moved.rotation * at_m - pose.rotation * at_m)
        };
        let bend_m = (offset_m(-1.0) + offset_m(1.0)) * 16.0 - offset_m(-2.0) - offset_m(2.0);
        let acceleration_m_s2 = pose.rotation.inverse() * bend_m / (12.0 * H_S * H_S);
        UnitQuaternion::from_scaled_axis(skin[segment] * acceleration_m_s2)
    }

    /// Velocity of the segment's origin and of its rotation at `t_s`.
    ///
    /// A five-point difference over 0.4 ms: exact to about 1e-6 of the fastest motion here.
    ///
    /// # Panics
    /// As for [`Body::pose`].
    pub fn twist(&self, segment: usize, t_s: f64) -> Twist {
        const H_S: f64 = 1e-4;
        let at = |n: f64| self.pose(segment, t_s + n * H_S);
        let (a, b, c, d) = (at(-2.0), at(-1.0), at(1.0), at(2.0));
        let slope = |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>, d: Vector3<f64>| {
            (a - 8.0 * b + 8.0 * c - d) / (12.0 * H_S)
        };
        let here = self.pose(segment, t_s).rotation;
        let rotation_vector_rad = |pose: &Isometry3<f64>| (pose.rotation * here.inverse()).scaled_axis();
        Twist {
            linear_m_s: slope(
                a.translation.vector,
                b.translation.vector,
                c.translation.vector,
                d.translation.vector,
            ),
            angular_rad_s: slope(
                rotation_vector_rad(&a),
                rotation_vector_rad(&b),
                rotation_vector_rad(&c),
                rotation_vector_rad(&d),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bodies() -> Vec<Body> {
        let motions = [
            Motion::Still(Still::default()),
            Motion::Orbit(Orbit::default()),
            Motion::Screw(Screw::default()),
            Motion::Curl(Curl { repetitions: Some(2), ..Curl::default() }),
            Motion::Walk(Walk::default()),
            Motion::Pole(Pole::default()),
            Motion::ImuCalibration(ImuCalibration::default()),
            Motion::Person(Person { activity: crate::body::Activity::Squats, ..Person::default() }),
        ];
        motions.into_iter().map(|motion| Body::new(motion, Path::new(".")).unwrap()).collect()
    }

    #[test]
    fn velocity_and_acceleration_never_jump() {
        let dt = 1e-3;
        for body in bodies() {
            for segment in 0..body.segments().len() {
                let twist = |i: i32| body.twist(segment, f64::from(i) * dt);
                let mut before = (twist(0), twist(1));
                for i in 2..9000 {
                    let now = twist(i);
                    let bend =
                        |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>| (c - 2.0 * b + a).norm() / dt;
                    let (a, b) = before;
                    let linear = bend(a.linear_m_s, b.linear_m_s, now.linear_m_s);
                    let angular = bend(a.angular_rad_s, b.angular_rad_s, now.angular_rad_s);
                    assert!(linear < 0.5, "{:?} {segment} at {i} ms: {linear} m/s2", body.motion);
                    assert!(angular < 1.5, "{:?} {segment} at {i} ms: {angular} rad/s2", body.motion);
                    before = (b, now);
                }
            }
        }
    }

    #[test]
    fn a_person_s_keys_that_make_no_sense_are_named() {
        let problem = |person: Person| Motion::Person(person).check().unwrap_err();
        for skin_deg_per_m_s2 in [-0.1, 5.1, f64::NAN] {
            let found = problem(Person { skin_deg_per_m_s2, ..Person::default() });
            assert!(
                found.starts_with("skin_deg_per_m_s2 = ") && found.ends_with("should be from 0 to 5"),
                "{found}"
            );
        }
        assert!(problem(Person { strap_deg: 91.0, ..Person::default() }).starts_with("strap_deg"));
        assert_eq!(Motion::Person(Person { skin_deg_per_m_s2: 0.06, ..Person::default() }).check(), Ok(()));
    }

    #[test]
    fn twist_of_a_screw_is_its_closed_form() {
        let screw = Screw { axis: [0.0, 0.0, 2.0], angle_deg: 90.0, period_s: 2.0, ..Screw::default() };
        let body = Body::new(Motion::Screw(screw.clone()), Path::new(".")).unwrap();
        let angular_velocity_rad_s = 90f64.to_radians() / 2.0 * std::f64::consts::PI; // at a quarter of the period
        let twist = body.twist(0, 0.5);
        assert!(
            (twist.angular_rad_s - Vector3::new(0.0, 0.0, angular_velocity_rad_s)).norm() < 1e-6,
            "{twist:?}"
        );
        let advance = screw.pitch_m_per_turn * angular_velocity_rad_s / std::f64::consts::TAU;
        assert!((twist.linear_m_s.z - advance).abs() < 1e-6);
        assert!((twist.linear_m_s.xy().norm() - angular_velocity_rad_s * screw.radius_m).abs() < 1e-6);
    }
}
