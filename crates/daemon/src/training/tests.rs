//! What the thread does with reports: nothing is lost that can be kept, and nobody waits.

use posed_drivers::Timestamp;
use posed_motion::exercise::{EventKind, Exercise};
use posed_protocol::{Answer, ListedSessions, People, Plans};
use posed_sessions::{EndedBy, Session};
use posed_stage::input::{Entry, Input, Model};
use posed_stage::name::Name;
use posed_stage::output::{
    ExerciseOutcome, ExerciseProgress, ExerciseState, ExerciseWhat, Outcome, OutcomeKind, Output, Repetition,
};

use super::super::fusion::{Command, INBOX_CAPACITY};
use super::super::inbox::{Event, Inbox};
use super::super::observers::{Observer, Times};
use super::*;

const NOW: Times = Times { read: Timestamp::ZERO, published: Timestamp::ZERO, now: Timestamp::ZERO };

/// An exercise of one joint, as a file would hold it.
fn exercise() -> Exercise {
    let row = vec![0.0, 30.0, 60.0, 60.0, 30.0, 0.0];
    let (means, sds) = (vec![row.clone(), row], vec![vec![1.0; 6]; 2]);
    let text = serde_json::json!({
        "format": "posed-exercise", "version": 1, "name": "curl", "rate_hz": 25.0,
        "channels": ["elbow_r_flexion_deg"],
        "movement": {
            "states": { "mean": means, "sd": sds },
            "background": { "mean": [[0.0, 0.0], [0.0, 0.0]], "sd": [[1.0, 1.0], [1.0, 1.0]] },
            "amplitude": [30.0, 30.0],
        },
        "durations": { "shortest_s": 1.5, "median_s": 2.0, "longest_s": 2.5 }, "log_jerk": 0.0,
        "gate": {
            "mean_log_ratio": 0.0, "fifth_log_ratio": 0.0, "gain": [0.5, 2.0], "similarity": 0.5,
            "duration": [0.5, 2.0], "visited": 0.5,
        },
    });
    Exercise::from_json(&text.to_string()).unwrap()
}

/// A stage with its sessions in a folder.
struct Stand {
    folder: tempfile::TempDir,
    training: Training,
    follow: Follow,
    inbox: FusionInbox,
}

impl Stand {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (stage, clock) = (Stage::parse("name = \"s\"").unwrap(), StageClock::start());
        let inbox = Inbox::new(INBOX_CAPACITY);
        let exercises = Library::new(folder.path().join("exercises"), "json");
        let tools = Tools { clock, hub: Hub::default(), inbox: inbox.clone(), exercises };
        let (training, follow) = Training::new(&stage, folder.path(), tools);
        let mut stand = Self { folder, training, follow, inbox };
        stand.outcome(0.0, OutcomeKind::ModelSwapped(Model::Exercise { exercise: Box::new(exercise()) }));
        stand
    }

    fn say(&mut self, t_s: f64, what: ExerciseWhat) {
        self.outcome(t_s, OutcomeKind::Exercise(ExerciseOutcome { subject: Name::from("default"), what }));
    }

    fn outcome(&mut self, t_s: f64, what: OutcomeKind) {
        let t = Timestamp::from_secs_f64(t_s);
        self.follow.on_output(&Output::Outcome(&Outcome { t_valid: t, t_decided: t, what }), &NOW);
    }

    fn repetition(&mut self, t_s: f64, number: u32) {
        self.say(
            t_s,
            ExerciseWhat::Repetition(Repetition {
                exercise: Name::from("curl"),
                kind: EventKind::Counted,
                count: u64::from(number),
                set_count: number,
                t_start_s: t_s - 2.0,
                reason: None,
                is_attempt: true,
                feedback: None,
                remark: None,
            }),
        );
    }

    /// How far the only exercise is.
    fn progress(&mut self, count: u64, done: bool) {
        let exercises = vec![ExerciseProgress {
            exercise: "curl".to_owned(),
            count,
            set: 1,
            set_count: count as u32,
            rest_until_s: None,
            done,
        }];
        let state = ExerciseState { body: None, exercises, repetitions: Some(2), sets: Some(1), rest_s: 0.0 };
        self.say(0.0, ExerciseWhat::State(state));
    }

    /// Lets the thread do what it does at each look.
    fn look(&self) {
        self.training.shared.look();
    }

    fn session(&self, session: i64) -> Session {
        self.training.shared.lock().store().unwrap().session(session).unwrap()
    }

    /// What it asks of the thread that tracks.
    fn selected(&self) -> Vec<String> {
        let clock = StageClock::start();
        let events = std::iter::from_fn(|| self.inbox.pop_until(Some(clock.instant(Timestamp::ZERO))));
        let selected = events.filter_map(|event| match event {
            Event::Command(Command::Request { request, .. }) => Some(format!("{request:?}")),
            Event::Command(_) | Event::Entry(Entry { input: Input::Timer, .. }) => None,
            Event::Entry(entry) => panic!("{entry:?}"),
        });
        selected.collect()
    }
}

#[test]
fn a_session_has_what_was_counted_between_its_ends_also_what_still_waited() {
    let mut stand = Stand::new();
    stand.repetition(0.0, 1);
    stand.training.begin("P-1", None, None).unwrap();
    let t_begin_s = stand.training.shared.lock().running[0].t_begin_s;
    stand.repetition(t_begin_s + 3.0, 2);
    stand.repetition(t_begin_s + 5.0, 3);
    // Nobody has looked meanwhile.
    stand.training.end(None).unwrap();
    stand.repetition(t_begin_s + 7.0, 4);
    stand.look();
    let numbers: Vec<_> = stand.session(1).repetitions().map(|repetition| repetition.number).collect();
    assert_eq!(numbers, [Some(2), Some(3)]);
}

#[test]
fn a_plan_rests_between_its_steps_and_ends_the_session_after_the_last() {
    let mut stand = Stand::new();
    let step =
        |rest_s| posed_sessions::PlanStep { exercise: "curl".to_owned(), sets: 1, repetitions: 2, rest_s };
    let plan = posed_sessions::Plan { name: "week 1".to_owned(), steps: vec![step(0.0), step(0.0)] };
    stand.training.save_plan(&plan).unwrap();
    stand.training.begin("P-1", Some("week 1"), None).unwrap();
    assert_eq!(stand.selected().len(), 1);
    for step in 1..=2 {
        stand.progress(0, false);
        stand.look();
        assert!(stand.selected().is_empty(), "it is at work");
        stand.progress(2, true);
        stand.look();
        assert_eq!(stand.selected().len(), usize::from(step == 1), "step {step}");
    }
    assert_eq!(stand.session(1).summary.ended_by, Some(EndedBy::Plan));
    assert!(stand.training.shared.lock().running.is_empty());
}

#[test]
fn what_cannot_be_written_waits_is_reported_and_is_written_when_it_can() {
    let mut stand = Stand::new();
    stand.training.begin("P-1", None, None).unwrap();
    // Another program has the database.
    let file = file_in(stand.folder.path());
    stand.training.shared.lock().store().unwrap().set_patience(Duration::ZERO).unwrap();
    let holder = posed_sessions::Store::open(&file).unwrap();
    let held = holder.hold().unwrap();
    stand.repetition(1e6, 1);
    stand.look();
    let problem = |stand: &Stand| {
        let hub = &stand.training.shared.lock().tools.hub;
        std::iter::from_fn(|| hub.take_sessions())
            .last()
            .and_then(|sessions| sessions.sessions[0].problem.clone())
    };
    let reported = problem(&stand).unwrap();
    assert!(reported.contains("it is tried again"), "{reported}");
    drop(held);
    stand.look();
    assert_eq!(problem(&stand), None);
    assert_eq!(stand.session(1).repetitions().count(), 1);
}

#[test]
fn more_reports_than_may_wait_are_counted_and_keep_nobody_waiting() {
    let mut stand = Stand::new();
    stand.training.begin("P-1", None, None).unwrap();
    (0..REPORTS as u32 + 7).for_each(|n| stand.repetition(1e6 + f64::from(n), n + 1));
    assert_eq!(stand.training.shared.lost.load(Ordering::Relaxed), 7);
    stand.look();
    assert_eq!(stand.session(1).repetitions().count(), REPORTS);
}

#[test]
fn more_repetitions_than_may_wait_for_the_disk_lose_the_oldest_and_not_the_end() {
    let mut stand = Stand::new();
    stand.training.begin("P-1", None, None).unwrap();
    stand.training.shared.lock().store().unwrap().set_patience(Duration::ZERO).unwrap();
    let holder = posed_sessions::Store::open(&file_in(stand.folder.path())).unwrap();
    let held = holder.hold().unwrap();
    let surplus = 3;
    for n in 0..state::UNWRITTEN as u32 + surplus - 1 {
        stand.repetition(1e6 + f64::from(n), n + 1);
        drop(stand.training.shared.up_to_date());
    }
    stand.training.end(None).unwrap();
    drop(held);
    stand.look();
    let session = stand.session(1);
    let numbers: Vec<_> = session.repetitions().filter_map(|repetition| repetition.number).collect();
    assert_eq!(numbers.len(), state::UNWRITTEN - 1);
    assert_eq!((numbers[0], session.summary.ended_by), (surplus + 1, Some(EndedBy::Request)));
}

#[test]
fn more_sessions_than_may_go_on_are_refused_and_those_that_go_on_do() {
    let mut stand = Stand::new();
    let begin = |subject: usize| {
        let subject = if subject == 0 { None } else { Some(format!("subject {subject}")) };
        stand.training.begin("P-1", None, subject)
    };
    (0..requests::RUNNING).for_each(|subject| _ = begin(subject).unwrap());
    assert!(begin(requests::RUNNING).unwrap_err().to_string().contains("go on already"));
    stand.repetition(1e6, 1);
    stand.look();
    assert_eq!(stand.session(1).repetitions().count(), 1);
}

#[test]
fn looking_makes_no_file_and_finds_nobody() {
    let stand = Stand::new();
    let answers = [stand.training.people(), stand.training.list(None, None), stand.training.plans()];
    let emptied = [
        Answer::People(People { people: vec![] }),
        Answer::Sessions(ListedSessions { sessions: vec![] }),
        Answer::Plans(Plans { plans: vec![] }),
    ];
    assert_eq!(answers.map(|answer| answer.unwrap().unwrap()), emptied);
    assert!(stand.training.show(1).is_err() && stand.training.begin("P-1", Some("none"), None).is_err());
    assert_eq!(std::fs::read_dir(stand.folder.path()).unwrap().count(), 0);
}
