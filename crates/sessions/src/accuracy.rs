//! How well sets were counted, by the counts that a therapist put right.
//!
//! What comes in: sessions, and where there are recordings what these give when they are counted again. What goes out: for each exercise
//! how many sets were exact, and within one. What it never does: take a set for right that nobody has looked at.

use serde::Serialize;

use crate::repetition::Repetition;
use crate::session::{Session, TrainingSet};

/// How well the sets of an exercise were counted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CountAccuracy {
    /// Name of the exercise.
    pub exercise: String,
    /// Sets whose count somebody gave.
    pub sets: u32,
    /// Of these, the sets that were counted as many.
    pub exact: u32,
    /// Those that were off by one at most.
    pub within_one: u32,
}

impl CountAccuracy {
    /// By exercises, in the order in which they come: name, count and truth of each set.
    pub fn of<'a>(sets: impl IntoIterator<Item = (&'a str, u32, u32)>) -> Vec<Self> {
        let mut exercises: Vec<Self> = Vec::new();
        for (name, counted, truth) in sets {
            let at = exercises.iter().position(|known| known.exercise == name).unwrap_or_else(|| {
                exercises.push(Self { exercise: name.to_owned(), sets: 0, exact: 0, within_one: 0 });
                exercises.len() - 1
            });
            exercises[at].sets += 1;
            exercises[at].exact += u32::from(counted == truth);
            exercises[at].within_one += u32::from(counted.abs_diff(truth) <= 1);
        }
        exercises
    }
}

impl Session {
    /// The sets whose count somebody has put right, or said to be right, with that count.
    pub fn corrected(&self) -> impl Iterator<Item = (&TrainingSet, u32)> {
        self.training.iter().filter_map(|set| Some((set, set.corrected?)))
    }

    /// How many repetitions of a set there are among those that its recording gives, `counted`, which began at `begun_s`, s; `None`
    /// where the set began before. What lies between two sets belongs to the nearer one.
    pub fn counted_again(&self, set: u32, counted: &[Repetition], begun_s: f64) -> Option<u32> {
        let at = self.training.iter().position(|one| one.set == set)?;
        let first_s = |set: &TrainingSet| set.repetitions.first().map(|one| one.t_start_s);
        let last_s = |set: &TrainingSet| set.repetitions.last().map(|one| one.t_end_s);
        let between = |before: usize| {
            let (before, after) = (self.training.get(before)?, self.training.get(before + 1)?);
            Some(0.5 * (last_s(before)? + first_s(after)?))
        };
        let from_s = at.checked_sub(1).and_then(between).unwrap_or(self.t_begin_s);
        let until_s = between(at).unwrap_or(self.t_end_s());
        let set = &self.training[at];
        if first_s(set)? < begun_s {
            return None;
        }
        let is_of_it = |one: &&Repetition| {
            one.is_counted()
                && one.subject == self.subject
                && one.lesson.exercise == set.lesson.exercise
                && (from_s..until_s).contains(&(0.5 * (one.t_start_s + one.t_end_s)))
        };
        Some(counted.iter().filter(is_of_it).count() as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn sets_are_held_against_what_somebody_counted_and_others_are_left_aside() {
        let sets = [("curl", 10, 10), ("squat", 8, 10), ("curl", 9, 10), ("curl", 10, 13)];
        let [curl, squat] = &CountAccuracy::of(sets)[..] else { panic!() };
        assert_eq!((curl.sets, curl.exact, curl.within_one), (3, 1, 2));
        assert_eq!((squat.exercise.as_str(), squat.sets, squat.exact, squat.within_one), ("squat", 1, 0, 0));
    }
}
