//! `posed exercise`: teaching and counting from files.

mod count;
mod picture;
mod teach;

use clap::Subcommand;

use super::Error;

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

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match args.command {
        Command::Teach(args) => teach::run(args),
        Command::Count(args) => count::run(args),
    }
}
