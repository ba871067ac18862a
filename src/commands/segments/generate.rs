//! `posed segments generate DIR`: made-up labelled sequences, to try training on and to compare networks with.

use std::path::PathBuf;

use posed_recording::table::{SequenceFrame, Sequences};
use posed_simulator::actions::{self, Actions, JOINTS};
use posed_simulator::body::SEGMENT_NAMES;
use posed_simulator::body::programme::{self, Programme};
use posed_simulator::primitives::{self, Primitives};

use super::super::{Error, print};

/// How many, and which.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed segments generate made-up/ --sequences 60 && posed segments train made-up/ -o m.safetensors\n\n\
    A person walks, turns, picks and places for 13 to 22 s: 19 joints, 72 Hz, ten labels. With --primitives the labels are finer, those\n\
    of Cheema et al. 2019: steps begun, made and ended by either foot, reach, retrieve, turn. With --person it is the one of simulated\n\
    stages, who walks, reaches, curls and squats: trunk and limbs in ten segments, 60 Hz. A seed gives the same files anywhere (up to\n\
    rounding)."
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
    /// Segments of the body as the daemon knows it, so that what learns from them names a worn body live.
    #[arg(long)]
    person: bool,
    /// The ten motion primitives of Cheema et al. 2019, in their proportions.
    #[arg(long, conflicts_with = "person")]
    primitives: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    std::fs::create_dir_all(&args.folder).map_err(|error| Error::file("make", &args.folder, &error))?;
    for index in 0..u64::from(args.sequences) {
        let seed = args.seed + index;
        let sequences = if args.person {
            let Programme { frames, labels } = Programme::generate(seed);
            sequences(
                &SEGMENT_NAMES[..programme::SHOWN],
                &frames,
                labels.iter().map(|k| programme::LABELS[*k]),
                programme::RATE_HZ,
            )
        } else if args.primitives {
            let Primitives { frames, labels } = Primitives::generate(seed);
            sequences(&JOINTS, &frames, labels.iter().map(|k| primitives::LABELS[*k]), primitives::RATE_HZ)
        } else {
            let Actions { frames, labels } = Actions::generate(seed);
            sequences(&JOINTS, &frames, labels.iter().map(|k| actions::LABELS[*k]), actions::RATE_HZ)
        };
        sequences.write(&args.folder.join(format!("{seed:05}.csv.gz"))).map_err(Error::failed)?;
    }
    print(&format!("wrote {} sequences to {}\n", args.sequences, args.folder.display()))
}

fn sequences<'a, const N: usize>(
    joints: &[&str],
    frames: &[[[f64; 3]; N]],
    labels: impl Iterator<Item = &'a str>,
    rate_hz: f64,
) -> Sequences {
    let frame = |(frame, label): (usize, &str)| SequenceFrame {
        t_s: frame as f64 / rate_hz,
        label: Some(label.to_owned()),
        transition: false,
    };
    Sequences {
        joints: joints.iter().map(|joint| (*joint).to_owned()).collect(),
        labelled: true,
        frames: labels.enumerate().map(frame).collect(),
        // To a tenth of a millimetre.
        positions_m: frames.iter().flatten().map(|p| Some(p.map(|v| (v * 1e4).round() / 1e4))).collect(),
    }
}
