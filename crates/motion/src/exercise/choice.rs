//! Which channels an exercise is taught in: the richest set in which repetitions that were left out are counted.
//!
//! What comes in: the channels that move, and for a set of them how its repetitions were found. What goes out: sets of channels, and how
//! many of a lesson's repetitions a model of the others counts in each. What it never does: weigh channels by numbers of its own.
//!
//! More channels keep more of other movements out, so they are preferred. But axes of a sensor that do something else in each
//! repetition (a foot that turns) make every one of them unlike the others, and then those that are faster, smaller or turn do not
//! count. The lesson itself shows it: each repetition is left out once, and counted live by what the others teach.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::counter::Counter;
use super::event::{Event, EventKind};
use super::exercise::Exercise;
use super::kinds::{kinds, siblings};
use super::material::Material;
use super::smaller::interval;

/// Most sets that are tried, the richest first: a single sensor has ten.
const MOST_SETS: usize = 20;

/// A set of channels that teaching has tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TriedChannels {
    /// The channels of it that do the same in every repetition; those it began with where it taught nothing.
    pub channels: Vec<String>,
    /// How many of the repetitions were counted by what the others teach.
    pub counted: usize,
    /// How many there are: those announced, or those seen where they are more.
    pub of: usize,
    /// Counts where there is no repetition, per pass through the lesson.
    pub false_counts: f64,
    /// Mean share of the movement of a repetition that the others explain (correlation squared), 0 to 1; 0 of one that is missing.
    pub explained: f64,
    /// Whether it teaches the number announced.
    pub accepted: bool,
}

/// Why channels are used that were named.
pub(super) const ASKED_FOR: &str = "they were asked for";

impl TriedChannels {
    /// Channels in which nothing is repeated as often.
    pub(super) fn nothing(channels: Vec<String>, of: usize) -> Self {
        Self { channels, counted: 0, of, false_counts: 0.0, explained: 0.0, accepted: false }
    }

    /// Share of the repetitions that are counted, less the false counts.
    pub(super) fn share(&self) -> f64 {
        (self.counted as f64 - self.false_counts) / self.of.max(1) as f64
    }

    /// Whether the share is 1 within the standard error of the difference from it (Agresti & Coull, so that all of a few is not certain).
    fn may_be_perfect(&self) -> bool {
        let n = self.of as f64 + 2.0;
        let variance = |share: f64| {
            let share = (share * self.of as f64 + 1.0) / n;
            share * (1.0 - share) / n
        };
        let share = self.share().clamp(0.0, 1.0);
        1.0 - share <= (variance(share) + variance(1.0)).sqrt()
    }

    /// Whether no other set can be better.
    pub(super) fn is_perfect(&self) -> bool {
        self.accepted && self.counted == self.of && self.false_counts == 0.0
    }
}

/// Index of the set to take. The richest that is accepted, where what it misses may be chance: no more than the standard error of the
/// difference from none. Otherwise, of those that count as much, the one whose repetitions explain one another best.
pub(super) fn choose(tried: &[TriedChannels]) -> Option<usize> {
    let accepted = || tried.iter().enumerate().filter(|(_, set)| set.accepted);
    let (richest, set) = accepted().next()?;
    if set.may_be_perfect() {
        return Some(richest);
    }
    accepted()
        .filter(|(_, other)| other.share() >= set.share())
        .reduce(|a, b| if b.1.explained > a.1.explained { b } else { a })
        .map(|(index, _)| index)
}

/// Why a set was taken, a sentence.
pub(super) fn because(tried: &[TriedChannels], taken: usize) -> String {
    let Some(set) = tried.get(taken) else {
        return "they move and do the same in every repetition".to_owned();
    };
    let figures = |set: &TriedChannels| {
        let false_counts = match set.false_counts.round() {
            0.0 => String::new(),
            some => format!(", with {some:.0} false"),
        };
        format!("{} of {}{false_counts}", set.counted, set.of)
    };
    let counted = format!("what the other repetitions teach counts {}", figures(set));
    match tried[..taken].first() {
        None => format!("{counted}, so that all channels that do the same in every repetition are used"),
        Some(richest) => format!(
            "{counted} and explains {:.0} % of a repetition; in {} it counts {} and explains {:.0} %",
            100.0 * set.explained,
            richest.channels.join(", "),
            figures(richest),
            100.0 * richest.explained
        ),
    }
}

/// Sets of channels worth trying, the richest first: all; without vectors in sensor axes (angular velocities, specific forces, the
/// vertical) these are all there is. With them also all but one kind, each kind, each vector, and of each vector the axis that moves
/// most: a movement in a plane turns about one axis, and what happens on the others is how the sensor sits.
pub(super) fn sets_of(material: &Material) -> Vec<Vec<usize>> {
    let channels = &material.channels;
    let all: Vec<usize> = (0..channels.len()).collect();
    let siblings = siblings(channels);
    let mut sets = vec![all.clone()];
    if siblings.iter().all(Vec::is_empty) {
        return sets;
    }
    let kinds = kinds(channels);
    let moved: Vec<f64> = all.iter().map(|channel| material.sd(*channel)).collect();
    for channel in &all {
        let of = |is_same: bool| {
            all.iter().copied().filter(|c| (kinds[*c] == kinds[*channel]) == is_same).collect()
        };
        let mut vector = siblings[*channel].clone();
        vector.push(*channel);
        vector.sort_unstable();
        let most = vector.iter().copied().reduce(|a, b| if moved[b] > moved[a] { b } else { a });
        for set in [of(false), of(true), vector, most.into_iter().collect()] {
            if !set.is_empty() && !sets.contains(&set) {
                sets.push(set);
            }
        }
    }
    sets.sort_by_key(|set| std::cmp::Reverse(set.len()));
    sets.truncate(MOST_SETS);
    sets
}

/// Which of the repetitions a counter finds, and how many counts there are that are none of them.
pub(super) fn counted(
    exercise: &Exercise,
    material: &Material,
    repetitions: &[Range<usize>],
) -> (Vec<bool>, usize) {
    let mut found = vec![false; repetitions.len()];
    let Ok(mut counter) = Counter::new(vec![exercise.clone()], &material.channels) else { return (found, 0) };
    let mut ends_s = Vec::new();
    let mut note = |event: Event| {
        if event.kind == EventKind::Counted {
            ends_s.push(event.t_s);
        }
    };
    let mut row = Vec::with_capacity(material.width());
    for (frame, values) in material.values.chunks_exact(material.width()).enumerate() {
        row.clear();
        row.extend(values.iter().map(|value| value.is_finite().then_some(*value)));
        counter.push(material.t_s(frame) + 0.5 / material.rate_hz, &row, &mut note);
    }
    counter.finish(&mut note);
    let half_s = 0.5 * interval(repetitions).unwrap_or(f64::INFINITY) / material.rate_hz;
    let mut false_counts = 0;
    for end_s in ends_s {
        let near = |range: &Range<usize>| (material.t_s(range.end) - end_s).abs() <= half_s;
        match (0..repetitions.len()).find(|index| !found[*index] && near(&repetitions[*index])) {
            Some(index) => found[index] = true,
            None => false_counts += 1,
        }
    }
    (found, false_counts)
}

#[cfg(test)]
mod tests {
    use super::super::material::Stream;
    use super::*;

    fn tried(counted: usize, false_counts: f64, explained: f64, accepted: bool) -> TriedChannels {
        TriedChannels { channels: Vec::new(), counted, of: 10, false_counts, explained, accepted }
    }

    /// A second of channels, the later ones of which move more.
    fn material(columns: &[&str]) -> Material {
        let columns: Vec<String> = columns.iter().map(|name| (*name).to_owned()).collect();
        let t_s: Vec<f64> = (0..25).map(|frame| f64::from(frame) / 25.0).collect();
        let row =
            |t: &f64| (0..columns.len()).map(move |channel| Some(t * channel as f64)).collect::<Vec<_>>();
        let values: Vec<_> = t_s.iter().flat_map(row).collect();
        Material::new(&Stream { columns: &columns, t_s: &t_s, values: &values }, None, 25.0).unwrap()
    }

    #[test]
    fn joints_are_one_set_and_a_sensor_has_its_vectors_and_the_axes_that_move_most() {
        assert_eq!(sets_of(&material(&["elbow_flexion_deg", "knee_deg"])), [[0, 1]]);
        let of = sets_of(&material(&["ax", "ay", "az", "gx", "gy", "gz"]));
        assert_eq!(of, [vec![0, 1, 2, 3, 4, 5], vec![3, 4, 5], vec![0, 1, 2], vec![2], vec![5]]);
    }

    #[test]
    fn the_richest_is_taken_where_what_it_misses_may_be_chance() {
        assert_eq!(choose(&[tried(10, 0.0, 0.8, true), tried(10, 0.0, 0.9, true)]), Some(0));
        assert_eq!(choose(&[tried(9, 0.0, 0.8, true), tried(10, 0.0, 0.9, true)]), Some(0));
        assert_eq!(
            choose(&[tried(7, 0.0, 0.7, true), tried(10, 0.0, 0.8, true), tried(9, 0.0, 0.9, true)]),
            Some(2)
        );
        // Nor is one taken that is alike in what it sees, and misses more.
        assert_eq!(choose(&[tried(7, 0.0, 0.7, true), tried(6, 0.0, 0.9, true)]), Some(0));
        assert_eq!(choose(&[tried(10, 4.0, 0.8, true), tried(10, 0.0, 0.9, true)]), Some(1));
        assert_eq!(choose(&[tried(10, 0.0, 0.9, false), tried(5, 0.0, 0.8, true)]), Some(1));
        assert_eq!(choose(&[tried(10, 0.0, 0.9, false)]), None);
    }
}
