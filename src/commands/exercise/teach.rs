//! `posed exercise teach STREAM.csv --name N --repetitions K -o N.json`: learns an exercise from a recording.

use std::path::PathBuf;

use posed_motion::exercise::{AsPublished, Options, Refusal, Report, Stream, columns_of, teach};
use serde::Serialize;

use super::super::{Error, output, print, print_json};
use super::units::Unit;
use super::{propose, read};
use crate::pictures::exercise as picture;

/// What to learn, and from what.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    posed exercise teach curls.csv --name curl --repetitions 5 -o curl.json\n  \
    posed exercise teach take.mcap --propose\n  \
    posed exercise teach take.mcap --from-s 12.5 --to-s 31 --name curl --repetitions 5 -o curl.json\n\n\
    Exit code 1 if the demonstration is refused; the reason states what was seen instead. \
    The same if there is nothing to propose.")]
pub(crate) struct Args {
    /// The recording: CSV with a column `t` (s) and numeric columns, or `.mcap`; rest a moment before and after.
    stream: PathBuf,
    /// Name of the exercise, as in events.
    #[arg(long, required_unless_present = "propose")]
    name: Option<String>,
    /// How many repetitions the recording, or its range, holds; 3 to 10 are good.
    #[arg(long, required_unless_present = "propose", value_name = "K")]
    repetitions: Option<usize>,
    /// Write the exercise to this file.
    #[arg(short, long, required_unless_present = "propose", value_name = "FILE.json")]
    output: Option<PathBuf>,
    /// Begin at this time of the recording, s.
    #[arg(long, value_name = "S")]
    from_s: Option<f64>,
    /// End at this time of the recording, s.
    #[arg(long, value_name = "S")]
    to_s: Option<f64>,
    /// Teach nothing; list the ranges of the recording in which something is repeated, each with the command that teaches it.
    #[arg(long, conflicts_with_all = ["name", "repetitions", "output", "picture"])]
    propose: bool,
    /// Use these channels instead of choosing.
    #[arg(long, value_delimiter = ',', value_name = "A,B")]
    columns: Option<Vec<String>>,
    /// The density of a subsequence is that of its K-th neighbour, as published, not of the one before: with K repetitions it is none of them.
    #[arg(long)]
    kth_neighbour: bool,
    /// Decode each channel by itself, as published, not all with one sequence of states.
    #[arg(long)]
    per_channel: bool,
    /// Units of columns whose names lack them: deg, rad or m, of all such columns or of some (NAME=UNIT).
    #[arg(long, value_delimiter = ',', value_name = "UNIT|NAME=UNIT")]
    units: Vec<Unit>,
    /// Rows per second of a recording without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// Draw where the repetitions were seen.
    #[arg(long, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
    /// The body whose joints count, by name, of a recording with several.
    #[arg(long, value_name = "NAME")]
    body: Option<String>,
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
    /// How many more repetitions a refused demonstration needs; 0 where more would not help.
    more: usize,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let (name, announced) = (args.name.as_deref().unwrap_or_default().trim(), args.repetitions.unwrap_or(0));
    if !args.propose && announced < 2 {
        return Err(Error::Usage("--repetitions must be at least 2".to_owned()));
    }
    if !args.propose && name.is_empty() {
        return Err(Error::Usage("--name must not be empty".to_owned()));
    }
    let [from_s, to_s] = args.range()?;
    let streams =
        read(&args.stream, args.rate_hz, &args.units, args.body.as_deref(), |columns| match &args.columns {
            Some(channels) => columns_of(channels, columns)
                .map(Some)
                .map_err(|channel| format!("there is no channel `{channel}`")),
            None => Ok(None),
        })?;
    let all = Stream { columns: &streams.columns, t_s: &streams.t_s, values: &streams.values };
    let stream = all.between(from_s, to_s);
    if stream.t_s.is_empty() {
        return Err(Error::Failed(args.holds_nothing(all.t_s)));
    }
    let options = Options {
        name: name.to_owned(),
        repetitions: announced,
        channels: args.columns.clone(),
        as_published: AsPublished { kth_neighbour: args.kth_neighbour, per_channel: args.per_channel },
    };
    if args.propose {
        return propose::run(&stream, &options, &args.stream, &args.reading(), args.json);
    }
    let taught = teach(&stream, &options);
    let more = if let Err(Refusal::Count { more, .. }) = &taught { *more } else { 0 };
    let (channels, report, reason) = match &taught {
        Ok(lesson) => (lesson.exercise.channels.clone(), lesson.report.clone(), None),
        Err(refusal) => {
            let report = match refusal {
                Refusal::Count { report, .. } => Report::clone(report),
                _ => Report { announced, ..Report::default() },
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
    if let (Ok(lesson), Some(path)) = (&taught, &args.output) {
        let json = lesson.exercise.to_json().map_err(Error::failed)?;
        output::replace(path, |file| file.write_all(json.as_bytes()))?;
    }
    match (args.json, reason) {
        (true, reason) => {
            let accepted = reason.is_none();
            print_json(&Answer { accepted, reason, channels, report, more })?;
            if accepted { Ok(()) } else { Err(Error::Reported) }
        }
        (false, Some(reason)) => {
            let path = args.stream.display();
            Err(Error::Failed(format!("{path}: {reason}; --propose lists the ranges that repeat")))
        }
        (false, None) => print(&sentences(&channels, &report)),
    }
}

impl Args {
    /// The range of the recording, s.
    fn range(&self) -> Result<[f64; 2], Error> {
        let range = [self.from_s.unwrap_or(f64::NEG_INFINITY), self.to_s.unwrap_or(f64::INFINITY)];
        if range[0] < range[1] {
            Ok(range)
        } else {
            Err(Error::Usage("--from-s must be below --to-s".to_owned()))
        }
    }

    /// The arguments that name the recording and how it is read.
    fn reading(&self) -> String {
        let mut text = self.stream.display().to_string();
        if let Some(columns) = &self.columns {
            text.push_str(&format!(" --columns {}", columns.join(",")));
        }
        if !self.units.is_empty() {
            let units: Vec<String> = self.units.iter().map(Unit::to_string).collect();
            text.push_str(&format!(" --units {}", units.join(",")));
        }
        if let Some(rate_hz) = self.rate_hz {
            text.push_str(&format!(" --rate-hz {rate_hz}"));
        }
        text
    }

    /// Why the range is empty.
    fn holds_nothing(&self, t_s: &[f64]) -> String {
        let path = self.stream.display();
        match (t_s.first(), t_s.last()) {
            (Some(first), Some(last)) => {
                format!("{path}: the range is empty; the recording goes from {first:.2} to {last:.2} s")
            }
            _ => format!("{path}: the recording is empty"),
        }
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
    text.push_str(&format!("these channels because {}\n", report.because));
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
