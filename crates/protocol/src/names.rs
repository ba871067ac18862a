//! Names of a stage's sensors and devices, in the order of their indices.

use posed_stage::Stage;
use posed_stage::input::{DeviceIndex, SensorIndex};
use posed_stage::layout::BodyLayout;

/// Names as messages carry them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Names {
    devices: Vec<String>,
    sensors: Vec<SensorName>,
    body: Option<BodyLayout>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct SensorName {
    name: String,
    device: String,
    magnetic: bool,
}

impl Names {
    /// Those of a stage.
    pub fn new(stage: &Stage) -> Self {
        let magnetic = stage.magnetic_indices();
        let sensor = |(index, sensor): (usize, &posed_stage::Sensor)| SensorName {
            name: sensor.name.clone(),
            device: sensor.device.clone(),
            magnetic: magnetic.contains(&index),
        };
        Self {
            devices: stage.devices.iter().map(|device| device.name.clone()).collect(),
            sensors: stage.sensors.iter().enumerate().map(sensor).collect(),
            body: BodyLayout::of(stage),
        }
    }

    /// The body's segments, where the sensors are worn.
    pub fn body(&self) -> Option<&BodyLayout> {
        self.body.as_ref()
    }

    /// A device's name.
    pub fn device(&self, device: DeviceIndex) -> &str {
        self.devices.get(usize::from(device)).map_or("", String::as_str)
    }

    /// A sensor's name.
    pub fn sensor(&self, sensor: SensorIndex) -> &str {
        self.sensors.get(usize::from(sensor)).map_or("", |sensor| &sensor.name)
    }

    /// Whether a sensor is a magnetic tracker's.
    pub fn is_magnetic(&self, sensor: SensorIndex) -> bool {
        self.sensors.get(usize::from(sensor)).is_some_and(|sensor| sensor.magnetic)
    }

    /// Name of the device that a sensor belongs to.
    pub fn device_of(&self, sensor: SensorIndex) -> &str {
        self.sensors.get(usize::from(sensor)).map_or("", |sensor| &sensor.device)
    }

    /// The sensor of that name.
    pub fn find_sensor(&self, name: &str) -> Option<SensorIndex> {
        let at = self.sensors.iter().position(|sensor| sensor.name == name)?;
        SensorIndex::try_from(at).ok()
    }

    /// Number of sensors.
    pub fn sensor_count(&self) -> usize {
        self.sensors.len()
    }

    /// Name and device of every sensor, in order.
    pub fn sensors(&self) -> impl ExactSizeIterator<Item = (&str, &str)> {
        self.sensors.iter().map(|sensor| (sensor.name.as_str(), sensor.device.as_str()))
    }
}
