//! The raw poses of a recording's magnetic sensors, as fault maps see them.
//!
//! What comes in: a recording. What goes out: frames of poses, before any repair. They come from the log by way of the
//! pipeline, so that they are the very numbers that a live stage sees.

use std::path::Path;

use super::ending::ReadError;
use super::machine::{Machine, MachineError};
use super::reader::{Item, Reader};
use posed_motion::fault_map::Frames;
use posed_pipeline::raw_poses;
use posed_stage::output::Output;

/// Why a recording gives no poses.
#[derive(Debug, thiserror::Error)]
pub enum RawPosesError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// It cannot be replayed.
    #[error(transparent)]
    Machine(#[from] MachineError),
}

/// Raw poses of all magnetic sensors in transmitter axes turned z up, frame by frame; NaN where a sensor sent none. Times
/// are capture times, s. A torn recording gives what it has.
///
/// # Errors
/// The recording cannot be read, is damaged, or is of another version.
pub fn read(path: &Path) -> Result<Frames, RawPosesError> {
    let mut reader = Reader::open(path)?;
    let (stage, machine) = Machine::as_recorded(reader.header())?;
    let mut pipeline = machine.pipeline;
    let sensors = stage.magnetic_sensors().into_iter().map(str::to_owned).collect();
    let mut frames = Frames { sensors, ..Frames::default() };
    let indices = stage.magnetic_indices();
    let (mut times, mut rows) = (Vec::new(), Vec::new());
    for item in reader.by_ref() {
        let Item::Entry(entry) = item? else { continue };
        pipeline.push(&entry, &mut |output| {
            if let Output::Estimate(estimate) = output {
                times.push(estimate.t_valid.as_secs_f64());
                raw_poses(estimate, &indices, |pose| rows.push(pose));
            }
        });
        let room = pipeline.room_transmitter();
        for pose in rows.drain(..) {
            pose.upright(room).append_to(&mut frames);
        }
        frames.t_s.append(&mut times);
    }
    Ok(frames)
}
