//! `posed segments generate DIR`: made-up labelled sequences, to try training on and to compare networks with.

use std::path::PathBuf;

use posed::table::{SequenceFrame, Sequences};
use posed_simulator::actions::{Actions, JOINTS, LABELS, RATE_HZ};

use super::super::{Error, print};

/// How many, and which.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed segments generate made-up/ --sequences 60 && posed segments train made-up/ -o m.safetensors\n\n\
    A person walks, turns, picks and places for 13 to 22 s: 19 joints, 72 Hz, ten labels. A seed gives the same files anywhere\n\
    (up to rounding)."
)]
pub(crate) struct Args {
    /// The folder; it is made if it is not there.
    folder: PathBuf,
    /// Number of sequences.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    sequences: u16,
    /// Seed of the first; the others follow.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    std::fs::create_dir_all(&args.folder).map_err(|error| Error::file("make", &args.folder, &error))?;
    for index in 0..u64::from(args.sequences) {
        let seed = args.seed + index;
        let made = Actions::generate(seed);
        let frame = |(frame, label): (usize, &usize)| SequenceFrame {
            t_s: frame as f64 / RATE_HZ,
            label: Some(LABELS[*label].to_owned()),
            transition: false,
        };
        let sequences = Sequences {
            joints: JOINTS.map(str::to_owned).to_vec(),
            labelled: true,
            frames: made.labels.iter().enumerate().map(frame).collect(),
            // To a tenth of a millimetre.
            positions_m: made
                .frames
                .iter()
                .flatten()
                .map(|p| Some(p.map(|v| (v * 1e4).round() / 1e4)))
                .collect(),
        };
        sequences.write(&args.folder.join(format!("{seed:05}.csv.gz"))).map_err(Error::failed)?;
    }
    print(&format!("wrote {} sequences to {}\n", args.sequences, args.folder.display()))
}
