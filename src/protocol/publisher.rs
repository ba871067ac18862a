//! From the pipeline's outputs to the messages of every topic at the full rate: for recordings and for replay.
//!
//! Deterministic and without a clock: the same outputs give the same bytes. All its state is [`Counters`]; a recording
//! begun mid-run stores them beside the pipeline's snapshot.

use posed_drivers::Timestamp;
use serde::{Deserialize, Serialize};

use super::{Encoding, Fields, Names, Payload, Topic, View, encode, round};
use crate::stage::Stage;

/// When and as which event a payload is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Where.
    pub topic: Topic,
    /// Time of the message in microseconds since the stage's epoch; rises strictly within the topic.
    pub t_us: i64,
    /// Stage-wide number, for events.
    pub event_id: Option<u64>,
}

impl Stamp {
    /// Time of the message, s.
    pub fn t_s(&self) -> f64 {
        round::seconds(self.t_us)
    }

    /// Time of the message.
    pub fn t(&self) -> Timestamp {
        Timestamp::from_nanos(self.t_us.saturating_mul(1000))
    }
}

/// Numbers given out so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    events: u64,
    last_t_us: [Option<i64>; Topic::COUNT],
}

impl Counters {
    /// Stamps a payload: the next event number, and its time, moved up to keep it rising.
    pub fn stamp(&mut self, payload: &Payload<'_>) -> Stamp {
        let topic = payload.topic();
        let t_us = match payload {
            Payload::Estimate(estimate) => microseconds(estimate.t_valid),
            Payload::Truth(truth) => microseconds(truth.t_valid),
            Payload::Outcome(outcome) => microseconds(outcome.t_decided),
            Payload::Status(status) => microseconds(Timestamp::from_secs_f64(status.t_s)),
            Payload::Jobs(jobs) => microseconds(Timestamp::from_secs_f64(jobs.t_s)),
        };
        let last = &mut self.last_t_us[topic.index()];
        let t_us = last.map_or(t_us, |last| t_us.max(last + 1));
        *last = Some(t_us);
        let event_id = topic.is_event().then(|| {
            self.events += 1;
            self.events
        });
        Stamp { topic, t_us, event_id }
    }

    /// Lets the times of all topics start anew; event numbers go on.
    pub fn rewind(&mut self) {
        self.last_t_us = [None; Topic::COUNT];
    }

    /// Number of the newest event, 0 before the first.
    pub fn last_event_id(&self) -> u64 {
        self.events
    }
}

/// To the nearest microsecond.
pub(super) fn microseconds(t: Timestamp) -> i64 {
    (t.as_nanos().saturating_add(500)).div_euclid(1000)
}

/// Writes the JSON messages of all topics as a client would get them who misses nothing.
#[derive(Clone, Debug)]
pub struct Publisher {
    names: Names,
    view: View,
    counters: Counters,
    seq: [u64; Topic::COUNT],
    body: Vec<u8>,
    message: Vec<u8>,
}

/// State of a [`Publisher`] between two outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PublisherState {
    counters: Counters,
    seq: [u64; Topic::COUNT],
}

impl Publisher {
    /// Starts counting; `fields` are those of `sensors` and `truth`.
    pub fn new(stage: &Stage, fields: Fields) -> Self {
        Self {
            names: Names::new(stage),
            view: View { fields, ..View::all(Encoding::Json) },
            counters: Counters::default(),
            seq: [0; Topic::COUNT],
            body: Vec::new(),
            message: Vec::new(),
        }
    }

    /// What to store in order to go on from here.
    pub fn state(&self) -> PublisherState {
        PublisherState { counters: self.counters, seq: self.seq }
    }

    /// Goes on from a stored state.
    pub fn restore(&mut self, state: PublisherState) {
        self.counters = state.counters;
        self.seq = state.seq;
    }

    /// Counts a payload without writing it: while nothing records.
    pub fn skip(&mut self, payload: &Payload<'_>) {
        let stamp = self.counters.stamp(payload);
        self.seq[stamp.topic.index()] += 1;
    }

    /// Writes the message of a payload; the bytes stay valid until the next call.
    pub fn publish(&mut self, payload: &Payload<'_>) -> (Topic, Timestamp, &[u8]) {
        let stamp = self.counters.stamp(payload);
        let seq = &mut self.seq[stamp.topic.index()];
        self.body.clear();
        self.message.clear();
        encode::body(payload, &stamp, &self.names, &self.view, &mut self.body);
        encode::message(self.view.encoding, stamp.topic, *seq, 0, &self.body, &mut self.message);
        *seq += 1;
        (stamp.topic, stamp.t(), &self.message)
    }
}
