//! How each sensor sits on its segment, from poses and movements that were held at known times.
//!
//! In: a recording of the whole body and the [`Block`]s of it in which something known was done. Out: a [`SensorMount`] per
//! sensor with its quality in degrees, or one sentence that states what was missing and what to do. It never returns a
//! mounting that the recording does not show.
//!
//! Poses give the anatomical zero: which way is up in each segment. Movements give the axes: a hinge points to the body's
//! right whatever the person takes for standing straight. Both are directions seen in the sensor and known in the
//! segment, so the mounting is Wahba's problem over all of them, weighted by how well people can hold each. Which way the
//! body faces comes from the same axes; with magnetometers one angle serves all sensors, without each sensor needs its
//! own.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::block::{Block, BlockKind, Movement, Recorded};
use super::skeleton::{BodySegment, SEGMENTS, Skeleton, upright};
use super::{SensorMount, joint_rotation, yaw_from_upright};
use crate::ahrs::{Ahrs, ImuSample, Params};
use crate::chain;
use crate::mounting::{Refused, hinge_axes};
use posed_geometry::so3;

/// A pose in which a sensor turns faster than this, root mean square about its mean, was not held, rad/s.
const HELD_RAD_S: f64 = 0.2;
/// A gyro that says more than this in a pose that is held has a bias, rad/s: nobody turns so on the spot for seconds.
const BIAS_RAD_S: f64 = 0.035;
/// Above this disagreement of its directions, degrees, a warning asks for the mounting to be repeated; above 15 it is
/// refused.
pub const REPEAT_DEG: f64 = 5.0;
/// And by more than this it is refused, degrees.
const REFUSE_DEG: f64 = 15.0;
/// How well people hold what they are asked to, degrees.
const POSE_DEG: f64 = 3.0;
const FACING_DEG: f64 = 5.0;
const HINGE_DEG: f64 = 2.0;
/// How far the segment above a joint must turn meanwhile, root mean square, to show the axis without a magnetometer, rad.
const PARENT_ROTATES_RAD: f64 = 0.35;
const BALL_DEG: f64 = 6.0;

/// How the sensors sit: sensor-to-segment alignment of each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibrated {
    /// By [`BodySegment::index`]; `None` where no sensor has samples.
    pub mounts: [Option<SensorMount>; SEGMENTS],
    /// Root mean square by which the directions disagree, weighted, degrees, by [`BodySegment::index`]; below 15. It shows
    /// neither a pose that all sensors saw wrong nor soft tissue.
    pub quality_deg: [Option<f64>; SEGMENTS],
    /// Sentences about what should be repeated.
    pub warnings: Vec<String>,
}

/// Why a body cannot be calibrated.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CalibrationError {
    /// No sensor has samples.
    #[error("no sensor of the body has samples")]
    Empty,
    /// No pose shows which way is up in the segments.
    #[error("no pose was held: add an `n_pose` of three seconds")]
    NoPose,
    /// A pose was not held still, or has no samples.
    #[error("{pose} from {start_s} to {end_s} s: {segment} {problem}")]
    NotHeld {
        /// Which pose.
        pose: String,
        /// Its begin.
        start_s: f64,
        /// Its end.
        end_s: f64,
        /// Which segment's sensor.
        segment: &'static str,
        /// What is wrong.
        problem: &'static str,
    },
    /// A movement does not show its axis.
    #[error("{movement} from {start_s} to {end_s} s: {reason}")]
    Movement {
        /// Which movement.
        movement: String,
        /// Its begin.
        start_s: f64,
        /// Its end.
        end_s: f64,
        /// What was missing.
        reason: Refused,
    },
    /// Nothing states which way the body faces.
    #[error("nothing shows which way {of} faces: add {fix}")]
    Facing {
        /// The body, or a segment.
        of: &'static str,
        /// What to record.
        fix: &'static str,
    },
    /// What the sensor showed contradicts itself.
    #[error(
        "{segment}: poses and movements disagree by {found_deg:.0} degrees: repeat them, and see whether its strap slipped \
         or two sensors are swapped"
    )]
    Disagree {
        /// Which segment.
        segment: &'static str,
        /// By how much.
        found_deg: f64,
    },
}

/// A direction seen in a sensor and known in its segment.
struct SegmentAxis {
    sensor: Vector3<f64>,
    segment: Vector3<f64>,
    sigma_deg: f64,
}

/// A movement's axis, as a sensor saw it.
struct Axis {
    segment: BodySegment,
    sensor: Vector3<f64>,
    in_segment: Vector3<f64>,
    sigma_deg: f64,
}

/// A pose as one sensor held it: its mean orientation, level frame or room.
type Held = [Option<UnitQuaternion<f64>>; SEGMENTS];

/// Finds the sensor-to-segment alignments. `offsets_m` states where sensors sit, segment frame, m, by [`BodySegment::index`],
/// where that is known; without a block, the first second counts as an N-pose and the whole recording as bending of elbows
/// and knees. Magnetometers count where all sensors have one. Offline; Wahba's problem with the weights of
/// `docs/methods/body.md`.
///
/// # Errors
/// A [`CalibrationError`], whose sentence names what is missing and what to do: nothing recorded, no pose, a pose not held, a
/// movement that does not show its axis, no direction that the body faces, or directions that disagree by more than 15
/// degrees.
pub fn calibrate(
    recording: &[Recorded],
    blocks: &[Block],
    skeleton: &Skeleton,
    offsets_m: &[Option<Vector3<f64>>; SEGMENTS],
) -> Result<Calibrated, CalibrationError> {
    let present = BodySegment::ALL.map(|segment| recording.iter().any(|(_, s)| s[segment.index()].is_some()));
    if !present.contains(&true) {
        return Err(CalibrationError::Empty);
    }
    let magnetic = BodySegment::ALL.iter().filter(|segment| present[segment.index()]).all(|segment| {
        recording.iter().any(|(_, samples)| samples[segment.index()].is_some_and(|s| s.mag.is_some()))
    });
    let alone = alone(recording, &present);
    let blocks = if blocks.is_empty() { &alone } else { blocks };
    let session = Session { recording, present, magnetic, tracks: tracks(recording, &present, magnetic) };

    let poses = |kind: BlockKind| -> Result<Vec<Held>, CalibrationError> {
        blocks.iter().filter(|block| block.kind == kind).map(|block| session.held(block)).collect()
    };
    let (standing, spread) = (poses(BlockKind::NPose)?, poses(BlockKind::TPose)?);
    if standing.is_empty() && spread.is_empty() {
        return Err(CalibrationError::NoPose);
    }
    let mut axes = Vec::new();
    for block in blocks {
        session.axes(block, &mut axes)?;
    }
    let facing = Facing { magnetic, standing: &standing, spread: &spread, axes: &axes };
    let mut out =
        Calibrated { mounts: [None; SEGMENTS], quality_deg: [None; SEGMENTS], warnings: Vec::new() };
    for segment in BodySegment::ALL.into_iter().filter(|segment| present[segment.index()]) {
        let index = segment.index();
        let yaw = facing.of(segment)?;
        let mut seen: Vec<SegmentAxis> = axes
            .iter()
            .filter(|axis| axis.segment == segment)
            .map(|axis| SegmentAxis {
                sensor: axis.sensor,
                segment: axis.in_segment,
                sigma_deg: axis.sigma_deg,
            })
            .collect();
        let reference = standing.first().or(spread.first());
        for (held, raised) in
            standing.iter().map(|held| (held, false)).chain(spread.iter().map(|h| (h, true)))
        {
            let Some(sensor) = held[index] else { continue };
            let turned = reference.map_or(0.0, |first| turned_between(first, held));
            let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw + turned);
            let body = heading * upright() * posture(segment, raised);
            for (direction, sigma_deg) in [(Vector3::z(), POSE_DEG), (heading * -Vector3::y(), FACING_DEG)] {
                seen.push(SegmentAxis {
                    sensor: sensor.inverse() * direction,
                    segment: body.inverse() * direction,
                    sigma_deg,
                });
            }
        }
        let (q_segment_sensor, rms_deg) = wahba(&seen);
        if rms_deg > REFUSE_DEG {
            return Err(CalibrationError::Disagree { segment: segment.name(), found_deg: rms_deg });
        }
        if rms_deg > REPEAT_DEG {
            out.warnings.push(format!(
                "{}: poses and movements disagree by {rms_deg:.1} degrees (limit {REPEAT_DEG:.0}): repeat them",
                segment.name()
            ));
        }
        out.quality_deg[index] = Some(rms_deg);
        out.mounts[index] = Some(SensorMount {
            q_segment_sensor,
            offset_m: offsets_m[index].unwrap_or_else(|| skeleton.usual_sensor_m(segment)),
            // The level frame is turned so that the body looks along the room's x where it was calibrated.
            heading_rad: (!magnetic).then_some(-yaw),
        });
    }
    Ok(out)
}

/// The blocks of a recording without any.
fn alone(recording: &[Recorded], present: &[bool; SEGMENTS]) -> Vec<Block> {
    let (Some((start_s, _)), Some((end_s, _))) = (recording.first(), recording.last()) else {
        return Vec::new();
    };
    let mut blocks = vec![Block { kind: BlockKind::NPose, start_s: *start_s, end_s: start_s + 1.0 }];
    for segment in [BodySegment::ForearmR, BodySegment::ForearmL, BodySegment::ShankR, BodySegment::ShankL] {
        let parent = segment.parent().map_or(0, BodySegment::index);
        if present[segment.index()] && present[parent] {
            blocks.push(Block {
                kind: BlockKind::Move(segment, Movement::Flexion),
                start_s: *start_s,
                end_s: *end_s,
            });
        }
    }
    blocks
}

/// The recording with every sensor's orientations.
struct Session<'a> {
    recording: &'a [Recorded],
    present: [bool; SEGMENTS],
    magnetic: bool,
    /// Sensor to its level frame, or to the room where all have magnetometers; empty for absent ones.
    tracks: [Vec<UnitQuaternion<f64>>; SEGMENTS],
}

/// Orientations of all sensors over the recording.
fn tracks(
    recording: &[Recorded],
    present: &[bool; SEGMENTS],
    magnetic: bool,
) -> [Vec<UnitQuaternion<f64>>; SEGMENTS] {
    BodySegment::ALL.map(|segment| {
        let index = segment.index();
        if !present[index] {
            return Vec::new();
        }
        let mut filter = Ahrs::new(Params::default());
        let mut last_s = None;
        let mut track = Vec::with_capacity(recording.len());
        for (t_s, samples) in recording {
            let dt_s = last_s.map_or(0.01, |last| t_s - last);
            last_s = Some(*t_s);
            match samples[index] {
                Some(sample) => {
                    _ = filter.push(&ImuSample { mag: sample.mag.filter(|_| magnetic), ..sample }, dt_s);
                }
                None => filter.coast(dt_s),
            }
            track.push(if magnetic { filter.orientation() } else { filter.orientation_6d() });
        }
        track
    })
}

impl Session<'_> {
    fn range(&self, block: &Block) -> std::ops::Range<usize> {
        let begin = self.recording.partition_point(|(t_s, _)| *t_s < block.start_s);
        let end = self.recording.partition_point(|(t_s, _)| *t_s <= block.end_s);
        begin..end
    }

    /// Mean orientations in a pose.
    fn held(&self, block: &Block) -> Result<Held, CalibrationError> {
        let range = self.range(block);
        let mut held: Held = [None; SEGMENTS];
        for segment in BodySegment::ALL.into_iter().filter(|segment| self.present[segment.index()]) {
            let index = segment.index();
            let wrong = |problem| CalibrationError::NotHeld {
                pose: block.kind.name(),
                start_s: block.start_s,
                end_s: block.end_s,
                segment: segment.name(),
                problem,
            };
            let gyros_rad_s: Vec<Vector3<f64>> = self.recording[range.clone()]
                .iter()
                .filter_map(|(_, samples)| samples[index].map(|sample| sample.gyro_rad_s))
                .filter(|w| w.iter().all(|value| value.is_finite()))
                .collect();
            if gyros_rad_s.len() < 10 {
                return Err(wrong("has no samples then"));
            }
            let mean = gyros_rad_s.iter().sum::<Vector3<f64>>() / gyros_rad_s.len() as f64;
            if mean.norm() > BIAS_RAD_S {
                return Err(wrong(
                    "turns by more than 2 degrees per second at rest: its gyro has a bias that no filter here corrects; run \
                     `posed imu calibrate` on the unit first",
                ));
            }
            let moved =
                gyros_rad_s.iter().map(|w| (w - mean).norm_squared()).sum::<f64>() / gyros_rad_s.len() as f64;
            if moved.sqrt() > HELD_RAD_S {
                return Err(wrong("moved: stand still and repeat it"));
            }
            let track = &self.tracks[index][range.clone()];
            held[index] = Some(mean_orientation(track));
        }
        Ok(held)
    }

    /// The axes that a movement shows, in the sensors on both sides of the joint.
    fn axes(&self, block: &Block, out: &mut Vec<Axis>) -> Result<(), CalibrationError> {
        let range = self.range(block);
        let failed = |reason| CalibrationError::Movement {
            movement: block.kind.name(),
            start_s: block.start_s,
            end_s: block.end_s,
            reason,
        };
        let (segment, movement) = match block.kind {
            BlockKind::NPose | BlockKind::TPose => return Ok(()),
            BlockKind::Bow => {
                for segment in [BodySegment::Torso, BodySegment::Pelvis] {
                    if self.present[segment.index()] {
                        let sensor =
                            main_axis(&self.tracks[segment.index()][range.clone()]).map_err(failed)?;
                        out.push(Axis { segment, sensor, in_segment: -Vector3::z(), sigma_deg: BALL_DEG });
                    }
                }
                return Ok(());
            }
            BlockKind::TrunkRotation => {
                if self.present[BodySegment::Torso.index()] {
                    let sensor =
                        main_axis(&self.tracks[BodySegment::Torso.index()][range]).map_err(failed)?;
                    let (segment, in_segment) = (BodySegment::Torso, Vector3::y());
                    out.push(Axis { segment, sensor, in_segment, sigma_deg: BALL_DEG });
                }
                return Ok(());
            }
            BlockKind::Move(segment, movement) => (segment, movement),
        };
        let Some(parent) = segment.parent() else { return Ok(()) };
        if !self.present[segment.index()] {
            return Ok(());
        }
        let side = segment.side();
        let hinge = matches!(
            segment,
            BodySegment::ForearmR | BodySegment::ForearmL | BodySegment::ShankR | BodySegment::ShankL
        );
        let (in_segment, both) = match movement {
            Movement::Flexion if matches!(segment, BodySegment::ShankR | BodySegment::ShankL) => {
                (-Vector3::z(), true)
            }
            Movement::Flexion => (Vector3::z(), true),
            Movement::Abduction => (-Vector3::x() * side, true),
            // The axis goes with the segment: the one above sees it wherever the segment points.
            Movement::Rotation | Movement::Pronation => (Vector3::y() * side, false),
        };
        let sigma_deg = if hinge && both { HINGE_DEG } else { BALL_DEG };
        let axes = if self.present[parent.index()] {
            self.pair(parent, segment, range).map_err(failed)?
        } else {
            [None, Some(main_axis(&self.tracks[segment.index()][range]).map_err(failed)?)]
        };
        let [above, below] = axes;
        if let Some(sensor) = above.filter(|_| both) {
            out.push(Axis { segment: parent, sensor, in_segment, sigma_deg });
        }
        if let Some(sensor) = below {
            out.push(Axis { segment, sensor, in_segment, sigma_deg });
        }
        Ok(())
    }

    /// The axis between two sensors, positive for the way that the movement begins.
    fn pair(
        &self,
        parent: BodySegment,
        segment: BodySegment,
        range: std::ops::Range<usize>,
    ) -> Result<[Option<Vector3<f64>>; 2], Refused> {
        let (a, b) = (parent.index(), segment.index());
        let samples: Vec<_> = self.recording[range.clone()]
            .iter()
            .filter_map(|(_, samples)| {
                let (a, b) = (samples[a]?, samples[b]?);
                Some(([a.gyro_rad_s, b.gyro_rad_s], [a.accel_m_s2, b.accel_m_s2]))
            })
            .filter(|(w, a)| w.iter().chain(a).all(|v| v.iter().all(|v| v.is_finite())))
            .collect();
        let (before, behind) = (&self.tracks[a][range.clone()], &self.tracks[b][range.clone()]);
        // Headings of their own tie the two together only as far as both turn: above a parent that stands still, the joint shows
        // its axis in the sensor below alone.
        if !self.magnetic && turned_rad(before) < PARENT_ROTATES_RAD {
            return main_axis(behind).map(|axis| [None, Some(axis)]);
        }
        let steps_s: Vec<f64> = range
            .clone()
            .map(|k| if k == 0 { 0.01 } else { self.recording[k].0 - self.recording[k - 1].0 })
            .collect();
        let rough = match hinge_axes(&samples) {
            Ok(axes) if !self.magnetic => Some(axes),
            Ok(_) | Err(Refused::Excitation { .. }) => None,
            Err(refused) => return Err(refused),
        };
        let [first, second] = match rough {
            Some(axes) => chain::refined_axes(&axes, before, behind, &steps_s),
            None => relative_axis(before, behind)?,
        };
        // The way the movement begins: the mean rotation from the posture at its start.
        let start = before[0].inverse() * behind[0];
        let mean: Vector3<f64> = before
            .iter()
            .zip(behind)
            .map(|(a, b)| so3::log(&(start.inverse() * (a.inverse() * b))))
            .sum::<Vector3<f64>>();
        let sign = mean.dot(&second).signum();
        Ok([Some(first * sign), Some(second * sign)])
    }
}

/// How far a sensor turned from where it began, root mean square, rad.
fn turned_rad(track: &[UnitQuaternion<f64>]) -> f64 {
    let Some(start) = track.first() else { return 0.0 };
    let squares: f64 = track.iter().map(|q| start.angle_to(q).powi(2)).sum();
    (squares / track.len() as f64).sqrt()
}

/// The axis about which a sensor mainly turned, its axes, positive for the way that the movement begins.
fn main_axis(track: &[UnitQuaternion<f64>]) -> Result<Vector3<f64>, Refused> {
    let still = vec![UnitQuaternion::identity(); track.len()];
    relative_axis(&still, track).map(|[_, second]| second)
}

/// The axis about which the second of two sensors mainly turned against the first, in the axes of both: the plane of the
/// relative rotations' vectors is narrow, and their long axis is it.
fn relative_axis(
    before: &[UnitQuaternion<f64>],
    behind: &[UnitQuaternion<f64>],
) -> Result<[Vector3<f64>; 2], Refused> {
    let relative: Vec<_> = before.iter().zip(behind).map(|(a, b)| a.inverse() * b).collect();
    let Some(start) = relative.first() else { return Err(Refused::TooShort { found: 0, needed: 50 }) };
    let mut spread = Matrix3::zeros();
    let mut mean = Vector3::zeros();
    for q in &relative {
        let rotation_vector_rad = so3::log(&(start.inverse() * q));
        spread += rotation_vector_rad * rotation_vector_rad.transpose();
        mean += rotation_vector_rad;
    }
    let n = relative.len() as f64;
    spread /= n;
    let eigen = spread.symmetric_eigen();
    let largest = eigen.eigenvalues.imax();
    let axis: Vector3<f64> = eigen.eigenvectors.column(largest).into();
    // A rotation of at least 12 degrees, root mean square, and nearly all of it about one axis.
    let needed = 12_f64.to_radians().powi(2);
    if eigen.eigenvalues[largest].is_nan() || eigen.eigenvalues[largest] < needed {
        return Err(Refused::Excitation { found: eigen.eigenvalues[largest], needed });
    }
    let axis = axis * axis.dot(&mean).signum();
    Ok([start * axis, axis])
}

/// Which way the body faces.
struct Facing<'a> {
    magnetic: bool,
    standing: &'a [Held],
    spread: &'a [Held],
    axes: &'a [Axis],
}

impl Facing<'_> {
    /// Turn of the body about the vertical in a segment's room or level frame, rad.
    fn of(&self, segment: BodySegment) -> Result<f64, CalibrationError> {
        let mut sum = Vector3::zeros();
        for axis in self.axes.iter().filter(|axis| self.magnetic || axis.segment == segment) {
            let Some(sensor) =
                self.standing.first().or(self.spread.first()).and_then(|h| h[axis.segment.index()])
            else {
                continue;
            };
            let raised = self.standing.is_empty();
            // Forward is where the axis would point if the body looked along the room's x, turned with it.
            let nominal = upright() * posture(axis.segment, raised) * axis.in_segment;
            sum += forward(&(sensor * axis.sensor), &nominal) / axis.sigma_deg;
        }
        // From the N-pose to the T-pose an arm turns about the way the body faces.
        if let (Some(low), Some(high)) = (self.standing.first(), self.spread.first()) {
            let arms = [
                BodySegment::UpperArmR,
                BodySegment::ForearmR,
                BodySegment::UpperArmL,
                BodySegment::ForearmL,
            ];
            for arm in arms.into_iter().filter(|arm| self.magnetic || *arm == segment) {
                let (Some(low), Some(high)) = (low[arm.index()], high[arm.index()]) else { continue };
                let rotation_vector_rad = so3::log(&(high * low.inverse()));
                if rotation_vector_rad.norm() > 0.8 {
                    sum +=
                        forward(&(rotation_vector_rad.normalize() * -arm.side()), &Vector3::x()) / FACING_DEG;
                }
            }
        }
        if sum.norm() < 1e-6 {
            return Err(self.missing(segment));
        }
        Ok(libm::atan2(sum.y, sum.x))
    }

    fn missing(&self, segment: BodySegment) -> CalibrationError {
        if self.magnetic {
            let fix = "a `t_pose`, or a movement such as `elbow_flexion_r` or `knee_flexion_r`";
            return CalibrationError::Facing { of: "the body", fix };
        }
        let fix = match segment {
            BodySegment::Torso | BodySegment::Pelvis => {
                "a `bow` (without magnetometers each sensor needs a movement)"
            }
            BodySegment::UpperArmR | BodySegment::ForearmR => "a `t_pose` or `elbow_flexion_r`",
            BodySegment::UpperArmL | BodySegment::ForearmL => "a `t_pose` or `elbow_flexion_l`",
            BodySegment::ThighR => "`hip_flexion_r`",
            BodySegment::ThighL => "`hip_flexion_l`",
            BodySegment::ShankR => "`knee_flexion_r`",
            BodySegment::ShankL => "`knee_flexion_l`",
        };
        CalibrationError::Facing { of: segment.name(), fix }
    }
}

/// The body's forward direction, level, from a direction that was `seen` where `nominal` is that of a body which looks along x;
/// short where the direction is steep.
fn forward(seen: &Vector3<f64>, nominal: &Vector3<f64>) -> Vector3<f64> {
    let (s, n) = (Vector3::new(seen.x, seen.y, 0.0), Vector3::new(nominal.x, nominal.y, 0.0));
    Vector3::new(s.dot(&n), n.x * s.y - n.y * s.x, 0.0)
}

/// A segment's rotation in a pose against the N-pose.
fn posture(segment: BodySegment, raised: bool) -> UnitQuaternion<f64> {
    let quarter = std::f64::consts::FRAC_PI_2;
    match segment {
        BodySegment::UpperArmR | BodySegment::ForearmR if raised => {
            joint_rotation(BodySegment::UpperArmR, &[0.0, quarter, 0.0])
        }
        BodySegment::UpperArmL | BodySegment::ForearmL if raised => {
            joint_rotation(BodySegment::UpperArmL, &[0.0, quarter, 0.0])
        }
        _ => UnitQuaternion::identity(),
    }
}

/// By how much the body turned about the vertical from one pose to another, as the trunk and legs show it, rad.
fn turned_between(first: &Held, second: &Held) -> f64 {
    let still = [
        BodySegment::Torso,
        BodySegment::Pelvis,
        BodySegment::ThighR,
        BodySegment::ThighL,
        BodySegment::ShankR,
        BodySegment::ShankL,
    ];
    still
        .into_iter()
        .find_map(|segment| {
            let (a, b) = (first[segment.index()]?, second[segment.index()]?);
            Some(yaw_from_upright(&(b * a.inverse() * upright())))
        })
        .unwrap_or(0.0)
}

fn mean_orientation(track: &[UnitQuaternion<f64>]) -> UnitQuaternion<f64> {
    let first = track.first().copied().unwrap_or_else(UnitQuaternion::identity);
    let sum: Vector3<f64> = track.iter().map(|q| so3::log(&(first.inverse() * q))).sum();
    first * so3::exp(&(sum / track.len().max(1) as f64))
}

/// The rotation from sensor to segment that fits all directions best, and the weighted root mean square of what is left,
/// degrees.
fn wahba(seen: &[SegmentAxis]) -> (UnitQuaternion<f64>, f64) {
    let profile = seen
        .iter()
        .map(|seen| seen.segment * seen.sensor.transpose() / seen.sigma_deg.powi(2))
        .sum::<Matrix3<f64>>();
    let svd = profile.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return (UnitQuaternion::identity(), 180.0) };
    let sign = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
    let q = UnitQuaternion::from_matrix(&(u * Matrix3::from_diagonal(&sign) * v_t));
    let weights: f64 = seen.iter().map(|seen| seen.sigma_deg.powi(-2)).sum();
    let squares: f64 = seen
        .iter()
        .map(|seen| (q * seen.sensor).angle(&seen.segment).to_degrees().powi(2) / seen.sigma_deg.powi(2))
        .sum();
    (q, (squares / weights).sqrt())
}
