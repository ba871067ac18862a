//! The database: it gives back what it took, and forgets who is to be forgotten.

use std::path::Path;

use super::*;
use crate::plan::{Plan, PlanStep};
use crate::session::EndedBy;
use crate::testing::{lesson, rejected, repetition};
use crate::{Erasure, Forgotten};
use crate::{Repetition, Session};

const PERSON: &str = "Ottilie-Wurzelbacher";

fn begin(store: &mut Store, person: &str) -> SessionId {
    let new = NewSession {
        person,
        stage: "clinic",
        subject: "default",
        epoch_utc_ns: 1_700_000_000_000_000_000,
        t_begin_s: 1.5,
        recording: Some("a.mcap"),
        ..NewSession::default()
    };
    store.begin(&new).unwrap()
}

/// Two sets of three and two, one repetition not counted.
fn repetitions() -> Vec<Repetition> {
    let curl = lesson("curl of an unusual kind", 3, 80.0);
    vec![
        repetition(&curl, 1, 2.0, 80.0),
        rejected(&curl, 5.0),
        repetition(&curl, 2, 8.0, 70.0),
        repetition(&curl, 3, 11.0, 60.25),
        repetition(&curl, 1, 40.0, 80.0),
        repetition(&curl, 2, 43.0, 80.0),
    ]
}

fn trained(store: &mut Store, person: &str) -> Session {
    let session = begin(store, person);
    repetitions().iter().for_each(|repetition| store.add(session, repetition).unwrap());
    store.end(session, 61.5, EndedBy::Request).unwrap();
    store.session(session).unwrap()
}

#[test]
fn what_was_trained_comes_back_number_by_number_and_counts_again_without_a_difference() {
    let mut store = Store::in_memory().unwrap();
    let session = trained(&mut store, PERSON);
    let kept: Vec<Repetition> = session.repetitions().cloned().collect();
    assert_eq!(kept, repetitions());
    let sizes: Vec<_> = session.training.iter().map(|set| (set.set, set.repetitions.len())).collect();
    assert_eq!(sizes, [(1, 4), (2, 2)]);
    assert_eq!(session.summary.begun, "2023-11-14T22:13:21Z");
    assert_eq!((session.summary.counted, session.summary.rejected, session.summary.sets), (5, 1, 2));
    assert_eq!((session.summary.duration_s, session.summary.ended_by), (Some(60.0), Some(EndedBy::Request)));
    assert_eq!(store.sessions(None, 10).unwrap(), std::slice::from_ref(&session.summary));

    assert_eq!(session.differences(&repetitions(), 0.0), [""; 0]);
    let mut other = repetitions();
    other[2].joints[0].course_deg[7] += 0.01;
    other.remove(4);
    let differences = session.differences(&other, 0.0);
    assert_eq!(differences.len(), 2, "{differences:?}");
    assert!(
        differences[0].contains("other figures") && differences[1].contains("not counted again"),
        "{differences:?}"
    );
    // What began before the recording did is nobody's difference.
    assert_eq!(session.differences(&repetitions()[2..], 6.0), [""; 0]);
}

#[test]
fn a_repetition_that_comes_to_a_session_in_the_middle_of_a_set_has_a_set_of_its_own() {
    let mut store = Store::in_memory().unwrap();
    let session = begin(&mut store, PERSON);
    let curl = lesson("curl", 1, 80.0);
    store.add(session, &repetition(&curl, 4, 2.0, 80.0)).unwrap();
    store.add(session, &repetition(&lesson("squat", 1, 80.0), 7, 4.0, 80.0)).unwrap();
    store.add(session, &repetition(&curl, 5, 6.0, 80.0)).unwrap();
    let sets = store.session(session).unwrap().training;
    assert_eq!(sets.iter().map(|set| set.repetitions.len()).collect::<Vec<_>>(), [2, 1]);
}

#[test]
fn a_corrected_count_stands_beside_the_one_that_was_counted() {
    let mut store = Store::in_memory().unwrap();
    let session = trained(&mut store, PERSON).summary.session;
    store.correct(session, 1, 5, 10).unwrap();
    store.correct(session, 1, 4, 20).unwrap();
    let corrected = store.session(session).unwrap();
    assert_eq!((corrected.training[0].corrected, corrected.training[0].counted().count()), (Some(4), 3));
    assert_eq!(corrected.exercises()[0].corrected, Some(6));
    assert!(matches!(store.correct(session, 3, 5, 10), Err(StoreError::NoSet(_, 3))));
    assert!(matches!(store.correct(99, 1, 5, 10), Err(StoreError::NoSession(99))));
    let first: (u32, u32) = store
        .connection
        .query_row("SELECT counted, corrected FROM correction ORDER BY id", [], |row| {
            Ok((row.get(0)?, row.get(1)?))
        })
        .unwrap();
    assert_eq!(first, (3, 5), "the one before is still there");
}

#[test]
fn a_session_whose_daemon_broke_off_ends_with_its_last_repetition() {
    let mut store = Store::in_memory().unwrap();
    let (session, empty) = (begin(&mut store, PERSON), begin(&mut store, "B"));
    store.add(session, &repetitions()[0]).unwrap();
    assert_eq!(store.end_interrupted("another stage").unwrap(), 0);
    assert_eq!(store.end_interrupted("clinic").unwrap(), 2);
    let of = |session| store.session(session).unwrap().summary;
    assert_eq!((of(session).ended_by, of(session).duration_s), (Some(EndedBy::Interruption), Some(2.9)));
    assert_eq!(of(empty).duration_s, Some(0.0));
}

/// Whether any file of the database holds these bytes.
fn holds(folder: &Path, text: &str) -> bool {
    std::fs::read_dir(folder).unwrap().any(|file| {
        let bytes = std::fs::read(file.unwrap().path()).unwrap();
        bytes.windows(text.len()).any(|window| window == text.as_bytes())
    })
}

#[test]
fn nothing_of_somebody_who_was_forgotten_is_on_the_disk_and_others_keep_what_is_theirs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sessions.db");
    let mut store = Store::open(&path).unwrap();
    let theirs = trained(&mut store, "P-2");
    let own = begin(&mut store, PERSON);
    let squat = lesson("squat only they do", 2, 90.0);
    (1..=40).for_each(|number| store.add(own, &repetition(&squat, number, f64::from(number), 80.0)).unwrap());
    assert!(holds(folder.path(), PERSON) && holds(folder.path(), &squat.exercise));

    // Another program that reads keeps the journal.
    let reader = Connection::open(&path).unwrap();
    reader.execute_batch("BEGIN; SELECT * FROM person;").unwrap();
    store.connection.busy_timeout(Duration::ZERO).unwrap();
    let forgotten = store.forget(PERSON).unwrap();
    let expected =
        Forgotten { sessions: 1, recordings: vec!["a.mcap".to_owned()], erasure: Erasure::Pending };
    assert_eq!(forgotten, expected);
    assert!(matches!(store.forget(PERSON), Err(StoreError::NoPerson(_))));
    drop(reader);
    assert_eq!(store.erase().unwrap(), Erasure::Done);

    assert!(!holds(folder.path(), PERSON) && !holds(folder.path(), &squat.exercise));
    let counts =
        "SELECT (SELECT count(*) FROM person), (SELECT count(*) FROM joint), (SELECT count(*) FROM lesson)";
    let counts: (u32, u32, u32) =
        store.connection.query_row(counts, [], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?))).unwrap();
    assert_eq!(counts, (1, 18, 1));
    assert_eq!(store.session(theirs.summary.session).unwrap(), theirs);
}

#[test]
fn plans_are_kept_replaced_and_refused_with_the_place() {
    let mut store = Store::in_memory().unwrap();
    let step =
        |exercise: &str, sets| PlanStep { exercise: exercise.to_owned(), sets, repetitions: 8, rest_s: 30.0 };
    let plan = Plan { name: "knee, week 3".to_owned(), steps: vec![step("squat", 3), step("curl", 2)] };
    store.save_plan(&Plan { steps: vec![step("squat", 1)], ..plan.clone() }).unwrap();
    store.save_plan(&plan).unwrap();
    assert_eq!(store.plans().unwrap(), std::slice::from_ref(&plan));
    let refused = store.save_plan(&Plan { steps: vec![step("squat", 3), step("curl", 0)], ..plan.clone() });
    assert_eq!(refused.unwrap_err().to_string(), "steps[1].sets: give 1 to 100");
    store.delete_plan(&plan.name).unwrap();
    assert!(matches!(store.plan(&plan.name), Err(StoreError::NoPlan(_))));
    for name in ["", " a", "a\n", &"x".repeat(65)] {
        assert!(matches!(store.add_person(name), Err(StoreError::Name)), "{name:?}");
    }
}

#[test]
fn what_another_version_wrote_and_what_is_no_database_is_refused_and_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sessions.db");
    Store::open(&path).unwrap().connection.pragma_update(None, "user_version", 7).unwrap();
    assert!(matches!(Store::open(&path), Err(StoreError::Version(7))));
    let other = folder.path().join("other.db");
    std::fs::write(&other, "precious, and no database at all").unwrap();
    let error = Store::open(&other).unwrap_err();
    assert!(!error.may_pass(), "{error}");
    assert_eq!(std::fs::read(&other).unwrap(), b"precious, and no database at all");
}

/// What a process that is killed leaves is its files: a copy of them, made while the database is open, is what it would leave.
#[test]
fn all_that_was_taken_is_there_after_the_program_was_killed() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open(&folder.path().join("sessions.db")).unwrap();
    let session = begin(&mut store, PERSON);
    for (taken, repetition) in (1..).zip(&repetitions()) {
        store.add(session, repetition).unwrap();
        let copy = tempfile::tempdir().unwrap();
        // Not the index of the journal: SQLite makes it anew.
        for name in ["sessions.db", "sessions.db-wal"] {
            std::fs::copy(folder.path().join(name), copy.path().join(name)).unwrap();
        }
        let left = Store::open(&copy.path().join("sessions.db")).unwrap().session(session).unwrap();
        assert_eq!(left.repetitions().count(), taken);
    }
}

#[test]
fn a_full_disk_refuses_a_repetition_whole_and_takes_it_when_there_is_room() {
    let mut store = Store::in_memory().unwrap();
    let session = begin(&mut store, PERSON);
    let pages: i64 = store.connection.query_row("PRAGMA page_count", [], |row| row.get(0)).unwrap();
    store.connection.pragma_update(None, "max_page_count", pages).unwrap();
    let curl = lesson("curl", 60, 80.0);
    let one = repetition(&curl, 1, 2.0, 80.0);
    let error = store.add(session, &one).unwrap_err();
    assert!(error.may_pass(), "{error}");
    assert_eq!(store.session(session).unwrap().training, []);
    store.connection.pragma_update(None, "max_page_count", 10_000).unwrap();
    store.add(session, &one).unwrap();
    assert_eq!(store.session(session).unwrap().repetitions().count(), 1);
}

#[test]
fn a_recording_that_has_another_name_is_still_that_of_its_sessions() {
    let mut store = Store::in_memory().unwrap();
    let session = begin(&mut store, PERSON);
    assert_eq!(store.rename_recording("other.mcap", "b.mcap").unwrap(), 0);
    assert_eq!(store.rename_recording("a.mcap", "b.mcap").unwrap(), 1);
    assert_eq!(store.session(session).unwrap().summary.recording.as_deref(), Some("b.mcap"));
    assert_eq!(store.forget(PERSON).unwrap().recordings, ["b.mcap"]);
}
