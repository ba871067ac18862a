//! Repetitions with the course of their joints, from what the pipeline puts out.
//!
//! What comes in: every output, in order, live or of a replay. What goes out: each repetition that was counted or rejected, with
//! its lesson, its place in a set and the angles from its beginning to its end. What it never does: decide whether it counts.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use crate::lesson::{LessonJoint, TaughtLesson, bounds, resampled};
use crate::number::{degrees, points, time_s};
use crate::repetition::{JointCourse, Repetition, Score};
use posed_motion::exercise::{EventKind, Exercise, Language};
use posed_stage::input::Model;
use posed_stage::layout::BodyLayout;
use posed_stage::output::{Body, ExerciseOutcome, ExerciseState, ExerciseWhat, Outcome, OutcomeKind, Output};
use posed_stage::{LoadedModels, Stage, output};

/// How far back angles are remembered, s: longer repetitions have no courses.
const MEMORY_S: f64 = 120.0;
/// Rows of angles that are remembered at most.
const ROWS: usize = 16_384;
/// Least distance of two rows, s.
const ROW_INTERVAL_S: f64 = 0.005;
/// An angle that was not seen for longer within a repetition has no course, s.
const GAP_S: f64 = 0.5;
/// Fewest rows of a course.
const FEWEST_ROWS: usize = 6;

/// Follows a stage.
#[derive(Debug)]
pub struct Follower {
    /// What each body did, in the stage's order.
    bodies: Vec<Course>,
    /// By subject, the body that is counted for it.
    counted: BTreeMap<String, usize>,
    lessons: BTreeMap<String, Arc<TaughtLesson>>,
    /// By subject and exercise.
    sets: BTreeMap<(String, String), SetInProgress>,
}

/// The newest angles of a body.
#[derive(Debug)]
struct Course {
    /// Its name.
    name: String,
    /// Name of each shown angle, and its index in [`Body::angles_rad`].
    angles: Vec<(String, usize)>,
    /// Times of the rows, s.
    t_s: VecDeque<f64>,
    /// Row by row, an angle in degrees per shown angle; NaN where it is not known.
    rows: VecDeque<f32>,
}

impl Course {
    fn new(name: &str, layout: Option<&BodyLayout>) -> Self {
        let angles =
            layout.into_iter().flat_map(|layout| layout.columns().zip(layout.shown_angles.iter().copied()));
        Self { name: name.to_owned(), angles: angles.collect(), t_s: VecDeque::new(), rows: VecDeque::new() }
    }

    fn push(&mut self, body: &Body) {
        let t_s = body.t_valid.as_secs_f64();
        if self.angles.is_empty() || self.t_s.back().is_some_and(|last_s| t_s < last_s + ROW_INTERVAL_S) {
            return;
        }
        while self.t_s.len() >= ROWS || self.t_s.front().is_some_and(|first_s| *first_s < t_s - MEMORY_S) {
            self.t_s.pop_front();
            self.rows.drain(..self.angles.len());
        }
        self.t_s.push_back(t_s);
        let angle = |(_, index): &(String, usize)| {
            body.angles_rad[*index].map_or(f32::NAN, |angle_rad| angle_rad.to_degrees() as f32)
        };
        self.rows.extend(self.angles.iter().map(angle));
    }

    /// What the joints of a lesson did between two times.
    fn courses(&self, lesson: &TaughtLesson, t_start_s: f64, t_end_s: f64) -> Vec<JointCourse> {
        let first = self.t_s.partition_point(|t_s| *t_s < t_start_s);
        let after = self.t_s.partition_point(|t_s| *t_s <= t_end_s);
        let known_from_s = self.t_s.front().copied().unwrap_or(f64::INFINITY);
        // What began before the oldest row was not seen from its beginning.
        if t_start_s < known_from_s || after < first + FEWEST_ROWS {
            return Vec::new();
        }
        let course = |(joint, taught): (u32, &LessonJoint)| {
            let column = self.angles.iter().position(|(name, _)| *name == taught.name)?;
            let angle = |row: usize| f64::from(self.rows[row * self.angles.len() + column]);
            let known = (first..after).map(|row| (self.t_s[row], angle(row)));
            let known: Vec<(f64, f64)> = known.filter(|(_, angle)| angle.is_finite()).collect();
            let ends = [(t_start_s, 0.0), (t_end_s, 0.0)];
            let times = ends[..1].iter().chain(&known).chain(&ends[1..]);
            let times: Vec<f64> = times.map(|(t_s, _)| *t_s).collect();
            if known.is_empty() || times.windows(2).any(|pair| pair[1] - pair[0] > GAP_S) {
                return None;
            }
            let values: Vec<f64> = known.iter().map(|(_, angle)| *angle).collect();
            let (least, greatest) = bounds(&values);
            Some(JointCourse {
                joint,
                name: taught.name.clone(),
                least_deg: degrees(least),
                greatest_deg: degrees(greatest),
                course_deg: resampled(&at_equal_times(&known, t_start_s, t_end_s), 1.0),
            })
        };
        (0..).zip(&lesson.joints).filter_map(course).collect()
    }
}

/// How far the set of a subject in an exercise is.
#[derive(Clone, Copy, Debug)]
struct SetInProgress {
    planned: Option<u32>,
    counted: u32,
    /// Nothing was seen yet since the exercise was selected or reset.
    is_new: bool,
}

impl Default for SetInProgress {
    fn default() -> Self {
        Self { planned: None, counted: 0, is_new: true }
    }
}

impl Follower {
    /// For a stage, with the models that are in use.
    pub fn new(stage: &Stage, models: &LoadedModels) -> Self {
        let bodies = stage.bodies.iter().zip(BodyLayout::all(stage));
        let mut follower = Self {
            bodies: bodies.map(|(body, layout)| Course::new(&body.name, layout.as_ref())).collect(),
            counted: BTreeMap::new(),
            lessons: BTreeMap::new(),
            sets: BTreeMap::new(),
        };
        models.iter().for_each(|model| follower.model(model));
        follower
    }

    /// Takes an output; gives a repetition that is decided with it.
    pub fn output(&mut self, output: &Output<'_>) -> Option<Repetition> {
        match output {
            Output::Body(body) => {
                if let Some(course) = self.bodies.get_mut(usize::from(body.index)) {
                    course.push(body);
                }
            }
            Output::Outcome(Outcome { what: OutcomeKind::ModelSwapped(model), .. }) => self.model(model),
            Output::Outcome(outcome) => {
                let OutcomeKind::Exercise(ExerciseOutcome { subject, what }) = &outcome.what else {
                    return None;
                };
                match what {
                    ExerciseWhat::State(state) => self.state(subject, state),
                    ExerciseWhat::Repetition(repetition) => {
                        return self.repetition(outcome, subject, repetition);
                    }
                    ExerciseWhat::Hint(_) => {}
                }
            }
            _ => {}
        }
        None
    }

    fn model(&mut self, model: &Model) {
        if let Model::Exercise { exercise } = model {
            self.teach(exercise);
        }
    }

    fn teach(&mut self, exercise: &Exercise) {
        self.lessons.insert(exercise.name.clone(), Arc::new(TaughtLesson::of(exercise)));
    }

    fn state(&mut self, subject: &str, state: &ExerciseState) {
        let body = self.bodies.iter().position(|body| Some(&body.name) == state.body.as_ref());
        self.counted.insert(subject.to_owned(), body.unwrap_or(0));
        // What is no longer selected has ended.
        self.sets.retain(|(of, exercise), _| {
            of != subject || state.exercises.iter().any(|progress| progress.exercise == *exercise)
        });
        for progress in &state.exercises {
            let set = self.sets.entry((subject.to_owned(), progress.exercise.clone())).or_default();
            set.planned = state.repetitions;
            set.is_new |= progress.count == 0;
        }
    }

    fn repetition(
        &mut self,
        outcome: &Outcome,
        subject: &str,
        repetition: &output::Repetition,
    ) -> Option<Repetition> {
        let is_counted = match repetition.kind {
            EventKind::Counted => true,
            EventKind::Rejected if repetition.is_attempt => false,
            EventKind::Rejected | EventKind::Started | EventKind::Provisional | EventKind::Withdrawn => {
                return None;
            }
        };
        let exercise = repetition.exercise.to_string();
        // Of a recording that begins in the middle of a run, an exercise may be selected that was not loaded since.
        let lesson = self.lessons.get(&exercise)?.clone();
        let set = self.sets.entry((subject.to_owned(), exercise)).or_default();
        // What comes after the last planned one still belongs to that set, also what is seen in the rest.
        let begins_set = set.is_new || (is_counted && repetition.set_count <= set.counted);
        if begins_set {
            (set.counted, set.is_new) = (0, false);
        }
        if is_counted {
            set.counted = repetition.set_count;
        }
        let planned = set.planned;
        let feedback = repetition.feedback.as_ref();
        let (t_start_s, t_end_s) = (repetition.t_start_s, outcome.t_valid.as_secs_f64());
        Some(Repetition {
            subject: subject.to_owned(),
            begins_set,
            planned,
            number: is_counted.then_some(repetition.set_count),
            t_start_s: time_s(t_start_s),
            t_end_s: time_s(t_end_s),
            t_decided_s: time_s(outcome.t_decided.as_secs_f64()),
            reason: repetition.reason,
            score: feedback.filter(|_| is_counted).map(|(_, feedback)| score(&feedback.score)),
            sentence: repetition.sentence(Language::English),
            sentence_de: repetition.sentence(Language::German),
            joints: self.courses(subject, &lesson, t_start_s, t_end_s),
            lesson,
        })
    }

    /// What the joints of a lesson did between two times.
    fn courses(
        &self,
        subject: &str,
        lesson: &TaughtLesson,
        t_start_s: f64,
        t_end_s: f64,
    ) -> Vec<JointCourse> {
        let body = self.counted.get(subject).copied().unwrap_or(0);
        self.bodies.get(body).map_or_else(Vec::new, |body| body.courses(lesson, t_start_s, t_end_s))
    }
}

/// As many values at equal times between two, linearly between neighbours.
fn at_equal_times(known: &[(f64, f64)], t_start_s: f64, t_end_s: f64) -> Vec<f64> {
    let last = crate::POINTS - 1;
    let value = |point: usize| {
        let t_s = t_start_s + (t_end_s - t_start_s) * point as f64 / last as f64;
        let after = known.partition_point(|(known_s, _)| *known_s < t_s);
        match (after.checked_sub(1).map(|before| known[before]), known.get(after)) {
            (Some((t0_s, a0)), Some((t1_s, a1))) => a0 + (a1 - a0) * (t_s - t0_s) / (t1_s - t0_s),
            (Some((_, angle)), None) => angle,
            (None, Some((_, angle))) => *angle,
            (None, None) => 0.0,
        }
    };
    (0..=last).map(value).collect()
}

fn score(score: &posed_motion::exercise::Score) -> Score {
    Score {
        total: points(score.total),
        amplitude: points(score.amplitude),
        tempo: points(score.tempo),
        smoothness: points(score.smoothness),
        symmetry: score.symmetry.map(points),
    }
}
