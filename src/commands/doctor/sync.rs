//! `posed doctor --sync`: by how much one device's motion appears later than another's.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use posed_daemon::{Daemon, Options};
use posed_geometry::orientation_from_wxyz;
use posed_pipeline::clock::offset::{Offset, offset};
use posed_protocol::{Measured, ServerMessage};
use posed_recording::{Item, Take, is_recording};
use posed_stage::Stage;
use serde::Serialize;

use super::{Error, print, print_json};

/// Below this a correlation says nothing.
const LEAST_CORRELATION: f64 = 0.7;
/// Less variation of the angular speed than this is too little motion, rad/s.
const LEAST_MOTION_RAD_S: f64 = 0.2;
/// Longest step from which a speed is taken, s.
const LONGEST_STEP_S: f64 = 0.1;

/// The answer.
#[derive(Serialize)]
struct Report {
    offsets: Vec<Found>,
}

/// One device beside the stage's first.
#[derive(Debug, Serialize)]
struct Found {
    device: String,
    /// The device that it is compared with.
    against: String,
    /// The sensors whose motion agrees best.
    sensors: [String; 2],
    /// By how much its motion appears later, ms.
    later_ms: f64,
    correlation: f64,
    /// The device whose key is to be set, and its value: what it has now and the offset.
    set: String,
    measurement_delay_ms: f64,
}

/// Angular speeds of one sensor, by time.
type Speed = Vec<(f64, f64)>;

/// Measures the offsets in a recording, or on a stage that runs for so many seconds.
pub(super) fn run(file: &Path, seconds: f64, json: bool) -> Result<(), Error> {
    let folder;
    let recording = if is_recording(file) {
        file.to_owned()
    } else {
        folder = tempfile::tempdir().map_err(|error| Error::Failed(format!("no room to record: {error}")))?;
        let recording = folder.path().join("sync.mcap");
        record(file, &recording, seconds)?;
        recording
    };
    let (stage, speeds) = read(&recording)?;
    let offsets = offsets(&stage, &speeds)?;
    if json {
        return print_json(&Report { offsets });
    }
    for found in &offsets {
        let Found { device, against, sensors, later_ms, correlation, set, measurement_delay_ms } = found;
        let [one, other] = sensors;
        print(&format!(
            "{device}: its motion appears {later_ms:.1} ms later than that of {against} (correlation {correlation:.3} of \
             {one} and {other})\n    set for {set}: measurement_delay_ms = {measurement_delay_ms:.1}\n"
        ))?;
    }
    Ok(())
}

/// Runs the stage and records it.
fn record(stage: &Path, recording: &Path, seconds: f64) -> Result<(), Error> {
    let text = std::fs::read_to_string(stage).map_err(|error| Error::file("read", stage, &error))?;
    let parsed = Stage::load(stage).map_err(Error::failed)?;
    let folder = stage.parent().unwrap_or(Path::new("")).to_owned();
    let options = Options {
        listen: Some("127.0.0.1:0".to_owned()),
        record: Some(recording.to_owned()),
        ..super::super::run::options(parsed, text, folder)
    };
    super::super::notify(&format!("move the sensors together, quickly and irregularly, for {seconds} s"));
    super::super::run::block_on(async {
        let daemon = Daemon::start(options).map_err(Error::failed)?;
        wait(Duration::from_secs_f64(seconds)).await;
        daemon.shutdown().await;
        Ok(())
    })
}

#[expect(clippy::disallowed_methods, reason = "the stage runs in real time")]
async fn wait(time: Duration) {
    tokio::time::sleep(time).await;
}

/// The stage of a recording, and the angular speeds of its sensors by name, from their raw records.
fn read(recording: &Path) -> Result<(Stage, BTreeMap<String, Speed>), Error> {
    let failed = |error| Error::Failed(format!("cannot read {}: {error}", recording.display()));
    let take = Take::open(recording).map_err(failed)?;
    let stage = Stage::parse(&take.header().stage_toml).map_err(Error::failed)?;
    let mut measured: BTreeMap<String, Vec<Measured>> = BTreeMap::new();
    for item in take {
        let Item::Message(message) = item.map_err(failed)? else { continue };
        if &*message.topic != "sensors" {
            continue;
        }
        let Ok(ServerMessage::Sensors(frame)) = serde_json::from_slice(&message.json) else { continue };
        for sensor in frame.body.sensors {
            if let Some(record) = sensor.measured {
                measured.entry(sensor.name).or_default().push(record);
            }
        }
    }
    Ok((stage, measured.into_iter().map(|(name, records)| (name, speed(&records))).collect()))
}

/// Angular speed by gyro where there is one, else from one orientation to the next.
fn speed(records: &[Measured]) -> Speed {
    let mut speed: Speed = Vec::with_capacity(records.len());
    let mut before: Option<&Measured> = None;
    for record in records {
        if let Some([x, y, z]) = record.angular_velocity_rad_s {
            speed.push((record.t_s, (x * x + y * y + z * z).sqrt()));
        } else if let Some(earlier) = before {
            let dt_s = record.t_s - earlier.t_s;
            let orientation = |of: &Measured| of.orientation_wxyz.and_then(orientation_from_wxyz);
            if let (Some(from), Some(to)) = (orientation(earlier), orientation(record))
                && dt_s > 0.0
                && dt_s <= LONGEST_STEP_S
            {
                // Between the two it is true in the middle.
                speed.push((0.5 * (record.t_s + earlier.t_s), from.angle_to(&to) / dt_s));
            }
        }
        before = Some(record);
    }
    // Records that came late may lie out of order.
    speed.sort_by(|one, other| one.0.total_cmp(&other.0));
    speed.dedup_by(|one, other| one.0 == other.0);
    speed
}

/// Every device against the first, by the two sensors whose motion agrees best.
fn offsets(stage: &Stage, speeds: &BTreeMap<String, Speed>) -> Result<Vec<Found>, Error> {
    let [first, others @ ..] = stage.devices.as_slice() else {
        return Err(Error::Failed("the stage has no device".to_owned()));
    };
    if others.is_empty() {
        return Err(Error::Failed("the stage has one device only; an offset is between two".to_owned()));
    }
    let sensors = |device: &str| {
        let of = stage.sensors.iter().filter(|sensor| sensor.device == device);
        of.filter_map(|sensor| Some((sensor.name.as_str(), speeds.get(&sensor.name)?))).collect::<Vec<_>>()
    };
    let mut found = Vec::new();
    for device in others {
        let mut best: Option<(Offset, [&str; 2])> = None;
        for (one, a) in sensors(&first.name) {
            for (other, b) in sensors(&device.name) {
                if let Some(offset) = offset(a, b)
                    && best.is_none_or(|(known, _)| offset.correlation > known.correlation)
                {
                    best = Some((offset, [one, other]));
                }
            }
        }
        let Some((offset, names)) = best.filter(|(offset, _)| {
            offset.correlation >= LEAST_CORRELATION && offset.motion_rad_s >= LEAST_MOTION_RAD_S
        }) else {
            return Err(Error::Failed(format!(
                "no sensor of {} moves like one of {}; attach one of each to the same stick and turn it quickly and \
                 irregularly for some ten seconds",
                device.name, first.name
            )));
        };
        let later_ms = 1e3 * offset.later_s;
        let (set, delay_ms) = if later_ms >= 0.0 || device.measurement_delay_ms + later_ms >= 0.0 {
            (device, device.measurement_delay_ms + later_ms)
        } else {
            (first, first.measurement_delay_ms - later_ms)
        };
        found.push(Found {
            device: device.name.clone(),
            against: first.name.clone(),
            sensors: names.map(str::to_owned),
            later_ms,
            correlation: offset.correlation,
            set: set.name.clone(),
            measurement_delay_ms: delay_ms,
        });
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAGE: &str = "name = \"s\"\n\
        [[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"/dev/a\"\nmeasurement_delay_ms = 2.0\n\
        [[device]]\nname = \"imu\"\ndriver = \"x-imu3\"\nport = \"/dev/b\"\n\
        [[sensor]]\nname = \"bird\"\ndevice = \"flock\"\naddress = 0\n\
        [[sensor]]\nname = \"unit\"\ndevice = \"imu\"\naddress = 0\n";

    fn record(t_s: f64, shift_s: f64, gyro: bool) -> Measured {
        // Turning about z by an angle whose angular velocity is known.
        let t = t_s - shift_s;
        let angle = 0.8 * libm::sin(2.0 * t) + 0.3 * libm::cos(5.3 * t);
        let angular_velocity_rad_s = 1.6 * libm::cos(2.0 * t) - 1.59 * libm::sin(5.3 * t);
        Measured {
            t_s,
            position_m: None,
            orientation_wxyz: (!gyro).then(|| [libm::cos(0.5 * angle), 0.0, 0.0, libm::sin(0.5 * angle)]),
            button: None,
            angular_velocity_rad_s: gyro.then_some([0.0, angular_velocity_rad_s, 0.0]),
            specific_force_m_s2: None,
            linear_acceleration_m_s2: None,
            magnetic_field: None,
        }
    }

    fn speeds(shift_s: f64) -> BTreeMap<String, Speed> {
        let bird: Vec<Measured> = (0..2000).map(|k| record(f64::from(k) / 103.3, 0.0, false)).collect();
        let unit: Vec<Measured> = (0..2000).map(|k| record(f64::from(k) / 100.0, shift_s, true)).collect();
        [("bird".to_owned(), speed(&bird)), ("unit".to_owned(), speed(&unit))].into()
    }

    #[test]
    fn the_key_to_set_takes_the_offset_away() {
        let stage = Stage::parse(STAGE).unwrap();
        let later = &offsets(&stage, &speeds(0.037)).unwrap()[0];
        assert!((later.later_ms - 37.0).abs() < 1.0, "{later:?}");
        assert_eq!((later.set.as_str(), later.device.as_str()), ("imu", "imu"));
        let earlier = &offsets(&stage, &speeds(-0.02)).unwrap()[0];
        assert_eq!(earlier.set, "flock");
        assert!((earlier.measurement_delay_ms - 22.0).abs() < 1.0, "{earlier:?}");
    }

    #[test]
    fn sensors_that_do_not_move_together_are_reported() {
        let stage = Stage::parse(STAGE).unwrap();
        let mut still = speeds(0.0);
        still.get_mut("unit").unwrap().iter_mut().for_each(|(_, speed)| *speed = 0.0);
        let error = offsets(&stage, &still).unwrap_err().to_string();
        assert!(error.contains("same stick"), "{error}");
    }
}
