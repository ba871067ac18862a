//! Teaching and counting together, on simulated joint angles with known truth.

use super::viterbi::tests::Random;
use super::*;

/// A recording under construction: two joint angles at 100 Hz.
struct Person {
    random: Random,
    columns: Vec<String>,
    t_s: Vec<f64>,
    values: Vec<Option<f64>>,
    /// How far both joints sit from where they are.
    offset_deg: f64,
    /// Beginning and end of every true repetition, s.
    truth: Vec<[f64; 2]>,
}

impl Person {
    fn new(seed: u64) -> Self {
        let columns = ["elbow_flexion_deg", "shoulder_flexion_deg"].map(str::to_owned).to_vec();
        let (t_s, values, truth) = (Vec::new(), Vec::new(), Vec::new());
        Self { random: Random::new(seed), columns, t_s, values, offset_deg: 0.0, truth }
    }

    fn noise(&mut self) -> f64 {
        (0..6).map(|_| self.random.unit() - 0.5).sum::<f64>() * 1.4
    }

    fn sample(&mut self, elbow_deg: f64, shoulder_deg: f64) {
        let row = [elbow_deg, shoulder_deg].map(|angle_deg| angle_deg + self.offset_deg + self.noise());
        self.t_s.push(self.t_s.len() as f64 / 100.0);
        self.values.extend(row.map(Some));
    }

    fn rest(&mut self, seconds: f64) {
        for _ in 0..(100.0 * seconds) as usize {
            self.sample(10.0, 5.0);
        }
    }

    /// One curl: the elbow goes up and down, the shoulder a little, with a share of the way done.
    fn curl(&mut self, seconds: f64, size: f64, elbow_short_deg: f64) {
        let start = self.t_s.len() as f64 / 100.0;
        let frames = (100.0 * seconds) as usize;
        for frame in 0..frames {
            let phase = frame as f64 / frames as f64;
            let lift = 0.5 - 0.5 * libm::cos(std::f64::consts::TAU * phase);
            self.sample(10.0 + (110.0 * size - elbow_short_deg) * lift, 5.0 + 25.0 * size * lift.powi(2));
        }
        self.truth.push([start, self.t_s.len() as f64 / 100.0]);
    }

    fn set(&mut self, count: usize) {
        self.rest(3.0);
        for _ in 0..count {
            let (tempo, size) = (0.85 + 0.3 * self.random.unit(), 0.95 + 0.1 * self.random.unit());
            self.curl(2.5 * tempo, size, 0.0);
        }
        self.rest(3.0);
    }

    fn stream(&self) -> Stream<'_> {
        Stream { columns: &self.columns, t_s: &self.t_s, values: &self.values }
    }
}

fn options(repetitions: usize) -> Options {
    Options { name: "curl".to_owned(), repetitions, ..Options::default() }
}

fn taught(seed: u64) -> Lesson {
    let mut person = Person::new(seed);
    person.set(5);
    teach(&person.stream(), &options(5)).unwrap()
}

fn events(exercises: Vec<Exercise>, person: &Person) -> Vec<Event> {
    let mut counter = Counter::new(exercises, &person.columns).unwrap();
    let mut events = Vec::new();
    for (row, t_s) in person.values.chunks(2).zip(&person.t_s) {
        counter.push(*t_s, row, &mut |event| events.push(event));
    }
    counter.finish(&mut |event| events.push(event));
    events
}

fn of(kind: EventKind, events: &[Event]) -> Vec<&Event> {
    events.iter().filter(|event| event.kind == kind).collect()
}

#[test]
fn given_five_repetitions_teaching_sees_them_where_they_are() {
    for seed in 0..6 {
        let mut person = Person::new(seed);
        person.set(5);
        let lesson = teach(&person.stream(), &options(5)).unwrap();
        assert!(lesson.report.quality > 0.9, "seed {seed}: {}", lesson.report.quality);
        for (seen, truth) in lesson.report.repetitions.iter().zip(&person.truth) {
            let width = 0.2 * lesson.exercise.durations.median_s;
            assert!((seen.t_start_s - truth[0]).abs() < width, "seed {seed}: {seen:?}, {truth:?}");
            assert!((seen.t_end_s - truth[1]).abs() < width, "seed {seed}: {seen:?}, {truth:?}");
        }
    }
}

#[test]
fn the_published_ways_see_a_clear_demonstration_too() {
    let ways = [(true, false), (false, true), (true, true)];
    for (kth_neighbour, per_channel) in ways {
        let mut person = Person::new(3);
        person.set(5);
        let as_published = AsPublished { kth_neighbour, per_channel };
        let lesson = teach(&person.stream(), &Options { as_published, ..options(5) }).unwrap();
        assert_eq!(lesson.report.repetitions.len(), 5, "{as_published:?}");
    }
}

#[test]
fn given_other_sets_all_are_counted_in_time_and_provisional_first() {
    for seed in 0..6 {
        let exercise = taught(seed).exercise;
        let mut person = Person::new(100 + seed);
        person.set(10);
        let events = events(vec![exercise.clone()], &person);
        let counted = of(EventKind::Counted, &events);
        assert_eq!(counted.len(), 10, "seed {seed}");
        for (index, (event, truth)) in counted.iter().zip(&person.truth).enumerate() {
            assert_eq!(event.count, index as u64 + 1);
            assert!((event.t_s - truth[1]).abs() < 0.5, "seed {seed}: {event:?}, {truth:?}");
            assert!(event.t_start_s > truth[0] - 0.5, "before it began: {event:?}, {truth:?}");
            assert!(event.t_decided_s - truth[1] < 0.6 * exercise.durations.median_s, "{event:?}");
        }
        // What was provisional was counted, or taken back.
        let provisional = of(EventKind::Provisional, &events).len();
        assert!(provisional >= 8, "seed {seed}: {provisional}");
    }
}

#[test]
fn given_half_movements_and_aborted_ones_nothing_counts() {
    let exercise = taught(1).exercise;
    let mut person = Person::new(50);
    person.rest(3.0);
    for _ in 0..10 {
        person.curl(2.5, 0.5, 0.0);
        person.rest(1.0);
    }
    // Up quickly and straight down again from a third of the way.
    for _ in 0..10 {
        person.curl(1.0, 0.35, 0.0);
        person.rest(1.0);
    }
    // A slow drift up and down.
    person.curl(40.0, 1.0, 0.0);
    person.rest(3.0);
    let events = events(vec![exercise], &person);
    assert_eq!(of(EventKind::Counted, &events).len(), 0, "{events:?}");
}

#[test]
fn given_a_joint_in_another_posture_it_is_another_exercise_and_given_a_dead_one_it_is_not() {
    let exercise = taught(1).exercise;
    assert_eq!(exercise.channels.len(), 2);
    // Of each row, what a joint says instead.
    let joint = |channel: usize, angle_deg: &dyn Fn(f64) -> Option<f64>| {
        let mut person = Person::new(60);
        person.set(8);
        for row in person.values.chunks_mut(2) {
            row[channel] = row[channel].and_then(angle_deg);
        }
        let events = events(vec![exercise.clone()], &person);
        (of(EventKind::Counted, &events).len(), of(EventKind::Rejected, &events).len())
    };
    let reported = |shoulder_deg: &dyn Fn(f64) -> Option<f64>| joint(1, shoulder_deg);
    assert_eq!(reported(&|deg| Some(deg + 20.0)).0, 8, "worn otherwise");
    assert_eq!(reported(&|_| Some(90.0)).0, 8, "frozen");
    assert_eq!(reported(&|_| None).0, 8, "silent");
    assert_eq!(joint(0, &|_| None).0, 8, "the elbow silent, which does most of the work");
    let (counted, rejected) = reported(&|deg| Some(deg + 85.0));
    assert!(counted == 0 && rejected > 0, "the arm held up: {counted} counted, {rejected} rejected");
}

#[test]
fn given_a_rest_only_recording_teaching_refuses() {
    let mut person = Person::new(3);
    person.rest(20.0);
    assert!(teach(&person.stream(), &options(5)).is_err());
}

#[test]
fn given_fewer_repetitions_than_announced_the_refusal_says_how_many_it_saw() {
    let mut person = Person::new(4);
    person.set(3);
    let refusal = teach(&person.stream(), &options(5)).unwrap_err().to_string();
    assert!(refusal.contains("of 5"), "{refusal}");
}

/// Steps: short movements with rests between them, the first and the last one of this size.
fn steps(seed: u64, count: usize, outer: f64) -> Person {
    let mut person = Person::new(seed);
    person.rest(3.0);
    for step in 0..count {
        let size = if step == 0 || step + 1 == count { outer } else { 0.9 + 0.2 * person.random.unit() };
        person.curl(0.7, size, 0.0);
        person.rest(0.4);
    }
    person.rest(3.0);
    person
}

#[test]
fn given_smaller_ones_among_the_taught_they_count_and_otherwise_not() {
    let (taught, other) = (steps(1, 12, 0.4), steps(2, 12, 0.4));
    let lesson = teach(&taught.stream(), &options(12)).unwrap();
    assert_eq!(lesson.report.repetitions.len(), 12, "{:?}", lesson.report);
    assert!(lesson.exercise.sizes.len() > 1, "{:?}", lesson.exercise.sizes);
    assert_eq!(Exercise::from_json(&lesson.exercise.to_json().unwrap()).unwrap(), lesson.exercise);
    assert_eq!(of(EventKind::Counted, &events(vec![lesson.exercise.clone()], &other)).len(), 12);
    // Taught in full size alone, smaller ones are none.
    let full = teach(&steps(3, 12, 1.0).stream(), &options(12)).unwrap().exercise;
    assert_eq!(full.sizes, [1.0]);
    assert_eq!(of(EventKind::Counted, &events(vec![full], &other)).len(), 10);
    // An exercise of an older file has one size and one tempo.
    let mut older: serde_json::Value = serde_json::from_str(&lesson.exercise.to_json().unwrap()).unwrap();
    for newer in ["sizes", "tempi", "rest"] {
        older.as_object_mut().unwrap().remove(newer);
    }
    let older = Exercise::from_json(&older.to_string()).unwrap();
    assert_eq!((older.sizes, older.tempi, older.rest), (vec![1.0], vec![1.0], Vec::new()));
    let mut damaged = lesson.exercise;
    damaged.sizes = vec![0.5];
    assert!(damaged.check().is_err());
}

#[test]
fn given_somebody_in_another_tempo_repetitions_count_and_look_more_like_the_lesson_than_in_its_own_alone() {
    let exercise = taught(4).exercise;
    let alone = Exercise { tempi: vec![1.0], ..exercise.clone() };
    let ratio = |exercise: &Exercise, seconds: f64| {
        let mut person = Person::new(90);
        person.rest(3.0);
        (0..10).for_each(|_| person.curl(seconds, 1.0, 0.0));
        person.rest(3.0);
        let events = events(vec![exercise.clone()], &person);
        let counted = of(EventKind::Counted, &events);
        assert_eq!(counted.len(), 10, "{seconds} s");
        counted.iter().map(|event| event.measures.unwrap().mean_log_ratio).sum::<f64>() / 10.0
    };
    for (seconds, gains) in [(1.6, 1.1), (2.5, 0.99), (4.0, 1.1)] {
        let (with, without) = (ratio(&exercise, seconds), ratio(&alone, seconds));
        assert!(with > gains * without, "{seconds} s: {with}, {without}");
    }
    for tempi in [vec![], vec![1.4, 1.0], vec![1.0, 0.0], vec![1.0, f64::NAN], vec![1.0; 9]] {
        assert!(Exercise { tempi: tempi.clone(), ..exercise.clone() }.check().is_err(), "{tempi:?}");
    }
}

#[test]
fn given_somebody_twice_as_fast_as_the_lesson_none_comes_too_soon() {
    let curls = |seed: u64, count: usize, seconds: f64| {
        let mut person = Person::new(seed);
        person.rest(3.0);
        (0..count).for_each(|_| person.curl(seconds, 1.0, 0.0));
        person.rest(3.0);
        person
    };
    let exercise = teach(&curls(92, 5, 3.6).stream(), &options(5)).unwrap().exercise;
    let alone = Exercise { tempi: vec![1.0], ..exercise.clone() };
    let fast = curls(93, 10, 1.8);
    let counted = |exercise: Exercise| of(EventKind::Counted, &events(vec![exercise], &fast)).len();
    assert_eq!(counted(exercise), 10);
    assert!(counted(alone) < 8);
}

#[test]
fn given_somebody_who_stands_otherwise_repetitions_count_from_where_they_rest() {
    let exercise = taught(4).exercise;
    for (rest, expected) in exercise.rest.iter().zip([10.0, 5.0]) {
        assert!((rest - expected).abs() < 1.0, "{:?}", exercise.rest);
    }
    let unaware = Exercise { rest: Vec::new(), ..exercise.clone() };
    let ratio = |exercise: &Exercise, offset_deg: f64| {
        let mut person = Person { offset_deg, ..Person::new(91) };
        person.set(10);
        let events = events(vec![exercise.clone()], &person);
        let counted = of(EventKind::Counted, &events);
        assert_eq!(counted.len(), 10, "{offset_deg} degrees");
        counted.iter().map(|event| event.measures.unwrap().mean_log_ratio).sum::<f64>() / 10.0
    };
    let usual = ratio(&exercise, 0.0);
    for offset_deg in [-20.0, 20.0] {
        assert!(ratio(&exercise, offset_deg) > 0.95 * usual && ratio(&unaware, offset_deg) < 0.8 * usual);
    }
    for rest in [vec![0.0], vec![f64::NAN, 0.0]] {
        assert!(Exercise { rest, ..exercise.clone() }.check().is_err());
    }
}

#[test]
fn given_a_deficit_at_the_top_the_feedback_names_joint_place_and_size() {
    let exercise = taught(2).exercise;
    let mut person = Person::new(60);
    person.rest(3.0);
    for _ in 0..10 {
        person.curl(2.5, 1.0, 30.0);
    }
    person.rest(3.0);
    let events = events(vec![exercise.clone()], &person);
    let sentences: Vec<String> =
        events.iter().filter_map(|event| event.sentence(&exercise, Language::English)).collect();
    let named = sentences
        .iter()
        .filter(|sentence| {
            sentence.starts_with("elbow bent 3") && sentence.ends_with("less than shown at the top")
        })
        .count();
    assert!(named >= 9, "{sentences:?}");
}

#[test]
fn given_a_snapshot_counting_goes_on_as_before() {
    let mut person = Person::new(70);
    person.set(4);
    let mut counter = Counter::new(vec![taught(5).exercise], &person.columns).unwrap();
    let half = person.t_s.len() / 2;
    let push = |counter: &mut Counter, from: usize, to: usize| {
        let mut events = Vec::new();
        for row in from..to {
            counter.push(person.t_s[row], &person.values[2 * row..2 * row + 2], &mut |e| events.push(e));
        }
        events
    };
    push(&mut counter, 0, half);
    let mut restored = Counter::new(vec![taught(5).exercise], &person.columns).unwrap();
    posed_state::restore(&mut restored, &posed_state::snapshot(&counter)).unwrap();
    let (a, b) = (push(&mut counter, half, person.t_s.len()), push(&mut restored, half, person.t_s.len()));
    assert!(!a.is_empty());
    assert_eq!(a, b);
}

#[test]
fn given_lost_samples_and_a_long_gap_it_keeps_counting() {
    let exercise = taught(6).exercise;
    let mut person = Person::new(80);
    person.set(5);
    let mut random = Random::new(9);
    let mut counter = Counter::new(vec![exercise], &person.columns).unwrap();
    let mut counted = 0;
    for part in 0..2 {
        for (row, t_s) in person.values.chunks(2).zip(&person.t_s) {
            if random.unit() > 0.4 {
                let mut count = |event: Event| counted += usize::from(event.kind == EventKind::Counted);
                counter.push(t_s + 500.0 * f64::from(part), row, &mut count);
            }
        }
    }
    counter.finish(&mut |event| counted += usize::from(event.kind == EventKind::Counted));
    assert_eq!(counted, 10);
}

#[test]
fn an_exercise_file_comes_back_as_it_was_and_others_are_refused() {
    let exercise = taught(0).exercise;
    let text = exercise.to_json().unwrap();
    assert_eq!(Exercise::from_json(&text).unwrap(), exercise);
    let newer = text.replacen("\"version\": 1", "\"version\": 2", 1);
    assert!(Exercise::from_json(&newer).unwrap_err().to_string().contains("version 2"));
    let mut damaged = exercise.clone();
    damaged.movement.states.sd[0][0] = 0.0;
    assert!(Exercise::from_json(&damaged.to_json().unwrap()).is_err());
    assert!(Exercise::from_json("{}").is_err());
}

#[test]
fn a_missing_channel_is_named() {
    let error = Counter::new(vec![taught(0).exercise], &["knee_deg".to_owned()]).unwrap_err();
    assert!(error.to_string().contains("elbow_flexion_deg"), "{error}");
}

/// The largest exercise that every single check lets through.
fn enormous() -> Exercise {
    let mut exercise = taught(1).exercise;
    let states = 4096;
    for rows in [&mut exercise.movement.states.mean, &mut exercise.movement.states.sd] {
        rows.iter_mut().for_each(|row| *row = vec![row[0]; states]);
    }
    exercise.sizes = (0..8).map(|k| 1.0 - 0.1 * f64::from(k)).collect();
    exercise.tempi = (0..8).map(|k| 1.0 + 0.1 * f64::from(k)).collect();
    exercise.rate_hz = 1000.0;
    (exercise.durations.median_s, exercise.durations.longest_s) = (599.0, 599.0);
    exercise.check().unwrap();
    exercise
}

#[test]
fn an_exercise_that_would_take_gigabytes_is_refused_before_they_are_taken() {
    let columns = enormous().channels;
    let refusal = Counter::new(vec![enormous()], &columns).unwrap_err();
    assert!(matches!(refusal, CounterError::TooCostly { states: 61441, .. }), "{refusal}");
    // Each could be counted alone.
    let many = |k: u32| {
        let mut exercise = enormous();
        exercise.name = format!("exercise {k}");
        (exercise.rate_hz, exercise.durations.median_s, exercise.durations.longest_s) = (25.0, 4.0, 6.0);
        exercise.sizes.truncate(2);
        exercise.tempi.truncate(2);
        exercise
    };
    assert!(Counter::new(vec![many(0)], &columns).is_ok());
    let refusal = Counter::new((0..8).map(many).collect(), &columns).unwrap_err();
    assert!(refusal.to_string().contains("select fewer exercises"), "{refusal}");
}

/// Strides of a foot, seen by its angular velocities: about `gy` all alike, about the other axes but for those that turn.
fn strides(seed: u64, count: usize) -> (Vec<String>, Vec<f64>, Vec<Option<f64>>) {
    let mut random = Random::new(seed);
    let columns = ["gx", "gy", "gz"].map(str::to_owned).to_vec();
    let mut values = Vec::new();
    let noise = |random: &mut Random| 0.2 * (random.unit() - 0.5);
    for _ in 0..200 {
        values.extend([Some(noise(&mut random)), Some(noise(&mut random)), Some(noise(&mut random))]);
    }
    for stride in 0..count {
        let across = if stride % 4 == 2 { [-5.0, 4.0] } else { [3.0, -2.0] };
        let frames = (100.0 + 20.0 * (random.unit() - 0.5)) as usize;
        for frame in 0..frames {
            let phase = frame as f64 / frames as f64;
            let swing =
                libm::exp(-(phase - 0.5).powi(2) / 0.01) - 0.4 * libm::exp(-(phase - 0.8).powi(2) / 0.004);
            let row = [across[0] * swing, 5.0 * swing, across[1] * swing];
            values.extend(row.map(|value| Some(value + noise(&mut random))));
        }
    }
    for _ in 0..200 {
        values.extend([Some(noise(&mut random)), Some(noise(&mut random)), Some(noise(&mut random))]);
    }
    let t_s = (0..values.len() / 3).map(|row| row as f64 / 100.0).collect();
    (columns, t_s, values)
}

#[test]
fn the_axis_that_does_the_same_in_every_repetition_is_taken_and_the_report_says_why() {
    let (columns, t_s, values) = strides(3, 14);
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let Lesson { exercise, report } = teach(&stream, &options(14)).unwrap();
    assert_eq!(exercise.channels, ["gy"], "{:?}", report.tried);
    assert!(report.because.contains("; in gx, gy, gz it counts"), "{}", report.because);
    let named = Options { channels: Some(vec!["gy".to_owned()]), ..options(14) };
    assert_eq!(teach(&stream, &named).unwrap().report.because, "they were asked for");
}

/// The stream without the rows of some stretches, s.
fn without(person: &Person, lost_s: &[[f64; 2]]) -> (Vec<f64>, Vec<Option<f64>>) {
    let is_there = |t_s: &f64| lost_s.iter().all(|[from_s, to_s]| t_s < from_s || t_s > to_s);
    let rows = person.t_s.iter().zip(person.values.chunks(2)).filter(|(t_s, _)| is_there(t_s));
    let (t_s, values): (Vec<f64>, Vec<&[Option<f64>]>) = rows.unzip();
    (t_s, values.concat())
}

#[test]
fn given_lost_packets_it_teaches_what_was_there() {
    for seed in 0..6 {
        let mut person = Person::new(seed);
        person.set(6);
        // A little of some repetitions, and all of one.
        let some = [0, 2, 4].map(|index| [person.truth[index][0] + 0.8, person.truth[index][0] + 1.3]);
        let whole = [[person.truth[3][0] + 0.1, person.truth[3][1] - 0.1]];
        for (lost_s, seen) in [(&some[..], 6), (&whole[..], 5)] {
            let (t_s, values) = without(&person, lost_s);
            let stream = Stream { columns: &person.columns, t_s: &t_s, values: &values };
            let lesson = teach(&stream, &options(6)).unwrap();
            assert_eq!(lesson.report.repetitions.len(), seen, "seed {seed}");
            let says_so = lesson.report.remarks.iter().any(|remark| remark.contains("no packets came from"));
            assert_eq!(says_so, seen < 6, "{:?}", lesson.report.remarks);
        }
    }
}

#[test]
fn given_one_that_is_different_one_more_is_asked_for_and_enough() {
    let mut person = Person::new(5);
    person.rest(3.0);
    let different = |person: &mut Person| person.curl(9.0, 1.0, 0.0);
    (0..2).for_each(|_| person.curl(2.5, 1.0, 0.0));
    different(&mut person);
    (0..2).for_each(|_| person.curl(2.5, 1.0, 0.0));
    person.rest(3.0);
    let refusal = teach(&person.stream(), &options(5)).unwrap_err();
    assert!(matches!(refusal, Refusal::Count { more: 1, .. }), "{refusal}");
    assert!(refusal.to_string().ends_with("do 1 more repetition like the others, then rest"), "{refusal}");
    person.curl(2.5, 1.0, 0.0);
    person.rest(3.0);
    assert_eq!(teach(&person.stream(), &options(5)).unwrap().report.repetitions.len(), 5);
}
