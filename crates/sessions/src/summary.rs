//! Figures of a session: per exercise, over its counted repetitions.

use std::sync::Arc;

use serde::Serialize;

use crate::lesson::{LessonJoint, TaughtLesson};
use crate::number::{degrees, points, time_s};
use crate::repetition::{JointCourse, Repetition, Score};
use crate::session::{Session, TrainingSet};

/// One exercise of a session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExerciseSummary {
    /// What it was compared with.
    #[serde(serialize_with = "crate::lesson::shared")]
    pub lesson: Arc<TaughtLesson>,
    /// Sets begun.
    pub sets: u32,
    /// Repetitions that were planned for those sets; absent where one of them has no end.
    pub planned: Option<u32>,
    /// Repetitions counted.
    pub counted: u32,
    /// What a therapist counted in their place; absent where no set was corrected.
    pub corrected: Option<u32>,
    /// Repetitions seen and not counted.
    pub rejected: u32,
    /// Mean of the scores and of each part; absent where there is none.
    pub score: Option<Score>,
    /// Median duration of a repetition, s; absent where none counts.
    pub duration_s: Option<f64>,
    /// The joints of the lesson, in its order.
    pub joints: Vec<JointSummary>,
    /// What was said most often in English and German, and how often; absent where nothing was said of a counted repetition.
    pub sentence: Option<(String, String, u32)>,
}

/// What a joint did over the counted repetitions of an exercise, degrees.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointSummary {
    /// Name of the channel.
    pub name: String,
    /// Range of motion in the demonstration.
    pub taught_range_deg: f64,
    /// Median range of motion; absent where the joint was not seen.
    pub range_deg: Option<f64>,
    /// Median of the least angles.
    pub least_deg: Option<f64>,
    /// Median of the greatest angles.
    pub greatest_deg: Option<f64>,
}

impl Session {
    /// Its exercises, in the order in which they were first done; lessons of one name apart.
    pub fn exercises(&self) -> Vec<ExerciseSummary> {
        let mut lessons: Vec<&Arc<TaughtLesson>> = Vec::new();
        for set in &self.training {
            if !lessons.contains(&&set.lesson) {
                lessons.push(&set.lesson);
            }
        }
        lessons.into_iter().map(|lesson| ExerciseSummary::of(lesson, self.sets_of(lesson))).collect()
    }

    /// The sets of a lesson.
    pub fn sets_of<'a>(&'a self, lesson: &'a TaughtLesson) -> impl Iterator<Item = &'a TrainingSet> + Clone {
        self.training.iter().filter(move |set| *set.lesson == *lesson)
    }
}

impl ExerciseSummary {
    /// Of sets of a lesson.
    pub(crate) fn of<'a>(
        lesson: &Arc<TaughtLesson>,
        sets: impl Iterator<Item = &'a TrainingSet> + Clone,
    ) -> Self {
        let sets = || sets.clone();
        let counted: Vec<&Repetition> = sets().flat_map(TrainingSet::counted).collect();
        let is_corrected = sets().any(|set| set.corrected.is_some());
        let in_set = |set: &TrainingSet| set.corrected.unwrap_or(set.counted().count() as u32);
        let joint =
            |(joint, taught): (u32, &LessonJoint)| joint_summary(lesson, joint, &taught.name, &counted);
        Self {
            lesson: Arc::clone(lesson),
            sets: sets().count() as u32,
            planned: sets().map(|set| set.planned).sum(),
            counted: counted.len() as u32,
            corrected: is_corrected.then(|| sets().map(in_set).sum()),
            rejected: (sets().map(|set| set.repetitions.len()).sum::<usize>() - counted.len()) as u32,
            score: mean_score(&counted),
            duration_s: median(counted.iter().map(|repetition| repetition.duration_s())).map(time_s),
            joints: (0..).zip(&lesson.joints).map(joint).collect(),
            sentence: most_said(&counted),
        }
    }
}

fn joint_summary(lesson: &TaughtLesson, joint: u32, name: &str, counted: &[&Repetition]) -> JointSummary {
    let of = |angle: fn(&JointCourse) -> f64| {
        let seen =
            counted.iter().filter_map(|repetition| repetition.joints.iter().find(|seen| seen.joint == joint));
        median(seen.map(angle)).map(degrees)
    };
    JointSummary {
        name: name.to_owned(),
        taught_range_deg: lesson.range_deg(joint as usize),
        range_deg: of(JointCourse::range_deg),
        least_deg: of(|seen| seen.least_deg),
        greatest_deg: of(|seen| seen.greatest_deg),
    }
}

fn mean_score(counted: &[&Repetition]) -> Option<Score> {
    let mean = |part: fn(&Score) -> Option<f64>| {
        let parts: Vec<f64> = counted.iter().filter_map(|repetition| part(&repetition.score?)).collect();
        (!parts.is_empty()).then(|| points(parts.iter().sum::<f64>() / parts.len() as f64))
    };
    Some(Score {
        total: mean(|score| Some(score.total))?,
        amplitude: mean(|score| Some(score.amplitude))?,
        tempo: mean(|score| Some(score.tempo))?,
        smoothness: mean(|score| Some(score.smoothness))?,
        symmetry: mean(|score| score.symmetry),
    })
}

/// What was said most often, sizes apart: sentences that differ in their numbers alone are one, spoken as it was said last.
fn most_said(counted: &[&Repetition]) -> Option<(String, String, u32)> {
    let kind = |sentence: &str| sentence.chars().filter(|c| !c.is_ascii_digit()).collect::<String>();
    let mut said: Vec<(String, &Repetition, u32)> = Vec::new();
    for repetition in counted {
        let Some(sentence) = &repetition.sentence else { continue };
        match said.iter_mut().find(|(known, ..)| *known == kind(sentence)) {
            Some((_, newest, times)) => (*newest, *times) = (repetition, *times + 1),
            None => said.push((kind(sentence), repetition, 1)),
        }
    }
    // Of several the one that was said first.
    let (_, repetition, times) = said.into_iter().rev().max_by_key(|(.., times)| *times)?;
    Some((repetition.sentence.clone()?, repetition.sentence_de.clone()?, times))
}

/// Median; of an even number of values the mean of the middle two; `None` of none.
pub(crate) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => None,
        even if even % 2 == 0 => Some((values[middle - 1] + values[middle]) / 2.0),
        _ => Some(values[middle]),
    }
}

/// Median of the slopes of all pairs (Theil 1950, Sen 1968), per unit of the first number; `None` of fewer than three points, or
/// where all lie at one place.
pub(crate) fn slope(of: &[(f64, f64)]) -> Option<f64> {
    if of.len() < 3 {
        return None;
    }
    let pairs =
        of.iter().enumerate().flat_map(|(at, left)| of[at + 1..].iter().map(move |right| (left, right)));
    median(
        pairs
            .filter(|(left, right)| right.0 > left.0)
            .map(|(left, right)| (right.1 - left.1) / (right.0 - left.0)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_the_median_of_pairs_and_needs_three_points() {
        assert_eq!(slope(&[(0.0, 1.0), (1.0, 3.0)]), None);
        // One session that went quite another way moves it little: the slopes are 2, 2, 2, 2, 2, 2 and four of the last.
        let points = [(0.0, 1.0), (1.0, 3.0), (2.0, 5.0), (3.0, 7.0), (4.0, 90.0)];
        assert_eq!(slope(&points), Some(2.0));
        assert_eq!(slope(&[(1.0, 1.0), (1.0, 2.0), (1.0, 3.0)]), None);
        assert_eq!(median([3.0, 1.0].into_iter()), Some(2.0));
    }
}
