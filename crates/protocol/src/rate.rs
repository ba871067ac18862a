//! A rate that a stream is thinned to.

/// When the next of a stream is due. Times are in any unit, the same for all.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    period: f64,
    due: f64,
}

impl Rate {
    /// One in each period, the first at any time.
    pub fn every(period: f64) -> Self {
        Self { period, due: f64::NEG_INFINITY }
    }

    /// Whether what is of this time may go out: at the stated rate on average, however it falls.
    pub fn is_due(&mut self, t: f64) -> bool {
        if t < self.due {
            return false;
        }
        // The next one is due a period after this one was, unless the stream had paused longer than that.
        let next = self.due + self.period;
        self.due = if next > t { next } else { t + self.period };
        true
    }

    /// Whether what was due has not come for longer than `patience`.
    pub fn is_overdue(&self, t: f64, patience: f64) -> bool {
        t > self.due + patience
    }

    /// Lets time start anew.
    pub fn rewind(&mut self) {
        self.due = f64::NEG_INFINITY;
    }
}
