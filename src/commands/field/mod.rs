//! `posed field`: calibrate by waving a pole, correct poses, look at the result.
//!
//! Positions are in the transmitter frame: a map is that of one transmitter where it stands.

mod cascade;
mod collect;
mod correct;
mod limbs;
mod posture;
mod show;
mod solve;

use std::path::Path;

use posed_field::FieldMap;

use super::{Error, notify, output, print, print_json};

/// What to do with a field.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed field solve pole.csv --spacing-m 0.3 --anchors anchors.csv -o field.json\n  \
    posed field correct field.json poses.csv -o corrected.csv\n  posed field show field.json -o field.svg"
)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Solves a recording of the pole for a map, or states why there is none.
    Solve(Box<solve::Args>),
    /// Corrects poses by a map.
    Correct(correct::Args),
    /// Draws a map.
    Show(show::Args),
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match args.command {
        Command::Solve(args) => solve::run(*args),
        Command::Correct(args) => correct::run(args),
        Command::Show(args) => show::run(args),
    }
}

/// Reads a map.
fn read_map(path: &Path) -> Result<FieldMap, Error> {
    posed_stage::read_field_map(path).map_err(Error::Failed)
}
