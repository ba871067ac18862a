//! What a calibration's recording shows by itself: how each sensor was turned in every pose, and the axes of every movement.
//!
//! In: the recording of a whole body, and when which pose or movement was held. Out: directions in the sensors' own axes, or why
//! a pose or movement does not show them. It knows nothing of how a sensor sits.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::super::BodySamples;
use super::super::block::{Block, BlockKind, Movement, Recorded};
use super::super::skeleton::{BodySegment, SEGMENTS, upright};
use super::CalibrationError;
use super::facing::{Faced, faced, forward, posture};
use crate::ahrs::{Ahrs, ImuSample, Params};
use crate::chain;
use crate::mounting::{Refused, hinge_axes};
use posed_geometry::so3;

/// A pose in which a sensor turns faster than this, root mean square about its mean, was not held, rad/s.
const HELD_RAD_S: f64 = 0.2;
/// A gyro that says more than this in a pose that is held has a bias, rad/s: nobody turns so on the spot for seconds.
const BIAS_RAD_S: f64 = 0.035;
/// How far the segment above a joint must turn meanwhile, root mean square, to show the axis without a magnetometer, rad.
const PARENT_ROTATES_RAD: f64 = 0.35;
/// How far a segment must turn in a movement to show its axis, root mean square, rad: 12 degrees, and half of it for head, hands, feet and shoulders, which turn less far.
const TURNS_RAD: f64 = 12_f64.to_radians();
const LEAF_TURNS_RAD: f64 = 0.1;
/// A movement of which less went one way does not show which way its axis points.
pub(super) const ONE_WAY: f64 = 0.3;
/// An axis whose vertical part is longer in the pose points up or down.
const STEEP: f64 = 0.7;
/// How well people move about one axis, degrees: about a hinge, and any other.
const HINGE_DEG: f64 = 2.0;
const BALL_DEG: f64 = 6.0;

/// A movement's axis, as a sensor saw it.
pub(super) struct Axis {
    pub(super) block: Block,
    pub(super) segment: BodySegment,
    pub(super) sensor: Vector3<f64>,
    /// How much of the movement went one way, 0 to 1: what goes both ways alike does not show which way the axis points.
    pub(super) one_way: f64,
    pub(super) in_segment: Vector3<f64>,
    pub(super) sigma_deg: f64,
}

/// A pose as the sensors held it: their mean orientations, level frame or room, by [`BodySegment::index`].
pub(super) type Held = [Option<UnitQuaternion<f64>>; SEGMENTS];

/// What all poses and movements show, in their order.
pub(super) struct Seen {
    pub(super) standing: Vec<(Block, Held)>,
    pub(super) spread: Vec<(Block, Held)>,
    pub(super) axes: Vec<Axis>,
}

impl Seen {
    /// The first N-pose.
    pub(super) fn low(&self) -> Option<&Held> {
        self.standing.first().map(|(_, held)| held)
    }

    /// The first T-pose.
    pub(super) fn high(&self) -> Option<&Held> {
        self.spread.first().map(|(_, held)| held)
    }

    /// Poses that show how the sensor on a segment sits: shoulders rise with the arms, and further in one person than in another, so that a T-pose does not show theirs.
    pub(super) fn poses(&self, segment: BodySegment) -> impl Iterator<Item = &(Block, Held)> {
        let spread = if BodySegment::SHOULDERS.contains(&segment) { &[] } else { self.spread.as_slice() };
        self.standing.iter().chain(spread)
    }

    /// Axes of movements that went both ways alike point as the poses show it: a steep one by gravity, a level one by which way the body faces.
    fn point_axes(&mut self, magnetic: bool) {
        let open = |axis: &Axis| axis.one_way < ONE_WAY;
        let known: Vec<Faced> = faced(self).filter(|faced| !faced.open).collect();
        let Some(reference) = self.reference().copied() else { return };
        let raised = self.low().is_none();
        for axis in self.axes.iter_mut().filter(|axis| open(axis)) {
            let Some(held) = reference[axis.segment.index()] else { continue };
            let (seen, nominal) =
                (held * axis.sensor, upright() * posture(axis.segment, raised) * axis.in_segment);
            let facing: Vector3<f64> = known
                .iter()
                .filter(|faced| magnetic || faced.segment == axis.segment)
                .map(|faced| faced.forward / faced.sigma_deg)
                .sum();
            let agrees = if nominal.z.abs() > STEEP {
                seen.z * nominal.z
            } else {
                forward(&seen, &nominal).dot(&facing)
            };
            if agrees < 0.0 {
                axis.sensor = -axis.sensor;
            }
        }
    }

    /// The pose that all else is held against: the first N-pose, or the first T-pose where none was held.
    pub(super) fn reference(&self) -> Option<&Held> {
        self.low().or(self.high())
    }
}

/// The axis of a joint in the sensor above and in the one below it, where they show it; and how much of the movement went one way.
type PairAxes = ([Option<Vector3<f64>>; 2], f64);

/// Orientations of all sensors over a recording, as it comes.
#[derive(Clone, Debug)]
pub(in super::super) struct Tracks {
    /// Whether magnetometers count.
    magnetic: bool,
    /// `None` where there is no sensor.
    filters: [Option<Ahrs>; SEGMENTS],
    last_s: Option<f64>,
    /// Of which sensors samples came, and samples of a magnetometer.
    seen: [bool; SEGMENTS],
    seen_field: [bool; SEGMENTS],
    /// Sensor to its level frame, or to the room where magnetometers count; empty for absent ones.
    orientations: [Vec<UnitQuaternion<f64>>; SEGMENTS],
}

impl Tracks {
    pub(in super::super) fn new(present: &[bool; SEGMENTS], magnetic: bool) -> Self {
        let filters = present.map(|present| present.then(|| Ahrs::new(Params::instantaneous())));
        let orientations = std::array::from_fn(|_| Vec::new());
        let (seen, seen_field) = ([false; SEGMENTS], [false; SEGMENTS]);
        Self { magnetic, filters, last_s: None, seen, seen_field, orientations }
    }

    /// Of a whole recording; magnetometers count where all sensors have one.
    pub(in super::super) fn of(recording: &[Recorded]) -> Self {
        let any = |of: fn(&ImuSample) -> bool| {
            std::array::from_fn(|index| recording.iter().any(|(_, s)| s[index].as_ref().is_some_and(of)))
        };
        let (seen, seen_field): ([bool; SEGMENTS], _) = (any(|_| true), any(|sample| sample.mag.is_some()));
        let mut tracks = Self::new(&seen, seen == seen_field);
        recording.iter().for_each(|(t_s, samples)| tracks.push(*t_s, samples));
        tracks
    }

    pub(in super::super) fn push(&mut self, t_s: f64, samples: &BodySamples) {
        let dt_s = self.last_s.map_or(0.01, |last_s| t_s - last_s);
        self.last_s = Some(t_s);
        for (index, sample) in samples.iter().enumerate() {
            let Some(filter) = &mut self.filters[index] else { continue };
            match sample {
                Some(sample) => {
                    self.seen[index] = true;
                    self.seen_field[index] |= sample.mag.is_some();
                    _ = filter
                        .push(&ImuSample { mag: sample.mag.filter(|_| self.magnetic), ..*sample }, dt_s);
                }
                None => filter.coast(dt_s),
            }
            let q = if self.magnetic { filter.orientation() } else { filter.orientation_6d() };
            self.orientations[index].push(q);
        }
    }

    /// Whether magnetometers came of all sensors, or not, as was expected of them.
    pub(in super::super) fn are_as_expected(&self) -> bool {
        self.magnetic == (self.seen == self.seen_field)
    }
}

/// The recording with every sensor's orientations.
pub(super) struct Session<'a> {
    pub(super) recording: &'a [Recorded],
    pub(super) present: [bool; SEGMENTS],
    /// Whether all have magnetometers.
    pub(super) magnetic: bool,
    /// As in [`Tracks`].
    pub(super) tracks: &'a [Vec<UnitQuaternion<f64>>; SEGMENTS],
}

impl<'a> Session<'a> {
    /// Of a recording and its tracks.
    ///
    /// # Errors
    /// [`CalibrationError::Empty`] where no sensor has a sample.
    pub(super) fn new(recording: &'a [Recorded], tracks: &'a Tracks) -> Result<Self, CalibrationError> {
        if !tracks.seen.contains(&true) {
            return Err(CalibrationError::Empty);
        }
        Ok(Self { recording, present: tracks.seen, magnetic: tracks.magnetic, tracks: &tracks.orientations })
    }

    /// What these poses and movements show.
    pub(super) fn seen(&self, blocks: &[Block]) -> Result<Seen, CalibrationError> {
        let poses = |kind: BlockKind| -> Result<Vec<(Block, Held)>, CalibrationError> {
            let held = |block: &Block| Ok((*block, self.held(block)?));
            blocks.iter().filter(|block| block.kind == kind).map(held).collect()
        };
        let (standing, spread) = (poses(BlockKind::NPose)?, poses(BlockKind::TPose)?);
        let mut axes = Vec::new();
        let low = standing.first().map(|(_, held)| held);
        for block in blocks {
            self.axes(block, low, &mut axes)?;
        }
        let mut seen = Seen { standing, spread, axes };
        seen.point_axes(self.magnetic);
        Ok(seen)
    }

    /// The samples of a span.
    pub(super) fn range(&self, block: &Block) -> std::ops::Range<usize> {
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
            held[index] = Some(so3::mean(track));
        }
        Ok(held)
    }

    /// The axes that a movement shows, in the sensors on both sides of the joint.
    fn axes(&self, block: &Block, low: Option<&Held>, out: &mut Vec<Axis>) -> Result<(), CalibrationError> {
        let range = self.range(block);
        let failed = |reason| CalibrationError::movement(block, reason);
        let (segment, movement) = match block.kind {
            BlockKind::NPose | BlockKind::TPose | BlockKind::Walk => return Ok(()),
            BlockKind::Bow => {
                // Shoulders go with the trunk.
                let [right, left] = BodySegment::SHOULDERS;
                for segment in [BodySegment::Torso, BodySegment::Pelvis, right, left] {
                    if self.present[segment.index()] {
                        let (sensor, one_way) =
                            self.main_axis(segment, low, range.clone(), TURNS_RAD).map_err(failed)?;
                        let in_segment = -Vector3::z();
                        out.push(Axis {
                            block: *block,
                            segment,
                            sensor,
                            one_way,
                            in_segment,
                            sigma_deg: BALL_DEG,
                        });
                    }
                }
                return Ok(());
            }
            BlockKind::TrunkRotation => {
                let [right, left] = BodySegment::SHOULDERS;
                for segment in [BodySegment::Torso, right, left] {
                    if self.present[segment.index()] {
                        let (sensor, one_way) =
                            self.main_axis(segment, low, range.clone(), TURNS_RAD).map_err(failed)?;
                        let (in_segment, sigma_deg) = (Vector3::y(), BALL_DEG);
                        out.push(Axis { block: *block, segment, sensor, one_way, in_segment, sigma_deg });
                    }
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
        if BodySegment::LEAVES.contains(&segment) {
            // What it shows of the segment above, that one's own movements show better.
            let (sensor, one_way) = self.main_axis(segment, low, range, LEAF_TURNS_RAD).map_err(failed)?;
            let in_segment = match segment {
                BodySegment::Head => -Vector3::z(),
                BodySegment::HandR | BodySegment::HandL => Vector3::x() * side,
                BodySegment::ShoulderR | BodySegment::ShoulderL => -Vector3::x() * side,
                _ => Vector3::z(),
            };
            out.push(Axis { block: *block, segment, sensor, one_way, in_segment, sigma_deg: BALL_DEG });
            return Ok(());
        }
        let hinge = matches!(
            segment,
            BodySegment::ForearmR | BodySegment::ForearmL | BodySegment::ShankR | BodySegment::ShankL
        );
        let (in_segment, both) = match movement {
            Movement::Flexion if matches!(segment, BodySegment::ShankR | BodySegment::ShankL) => {
                (-Vector3::z(), true)
            }
            Movement::Flexion => (Vector3::z(), true),
            Movement::Abduction | Movement::Elevation => (-Vector3::x() * side, true),
            // The axis goes with the segment: the one above sees it wherever the segment points.
            Movement::Rotation | Movement::Pronation => (Vector3::y() * side, false),
        };
        let sigma_deg = if hinge && both { HINGE_DEG } else { BALL_DEG };
        let ([above, below], one_way) = if self.present[parent.index()] {
            self.pair(parent, segment, low, range).map_err(failed)?
        } else {
            let (below, one_way) = self.main_axis(segment, low, range, TURNS_RAD).map_err(failed)?;
            ([None, Some(below)], one_way)
        };
        if let Some(sensor) = above.filter(|_| both) {
            out.push(Axis { block: *block, segment: parent, sensor, one_way, in_segment, sigma_deg });
        }
        if let Some(sensor) = below {
            out.push(Axis { block: *block, segment, sensor, one_way, in_segment, sigma_deg });
        }
        Ok(())
    }

    /// The axis about which a sensor mainly turned, its axes, positive for the way that it went from the N-pose, or from where it began; and how much of it went
    /// that way.
    fn main_axis(
        &self,
        segment: BodySegment,
        low: Option<&Held>,
        range: std::ops::Range<usize>,
        needed_rad: f64,
    ) -> Result<(Vector3<f64>, f64), Refused> {
        let track = &self.tracks[segment.index()][range];
        let still = vec![UnitQuaternion::identity(); track.len()];
        let [_, axis] = relative_axis(&still, track, needed_rad)?;
        let Some(held) = low.and_then(|low| low[segment.index()]) else {
            return Ok(pointed(axis, &still, track, &track[0]));
        };
        // By gravity alone: the person may face another way by now.
        let up = |q: &UnitQuaternion<f64>| q.inverse() * Vector3::z();
        let went = |q: &UnitQuaternion<f64>| up(q).cross(&up(&held)).dot(&axis);
        let (sign, one_way) = one_way(track.iter().map(went), needed_rad);
        Ok((axis * sign, one_way))
    }

    /// The axis between two sensors, positive for the way that the movement went from the N-pose, or from where it began; and how much of it went that way.
    pub(super) fn pair(
        &self,
        parent: BodySegment,
        segment: BodySegment,
        low: Option<&Held>,
        range: std::ops::Range<usize>,
    ) -> Result<PairAxes, Refused> {
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
            let (axis, one_way) = self.main_axis(segment, low, range, TURNS_RAD)?;
            return Ok(([None, Some(axis)], one_way));
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
            None => relative_axis(before, behind, TURNS_RAD)?,
        };
        // From the pose; headings of their own have drifted apart since, so that without a field the posture at the start has to do.
        let held = low.filter(|_| self.magnetic).and_then(|low| Some(low[a]?.inverse() * low[b]?));
        let start = held.unwrap_or_else(|| before[0].inverse() * behind[0]);
        let (second_pointed, one_way) = pointed(second, before, behind, &start);
        let sign = second_pointed.dot(&second).signum();
        Ok(([Some(first * sign), Some(second_pointed)], one_way))
    }
}

/// An axis of the second of two sensors, positive for the way that it went from `start` (its rotation against the first one there); and how much of it went that way.
fn pointed(
    axis: Vector3<f64>,
    before: &[UnitQuaternion<f64>],
    behind: &[UnitQuaternion<f64>],
    start: &UnitQuaternion<f64>,
) -> (Vector3<f64>, f64) {
    let went = before.iter().zip(behind).map(|(a, b)| so3::log(&(start.inverse() * (a.inverse() * b))));
    let (sign, one_way) = one_way(went.map(|rotation_vector_rad| rotation_vector_rad.dot(&axis)), 0.0);
    (axis * sign, one_way)
}

/// Which way angles went about an axis, 1 or -1, and how much of that went this way, 0 to 1; angles as small as `least_rad` say less.
fn one_way(angles_rad: impl Iterator<Item = f64>, least_rad: f64) -> (f64, f64) {
    let (mut sum, mut squares, mut count) = (0.0_f64, 0.0, 0.0);
    for angle_rad in angles_rad {
        sum += angle_rad;
        squares += angle_rad * angle_rad;
        count += 1.0;
    }
    let most: f64 = (squares * count).sqrt().max(least_rad * count).max(f64::MIN_POSITIVE);
    (sum.signum(), sum.abs() / most)
}

/// How far a sensor turned from where it began, root mean square, rad.
fn turned_rad(track: &[UnitQuaternion<f64>]) -> f64 {
    let Some(start) = track.first() else { return 0.0 };
    let squares: f64 = track.iter().map(|q| start.angle_to(q).powi(2)).sum();
    (squares / track.len() as f64).sqrt()
}

/// The axis about which the second of two sensors mainly turned against the first, in the axes of both: the plane of the
/// relative rotations' vectors is narrow, and their long axis is it.
fn relative_axis(
    before: &[UnitQuaternion<f64>],
    behind: &[UnitQuaternion<f64>],
    needed_rad: f64,
) -> Result<[Vector3<f64>; 2], Refused> {
    let relative: Vec<_> = before.iter().zip(behind).map(|(a, b)| a.inverse() * b).collect();
    let Some(start) = relative.first() else { return Err(Refused::TooShort { found: 0, needed: 50 }) };
    let mut spread = Matrix3::zeros();
    for q in &relative {
        let rotation_vector_rad = so3::log(&(start.inverse() * q));
        spread += rotation_vector_rad * rotation_vector_rad.transpose();
    }
    let n = relative.len() as f64;
    spread /= n;
    let eigen = spread.symmetric_eigen();
    let largest = eigen.eigenvalues.imax();
    let axis: Vector3<f64> = eigen.eigenvectors.column(largest).into();
    // Turned far enough, and nearly all of it about one axis.
    let needed = needed_rad.powi(2);
    if eigen.eigenvalues[largest].is_nan() || eigen.eigenvalues[largest] < needed {
        return Err(Refused::Excitation { found: eigen.eigenvalues[largest], needed });
    }
    Ok([start * axis, axis])
}
