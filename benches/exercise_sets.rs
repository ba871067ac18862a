//! How well exercises are taught, counted and corrected, over simulated people: `cargo bench --bench exercise_sets`,
//! with `-- SEED` for other people.
//!
//! Ten people, five exercises, ten sets of 5 to 15 repetitions each, taught from one set of five on another day; an
//! hour of other movement with all five exercises of a person counted at once; and sets in which one joint falls short
//! by 20 degrees.

use std::io::Write;

use posed_motion::exercise::{Counter, Event, EventKind, Exercise, Options, Stream, teach};
use posed_simulator::exercises::{ANGLES, Day, Exercise as Training, Person, RATE_HZ, Recording, Variant};

const PEOPLE: u64 = 10;
const SETS: u64 = 10;
const OTHER_S: f64 = 360.0;

#[derive(Default)]
struct Score {
    sets: usize,
    exact: usize,
    within_one: usize,
    refused: usize,
    repetitions: usize,
    /// Of a repetition, after its end.
    confirmed: Vec<f64>,
    /// Seconds after its end.
    provisional_s: Vec<f64>,
    false_counts: usize,
    other_s: f64,
    deficits: usize,
    named: usize,
}

fn main() -> std::io::Result<()> {
    let first = std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(300);
    let mut score = Score::default();
    for seed in first..first + PEOPLE {
        let person = Person::new(seed);
        let mut taught = Vec::new();
        for (number, training) in (0..).step_by(100).zip(Training::ALL) {
            let mut day = Day::new(&person, number);
            day.set(training, 5, Variant::Right);
            let options = Options { name: training.name().into(), repetitions: 5, channels: None };
            let Ok(lesson) = with_stream(&day.finish(), |stream| teach(&stream, &options)) else {
                score.refused += 1;
                score.sets += SETS as usize;
                continue;
            };
            for set in 0..SETS {
                let repetitions = 5 + (7 * set + seed - first) % 11;
                let mut day = Day::new(&person, number + 1 + set);
                day.set(training, repetitions as usize, Variant::Right);
                score.set(&lesson.exercise, &day.finish());
            }
            for angle in training.main_angles() {
                let mut day = Day::new(&person, number + 50 + angle as u64);
                day.set(training, 10, Variant::Short { angle, by_deg: 20.0 });
                score.deficit(&lesson.exercise, &day.finish(), angle);
            }
            taught.push(lesson.exercise);
        }
        let mut day = Day::new(&person, 999);
        day.other(OTHER_S);
        score.other(taught, &day.finish());
    }
    score.write(&mut std::io::stdout().lock())
}

fn with_stream<T>(recording: &Recording, then: impl FnOnce(Stream<'_>) -> T) -> T {
    let columns = ANGLES.map(str::to_owned);
    let rows = recording.angles_deg.len() / columns.len();
    let t_s: Vec<f64> = (0..rows).map(|row| row as f64 / RATE_HZ).collect();
    let values: Vec<Option<f64>> = recording.angles_deg.iter().map(|value| Some(*value)).collect();
    then(Stream { columns: &columns, t_s: &t_s, values: &values })
}

fn events(exercises: Vec<Exercise>, recording: &Recording) -> Vec<Event> {
    let mut events = Vec::new();
    with_stream(recording, |stream| {
        let Ok(mut counter) = Counter::new(exercises, stream.columns) else { return };
        for (row, t_s) in stream.values.chunks(stream.columns.len()).zip(stream.t_s) {
            counter.push(*t_s, row, &mut |event| events.push(event));
        }
    });
    events
}

/// Whether an event speaks of the repetition.
fn near(event: &Event, [start_s, end_s]: [f64; 2]) -> bool {
    (event.t_s - end_s).abs() < 0.5 * (end_s - start_s)
}

impl Score {
    fn set(&mut self, exercise: &Exercise, recording: &Recording) {
        let events = events(vec![exercise.clone()], recording);
        let of = |kind| events.iter().filter(move |event| event.kind == kind);
        let off = of(EventKind::Counted).count().abs_diff(recording.repetitions.len());
        self.sets += 1;
        self.exact += usize::from(off == 0);
        self.within_one += usize::from(off <= 1);
        self.repetitions += recording.repetitions.len();
        for truth in &recording.repetitions {
            let [start_s, end_s] = *truth;
            if let Some(event) = of(EventKind::Counted).find(|event| near(event, *truth)) {
                self.confirmed.push((event.t_decided_s - end_s) / (end_s - start_s));
            }
            if let Some(event) = of(EventKind::Provisional).find(|event| near(event, *truth)) {
                self.provisional_s.push(event.t_decided_s - end_s);
            }
        }
    }

    fn deficit(&mut self, exercise: &Exercise, recording: &Recording, angle: usize) {
        let events = events(vec![exercise.clone()], recording);
        let joint = ANGLES[angle].trim_end_matches("_deg").replace('_', " ");
        for truth in &recording.repetitions {
            self.deficits += 1;
            let judged = |event: &&Event| event.feedback.is_some() && near(event, *truth);
            let sentence = events.iter().find(judged).and_then(|event| event.feedback?.sentence(exercise));
            let named = |text: &String| text.starts_with(&joint) && text.ends_with("short at the top");
            self.named += usize::from(sentence.as_ref().is_some_and(named));
        }
    }

    fn other(&mut self, exercises: Vec<Exercise>, recording: &Recording) {
        self.other_s += (recording.angles_deg.len() / ANGLES.len()) as f64 / RATE_HZ;
        let counted = events(exercises, recording).iter().filter(|e| e.kind == EventKind::Counted).count();
        self.false_counts += counted;
    }

    fn write(mut self, out: &mut impl Write) -> std::io::Result<()> {
        let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
        self.confirmed.sort_by(f64::total_cmp);
        self.provisional_s.sort_by(f64::total_cmp);
        let at = |values: &[f64], share: f64| {
            values.get((share * values.len() as f64) as usize).copied().unwrap_or(f64::NAN)
        };
        let soon = self.provisional_s.partition_point(|t_s| *t_s <= 0.2);
        let Self { sets, refused, repetitions, false_counts, deficits, .. } = self;
        writeln!(
            out,
            "{sets} sets: exact {:.1} %, within one {:.1} %; {refused} demonstrations refused",
            percent(self.exact, sets),
            percent(self.within_one, sets)
        )?;
        writeln!(out, "{false_counts} false counts in {:.0} minutes of other movement", self.other_s / 60.0)?;
        writeln!(
            out,
            "counted {:.2} of a repetition after its end at the median, 95 %: {:.2}",
            at(&self.confirmed, 0.5),
            at(&self.confirmed, 0.95)
        )?;
        writeln!(
            out,
            "provisional within 0.2 s: {:.1} % of {repetitions} repetitions",
            percent(soon, repetitions)
        )?;
        writeln!(
            out,
            "20 degrees short named with joint and phase: {:.1} % of {deficits}",
            percent(self.named, deficits)
        )
    }
}
