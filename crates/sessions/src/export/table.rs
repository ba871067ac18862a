//! CSV: one line per repetition.

use crate::repetition::Repetition;
use crate::{Session, TrainingSet};

/// The columns in front of those of the joints.
const COLUMNS: [&str; 20] = [
    "session",
    "person",
    "begun",
    "set",
    "exercise",
    "planned",
    "corrected",
    "number",
    "t_start_s",
    "t_end_s",
    "t_decided_s",
    "duration_s",
    "reason",
    "score",
    "amplitude",
    "tempo",
    "smoothness",
    "symmetry",
    "sentence",
    "sentence_de",
];

/// One line per repetition; for each joint `JOINT_least_deg`, `JOINT_greatest_deg` and `JOINT_range_deg`, JOINT being the name of its
/// channel without `_deg`. What is absent is an empty cell.
///
/// # Errors
/// There is no memory for it.
pub fn csv(sessions: &[Session]) -> Result<String, csv::Error> {
    let mut joints: Vec<&str> = Vec::new();
    let all = sessions.iter().flat_map(|session| &session.training);
    for joint in all.clone().flat_map(|set| &set.lesson.joints) {
        if !joints.contains(&joint.name.as_str()) {
            joints.push(&joint.name);
        }
    }
    let mut writer = csv::Writer::from_writer(Vec::new());
    let of_joints = joints.iter().flat_map(|joint| {
        let name = joint.strip_suffix("_deg").unwrap_or(joint);
        ["least", "greatest", "range"].map(|what| format!("{name}_{what}_deg"))
    });
    writer.write_record(COLUMNS.map(str::to_owned).into_iter().chain(of_joints))?;
    for session in sessions {
        for set in &session.training {
            for repetition in &set.repetitions {
                writer.write_record(line(session, set, repetition, &joints))?;
            }
        }
    }
    let bytes = writer.into_inner().map_err(|error| csv::Error::from(error.into_error()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn line(session: &Session, set: &TrainingSet, repetition: &Repetition, joints: &[&str]) -> Vec<String> {
    fn cell<T: ToString>(value: Option<T>) -> String {
        value.map_or_else(String::new, |value| value.to_string())
    }
    let score = repetition.score;
    let mut line = vec![
        session.summary.session.to_string(),
        session.summary.person.clone(),
        session.summary.begun.clone(),
        set.set.to_string(),
        set.lesson.exercise.clone(),
        cell(set.planned),
        cell(set.corrected),
        cell(repetition.number),
        repetition.t_start_s.to_string(),
        repetition.t_end_s.to_string(),
        repetition.t_decided_s.to_string(),
        repetition.duration_s().to_string(),
        cell(repetition.reason.map(|reason| reason.as_str())),
        cell(score.map(|score| score.total)),
        cell(score.map(|score| score.amplitude)),
        cell(score.map(|score| score.tempo)),
        cell(score.map(|score| score.smoothness)),
        cell(score.and_then(|score| score.symmetry)),
        cell(repetition.sentence.as_ref()),
        cell(repetition.sentence_de.as_ref()),
    ];
    for joint in joints {
        let seen = repetition.joints.iter().find(|seen| seen.name == *joint);
        line.push(cell(seen.map(|seen| seen.least_deg)));
        line.push(cell(seen.map(|seen| seen.greatest_deg)));
        line.push(cell(seen.map(|seen| seen.range_deg())));
    }
    line
}
