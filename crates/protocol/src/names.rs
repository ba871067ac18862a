//! Names of a stage's sensors and devices, in the order of their indices.

use posed_stage::input::{DeviceIndex, SensorIndex};
use posed_stage::layout::BodyLayout;
use posed_stage::{BodyIndex, Stage};

/// Names as messages carry them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Names {
    devices: Vec<String>,
    sensors: Vec<SensorName>,
    bodies: Vec<(String, Option<BodyLayout>)>,
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
            bodies: stage.bodies.iter().map(|body| body.name.clone()).zip(BodyLayout::all(stage)).collect(),
        }
    }

    /// Segments and angles of a body; `None` where there is no such body, or it wears no sensor.
    pub fn body(&self, body: BodyIndex) -> Option<&BodyLayout> {
        self.bodies.get(usize::from(body))?.1.as_ref()
    }

    /// A body's name; empty for an index that the stage does not have.
    pub fn body_name(&self, body: BodyIndex) -> &str {
        self.bodies.get(usize::from(body)).map_or("", |(name, _)| name)
    }

    /// Indices of all bodies.
    pub fn bodies(&self) -> impl ExactSizeIterator<Item = BodyIndex> + use<> {
        // There are no more than their indices can tell.
        (0..self.bodies.len()).map(|index| index as BodyIndex)
    }

    /// A device's name; empty for an index that the stage does not have.
    pub fn device(&self, device: DeviceIndex) -> &str {
        self.devices.get(usize::from(device)).map_or("", String::as_str)
    }

    /// A sensor's name; empty for an index that the stage does not have.
    pub fn sensor(&self, sensor: SensorIndex) -> &str {
        self.sensors.get(usize::from(sensor)).map_or("", |sensor| &sensor.name)
    }

    /// Whether a sensor is a magnetic tracker's; `false` for an index that the stage does not have.
    pub fn is_magnetic(&self, sensor: SensorIndex) -> bool {
        self.sensors.get(usize::from(sensor)).is_some_and(|sensor| sensor.magnetic)
    }

    /// Name of the device that a sensor belongs to; empty for an index that the stage does not have.
    pub fn device_of(&self, sensor: SensorIndex) -> &str {
        self.sensors.get(usize::from(sensor)).map_or("", |sensor| &sensor.device)
    }

    /// Index of the sensor of that name; `None` where the stage has none.
    pub fn find_sensor(&self, name: &str) -> Option<SensorIndex> {
        let at = self.sensors.iter().position(|sensor| sensor.name == name)?;
        SensorIndex::try_from(at).ok()
    }

    /// Number of sensors.
    pub fn sensor_count(&self) -> usize {
        self.sensors.len()
    }

    /// Name and device's name of every sensor, in the order of their indices.
    pub fn sensors(&self) -> impl ExactSizeIterator<Item = (&str, &str)> {
        self.sensors.iter().map(|sensor| (sensor.name.as_str(), sensor.device.as_str()))
    }
}
