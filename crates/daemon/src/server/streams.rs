//! What is reported to Lab Streaming Layer, and what to the operator where that does not work.
//!
//! In: items from the distributor's task with their stamps. Out: samples for the thread that calls liblsl. Never: a wait.

use std::sync::Arc;

use super::hub::Item;
use super::metrics::Metrics;
use crate::clock::StageClock;
use crate::lsl::{Lsl, LslError};
use posed_protocol::lsl::Streams;
use posed_protocol::{Encoding, Names, Payload, Problem, Stamp, View, encode};
use posed_stage::Stage;

/// The streams of a stage, or why there are none.
pub(super) struct Streaming {
    streams: Streams,
    lsl: Result<Lsl, LslError>,
    metrics: Arc<Metrics>,
}

impl Streaming {
    /// Offers them. The stage runs without them too.
    pub(super) fn start(
        stage: &Stage,
        settings: &posed_stage::Lsl,
        clock: StageClock,
        metrics: Arc<Metrics>,
    ) -> Self {
        let streams = Streams::new(stage);
        let lsl = Lsl::start(settings, streams.list(), clock);
        if let Err(error) = &lsl {
            tracing::warn!("{error}");
        }
        Self { streams, lsl, metrics }
    }

    /// What the operator should know.
    pub(super) fn problem(&self) -> Option<Problem> {
        let broken = "what feeds the streams of LSL had a fault of its own, and they have ended: restart posed, and please report this";
        let message = match &self.lsl {
            Ok(lsl) if lsl.is_broken() => broken.to_owned(),
            Ok(_) => return None,
            Err(error) => error.to_string(),
        };
        Some(Problem::new("lsl", message))
    }

    /// Tells an item, if it is something to them.
    pub(super) fn publish(&self, item: &Item, stamp: &Stamp, names: &Names) {
        let Ok(lsl) = &self.lsl else { return };
        let sample = match item {
            Item::Estimate(estimate) => self.streams.frame(estimate),
            Item::Body(body) => self.streams.body(body),
            Item::Outcome(outcome) => {
                let (mut body, mut message) = (Vec::new(), Vec::new());
                let view = View::all(Encoding::Json);
                encode::body(&Payload::Outcome(outcome), stamp, names, &view, &mut body);
                let head = encode::Head { stage: None, topic: stamp.topic, seq: 0, dropped: 0 };
                encode::message(Encoding::Json, head, &body, &mut message);
                String::from_utf8(message).ok().map(|json| self.streams.event(stamp, json))
            }
            Item::Truth(_)
            | Item::Status(_)
            | Item::Jobs(_)
            | Item::Sessions(_)
            | Item::Timecode(_)
            | Item::Rewind => None,
        };
        if let Some(sample) = sample
            && !lsl.report(sample)
        {
            self.metrics.lsl_lost.inc();
        }
    }
}
