//! Exercises live: taught from tracked poses, counted in the pipeline, replayed, and the same from a file.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::LazyLock;

use posed_motion::exercise::{
    Counter, EventKind, Exercise, Joint, Language, Lesson, Options, Stream, rests, teach,
};
use posed_pipeline::Pipeline;
use posed_recording::table::Streams;
use posed_simulator::exercises::{self, Day, Exercise as Training, Person, Variant};
use posed_simulator::motion::{Curl, Motion};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::Stage;
use posed_stage::input::{Input, Model, Plan, Request};
use posed_stage::output::{Estimate, ExerciseState, ExerciseWhat, OutcomeKind, Repetition};
use posed_stage::signals::{self, BodyColumns};

use crate::cli::{json, posed};
use posed_rig::{Rig, Said, demo, record, replay, stage};

/// A forearm and an upper arm that curl so many times.
fn scenario(seed: u64, repetitions: u32, period_s: f64) -> Scenario {
    let curl = Curl {
        shoulder_m: [0.45, -0.1, 0.1],
        start_s: 3.0,
        period_s,
        pause_s: 0.4,
        repetitions: Some(repetitions),
        ..Curl::default()
    };
    let sensor = |name: &str, segment: &str, along_m: f64| SensorScenario {
        name: name.into(),
        body: "arm".into(),
        segment: Some(segment.into()),
        offset_m: [0.0, along_m, 0.04],
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
    };
    Scenario {
        seed,
        bodies: vec![BodySpec { name: "arm".into(), motion: Motion::Curl(curl) }],
        sensors: vec![sensor("s0-0", "upper_arm", -0.15), sensor("s0-1", "forearm", -0.18)],
        devices: vec![DeviceScenario { name: "d0".into(), boot_ms: 0.0, ..DeviceScenario::default() }],
        ..Scenario::default()
    }
}

fn rows<'a>(estimates: impl Iterator<Item = &'a Estimate>) -> (Vec<String>, Vec<f64>, Vec<Option<f64>>) {
    let (mut t_s, mut values, mut row) = (Vec::new(), Vec::new(), Vec::new());
    for estimate in estimates {
        t_s.push(estimate.t_valid.as_secs_f64());
        signals::write(estimate, &mut row);
        values.extend_from_slice(&row);
    }
    (signals::columns(["s0-0", "s0-1"]), t_s, values)
}

/// Taught once for all tests, from five curls of three seconds.
pub(crate) static CURL: LazyLock<Exercise> = LazyLock::new(|| {
    let mut rig = Rig::new(&stage(&[2]), &scenario(1, 5, 3.0));
    rig.run_until(22.0);
    let (columns, t_s, values) = rows(rig.estimates());
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let options = Options { name: "curl".into(), repetitions: 5, ..Options::default() };
    teach(&stream, &options).unwrap().exercise
});

fn load() -> Input {
    Input::Model(Model::Exercise { exercise: Box::new(CURL.clone()) })
}

fn select(plan: Plan) -> Input {
    let (subject, exercises) = ("patient".to_owned(), vec!["curl".to_owned()]);
    Input::Request(Request::ExerciseSelect { subject, exercises, plan, sensors: BTreeMap::new(), body: None })
}

/// Selects the curl for somebody who wears other sensors than those it was taught with.
fn with_sensors<const N: usize>(sensors: [(&str, &str); N]) -> Request {
    let sensors = sensors.map(|(taught, other)| (taught.to_owned(), other.to_owned())).into();
    let (subject, exercises) = ("patient".to_owned(), vec!["curl".to_owned()]);
    Request::ExerciseSelect { subject, exercises, plan: Plan::default(), sensors, body: None }
}

/// Somebody else, at another pace; the exercise is loaded at the start.
fn session(repetitions: u32) -> Rig {
    let mut rig = Rig::new(&stage(&[2]), &scenario(2, repetitions, 2.6));
    rig.push(load());
    rig
}

fn outcomes(emitted: &[Said]) -> impl Iterator<Item = (&str, &ExerciseWhat)> {
    emitted.iter().filter_map(|emitted| match emitted {
        Said::Outcome(outcome) => match &outcome.what {
            OutcomeKind::Exercise(exercise) => Some((&*exercise.subject, &exercise.what)),
            _ => None,
        },
        _ => None,
    })
}

fn repetitions<'a>(emitted: &'a [Said], subject: &str) -> Vec<&'a Repetition> {
    outcomes(emitted)
        .filter(|(of, _)| *of == subject)
        .filter_map(|(_, what)| if let ExerciseWhat::Repetition(it) = what { Some(it) } else { None })
        .collect()
}

pub(crate) fn counts(emitted: &[Said], subject: &str) -> Vec<u64> {
    let counted = |it: &&Repetition| it.kind == EventKind::Counted;
    repetitions(emitted, subject).into_iter().filter(counted).map(|it| it.count).collect()
}

fn states(emitted: &[Said], subject: &str) -> Vec<ExerciseState> {
    outcomes(emitted)
        .filter(|(of, _)| *of == subject)
        .filter_map(
            |(_, what)| if let ExerciseWhat::State(state) = what { Some(state.clone()) } else { None },
        )
        .collect()
}

#[test]
fn what_is_loaded_is_counted_in_order_and_provisional_before_it_counts() {
    let mut rig = session(6);
    rig.run_until(24.0);
    assert_eq!(counts(&rig.emitted, "default"), [1, 2, 3, 4, 5, 6]);
    let kinds: Vec<EventKind> = repetitions(&rig.emitted, "default").iter().map(|it| it.kind).collect();
    let provisional = kinds.iter().filter(|kind| **kind == EventKind::Provisional).count();
    assert!(provisional >= 5 && !kinds.contains(&EventKind::Rejected), "{kinds:?}");
    let mut last = 0.0;
    for it in repetitions(&rig.emitted, "default").iter().filter(|it| it.kind == EventKind::Counted) {
        assert!(it.t_start_s > last && it.t_start_s > 2.5, "{it:?}");
        last = it.t_start_s;
    }
}

#[test]
fn sets_rests_and_subjects_are_kept_apart() {
    let mut rig = session(7);
    rig.run_until(1.0);
    rig.push(select(Plan { repetitions: Some(3), sets: Some(2), rest_s: 2.0 }));
    rig.run_until(10.8);
    assert_eq!(counts(&rig.emitted, "patient"), [1, 2]);
    rig.push(Input::Request(Request::ExerciseReset { subject: "patient".into() }));
    rig.run_until(27.0);
    assert_eq!(counts(&rig.emitted, "default"), [1, 2, 3, 4, 5, 6, 7]);
    let counted = repetitions(&rig.emitted, "patient");
    let sets: Vec<u32> =
        counted.iter().filter(|it| it.kind == EventKind::Counted).map(|it| it.set_count).collect();
    assert_eq!(sets, [1, 2, 1, 2, 3, 1, 2], "reset after two, then a set of three");
    let states = states(&rig.emitted, "patient");
    let progress = |state: &ExerciseState| {
        let one = &state.exercises[0];
        (one.count, one.set, one.set_count, one.rest_until_s.is_some(), one.done)
    };
    let seen: Vec<_> = states.iter().map(progress).collect();
    assert_eq!(
        seen,
        [(0, 1, 0, false, false), (0, 1, 0, false, false), (3, 1, 3, true, false), (3, 1, 3, false, false)],
        "selected, reset, set complete, rest over"
    );
}

#[test]
fn who_wears_the_sensors_the_other_way_round_is_counted_once_that_is_said() {
    let mut rig = Rig::new(&stage(&[2]), &scenario(2, 4, 2.6));
    let mut swapped = CURL.clone();
    for channel in &mut swapped.channels {
        let (other, part) = match channel.strip_prefix("s0-0") {
            Some(part) => ("s0-1", part),
            None => ("s0-0", channel.trim_start_matches("s0-1")),
        };
        *channel = format!("{other}{part}");
    }
    rig.push(Input::Model(Model::Exercise { exercise: Box::new(swapped) }));
    rig.push(Input::Request(with_sensors([("s0-0", "s0-1"), ("s0-1", "s0-0")])));
    rig.run_until(18.0);
    assert_eq!(counts(&rig.emitted, "patient"), [1, 2, 3, 4]);
    assert_eq!(counts(&rig.emitted, "default"), [0; 0]);
}

#[test]
fn requests_without_sense_are_refused_and_change_nothing() {
    let mut rig = session(1);
    let refused = [
        Request::ExerciseSelect {
            subject: "a".into(),
            exercises: vec!["squat".into()],
            plan: Plan::default(),
            sensors: BTreeMap::new(),
            body: None,
        },
        Request::ExerciseSelect {
            subject: "a".into(),
            exercises: vec!["curl".into(); 2],
            plan: Plan::default(),
            sensors: BTreeMap::new(),
            body: None,
        },
        Request::ExerciseSelect {
            subject: String::new(),
            exercises: Vec::new(),
            plan: Plan::default(),
            sensors: BTreeMap::new(),
            body: None,
        },
        with_sensors([("s0-0", "nobody")]),
        with_sensors([("nobody", "s0-0")]),
        Request::ExerciseSelect {
            subject: "a".into(),
            exercises: vec!["curl".into()],
            plan: Plan { rest_s: f64::NAN, ..Plan::default() },
            sensors: BTreeMap::new(),
            body: None,
        },
        Request::ExerciseReset { subject: "a".into() },
    ];
    let before = rig.emitted.len();
    for (index, request) in refused.into_iter().enumerate() {
        assert!(rig.pipeline.check_request(&request).is_err(), "{request:?}");
        rig.push(Input::Request(request));
        assert_eq!(rig.pipeline.status().requests_refused, index as u64 + 1);
    }
    // An exercise of another stage.
    let mut foreign = CURL.clone();
    foreign.channels[0] = "knee_flexion_deg".into();
    rig.push(Input::Model(Model::Exercise { exercise: Box::new(foreign) }));
    assert_eq!((rig.pipeline.status().models_refused, rig.emitted.len()), (1, before));
}

#[test]
fn the_log_says_the_same_again_from_any_snapshot() {
    let mut rig = session(4);
    let mut snapshots = Vec::new();
    // At rest, within repetitions, and while one is provisional.
    for until_s in [0.5, 2.0, 4.4, 5.9, 6.3, 8.0, 9.1] {
        rig.run_until(until_s);
        if until_s == 2.0 {
            rig.push(select(Plan { repetitions: Some(2), sets: None, rest_s: 1.0 }));
        }
        snapshots.push((
            rig.pipeline.models().clone(),
            rig.pipeline.snapshot(),
            rig.log.len(),
            rig.emitted.len(),
        ));
    }
    rig.run_until(16.0);
    assert!(counts(&rig.emitted, "patient").len() >= 3);
    let stage = stage(&[2]);
    assert_eq!(replay(&mut Pipeline::new(&stage).unwrap(), &rig.log), rig.emitted);
    for (models, snapshot, entries, emitted) in snapshots {
        let mut restored = Pipeline::restore(&stage, &models, &snapshot).unwrap();
        assert_eq!(
            replay(&mut restored, &rig.log[entries..]),
            rig.emitted[emitted..],
            "from entry {entries}"
        );
        assert_eq!(restored.snapshot(), rig.pipeline.snapshot(), "from entry {entries}");
    }
}

/// Joint angles of a simulated person as a stream.
fn angles(recording: &exercises::Recording) -> (Vec<String>, Vec<f64>, Vec<Option<f64>>) {
    let columns = exercises::ANGLES.map(str::to_owned).to_vec();
    let rows = recording.angles_deg.len() / columns.len();
    let t_s = (0..rows).map(|row| row as f64 / exercises::RATE_HZ).collect();
    (columns, t_s, recording.angles_deg.iter().map(|value| Some(*value)).collect())
}

/// Counts and sentences of a recording.
fn count(exercise: &Exercise, recording: &exercises::Recording) -> (usize, Vec<String>) {
    let (columns, t_s, values) = angles(recording);
    let mut counter = Counter::new(vec![exercise.clone()], &columns).unwrap();
    let (mut counted, mut sentences) = (0, Vec::new());
    for (row, t_s) in values.chunks(columns.len()).zip(&t_s) {
        counter.push(*t_s, row, &mut |event| {
            counted += usize::from(event.kind == EventKind::Counted);
            sentences.extend(event.sentence(exercise, Language::English));
        });
    }
    (counted, sentences)
}

#[test]
fn given_a_trunk_that_leans_it_is_named_as_a_compensation() {
    for person in [310, 311, 312] {
        let taught = lesson(Training::Curl, &set(person, 0, Training::Curl, 5, Variant::Right));
        let still: Vec<_> = taught.exercise.still.iter().map(|still| still.channel.as_str()).collect();
        assert!(still.contains(&"trunk_flexion_deg"), "{still:?}");
        let (counted, said) =
            count(&taught.exercise, &set(person, 1, Training::Curl, 8, Variant::Leans(25.0)));
        assert_eq!(counted, 8, "{said:?}");
        let leans = |said: &&String| {
            said.starts_with("trunk leaned back by 2") && said.ends_with("meanwhile: keep it still")
        };
        assert!(said.iter().filter(leans).count() >= 7, "{said:?}");
        let (_, said) = count(&taught.exercise, &set(person, 2, Training::Curl, 8, Variant::Right));
        assert_eq!(said, Vec::<String>::new());
    }
}

#[test]
fn given_waving_and_drinking_nobody_raises_a_shoulder_or_curls() {
    for person in [310, 311, 312] {
        let taught = [Training::Curl, Training::ShoulderRaise]
            .map(|training| lesson(training, &set(person, 0, training, 5, Variant::Right)).exercise);
        let mut day = Day::new(&Person::new(person), 7);
        for _ in 0..6 {
            day.wave();
            day.drink();
        }
        let recording = day.finish();
        assert_eq!(taught.map(|exercise| count(&exercise, &recording).0), [0, 0], "{person}");
    }
}

#[test]
fn given_legs_that_walk_nobody_curls_and_how_they_stand_is_nobodys_affair() {
    for person in [310, 311, 312] {
        let taught = lesson(Training::Curl, &set(person, 0, Training::Curl, 5, Variant::Right)).exercise;
        let with_knee = |bent_deg: &dyn Fn(f64) -> f64| {
            let mut recording = set(person, 1, Training::Curl, 8, Variant::Right);
            for (k, row) in recording.angles_deg.chunks_mut(exercises::ANGLES.len()).enumerate() {
                row[5] += bent_deg(k as f64 / exercises::RATE_HZ);
            }
            count(&taught, &recording).0
        };
        assert_eq!(with_knee(&|_| 80.0), 8, "{person} sits");
        assert_eq!(with_knee(&|t_s| 15.0 * (t_s % 2.0).floor()), 8, "{person} shifts the weight");
        let strides = |t_s: f64| 30.0 + 30.0 * libm::sin(std::f64::consts::TAU * t_s);
        assert_eq!(with_knee(&strides), 0, "{person} walks");
    }
}

/// A set on one day of a simulated person.
fn set(
    person: u64,
    day: u64,
    training: Training,
    repetitions: usize,
    variant: Variant,
) -> exercises::Recording {
    let mut day = Day::new(&Person::new(person), day);
    day.set(training, repetitions, variant);
    day.finish()
}

/// What five repetitions of a simulated person teach.
fn lesson(training: Training, demonstration: &exercises::Recording) -> Lesson {
    let (columns, t_s, values) = angles(demonstration);
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let options = Options { name: training.name().into(), repetitions: 5, ..Options::default() };
    teach(&stream, &options).unwrap()
}

#[test]
fn simulated_people_are_counted_corrected_and_otherwise_left_alone() {
    for person in [500, 501] {
        let squats = |day, repetitions, variant| set(person, day, Training::Squat, repetitions, variant);
        let squat = lesson(Training::Squat, &squats(0, 5, Variant::Right)).exercise;
        assert_eq!(count(&squat, &squats(1, 9, Variant::Right)).0, 9, "person {person}");

        let mut day = Day::new(&Person::new(person), 2);
        day.other(60.0);
        assert_eq!(count(&squat, &day.finish()).0, 0, "person {person}: other movement");

        let (_, sentences) = count(&squat, &squats(3, 8, Variant::Short { angle: 5, by_deg: 25.0 }));
        let named = |sentence: &&String| {
            sentence.starts_with("knee bent") && sentence.ends_with("less than shown at the turning point")
        };
        assert!(sentences.iter().filter(named).count() >= 6, "person {person}: {sentences:?}");
    }
}

/// Who stands still for long before the first repetition, and who goes to a wall first and away from it at last.
#[test]
fn repetitions_are_cut_where_they_begin_and_end_whatever_is_before_and_after_them() {
    for (person, day, training) in [
        (10_007, 0, Training::Curl),
        (10_039, 300, Training::ShoulderRaise),
        (10_053, 100, Training::WallPushUp),
        (10_057, 100, Training::WallPushUp),
    ] {
        let demonstration = set(person, day, training, 5, Variant::Right);
        let seen = lesson(training, &demonstration).report.repetitions;
        for (seen, truth) in seen.iter().zip(&demonstration.repetitions) {
            let off_s = 0.5 * (seen.t_start_s + seen.t_end_s - truth[0] - truth[1]);
            let of = off_s.abs() / (truth[1] - truth[0]);
            assert!(of < 0.25, "person {person}, {}: {seen:?}, {truth:?}", training.name());
        }
    }
}

/// Hip and knee do most of a squat. One of them that has failed gives no information about its size.
#[test]
fn a_joint_that_has_failed_makes_no_squat_too_small() {
    let squats = |day, repetitions| set(500, day, Training::Squat, repetitions, Variant::Right);
    let squat = lesson(Training::Squat, &squats(0, 5)).exercise;
    for failed in ["hip_flexion_deg", "knee_flexion_deg"] {
        assert!(squat.channels.iter().any(|channel| channel == failed));
        let at = exercises::ANGLES.iter().position(|angle| *angle == failed).unwrap();
        let mut frozen = squats(7, 8);
        frozen.angles_deg.chunks_mut(exercises::ANGLES.len()).for_each(|row| row[at] = 20.0);
        let counted = count(&squat, &frozen).0;
        assert!((7..=8).contains(&counted), "{failed}: {counted} of 8");
    }
}

/// The path of who stops half-way stays in states half-way, so its size along the path is almost whole.
#[test]
fn half_a_push_up_at_the_wall_does_not_count() {
    let push_ups = |day, repetitions, variant| set(2001, day, Training::WallPushUp, repetitions, variant);
    let push_up = lesson(Training::WallPushUp, &push_ups(0, 5, Variant::Right)).exercise;
    assert_eq!(count(&push_up, &push_ups(5, 10, Variant::Partly(0.5))).0, 0);
    assert_eq!(count(&push_up, &push_ups(6, 10, Variant::Right)).0, 10);
}

/// What the wearer's sensors said between two times, as a job that teaches sees it.
pub(crate) fn wearer(
    rig: &Rig,
    stage: &Stage,
    span_s: Range<f64>,
) -> (Vec<String>, Vec<f64>, Vec<Option<f64>>) {
    let columns = signals::columns_of_wearer(stage, 0);
    let (t_s, values) = said_in(rig, stage, &columns, span_s);
    (columns, t_s, values)
}

/// Times and rows of these columns of the stage.
pub(crate) fn said_in(
    rig: &Rig,
    stage: &Stage,
    columns: &[String],
    span_s: Range<f64>,
) -> (Vec<f64>, Vec<Option<f64>>) {
    let all = signals::columns_of(stage);
    let kept: Vec<usize> =
        columns.iter().filter_map(|column| all.iter().position(|other| other == column)).collect();
    let angles = BodyColumns::of(stage);
    let (mut t_s, mut values, mut row, mut newest) = (Vec::new(), Vec::new(), Vec::new(), BTreeMap::new());
    for emitted in &rig.emitted {
        match emitted {
            Said::Body(body) => _ = newest.insert(body.index, &**body),
            Said::Estimate(estimate) if span_s.contains(&estimate.t_valid.as_secs_f64()) => {
                t_s.push(estimate.t_valid.as_secs_f64());
                signals::write(estimate, &mut row);
                angles.append(|body| newest.get(&body).copied(), estimate, &mut row);
                assert_eq!(row.len(), all.len());
                values.extend(kept.iter().map(|column| row[*column]));
            }
            _ => {}
        }
    }
    (t_s, values)
}

/// The stage of `posed demo`: its person does three sets of five curls, with rests of five seconds between.
#[test]
fn the_demos_person_rests_after_a_set_is_taught_by_it_and_counted_in_the_next_ones() {
    let (stage, mut rig) = demo();
    rig.run_until(15.5);
    let resting = |span_s: Range<f64>| {
        let (columns, t_s, values) = wearer(&rig, &stage, span_s);
        rests(&Stream { columns: &columns, t_s: &t_s, values: &values })
    };
    // The set lasts from 1.5 to 11.5 s.
    assert!((6..=23).all(|half| !resting(0.0..0.5 * f64::from(half))), "rests while it moves");
    assert!((27..=31).all(|half| resting(0.0..0.5 * f64::from(half))), "never rests");
    let (columns, t_s, values) = wearer(&rig, &stage, 0.0..13.5);
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let options = Options { name: "curl".into(), repetitions: 5, ..Options::default() };
    let lesson = teach(&stream, &options).unwrap();
    assert!(lesson.report.quality > 0.8, "{:?}", lesson.report);
    let names = &lesson.exercise.channels;
    assert!(names.iter().all(|name| Joint::of(name).is_some()), "a body has joints: {names:?}");
    rig.push(Input::Model(Model::Exercise { exercise: Box::new(lesson.exercise) }));
    rig.push(select(Plan { repetitions: Some(5), sets: Some(2), rest_s: 3.0 }));
    rig.run_until(64.0);
    assert_eq!(counts(&rig.emitted, "patient"), (1..=10).collect::<Vec<_>>());
    assert!(states(&rig.emitted, "patient").last().unwrap().exercises[0].done);
    // Who does as was taught hears of nothing, neither afterwards nor meanwhile.
    let said: Vec<_> = repetitions(&rig.emitted, "patient").into_iter().filter_map(|it| it.remark).collect();
    assert!(said.is_empty(), "{said:?}");
    let hints: Vec<_> = outcomes(&rig.emitted)
        .filter_map(|(_, what)| match what {
            ExerciseWhat::Hint(Some(hint)) => hint.remark.clone(),
            _ => None,
        })
        .collect();
    assert!(hints.is_empty(), "{hints:?}");
}

/// Its squats, counted beside the curls: nobody hears of an elbow, or of a plane that a hanging arm does not have.
#[test]
fn the_demos_squats_are_counted_beside_its_curls_without_a_complaint() {
    let (stage, mut rig) = demo();
    rig.run_until(79.0);
    let taught = |name: &str, span_s: Range<f64>| {
        let (columns, t_s, values) = wearer(&rig, &stage, span_s);
        let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
        let options = Options { name: name.into(), repetitions: 5, ..Options::default() };
        teach(&stream, &options).unwrap().exercise
    };
    let exercises = [taught("curl", 0.0..13.5), taught("squat", 58.0..78.0)];
    for exercise in exercises {
        rig.push(Input::Model(Model::Exercise { exercise: Box::new(exercise) }));
    }
    // Between the rounds he walks about the room.
    rig.run_until(177.6);
    let repetitions = repetitions(&rig.emitted, "default");
    for (name, sets) in [("curl", 3), ("squat", 2)] {
        let of = repetitions.iter().filter(|it| &*it.exercise == name);
        assert_eq!(of.filter(|it| it.kind == EventKind::Counted).count(), 5 * sets, "{name}");
    }
    let said: Vec<_> = repetitions.iter().filter_map(|it| it.remark).collect();
    assert!(said.is_empty(), "{said:?}");
    // He reaches about between the sets: that is not meant, and nobody hears of it.
    let meant = |it: &&&Repetition| it.kind == EventKind::Rejected && it.is_attempt;
    assert_eq!(repetitions.iter().filter(meant).collect::<Vec<_>>(), Vec::<&&Repetition>::new());
    // The arms curl by turns: neither the first nor the last of a set is lopsided for that.
    for it in repetitions.iter().filter(|it| it.kind == EventKind::Counted) {
        let score = it.feedback.as_ref().unwrap().1.score;
        assert!(score.total > 85.0 && score.symmetry.is_none_or(|symmetry| symmetry > 90.0), "{score:?}");
    }
}

/// The messages of `exercise` in a session of six curls.
pub(crate) fn live_messages() -> Vec<serde_json::Value> {
    let folder = tempfile::tempdir().unwrap();
    let text = toml::to_string(&stage(&[2])).unwrap().replace("\"none\"", "\"/dev/none\"");
    let mut rig = session(6);
    rig.run_until(24.0);
    record(&folder.path().join("take.mcap"), &rig.log, &text, "exercise")
}

#[test]
fn counting_and_teaching_from_the_recording_is_what_was_live() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).into_os_string();
    std::fs::write(path("curl.json"), CURL.to_json().unwrap()).unwrap();
    let text = toml::to_string(&stage(&[2])).unwrap().replace("\"none\"", "\"/dev/none\"");
    let mut rig = session(6);
    rig.run_until(24.0);
    let live = record(path("take.mcap").as_ref(), &rig.log, &text, "exercise");
    let (take, events) = (path("take.mcap"), path("events.csv"));
    let command: Vec<std::ffi::OsString> =
        vec!["exercise".into(), "count".into(), path("curl.json"), "--in".into(), take, "-o".into(), events];
    let output = posed(command);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let csv = std::fs::read_to_string(path("events.csv")).unwrap();
    let offline: Vec<(f64, f64, String, f64)> = csv
        .lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let number = |cell: usize| cells[cell].parse::<f64>().unwrap();
            (number(0), number(1), cells[4].to_owned(), number(5))
        })
        .collect();
    let words = ["started", "provisional", "counted", "rejected", "withdrawn"];
    let streamed: Vec<(f64, f64, String, f64)> = live
        .iter()
        .filter(|event| words.contains(&event["event"].as_str().unwrap()))
        .map(|event| {
            let number = |key: &str| event[key].as_f64().unwrap();
            let word = event["event"].as_str().unwrap().to_owned();
            (number("t_valid_s"), number("t_start_s"), word, number("count"))
        })
        .collect();
    assert!(streamed.iter().filter(|event| event.2 == "counted").count() == 6);
    // The end of a file is an end, that of a stream is not: only then a last repetition is certain.
    assert_eq!(offline[..streamed.len()], streamed);
    assert!(live.iter().any(|event| event["event"] == "loaded" && event["exercise"] == "curl"));

    let command: Vec<std::ffi::OsString> =
        ["exercise", "teach", "--name", "again", "--repetitions", "6", "-o"].map(Into::into).into();
    let output = posed(command.into_iter().chain([path("again.json"), path("take.mcap")]));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Exercise::from_json(&std::fs::read_to_string(path("again.json")).unwrap()).unwrap();
}

#[test]
fn a_session_is_taught_from_its_ranges_which_the_program_proposes() {
    let mut day = Day::new(&Person::new(500), 0);
    day.set(Training::Squat, 6, Variant::Right);
    day.set(Training::Curl, 7, Variant::Right);
    let (columns, t_s, values) = angles(&day.finish());
    let folder = tempfile::tempdir().unwrap();
    let (session, squat) = (folder.path().join("session.csv"), folder.path().join("squat.json"));
    Streams { columns, t_s, values }.write(&session).unwrap();
    let teach = |options: &[&str]| {
        let begin = ["exercise".as_ref(), "teach".as_ref(), session.as_os_str()];
        posed(begin.into_iter().chain(options.iter().map(|option| option.as_ref())))
    };
    let ranges = json(&teach(&["--propose", "--json"]))["ranges"].clone();
    let repetitions: Vec<u64> =
        ranges.as_array().unwrap().iter().map(|range| range["repetitions"].as_u64().unwrap()).collect();
    assert_eq!(repetitions, [6, 7], "{ranges}");
    // What it proposes is a command that works.
    let text = String::from_utf8(teach(&["--propose"]).stdout).unwrap();
    let words: Vec<&str> = text.lines().nth(1).unwrap().split_whitespace().collect();
    let options: Vec<&str> = words[4..]
        .iter()
        .map(|word| match *word {
            "NAME" => "squat",
            "NAME.json" => squat.to_str().unwrap(),
            word => word,
        })
        .collect();
    let output = teach(&options);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let exercise = Exercise::from_json(&std::fs::read_to_string(&squat).unwrap()).unwrap();
    assert_eq!(count(&exercise, &set(500, 3, Training::Squat, 9, Variant::Right)).0, 9);
    // Nothing in the session is repeated four times, and a range beside it holds nothing.
    let whole = ["--name", "squat", "--repetitions", "4", "-o", squat.to_str().unwrap()];
    let refused = teach(&whole);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--propose"));
    let empty = teach(&[&whole[..], &["--from-s", "5000"]].concat());
    assert!(String::from_utf8_lossy(&empty.stderr).contains("the range is empty"), "{empty:?}");
    assert_eq!(teach(&[&whole[..], &["--from-s", "9", "--to-s", "3"]].concat()).status.code(), Some(2));
}

#[test]
fn angles_whose_names_lack_their_unit_count_as_well_when_it_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let write = |name: &str, recording: &exercises::Recording| {
        let (columns, t_s, values) = angles(recording);
        let columns = columns.iter().map(|column| column.trim_end_matches("_deg").to_owned()).collect();
        Streams { columns, t_s, values }.write(path(name).as_ref()).unwrap();
    };
    write("lesson.csv", &set(500, 0, Training::Squat, 5, Variant::Right));
    write("set.csv", &set(500, 1, Training::Squat, 9, Variant::Right));
    let run = |words: &str| {
        posed(["exercise".to_owned()].into_iter().chain(
            words.split(' ').map(|word| if word.contains('.') { path(word) } else { word.to_owned() }),
        ))
    };
    let taught = run("teach lesson.csv --name squat --repetitions 5 -o squat.json --units deg");
    assert!(taught.status.success(), "{}", String::from_utf8_lossy(&taught.stderr));
    let exercise = Exercise::from_json(&std::fs::read_to_string(path("squat.json")).unwrap()).unwrap();
    assert!(exercise.channels.iter().all(|channel| channel.ends_with("_deg")), "{:?}", exercise.channels);
    // The same as from names that have their units.
    assert_eq!(exercise, lesson(Training::Squat, &set(500, 0, Training::Squat, 5, Variant::Right)).exercise);
    let counted = json(&run("count squat.json --in set.csv -o events.csv --units deg --json"));
    assert_eq!(counted["exercises"][0]["count"], 9, "{counted}");
    let unknown = run("count squat.json --in set.csv -o events.csv");
    assert!(String::from_utf8_lossy(&unknown.stderr).contains("needs the channel"), "{unknown:?}");
}
