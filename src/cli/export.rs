//! `posed export REC.mcap`: files that other programs open.

use std::path::PathBuf;

use posed::recording::export::{self, Frame};

use super::{Error, print, print_json};

/// What to export, and as what.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed export take-1.mcap --to csv -o poses.csv\n  \
    posed export take-1.mcap --to csv --frame transmitter -o poses.csv.gz\n  \
    posed export take-1.mcap --to jsonl -o messages.jsonl")]
pub(crate) struct Args {
    /// The recording.
    recording: PathBuf,
    /// csv: filtered poses with their state. jsonl: every published message, one on each line.
    #[arg(long, value_enum)]
    to: Format,
    /// The file to write; csv is zipped where it ends in .gz.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Axes of the poses in a csv file.
    #[arg(long, value_enum, default_value = "room")]
    frame: Frame,
    /// Print one JSON object: rows.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    Jsonl,
    Csv,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let Args { recording, to, output, frame, json } = args;
    let rows = match to {
        Format::Jsonl if frame != Frame::Room => {
            return Err(Error::Usage(
                "--frame is for --to csv; messages are written as they were published".into(),
            ));
        }
        Format::Jsonl => export::jsonl(&recording, &output),
        Format::Csv => export::csv(&recording, &output, frame),
    };
    let rows = rows.map_err(Error::failed)?;
    if json {
        print_json(&serde_json::json!({ "rows": rows }))
    } else {
        print(&format!("{}: {rows} rows\n", output.display()))
    }
}
