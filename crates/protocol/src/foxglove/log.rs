//! Events as sentences with a level, for the viewers' log.

use crate::Names;
use posed_field::Warning;
use posed_motion::exercise::EventKind;
use posed_stage::input::Model;
use posed_stage::output::{ExerciseWhat, FieldNews, Outcome, OutcomeKind, Phase, SegmentEvent};

/// How grave it is, as `foxglove.Log` numbers it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    Debug = 1,
    Info = 2,
    Warning = 3,
}

/// Level, who it is about, and the sentence.
pub(super) fn sentence(outcome: &Outcome, names: &Names) -> Option<(Level, String, String)> {
    let of_sensor = |sensor: usize| u16::try_from(sensor).map_or("", |sensor| names.sensor(sensor));
    let (level, name, sentence) = match &outcome.what {
        OutcomeKind::Fault { sensor, cause, active: true } => {
            (Level::Warning, names.sensor(*sensor), cause.words().to_owned())
        }
        OutcomeKind::Fault { sensor, cause, active: false } => {
            (Level::Info, names.sensor(*sensor), format!("over: {}", cause.words()))
        }
        OutcomeKind::ModelSwapped(model) => (Level::Info, "stage", swapped(model)),
        OutcomeKind::Exercise(outcome) => {
            let (level, sentence) = match &outcome.what {
                ExerciseWhat::Repetition(repetition) => {
                    let name = &repetition.exercise;
                    match repetition.kind {
                        EventKind::Counted => (Level::Info, format!("{name}: {} counted", repetition.count)),
                        EventKind::Rejected => (Level::Info, format!("{name}: a repetition does not count")),
                        EventKind::Withdrawn => {
                            (Level::Debug, format!("{name}: it was no repetition after all"))
                        }
                        EventKind::Started => (Level::Debug, format!("{name}: a repetition begins")),
                        EventKind::Provisional => {
                            (Level::Debug, format!("{name}: a repetition seems complete"))
                        }
                    }
                }
                ExerciseWhat::State(_) => (Level::Debug, "what is counted has changed".to_owned()),
                ExerciseWhat::Hint(Some(hint)) if hint.anomaly => {
                    (Level::Info, format!("{}: this looks like something else", hint.exercise))
                }
                ExerciseWhat::Hint(_) => return None,
            };
            return Some((level, outcome.subject.to_string(), sentence));
        }
        OutcomeKind::KeyPose(event) => {
            let what = if event.corner { "corner" } else { "key pose" };
            let sentence = match event.phase {
                Phase::Provisional => return None,
                Phase::Confirmed => format!("{what}, score {:.1}", event.score),
                Phase::Withdrawn => format!("no {what} after all"),
            };
            (Level::Debug, names.sensor(event.sensor), sentence)
        }
        OutcomeKind::Mark { label } => (Level::Info, "mark", label.clone()),
        OutcomeKind::MotionSegment(segment) => match segment.event {
            SegmentEvent::Confirmed => (Level::Info, "segments", format!("{} begins", segment.label)),
            SegmentEvent::Provisional => {
                (Level::Debug, "segments", format!("{} seems to begin", segment.label))
            }
            SegmentEvent::Withdrawn => {
                (Level::Debug, "segments", format!("{} does not begin", segment.label))
            }
        },
        OutcomeKind::Field(FieldNews::Warning(Warning::Disturbed {
            sensors: [a, b],
            deviation_m,
            active,
            ..
        })) => {
            let who = pair(of_sensor(*a), of_sensor(*b));
            if *active {
                let millimetres = deviation_m * 1e3;
                (
                    Level::Warning,
                    "field",
                    format!("the field is disturbed: {who} deviates by {millimetres:.0} mm"),
                )
            } else {
                (Level::Info, "field", format!("over: the field was disturbed at {who}"))
            }
        }
        OutcomeKind::Field(FieldNews::Warning(Warning::Drifted { sensors: [a, b], deviation_m })) => {
            let who = pair(of_sensor(*a), of_sensor(*b));
            let millimetres = deviation_m * 1e3;
            let sentence = format!(
                "the field is not the calibrated one any more: {who} deviates by {millimetres:.0} mm; calibrate again"
            );
            (Level::Warning, "field", sentence)
        }
        OutcomeKind::Field(FieldNews::Progress(progress)) => {
            let percent = progress.covered * 100.0;
            (Level::Debug, "field", format!("calibration: {percent:.0} % of the room has been seen"))
        }
    };
    Some((level, name.to_owned(), sentence))
}

/// A reference sensor, or a pair.
fn pair(a: &str, b: &str) -> String {
    if a == b { a.to_owned() } else { format!("{a} and {b}") }
}

fn swapped(model: &Model) -> String {
    match model {
        Model::Transmitter { .. } => "the transmitter's place in the room is set".to_owned(),
        Model::TrackerNoise { device, .. } => format!("the noise of {device} is set"),
        Model::Field { map: Some(_), version } => format!("map {version} of the field is in use"),
        Model::Field { map: None, .. } => "no map of the field is in use".to_owned(),
        Model::Mounting { body: Some(name), .. } => format!("the sensors of {name} are calibrated"),
        Model::Mounting { body: None, .. } => "the body's sensors are calibrated".to_owned(),
        Model::AttachedImu { sensor, .. } => format!("how the IMU sits on {sensor} is set"),
        Model::Chain { .. } => "the chain is calibrated".to_owned(),
        Model::Imu { unit, .. } => format!("the IMU {unit} is calibrated"),
        Model::Exercise { exercise } => format!("the exercise {} is loaded", exercise.name),
        Model::Faults { fault_map } => format!("the fault map {} is in use", fault_map.revision),
    }
}
