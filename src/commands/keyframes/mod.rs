//! `posed keyframes`: where motions change, on recordings and on gestures whose changes are known.

mod find;
mod generate;
mod study;

use super::number::positive;
use super::{Error, notify, output, print, print_json};

/// Where to look, and how; or gestures to try it on.
#[derive(clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "Examples:\n  posed keyframes poses.csv -o keys.csv --resample path.csv --picture keys.svg\n  \
    posed keyframes generate -o gesture.csv --noise 3 --changes truth.csv\n  posed keyframes study --method paper --seeds 50\n\n\
    Columns of the answer: frame,t,t_decided,score,sensor,corner. A frame is one time of the file, counted from 0;\n\
    t_decided is when a live client would have known. Without orientations only positions are looked at."
)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    find: Option<find::Find>,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Writes a gesture whose changes are known, with noise if wished.
    Generate(generate::Args),
    /// Counts what a method finds, misses and invents over the published levels of noise: Table 2 of Merckel and Nishida (2010).
    Study(study::Args),
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match (args.command, args.find) {
        (Some(Command::Generate(args)), _) => generate::run(&args),
        (Some(Command::Study(args)), _) => study::run(&args),
        (None, Some(args)) => find::run(args),
        (None, None) => Err(Error::Usage("name a file of poses, or `generate` or `study`".into())),
    }
}

/// How the pieces of a gesture look.
#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Shape {
    /// Constant velocities: screws.
    Straight,
    /// Velocities that grow or shrink by up to half over a piece.
    Bent,
    /// Velocities that sway.
    Swaying,
}

impl From<Shape> for posed_simulator::gesture::Shape {
    fn from(shape: Shape) -> Self {
        match shape {
            Shape::Straight => Self::Straight,
            Shape::Bent => Self::Bent,
            Shape::Swaying => Self::Swaying,
        }
    }
}
