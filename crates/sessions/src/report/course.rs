//! The report of a course of weeks.

use super::html::Page;
use super::session::{counts, explanation};
use super::{Reader, chart};
use crate::Session;
use crate::summary::{ExerciseSummary, slope};

/// Seconds of a week.
const WEEK_S: f64 = 7.0 * 86_400.0;

/// An exercise in one session of the course.
struct Visit<'a> {
    session: &'a Session,
    /// Weeks since the first session.
    week: f64,
    exercise: ExerciseSummary,
}

/// A course: each exercise over all sessions, its figures over the weeks with their trend. `sessions` are those of one person, the oldest
/// first.
pub fn course(person: &str, sessions: &[Session], reader: &Reader) -> String {
    let mut page = Page::new(reader, person);
    let (Some(first), Some(last)) = (sessions.first(), sessions.last()) else {
        page.note(reader.say("There is no session yet.", "Es gibt noch keine Sitzung."));
        return page.finish();
    };
    page.note(&format!(
        "{} · {} – {}",
        match sessions.len() {
            1 => reader.say("1 session", "1 Sitzung").to_owned(),
            several => format!("{several} {}", reader.say("sessions", "Sitzungen")),
        },
        reader.day(&first.summary.begun),
        reader.day(&last.summary.begun),
    ));
    let begun_s = utc_s(first);
    let mut visits: Vec<Visit<'_>> = Vec::new();
    for session in sessions {
        let week = (utc_s(session) - begun_s) / WEEK_S;
        visits.extend(session.exercises().into_iter().map(|exercise| Visit { session, week, exercise }));
    }
    let mut names: Vec<&str> = Vec::new();
    for visit in &visits {
        if !names.contains(&visit.exercise.lesson.exercise.as_str()) {
            names.push(&visit.exercise.lesson.exercise);
        }
    }
    for name in names {
        let of_it: Vec<&Visit<'_>> =
            visits.iter().filter(|visit| visit.exercise.lesson.exercise == name).collect();
        one_exercise(&mut page, name, &of_it, reader);
    }
    page.note(explanation(reader));
    page.note(reader.say(
        "Trend is the median slope between all pairs of sessions (Theil–Sen), per week; from three sessions on.",
        "Trend ist die mittlere Steigung (Median) zwischen allen Paaren von Sitzungen (Theil–Sen), pro Woche; ab drei Sitzungen.",
    ));
    page.finish()
}

fn utc_s(session: &Session) -> f64 {
    session.epoch_utc_ns as f64 * 1e-9 + session.t_begin_s
}

/// What is followed over the weeks.
struct Figure {
    name: String,
    unit: &'static str,
    goal: Option<f64>,
    points: Vec<(f64, f64)>,
}

fn one_exercise(page: &mut Page, name: &str, visits: &[&Visit<'_>], reader: &Reader) {
    page.heading(name);
    let figures = figures(visits, reader);
    let trends = figures.iter().map(|figure| {
        let ends = [figure.points.first(), figure.points.last()].map(|point| point.map(|point| point.1));
        vec![
            format!("{} ({})", figure.name, figure.unit),
            reader.number(ends[0], 0),
            reader.number(ends[1], 0),
            reader.number(figure.goal, 0),
            reader.number(slope(&figure.points), 1),
        ]
    });
    let headings = [
        "",
        reader.say("first", "zuerst"),
        reader.say("last", "zuletzt"),
        reader.say("taught", "gezeigt"),
        reader.say("trend per week", "Trend pro Woche"),
    ];
    page.table(&headings, trends);
    let ends = [visits.first(), visits.last()]
        .map(|visit| visit.map_or_else(String::new, |visit| reader.day(&visit.session.summary.begun)));
    let charts = figures.iter().filter(|figure| !figure.points.is_empty()).map(|figure| {
        let caption = format!("{} ({})", figure.name, figure.unit);
        let svg = chart::trend(&figure.name, &figure.points, figure.goal, [&ends[0], &ends[1]]);
        (caption, svg)
    });
    page.charts(charts);
    let headings = [
        reader.say("Session", "Sitzung"),
        "",
        reader.say("Score", "Punkte"),
        reader.say("Tempo", "Tempo"),
        reader.say("Symmetry", "Symmetrie"),
        reader.say("Duration (s)", "Dauer (s)"),
    ];
    let rows = visits.iter().map(|visit| {
        let score = visit.exercise.score;
        vec![
            format!("{} ({})", reader.moment(&visit.session.summary.begun), visit.session.summary.session),
            counts(&visit.exercise, reader),
            reader.number(score.map(|score| score.total), 0),
            reader.number(score.map(|score| score.tempo), 0),
            reader.number(score.and_then(|score| score.symmetry), 0),
            reader.number(visit.exercise.duration_s, 1),
        ]
    });
    page.table(&headings, rows);
}

fn figures(visits: &[&Visit<'_>], reader: &Reader) -> Vec<Figure> {
    let over_weeks = |of: &dyn Fn(&ExerciseSummary) -> Option<f64>| {
        let points = visits.iter().filter_map(|visit| Some((visit.week, of(&visit.exercise)?)));
        points.collect::<Vec<_>>()
    };
    let points = reader.say("points", "Punkte");
    let mut figures = vec![
        Figure {
            name: reader.say("Repetitions", "Wiederholungen").to_owned(),
            unit: reader.say("counted", "gezählt"),
            goal: None,
            points: over_weeks(&|exercise| Some(f64::from(exercise.counted))),
        },
        Figure {
            name: reader.say("Score", "Punkte").to_owned(),
            unit: "0–100",
            goal: None,
            points: over_weeks(&|exercise| exercise.score.map(|score| score.total)),
        },
        Figure {
            name: reader.say("Tempo", "Tempo").to_owned(),
            unit: points,
            goal: None,
            points: over_weeks(&|exercise| exercise.score.map(|score| score.tempo)),
        },
        Figure {
            name: reader.say("Symmetry", "Symmetrie").to_owned(),
            unit: points,
            goal: None,
            points: over_weeks(&|exercise| exercise.score.and_then(|score| score.symmetry)),
        },
    ];
    let mut joints: Vec<(&str, f64)> = Vec::new();
    for joint in visits.iter().flat_map(|visit| &visit.exercise.joints) {
        match joints.iter_mut().find(|(name, _)| *name == joint.name) {
            // A newer lesson sets another goal.
            Some((_, goal)) => *goal = joint.taught_range_deg,
            None => joints.push((&joint.name, joint.taught_range_deg)),
        }
    }
    figures.extend(joints.into_iter().map(|(name, goal)| Figure {
        name: reader.joint(name),
        unit: "°",
        goal: Some(goal),
        points: over_weeks(&|exercise| exercise.joints.iter().find(|joint| joint.name == name)?.range_deg),
    }));
    figures.retain(|figure| !figure.points.is_empty());
    figures
}
