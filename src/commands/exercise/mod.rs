//! `posed exercise`: teaching and counting from files.

mod count;
mod propose;
mod teach;
mod units;

use clap::Subcommand;

use std::path::Path;

use posed_recording::is_recording;
use posed_recording::table::{Streams, TableReader};

use super::Error;
use units::Unit;

/// What to do with exercises.
#[derive(clap::Args)]
#[command(subcommand_required = true, arg_required_else_help = true)]
#[command(after_help = "Examples:\n  \
    posed exercise teach curls.csv --name curl --repetitions 5 -o curl.json\n  \
    posed exercise count curl.json --in session.csv -o events.csv")]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Learns an exercise from a recording of a few repetitions.
    Teach(teach::Args),
    /// Counts repetitions of taught exercises in a recording.
    Count(count::Args),
}

/// Reads a recording (`.mcap`), or of a CSV file the columns that `needed` chooses among those that are there (none:
/// all). `units` are those that names lack.
fn read(
    path: &Path,
    rate_hz: Option<f64>,
    units: &[Unit],
    body: Option<&str>,
    needed: impl FnOnce(&[String]) -> Result<Option<Vec<String>>, String>,
) -> Result<Streams, Error> {
    let lacks = |sentence: String| Error::Failed(format!("{}: {sentence}", path.display()));
    if is_recording(path) {
        let mut streams = Streams::read_recording(path, body).map_err(Error::failed)?;
        streams.columns = units::named(&streams.columns, units).map_err(lacks)?;
        needed(&streams.columns).map_err(lacks)?;
        return Ok(streams);
    }
    if body.is_some() {
        return Err(Error::Usage(
            "--body is for recordings: a table does not know whose its columns are".into(),
        ));
    }
    let table = TableReader::open(path).map_err(Error::failed)?;
    let columns = table.columns().to_vec();
    let names = units::named(&columns, units).map_err(lacks)?;
    let chosen = needed(&names).map_err(lacks)?;
    let in_file = |chosen: &Vec<String>| -> Vec<String> {
        let both = columns.iter().zip(&names);
        both.filter(|(_, name)| chosen.contains(name)).map(|(column, _)| column.clone()).collect()
    };
    let in_file = chosen.as_ref().map(in_file);
    let mut streams = Streams::from_table(table, in_file.as_deref(), rate_hz).map_err(Error::failed)?;
    streams.columns = units::named(&streams.columns, &Unit::of(units, &streams.columns)).map_err(lacks)?;
    Ok(streams)
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match args.command {
        Command::Teach(args) => teach::run(args),
        Command::Count(args) => count::run(args),
    }
}
