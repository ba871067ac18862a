//! One sensor of a magnetic tracker in its cycle: physics, the script's faults, and the class of what results.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use posed_drivers::Timestamp;

use super::{Signal, Tracker};
use crate::device::Sensor;
use crate::faults::Fault;
use crate::random::Random;
use crate::truth::{Class, TruthRow};

/// What a sensor reports: sensor to transmitter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reported {
    /// m.
    pub(crate) position_m: Vector3<f64>,
    /// Sensor to transmitter.
    pub(crate) orientation: UnitQuaternion<f64>,
}

/// A sensor of a tracker, by its address on the device.
#[derive(Debug)]
pub(crate) struct Station {
    pub(crate) address: u16,
    sensor: Sensor,
    /// Noise of its signals.
    random: Random,
    /// Axis of the half-space that the device was set to, in the transmitter frame; zero: it follows the sensor.
    pub(crate) hemisphere: Vector3<f64>,
    latest: Option<Reported>,
    stuck: bool,
}

/// What all stations of a device share.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    pub(crate) tracker: Tracker,
    /// Transmitter to room.
    pub(crate) transmitter_in_room: Isometry3<f64>,
    /// A distortion above this makes a measurement `disturbed`, m.
    pub(crate) disturbed_above_m: f64,
}

impl Station {
    pub(crate) fn new(address: u16, sensor: Sensor, random: Random) -> Self {
        Self { address, sensor, random, hemisphere: Vector3::x(), latest: None, stuck: false }
    }

    /// What was measured last; while the sensor is out of range it repeats.
    pub(crate) fn latest(&self) -> Option<Reported> {
        self.latest
    }

    /// Measures at `t`, and returns what is true.
    pub(crate) fn measure(&mut self, scene: &Scene, faults: &[Fault], t: Timestamp) -> TruthRow {
        let pose = self.sensor.pose_in_room(t);
        let in_transmitter = scene.transmitter_in_room.inverse() * pose;
        let follows = self.hemisphere == Vector3::zeros();
        let hemisphere = if follows { in_transmitter.translation.vector } else { self.hemisphere };
        let reading = scene.tracker.measure(t.as_secs_f64(), &in_transmitter, &hemisphere, &mut self.random);
        let active = |wanted: fn(&Fault) -> bool| {
            faults.iter().any(|f| wanted(f) && f.address() == Some(self.address) && f.is_active(t))
        };
        let frozen = active(|fault| matches!(fault, Fault::OutOfRange { .. }));
        let flipped = active(|fault| matches!(fault, Fault::HemisphereFlip { .. }));
        let solution = reading.solution.filter(|_| !frozen);
        let is_bent = reading.distortion_m.norm() > scene.disturbed_above_m;
        let class = match solution {
            None => {
                self.stuck = true;
                Class::Stuck
            }
            Some(_) if std::mem::take(&mut self.stuck) && self.latest.is_some() => Class::Jump,
            Some(_) if reading.mirrored != flipped => Class::Inverted,
            Some(_) if is_bent || reading.signal == Signal::Saturated => Class::Disturbed,
            Some(_) => Class::Clean,
        };
        if let Some(solution) = solution {
            let position_m = if flipped { -solution.position_m } else { solution.position_m };
            self.latest = Some(Reported { position_m, orientation: solution.orientation });
        }
        TruthRow {
            sensor: self.sensor.index,
            pose,
            class,
            distortion_m: scene.transmitter_in_room.rotation * reading.distortion_m,
        }
    }
}
