//! Repetitions that nobody has done, for tests.

use std::sync::Arc;

use crate::lesson::{LessonJoint, TaughtLesson};
use crate::number::{degrees, points, time_s};
use crate::repetition::{JointCourse, POINTS, Repetition, Score};
use posed_motion::exercise::Reason;

/// A lesson of so many joints, each of which goes `range_deg` and back.
pub(crate) fn lesson(exercise: &str, joints: usize, range_deg: f64) -> Arc<TaughtLesson> {
    let names =
        ["elbow_r_flexion_deg", "elbow_l_flexion_deg", "shoulder_r_elevation_deg", "hip_r_flexion_deg"];
    let joint = |at: usize| LessonJoint {
        name: names.get(at).map_or_else(|| format!("joint{at}_deg"), |name| (*name).to_owned()),
        demonstration_deg: course(range_deg),
    };
    Arc::new(TaughtLesson {
        exercise: exercise.to_owned(),
        revision: 1,
        duration_s: 2.0,
        joints: (0..joints).map(joint).collect(),
    })
}

fn course(range_deg: f64) -> Vec<f64> {
    let half = (POINTS - 1) as f64 / 2.0;
    (0..POINTS).map(|at| degrees(5.0 + range_deg * (1.0 - (at as f64 / half - 1.0).abs()))).collect()
}

/// A repetition at a time; the joints go `range_deg` and back.
pub(crate) fn repetition(
    lesson: &Arc<TaughtLesson>,
    number: u32,
    t_start_s: f64,
    range_deg: f64,
) -> Repetition {
    let courses = (0..).zip(&lesson.joints).map(|(joint, taught)| JointCourse {
        joint,
        name: taught.name.clone(),
        least_deg: 5.0,
        greatest_deg: degrees(5.0 + range_deg),
        course_deg: course(range_deg),
    });
    Repetition {
        subject: "default".to_owned(),
        lesson: Arc::clone(lesson),
        begins_set: number == 1,
        planned: Some(10),
        number: Some(number),
        t_start_s: time_s(t_start_s),
        t_end_s: time_s(t_start_s + 2.1),
        t_decided_s: time_s(t_start_s + 2.4),
        reason: None,
        score: Some(Score {
            total: points(80.0 + f64::from(number)),
            amplitude: points(range_deg),
            tempo: 100.0,
            smoothness: 95.5,
            symmetry: None,
        }),
        sentence: (number == 3).then(|| "right elbow bent 20 degrees less than shown at the top".to_owned()),
        sentence_de: (number == 3)
            .then(|| "rechter Ellenbogen 20 Grad weniger gebeugt als gezeigt".to_owned()),
        joints: courses.collect(),
    }
}

/// One that was not counted.
pub(crate) fn rejected(lesson: &Arc<TaughtLesson>, t_start_s: f64) -> Repetition {
    Repetition {
        number: None,
        begins_set: false,
        reason: Some(Reason::TooSmall),
        score: None,
        ..repetition(lesson, 2, t_start_s, 20.0)
    }
}
