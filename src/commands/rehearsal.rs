//! How the demo's fault map, `config/demo-faults.json`, was made: from a rehearsal, some time of the stage's own movement.
//!
//! What comes in: a stage with a `[simulation]` table. What goes out: a network that knows where its magnetic sensors are,
//! and what they look like with faults put in; nobody labels anything. What it never does: wait, touch a port, or be part of the program.

use std::mem::take;
use std::path::Path;

use posed_drivers::{LineEvent, Timestamp};
use posed_motion::fault_map::Frames;
use posed_motion::fault_map::Training;
use posed_motion::fault_map::{FaultMap, Size};
use posed_pipeline::{Pipeline, raw_poses};
use posed_simulator::figure::{Fault, Poses, inject};
use posed_simulator::stage::Output as Virtual;
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};
use posed_stage::output::Output;

use super::{Error, simulation};

/// How long it takes, in the stage's own time, s: until the demo has done each of its movements.
const LENGTH_S: f64 = 77.0;
/// Share of the frames that get a fault.
const BAD_SHARE: f64 = 0.4;

/// Learns the map from frames that are all right.
fn learn_faults(mut frames: Frames) -> FaultMap {
    let rate_hz = (frames.len() - 1) as f64 / (frames.t_s[frames.len() - 1] - frames.t_s[0]);
    let Frames { sensors, positions_m, orientations_wxyz, .. } = &mut frames;
    let mut poses = Poses { positions_m: take(positions_m), orientations_wxyz: take(orientations_wxyz) };
    inject(&mut poses, sensors.len(), rate_hz, 1, BAD_SHARE, &Fault::ALL);
    (*positions_m, *orientations_wxyz) = (poses.positions_m, poses.orientations_wxyz);
    FaultMap::train(&frames, Size::default(), &Training::default()).unwrap().0
}

/// The raw poses of the magnetic sensors, as the stage itself will see them: every frame that has all their positions.
fn poses(stage: &Stage, folder: &Path) -> Result<Frames, Error> {
    let indices = stage.magnetic_indices();
    // Only devices that carry such sensors are switched on.
    let is_on = |device: usize| {
        let name = &stage.devices[device].name;
        indices.iter().any(|index| stage.sensors[*index].device == *name)
    };
    let mut devices = simulation::virtual_stage(stage, folder)?;
    let mut pipeline = Pipeline::new(stage).map_err(Error::failed)?;
    let sensors = stage.magnetic_sensors().into_iter().map(str::to_owned).collect();
    let mut frames = Frames { sensors, ..Frames::default() };
    let mut now = Timestamp::ZERO;
    let mut row = Vec::with_capacity(indices.len());
    let mut push = |pipeline: &mut Pipeline, now, input, answers: &mut Vec<(usize, Vec<u8>)>| {
        let room = *pipeline.room_transmitter();
        pipeline.push(&Entry { t: now, input }, &mut |output| match output {
            Output::Transmit { device, bytes } => answers.push((usize::from(device), bytes.to_vec())),
            Output::Estimate(estimate) => {
                row.clear();
                raw_poses(estimate, &indices, |pose| row.push(pose.upright(&room)));
                if row.iter().flat_map(|pose| pose.position_m).all(f64::is_finite) {
                    frames.t_s.push(estimate.t_valid.as_secs_f64());
                    row.iter().for_each(|pose| pose.append_to(&mut frames));
                }
            }
            _ => {}
        });
    };
    let mut answers = Vec::new();
    for device in (0..stage.devices.len()).filter(|device| is_on(*device)) {
        let event = LineEvent::Opened { modem_lines: false };
        push(&mut pipeline, now, Input::Line { device: device as u16, event }, &mut answers);
    }
    let end = Timestamp::from_secs_f64(LENGTH_S);
    while now < end {
        answers.drain(..).for_each(|(device, bytes)| devices.write(device, now, &bytes));
        let due = [devices.poll_timeout(), pipeline.poll_timeout()];
        now = due.into_iter().flatten().min().unwrap_or(end).clamp(now, end);
        devices.step(now);
        while let Some(event) = devices.poll_event() {
            if let Virtual::Data(bytes) = event.output
                && is_on(event.device)
            {
                push(&mut pipeline, now, Input::Bytes { device: event.device as u16, bytes }, &mut answers);
            }
        }
        if pipeline.poll_timeout().is_some_and(|due| due <= now) {
            push(&mut pipeline, now, Input::Timer, &mut answers);
        }
    }
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use posed_fusion::faults::Class;

    use super::*;

    #[test]
    fn the_demos_map_has_cells_of_all_kinds_and_finds_the_demos_movement_clean() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
        let mut stage = Stage::parse(include_str!("../../config/demo.toml")).unwrap();
        let path = folder.join(stage.models.faults.take().unwrap());
        let frames = poses(&stage, &folder).unwrap();
        if std::env::var_os("POSED_BLESS").is_some() {
            let learnt = learn_faults(frames.clone());
            std::fs::write(&path, serde_json::to_string(&learnt).unwrap() + "\n").unwrap();
        }
        let fault_map = stage.read_faults(&path).unwrap();
        for class in [Class::Clean, Class::Inverted, Class::Anomalous] {
            assert!(fault_map.cells.contains(&class), "{class:?}");
        }
        let mut watch = fault_map.watch();
        let bad = (0..frames.len())
            .filter(|k| watch.push(&fault_map, frames.frame(*k)).label.class != Class::Clean)
            .count();
        assert!(frames.len() > 4000 && bad * 100 < frames.len(), "{bad} of {}", frames.len());
    }
}
