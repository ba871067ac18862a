//! Which sensor sits on which segment, found from the movements of a calibration.
//!
//! In: a recording whose samples stand under the segments that somebody took the sensors to sit on, and when which movement
//! was done. Out: where each really sits, or which two cannot be distinguished and what to do about it. How a sensor sits on
//! its segment is of no matter: only how fast it turned is looked at. It never guesses between two that moved in the same way.
//!
//! A movement turns some segments and leaves others at rest. Sensors and segments are matched so that the sum of squared
//! departures from that is least: the linear assignment problem (Kuhn 1955, Munkres 1957).

use nalgebra::Vector3;
use pathfinding::prelude::{Matrix, kuhn_munkres_min};
use thiserror::Error;

use super::block::{Block, BlockKind, Movement, Recorded};
use super::skeleton::{BodySegment, SEGMENTS};

/// A sensor that fits another segment nearly as well, by a sum of squared shares of the fastest, cannot be distinguished from the one there.
const MARGIN: f64 = 0.15;
/// Whoever is to move turns at least so fast, root mean square, rad/s.
const MOVES_RAD_S: f64 = 0.2;
/// Fewer samples in a movement are none.
const ENOUGH_SAMPLES: usize = 10;
/// The library wants whole numbers: costs are counted in millionths.
const PER_UNIT: f64 = 1e6;
/// More than any assignment costs.
const FORBIDDEN: i64 = 1_000_000_000_000;

/// By [`BodySegment::index`] of where a sensor was taken to sit: where it does. A permutation of the segments that wear
/// sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Assignment([Option<BodySegment>; SEGMENTS]);

impl Assignment {
    /// What stands under the segments that sensors were taken to sit on, under those that they do sit on; what has no sensor
    /// is dropped.
    pub fn place<T: Copy>(&self, taken_for: &[Option<T>; SEGMENTS]) -> [Option<T>; SEGMENTS] {
        let mut placed = [None; SEGMENTS];
        for (what, segment) in taken_for.iter().zip(self.0) {
            if let Some(segment) = segment {
                placed[segment.index()] = *what;
            }
        }
        placed
    }

    /// A recording with every sensor's samples under the segment that it does sit on.
    pub fn placed(&self, recording: &[Recorded]) -> Vec<Recorded> {
        recording.iter().map(|(t_s, samples)| (*t_s, self.place(samples))).collect()
    }
}

/// Why sensors cannot be assigned.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum AssignError {
    /// Nothing moved.
    #[error("nobody moved in {0}: repeat it, further and faster")]
    Still(String),
    /// A sensor has no samples there.
    #[error(
        "the sensor that was taken for {taken_for} sent nothing during {movement}: see to it, and repeat"
    )]
    Silent {
        /// Where it was taken to sit.
        taken_for: &'static str,
        /// When it failed.
        movement: String,
    },
    /// Two segments moved in the same way.
    #[error("{first} and {second} moved in the same way: add a movement of one of them alone, such as {fix}")]
    Alike {
        /// One of them.
        first: &'static str,
        /// The other.
        second: &'static str,
        /// A movement that tells them apart.
        fix: String,
    },
    /// Something else was done than was asked for.
    #[error("in {movement} {still} turned more than {moving}: repeat it, and keep the rest still")]
    Unlike {
        /// What was to be done.
        movement: String,
        /// Who was to move.
        moving: &'static str,
        /// Who was to rest.
        still: &'static str,
    },
}

/// Finds the segment of every sensor that the recording has; the segments are those that the sensors were taken to sit on.
/// Only angular velocities count, so mounting and magnetometers do not matter. Linear assignment (Kuhn 1955) with a margin
/// between best and second best; `docs/methods/body.md`, Assignment.
///
/// # Errors
/// An [`AssignError`] whose sentence states what to do: nobody moved, a sensor was silent, two segments moved in the same way,
/// or the rest was not still.
pub fn assign(recording: &[Recorded], blocks: &[Block]) -> Result<Assignment, AssignError> {
    let segments: Vec<BodySegment> = BodySegment::ALL
        .into_iter()
        .filter(|segment| recording.iter().any(|(_, samples)| samples[segment.index()].is_some()))
        .collect();
    let mut movements = Vec::new();
    for block in blocks {
        if segments.iter().any(|segment| share(*segment, block.kind) == Some(1.0)) {
            movements.push((block.kind, shares_turned(recording, block, &segments)?));
        }
    }
    let departure = |sensor: usize, segment: BodySegment| -> f64 {
        let of = |(kind, turned): &(BlockKind, Vec<f64>)| {
            share(segment, *kind).map_or(0.0, |share| (turned[sensor] - share).powi(2))
        };
        movements.iter().map(of).sum()
    };
    let costs = Matrix::from_fn(segments.len(), segments.len(), |(sensor, at)| {
        (departure(sensor, segments[at]) * PER_UNIT) as i64
    });
    let (least, found) = kuhn_munkres_min(&costs);
    for (sensor, at) in found.iter().copied().enumerate() {
        let segment = segments[at];
        // The best of the assignments in which this sensor sits elsewhere.
        let mut without = costs.clone();
        without[(sensor, at)] = FORBIDDEN;
        let (second, other) = kuhn_munkres_min(&without);
        if segments.len() > 1 && (second - least) as f64 <= MARGIN * PER_UNIT {
            let fix = match segment {
                BodySegment::Torso | BodySegment::Pelvis => BlockKind::TrunkRotation,
                BodySegment::ShoulderR | BodySegment::ShoulderL => {
                    BlockKind::Move(segment, Movement::Elevation)
                }
                limb => BlockKind::Move(limb, Movement::Flexion),
            };
            let (first, second) = (segment.name(), segments[other[sensor]].name());
            return Err(AssignError::Alike { first, second, fix: fix.name() });
        }
    }
    for (kind, turned) in &movements {
        was_done(*kind, turned, &found, &segments)?;
    }
    let mut assignment = [None; SEGMENTS];
    for (sensor, at) in found.into_iter().enumerate() {
        assignment[segments[sensor].index()] = Some(segments[at]);
    }
    Ok(Assignment(assignment))
}

/// How fast each sensor turned in a movement, root mean square, as a part of the fastest. What a gyro reports on average is its bias:
/// movements go there and back.
fn shares_turned(
    recording: &[Recorded],
    block: &Block,
    segments: &[BodySegment],
) -> Result<Vec<f64>, AssignError> {
    let inside = |(t_s, _): &&Recorded| (block.start_s..=block.end_s).contains(t_s);
    let turned = |segment: &BodySegment| {
        let gyro_rad_s: Vec<Vector3<f64>> = recording
            .iter()
            .filter(inside)
            .filter_map(|(_, samples)| Some(samples[segment.index()]?.gyro_rad_s))
            .filter(|w| w.iter().all(|value| value.is_finite()))
            .collect();
        if gyro_rad_s.len() < ENOUGH_SAMPLES {
            return Err(AssignError::Silent { taken_for: segment.name(), movement: block.kind.name() });
        }
        let count = gyro_rad_s.len() as f64;
        let mean = gyro_rad_s.iter().sum::<Vector3<f64>>() / count;
        Ok((gyro_rad_s.iter().map(|w| (w - mean).norm_squared()).sum::<f64>() / count).sqrt())
    };
    let mut turned = segments.iter().map(turned).collect::<Result<Vec<f64>, _>>()?;
    let most = turned.iter().copied().fold(0.0, f64::max);
    if most < MOVES_RAD_S {
        return Err(AssignError::Still(block.kind.name()));
    }
    turned.iter_mut().for_each(|share| *share /= most);
    Ok(turned)
}

/// Whoever was to move did so more than those who were to rest.
fn was_done(
    kind: BlockKind,
    turned: &[f64],
    found: &[usize],
    segments: &[BodySegment],
) -> Result<(), AssignError> {
    let by = |wanted: f64| {
        let wanted_share = move |(_, segment): &(f64, BodySegment)| share(*segment, kind) == Some(wanted);
        turned.iter().copied().zip(found.iter().map(|at| segments[*at])).filter(wanted_share)
    };
    let least = by(1.0).min_by(|(a, _), (b, _)| a.total_cmp(b));
    let most = by(0.0).max_by(|(a, _), (b, _)| a.total_cmp(b));
    match (least, most) {
        (Some((moved, moving)), Some((rested, still))) if moved <= rested => {
            Err(AssignError::Unlike { movement: kind.name(), moving: moving.name(), still: still.name() })
        }
        _ => Ok(()),
    }
}

/// How much a segment turns in a movement, as a part of what turns most. `None` where people differ: a shank hangs or is
/// stretched when the thigh is lifted, arms hang or are held when the trunk moves, shoulders rise with arms that are lifted.
fn share(segment: BodySegment, kind: BlockKind) -> Option<f64> {
    let hangs_on = |above: BodySegment| {
        std::iter::successors(segment.parent(), |of| of.parent()).any(|parent| parent == above)
    };
    let is_shoulder = BodySegment::SHOULDERS.contains(&segment);
    match kind {
        BlockKind::NPose | BlockKind::TPose | BlockKind::Walk => None,
        BlockKind::Bow if is_shoulder || matches!(segment, BodySegment::Torso | BodySegment::Pelvis) => {
            Some(1.0)
        }
        BlockKind::TrunkRotation if is_shoulder || segment == BodySegment::Torso => Some(1.0),
        BlockKind::TrunkRotation if segment == BodySegment::Pelvis => Some(0.0),
        BlockKind::Bow | BlockKind::TrunkRotation => BodySegment::LEGS.contains(&segment).then_some(0.0),
        BlockKind::Move(moved, _) if segment == moved => Some(1.0),
        BlockKind::Move(moved, _) if hangs_on(moved) || moved.shoulder() == Some(segment) => None,
        BlockKind::Move(..) => Some(0.0),
    }
}

#[cfg(test)]
mod tests {
    use posed_simulator::body::{Activity, Build, Script, Wearer, WearerSpec};

    use super::super::Skeleton;
    use super::super::calibrate::calibrate;
    use super::super::guide::{Guide, Thoroughness};
    use super::super::tests::{record_of, spec};
    use super::*;

    /// What a person does who follows the guide, with every sensor's samples under the segment at the opposite end of the list.
    fn guided(magnetometer: bool, count: usize, seed: u64) -> Guide {
        let script = Script { activity: Activity::Movements, calibration: false, facing: 0.6, mistake: None };
        let build = Build { girdle: count == SEGMENTS, ..Build::of_height(1.8) };
        let mut wearer = Wearer::new(WearerSpec { magnetometer, build, ..spec(script, seed) });
        let present = std::array::from_fn(|index| index < count);
        let (recording, _) = record_of(&present, &mut wearer, 145.0);
        let mut guide = Guide::new(present, magnetometer, Thoroughness::Assign);
        for (t_s, mut samples) in recording {
            samples[..count].reverse();
            guide.push(t_s, &samples);
        }
        assert_eq!(guide.prompt(), None, "{:?}", guide.recorded().1);
        guide
    }

    #[test]
    fn sensors_find_their_segments() {
        let fifteen = BodySegment::BEFORE_SHOULDERS;
        for (magnetometer, count, seed) in
            [(true, fifteen, 4), (false, fifteen, 5), (true, SEGMENTS, 4), (false, SEGMENTS, 5)]
        {
            let guide = guided(magnetometer, count, seed);
            let (recording, blocks) = guide.recorded();
            let found = assign(recording, blocks).unwrap();
            let mut expected = BodySegment::ALL.map(|segment| (segment.index() < count).then_some(segment));
            expected[..count].reverse();
            assert_eq!(found.0, expected);
            // The same movements show how they sit.
            let skeleton = Skeleton::from_height(1.8);
            let calibrated =
                calibrate(&found.placed(recording), blocks, &skeleton, &[None; SEGMENTS]).unwrap();
            assert_eq!(calibrated.warnings, Vec::<String>::new());
            let worst = calibrated.quality_deg.iter().flatten().copied().fold(0.0, f64::max);
            assert!(worst < 5.0 && calibrated.quality_deg.iter().flatten().count() == count, "{worst}");
        }
    }

    #[test]
    fn sensors_that_moved_alike_or_not_as_asked_are_not_guessed() {
        let guide = guided(true, BodySegment::BEFORE_SHOULDERS, 6);
        let (recording, blocks) = guide.recorded();
        // The poses and one elbow alone.
        assert!(matches!(assign(recording, &blocks[..4]), Err(AssignError::Alike { .. })));
        // All but what tells the torso from the pelvis.
        let without = |kind: &str| {
            blocks.iter().filter(|block| block.kind.name() != kind).copied().collect::<Vec<Block>>()
        };
        assert_eq!(
            assign(recording, &without("trunk_rotation")).unwrap_err().to_string(),
            "torso and pelvis moved in the same way: add a movement of one of them alone, such as trunk_rotation"
        );
        let of = |kind: &str| *blocks.iter().find(|block| block.kind.name() == kind).unwrap();
        // What is found where this was asked for between these times.
        let during = |kind: &str, start_s: f64, end_s: f64| {
            let moved = |block: &Block| {
                if block.kind.name() == kind { Block { start_s, end_s, ..*block } } else { *block }
            };
            assign(recording, &blocks.iter().map(moved).collect::<Vec<Block>>())
        };
        let knee = of("knee_flexion_l");
        // A knee was bent where the elbow was asked for.
        assert_eq!(
            during("elbow_flexion_r", knee.start_s, knee.end_s).unwrap_err().to_string(),
            "forearm_r and upper_arm_r moved in the same way: add a movement of one of them alone, such as elbow_flexion_r"
        );
        // A knee was bent where a bow was asked for: all are known, but not what was asked.
        assert_eq!(
            during("bow", knee.start_s, knee.end_s).unwrap_err().to_string(),
            "in bow foot_l turned more than pelvis: repeat it, and keep the rest still"
        );
        // Nobody moved.
        assert_eq!(
            during("elbow_flexion_r", 1.0, 3.0).unwrap_err().to_string(),
            "nobody moved in elbow_flexion_r: repeat it, further and faster"
        );
        // A sensor was away.
        let mut away = recording.to_vec();
        let block = of("hip_flexion_l");
        for (_, samples) in away.iter_mut().filter(|(t_s, _)| (block.start_s..block.end_s).contains(t_s)) {
            samples[BodySegment::Torso.index()] = None;
        }
        assert_eq!(
            assign(&away, blocks).unwrap_err().to_string(),
            "the sensor that was taken for torso sent nothing during hip_flexion_l: see to it, and repeat"
        );
    }
}
