//! From outcomes of the exercise stage to the body of topic `exercise`.

use super::message::{Begun, Deviation, ExerciseChange, Judged, Spoken};
use super::round;
use posed_motion::exercise::{EventKind, Exercise, Feedback, Joint, Language, Remark, Score};
use posed_stage::output::{ExerciseWhat, LiveHint, Repetition};

/// Digits of ratios, phases and deviations.
const FINE: f64 = 1e4;
/// Digits of points and degrees.
const TENTHS: f64 = 10.0;
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
            let (sentence, sentence_de) = (None, None);
            ExerciseChange::Hint { exercise: None, phase: None, anomaly: false, sentence, sentence_de }
        }
        ExerciseWhat::Hint(Some(LiveHint { exercise, phase, anomaly, remark })) => {
            let said = |language| remark.as_ref().map(|(channel, remark)| remark.sentence(channel, language));
            ExerciseChange::Hint {
                exercise: Some(exercise.to_string()),
                phase: Some(round::to(FINE, *phase)),
                anomaly: *anomaly,
                sentence: said(Language::English),
                sentence_de: said(Language::German),
            }
        }
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
        remark: repetition.remark.as_ref().and_then(|remark| spoken(channel, remark)),
        sentence: repetition.sentence(Language::English),
        sentence_de: repetition.sentence(Language::German),
        // In points of a lesson only what counts can be measured.
        score: feedback.filter(|_| repetition.reason.is_none()).map(|(_, feedback)| score(&feedback.score)),
        deviation: feedback.map(|(channel, feedback)| deviation(channel, feedback)),
    }
}

/// A remark for programs; `channel` is the name of the channel that it speaks of.
fn spoken(channel: &str, remark: &Remark) -> Option<Spoken> {
    Some(match *remark {
        Remark::Deviation { deviation, kind, place, .. } => {
            let joint = Joint::of(channel)?;
            Spoken::Joint {
                joint: joint.joint.to_owned(),
                side: joint.side,
                movement: joint.movement.to_owned(),
                deviation_deg: round::to(TENTHS, deviation * joint.degrees),
                kind,
                place,
            }
        }
        Remark::Size(size) => Spoken::Size { size: round::to(FINE, size) },
        Remark::Tempo(tempo) => Spoken::Tempo { tempo: round::to(FINE, tempo) },
        Remark::Jerky => Spoken::Smoothness,
    })
}

fn score(score: &Score) -> Score {
    let tenths = |points| round::to(TENTHS, points);
    Score {
        total: tenths(score.total),
        amplitude: tenths(score.amplitude),
        tempo: tenths(score.tempo),
        smoothness: tenths(score.smoothness),
        symmetry: score.symmetry.map(tenths),
    }
}

fn deviation(channel: &str, feedback: &Feedback) -> Deviation {
    let fine = |value| round::to(FINE, value);
    Deviation {
        channel: channel.to_owned(),
        size: fine(feedback.deviation),
        worth: fine(feedback.worth),
        phase: fine(feedback.phase),
        range: fine(feedback.range),
        tempo: fine(feedback.tempo),
        fifth_tempo: feedback.fifth_tempo.map(fine),
        jerk: fine(feedback.jerk),
    }
}
