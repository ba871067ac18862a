//! Where a device that sends to `/imu` sits in the stage, by its id, and what is reported to it.

use std::collections::BTreeMap;
use std::sync::Arc;

use posed_protocol::{LinkState, Status};
use posed_stage::{Driver, Stage};
use serde_json::{Value, json};

/// What a stage has of each id; clones share it.
#[derive(Clone)]
pub(crate) struct Placing {
    stage: Arc<str>,
    by_id: Arc<BTreeMap<String, Placed>>,
}

/// A device that the stage file names.
struct Placed {
    device: String,
    sensor: String,
    /// The segment that wears it; `None`: it is on none.
    segment: Option<String>,
}

impl Placing {
    pub(crate) fn new(stage: &Stage) -> Self {
        let mut by_id = BTreeMap::new();
        for (device, sensor, id) in named(stage) {
            let sits_on = sensor.sits_on().to_owned();
            let placed = Placed {
                device: device.name.clone(),
                sensor: sensor.name.clone(),
                segment: (!stage.bodies.is_empty() && posed_stage::SEGMENTS.contains(&&*sits_on))
                    .then_some(sits_on),
            };
            // Of a device with several sensors, the first.
            by_id.entry(id.to_owned()).or_insert(placed);
        }
        Self { stage: stage.name.as_str().into(), by_id: Arc::new(by_id) }
    }

    /// The sensor of a device, by name; `None` where the stage has none.
    pub(crate) fn sensor(&self, id: &str) -> Option<&str> {
        self.by_id.get(id).map(|placed| placed.sensor.as_str())
    }

    /// What is reported to a device of itself.
    pub(super) fn report(&self, id: &str, status: &Status) -> Value {
        let Some(placed) = self.by_id.get(id) else {
            return json!({"stage": {"name": &*self.stage, "state": "found"}});
        };
        let device = status.devices.iter().find(|device| device.name == placed.device);
        let sensor = status.sensors.iter().find(|sensor| sensor.name == placed.sensor);
        let is_late = sensor.is_none_or(|sensor| sensor.age_s.is_none_or(|age_s| age_s > 2.0));
        let state = match device.map(|device| device.state) {
            Some(LinkState::Streaming) if !is_late => "streaming",
            _ => "waiting",
        };
        let about_it = |problem: &&posed_protocol::Problem| {
            let is = |key: &str, name: &String| problem.values.get(key) == Some(name);
            is("sensor", &placed.sensor) || is("device", &placed.device)
        };
        let problems = status.problems.iter().filter(about_it).map(|problem| problem.message.as_str());
        json!({"stage": {
            "name": &*self.stage,
            "state": state,
            "sensor": placed.sensor,
            "segment": placed.segment,
            "rate_hz": sensor.and_then(|sensor| sensor.rate_hz),
            "samples": sensor.map(|sensor| sensor.samples),
            // What came and was of no use is not the radio's.
            "lost": sensor.map(|sensor| sensor.missed),
            "problems": problems.collect::<Vec<_>>(),
        }})
    }
}

/// Every device that the stage file names by the id that it sends, with its sensor.
fn named(stage: &Stage) -> impl Iterator<Item = (&posed_stage::Device, &posed_stage::Sensor, &str)> {
    let of_device =
        |device| stage.sensors.iter().filter(move |sensor: &&posed_stage::Sensor| sensor.device == device);
    stage.devices.iter().flat_map(move |device| {
        let ids: &[String] = match &device.driver {
            Driver::OpenImu(settings) => &settings.devices,
            _ => &[],
        };
        // The low byte of an address is the number of the device, from 1.
        let id =
            move |sensor: &posed_stage::Sensor| ids.get(usize::from(sensor.address & 0xFF).checked_sub(1)?);
        of_device(device.name.as_str()).filter_map(move |sensor| Some((device, sensor, id(sensor)?.as_str())))
    })
}

#[cfg(test)]
mod tests {
    use posed_protocol::Problem;

    use super::*;

    #[test]
    fn a_phone_hears_what_is_wrong_with_its_own_sensor_and_device_and_not_with_one_whose_name_is_longer() {
        let text = "name = \"hall\"\n[[device]]\nname = \"phones\"\ndriver = \"open-imu\"\nport = \"websocket\"\ndevices = [\"one\"]\n\
            [[sensor]]\nname = \"arm\"\ndevice = \"phones\"\naddress = 1\n";
        let placing = Placing::new(&Stage::parse(text).unwrap());
        let about = |code: &str, key: &str, value: &str| {
            Problem::new(code, format!("{value} {code}")).with(key, value)
        };
        let problems = vec![
            about("battery", "sensor", "arm"),
            about("battery", "sensor", "forearm"),
            about("device", "device", "phones"),
            Problem::new("load", "this machine is too slow for the arm"),
        ];
        let report = placing.report("one", &Status { problems, ..Status::default() });
        assert_eq!(report["stage"]["problems"], json!(["arm battery", "phones device"]));
    }
}
