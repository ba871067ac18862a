//! The report of one session.

use super::html::Page;
use super::{Reader, chart};
use crate::Session;
use crate::session::TrainingSet;
use crate::summary::ExerciseSummary;
use posed_motion::exercise::Language;

/// One session: each exercise with its sets, its joints beside the demonstration, and what was said most often.
pub fn session(session: &Session, reader: &Reader) -> String {
    let summary = &session.summary;
    let title = format!("{}, {}", summary.person, reader.moment(&summary.begun));
    let mut page = Page::new(reader, &title);
    let mut about = format!(
        "{} {} · {} · {} {}",
        reader.say("Session", "Sitzung"),
        summary.session,
        reader.minutes(summary.duration_s),
        reader.say("stage", "Bühne"),
        session.stage,
    );
    if let Some(plan) = &summary.plan {
        about.push_str(&format!(" · {} {plan}", reader.say("plan", "Plan")));
    }
    if let Some(recording) = &summary.recording {
        about.push_str(&format!(" · {} {recording}", reader.say("recording", "Aufzeichnung")));
    }
    page.note(&about);
    match reader.ended_by(summary.ended_by) {
        "" => {}
        sentence => page.note(sentence),
    }
    let exercises = session.exercises();
    if exercises.is_empty() {
        page.note(reader.say("No repetition was seen.", "Es wurde keine Wiederholung gesehen."));
    }
    for exercise in &exercises {
        one_exercise(&mut page, session, exercise, reader);
    }
    if !exercises.is_empty() {
        page.note(explanation(reader));
    }
    page.finish()
}

/// How the figures are to be read.
pub(super) fn explanation(reader: &Reader) -> &'static str {
    reader.say(
        "Scores go from 0 to 100, 100 is as taught: amplitude (how far the joints went; half of the total), tempo (0.2), smoothness \
         (0.15) and, where both sides move, symmetry (0.15). Range of motion is the greatest less the least angle of a repetition; \
         tables show medians over the counted repetitions. Curves: the demonstration thick, each repetition thin.",
        "Punkte gehen von 0 bis 100, 100 ist wie gezeigt: Umfang (wie weit die Gelenke gingen; die Hälfte der Summe), Tempo (0,2), \
         Flüssigkeit (0,15) und, wo sich beide Seiten bewegen, Symmetrie (0,15). Bewegungsumfang ist der größte weniger der kleinste \
         Winkel einer Wiederholung; Tabellen zeigen Mediane über die gezählten Wiederholungen. Kurven: die Vorführung dick, jede \
         Wiederholung dünn.",
    )
}

fn one_exercise(page: &mut Page, session: &Session, exercise: &ExerciseSummary, reader: &Reader) {
    page.heading(&exercise.lesson.exercise);
    page.note(&counts(exercise, reader));
    if let Some((english, german, times)) = &exercise.sentence {
        let sentence = match reader.language {
            Language::English => english,
            Language::German => german,
        };
        let most = reader.say("Said most often", "Am häufigsten gesagt");
        page.note(&format!("{most}: “{sentence}” ({times} ×)"));
    }
    sets(page, session, exercise, reader);
    joints(page, exercise, reader);
    let courses = (0..).zip(&exercise.lesson.joints).filter_map(|(at, joint)| {
        let counted = session.sets_of(&exercise.lesson).flat_map(TrainingSet::counted);
        let own = counted.filter_map(|repetition| repetition.joints.iter().find(|seen| seen.joint == at));
        let own: Vec<&[f64]> = own.map(|seen| seen.course_deg.as_slice()).collect();
        let name = reader.joint(&joint.name);
        let ends = [reader.say("beginning", "Anfang"), reader.say("end", "Ende")];
        let svg = (!own.is_empty()).then(|| chart::courses(&name, &joint.demonstration_deg, &own, ends))?;
        Some((format!("{name} (°)"), svg))
    });
    page.charts(courses);
}

/// How often, in words.
pub(super) fn counts(exercise: &ExerciseSummary, reader: &Reader) -> String {
    let mut counts =
        format!("{} {}", exercise.counted, reader.say("repetitions counted", "Wiederholungen gezählt"));
    if let Some(planned) = exercise.planned {
        counts.push_str(&format!(" ({} {planned})", reader.say("planned", "geplant")));
    }
    if let Some(corrected) = exercise.corrected {
        counts.push_str(&format!(
            ", {} {corrected}",
            reader.say("corrected by hand to", "von Hand berichtigt auf")
        ));
    }
    if exercise.rejected > 0 {
        counts.push_str(&format!(", {} {}", exercise.rejected, reader.say("not counted", "nicht gezählt")));
    }
    counts
}

fn sets(page: &mut Page, session: &Session, exercise: &ExerciseSummary, reader: &Reader) {
    let headings = [
        reader.say("Set", "Satz"),
        reader.say("Counted", "Gezählt"),
        reader.say("Not counted", "Nicht gezählt"),
        reader.say("Score", "Punkte"),
        reader.say("Amplitude", "Umfang"),
        reader.say("Tempo", "Tempo"),
        reader.say("Smoothness", "Flüssigkeit"),
        reader.say("Symmetry", "Symmetrie"),
        reader.say("Duration (s)", "Dauer (s)"),
    ];
    let rows = session.sets_of(&exercise.lesson).map(|set| {
        let figures = ExerciseSummary::of(&exercise.lesson, std::iter::once(set));
        let score = figures.score;
        let points = |part: Option<f64>| reader.number(part, 0);
        let mut counted = figures.counted.to_string();
        if let Some(corrected) = set.corrected {
            counted.push_str(&format!(" → {corrected}"));
        }
        vec![
            set.set.to_string(),
            counted,
            figures.rejected.to_string(),
            points(score.map(|score| score.total)),
            points(score.map(|score| score.amplitude)),
            points(score.map(|score| score.tempo)),
            points(score.map(|score| score.smoothness)),
            points(score.and_then(|score| score.symmetry)),
            reader.number(figures.duration_s, 1),
        ]
    });
    page.table(&headings, rows);
}

/// The joints beside the demonstration.
fn joints(page: &mut Page, exercise: &ExerciseSummary, reader: &Reader) {
    if exercise.joints.is_empty() {
        return;
    }
    let headings = [
        reader.say("Joint", "Gelenk"),
        reader.say("Range of motion (°)", "Bewegungsumfang (°)"),
        reader.say("taught (°)", "gezeigt (°)"),
        reader.say("least (°)", "kleinster (°)"),
        reader.say("greatest (°)", "größter (°)"),
    ];
    let rows = exercise.joints.iter().map(|joint| {
        vec![
            reader.joint(&joint.name),
            reader.number(joint.range_deg, 0),
            reader.number(Some(joint.taught_range_deg), 0),
            reader.number(joint.least_deg, 0),
            reader.number(joint.greatest_deg, 0),
        ]
    });
    page.table(&headings, rows);
}
