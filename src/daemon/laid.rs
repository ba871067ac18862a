//! What an IMU tells, for a calibration of it that is under way.
//!
//! In: estimates, on the fusion thread. Out: samples as the unit told them, uncorrected, to one who watches. It never waits for
//! that one: what he does not take in time is left out, and once he has gone nothing is done.

use std::sync::mpsc::{SyncSender, TrySendError};

use crate::fusion::ahrs::ImuSample;
use crate::input::SensorIndex;
use crate::output::Estimate;

/// A sample with its capture time, s.
pub(super) type Told = (f64, ImuSample);

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Laid(Option<(SensorIndex, SyncSender<Told>)>);

impl Laid {
    /// Begins to send; whoever watched before gets nothing more.
    pub(super) fn watch(&mut self, sensor: SensorIndex, to: SyncSender<Told>) {
        self.0 = Some((sensor, to));
    }

    pub(super) fn frame(&mut self, estimate: &Estimate) {
        let Some((sensor, to)) = &self.0 else { return };
        let record = estimate.sensors.get(usize::from(*sensor)).and_then(|sensor| sensor.measured);
        let told = record.and_then(|record| Some((record.t_valid.as_secs_f64(), record.inertial?.told()?)));
        if let Some(told) = told
            && matches!(to.try_send(told), Err(TrySendError::Disconnected(_)))
        {
            self.0 = None;
        }
    }
}
