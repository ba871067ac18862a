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

#[cfg(test)]
mod tests {
    use super::*;

    /// A hub thins for its clients what a stage has thinned for the hub.
    #[test]
    fn thinned_twice_to_one_rate_a_stream_keeps_that_rate() {
        for (frame_us, rate_hz) in
            [(10_000, 60.0), (10_000, 50.0), (9_700, 60.0), (6_944, 60.0), (5_000, 90.0)]
        {
            for begun in 0..12 {
                let (mut first, mut second) = (Rate::every(1e6 / rate_hz), Rate::every(1e6 / rate_hz));
                let frames = (0..10_000_000 / frame_us).map(|n| f64::from(n * frame_us));
                let once: Vec<f64> = frames.filter(|t| first.is_due(*t)).collect();
                let twice = once[begun..].iter().filter(|t| second.is_due(**t)).count();
                let share = twice as f64 / (once.len() - begun) as f64;
                assert!(share > 0.97, "{frame_us} us at {rate_hz} Hz from frame {begun}: {share}");
            }
        }
    }
}
