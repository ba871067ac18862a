//! Records of a magnetic sensor and of its IMU for an alignment that is under way.
//!
//! In: estimates and the pipeline behind them, on the fusion thread. Out: records, as they come, to one who watches. It never waits
//! for that one: what he does not take in time is left out, and once he has gone nothing is done.

use std::sync::mpsc::{SyncSender, TrySendError};

use nalgebra::Isometry3;

use crate::fusion::ahrs::ImuSample;
use crate::input::SensorIndex;
use crate::output::Estimate;
use crate::pipeline::Pipeline;

/// One record with its capture time, s.
#[derive(Clone, Copy, Debug)]
pub enum Seen {
    /// Sensor to transmitter, corrected, of a record that was believed.
    Magnetic(f64, Isometry3<f64>),
    /// Of the IMU.
    Imu(f64, ImuSample),
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Waved(Option<Watcher>);

#[derive(Debug)]
struct Watcher {
    sensor: SensorIndex,
    imu: Option<SensorIndex>,
    to: SyncSender<Seen>,
    last_s: f64,
}

impl Waved {
    /// Begins to send; whoever watched before gets nothing more.
    pub(super) fn watch(&mut self, sensor: SensorIndex, imu: Option<SensorIndex>, to: SyncSender<Seen>) {
        self.0 = Some(Watcher { sensor, imu, to, last_s: f64::NEG_INFINITY });
    }

    /// What the IMU measured in a frame.
    pub(super) fn frame(&mut self, estimate: &Estimate) {
        let Some(watcher) = &self.0 else { return };
        let record = watcher.imu.and_then(|imu| estimate.sensors.get(usize::from(imu))?.measured);
        let seen = record.and_then(|record| Some((record.t_valid.as_secs_f64(), record.inertial?.sample()?)));
        if let Some((t_s, sample)) = seen {
            self.send(Seen::Imu(t_s, sample));
        }
    }

    /// What the magnetic sensor measured, after an entry.
    pub(super) fn look(&mut self, pipeline: &Pipeline) {
        let Some(watcher) = &mut self.0 else { return };
        let Some((t, pose)) = pipeline.believed(watcher.sensor) else { return };
        let t_s = t.as_secs_f64();
        if t_s > watcher.last_s {
            watcher.last_s = t_s;
            self.send(Seen::Magnetic(t_s, pose));
        }
    }

    fn send(&mut self, seen: Seen) {
        let gone =
            |watcher: &mut Watcher| matches!(watcher.to.try_send(seen), Err(TrySendError::Disconnected(_)));
        self.0.take_if(gone);
    }
}
