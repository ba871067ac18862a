//! Capture times of devices that neither count nor measure in cycles: a sample was true when it arrived.
//!
//! What such a device's network takes is not known and only adds: where it is constant, the stage file's
//! `measurement_delay_ms` takes it off.
//!
//! What waits in a network, or for a host that sleeps, comes all at once, and most of it is old. A packet says nothing of its
//! age, but those behind it do: what follows a silence, and whatever comes on its heels, is taken for [`Stamp::queued`] until
//! one comes by itself, with as much time before it as a device takes to send another one.

use posed_drivers::{DeviceTime, Sample, Timestamp};
use posed_state::Plain;
use std::time::Duration;

use super::{LEAST_STEP_NS, Settings, Stamp};

/// What a wireless network's delay varies by, s.
const SIGMA_S: f64 = 5e-3;

/// Silence after which what comes may have waited, and least time between two packets that have not, s. The devices look for
/// something new every 10 ms.
const SILENCE_S: f64 = 0.025;
const APART_S: f64 = 0.005;

/// A clock that believes arrivals, less the constant delay of its [`Settings`]. What the network adds stays in its capture times.
#[derive(Clone, Debug, Plain)]
pub struct ArrivalClock {
    settings: Settings,
    last: Option<(u64, Timestamp)>,
    /// When the latest packet came, and whether it may have waited.
    came: Option<Timestamp>,
    queued: bool,
}

impl ArrivalClock {
    /// A clock that has seen nothing yet; of its settings only the delay counts.
    pub fn new(settings: Settings) -> Self {
        Self { settings, last: None, came: None, queued: true }
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
        if begins_cycle {
            let t_read = sample.arrival.t_read;
            let since_s = self.came.replace(t_read).map_or(f64::INFINITY, |came| t_read.seconds_since(came));
            self.queued = since_s > SILENCE_S || (self.queued && since_s < APART_S);
        }
        if let Some((_, last)) = self.last {
            t_valid = if begins_cycle {
                t_valid.max(Timestamp::from_nanos(last.as_nanos() + LEAST_STEP_NS))
            } else {
                last
            };
        }
        self.last = Some((packet, t_valid));
        Stamp { t_valid, sigma_s: SIGMA_S, begins_cycle, cycles_skipped: 0, queued: self.queued }
    }

    /// Standard deviation of a capture time, s: 5 ms, taken and not measured. `None` before the first sample.
    pub fn sigma_t_s(&self) -> Option<f64> {
        self.last.map(|_| SIGMA_S)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::sample;
    use super::*;

    #[test]
    fn what_waited_is_queued_until_one_comes_by_itself() {
        let mut clock = ArrivalClock::new(Settings { byte_time_s: 0.0, measurement_delay_s: 0.0 });
        let mut packet = 0;
        let mut queued = |t_ms: f64| {
            packet += 1;
            let t_read = Timestamp::from_secs_f64(t_ms * 1e-3);
            clock.push(&sample(1, t_read, None, DeviceTime::Cycle(packet))).queued
        };
        // The first one may have waited, too.
        assert_eq!([0.0, 10.0, 20.0, 31.0, 39.0].map(&mut queued), [true, false, false, false, false]);
        // Half a second of packets at once, and the stream goes on.
        assert_eq!([540.0, 540.1, 540.2, 541.0, 543.0].map(&mut queued), [true; 5]);
        assert_eq!([550.0, 560.0].map(&mut queued), [false; 2]);
    }
}
