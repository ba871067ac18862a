//! `posed keyframes generate`.

use std::path::PathBuf;

use posed_geometry::orientation_to_wxyz;
use posed_recording::table::{PoseRow, Poses, TableWriter};
use posed_simulator::gesture::{CHANGES, FRAMES, Gesture, NOISE};

use super::{Error, Shape, notify, positive};

/// Which gesture, and where to write it.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed keyframes generate -o gesture.csv --seed 4 --noise 3 --changes truth.csv"
)]
pub(super) struct Args {
    /// Where to write the poses: 1000 frames, t,x,y,z,qw,qx,qy,qz.
    #[arg(short, long, value_name = "POSES.csv")]
    output: PathBuf,
    /// Which one of its kind.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// How its seven pieces look.
    #[arg(long, value_enum, default_value = "bent")]
    shape: Shape,
    /// Level of noise of the published table: 0 is none, 6 is 30 mm and 40 degrees on each axis.
    #[arg(long, value_name = "LEVEL", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..NOISE.len() as i64))]
    noise: u8,
    /// Length of the box that its path about fills, m.
    #[arg(long, default_value_t = 2.0, value_parser = positive)]
    size_m: f64,
    /// How far it turns in all, degrees, about.
    #[arg(long, default_value_t = 300.0, value_parser = positive)]
    rotation_deg: f64,
    /// Frames a second.
    #[arg(long, default_value_t = 100.0, value_parser = positive)]
    rate_hz: f64,
    /// Where to write the six frames at which its velocity changes: frame,t.
    #[arg(long, value_name = "TRUTH.csv")]
    changes: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> Result<(), Error> {
    let gesture = Gesture {
        seed: args.seed,
        shape: args.shape.into(),
        size_m: args.size_m,
        rotation_deg: args.rotation_deg,
    };
    let t_s = |frame: usize| frame as f64 / args.rate_hz;
    let rows =
        gesture.noisy(NOISE[usize::from(args.noise)]).into_iter().enumerate().map(|(frame, pose)| PoseRow {
            t_s: t_s(frame),
            sensor: 0,
            position_m: Some(pose.translation.vector.into()),
            orientation_wxyz: Some(orientation_to_wxyz(&pose.rotation)),
            state: None,
        });
    let poses = Poses { sensors: vec![String::new()], rows: rows.collect() };
    poses.write(&args.output).map_err(Error::failed)?;
    if let Some(path) = &args.changes {
        let write = || {
            let mut table = TableWriter::create(path, &["frame", "t"])?;
            for frame in CHANGES {
                table.text(&frame.to_string())?;
                table.number(t_s(frame))?;
                table.end_row()?;
            }
            table.finish()
        };
        write().map_err(Error::failed)?;
    }
    notify(&format!("{FRAMES} frames with {} changes to {}", CHANGES.len(), args.output.display()));
    Ok(())
}
