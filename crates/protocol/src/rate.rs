//! A rate that frames are thinned to.

use posed_drivers::Timestamp;

/// When the next frame is due.
#[derive(Clone, Debug)]
pub(crate) struct Rate {
    period_s: f64,
    due_s: f64,
}

impl Rate {
    pub(crate) fn new(rate_hz: f64) -> Self {
        Self { period_s: 1.0 / rate_hz, due_s: f64::NEG_INFINITY }
    }

    /// Whether a frame of this time is to be sent: at the rate on average, however the frames fall.
    pub(crate) fn is_due(&mut self, t: Timestamp) -> bool {
        let t_s = t.as_secs_f64();
        if t_s < self.due_s {
            return false;
        }
        let next_s = self.due_s + self.period_s;
        self.due_s = if next_s > t_s { next_s } else { t_s + self.period_s };
        true
    }

    /// Whether what was due has not come for more than a second, somewhat more than the largest distance of two frames.
    pub(crate) fn is_overdue(&self, t_s: f64) -> bool {
        t_s > self.due_s + 1.0
    }

    /// Lets time start anew.
    pub(crate) fn rewind(&mut self) {
        self.due_s = f64::NEG_INFINITY;
    }
}
