//! One question at a time, with a time limit and tries.
//!
//! Answers carry no header, so only their place in time and their length say what they are: never
//! are two questions open, and bytes that come without a question belong to none.

use std::time::Duration;

use posed_state::Plain;

use super::wire::{Addressing, Command};
use crate::sample::Timestamp;

/// A question to the unit on the line.
#[derive(Clone, Debug, Plain)]
pub(super) struct Asker {
    question: Vec<u8>,
    answer_len: usize,
    timeout: Duration,
    tries_left: u8,
    deadline: Timestamp,
    answer: Vec<u8>,
    /// Late bytes of a failed try are let pass before the next one.
    pausing: bool,
}

/// What a time-out asks for.
#[derive(Debug, PartialEq)]
pub(super) enum Expired {
    /// Nothing yet.
    No,
    /// Send these bytes again.
    Again(Vec<u8>),
    /// No answer came; all tries are used up.
    GaveUp,
}

/// Pause before a question is repeated: late bytes of the failed try must not count as its answer.
const PAUSE: Duration = Duration::from_millis(60);

impl Asker {
    /// Opens a question; send [`Self::question`] now.
    pub(super) fn new(
        now: Timestamp,
        command: &Command,
        to: Option<u8>,
        addressing: Addressing,
        tries: u8,
    ) -> Self {
        let answer_len = command.answer_len(addressing);
        // Long answers are slow ones: the flock system status takes 50 ms, all others 16 ms or less.
        let timeout = Duration::from_millis(if answer_len > 10 { 800 } else { 250 });
        Self {
            question: command.to_bytes(to, addressing),
            answer_len,
            timeout,
            tries_left: tries.saturating_sub(1),
            deadline: now + timeout,
            answer: Vec::with_capacity(answer_len),
            pausing: false,
        }
    }

    /// The bytes to send.
    pub(super) fn question(&self) -> Vec<u8> {
        self.question.clone()
    }

    /// When to call [`Self::handle_timeout`].
    pub(super) fn poll_timeout(&self) -> Timestamp {
        self.deadline
    }

    /// Takes bytes; returns the answer once it is whole, and how many bytes were not part of it.
    pub(super) fn handle_bytes(&mut self, bytes: &[u8]) -> (Option<Vec<u8>>, u64) {
        if self.pausing {
            return (None, bytes.len() as u64);
        }
        let take = (self.answer_len - self.answer.len()).min(bytes.len());
        self.answer.extend_from_slice(&bytes[..take]);
        let whole = self.answer.len() == self.answer_len;
        (whole.then(|| std::mem::take(&mut self.answer)), (bytes.len() - take) as u64)
    }

    /// The time limit may have passed; also states how many bytes of a broken answer are given up.
    pub(super) fn handle_timeout(&mut self, now: Timestamp) -> (Expired, u64) {
        if now < self.deadline {
            return (Expired::No, 0);
        }
        if self.pausing {
            self.pausing = false;
            self.deadline = now + self.timeout;
            return (Expired::Again(self.question()), 0);
        }
        let lost = self.answer.len() as u64;
        self.answer.clear();
        if self.tries_left == 0 {
            return (Expired::GaveUp, lost);
        }
        self.tries_left -= 1;
        self.pausing = true;
        self.deadline = now + PAUSE;
        (Expired::No, lost)
    }
}
