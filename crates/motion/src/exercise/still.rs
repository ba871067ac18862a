//! Joints that keep still in an exercise.
//!
//! What comes in: the courses of all joints. What goes out: those that hardly move, and belong to the limb
//! that does, to the trunk, or to the legs, with how they were held; and of a repetition, how long they were held quite otherwise, and by how much
//! one moved with the movement. What it never does: take part in the likelihood: a joint that says nothing about the movement must
//! not decide where it begins. It is a gate (who waves with a bent arm raises no straight one), and a word (who
//! leans back to lift a weight). Of a leg
//! that takes no part it is asked only that it does not go along: who walks curls nothing, and who squats lifts no knee. How it stands is the person's affair.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::channels::all_channels;
use super::exercise::Exercise;
use super::hmm::{Movement, range};
use super::joint::{Joint, Part, Side};
use super::judge::{ELSEWHERE_DEG, share_far};
use super::kinds::is_posture;
use super::material::{Material, Stream};
use super::turns::phase;

/// A joint that goes farther in a demonstration does not keep still, degrees.
const STILL_DEG: f64 = 30.0;
/// By so much a joint may move with the movement, degrees, and by so many of the lesson's standard deviations.
const MOVES_DEG: f64 = 12.0;
const MOVES_SDS: f64 = 3.0;
/// Where a joint of the limb moves farther with it, the movement is another one, degrees: who drinks bends the elbow as in a curl, and lifts the upper
/// arm by more. A trunk that leans so far still belongs to the same movement, and leaves it later.
const LIMB_DEG: f64 = 20.0;
const TRUNK_DEG: f64 = 45.0;
/// A leg that takes no part may sway by this standard deviation, degrees: as who stands half of the time in each of two postures that are as
/// far apart as a joint goes that keeps still. A stride has more, a shift of weight less.
const SWAYS_DEG: f64 = 0.5 * STILL_DEG;
/// Share of a repetition's frames in which a joint must be seen.
const SEEN: f64 = 0.9;
/// Sets begin and end elsewhere than their repetitions: what lies beside this is not looked at.
const BEGUN: std::ops::Range<f64> = 0.1..0.9;
/// Most joints of one exercise; a body has fewer.
pub(super) const MOST: usize = 64;

/// An angle that keeps still in an exercise, in the channel's unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Still {
    /// The channel.
    pub channel: String,
    /// Least and greatest value in the taught repetitions.
    pub range: [f64; 2],
    /// Mean of how far it goes with the movement there and back.
    pub moves: f64,
    /// Standard deviation of that from repetition to repetition.
    pub moves_sd: f64,
}

impl Still {
    /// Whether its numbers fit together.
    pub(super) fn is_right(&self) -> bool {
        let [low, high] = self.range;
        let finite = [low, high, self.moves, self.moves_sd].iter().all(|value| value.is_finite());
        !self.channel.is_empty() && finite && low <= high && self.moves_sd >= 0.0
    }

    /// Share of a repetition in which it was quite elsewhere; 0 of a joint that was not seen, or always says the same.
    pub(super) fn elsewhere(&self, values: impl Iterator<Item = f64> + Clone) -> f64 {
        let far = ELSEWHERE_DEG / self.degrees();
        let [low, high] = self.range;
        share_far(values.map(|value| (value, value < low - far || value > high + far)))
    }

    /// Whether it went to and fro by more than a leg that stands; its values in a repetition.
    pub(super) fn sways(&self, values: impl Iterator<Item = f64>) -> bool {
        let (n, x, xx) = values
            .filter(|value| value.is_finite())
            .fold((0.0, 0.0, 0.0), |(n, x, xx), value| (n + 1.0, x + value, xx + value * value));
        (xx / n - (x / n).powi(2)).max(0.0).sqrt() * self.degrees() > SWAYS_DEG
    }

    /// By how much it moved with the movement more than taught, in its unit. The values come with how far the movement
    /// is, as [`ways`] has it.
    pub(super) fn moved(&self, values: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
        Some(moves(values)? - self.moves)
    }

    /// What that is worth, the least that is worth a word being 1.
    pub(super) fn worth(&self, moved: f64) -> f64 {
        moved.abs() / (MOVES_DEG / self.degrees()).max(MOVES_SDS * self.moves_sd)
    }

    /// As [`Self::moved`], in degrees.
    pub(super) fn moved_deg(&self, values: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
        Some(self.moved(values)? * self.degrees())
    }

    /// Degrees per unit of the channel.
    fn degrees(&self) -> f64 {
        Joint::of(&self.channel).map_or(1.0, |joint| joint.degrees)
    }
}

/// The angles of one joint that keep still, which turn together: how a sensor sits shares a turn out among them.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Together {
    /// Their numbers.
    members: Vec<usize>,
    limit_deg: f64,
}

impl Together {
    /// The joints of those of these angles that `belongs` takes.
    pub(super) fn of(stills: &[Still], belongs: impl Fn(usize) -> bool) -> Vec<Self> {
        let joint = |number: usize| Joint::of(&stills[number].channel);
        let is_of = |one: usize, other: usize| {
            joint(one).zip(joint(other)).map_or(one == other, |(one, other)| one.is_beside(&other))
        };
        let all = || (0..stills.len()).filter(|number| belongs(*number));
        let firsts =
            all().filter(|one| !all().take_while(|other| other < one).any(|other| is_of(*one, other)));
        firsts
            .map(|first| {
                let is_trunk = joint(first).is_some_and(|joint| joint.part() == Some(Part::Trunk));
                Self {
                    members: all().filter(|other| is_of(first, *other)).collect(),
                    limit_deg: if is_trunk { TRUNK_DEG } else { LIMB_DEG },
                }
            })
            .collect()
    }

    /// Whether the joint moved so far that the movement is another one; `moved_deg` is how far each of the angles did, degrees.
    pub(super) fn is_another(&self, moved_deg: impl Fn(usize) -> Option<f64>) -> bool {
        let moved = self.members.iter().filter_map(|member| moved_deg(*member));
        moved.map(|moved| moved * moved).sum::<f64>() > self.limit_deg * self.limit_deg
    }
}

/// How far an angle goes with the movement, by least squares; `None` of a joint that says the same all the time, and has failed. The values
/// come with how far the movement is, from 0 to 1: who holds it at its turning point is there.
fn moves(values: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
    let there = values.filter(|(way, value)| way.is_finite() && value.is_finite());
    let (n, x, y) =
        there.clone().fold((0.0, 0.0, 0.0), |(n, x, y), (way, value)| (n + 1.0, x + way, y + value));
    let (x, y) = (x / n, y / n);
    let (low, high) = range(there.clone().map(|(_, value)| value));
    let (xy, xx) = there
        .fold((0.0, 0.0), |(xy, xx), (way, value)| (xy + (way - x) * (value - y), xx + (way - x).powi(2)));
    (xx > 0.0 && high > low).then(|| xy / xx)
}

/// How far a movement is in each of its states, from 0 to 1, by the joint that goes farthest; NaN at its ends, since sets begin and end
/// elsewhere than their repetitions, and everywhere of a movement without joints.
pub(super) fn ways(movement: &Movement, channels: &[String]) -> Vec<f64> {
    let means = &movement.states.mean;
    let goes_deg = |channel: usize| {
        let (low, high) = range(means[channel].iter().copied());
        Joint::of(&channels[channel]).map_or(0.0, |joint| (high - low) * joint.degrees)
    };
    let farthest = (0..channels.len()).max_by(|a, b| goes_deg(*a).total_cmp(&goes_deg(*b)));
    let course = farthest.map_or(&[][..], |channel| &means[channel]);
    let ends = 0.5 * (course.first().unwrap_or(&0.0) + course.last().unwrap_or(&0.0));
    let most = course.iter().map(|mean| (mean - ends).abs()).fold(0.0, f64::max);
    let way = |(state, mean): (usize, &f64)| {
        if BEGUN.contains(&phase(state, course.len())) { (mean - ends).abs() / most } else { f64::NAN }
    };
    course.iter().enumerate().map(way).collect()
}

/// The joints that keep still in an exercise while its repetitions, s, are done.
pub(super) fn stills(stream: &Stream<'_>, exercise: &Exercise, repetitions: &[[f64; 2]]) -> Vec<Still> {
    let is_meant = |name: &String| role(name, &exercise.channels).is_some();
    let names: Vec<String> = all_channels(stream.columns).into_iter().filter(is_meant).take(MOST).collect();
    if names.is_empty() {
        return Vec::new();
    }
    // All of them are there.
    let Ok(material) = Material::new(stream, Some(&names), exercise.rate_hz) else { return Vec::new() };
    let ways = ways(&exercise.movement, &exercise.channels);
    let still = |(channel, name): (usize, &String)| still(&material, channel, name, &ways, repetitions);
    names.iter().enumerate().filter_map(still).collect()
}

fn still(
    material: &Material,
    channel: usize,
    name: &str,
    ways: &[f64],
    repetitions: &[[f64; 2]],
) -> Option<Still> {
    let degrees = Joint::of(name)?.degrees;
    let (mut seen, mut all, mut low, mut high) = (0.0, 0.0, f64::INFINITY, f64::NEG_INFINITY);
    let mut moved = Vec::with_capacity(repetitions.len());
    for [start_s, end_s] in repetitions {
        let frames =
            (0..material.frames()).filter(|frame| (*start_s..*end_s).contains(&material.t_s(*frame)));
        let values = frames.map(|frame| {
            let phase = (material.t_s(frame) - start_s) / (end_s - start_s);
            let way = ways[((phase * ways.len() as f64) as usize).min(ways.len() - 1)];
            (way, material.values[frame * material.width() + channel])
        });
        all += values.clone().count() as f64;
        let there = values.clone().map(|(_, value)| value).filter(|value| value.is_finite());
        seen += there.clone().count() as f64;
        let (least, greatest) = range(there);
        (low, high) = (f64::min(low, least), f64::max(high, greatest));
        moved.push(moves(values)?);
    }
    // Not seen, without life, or moving with the rest.
    if seen < SEEN * all || high <= low || (high - low) * degrees > STILL_DEG {
        return None;
    }
    let n = moved.len() as f64;
    let mean = moved.iter().sum::<f64>() / n;
    let squares: f64 = moved.iter().map(|one| (one - mean).powi(2)).sum();
    Some(Still {
        channel: name.to_owned(),
        range: [low, high],
        moves: mean,
        moves_sd: (squares / (n - 1.0).max(1.0)).sqrt(),
    })
}

/// What an angle that keeps still has to do with an exercise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub(super) enum Role {
    /// It is of the limb that moves, or of the trunk: the exercise depends on its posture.
    Holds,
    /// It is of a leg that takes no part.
    Stands,
}

/// The role of a joint's angle in an exercise of these channels; `None` where it has none.
pub(super) fn role(name: &str, channels: &[String]) -> Option<Role> {
    let joint = Joint::of(name).filter(|_| is_posture(name))?;
    let part = joint.part().filter(|_| joint.movement != "pronation")?;
    let moves = || channels.iter().filter_map(|channel| Joint::of(channel));
    let beside = |other: &Joint<'_>| {
        let one_side = |a: Option<Side>, b: Option<Side>| a.zip(b).is_none_or(|(a, b)| a == b);
        other.part() == Some(part) && one_side(joint.side, other.side)
    };
    if part == Part::Trunk || moves().any(|other| beside(&other)) {
        Some(Role::Holds)
    } else {
        (part == Part::Leg && moves().any(|other| other.part().is_some())).then_some(Role::Stands)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_of_the_limb_that_moves_and_of_the_trunk_are_held_still() {
        let channels = ["elbow_r_flexion_deg".to_owned()];
        for (name, expected) in [
            ("shoulder_r_flexion_deg", true),
            ("shoulder_l_flexion_deg", false),
            ("elbow_l_flexion_deg", false),
            ("spine_flexion_deg", true),
            ("trunk_flexion_deg", true),
            ("shoulder_r_plane_deg", false),
            ("elbow_r_pronation_deg", false),
            ("watch_gx", false),
        ] {
            assert_eq!(role(name, &channels), expected.then_some(Role::Holds), "{name}");
        }
        assert_eq!(role("shoulder_flexion_deg", &channels), Some(Role::Holds), "of one side only");
        assert_eq!(role("knee_l_flexion_deg", &channels), Some(Role::Stands));
        assert_eq!(role("elbow_l_flexion_deg", &["knee_l_flexion_deg".to_owned()]), None);
        assert_eq!(role("knee_r_flexion_deg", &["knee_l_flexion_deg".to_owned()]), Some(Role::Stands));
    }

    #[test]
    fn what_moves_with_the_movement_is_worth_a_word_and_what_is_held_elsewhere_is_another_movement() {
        let still =
            Still { channel: "spine_flexion_deg".into(), range: [-2.0, 4.0], moves: 1.0, moves_sd: 1.0 };
        let course = |lean: f64, offset: f64| {
            (0..100).map(move |k| {
                let way = libm::sin(std::f64::consts::PI * f64::from(k) / 100.0).powi(2);
                (way, offset + lean * way + 0.01 * f64::from(k % 3))
            })
        };
        let worth = |lean, offset| still.worth(still.moved(course(lean, offset)).unwrap());
        assert!(worth(0.0, 20.0) < 0.2, "a sensor that sits otherwise moves nothing");
        assert!(worth(9.0, 0.0) < 1.0 && worth(-30.0, 0.0) > 1.0 && worth(30.0, 0.0) > 1.0);
        let elsewhere = |offset| still.elsewhere(course(0.0, offset).map(|(_, value)| value));
        assert_eq!([elsewhere(20.0), elsewhere(60.0), elsewhere(-60.0)], [0.0, 1.0, 1.0]);
        assert_eq!(still.elsewhere((0..50).map(|_| 90.0)), 0.0, "a sensor that has failed");
        assert_eq!(still.moved((0..50).map(|k| (f64::from(k) / 50.0, f64::NAN))), None);
    }

    #[test]
    fn who_walks_sways_and_who_stands_does_not() {
        let knee = Still { channel: "knee_flexion_deg".into(), range: [4.0, 9.0], moves: 0.0, moves_sd: 1.0 };
        let strides = |deg: f64| (0..200).map(move |k| 40.0 + deg * libm::sin(0.1 * f64::from(k)));
        assert!(knee.sways(strides(27.0)) && !knee.sways(strides(15.0)), "a stride, and a shift of weight");
        assert!(!knee.sways((0..200).map(|_| 80.0)), "who sits");
        assert!(!knee.sways(std::iter::repeat_n(f64::NAN, 200)), "who was not seen");
    }

    #[test]
    fn the_angles_of_one_joint_make_another_movement_together() {
        let named =
            |channel: &str| Still { channel: channel.into(), range: [0.0; 2], moves: 0.0, moves_sd: 1.0 };
        let names = [
            "shoulder_r_flexion_deg",
            "spine_flexion_deg",
            "shoulder_r_adduction_deg",
            "elbow_r_flexion_deg",
        ];
        let joints = Together::of(&names.map(named), |_| true);
        let members: Vec<_> = joints.iter().map(|joint| joint.members.clone()).collect();
        assert_eq!(members, [vec![0, 2], vec![1], vec![3]]);
        let is_another =
            |joint: usize, moved: [f64; 4]| joints[joint].is_another(|number| Some(moved[number]));
        assert!(!is_another(0, [15.0, 90.0, 10.0, 90.0]) && is_another(0, [15.0, 0.0, -15.0, 0.0]));
        assert!(!is_another(1, [90.0, 30.0, 90.0, 90.0]) && is_another(1, [0.0, -50.0, 0.0, 0.0]));
        assert!(!joints[2].is_another(|_| None), "a joint that was not seen");
        // By itself the trunk may go farther than a limb.
        let by_itself =
            |joint: usize| [15.0, 30.0, -50.0].map(|moved| joints[joint].is_another(|_| Some(moved)));
        assert_eq!(by_itself(1), [false, false, true]);
        assert_eq!(by_itself(2), [false, true, true]);
    }
}
