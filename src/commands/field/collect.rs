//! What sensors measured, out of a recording: through the same pipeline as live.
//!
//! Field maps live in the transmitter frame and are made from what devices say, so neither the filtered poses of a
//! recording nor those that another map has corrected will do.

use std::path::Path;

use posed_field::PoleRun;
use posed_recording::table::{PoseRow, Poses};
use posed_recording::{Item, Machine, Reader};
use posed_stage::input::{Entry, Input, Request};
use posed_stage::output::{Output, SensorState};

use super::super::recorded::Recorded;
use super::Error;

/// What a guided run would have collected of `sensors` (all that give positions, if none are named) in a whole recording.
pub(super) fn run(path: &Path, sensors: &[String], spacing_m: f64) -> Result<PoleRun, Error> {
    let mut reader = Reader::open(path).map_err(Error::failed)?;
    let (stage, mut machine) = Machine::as_recorded(reader.header()).map_err(Error::failed)?;
    let magnetic = || stage.magnetic_sensors().into_iter().map(str::to_owned).collect();
    let sensors = if sensors.is_empty() { magnetic() } else { sensors.to_vec() };
    if let Some(name) = sensors.iter().find(|name| !stage.sensors.iter().any(|sensor| sensor.name == **name))
    {
        return Err(Error::Usage(format!("{} has no sensor {name:?}", path.display())));
    }
    let t = reader.header().begun;
    let mut push = |entry: &Entry| {
        let mut collected = None;
        machine.pipeline.push(entry, &mut |output| {
            if let Output::PoleRun(run) = output {
                collected = Some(run.clone());
            }
        });
        collected
    };
    push(&Entry { t, input: Input::Request(Request::FieldStart { sensors, spacing_m }) });
    for item in reader.by_ref() {
        let Item::Entry(entry) = item.map_err(Error::failed)? else { continue };
        // The operator's own runs would end this one.
        let guided =
            matches!(entry.input, Input::Request(Request::FieldStart { .. } | Request::FieldFinish {}));
        if !guided {
            push(&entry);
        }
    }
    let run = push(&Entry { t, input: Input::Request(Request::FieldFinish {}) });
    run.filter(|run| !run.frames.is_empty())
        .ok_or_else(|| Error::Failed(format!("{} holds no positions of these sensors", path.display())))
}

/// Every believed record of a recording as its device said it; those on the wrong side of the transmitter are left out.
pub(super) fn measured(path: &Path) -> Result<Poses, Error> {
    let (stage, recorded) = Recorded::open(path)?;
    let sensors = stage.sensors.iter().map(|sensor| sensor.name.clone()).collect();
    let mut poses = Poses { sensors, rows: Vec::new() };
    recorded.estimates(|estimate| {
        for (sensor, seen) in estimate.sensors.iter().enumerate() {
            if !matches!(seen.state, SensorState::Ok | SensorState::Extrapolated) {
                continue;
            }
            let Some(measured) = &seen.measured else { continue };
            poses.rows.push(PoseRow {
                t_s: measured.t_valid.as_secs_f64(),
                sensor,
                position_m: measured.position_m,
                orientation_wxyz: measured.orientation_wxyz,
                state: None,
            });
        }
    })?;
    Ok(poses)
}
