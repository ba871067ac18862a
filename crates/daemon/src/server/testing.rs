//! What unit tests need of a server: all of it but the sockets.

use std::sync::Arc;

use serde_json::Value;
use tokio::sync::watch;

use super::access::Access;
use super::listen::{ConnectionContext, MakesWay};
use super::metrics::Metrics;
use super::outbox::{Outbox, Outboxes};
use super::requests::Reply;
use super::slots::Slots;
use super::{StageInfo, StageServices, topics_of};
use posed_protocol::{Encoding, RequestId};
use posed_stage::{Limits, Stage};

/// What every connection needs.
pub(super) fn context(limits: &Limits) -> Arc<ConnectionContext> {
    let access = Access {
        tokens: Vec::new(),
        allowed_origins: Vec::new(),
        listen_host: "localhost".to_owned(),
        port: 0,
        tls: false,
    };
    Arc::new(ConnectionContext {
        access,
        limits: limits.clone(),
        metrics: Arc::new(Metrics::new()),
        slots: Slots::new(limits),
        outboxes: Outboxes::new(limits),
        shutdown: watch::channel(false).1,
        makes_way: MakesWay::default(),
    })
}

/// A stage's side of it, whose queues the test empties.
pub(super) fn services(stage: &Stage) -> StageServices {
    let about = StageInfo {
        epoch_utc_ns: 0,
        topics: topics_of(stage, &[]),
        last_event_id: 0,
        replay: false,
        operable: true,
        problems: Vec::new(),
    };
    let context = context(&Limits::default());
    StageServices::new(stage, about, &context, Arc::clone(&context.metrics))
}

/// Takes all that waits for a client of our own protocol.
pub(super) fn received(outbox: &Outbox) -> Vec<Value> {
    let mut out = Vec::new();
    let mut all = Vec::new();
    while let Ok(Some(_)) = outbox.pop(&mut out) {
        all.push(serde_json::from_slice(&out).unwrap());
        out.clear();
    }
    all
}

/// Who asks the daemon for something, and what it is answered.
pub(crate) struct Asking {
    outbox: Arc<Outbox>,
}

impl Asking {
    pub(crate) fn new() -> Self {
        let outboxes = Outboxes::new(&Limits::default());
        Self { outbox: Arc::new(outboxes.open(Encoding::Json, 16)) }
    }

    /// Where the answer to a request of this number goes.
    pub(crate) fn reply(&self, id: usize) -> Reply {
        Reply::new(Arc::clone(&self.outbox), RequestId::Number(id as i64))
    }

    /// The answers that nobody has looked at.
    pub(crate) fn answers(&self) -> Vec<Value> {
        received(&self.outbox)
    }
}

/// The numbers of the requests that these answer.
pub(crate) fn ids(answers: &[Value]) -> Vec<usize> {
    answers.iter().filter_map(|answer| answer["id"].as_u64()).map(|id| id as usize).collect()
}
