//! HL7 FHIR R4 (hl7.org/fhir/R4): a `Bundle` of type `collection` with a `Patient` and `Observation`s.
//!
//! Each exercise of a session is one observation, its figures are components with UCUM units. No public code system has codes for
//! them: they are of the system [`SYSTEM`], whose words `docs/sessions.md` lists, beside a text.

use serde_json::{Value, json};

use crate::Session;
use crate::summary::ExerciseSummary;

/// The code system of the figures: a name, not an address.
const SYSTEM: &str = "urn:posed:exercise";
/// UCUM, the system of units.
const UCUM: &str = "http://unitsofmeasure.org";

/// A bundle of all sessions; those that go on are marked as preliminary.
pub fn bundle(sessions: &[Session]) -> Value {
    let mut people: Vec<&str> = Vec::new();
    for session in sessions {
        if !people.contains(&session.summary.person.as_str()) {
            people.push(&session.summary.person);
        }
    }
    let patient_url =
        |name: &str| url(1, people.iter().position(|known| *known == name).unwrap_or(0) as u64 + 1);
    let patients = people.iter().map(|name| {
        json!({
            "fullUrl": patient_url(name),
            "resource": { "resourceType": "Patient", "identifier": [{ "system": "urn:posed:person", "value": name }] },
        })
    });
    let exercises = sessions
        .iter()
        .flat_map(|session| session.exercises().into_iter().map(move |exercise| (session, exercise)));
    let observations = (1..).zip(exercises).map(|(number, (session, exercise))| {
        json!({
            "fullUrl": url(2, number),
            "resource": observation(session, &exercise, &patient_url(&session.summary.person)),
        })
    });
    let entries: Vec<Value> = patients.chain(observations).collect();
    let mut bundle = json!({ "resourceType": "Bundle", "type": "collection" });
    // An empty list is none in FHIR.
    if !entries.is_empty() {
        bundle["entry"] = entries.into();
    }
    bundle
}

/// An address within the bundle: a UUID of version 8 (RFC 9562), whose bits are the author's own.
fn url(kind: u8, number: u64) -> String {
    format!("urn:uuid:{kind:08x}-0000-8000-8000-{number:012x}")
}

fn observation(session: &Session, exercise: &ExerciseSummary, patient: &str) -> Value {
    let summary = &session.summary;
    let name = &exercise.lesson.exercise;
    let goes_on = summary.ended_by.is_none();
    let mut period = json!({ "start": summary.begun });
    if let Some(end) = end(session) {
        period["end"] = end.into();
    }
    let mut components = vec![
        quantity("repetitions", "Repetitions counted", f64::from(exercise.counted), "{repetitions}", "1"),
        quantity(
            "rejected",
            "Repetitions seen and not counted",
            f64::from(exercise.rejected),
            "{repetitions}",
            "1",
        ),
        quantity("sets", "Sets", f64::from(exercise.sets), "{sets}", "1"),
    ];
    let mut add = |code: &str, text: &str, value: Option<f64>, unit: &str, ucum: &str| {
        components.extend(value.map(|value| quantity(code, text, value, unit, ucum)));
    };
    add(
        "corrected",
        "Repetitions as counted by a person",
        exercise.corrected.map(f64::from),
        "{repetitions}",
        "1",
    );
    add("planned", "Repetitions planned", exercise.planned.map(f64::from), "{repetitions}", "1");
    add("duration", "Median duration of a repetition", exercise.duration_s, "s", "s");
    let score = exercise.score;
    let parts = [
        ("score", "Score beside the lesson, 0 to 100", score.map(|score| score.total)),
        ("amplitude", "Amplitude beside the lesson, 0 to 100", score.map(|score| score.amplitude)),
        ("tempo", "Tempo beside the lesson, 0 to 100", score.map(|score| score.tempo)),
        ("smoothness", "Smoothness beside the lesson, 0 to 100", score.map(|score| score.smoothness)),
        ("symmetry", "Symmetry, 0 to 100", score.and_then(|score| score.symmetry)),
    ];
    for (code, text, value) in parts {
        add(code, text, value, "points", "{score}");
    }
    for joint in &exercise.joints {
        let name = joint.name.strip_suffix("_deg").unwrap_or(&joint.name);
        let text = |what: &str| format!("{what} of {}", name.replace('_', " "));
        let angles = [
            ("range", "Median range of motion", joint.range_deg),
            ("least", "Median least angle", joint.least_deg),
            ("greatest", "Median greatest angle", joint.greatest_deg),
        ];
        for (code, what, value) in angles {
            add(&format!("{code}-{}", name.replace('_', "-")), &text(what), value, "degree", "deg");
        }
    }
    json!({
        "resourceType": "Observation",
        "status": if goes_on { "preliminary" } else { "final" },
        "code": { "coding": [{ "system": SYSTEM, "code": "exercise", "display": "Exercise" }], "text": format!("Exercise: {name}") },
        "subject": { "reference": patient },
        "effectivePeriod": period,
        "component": components,
    })
}

/// When a session ended, in UTC.
fn end(session: &Session) -> Option<String> {
    let begun: jiff::Timestamp = session.summary.begun.parse().ok()?;
    let duration = jiff::SignedDuration::from_secs(session.summary.duration_s?.round() as i64);
    Some(begun.checked_add(duration).ok()?.to_string())
}

fn quantity(code: &str, text: &str, value: f64, unit: &str, ucum: &str) -> Value {
    json!({
        "code": { "coding": [{ "system": SYSTEM, "code": code }], "text": text },
        "valueQuantity": { "value": value, "unit": unit, "system": UCUM, "code": ucum },
    })
}
