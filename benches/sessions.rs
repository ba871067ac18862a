//! What a course of six weeks of twenty people takes: bytes on the disk, and time until a report is there.
//!
//!     cargo bench --bench sessions

use std::sync::Arc;
use std::time::Instant;

use jiff::tz::TimeZone;
use posed_motion::exercise::Language;
use posed_sessions::{
    EndedBy, JointCourse, LessonJoint, NewSession, POINTS, Repetition, Score, Store, TaughtLesson, report,
};

const PEOPLE: u32 = 20;
const SESSIONS: u32 = 18;
const EXERCISES: usize = 5;
const SETS: u32 = 3;
const REPETITIONS: u32 = 10;
const JOINTS: u32 = 6;

fn course(shift: f64) -> Vec<f64> {
    (0..POINTS).map(|at| ((shift + f64::from(at as u32) * 3.71) * 100.0).round() / 100.0).collect()
}

fn lesson(exercise: usize) -> Arc<TaughtLesson> {
    let joint =
        |joint| LessonJoint { name: format!("joint_{joint}_flexion_deg"), demonstration_deg: course(0.0) };
    Arc::new(TaughtLesson {
        exercise: format!("exercise {exercise}"),
        revision: 1,
        duration_s: 2.5,
        joints: (0..JOINTS).map(joint).collect(),
    })
}

fn repetition(lesson: &Arc<TaughtLesson>, number: u32, t_s: f64) -> Repetition {
    let joint = |joint: u32| JointCourse {
        joint,
        name: format!("joint_{joint}_flexion_deg"),
        least_deg: 1.5,
        greatest_deg: 117.25,
        course_deg: course(t_s.fract() + f64::from(joint)),
    };
    Repetition {
        subject: "default".to_owned(),
        lesson: Arc::clone(lesson),
        begins_set: number == 1,
        planned: Some(REPETITIONS),
        number: Some(number),
        t_start_s: t_s,
        t_end_s: t_s + 2.413,
        t_decided_s: t_s + 2.9,
        reason: None,
        score: Some(Score {
            total: 91.3,
            amplitude: 88.1,
            tempo: 100.0,
            smoothness: 97.2,
            symmetry: Some(93.4),
        }),
        // One in four has a sentence.
        sentence: number
            .is_multiple_of(4)
            .then(|| "right elbow bent 20 degrees less than shown at the top".to_owned()),
        sentence_de: number
            .is_multiple_of(4)
            .then(|| "rechter Ellenbogen am Umkehrpunkt 20 Grad weniger gebeugt als gezeigt".to_owned()),
        joints: (0..JOINTS).map(joint).collect(),
    }
}

#[expect(clippy::print_stdout, reason = "a bench")]
#[expect(clippy::disallowed_methods, reason = "it measures time")]
fn main() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sessions.db");
    let mut store = Store::open(&path).expect("a database");
    let lessons: Vec<_> = (0..EXERCISES).map(lesson).collect();
    let (begun, mut count) = (Instant::now(), 0_u32);
    for session in 0..SESSIONS {
        for person in 0..PEOPLE {
            let days = session / 3 * 7 + session % 3 * 2;
            let epoch_utc_ns = 1_700_000_000_000_000_000 + i64::from(days) * 86_400_000_000_000;
            let person = format!("P-{person}");
            let new = NewSession {
                person: &person,
                stage: "clinic",
                subject: "default",
                epoch_utc_ns,
                ..NewSession::default()
            };
            let id = store.begin(&new).expect("a session");
            let mut t_s = 0.0;
            for lesson in &lessons {
                for number in (0..SETS).flat_map(|_| 1..=REPETITIONS) {
                    t_s += 3.017;
                    store.add(id, &repetition(lesson, number, t_s)).expect("a repetition");
                    count += 1;
                }
            }
            store.end(id, t_s, EndedBy::Plan).expect("an end");
        }
    }
    let kept_s = begun.elapsed().as_secs_f64();
    drop(store);
    let megabytes = std::fs::metadata(&path).expect("the file").len() as f64 * 1e-6;
    println!("{count} repetitions kept, {:.2} ms each; {megabytes:.1} MB", 1e3 * kept_s / f64::from(count));
    let reader = report::Reader { language: Language::English, time_zone: TimeZone::UTC };
    let begun = Instant::now();
    let store = Store::open(&path).expect("the database");
    let sessions = store.course("P-7").expect("a course");
    let page = report::course("P-7", &sessions, &reader);
    println!(
        "course of {} sessions: {:.3} s, {} kB",
        sessions.len(),
        begun.elapsed().as_secs_f64(),
        page.len() / 1000
    );
    let begun = Instant::now();
    let session = store.session(sessions[17].summary.session).expect("a session");
    let page = report::session(&session, &reader);
    println!("one session: {:.3} s, {} kB", begun.elapsed().as_secs_f64(), page.len() / 1000);
    let begun = Instant::now();
    let mut store = Store::open(&path).expect("the database");
    store.forget("P-7").expect("somebody");
    println!("forgotten in {:.3} s", begun.elapsed().as_secs_f64());
}
