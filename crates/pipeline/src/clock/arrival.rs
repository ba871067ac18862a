//! Capture times of devices that neither count nor measure in cycles: a sample was true when it arrived.
//!
//! What such a device's network takes is not known and only adds: where it is constant, the stage file's
//! `measurement_delay_ms` takes it off.

use posed_drivers::{DeviceTime, Sample, Timestamp};
use posed_state::Plain;
use std::time::Duration;

use super::{LEAST_STEP_NS, Settings, Stamp};

/// What a wireless network's delay varies by, s.
const SIGMA_S: f64 = 5e-3;

/// A clock that believes arrivals, less the constant delay of its [`Settings`]. What the network adds stays in its capture times.
#[derive(Clone, Debug, Plain)]
pub struct ArrivalClock {
    settings: Settings,
    last: Option<(u64, Timestamp)>,
}

impl ArrivalClock {
    /// A clock that has seen nothing yet; of its settings only the delay counts.
    pub fn new(settings: Settings) -> Self {
        Self { settings, last: None }
    }

    /// Takes the next sample, in order of arrival, and returns when it was measured; samples of one packet share their time, and
    /// those of the next are later. No cycle counts as skipped.
    ///
    /// # Panics
    /// The settings' `measurement_delay_s` is negative or not finite.
    pub fn push(&mut self, sample: &Sample) -> Stamp {
        let (DeviceTime::Cycle(packet) | DeviceTime::Counter { ticks: packet, .. }) = sample.t_device;
        let delay = Duration::from_secs_f64(self.settings.measurement_delay_s);
        let mut t_valid = sample.arrival.t_read - delay;
        let begins_cycle = self.last.is_none_or(|(last, t)| last != packet || t < t_valid);
        if let Some((_, last)) = self.last {
            t_valid = if begins_cycle {
                t_valid.max(Timestamp::from_nanos(last.as_nanos() + LEAST_STEP_NS))
            } else {
                last
            };
        }
        self.last = Some((packet, t_valid));
        Stamp { t_valid, sigma_s: SIGMA_S, begins_cycle, cycles_skipped: 0 }
    }

    /// Standard deviation of a capture time, s: 5 ms, taken and not measured. `None` before the first sample.
    pub fn sigma_t_s(&self) -> Option<f64> {
        self.last.map(|_| SIGMA_S)
    }
}
