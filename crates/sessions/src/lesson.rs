//! A lesson: the exercise that repetitions are compared with, as far as a report shows it.

use std::sync::Arc;

use serde::{Deserialize, Serialize, Serializer};

use crate::number::degrees;
use crate::repetition::POINTS;
use posed_motion::exercise::{Exercise, Joint};

/// Joints of a lesson that are kept at most.
const JOINTS: usize = 64;

/// An exercise as it was taught.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaughtLesson {
    /// Name of the exercise.
    pub exercise: String,
    /// How often an exercise of this name was taught until then.
    pub revision: u32,
    /// Median duration of its repetitions, s.
    pub duration_s: f64,
    /// The angles among its channels, in their order; without those that a hanging arm does not have (plane and rotation of a
    /// shoulder).
    pub joints: Vec<LessonJoint>,
}

/// An angle of a lesson.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LessonJoint {
    /// Name of the channel: `elbow_r_flexion_deg`.
    pub name: String,
    /// The demonstration, [`POINTS`] angles from its beginning to its end, degrees to a hundredth.
    pub demonstration_deg: Vec<f64>,
}

/// Writes a shared lesson as one's own.
pub(crate) fn shared<S: Serializer>(lesson: &Arc<TaughtLesson>, serializer: S) -> Result<S::Ok, S::Error> {
    lesson.serialize(serializer)
}

impl TaughtLesson {
    /// What an exercise shows.
    pub fn of(exercise: &Exercise) -> Self {
        let means = &exercise.movement.states.mean;
        let joint = |(name, states): (&String, &Vec<f64>)| {
            let joint = Joint::of(name).filter(|joint| !joint.needs_a_lifted_arm())?;
            let demonstration_deg = resampled(states, joint.degrees);
            Some(LessonJoint { name: name.clone(), demonstration_deg })
        };
        Self {
            exercise: exercise.name.clone(),
            revision: exercise.revision,
            duration_s: crate::number::time_s(exercise.durations.median_s),
            joints: exercise.channels.iter().zip(means).filter_map(joint).take(JOINTS).collect(),
        }
    }

    /// Range of an angle in the demonstration, degrees.
    pub fn range_deg(&self, joint: usize) -> f64 {
        let course = self.joints.get(joint).map_or(&[][..], |joint| &joint.demonstration_deg);
        let (least, greatest) = bounds(course);
        degrees(greatest - least)
    }
}

/// Least and greatest value; zeros of none.
pub(crate) fn bounds(values: &[f64]) -> (f64, f64) {
    let of = |pick: fn(f64, f64) -> f64| values.iter().copied().reduce(pick).unwrap_or(0.0);
    (of(f64::min), of(f64::max))
}

/// Values at equal distances, at [`POINTS`] of them, linearly between neighbours; `degrees` per unit.
pub(crate) fn resampled(values: &[f64], degrees_per_unit: f64) -> Vec<f64> {
    (0..POINTS).map(|point| degrees(course_at(values, point, POINTS) * degrees_per_unit)).collect()
}

/// The value of a course at one of `points` equally distant points (2 or more), linearly between neighbours; 0 of none.
pub fn course_at(values: &[f64], point: usize, points: usize) -> f64 {
    let Some(last) = values.len().checked_sub(1) else { return 0.0 };
    let at = last as f64 * point as f64 / (points - 1) as f64;
    let (left, share) = (at as usize, at.fract());
    let (left, right) = (values[left], values[(left + 1).min(last)]);
    left + share * (right - left)
}
