//! Learning the rules of a stage from a recording that nobody labelled.
//!
//! What comes in: a recording, with all its faults. What goes out: [`Rules`], and what hindsight reports about each frame and
//! sensor: a flip and a jump are seen from both ends, and a place is judged by what the whole recording specifies is usual.
//! What it never does: run live.

use super::Labels;
use super::frames::Frames;
use super::hindsight::{Recording, Step};
use super::joints::{self, Hint, Place};
use super::memory::{Habit, Point, distance};
use super::pairs::{Pairs, quantile};
use super::rules::{Rules, frame_label, position};
use super::side::{Side, Ways, goes_through};
use posed_fusion::faults::{Cause, Evidence, Label, Mirror, Repeats, Repetition};

/// In a recording, a step whose mirror image is so many times shorter is a flip; shorter steps are motion, m.
const FLIP_RATIO: f64 = 0.3;
const SMALLEST_FLIP_M: f64 = 0.1;
/// A deviation from a steady motion is a jump beyond so many times the largest usual one, or the usual one, and
/// never below this, m.
const JUMP_LARGEST: f64 = 1.5;
const JUMP_USUAL: f64 = 4.0;
const SMALLEST_JUMP_M: f64 = 0.04;
/// In hindsight none is below so many times what the sensor usually bends in so many frames to either side.
const JUMP_TREMBLE: f64 = 3.0;
const TREMBLE_FRAMES: usize = 12;

/// Heads are so far above feet, at least, where names tell which side is clean, m.
const UPRIGHT_M: f64 = 0.1;

/// Shares of the distances that are taken for faults, at either end, round by round.
const RANGES_LEAVE_OUT: [f64; 4] = [0.05, 0.02, 0.01, 0.003];

impl Rules {
    /// Learns from a recording without labels, and labels it with hindsight; no labels for no sensors. It is not
    /// causal: a frame is labelled by those after it too. The rules are described in `docs/methods/fault-map.md`.
    pub fn learn(frames: &Frames) -> (Self, Labels) {
        let (rules, labels, _) = Self::learn_with_shares(frames);
        (rules, labels)
    }

    /// As [`Self::learn`], and what the joints leave over, frame by frame.
    pub(super) fn learn_with_shares(frames: &Frames) -> (Self, Labels, Vec<f64>) {
        let sensors = frames.sensors.len();
        let sides = sides(frames);
        let stuck = stuck(frames);
        let mut positions = undone(frames, &sides);
        let interval_s = frames.interval_s();
        let gaps: Vec<bool> = (0..frames.len()).map(|k| frames.missing_before(k, interval_s) > 0).collect();
        let habits: Vec<Habit> =
            (0..sensors).map(|sensor| habit(&gaps, |k| positions[k * sensors + sensor])).collect();
        positions
            .iter_mut()
            .zip(&stuck)
            .filter(|(_, stuck)| **stuck)
            .for_each(|(position, _)| *position = None);
        let steps = steps(&positions, sensors, &gaps);
        let recording = Recording { sensors, frame_s: interval_s, positions: &positions, steps: &steps };
        let (away, pairs) = recording.away(|round, away| {
            let outside = RANGES_LEAVE_OUT[round.min(RANGES_LEAVE_OUT.len() - 1)];
            let position = |k: usize, sensor: usize| {
                let at = k * sensors + sensor;
                positions[at].filter(|_| !away[at])
            };
            Pairs::learn(sensors, frames.len(), outside, position)
        });
        let (joints, arms) = joints::learn(frames, |k, sensor| {
            let at = k * sensors + sensor;
            positions[at].filter(|_| !away[at])
        });
        let (places, shares) = joints.in_hindsight(&arms, frames, |k, sensor| {
            let at = k * sensors + sensor;
            match positions[at] {
                None => Hint::Missing,
                Some(_) if away[at] => Hint::Wrong,
                Some(here) => Hint::Here(here),
            }
        });
        let label = |at: usize| match (positions[at], stuck[at], away[at], places[at].map(Place::side)) {
            (_, true, ..) => Label::anomalous(Cause::Stuck),
            (None, ..) => Label::MISSING,
            // What the joints say of a sensor overrules its steps and ranges.
            (Some(here), _, _, Some(Some(side))) => side.label(side.undo(sides[at].undo(here))),
            (_, _, true, _) => Label::anomalous(Cause::Jump),
            (_, _, false, Some(None)) => Label::anomalous(Cause::Bone),
            (Some(here), _, false, None) => sides[at].label(here),
        };
        let sensor_labels: Vec<Label> = (0..positions.len()).map(label).collect();
        let pairs = if joints.is_empty() {
            pairs
        } else {
            // The joints know of more that is elsewhere than steps and ranges do.
            Pairs::learn(sensors, frames.len(), RANGES_LEAVE_OUT[RANGES_LEAVE_OUT.len() - 1], |k, sensor| {
                let at = k * sensors + sensor;
                positions[at].filter(|here| sensor_labels[at] == sides[at].label(*here))
            })
        };
        let frame_labels = sensor_labels.chunks_exact(sensors.max(1)).map(frame_label).collect();
        let labels = Labels { frames: frame_labels, sensors: sensor_labels };
        (Self::new(habits, pairs, joints), labels, shares)
    }
}

/// Which positions repeat those before them, often enough, while other sensors move.
fn stuck(frames: &Frames) -> Vec<bool> {
    let sensors = frames.sensors.len();
    let mut stuck = vec![false; frames.len() * sensors];
    let moved = |k: usize, sensor: usize| {
        let (now, before) =
            (position(frames.positions(k), sensor), position(frames.positions(k - 1), sensor));
        now.zip(before).is_some_and(|(now, before)| now != before)
    };
    let moving: Vec<bool> =
        (0..frames.len()).map(|k| k > 0 && (0..sensors).any(|sensor| moved(k, sensor))).collect();
    for sensor in 0..sensors {
        let mut words = Repetition::default();
        // Hindsight: what is stuck was so from its first repetition.
        let mut since = 0;
        for k in 0..frames.len() {
            let Some(p) = position(frames.positions(k), sensor) else { continue };
            let evidence = if moving[k] { Evidence::OthersMove } else { Evidence::None };
            match words.take(p, evidence) {
                Repeats::Changed => since = k + 1,
                Repeats::Stuck => {
                    let there = |k: &usize| moving[*k] && position(frames.positions(*k), sensor).is_some();
                    (since..=k).filter(there).for_each(|k| stuck[k * sensors + sensor] = true);
                    since = k + 1;
                }
                Repeats::Rests | Repeats::Suspect => {}
            }
        }
    }
    stuck
}

/// What separates each position from the one before; `gaps` are the frames that do not follow at once on the one before them.
///
/// A sensor that is pulled trembles, and what trembles for long would make jumps of no step at all: steps are held against
/// what the sensor trembles around them.
fn steps(positions: &[Option<Point>], sensors: usize, gaps: &[bool]) -> Vec<Step> {
    let mut steps = vec![Step::Steady; positions.len()];
    for sensor in 0..sensors {
        let bends = bends(gaps, |k| positions[k * sensors + sensor]);
        let tremble_m = tremble(&bends);
        let beyond = bends.iter().zip(&tremble_m).filter_map(|(bend, tremble)| Some((*bend)? - tremble));
        let jump_m = jump(beyond.collect());
        let mut last: Option<(usize, Point, Point)> = None;
        for (k, tremble_m) in tremble_m.into_iter().enumerate() {
            let at = k * sensors + sensor;
            let Some(p) = positions[at] else { continue };
            let mut step = [0.0; 3];
            match last {
                Some((before, here, speed)) if before + 1 == k && !gaps[k] => {
                    let expected: Point = std::array::from_fn(|c| here[c] + speed[c]);
                    let off = distance(p, expected) / jump_m.max(tremble_m);
                    if off > 1.0 {
                        steps[at] = Step::Jump(off);
                    } else {
                        step = std::array::from_fn(|c| p[c] - here[c]);
                    }
                }
                _ => steps[at] = Step::Gap,
            }
            last = Some((k, p, step));
        }
    }
    steps
}

/// How far a track bends in each frame, m: off a steady motion through the two frames before.
fn bends(gaps: &[bool], here: impl Fn(usize) -> Option<Point>) -> Vec<Option<f64>> {
    let bend = |k: usize| {
        if gaps[k.saturating_sub(1)..=k].contains(&true) {
            return None;
        }
        let (a, b, c) = (here(k.checked_sub(2)?)?, here(k - 1)?, here(k)?);
        Some(distance(c, std::array::from_fn(|axis| 2.0 * b[axis] - a[axis])))
    };
    (0..gaps.len()).map(bend).collect()
}

/// What a track may bend around each frame because it trembles, m.
fn tremble(bends: &[Option<f64>]) -> Vec<f64> {
    let around = |k: usize| {
        let span = k.saturating_sub(TREMBLE_FRAMES)..(k + TREMBLE_FRAMES + 1).min(bends.len());
        let mut bends: Vec<f64> = bends[span].iter().copied().flatten().collect();
        JUMP_TREMBLE * quantile(&mut bends, 0.5)
    };
    (0..bends.len()).map(around).collect()
}

/// The smallest bend that is a jump, m.
fn jump(mut bends: Vec<f64>) -> f64 {
    let largest = JUMP_LARGEST * quantile(&mut bends, 0.995);
    let usual = JUMP_USUAL * quantile(&mut bends, 0.95);
    largest.min(usual).max(SMALLEST_JUMP_M)
}

/// How a sensor moves, from a recording of it on its clean side.
fn habit(gaps: &[bool], here: impl Fn(usize) -> Option<Point>) -> Habit {
    let frames = gaps.len();
    let follows = |k: &usize| !gaps[*k];
    let mut steps: Vec<f64> =
        (1..frames).filter(follows).filter_map(|k| Some(distance(here(k)?, here(k - 1)?))).collect();
    let axis =
        |c: usize| quantile(&mut (0..frames).filter_map(|k| Some(here(k)?[c])).collect::<Vec<_>>(), 0.5);
    Habit {
        jump_m: jump(bends(gaps, &here).into_iter().flatten().collect()),
        step_m: quantile(&mut steps, 0.95),
        home_m: [axis(0), axis(1), axis(2)],
    }
}

/// On which side each position of a recording is: a sensor's side changes with each flip, and the side on
/// which it is longest is the clean one. The figure's own upward axis decides where the names tell it.
fn sides(frames: &Frames) -> Vec<Side> {
    let sensors = frames.sensors.len();
    let mut sides = vec![Side::CLEAN; frames.len() * sensors];
    let (mut last, mut now) = (vec![None::<Point>; sensors], vec![Side::CLEAN; sensors]);
    let mut flips = vec![None::<Mirror>; sensors];
    for k in 0..frames.len() {
        for sensor in 0..sensors {
            flips[sensor] = position(frames.positions(k), sensor).zip(last[sensor]).and_then(|(p, last)| {
                let (same, image) = (distance(p, last), distance(Mirror::Point.apply(p), last));
                is_flip(same, image).then_some(Mirror::Point)
            });
        }
        flip_together(frames.positions(k), &last, &mut flips);
        for sensor in 0..sensors {
            let Some(p) = position(frames.positions(k), sensor) else { continue };
            now[sensor] = flips[sensor].map_or(now[sensor], |mirror| now[sensor].through(mirror));
            last[sensor] = Some(p);
            sides[k * sensors + sensor] = now[sensor];
        }
    }
    find_clean(frames, &mut sides);
    sides
}

/// Positions on the clean side.
fn undone(frames: &Frames, sides: &[Side]) -> Vec<Option<Point>> {
    let sensors = frames.sensors.len();
    let position = |at: usize| Some(sides[at].undo(position(frames.positions(at / sensors), at % sensors)?));
    (0..sides.len()).map(position).collect()
}

/// Sees all sides from the clean one.
fn find_clean(frames: &Frames, sides: &mut [Side]) {
    let sensors = frames.sensors.len();
    for sensor in 0..sensors {
        let there = |k: &usize| position(frames.positions(*k), sensor).is_some();
        let of_sensor = (0..frames.len()).filter(there).map(|k| sides[k * sensors + sensor]);
        let clean = most(of_sensor, None);
        sides.iter_mut().skip(sensor).step_by(sensors).for_each(|side| *side = side.beside(clean));
    }
    if upside_down(frames, sides) {
        // The clean side is the one on which it is otherwise.
        let clean = most(sides.iter().copied(), Some(Side::CLEAN));
        sides.iter_mut().for_each(|side| *side = side.beside(clean));
    }
}

/// Whether a sensor that went so far, m, has gone through the mirror in which it went so far.
fn is_flip(same: f64, image: f64) -> bool {
    same > SMALLEST_FLIP_M && image < FLIP_RATIO * same
}

/// When the figure goes through the vertical mirror, its sensors near the plane, which hardly show it, go with the others.
fn flip_together(frame: &[f64], last: &[Option<Point>], flips: &mut [Option<Mirror>]) {
    let ways = |sensor: usize| Some(Ways::of(position(frame, sensor)?, last[sensor]?));
    let there = || (0..flips.len()).filter_map(ways);
    let shown = there().filter(|ways| ways.shows(SMALLEST_FLIP_M)).count();
    let jumped = there().filter(|ways| is_flip(ways.same, ways.image)).count();
    if goes_through(jumped, shown) {
        for (sensor, flip) in flips.iter_mut().enumerate() {
            if ways(sensor).is_some_and(|ways| ways.may_follow(SMALLEST_FLIP_M)) {
                *flip = Some(Mirror::Vertical);
            }
        }
    }
}

/// The side that is most frequent but for one, and of several the likeliest.
fn most(sides: impl Iterator<Item = Side> + Clone, but: Option<Side>) -> Side {
    let count = |side: &Side| sides.clone().filter(|other| other == side).count();
    // Of equals the last is taken.
    let candidates = Side::ALL.into_iter().rev().filter(|side| Some(*side) != but);
    candidates.max_by_key(count).unwrap_or_default()
}

/// Whether heads are below feet in most frames, where sensors are named after segments.
fn upside_down(frames: &Frames, sides: &[Side]) -> bool {
    let named = |words: &[&str]| -> Vec<usize> {
        let is = |name: &String| words.iter().any(|word| name.to_lowercase().contains(word));
        (0..frames.sensors.len()).filter(|sensor| is(&frames.sensors[*sensor])).collect()
    };
    let (high, low) =
        (named(&["head", "torso", "thorax"]), named(&["pelvis", "root", "foot", "shank", "toes"]));
    let sensors = frames.sensors.len();
    let mean = |k: usize, group: &[usize]| {
        let z = |sensor: &usize| {
            let p = position(frames.positions(k), *sensor)?;
            Some(sides[k * sensors + sensor].undo(p)[2])
        };
        let heights: Vec<f64> = group.iter().filter_map(z).collect();
        (!heights.is_empty()).then(|| heights.iter().sum::<f64>() / heights.len() as f64)
    };
    let (mut up, mut down) = (0, 0);
    for k in 0..frames.len() {
        if let (Some(high), Some(low)) = (mean(k, &high), mean(k, &low)) {
            up += usize::from(high - low > UPRIGHT_M);
            down += usize::from(low - high > UPRIGHT_M);
        }
    }
    down > up
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_fusion::faults::Class;

    /// Four sensors that sway; `position` may move the last.
    fn frames(count: usize, position: impl Fn(usize, Point) -> Point) -> Frames {
        let mut frames =
            Frames { sensors: ["a", "b", "c", "d"].map(str::to_owned).into(), ..Frames::default() };
        for k in 0..count {
            let t = k as f64 / 60.0;
            let sway = 0.2 * libm::sin(0.9 * t);
            let mut row: Vec<f64> = Vec::new();
            for sensor in 0..4 {
                let s = f64::from(sensor);
                let p = [1.5 + sway, 0.3 * s, 0.4 + 0.1 * s + 0.02 * libm::sin(3.0 * t + s)];
                row.extend(if sensor == 3 { position(k, p) } else { p });
            }
            frames.push(t, &row);
        }
        frames
    }

    #[test]
    fn a_pull_is_labelled_from_its_first_frame_to_its_last_and_freezing_too() {
        let recording = frames(1200, |k, p| match k {
            300..420 => [p[0] + 0.2, p[1], p[2] + 0.1],
            _ => p,
        });
        let (_, labels) = Rules::learn(&recording);
        let bad: Vec<usize> = (0..1200).filter(|k| labels.frames[*k].class == Class::Anomalous).collect();
        assert_eq!(bad, (300..420).collect::<Vec<_>>());

        // Interference trembles, too, and lasts so long that most of its steps would pass for usual ones.
        let recording = frames(1200, |k, p| {
            let tremble = |c: f64| 0.012 * libm::sin(0.7 * (k * k) as f64 + c);
            match k {
                300..460 => [p[0] + 0.12 + tremble(0.0), p[1] + tremble(1.0), p[2] + 0.08 + tremble(2.0)],
                _ => p,
            }
        });
        let (_, labels) = Rules::learn(&recording);
        let bad: Vec<usize> = (0..1200).filter(|k| labels.frames[*k].class == Class::Anomalous).collect();
        assert_eq!(bad, (300..460).collect::<Vec<_>>());

        let mut recording = frames(600, |_, p| p);
        let held = recording.positions(99)[9..12].to_vec();
        (100..160).for_each(|k| recording.positions_mut(k)[9..12].copy_from_slice(&held));
        let (_, labels) = Rules::learn(&recording);
        let bad: Vec<usize> = (0..600).filter(|k| labels.frames[*k].cause == Some(Cause::Stuck)).collect();
        assert_eq!(bad, (100..160).collect::<Vec<_>>());
    }

    #[test]
    fn what_moved_while_no_frames_came_did_not_jump() {
        // Two seconds are missing, twice, in which everything went on by 40 cm.
        let whole = frames(1200, |_, p| p);
        let mut recording = Frames { sensors: whole.sensors.clone(), ..Frames::default() };
        let is_there = |k: &usize| !(300..420).contains(k) && !(700..820).contains(k);
        for k in (0..1200).filter(is_there) {
            let moved: Vec<f64> = whole
                .positions(k)
                .iter()
                .enumerate()
                .map(|(n, x)| x + [0.0, 0.4 * (k / 400) as f64, 0.0][n % 3])
                .collect();
            recording.push(whole.t_s[k], &moved);
        }
        let (_, labels) = Rules::learn(&recording);
        let bad = labels.frames.iter().filter(|label| label.class != Class::Clean).count();
        assert_eq!(bad, 0);
    }
}
