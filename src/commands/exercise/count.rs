//! `posed exercise count N.json... --in STREAM.csv -o EVENTS.csv`: counts repetitions in a recording.
//!
//! The live counter runs over the file, so `t_decided` is what a live client would have had to wait for.

use std::path::PathBuf;

use posed_motion::exercise::{Counter, Event, EventKind, Exercise, Language, columns_of};
use posed_recording::table::{Streams, TableError, TableWriter};
use serde::Serialize;

use super::super::{Error, output, print, print_json};
use super::read;
use super::units::Unit;
use crate::pictures::exercise as picture;

/// Columns of the events.
const COLUMNS: [&str; 8] = ["t", "t_start", "t_decided", "exercise", "event", "count", "reason", "feedback"];

/// What to count, and where.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed exercise count curl.json squat.json --in session.csv -o events.csv"
)]
pub(crate) struct Args {
    /// Taught exercises; several compete.
    #[arg(required = true, value_name = "EXERCISE.json")]
    exercises: Vec<PathBuf>,
    /// The recording: CSV with a column `t` (s) and the columns the exercises were taught with, or `.mcap`.
    #[arg(long = "in", value_name = "STREAM.csv|REC.mcap")]
    input: PathBuf,
    /// Write the events to this file.
    #[arg(short, long, value_name = "EVENTS.csv")]
    output: PathBuf,
    /// Draw the recording and the repetitions that were counted in it.
    #[arg(long, value_name = "PICTURE.svg")]
    picture: Option<PathBuf>,
    /// Units of columns whose names lack them: deg, rad or m, of all such columns or of some (NAME=UNIT).
    #[arg(long, value_delimiter = ',', value_name = "UNIT|NAME=UNIT")]
    units: Vec<Unit>,
    /// Rows per second of a recording without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// The body whose joints count, by name, of a recording with several.
    #[arg(long, value_name = "NAME")]
    body: Option<String>,
    /// Print one JSON object: counts per exercise.
    #[arg(long)]
    json: bool,
}

/// The answer for programs.
#[derive(Serialize)]
struct Answer {
    exercises: Vec<Counted>,
    events: usize,
    /// Rows left out because their time was before the frame at hand.
    late: u64,
}

#[derive(Serialize)]
struct Counted {
    exercise: String,
    count: u64,
    rejected: u64,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let exercises: Vec<Exercise> = args.exercises.iter().map(load).collect::<Result<_, _>>()?;
    let streams = read(&args.input, args.rate_hz, &args.units, args.body.as_deref(), |columns| {
        let mut needed: Vec<String> = Vec::new();
        for exercise in &exercises {
            let of = columns_of(&exercise.channels, columns)
                .map_err(|channel| format!("exercise `{}` needs the channel `{channel}`", exercise.name))?;
            needed.extend(of.into_iter().filter(|column| !needed.contains(column)).collect::<Vec<_>>());
        }
        Ok(Some(needed))
    })?;
    let mut counter = Counter::new(exercises, &streams.columns).map_err(Error::failed)?;
    let mut events: Vec<Event> = Vec::new();
    for (index, t_s) in streams.t_s.iter().enumerate() {
        counter.push(*t_s, streams.row(index), &mut |event| events.push(event));
    }
    counter.finish(&mut |event| events.push(event));
    let known: Vec<&Exercise> = counter.exercises().collect();
    write(&args, &known, &events).map_err(Error::failed)?;
    if let Some(path) = &args.picture {
        let svg = drawn(&streams, &known, &events);
        output::replace(path, |file| file.write_all(svg.as_bytes()))?;
    }
    let rejected = |index: usize| {
        events.iter().filter(|event| event.exercise == index && event.kind == EventKind::Rejected).count()
            as u64
    };
    let counted: Vec<Counted> = known
        .iter()
        .enumerate()
        .map(|(index, exercise)| Counted {
            exercise: exercise.name.clone(),
            count: counter.count(index),
            rejected: rejected(index),
        })
        .collect();
    if args.json {
        return print_json(&Answer { exercises: counted, events: events.len(), late: counter.late() });
    }
    let line = |counted: &Counted| {
        format!("{}: {} counted, {} rejected\n", counted.exercise, counted.count, counted.rejected)
    };
    print(&counted.iter().map(line).collect::<String>())
}

/// The channels that the exercises look at, with what was counted.
fn drawn(streams: &Streams, exercises: &[&Exercise], events: &[Event]) -> String {
    let used = exercises.iter().filter_map(|exercise| columns_of(&exercise.channels, &streams.columns).ok());
    let counted = events.iter().filter(|event| event.kind == EventKind::Counted);
    let counted: Vec<[f64; 2]> = counted.map(|event| [event.t_start_s, event.t_s]).collect();
    picture::draw(streams, &used.flatten().collect::<Vec<_>>(), &counted)
}

fn load(path: &PathBuf) -> Result<Exercise, Error> {
    let text = std::fs::read_to_string(path).map_err(|error| Error::file("read", path, &error))?;
    Exercise::from_json(&text).map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
}

fn write(args: &Args, exercises: &[&Exercise], events: &[Event]) -> Result<(), TableError> {
    let mut table = TableWriter::create(&args.output, &COLUMNS)?;
    for event in events {
        let exercise = exercises[event.exercise];
        for time in [event.t_s, event.t_start_s, event.t_decided_s] {
            // Frames are hundredths of seconds apart: more digits would only be rounding.
            table.number((time * 1e4).round() / 1e4)?;
        }
        table.text(&exercise.name)?;
        table.text(event.kind.as_str())?;
        table.number(event.count as f64)?;
        table.text(event.reason.map_or("", |reason| reason.as_str()))?;
        let sentence = event.sentence(exercise, Language::English);
        table.text(sentence.as_deref().unwrap_or(""))?;
        table.end_row()?;
    }
    table.finish()
}
