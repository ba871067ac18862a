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

mod contradiction;
mod facing;
mod session;
mod strides;
#[cfg(test)]
mod tests;
mod walk;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use self::contradiction::Contradiction;
pub(super) use self::facing::posture;
use self::facing::{FACING_DEG, Facing, turned_between};
pub(super) use self::session::Tracks;
use self::session::{Seen, Session};
use super::SensorMount;
use super::block::{Block, BlockKind, Movement, Recorded};
use super::skeleton::{BodySegment, SEGMENTS, Skeleton, upright};
use crate::mounting::Refused;

/// Above this disagreement of its directions, degrees, a warning asks for the mounting to be repeated; above 15 it is
/// refused.
pub const REPEAT_DEG: f64 = 5.0;
/// And by more than this it is refused, degrees.
const REFUSE_DEG: f64 = 15.0;
/// The height of somebody of whom none is known, m.
const USUAL_M: f64 = 1.7;
/// How well people hold what they are asked to, degrees.
const POSE_DEG: f64 = 3.0;

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
    /// No pose shows which way is up in the segments, or none does in the shoulders.
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
    /// Something else was held or done than was asked for.
    #[error(transparent)]
    Contradicted(#[from] Contradiction),
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

impl CalibrationError {
    /// A movement does not show its axis, for this reason.
    fn movement(block: &Block, reason: Refused) -> Self {
        Self::Movement { movement: block.kind.name(), start_s: block.start_s, end_s: block.end_s, reason }
    }
}

/// A direction seen in a sensor and known in its segment.
struct SegmentAxis {
    sensor: Vector3<f64>,
    segment: Vector3<f64>,
    sigma_deg: f64,
}

/// Finds the sensor-to-segment alignments. `offsets_m` states where sensors sit, segment frame, m, by [`BodySegment::index`],
/// where that is known; without a block, the first second counts as an N-pose and the whole recording as bending of elbows
/// and knees, or where somebody moves in it, the whole recording as a walk. A walk counts where no pose was held: what it shows is good to some degrees. Magnetometers count where all sensors have one. Offline; Wahba's problem with the weights of
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
    let tracks = Tracks::of(recording);
    let session = Session::new(recording, &tracks)?;
    let alone = alone(recording, &session.present);
    let posed = blocks.iter().any(|block| matches!(block.kind, BlockKind::NPose | BlockKind::TPose));
    let walk = blocks.iter().find(|block| block.kind == BlockKind::Walk);
    if let Some(walk) = walk.filter(|_| !posed) {
        return walk::calibrate(&session, walk, skeleton, offsets_m);
    }
    if blocks.is_empty()
        && let Err(CalibrationError::NotHeld { .. }) = session.seen(&alone[..1])
        && let [_, whole, ..] = alone.as_slice()
        && let Ok(found) =
            walk::calibrate(&session, &Block { kind: BlockKind::Walk, ..*whole }, skeleton, offsets_m)
    {
        return Ok(found);
    }
    let seen = session.seen(if blocks.is_empty() { &alone } else { blocks })?;
    if seen.standing.is_empty() && seen.spread.is_empty() {
        return Err(CalibrationError::NoPose);
    }
    if !blocks.is_empty() {
        contradiction::check(&session, &seen)?;
    }
    let Session { present, magnetic, .. } = session;
    let facing = Facing { magnetic, seen: &seen };
    let mut out =
        Calibrated { mounts: [None; SEGMENTS], quality_deg: [None; SEGMENTS], warnings: Vec::new() };
    for segment in BodySegment::ALL.into_iter().filter(|segment| present[segment.index()]) {
        let index = segment.index();
        let yaw = facing.of(segment)?;
        let mut directions: Vec<SegmentAxis> = seen
            .axes
            .iter()
            .filter(|axis| axis.segment == segment)
            .map(|axis| SegmentAxis {
                sensor: axis.sensor,
                segment: axis.in_segment,
                sigma_deg: axis.sigma_deg,
            })
            .collect();
        if seen.poses(segment).next().is_none() {
            return Err(CalibrationError::NoPose);
        }
        for (block, held) in seen.poses(segment) {
            let Some(sensor) = held[index] else { continue };
            let raised = block.kind == BlockKind::TPose;
            let turned = seen.reference().map_or(0.0, |first| turned_between(first, held));
            let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw + turned);
            let body = heading * upright() * posture(segment, raised);
            for (direction, sigma_deg) in [(Vector3::z(), POSE_DEG), (heading * -Vector3::y(), FACING_DEG)] {
                directions.push(SegmentAxis {
                    sensor: sensor.inverse() * direction,
                    segment: body.inverse() * direction,
                    sigma_deg,
                });
            }
        }
        let (q_segment_sensor, rms_deg) = wahba(&directions);
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
        let sigma_rad = self::sigma_rad(&seen, segment, yaw, rms_deg);
        out.mounts[index] = Some(SensorMount {
            q_segment_sensor,
            sigma_rad,
            offset_m: offsets_m[index].unwrap_or_else(|| skeleton.usual_sensor_m(segment)),
            // The level frame is turned so that the body looks along the room's x where it was calibrated.
            heading_rad: (!magnetic).then_some(-yaw),
        });
    }
    Ok(out)
}

/// What contradicts that these poses and movements were done as their names say, as far as doing them once more may help; where it
/// is not `assigned` which sensor sits where, only what needs no segment is looked at.
pub(super) fn objection_to(
    recording: &[Recorded],
    tracks: &Tracks,
    blocks: &[Block],
    assigned: bool,
) -> Option<CalibrationError> {
    let objection = || {
        let session = Session::new(recording, tracks)?;
        if let Some(block) = blocks.iter().find(|block| block.kind == BlockKind::Walk) {
            // Lengths are of no matter for which way somebody goes.
            return walk::check(&session, block, &Skeleton::from_height(USUAL_M));
        }
        if !assigned {
            let is_pose = |block: &&Block| matches!(block.kind, BlockKind::NPose | BlockKind::TPose);
            let seen = session.seen(&blocks.iter().filter(is_pose).copied().collect::<Vec<_>>())?;
            contradiction::lowered(&session, &seen)?;
            return Ok(contradiction::hangs_again(&seen)?);
        }
        let seen = session.seen(blocks)?;
        Ok(contradiction::check(&session, &seen)?)
    };
    let may_help = |error: &CalibrationError| {
        matches!(error, CalibrationError::Contradicted(_) | CalibrationError::Movement { .. })
    };
    objection().err().filter(may_help)
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

/// How well a mounting is known, about the segment's axes, rad: by the directions that its poses and movements show, each as well as people hold and do what
/// they are asked to. Who stands twice stands wrong in the same way twice, so that a kind of pose counts once; and all of them face as the body was
/// found to. Where they disagree by more than that, so much worse.
fn sigma_rad(seen: &Seen, segment: BodySegment, yaw_rad: f64, rms_deg: f64) -> Vector3<f64> {
    let mut directions: Vec<(Vector3<f64>, f64)> = seen
        .axes
        .iter()
        .filter(|axis| axis.segment == segment)
        .map(|axis| (axis.in_segment, axis.sigma_deg))
        .collect();
    let held = |kind: BlockKind| {
        seen.poses(segment).any(|(block, held)| block.kind == kind && held[segment.index()].is_some())
    };
    for raised in [false, true] {
        if held(if raised { BlockKind::TPose } else { BlockKind::NPose }) {
            let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
            let body = heading * upright() * posture(segment, raised);
            directions.push((body.inverse() * Vector3::z(), POSE_DEG));
            // The facing is one number, however often it was looked at.
            if !raised || !held(BlockKind::NPose) {
                directions.push((body.inverse() * (heading * -Vector3::y()), FACING_DEG));
            }
        }
    }
    let across = |direction: &Vector3<f64>, sigma_deg: f64| {
        (Matrix3::identity() - direction * direction.transpose()) / sigma_deg.to_radians().powi(2)
    };
    let information: Matrix3<f64> =
        directions.iter().map(|(direction, sigma)| across(direction, *sigma)).sum();
    let weight: f64 = directions.iter().map(|(_, sigma_deg)| sigma_deg.powi(-2)).sum();
    let expected_deg = (directions.len() as f64 / weight).sqrt();
    let unknown = Matrix3::identity() * std::f64::consts::PI.powi(2);
    let covariance = information.try_inverse().unwrap_or(unknown);
    covariance.diagonal().map(|variance| variance.sqrt() * (rms_deg / expected_deg).max(1.0))
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
