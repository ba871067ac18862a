//! Asks an open port whether a Flock of Birds or a 3D Guidance unit answers, for `posed doctor`.
//!
//! The same contract as a session, without samples: feed it inputs, drain [`Probe::poll_output`], wait
//! for [`Probe::poll_timeout`], until [`Probe::result`] is there. A caller tries one baud rate after the other;
//! on a silent line a probe takes about 0.7 s, and 2 s more where it lets the unit out of reset first.

use std::collections::VecDeque;
use std::time::Duration;

use super::examine::{Examination, Failure, Findings, Progress};
use crate::sample::Timestamp;
use crate::session::Output;

/// Baud rates of a Flock, bit/s, the likeliest first.
pub const BAUD_RATES: [u32; 7] = [115_200, 38_400, 19_200, 57_600, 9_600, 4_800, 2_400];
/// What the unit needs after RTS has let it go.
const BOOT: Duration = Duration::from_secs(2);

/// One probe of one port at one baud rate. It stops a stream and sets nothing. Answers have neither head nor checksum: bytes of
/// the right number at the right time count as one.
#[derive(Debug)]
pub struct Probe {
    phase: Phase,
    outputs: VecDeque<Output>,
}

#[derive(Debug)]
enum Phase {
    Booting { until: Timestamp },
    Examining(Box<Examination>),
    Done(Result<Findings, Failure>),
}

impl Probe {
    /// Begins at a port that has just been opened; with modem lines the unit is let out of reset first, and given 2 s to start.
    pub fn new(now: Timestamp, modem_lines: bool) -> Self {
        if modem_lines {
            let phase = Phase::Booting { until: now + BOOT };
            return Self { phase, outputs: VecDeque::from([Output::SetRts(false)]) };
        }
        let mut probe = Self { phase: Phase::Booting { until: now }, outputs: VecDeque::new() };
        probe.examine(now);
        probe
    }

    /// Begins at a port that has been open all along, for a second baud rate.
    pub fn without_reset(now: Timestamp) -> Self {
        Self::new(now, false)
    }

    /// Bytes were read at `now`, cut anywhere. Without effect once there is a result.
    pub fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        if let Phase::Examining(examination) = &mut self.phase {
            let progress = examination.handle_bytes(now, bytes);
            self.on_progress(progress);
        }
    }

    /// The time of [`Self::poll_timeout`] has come. A call before that time does nothing.
    pub fn handle_timeout(&mut self, now: Timestamp) {
        if self.poll_timeout().is_none_or(|at| now < at) {
            return;
        }
        match &mut self.phase {
            Phase::Booting { .. } => self.examine(now),
            Phase::Examining(examination) => {
                let progress = examination.handle_timeout(now);
                self.on_progress(progress);
            }
            Phase::Done(_) => {}
        }
    }

    /// Bytes to send and lines to set, in order, until `None`: [`Output::Transmit`] and [`Output::SetRts`] only.
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When to call [`Self::handle_timeout`]; `None` when done.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        match &self.phase {
            Phase::Booting { until } => Some(*until),
            Phase::Examining(examination) => Some(examination.poll_timeout()),
            Phase::Done(_) => None,
        }
    }

    /// What was found; `None` until done. On an `Err`, [`Failure::advice`] states what to check.
    pub fn result(&self) -> Option<Result<&Findings, Failure>> {
        match &self.phase {
            Phase::Done(Ok(findings)) => Some(Ok(findings)),
            Phase::Done(Err(failure)) => Some(Err(*failure)),
            _ => None,
        }
    }

    fn examine(&mut self, now: Timestamp) {
        self.phase = Phase::Examining(Box::new(Examination::new(now, None, None, 2)));
        self.on_progress(Progress::Busy);
    }

    fn on_progress(&mut self, progress: Progress) {
        if let Phase::Examining(examination) = &mut self.phase {
            while let Some(bytes) = examination.poll_transmit() {
                self.outputs.push_back(Output::Transmit(bytes));
            }
        }
        match progress {
            Progress::Busy => {}
            Progress::Found(findings) => self.phase = Phase::Done(Ok(*findings)),
            Progress::Failed(failure) => self.phase = Phase::Done(Err(failure)),
        }
    }
}
