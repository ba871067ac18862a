//! What the frames know of a device: whether it is alive, its cycles, how late its records come.

use posed_drivers::Timestamp;
use posed_state::Plain;

use super::COAST_S;

/// Samples after which the longest lag seen is forgotten (half of them at a time).
const LAG_SPAN: u32 = 128;
/// Longest lag that a frame takes into account, s.
const LAG_MAX_S: f64 = 0.1;

#[derive(Clone, Debug, Default, Plain)]
pub(super) struct Device {
    /// Latest cycle, and the host time at which something last came.
    latest: Option<Timestamp>,
    received_at: Option<Timestamp>,
    period_s: Option<f64>,
    /// Longest lag from capture to the record's end, in this span and the one before, s.
    lag_s: [f64; 2],
    seen: u32,
    running: bool,
}

impl Device {
    pub(super) fn stamp(&mut self, t_valid: Timestamp, period_s: Option<f64>, now: Timestamp) {
        self.latest = self.latest.max(Some(t_valid));
        self.received_at = Some(now);
        self.period_s = period_s.or(self.period_s);
        self.running = true;
        self.seen += 1;
        if self.seen >= LAG_SPAN {
            self.seen = 0;
            self.lag_s = [0.0, self.lag_s[0]];
        }
        self.lag_s[0] = self.lag_s[0].max(now.seconds_since(t_valid).clamp(0.0, LAG_MAX_S));
    }

    pub(super) fn stop(&mut self) {
        self.running = false;
    }

    pub(super) fn latest(&self) -> Option<Timestamp> {
        self.latest
    }

    pub(super) fn period_s(&self) -> Option<f64> {
        self.period_s
    }

    /// Whether the device has not been stopped.
    pub(super) fn is_running(&self) -> bool {
        self.running
    }

    /// Whether records have come lately.
    pub(super) fn is_alive(&self, now: Timestamp) -> bool {
        self.running && self.received_at.is_some_and(|received_at| now.seconds_since(received_at) <= COAST_S)
    }

    pub(super) fn lag_s(&self) -> f64 {
        self.lag_s[0].max(self.lag_s[1])
    }
}
