//! Runs a session against a pretended device, in steps of one millisecond.

use std::time::Duration;

use posed_drivers::{LineEvent, Output, Sample, Session, State, Timestamp};

/// The far end of the line.
pub(crate) trait Device {
    /// The host has sent these bytes.
    fn receive(&mut self, now: Timestamp, bytes: &[u8]);
    /// What the device sends up to `now`, one datagram or chunk at a time.
    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>>;
}

/// A session, its device, and all that was said.
pub(crate) struct Rig<S, D> {
    pub(crate) session: S,
    pub(crate) device: D,
    pub(crate) now: Timestamp,
    pub(crate) samples: Vec<Sample>,
    pub(crate) warnings: Vec<String>,
    pub(crate) rts: Option<bool>,
    /// As it was made.
    fresh: S,
}

impl<S: Session + Clone, D: Device> Rig<S, D> {
    /// Opens the line.
    pub(crate) fn open(session: S, device: D) -> Self {
        let now = Timestamp::from_secs_f64(1.0);
        let fresh = session.clone();
        let mut rig = Self { session, device, now, samples: vec![], warnings: vec![], rts: None, fresh };
        rig.session.handle_line(now, &LineEvent::Opened { modem_lines: true });
        rig.drain();
        rig
    }

    fn drain(&mut self) {
        while let Some(output) = self.session.poll_output() {
            match output {
                Output::Transmit(bytes) => self.device.receive(self.now, &bytes),
                Output::Sample(sample) => self.samples.push(sample),
                Output::Warning(warning) => self.warnings.push(warning),
                Output::SetRts(on) => self.rts = Some(on),
                Output::StateChanged | Output::HeadingReset { .. } | Output::Pressed { .. } => {}
            }
        }
    }

    /// Lets time pass.
    pub(crate) fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now = self.now + Duration::from_millis(1);
            if self.session.poll_timeout().is_some_and(|at| at <= self.now) {
                self.session.handle_timeout(self.now);
                self.drain();
                assert!(
                    self.session.poll_timeout().is_none_or(|at| at > self.now),
                    "a deadline that has passed stays"
                );
            }
            while let Some(bytes) = self.device.send(self.now) {
                self.session.handle_bytes(self.now, &bytes);
                self.drain();
            }
        }
    }

    /// The host reads nothing for a while, and then all that has come at once.
    pub(crate) fn hold_back_ms(&mut self, ms: u64) {
        let mut held = Vec::new();
        for _ in 0..ms {
            self.now = self.now + Duration::from_millis(1);
            while let Some(bytes) = self.device.send(self.now) {
                held.extend(bytes);
            }
        }
        self.session.handle_bytes(self.now, &held);
        self.drain();
    }

    /// Puts the session away as a snapshot does, and goes on with what is read back.
    pub(crate) fn store_and_restore(&mut self)
    where
        S: posed_state::State,
    {
        let bytes = posed_state::snapshot(&self.session);
        self.session = self.fresh.clone();
        posed_state::restore(&mut self.session, &bytes).unwrap();
        assert_eq!(posed_state::snapshot(&self.session), bytes);
    }

    /// As [`Rig::run_ms`], put away and read back every few milliseconds.
    pub(crate) fn run_stored_ms(&mut self, ms: u64)
    where
        S: posed_state::State,
    {
        for _ in 0..ms.div_ceil(3) {
            self.run_ms(3);
            self.store_and_restore();
        }
    }

    pub(crate) fn is_streaming(&self) -> bool {
        *self.session.state() == State::Streaming
    }

    /// The reason of the state, where it has one.
    pub(crate) fn reason(&self) -> String {
        match self.session.state() {
            State::Streaming => String::new(),
            State::Connecting { reason } | State::Silent { reason } | State::Failed { reason } => {
                reason.clone()
            }
        }
    }
}
