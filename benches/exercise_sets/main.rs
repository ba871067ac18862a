//! How well exercises are taught, counted and corrected, over simulated people: `cargo bench --bench exercise_sets`,
//! with `-- SEED` for other people.
//!
//! Ten people, five exercises, ten sets of 5 to 15 repetitions each, taught from one set of five on another day, and sets in which one
//! joint falls short by 20 degrees, or in which the trunk leans back by 20: with the one exercise loaded, with all five of the person, and
//! with all five of somebody else. An hour of other movement with all five, and captured people: those in `tests/recordings`, and with
//! `-- SEED FILE... [--rate HZ]` those of tables of joint positions (mm, y up; 30 Hz unless said).

mod captured;
mod lessons;

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;

use captured::Captured;
use posed_motion::exercise::{
    AsPublished, Counter, DeviationKind, Event, EventKind, Exercise, Lesson, MovementPhase, Options, Remark,
    Stream, teach,
};
use posed_recording::table::{SequenceOptions, Unit, Up};
use posed_simulator::exercises::{ANGLES, Day, Exercise as Training, Person, RATE_HZ, Recording, Variant};

const PEOPLE: u64 = 10;
const SETS: u64 = 10;
const OTHER_S: f64 = 360.0;

/// Of one way to count: an exercise by itself, or all of a person at once.
#[derive(Default)]
struct Score {
    sets: usize,
    exact: usize,
    within_one: usize,
    /// Counts of another exercise than was done.
    wrong_name: usize,
    repetitions: usize,
    /// Of a repetition, after its end.
    confirmed: Vec<f64>,
    /// Seconds after its end.
    provisional_s: Vec<f64>,
    /// Repetitions that were right and were heard of, and those of them that heard a complaint.
    right: usize,
    complained: usize,
    deficits: usize,
    /// Of these, the repetitions of which joint and phase were named.
    named: usize,
    leaned: usize,
    /// Of these, the repetitions of which it was said that the trunk leaned.
    lean_named: usize,
}

/// What a person was taught: each exercise, none where its demonstration was refused.
struct Lessons {
    person: Person,
    seed: u64,
    exercises: Vec<Option<Exercise>>,
}

fn main() -> std::io::Result<()> {
    let captures = captures()?;
    let mut on_captures = OnCaptures::default();
    let first = std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(300);
    let (mut alone, mut together, mut strangers) = (Score::default(), Score::default(), Score::default());
    let mut before: Option<Vec<Exercise>> = None;
    let (mut refused, mut false_counts, mut other_s) = (0, 0, 0.0);
    for seed in first..first + PEOPLE {
        let lessons = Lessons::new(seed);
        refused += lessons.exercises.iter().filter(|exercise| exercise.is_none()).count();
        lessons.count(first, |number| lessons.exercises[number].iter().cloned().collect(), &mut alone);
        let all = || lessons.taught();
        lessons.count(first, |_| all(), &mut together);
        // With what the person before was taught.
        let others = before.replace(all()).unwrap_or_else(|| Lessons::new(first + PEOPLE).taught());
        lessons.count(first, |_| others.clone(), &mut strangers);
        let mut day = Day::new(&lessons.person, 999);
        day.other(OTHER_S);
        let recording = day.finish();
        other_s += (recording.angles_deg.len() / ANGLES.len()) as f64 / RATE_HZ;
        false_counts += events(all(), &recording).iter().filter(|e| e.kind == EventKind::Counted).count();
        captures.iter().for_each(|captured| on_captures.count(&all(), captured));
    }
    let mut out = std::io::stdout().lock();
    writeln!(out, "{refused} demonstrations refused")?;
    lessons::compare(first, &mut out)?;
    writeln!(out, "{false_counts} false counts in {:.0} minutes of other movement", other_s / 60.0)?;
    on_captures.write(&mut out)?;
    alone.write("one exercise loaded", &mut out)?;
    together.write("all five loaded", &mut out)?;
    strangers.write("all five of somebody else loaded", &mut out)
}

/// Both sides of all captured people.
fn captures() -> std::io::Result<Vec<Captured>> {
    let mut given = std::env::args().skip(1).filter(|argument| argument.parse::<u64>().is_err());
    let mut rate_hz = 30.0;
    let mut files: Vec<(PathBuf, Option<f64>)> = ["13_29", "13_30", "14_20"]
        .map(|name| (posed_rig::recording("cmu-labelled", &format!("{name}.csv.gz")), Some(120.0)))
        .into();
    while let Some(argument) = given.next() {
        match argument.as_str() {
            "--bench" => {}
            "--rate" => rate_hz = given.next().and_then(|rate| rate.parse().ok()).unwrap_or(rate_hz),
            path => files.push((path.into(), None)),
        }
    }
    let mut all = Vec::new();
    for (path, own_hz) in files {
        let rate_hz = own_hz.or(Some(rate_hz));
        let read = captured::read(&path, &SequenceOptions { rate_hz, unit: Unit::Mm, up: Up::Y });
        let sides = read.map_err(std::io::Error::other)?;
        let missing = || std::io::Error::other(format!("{}: joints are missing", path.display()));
        all.extend(sides.ok_or_else(missing)?);
    }
    Ok(all)
}

/// What is counted in captured movement, by what it shows: exercises as they are named.
#[derive(Default)]
struct OnCaptures {
    seconds: BTreeMap<String, f64>,
    counts: BTreeMap<String, BTreeMap<String, usize>>,
}

impl OnCaptures {
    fn count(&mut self, exercises: &[Exercise], captured: &Captured) {
        for (steps, label) in captured.t_s.windows(2).zip(&captured.labels) {
            *self.seconds.entry(label.clone()).or_default() += (steps[1] - steps[0]).min(0.1);
        }
        let columns = ANGLES.map(str::to_owned);
        let stream = Stream { columns: &columns, t_s: &captured.t_s, values: &captured.angles_deg };
        for event in events_of(exercises.to_vec(), &stream).iter().filter(|e| e.kind == EventKind::Counted) {
            let at = captured.t_s.partition_point(|t_s| *t_s < event.t_s).min(captured.labels.len() - 1);
            let counts = self.counts.entry(captured.labels[at].clone()).or_default();
            *counts.entry(exercises[event.exercise].name.clone()).or_default() += 1;
        }
    }

    fn write(&self, out: &mut impl Write) -> std::io::Result<()> {
        let all_s: f64 = self.seconds.values().sum();
        writeln!(out, "captured movement, {:.0} minutes of both sides:", all_s / 60.0)?;
        for (shown, seconds) in &self.seconds {
            write!(out, "  {shown}, {:.1} minutes:", seconds / 60.0)?;
            match self.counts.get(shown) {
                Some(counts) => counts.iter().try_for_each(|(name, count)| write!(out, " {count} {name}"))?,
                None => write!(out, " no count")?,
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

impl Lessons {
    fn new(seed: u64) -> Self {
        let person = Person::new(seed);
        let taught = |(_, lesson): (Recording, Option<Lesson>)| lesson.map(|lesson| lesson.exercise);
        let exercises = demonstrated(&person, AsPublished::default()).map(taught).collect();
        Self { person, seed, exercises }
    }

    fn taught(&self) -> Vec<Exercise> {
        self.exercises.iter().flatten().cloned().collect()
    }

    /// Counts all sets of this person with what is loaded for each exercise.
    fn count(&self, first: u64, loaded: impl Fn(usize) -> Vec<Exercise>, score: &mut Score) {
        for (at, training) in Training::ALL.into_iter().enumerate() {
            let number = 100 * at as u64;
            if self.exercises[at].is_none() {
                score.sets += SETS as usize;
                continue;
            }
            let exercises = loaded(at);
            for set in 0..SETS {
                let repetitions = 5 + (7 * set + self.seed - first) % 11;
                let mut day = Day::new(&self.person, number + 1 + set);
                day.set(training, repetitions as usize, Variant::Right);
                score.set(&exercises, training.name(), &day.finish());
            }
            for angle in training.main_angles() {
                let mut day = Day::new(&self.person, number + 50 + angle as u64);
                day.set(training, 10, Variant::Short { angle, by_deg: 20.0 });
                score.deficit(&exercises, training.name(), &day.finish(), angle);
            }
            let mut day = Day::new(&self.person, number + 70);
            day.set(training, 10, Variant::Leans(20.0));
            score.lean(&exercises, training.name(), &day.finish());
        }
    }
}

/// Five repetitions of each exercise, and what is taught from them; nothing where they are refused.
fn demonstrated(
    person: &Person,
    as_published: AsPublished,
) -> impl Iterator<Item = (Recording, Option<Lesson>)> {
    (0..).step_by(100).zip(Training::ALL).map(move |(number, training)| {
        let mut day = Day::new(person, number);
        day.set(training, 5, Variant::Right);
        let recording = day.finish();
        let name = training.name().into();
        let options = Options { name, repetitions: 5, as_published, ..Options::default() };
        let lesson = with_stream(&recording, |stream| teach(&stream, &options)).ok();
        (recording, lesson)
    })
}

fn with_stream<T>(recording: &Recording, then: impl FnOnce(Stream<'_>) -> T) -> T {
    let columns = ANGLES.map(str::to_owned);
    let rows = recording.angles_deg.len() / columns.len();
    let t_s: Vec<f64> = (0..rows).map(|row| row as f64 / RATE_HZ).collect();
    let values: Vec<Option<f64>> = recording.angles_deg.iter().map(|value| Some(*value)).collect();
    then(Stream { columns: &columns, t_s: &t_s, values: &values })
}

fn events(exercises: Vec<Exercise>, recording: &Recording) -> Vec<Event> {
    with_stream(recording, |stream| events_of(exercises, &stream))
}

fn events_of(exercises: Vec<Exercise>, stream: &Stream<'_>) -> Vec<Event> {
    let mut events = Vec::new();
    let Ok(mut counter) = Counter::new(exercises, stream.columns) else { return events };
    for (row, t_s) in stream.values.chunks(stream.columns.len()).zip(stream.t_s) {
        counter.push(*t_s, row, &mut |event| events.push(event));
    }
    events
}

/// Whether an event speaks of the repetition.
fn near(event: &Event, [start_s, end_s]: [f64; 2]) -> bool {
    (event.t_s - end_s).abs() < 0.5 * (end_s - start_s)
}

impl Score {
    fn set(&mut self, exercises: &[Exercise], name: &str, recording: &Recording) {
        let events = events(exercises.to_vec(), recording);
        let done = |event: &&Event| exercises[event.exercise].name == name;
        let of = |kind| events.iter().filter(move |event| event.kind == kind).filter(done);
        let off = of(EventKind::Counted).count().abs_diff(recording.repetitions.len());
        self.sets += 1;
        self.exact += usize::from(off == 0);
        self.within_one += usize::from(off <= 1);
        self.wrong_name +=
            events.iter().filter(|event| event.kind == EventKind::Counted && !done(event)).count();
        self.repetitions += recording.repetitions.len();
        for truth in &recording.repetitions {
            let [start_s, end_s] = *truth;
            if let Some(event) = of(EventKind::Counted).find(|event| near(event, *truth)) {
                self.confirmed.push((event.t_decided_s - end_s) / (end_s - start_s));
                self.right += 1;
                self.complained += usize::from(event.remark.is_some());
            }
            if let Some(event) = of(EventKind::Provisional).find(|event| near(event, *truth)) {
                self.provisional_s.push(event.t_decided_s - end_s);
            }
        }
    }

    /// The event that judges a repetition of an exercise.
    fn judged<'a>(
        events: &'a [Event],
        exercises: &[Exercise],
        name: &str,
        truth: [f64; 2],
    ) -> Option<&'a Event> {
        events.iter().find(|event| {
            event.feedback.is_some() && near(event, truth) && exercises[event.exercise].name == name
        })
    }

    fn deficit(&mut self, exercises: &[Exercise], name: &str, recording: &Recording, angle: usize) {
        let events = events(exercises.to_vec(), recording);
        for truth in &recording.repetitions {
            self.deficits += 1;
            let Some(event) = Self::judged(&events, exercises, name, *truth) else { continue };
            let channels = &exercises[event.exercise].channels;
            self.named += usize::from(matches!(
                event.remark,
                Some(Remark::Deviation { channel, kind: DeviationKind::Short, place: MovementPhase::Top, .. })
                    if channels[channel] == ANGLES[angle]
            ));
        }
    }

    fn lean(&mut self, exercises: &[Exercise], name: &str, recording: &Recording) {
        let events = events(exercises.to_vec(), recording);
        for truth in &recording.repetitions {
            self.leaned += 1;
            let Some(event) = Self::judged(&events, exercises, name, *truth) else { continue };
            let of = |channel| exercises[event.exercise].channel(channel) == Some("trunk_flexion_deg");
            self.lean_named +=
                usize::from(matches!(event.remark, Some(Remark::Deviation { channel, .. }) if of(channel)));
        }
    }

    fn write(mut self, title: &str, out: &mut impl Write) -> std::io::Result<()> {
        let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
        self.confirmed.sort_by(f64::total_cmp);
        self.provisional_s.sort_by(f64::total_cmp);
        let at = |values: &[f64], share: f64| {
            values.get((share * values.len() as f64) as usize).copied().unwrap_or(f64::NAN)
        };
        let soon = self.provisional_s.partition_point(|t_s| *t_s <= 0.2);
        let Self { sets, repetitions, deficits, right, complained, wrong_name, .. } = self;
        writeln!(
            out,
            "{title}: {sets} sets, exact {:.1} %, within one {:.1} %, {wrong_name} counts under a wrong name",
            percent(self.exact, sets),
            percent(self.within_one, sets)
        )?;
        writeln!(
            out,
            "  counted {:.2} of a repetition after its end at the median, 95 %: {:.2}",
            at(&self.confirmed, 0.5),
            at(&self.confirmed, 0.95)
        )?;
        writeln!(
            out,
            "  provisional within 0.2 s: {:.1} % of {repetitions} repetitions",
            percent(soon, repetitions)
        )?;
        writeln!(
            out,
            "  right ones without a complaint: {:.1} % of {right}; 20 degrees short named with joint and phase: {:.1} % of {deficits}",
            percent(right - complained, right),
            percent(self.named, deficits)
        )?;
        writeln!(
            out,
            "  trunk that leans back by 20 degrees named: {:.1} % of {}",
            percent(self.lean_named, self.leaned),
            self.leaned
        )
    }
}
