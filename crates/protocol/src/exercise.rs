//! From outcomes of the exercise stage to the body of topic `exercise`.

use super::message::{Begun, Deviation, ExerciseChange, Judged};
use super::round;
use posed_motion::exercise::{EventKind, Exercise, Feedback, Remark};
use posed_stage::output::{ExerciseWhat, LiveHint, Repetition};

/// Digits of ratios, phases and deviations.
const FINE: f64 = 1e4;
/// Digits of times.
const MICROSECONDS: f64 = 1e6;

/// What clients receive of an exercise that was swapped in: not all of its numbers.
pub(super) fn loaded(exercise: &Exercise) -> ExerciseChange {
    ExerciseChange::Loaded {
        exercise: exercise.name.clone(),
        revision: exercise.revision,
        channels: exercise.channels.clone(),
        duration_s: round::to(FINE, exercise.durations.median_s),
    }
}

/// What clients receive of an outcome.
pub(super) fn change(what: &ExerciseWhat) -> ExerciseChange {
    match what {
        ExerciseWhat::State(state) => {
            let mut state = state.clone();
            for progress in &mut state.exercises {
                progress.rest_until_s = progress.rest_until_s.map(|t_s| round::to(MICROSECONDS, t_s));
            }
            ExerciseChange::State { state }
        }
        ExerciseWhat::Repetition(repetition) => match repetition.kind {
            EventKind::Started => ExerciseChange::Started(begun(repetition)),
            EventKind::Provisional => ExerciseChange::Provisional(begun(repetition)),
            EventKind::Withdrawn => ExerciseChange::Withdrawn(begun(repetition)),
            EventKind::Counted => ExerciseChange::Counted(judged(repetition)),
            EventKind::Rejected => ExerciseChange::Rejected(judged(repetition)),
        },
        ExerciseWhat::Hint(None) => {
            ExerciseChange::Hint { exercise: None, phase: None, anomaly: false, sentence: None }
        }
        ExerciseWhat::Hint(Some(LiveHint { exercise, phase, anomaly, remark })) => ExerciseChange::Hint {
            exercise: Some(exercise.to_string()),
            phase: Some(round::to(FINE, *phase)),
            anomaly: *anomaly,
            sentence: remark.as_ref().map(|(channel, remark)| remark.sentence(channel)),
        },
    }
}

fn begun(repetition: &Repetition) -> Begun {
    Begun {
        exercise: repetition.exercise.to_string(),
        count: repetition.count,
        set_count: repetition.set_count,
        t_start_s: round::to(MICROSECONDS, repetition.t_start_s),
    }
}

fn judged(repetition: &Repetition) -> Judged {
    let feedback = repetition.feedback.as_ref();
    let channel = feedback.map_or("", |(channel, _)| channel);
    Judged {
        exercise: repetition.exercise.to_string(),
        count: repetition.count,
        set_count: repetition.set_count,
        t_start_s: round::to(MICROSECONDS, repetition.t_start_s),
        reason: repetition.reason,
        sentence: repetition.remark.as_ref().map(|remark: &Remark| remark.sentence(channel)),
        deviation: feedback.map(|(channel, feedback)| deviation(channel, feedback)),
    }
}

fn deviation(channel: &str, feedback: &Feedback) -> Deviation {
    let fine = |value| round::to(FINE, value);
    Deviation {
        channel: channel.to_owned(),
        size: fine(feedback.deviation),
        size_sd: fine(feedback.deviation_sd),
        phase: fine(feedback.phase),
        range: fine(feedback.range),
        tempo: fine(feedback.tempo),
        fifth_tempo: feedback.fifth_tempo.map(fine),
        jerk: fine(feedback.jerk),
    }
}
