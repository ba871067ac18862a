//! The input log: all that the pipeline ever sees, in one total order.
//!
//! A recording holds these entries, and a replay feeds them again: same entries, same outputs.

use std::collections::BTreeMap;

use posed_drivers::{LineEvent, Timestamp};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use posed_field::Prepared;
use posed_fusion::body::BodySegment;
use posed_fusion::chain::ChainCalibration;
use posed_fusion::intrinsics::Intrinsics;
use posed_motion::exercise::Exercise;
use posed_motion::fault_map::FaultMap;
use posed_timecode::Reading;

/// Index of a device in the stage file's `[[device]]` list ([`crate::Stage::devices`]), from 0.
pub type DeviceIndex = u16;
/// Index of a sensor in the stage file's `[[sensor]]` list ([`crate::Stage::sensors`]), from 0.
pub type SensorIndex = u16;

/// Longest label of a mark.
pub const MARK_BYTES: usize = 200;

/// Least standard deviation of a tracker, m and rad, and least reference distance, m.
const LEAST_NOISE: f64 = 1e-9;
/// Lengths of the field that can be those of a device's own records, which have about 1.
const FIELD_NORM: std::ops::RangeInclusive<f64> = 0.1..=10.0;

/// One entry of the input log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Host time of the entry, since the stage's epoch. Entries of several devices may be a few microseconds out of order; the
    /// pipeline's own time is the latest one seen.
    pub t: Timestamp,
    /// What came in.
    pub input: Input,
}

/// What can come in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Input {
    /// A read chunk of a device; `Entry::t` is its stamp.
    Bytes {
        /// Who sent it.
        device: DeviceIndex,
        /// The bytes of one read, as the device sent them.
        #[serde(with = "posed_geometry::bytes")]
        bytes: Vec<u8>,
    },
    /// A device's line opened, closed, or lost bytes.
    Line {
        /// Whose line.
        device: DeviceIndex,
        /// What happened.
        event: LineEvent,
    },
    /// A deadline of the pipeline (see `Pipeline::poll_timeout`) has passed.
    Timer,
    /// A model is swapped in, in full. One whose numbers are wrong ([`Model::check`]), or that speaks of what the stage has not,
    /// changes nothing but a count of the status.
    Model(Model),
    /// A client asks for something that changes what the pipeline does. What cannot be done changes nothing but a count of the
    /// status.
    Request(Request),
    /// A trained network of segments is swapped in: its file in full. An empty or an unusable one changes nothing but a count of
    /// the status.
    SegmentationNetwork(#[serde(with = "posed_geometry::bytes")] Vec<u8>),
    /// Ground truth from a simulator, passed through to the `truth` topic.
    Truth(Truth),
    /// A frame of time code; `Entry::t` is when the read that brought it was over.
    Timecode(Reading),
}

/// A model that can be swapped in between two frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Model {
    /// Where the transmitter stands in the room.
    Transmitter {
        /// Position of the transmitter in the room, m.
        position_m: [f64; 3],
        /// Turns transmitter coordinates into room coordinates.
        orientation_wxyz: [f64; 4],
    },
    /// How noisy the tracker is: standard deviations at the reference distance `r0_m`.
    TrackerNoise {
        /// The device it speaks of, by name.
        device: String,
        /// Reference distance from the transmitter, m.
        r0_m: f64,
        /// Standard deviation along the transmitter ray at `r0_m`, m (grows with r^4).
        sigma_radial_m: f64,
        /// Rotation standard deviation at `r0_m`, rad (grows with r^3).
        sigma_rotation_rad: f64,
    },
    /// Where metal bends the field: what a file of `posed field solve` holds.
    Field {
        /// Number of the map on its stage, from 1; 0 is none.
        version: u32,
        /// The map; null takes the present one away.
        #[schemars(with = "Option<serde_json::Map<String, serde_json::Value>>")]
        map: Option<Prepared>,
    },
    /// How the body's sensors sit, as a calibration found it.
    Mounting {
        /// The body, by name; absent: the only one.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        body: Option<String>,
        /// One per sensor on the body.
        sensors: Vec<MountedSensor>,
    },
    /// How the sensors of a chain of hinges sit and where its axes are, as a calibration found it.
    Chain {
        /// The body, by name; absent: the only one.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        body: Option<String>,
        /// One entry per segment of the stage file.
        calibration: Box<ChainCalibration>,
    },
    /// How an IMU sits on the magnetic sensor that it is attached to, as `stage.align` found it.
    AttachedImu {
        /// The magnetic sensor, by name.
        sensor: String,
        /// Turns the IMU's coordinates into the magnetic sensor's.
        quat_wxyz: [f64; 4],
        /// From the magnetic sensor to the IMU, the magnetic sensor's axes, m.
        offset_m: [f64; 3],
        /// Capture time of a magnetic record on the IMU's clock minus the one it is given, s.
        clock_offset_s: f64,
    },
    /// Intrinsics of an IMU; they take the place of those before, and filters that knew the unit begin anew.
    Imu {
        /// The unit: its serial number, or the name of its sensor where neither device nor stage file tell one.
        unit: String,
        /// As in its file; the field in the unit that the device itself measures in, about 1.
        intrinsics: Box<Intrinsics>,
    },
    /// A taught exercise; it takes the place of the one of its name.
    Exercise {
        /// The exercise, as in its file.
        exercise: Box<Exercise>,
    },
    /// A fault map; it takes the place of the one before. Clients send none: it is longer than a message may be.
    #[schemars(skip)]
    Faults {
        /// The network, as in its file.
        fault_map: Box<FaultMap>,
    },
}

/// How one sensor sits on its segment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MountedSensor {
    /// The sensor, by name.
    pub sensor: String,
    /// The segment it was found on, by name; absent: where it was taken to sit before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment: Option<String>,
    /// Turns sensor coordinates into segment coordinates.
    pub mount_quat_wxyz: [f64; 4],
    /// Where it sits, segment frame, m.
    pub offset_m: [f64; 3],
    /// How well the rotation is known: standard deviations about the segment's axes, degrees; absent: it is exact.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_deg: Option<[f64; 3]>,
}

/// What clients ask of the pipeline. `Pipeline::check_request` tells beforehand whether it can be done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// Counts these exercises from 0 for a subject, and no others.
    ExerciseSelect {
        /// Who moves: 1 to 64 bytes; 64 subjects at most.
        subject: String,
        /// Names of exercises that were loaded, each once, 32 at most, all taught at one frame rate; none ends the counting.
        exercises: Vec<String>,
        /// How much is to be done.
        plan: Plan,
        /// By the sensor that the exercises were taught with: the sensor of this subject that stands for it. Empty: they are the
        /// same.
        #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
        sensors: BTreeMap<String, String>,
        /// The body whose joints are counted, by name; absent: the one that is called as the subject, or else the first one.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        body: Option<String>,
    },
    /// Counts a subject's exercises from 0 again; what is under way goes on.
    ExerciseReset {
        /// Who moves; one for whom something was selected or is counted by default.
        subject: String,
    },
    /// Begins to collect what a pole's sensors read, to calibrate the field; what was collected before is forgotten.
    FieldStart {
        /// The sensors by name, in their order along the pole.
        sensors: Vec<String>,
        /// Measured distance between neighbours, m, above 0.
        spacing_m: f64,
    },
    /// Ends that: the recording goes out as `Output::PoleRun`, empty where none was under way. The map is solved elsewhere.
    FieldFinish {},
    /// Notes a moment, for whoever looks at the recording later: goes out as `OutcomeKind::Mark`.
    Mark {
        /// What happens then: [`MARK_BYTES`] at most, may be empty.
        label: String,
    },
    /// The person looks this way now, upright: the headings of IMUs that no field identifies begin anew from it.
    HeadingReset {
        /// The person, by the name of the body; absent: the one who wears the IMU, or the only one.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        body: Option<String>,
        /// The IMU, by name; absent: all on the body.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sensor: Option<String>,
        /// How far to the left of the room's x the person looks, rad.
        heading_rad: f64,
    },
}

/// How much of an exercise is to be done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Repetitions of a set, 1 to 10000; absent: one set without end.
    pub repetitions: Option<u32>,
    /// Sets of each exercise, 1 to 10000; absent: no end.
    pub sets: Option<u32>,
    /// Rest after a set, s, 0 to 3600; 0 by default.
    pub rest_s: f64,
}

impl Model {
    /// Whether `newer` takes this model's place: it is of the same kind, and speaks of the same device, magnetic sensor, unit or
    /// exercise where the kind has several.
    pub fn replaced_by(&self, newer: &Self) -> bool {
        match (self, newer) {
            (Self::Transmitter { .. }, Self::Transmitter { .. }) => true,
            (Self::Mounting { body, .. }, Self::Mounting { body: of, .. }) => body == of,
            (Self::Chain { body, .. }, Self::Chain { body: of, .. }) => body == of,
            (Self::AttachedImu { sensor, .. }, Self::AttachedImu { sensor: of, .. }) => sensor == of,
            (Self::TrackerNoise { device, .. }, Self::TrackerNoise { device: of, .. }) => device == of,
            (Self::Field { .. }, Self::Field { .. }) => true,
            (Self::Imu { unit, .. }, Self::Imu { unit: of, .. }) => unit == of,
            (Self::Exercise { exercise }, Self::Exercise { exercise: newer }) => exercise.name == newer.name,
            (Self::Faults { .. }, Self::Faults { .. }) => true,
            _ => false,
        }
    }

    /// Whether the numbers make a model: finite, in their ranges, quaternions not zero (they are normalised later). Whether the
    /// stage has what it speaks of, only the pipeline knows. A fault map is not looked at.
    ///
    /// # Errors
    /// One sentence that names the key and what it must be.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Transmitter { position_m, orientation_wxyz } => {
                if posed_geometry::isometry(*position_m, *orientation_wxyz).is_none() {
                    return Err(
                        "position_m, orientation_wxyz: give numbers up to 1e6 and a quaternion that is not zero"
                            .into(),
                    );
                }
            }
            Self::TrackerNoise { r0_m, sigma_radial_m, sigma_rotation_rad, .. } => {
                // No tracker reaches further, and one that is worse would say nothing: its gate would let everything through.
                let numbers = [
                    ("r0_m", r0_m, 100.0),
                    ("sigma_radial_m", sigma_radial_m, 1.0),
                    ("sigma_rotation_rad", sigma_rotation_rad, 1.0),
                ];
                let wrong = |(_, value, most): &(_, &f64, f64)| !(**value >= LEAST_NOISE && *value <= most);
                if let Some((key, value, most)) = numbers.into_iter().find(wrong) {
                    return Err(format!("{key}: give a number from {LEAST_NOISE:e} to {most}, not {value}"));
                }
            }
            Self::Field { map, .. } => {
                if let Some(map) = map {
                    map.map().check().map_err(|reason| format!("map: {reason}"))?;
                }
            }
            Self::Mounting { sensors, .. } => {
                let good = |sensor: &MountedSensor| {
                    let is_known = |sigma_deg: f64| (0.0..=180.0).contains(&sigma_deg);
                    posed_geometry::isometry(sensor.offset_m, sensor.mount_quat_wxyz).is_some()
                        && sensor.sigma_deg.is_none_or(|sigma_deg| sigma_deg.into_iter().all(is_known))
                };
                let nowhere = sensors
                    .iter()
                    .filter_map(|sensor| sensor.segment.as_ref())
                    .find(|name| BodySegment::named(name).is_none());
                if let Some(name) = nowhere {
                    return Err(format!("segment: {name:?} is no segment of the body"));
                }
                if let Some(bad) = sensors.iter().find(|sensor| !good(sensor)) {
                    return Err(format!(
                        "sensors: give {:?} numbers up to 1e6, a quaternion that is not zero and standard deviations up to 180",
                        bad.sensor
                    ));
                }
            }
            Self::AttachedImu { quat_wxyz, offset_m, clock_offset_s, .. } => {
                if posed_geometry::isometry(*offset_m, *quat_wxyz).is_none() || !clock_offset_s.is_finite() {
                    return Err("offset_m, quat_wxyz, clock_offset_s: give numbers up to 1e6 and a quaternion that is not zero".into());
                }
            }
            Self::Chain { calibration, .. } => calibration.check()?,
            Self::Imu { unit, intrinsics } => {
                intrinsics.check()?;
                let norm = intrinsics.mag.as_ref().map_or(1.0, |mag| mag.norm);
                if unit.is_empty() || !FIELD_NORM.contains(&norm) {
                    return Err(format!(
                        "unit, mag.norm: name the unit, and calibrate with the device's own records, whose field is about 1, not {norm:.3}"
                    ));
                }
            }
            Self::Exercise { exercise } => exercise.check().map_err(|error| error.to_string())?,
            // Read from its file, it holds together; whether it is of these sensors, the pipeline knows.
            Self::Faults { .. } => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_noise_that_would_let_everything_through_is_refused() {
        let noise = |r0_m, sigma_radial_m, sigma_rotation_rad| {
            let device = "flock".to_owned();
            Model::TrackerNoise { device, r0_m, sigma_radial_m, sigma_rotation_rad }.check()
        };
        assert_eq!(noise(1.0, 2e-4, 2e-3), Ok(()));
        for wrong in [0.0, -1.0, 1e300, f64::NAN, f64::INFINITY, 1e-300] {
            assert!(noise(wrong, 2e-4, 2e-3).is_err_and(|reason| reason.starts_with("r0_m")));
            assert!(noise(1.0, wrong, 2e-3).is_err_and(|reason| reason.starts_with("sigma_radial_m")));
            assert!(noise(1.0, 2e-4, wrong).is_err_and(|reason| reason.starts_with("sigma_rotation_rad")));
        }
    }
}

/// Ground truth of one capture instant of one simulated device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Capture time, exact.
    pub t_valid: Timestamp,
    /// One per sensor of that device.
    pub sensors: Vec<TruthSensor>,
}

/// Ground truth of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthSensor {
    /// Which sensor of the stage.
    pub sensor: SensorIndex,
    /// Position in the room, m.
    pub position_m: [f64; 3],
    /// Sensor to room, unit, scalar first.
    pub orientation_wxyz: [f64; 4],
    /// What the simulator did to the record: `clean`, `inverted`, `stuck`, `jump`, `disturbed`.
    pub class: String,
}
