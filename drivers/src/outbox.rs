//! What every session keeps: its state, its counts, and the outputs that nobody has polled yet.

use std::collections::VecDeque;

use posed_state::Plain;

use crate::sample::{Sample, Timestamp};
use crate::session::{Counters, Output, State};

/// A warning is repeated at most this often, in seconds; in between it is only counted by its effects.
const REPEAT_S: f64 = 10.0;
/// Kinds of warning that are remembered for throttling.
const REMEMBERED: usize = 16;

/// State, counters and outputs of a session.
#[derive(Clone, Debug, Plain)]
pub(crate) struct Outbox {
    #[state(skip)]
    queue: VecDeque<Output>,
    state: State,
    pub(crate) counters: Counters,
    warned: VecDeque<(u32, Timestamp)>,
}

impl Outbox {
    pub(crate) fn new() -> Self {
        Self {
            queue: VecDeque::new(),
            state: State::Connecting { reason: "the port is not open yet".into() },
            counters: Counters::default(),
            warned: VecDeque::new(),
        }
    }

    pub(crate) fn poll(&mut self) -> Option<Output> {
        self.queue.pop_front()
    }

    pub(crate) fn state(&self) -> &State {
        &self.state
    }

    /// Changes the state and says so, if it is another one.
    pub(crate) fn set_state(&mut self, state: State) {
        if self.state != state {
            self.state = state;
            self.queue.push_back(Output::StateChanged);
        }
    }

    pub(crate) fn connecting(&mut self, reason: impl Into<String>) {
        self.set_state(State::Connecting { reason: reason.into() });
    }

    pub(crate) fn silent(&mut self, reason: impl Into<String>) {
        self.set_state(State::Silent { reason: reason.into() });
    }

    pub(crate) fn failed(&mut self, reason: impl Into<String>) {
        self.set_state(State::Failed { reason: reason.into() });
    }

    pub(crate) fn streaming(&mut self) {
        if self.state != State::Streaming {
            self.set_state(State::Streaming);
        }
    }

    pub(crate) fn transmit(&mut self, bytes: Vec<u8>) {
        self.queue.push_back(Output::Transmit(bytes));
    }

    pub(crate) fn set_rts(&mut self, on: bool) {
        self.queue.push_back(Output::SetRts(on));
    }

    pub(crate) fn sample(&mut self, sample: Sample) {
        self.queue.push_back(Output::Sample(sample));
    }

    pub(crate) fn heading_reset(&mut self, address: u16) {
        self.queue.push_back(Output::HeadingReset { address });
    }

    pub(crate) fn pressed(&mut self, address: u16) {
        self.queue.push_back(Output::Pressed { address });
    }

    /// Warns, unless a warning of the same `kind` went out within the last ten seconds.
    pub(crate) fn warn(&mut self, now: Timestamp, kind: u32, sentence: impl FnOnce() -> String) {
        if let Some((_, last)) = self.warned.iter_mut().find(|(known, _)| *known == kind) {
            if now.seconds_since(*last) < REPEAT_S {
                return;
            }
            *last = now;
        } else {
            if self.warned.len() == REMEMBERED {
                self.warned.pop_front();
            }
            self.warned.push_back((kind, now));
        }
        self.queue.push_back(Output::Warning(sentence()));
    }
}
