//! `posed segments`: a network that learns what the frames of a motion show.

mod bench;
mod evaluate;
mod files;
mod generate;
mod label;
mod train;

use std::path::Path;

use clap::Subcommand;
use posed_motion::segments::Model;

use super::Error;

/// What to do with segments.
#[derive(clap::Args)]
#[command(subcommand_required = true, arg_required_else_help = true)]
#[command(after_help = "Examples:\n  \
    posed segments train labelled/ -o moves.safetensors\n  \
    posed segments label moves.safetensors new.csv -o new.labels.csv\n  \
    posed segments evaluate moves.safetensors labelled/ --picture bands.svg")]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Learns from a folder of labelled sequences.
    Train(train::Args),
    /// Names every frame of a sequence.
    Label(label::Args),
    /// Reports how well a model names labelled sequences.
    Evaluate(evaluate::Args),
    /// Makes up labelled sequences of a person who walks, turns, picks and places.
    Generate(generate::Args),
    /// Times a network with random weights: whole sequences, streaming, learning.
    Bench(bench::Args),
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match args.command {
        Command::Train(args) => train::run(args),
        Command::Label(args) => label::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Generate(args) => generate::run(args),
        Command::Bench(args) => bench::run(args),
    }
}

fn load(path: &Path) -> Result<Model, Error> {
    let bytes = std::fs::read(path).map_err(|error| Error::file("read", path, &error))?;
    Model::from_bytes(&bytes).map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
}
