//! One unit: what it is asked, whether it sends, and whether its time stamps can be true.

use std::time::Duration;

use posed_state::Plain;

use crate::sample::Timestamp;

/// Time for an answer, and further tries.
const ANSWER: Duration = Duration::from_millis(500);
const TRIES: u8 = 2;
/// Time between two questions to a unit that does not answer.
const RETRY: Duration = Duration::from_secs(1);
/// Silence of a running unit.
const SILENCE: Duration = Duration::from_millis(500);

#[derive(Clone, Copy, Debug, PartialEq, Plain)]
enum Phase {
    Closed,
    Asking { step: usize, tries: u8, until: Timestamp },
    Running { silent_at: Timestamp },
    Missing { until: Timestamp },
}

/// What has become of a unit's deadline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expired {
    /// It has not passed.
    No,
    /// Send the command once more, or the first one again.
    Ask,
    /// The unit has stopped sending.
    Silent,
    /// The unit has not answered for all the tries.
    Missing,
}

/// A unit of the stage file.
#[derive(Clone, Debug, Plain)]
pub(super) struct Unit {
    pub(super) address: u16,
    phase: Phase,
    /// Whether it has been missing since the line was opened.
    missing: bool,
    pub(super) clock: ClockWatch,
}

impl Unit {
    pub(super) fn new(address: u16) -> Self {
        Self { address, phase: Phase::Closed, missing: false, clock: ClockWatch::default() }
    }

    pub(super) fn ask_from_start(&mut self, now: Timestamp) {
        self.phase = Phase::Asking { step: 0, tries: TRIES, until: now + ANSWER };
    }

    pub(super) fn close(&mut self) {
        self.phase = Phase::Closed;
    }

    /// The command that waits for its answer.
    pub(super) fn asking(&self) -> Option<usize> {
        if let Phase::Asking { step, .. } = self.phase { Some(step) } else { None }
    }

    /// The command to send.
    pub(super) fn step(&self) -> usize {
        self.asking().unwrap_or_default()
    }

    pub(super) fn is_running(&self) -> bool {
        matches!(self.phase, Phase::Running { .. })
    }

    pub(super) fn is_missing(&self) -> bool {
        self.missing
    }

    /// The command was answered; true when there is another one.
    pub(super) fn answered(&mut self, now: Timestamp, commands: usize, period_us: u64) -> bool {
        self.missing = false;
        let next = self.step() + 1;
        if next < commands {
            self.phase = Phase::Asking { step: next, tries: TRIES, until: now + ANSWER };
            return true;
        }
        self.received(now, period_us);
        false
    }

    /// The running unit has sent data.
    pub(super) fn received(&mut self, now: Timestamp, period_us: u64) {
        let silence = SILENCE.max(Duration::from_micros(20 * period_us));
        self.phase = Phase::Running { silent_at: now + silence };
    }

    pub(super) fn poll_timeout(&self) -> Option<Timestamp> {
        match self.phase {
            Phase::Closed => None,
            Phase::Asking { until, .. } | Phase::Missing { until } => Some(until),
            Phase::Running { silent_at } => Some(silent_at),
        }
    }

    pub(super) fn handle_timeout(&mut self, now: Timestamp) -> Expired {
        if self.poll_timeout().is_none_or(|at| now < at) {
            return Expired::No;
        }
        match self.phase {
            Phase::Closed => Expired::No,
            Phase::Asking { step, tries, .. } if tries > 0 => {
                self.phase = Phase::Asking { step, tries: tries - 1, until: now + ANSWER };
                Expired::Ask
            }
            Phase::Asking { .. } => {
                self.missing = true;
                self.phase = Phase::Missing { until: now + RETRY };
                Expired::Missing
            }
            Phase::Missing { .. } => {
                // One question a second is enough for a unit that is not there.
                self.phase = Phase::Asking { step: 0, tries: 0, until: now + ANSWER };
                Expired::Ask
            }
            Phase::Running { .. } => Expired::Silent,
        }
    }
}

/// Whether a time stamp can be true.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Clock {
    /// It fits the ones before.
    Plausible,
    /// It does not; the message may be damaged.
    Doubtful,
    /// Two in a row fit each other and not the ones before, of which the last one came so many seconds ago.
    Restarted(f64),
}

/// What a gap between time stamps tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Inferred {
    /// As expected, or the first one.
    Whole,
    /// So many messages are missing.
    Lost(u64),
}

/// Holds a unit's time stamps against the host's clock: without a checksum this finds most damaged stamps.
#[derive(Clone, Copy, Debug, Default, Plain)]
pub(super) struct ClockWatch {
    last: Option<(Timestamp, u64)>,
    doubtful: Option<(Timestamp, u64)>,
    last_inertial_us: Option<u64>,
}

/// Greatest difference between the clocks that bursts and queues explain, in seconds.
const MOST_APART_S: f64 = 1.0;

fn fits((then, then_us): (Timestamp, u64), now: Timestamp, time_us: u64) -> bool {
    let device_s = (i128::from(time_us) - i128::from(then_us)) as f64 * 1e-6;
    (device_s - now.seconds_since(then)).abs() <= MOST_APART_S
}

impl ClockWatch {
    pub(super) fn check(&mut self, now: Timestamp, time_us: u64) -> Clock {
        if self.last.is_none_or(|last| fits(last, now, time_us)) {
            self.last = Some((now, time_us));
            self.doubtful = None;
            return Clock::Plausible;
        }
        if self.doubtful.replace((now, time_us)).is_some_and(|doubtful| fits(doubtful, now, time_us)) {
            let since_s = self.last.map_or(0.0, |(then, _)| now.seconds_since(then));
            *self = Self::default();
            return Clock::Restarted(since_s);
        }
        Clock::Doubtful
    }

    /// Messages missing in front of an inertial message.
    pub(super) fn gap(&mut self, time_us: u64, period_us: u64) -> Inferred {
        let Some(last) = self.last_inertial_us.replace(time_us) else { return Inferred::Whole };
        let periods = (time_us.saturating_sub(last) + period_us / 2) / period_us;
        if periods > 1 { Inferred::Lost(periods - 1) } else { Inferred::Whole }
    }
}
