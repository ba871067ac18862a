//! `posed faults generate`.

use std::path::PathBuf;

use posed_fusion::faults::{Class, Label};
use posed_motion::fault_map::{Frames, frame_label};
use posed_recording::table::{TableError, TableWriter};
use posed_simulator::figure::{Fault, Figure, Poses, SENSORS, Truth, inject};

use super::super::number::within;
use super::{Error, WHOLE_FRAME, notify, write_poses};

/// Which session, and where to write it.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed faults generate -o session.csv --truth truth.csv --frames 2823 --seed 4\n\n\
    A person with sixteen sensors walks about before a transmitter that stands 1 m above the floor. Faults of 0.5 to 3 s, of all kinds in turn:\n\
    one sensor or all mirrored through the transmitter or in the vertical axis; one stuck, one elsewhere, one or two drawn aside, one drawn aside gradually."
)]
pub(super) struct Args {
    /// Where to write the poses: t,sensor,x,y,z,qw,qx,qy,qz.
    #[arg(short, long, value_name = "POSES.csv")]
    output: PathBuf,
    /// Where to write what each sensor and frame is: t,sensor,class; `*` is the frame as a whole.
    #[arg(long, value_name = "TRUTH.csv")]
    truth: Option<PathBuf>,
    /// Which session.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// How tall the person is, m.
    #[arg(long, default_value_t = 1.75, value_parser = within(0.5..2.5, "between 0.5 and 2.5"))]
    height_m: f64,
    /// How many frames; the paper's scripted file F1 has 407.
    #[arg(long, default_value_t = 407, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Frames a second.
    #[arg(long, default_value_t = 30.0, value_parser = within(1.0..1000.0, "between 1 and 1000"))]
    rate_hz: f64,
    /// Share of the frames with a faulty sensor, about.
    #[arg(long, default_value_t = 0.5, value_parser = within(0.0..0.95, "between 0 and 0.95"))]
    share: f64,
}

pub(super) fn run(args: &Args) -> Result<(), Error> {
    let Args { seed, height_m, rate_hz, .. } = *args;
    let mut poses = Figure { seed, height_m, rate_hz, frames: args.frames as usize }.poses();
    let truth = inject(&mut poses, SENSORS.len(), rate_hz, seed, args.share, &Fault::ALL);
    let Poses { positions_m, orientations_wxyz } = poses;
    let t_s = (0..args.frames).map(|frame| f64::from(frame) / rate_hz).collect();
    let frames = Frames { sensors: SENSORS.map(str::to_owned).into(), t_s, positions_m, orientations_wxyz };
    write_poses(&args.output, &frames, |_, p| Some(p)).map_err(Error::failed)?;
    if let Some(path) = &args.truth {
        let write = || write_truth(TableWriter::create(path, &["t", "sensor", "class"])?, &frames, &truth);
        write().map_err(Error::failed)?;
    }
    notify(&format!("{} frames to {}", frames.len(), args.output.display()));
    Ok(())
}

fn write_truth(mut table: TableWriter, frames: &Frames, truth: &[Truth]) -> Result<(), TableError> {
    for (t_s, row) in frames.t_s.iter().zip(truth.chunks_exact(frames.sensors.len())) {
        let labels: Vec<Label> =
            row.iter().map(|truth| Label { class: class(*truth), cause: None }).collect();
        let sensors = frames.sensors.iter().map(String::as_str).zip(&labels);
        let frame = frame_label(&labels);
        for (name, label) in sensors.chain([(WHOLE_FRAME, &frame)]) {
            table.number(*t_s)?;
            table.text(name)?;
            table.text(label.class.name())?;
            table.end_row()?;
        }
    }
    table.finish()
}

fn class(truth: Truth) -> Class {
    match truth {
        Truth::Clean => Class::Clean,
        Truth::Inverted | Truth::InvertedVertically => Class::Inverted,
        Truth::Stuck | Truth::Jump | Truth::Disturbed | Truth::Drifted => Class::Anomalous,
    }
}
