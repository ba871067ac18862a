//! `posed exercise teach STREAM.csv --name N --repetitions K -o N.json`: learns an exercise from a recording.

use std::path::PathBuf;

use posed_motion::exercise::{Options, Refusal, Report, Stream, columns_of, teach};
use serde::Serialize;

use super::super::{Error, output, print, print_json};
use super::read;
use crate::pictures::exercise as picture;

/// What to learn, and from what.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed exercise teach curls.csv --name curl --repetitions 5 -o curl.json\n\n\
    Exit code 1 if the demonstration is refused; the reason states what was seen instead."
)]
pub(crate) struct Args {
    /// The recording: CSV with a column `t` (s) and numeric columns, or `.mcap`; rest a moment before and after.
    stream: PathBuf,
    /// Name of the exercise, as in events.
    #[arg(long)]
    name: String,
    /// How many repetitions the recording holds; 3 to 10 are good.
    #[arg(long, value_name = "K")]
    repetitions: usize,
    /// Write the exercise to this file.
    #[arg(short, long, value_name = "FILE.json")]
    output: PathBuf,
    /// Use these channels instead of choosing.
    #[arg(long, value_delimiter = ',', value_name = "A,B")]
    columns: Option<Vec<String>>,
    /// Rows per second of a recording without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// Draw where the repetitions were seen.
    #[arg(long, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
    /// Print one JSON object: accepted, reason, channels, what was seen.
    #[arg(long)]
    json: bool,
}

/// The answer for programs.
#[derive(Serialize)]
struct Answer {
    accepted: bool,
    reason: Option<String>,
    channels: Vec<String>,
    report: Report,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    if args.repetitions < 2 {
        return Err(Error::Usage("--repetitions must be at least 2".to_owned()));
    }
    if args.name.trim().is_empty() {
        return Err(Error::Usage("--name must not be empty".to_owned()));
    }
    let streams = read(&args.stream, args.rate_hz, |columns| match &args.columns {
        Some(channels) => columns_of(channels, columns)
            .map(Some)
            .map_err(|channel| format!("there is no channel `{channel}`")),
        None => Ok(None),
    })?;
    let stream = Stream { columns: &streams.columns, t_s: &streams.t_s, values: &streams.values };
    let options = Options {
        name: args.name.trim().to_owned(),
        repetitions: args.repetitions,
        channels: args.columns.clone(),
    };
    let taught = teach(&stream, &options);
    let (channels, report, reason) = match &taught {
        Ok(lesson) => (lesson.exercise.channels.clone(), lesson.report.clone(), None),
        Err(refusal) => {
            let report = match refusal {
                Refusal::Count { report, .. } => report.clone(),
                _ => Report { announced: args.repetitions, ..Report::default() },
            };
            (Vec::new(), report, Some(refusal.to_string()))
        }
    };
    if let Some(path) = &args.picture {
        let shown = if channels.is_empty() { &streams.columns } else { &channels };
        let seen: Vec<[f64; 2]> =
            report.repetitions.iter().map(|seen| [seen.t_start_s, seen.t_end_s]).collect();
        let svg = picture::draw(&streams, shown, &seen);
        output::replace(path, |file| file.write_all(svg.as_bytes()))?;
    }
    if let Ok(lesson) = &taught {
        let json = lesson.exercise.to_json().map_err(Error::failed)?;
        output::replace(&args.output, |file| file.write_all(json.as_bytes()))?;
    }
    match (args.json, reason) {
        (true, reason) => {
            let accepted = reason.is_none();
            print_json(&Answer { accepted, reason, channels, report })?;
            if accepted { Ok(()) } else { Err(Error::Reported) }
        }
        (false, Some(reason)) => Err(Error::Failed(format!("{}: {reason}", args.stream.display()))),
        (false, None) => print(&sentences(&channels, &report)),
    }
}

/// For people.
fn sentences(channels: &[String], report: &Report) -> String {
    let mut text = format!(
        "saw {} of {} repetitions, {:.0} % similar, in {}\n",
        report.repetitions.len(),
        report.announced,
        100.0 * report.quality,
        channels.join(", ")
    );
    for (index, seen) in report.repetitions.iter().enumerate() {
        let (number, alike) = (index + 1, 100.0 * seen.measures.similarity);
        text.push_str(&format!(
            "{number:3}  {:7.2} to {:7.2} s  {alike:3.0} % similar\n",
            seen.t_start_s, seen.t_end_s
        ));
    }
    for remark in &report.remarks {
        text.push_str(&format!("note: {remark}\n"));
    }
    text
}
