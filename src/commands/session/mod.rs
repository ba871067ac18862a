//! `posed session`: who trained what, when and how well.

mod accuracy;
mod change;
mod recording;
mod show;

use std::path::{Path, PathBuf};

use clap::Subcommand;
use posed_sessions::{Store, file_in};

use super::Error;

/// What to do with sessions.
#[derive(clap::Args)]
#[command(subcommand_required = true, arg_required_else_help = true)]
#[command(after_help = "Examples:\n  posed session list --data stage\n  \
    posed session report 12 -o today.html --language de\n  \
    posed session report --person P-17 -o weeks.html\n  \
    posed session count take-1.mcap --person P-17\n  \
    posed session forget P-17 --recordings recordings")]
pub(crate) struct Args {
    /// The folder where the daemon keeps what it learns, `sessions.db` among it: as `posed run --data`, or that of the stage file.
    #[arg(long, global = true, value_name = "FOLDER", default_value = ".")]
    data: PathBuf,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Lists sessions, the newest first.
    List(show::List),
    /// Lists everybody who trains.
    People(show::People),
    /// Shows a session with its sets.
    Show(show::Show),
    /// Writes sessions to a file: `.json` (all there is), `.csv` (a line per repetition), `.fhir.json` (FHIR R4 observations).
    Export(show::Export),
    /// Writes a report that prints well: of one session, or of all sessions of a person.
    Report(show::Report),
    /// Keeps the count of a set that somebody has seen with their own eyes, beside the one that was counted.
    Correct(change::Correct),
    /// Removes a person with everything of them: sessions, sets, repetitions, and the recordings of their sessions.
    Forget(change::Forget),
    /// Lists plans, or keeps or removes one.
    Plan(change::PlanArgs),
    /// Counts the repetitions of a recording again; with `--person` keeps them as a session.
    Count(recording::Count),
    /// Compares a session with its recording, number by number.
    Verify(recording::Verify),
    /// Reports how well sets were counted, by the counts that somebody put right; with `--recordings` also as this version counts them.
    Accuracy(accuracy::Accuracy),
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let data = &args.data;
    match args.command {
        Command::List(args) => args.run(&open(data)?),
        Command::People(args) => args.run(&open(data)?),
        Command::Show(args) => args.run(&open(data)?),
        Command::Export(args) => args.run(&open(data)?),
        Command::Report(args) => args.run(&open(data)?),
        Command::Correct(args) => args.run(&mut open(data)?),
        Command::Forget(args) => args.run(&mut open(data)?),
        Command::Plan(args) => args.run(data),
        Command::Count(args) => args.run(data),
        Command::Verify(args) => args.run(&open(data)?),
        Command::Accuracy(args) => args.run(&open(data)?),
    }
}

/// The database of a folder, which must be there.
fn open(data: &Path) -> Result<Store, Error> {
    let file = file_in(data);
    if !file.is_file() {
        let file = file.display();
        return Err(Error::Failed(format!("there is no {file}; give the daemon's folder with --data")));
    }
    Store::open(&file).map_err(Error::failed)
}

/// The database of a folder, which is made where it is absent.
fn open_or_create(data: &Path) -> Result<Store, Error> {
    std::fs::create_dir_all(data).map_err(|error| Error::file("make the folder", data, &error))?;
    Store::open(&file_in(data)).map_err(Error::failed)
}
