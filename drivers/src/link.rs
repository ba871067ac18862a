//! The life of a line from "the port is open" to a stream and back, for devices that are prepared, asked once, and then send.
//!
//! What comes in: line events, answers, records, the time. What goes out: what is due. It knows no bytes: the session sends what
//! [`Due`] names, and calls [`Link::started`] when the answer it waits for has come.
//!
//! `Closed -> Preparing (step by step) -> Asking (-> a reset) -> Streaming`; silence leads back to the first step.

use std::time::Duration;

use posed_state::Plain;

use crate::sample::Timestamp;

/// How long each part may take, by kind of device.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Pieces that are sent before the question, one at least.
    pub steps: u8,
    /// Pause behind each of them.
    pub step: Duration,
    /// For the answer to the question.
    pub answer: Duration,
    /// Unanswered questions after which the unit is reset.
    pub questions: u8,
    /// What a reset takes. The unit is not reset again before, but asked meanwhile: one that was off has not heard the reset, and answers
    /// as soon as it has power.
    pub reset: Duration,
    /// Silence of a stream that has just been started.
    pub start: Duration,
    /// Silence of a stream that goes on.
    pub silence: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq, Plain)]
enum Phase {
    Closed,
    Preparing { step: u8, until: Timestamp },
    Asking { until: Timestamp },
    Streaming { silent_at: Timestamp },
}

/// What is to be done now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Due {
    Nothing,
    /// Send this piece of the preparation, from 0.
    Prepare(u8),
    /// Ask.
    Ask,
    /// The unit does not answer: reset it, then send the first piece.
    Reset,
    /// The stream has ended: send the first piece.
    Silent,
}

/// See the module.
#[derive(Clone, Copy, Debug, Plain)]
pub(crate) struct Link {
    phase: Phase,
    /// Questions since an answer, the opening of the line or a reset.
    questions: u8,
    /// Until then a reset unit starts.
    resets_until: Timestamp,
}

impl Link {
    /// Of a line that is not open.
    pub(crate) fn new() -> Self {
        Self { phase: Phase::Closed, questions: 0, resets_until: Timestamp::ZERO }
    }

    /// The line has opened: send the first piece.
    pub(crate) fn open(&mut self, now: Timestamp, timing: &Timing) {
        self.questions = 0;
        self.begin(now, timing);
    }

    pub(crate) fn close(&mut self) {
        self.phase = Phase::Closed;
    }

    pub(crate) fn is_asking(&self) -> bool {
        matches!(self.phase, Phase::Asking { .. })
    }

    pub(crate) fn is_streaming(&self) -> bool {
        matches!(self.phase, Phase::Streaming { .. })
    }

    /// The question was answered, and the stream is to begin.
    pub(crate) fn started(&mut self, now: Timestamp, timing: &Timing) {
        self.questions = 0;
        self.phase = Phase::Streaming { silent_at: now + timing.start };
    }

    /// A record has come.
    pub(crate) fn heard(&mut self, now: Timestamp, timing: &Timing) {
        if self.is_streaming() {
            self.phase = Phase::Streaming { silent_at: now + timing.silence };
        }
    }

    pub(crate) fn poll_timeout(&self) -> Option<Timestamp> {
        match self.phase {
            Phase::Closed => None,
            Phase::Preparing { until, .. } | Phase::Asking { until } => Some(until),
            Phase::Streaming { silent_at } => Some(silent_at),
        }
    }

    pub(crate) fn handle_timeout(&mut self, now: Timestamp, timing: &Timing) -> Due {
        if self.poll_timeout().is_none_or(|at| now < at) {
            return Due::Nothing;
        }
        match self.phase {
            Phase::Closed => Due::Nothing,
            Phase::Preparing { step, .. } if step + 1 < timing.steps => {
                self.phase = Phase::Preparing { step: step + 1, until: now + timing.step };
                Due::Prepare(step + 1)
            }
            Phase::Preparing { .. } => {
                self.questions = self.questions.saturating_add(1);
                self.phase = Phase::Asking { until: now + timing.answer };
                Due::Ask
            }
            Phase::Asking { .. } if self.questions < timing.questions || now < self.resets_until => {
                self.begin(now, timing);
                Due::Prepare(0)
            }
            Phase::Asking { .. } => {
                self.questions = 0;
                self.resets_until = now + timing.reset;
                self.begin(now, timing);
                Due::Reset
            }
            Phase::Streaming { .. } => {
                self.begin(now, timing);
                Due::Silent
            }
        }
    }

    fn begin(&mut self, now: Timestamp, timing: &Timing) {
        self.phase = Phase::Preparing { step: 0, until: now + timing.step };
    }
}
