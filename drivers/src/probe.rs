//! Asks an open port whether a device of one kind is there, and what it is.
//!
//! The same contract as a session, without samples: feed an [`Inquiry`] inputs, drain [`Inquiry::poll_transmit`], wait
//! for [`Inquiry::poll_timeout`], until [`Inquiry::result`] is there. What is asked changes no setting; a device that
//! streams may have to be stopped for it. A Flock of Birds has a probe of its own ([`crate::flock::Probe`]).

use std::fmt;
use std::time::Duration;

use crate::sample::Timestamp;
use crate::session::SensorInfo;

/// What a device reports about itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Identity {
    /// Model as the device writes it, or the family where only that is known; `None`: it does not report one.
    pub model: Option<String>,
    /// Software revision as text; `None` where it is not reported.
    pub revision: Option<String>,
    /// Measurement rate as it is set, Hz; `None`: not asked, or not reported.
    pub rate_hz: Option<f64>,
    /// Its sensors, by rising address; empty where it has none, which is a [`Identity::problem`].
    pub sensors: Vec<SensorInfo>,
    /// What is wrong with it, in one sentence, and what to do about it; `None`: nothing.
    pub problem: Option<(String, String)>,
}

/// Why there is no [`Identity`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoAnswer {
    /// Not a byte came.
    Silent,
    /// Bytes came, but no answer of such a device: another device, another line rate, or a stream that did not stop.
    Unintelligible,
}

/// One question, and how long its answer may take.
#[derive(Clone, Debug)]
pub(crate) struct Question {
    pub(crate) bytes: Vec<u8>,
    pub(crate) wait: Duration,
}

impl Question {
    pub(crate) fn new(bytes: impl Into<Vec<u8>>, wait_ms: u64) -> Self {
        Self { bytes: bytes.into(), wait: Duration::from_millis(wait_ms) }
    }
}

/// Understands the answers of one kind of device.
pub(crate) trait Listener: fmt::Debug + Send {
    /// Bytes that came.
    fn listen(&mut self, bytes: &[u8]);
    /// Whether question `k` needs no more time.
    fn has_answer(&self, k: usize) -> bool;
    /// Whether it is worth asking on after question `k`.
    fn goes_on(&self, k: usize) -> bool;
    /// What the device is; none if it has not answered.
    fn identity(&self) -> Option<Identity>;
}

/// One inquiry at one port: some questions in a row, each with a time limit.
///
/// What it finds is the device's own word. Of the protocols only Xbus has a checksum (of one byte); elsewhere the form of the
/// answer must do, so another device that answers in the same form is taken for this one.
#[derive(Debug)]
pub struct Inquiry {
    questions: Vec<Question>,
    listener: Box<dyn Listener>,
    at: usize,
    until: Timestamp,
    transmit: Option<Vec<u8>>,
    received: bool,
    result: Option<Result<Identity, NoAnswer>>,
}

impl Inquiry {
    /// Begins; `now` is the time at which the port has been opened.
    pub(crate) fn new(now: Timestamp, questions: Vec<Question>, listener: Box<dyn Listener>) -> Self {
        let mut inquiry =
            Self { questions, listener, at: 0, until: now, transmit: None, received: false, result: None };
        inquiry.ask(now);
        inquiry
    }

    /// Bytes were read at `now`, cut anywhere. Without effect once there is a result.
    pub fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.received |= !bytes.is_empty();
        self.listener.listen(bytes);
        if self.result.is_none() && self.listener.has_answer(self.at) {
            self.next(now);
        }
    }

    /// The time of [`Self::poll_timeout`] has come. A call before that time does nothing.
    pub fn handle_timeout(&mut self, now: Timestamp) {
        if self.poll_timeout().is_some_and(|at| at <= now) {
            self.next(now);
        }
    }

    /// Bytes to send, until `None`. Poll after every input: a question that is not fetched is replaced by the next.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        self.transmit.take()
    }

    /// When to call [`Self::handle_timeout`]; `None` when done.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        self.result.is_none().then_some(self.until)
    }

    /// What was found; `None` while questions are open. An `Err` in it states that no device of this kind answered.
    pub fn result(&self) -> Option<&Result<Identity, NoAnswer>> {
        self.result.as_ref()
    }

    fn next(&mut self, now: Timestamp) {
        let ends = self.at + 1 == self.questions.len() || !self.listener.goes_on(self.at);
        if ends {
            let why = if self.received { NoAnswer::Unintelligible } else { NoAnswer::Silent };
            self.result = Some(self.listener.identity().ok_or(why));
        } else {
            self.at += 1;
            self.ask(now);
        }
    }

    fn ask(&mut self, now: Timestamp) {
        let question = &self.questions[self.at];
        self.transmit = Some(question.bytes.clone());
        self.until = now + question.wait;
    }
}
