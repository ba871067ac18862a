//! How well teaching and counting work: `cargo run --release --example evaluate_exercise -- FOLDER`.
//!
//! FOLDER holds the watch recordings (`sets.csv` and one `.csv.gz` per set). For each activity with sets on two or
//! more days the set with the median number of repetitions of one day is taught, and all sets of the other days are
//! counted; every day is the teaching day once. One line per set, a summary at the end. Sets whose written
//! count is in dispute are named in `docs/exercise.md`; the summary is given with and without them.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::io::Write;
use std::path::Path;

use posed_motion::exercise::{Counter, Event, EventKind, Options, Stream, teach};
use posed_recording::table::{Streams, TableReader};

/// Sets whose notes the recording contradicts; `docs/exercise.md` states why.
const DISPUTED: [&str; 7] = [
    "011224_CGCR_W52_S3_R8",
    "011224_DWC_W7_5_S1_R12",
    "011224_PREC_W7_5_S2_R10",
    "100125_IDBC_W7_5_S3_R10",
    "231124_SAOCTE_W11_S2_R15",
    "231224_APULL_W66_S3_R8",
    "261124_SACLR_W4_5_S2_R15",
];

struct Set {
    name: String,
    repetitions: usize,
    streams: Streams,
    active: Vec<bool>,
}

impl Set {
    fn day(&self) -> &str {
        &self.name[..6]
    }
}

#[derive(Default)]
struct Score {
    sets: usize,
    exact: usize,
    within_one: usize,
}

impl Score {
    fn add(&mut self, off: i64) {
        self.sets += 1;
        self.exact += usize::from(off == 0);
        self.within_one += usize::from(off.abs() <= 1);
    }

    fn line(&self) -> String {
        let percent = |part: usize| 100.0 * part as f64 / self.sets.max(1) as f64;
        let (sets, exact, one) = (self.sets, percent(self.exact), percent(self.within_one));
        format!("{sets} sets, exact {exact:.1} %, within one {one:.1} %")
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("give the folder with sets.csv")?;
    let mut out = std::io::stdout().lock();
    let activities = read(Path::new(&folder))?;
    let (mut all, mut plausible) = (Score::default(), Score::default());
    let (mut false_counts, mut idle_s) = (0, 0.0);
    for (activity, sets) in &activities {
        let days: BTreeSet<&str> = sets.iter().map(Set::day).collect();
        if days.len() < 2 {
            continue;
        }
        for day in days {
            let (mut of_day, others): (Vec<&Set>, Vec<&Set>) = sets.iter().partition(|set| set.day() == day);
            of_day.sort_by_key(|set| set.repetitions);
            let teacher = of_day[of_day.len() / 2];
            let options =
                Options { name: activity.clone(), repetitions: teacher.repetitions, ..Options::default() };
            let lesson = teach(&stream(&teacher.streams), &options);
            match &lesson {
                Ok(lesson) => writeln!(
                    out,
                    "{activity} taught from {}: saw {} of {}",
                    teacher.name,
                    lesson.report.repetitions.len(),
                    teacher.repetitions
                )?,
                Err(refusal) => writeln!(out, "{activity} refused {}: {refusal}", teacher.name)?,
            }
            for set in others {
                let events = match &lesson {
                    Ok(lesson) => {
                        count(Counter::new(vec![lesson.exercise.clone()], &set.streams.columns)?, set)
                    }
                    Err(_) => Vec::new(),
                };
                let counted: Vec<&Event> =
                    events.iter().filter(|event| event.kind == EventKind::Counted).collect();
                let idle = |t_s: f64| {
                    let row = set.streams.t_s.partition_point(|time| *time < t_s);
                    !set.active.get(row).copied().unwrap_or(false)
                };
                false_counts += counted
                    .iter()
                    .filter(|event| idle(event.t_s - 0.3) && idle(event.t_start_s + 0.3))
                    .count();
                idle_s += 0.01 * set.active.iter().filter(|active| !**active).count() as f64;
                let off = counted.len() as i64 - set.repetitions as i64;
                all.add(off);
                let disputed =
                    DISPUTED.contains(&set.name.as_str()) || DISPUTED.contains(&teacher.name.as_str());
                if !disputed {
                    plausible.add(off);
                }
                let mark = if disputed { " (in dispute)" } else { "" };
                let (name, written, found) = (&set.name, set.repetitions, counted.len());
                writeln!(out, "    {name:32} written {written:2}, counted {found:2} ({off:+}){mark}")?;
            }
        }
    }
    writeln!(out, "all: {}", all.line())?;
    writeln!(out, "without the sets in dispute: {}", plausible.line())?;
    writeln!(out, "{false_counts} false counts in {:.1} idle minutes", idle_s / 60.0)?;
    Ok(())
}

fn stream(streams: &Streams) -> Stream<'_> {
    Stream { columns: &streams.columns, t_s: &streams.t_s, values: &streams.values }
}

fn count(mut counter: Counter, set: &Set) -> Vec<Event> {
    let mut events = Vec::new();
    for (row, t_s) in set.streams.t_s.iter().enumerate() {
        counter.push(*t_s, set.streams.row(row), &mut |event| events.push(event));
    }
    counter.finish(&mut |event| events.push(event));
    events
}

/// The sets of every activity.
fn read(folder: &Path) -> Result<BTreeMap<String, Vec<Set>>, Box<dyn Error>> {
    let mut table = TableReader::open(&folder.join("sets.csv"))?;
    let [file, activity, repetitions] = table.require(["file", "activity", "reps_in_name"])?;
    let mut sets: BTreeMap<String, Vec<Set>> = BTreeMap::new();
    while table.next_row()? {
        let name = table.text(file).to_owned();
        let path = folder.join(format!("{name}.csv.gz"));
        let mut streams = Streams::read(&path, None, None)?;
        let active = take_active(&mut streams);
        let repetitions = table.required_number(repetitions)? as usize;
        sets.entry(table.text(activity).to_owned()).or_default().push(Set {
            name,
            repetitions,
            streams,
            active,
        });
    }
    Ok(sets)
}

/// Takes the hand-set marks out of the columns: they would give the answer away.
fn take_active(streams: &mut Streams) -> Vec<bool> {
    let Some(column) = streams.columns.iter().position(|name| name == "active") else { return Vec::new() };
    let width = streams.columns.len();
    let active = streams.values.iter().skip(column).step_by(width).map(|value| *value == Some(1.0)).collect();
    streams.columns.remove(column);
    let kept = streams.values.iter().enumerate().filter(|(index, _)| index % width != column);
    streams.values = kept.map(|(_, value)| *value).collect();
    active
}
