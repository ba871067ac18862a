//! What clients of our own protocol ask for: feeds go to the distributor, calls to the daemon, everything is answered.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use tokio::sync::mpsc::error::TrySendError;

use super::client::{Dialect, Received};
use super::distributor::{self, ClientId};
use super::outbox::{Close, Outbox, Outgoing};
use super::{Command, Shared};
use posed_protocol::{
    Answer, Call, Encoding, ErrorReply, Hello, OkReply, ParseError, Request, RequestId, ServerMessage,
    encode, parse,
};
use posed_stage::Role;

/// A client's request that the daemon carries out.
#[derive(Debug)]
pub struct PendingCall {
    /// What to do; the client's role allows it, but it may make no sense for this stage.
    pub call: Call,
    /// Where the answer goes.
    pub reply: Reply,
}

/// Why a request is not carried out: a code for programs, a sentence for people.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Refusal {
    code: &'static str,
    message: String,
}

impl Refusal {
    pub(crate) fn new(code: &'static str, reason: impl ToString) -> Self {
        Self { code, message: reason.to_string() }
    }

    /// What was asked for makes no sense here.
    pub(crate) fn bad_request(reason: impl ToString) -> Self {
        Self::new("bad_request", reason)
    }

    /// It was tried.
    pub(crate) fn failed(reason: impl ToString) -> Self {
        Self::new("failed", reason)
    }
}

/// Answers one request; dropped without an answer, the client gets an `error`.
#[derive(Debug)]
pub struct Reply {
    outbox: Arc<Outbox>,
    id: Option<RequestId>,
}

impl Reply {
    /// Answers that it is done; `result` is what was asked for, `None` where there is nothing to tell.
    pub fn ok(mut self, result: Option<Answer>) {
        let id = self.id.take();
        self.send(&ServerMessage::Ok(OkReply { id, result }));
    }

    /// Answers that it is not done: a code for programs, a sentence for people.
    pub fn error(mut self, code: &str, message: impl Into<String>) {
        let id = self.id.take();
        self.send(&ServerMessage::Error(ErrorReply { id, code: code.into(), message: message.into() }));
    }

    /// Answers how it came out.
    pub(crate) fn answer(self, outcome: Result<Option<Answer>, Refusal>) {
        match outcome {
            Ok(result) => self.ok(result),
            Err(refusal) => self.refuse(refusal),
        }
    }

    /// It is not done, for this reason.
    pub(crate) fn refuse(self, Refusal { code, message }: Refusal) {
        self.error(code, message);
    }

    fn send(&self, message: &ServerMessage) {
        self.outbox.push_lossless(Outgoing::Whole(encode::whole(self.outbox.encoding(), message)));
    }
}

impl Drop for Reply {
    fn drop(&mut self) {
        if let Some(id) = self.id.take() {
            let message = "the daemon did not carry this out: it is busy with something else, or ends".into();
            self.send(&ServerMessage::Error(ErrorReply {
                id: Some(id),
                code: "unavailable".into(),
                message,
            }));
        }
    }
}

/// One client's side of it.
pub(super) struct Requests {
    id: ClientId,
    role: Role,
    outbox: Arc<Outbox>,
    shared: Arc<Shared>,
}

impl Requests {
    /// Greets the client and makes it known to the distributor; `None` at shutdown.
    pub(super) async fn begin(encoding: Encoding, role: Role, shared: &Arc<Shared>) -> Option<Self> {
        let id = shared.next_client.fetch_add(1, Ordering::Relaxed);
        let outbox = Arc::new(shared.context.outboxes.open(encoding, shared.context.limits.queue_messages));
        let role = if shared.operable { role } else { Role::Watch };
        let hello = ServerMessage::Hello(Hello {
            version: env!("CARGO_PKG_VERSION").into(),
            stage: shared.greeting.stage.clone(),
            epoch_utc: shared.greeting.epoch_utc.clone(),
            skeleton: shared.greeting.skeleton,
            height_m: shared.greeting.height_m,
            transmitter: shared.greeting.transmitter,
            topics: shared.greeting.topics.clone(),
            sensors: shared.hello_sensors(),
            role,
            last_event_id: shared.last_event_id.load(Ordering::Relaxed),
        });
        outbox.push_lossless(Outgoing::Whole(encode::whole(encoding, &hello)));
        let requests = Self { id, role, outbox: Arc::clone(&outbox), shared: Arc::clone(shared) };
        requests.report(distributor::Command::Connect { client: id, outbox, stage: None }).await.ok()?;
        Some(requests)
    }

    async fn report(&self, command: distributor::Command) -> Result<(), Close> {
        self.shared.commands.send(Command::Client(command)).await.map_err(|_| Close::SHUTDOWN)
    }

    fn call(&self, id: RequestId, call: Call) {
        let reply = Reply { outbox: Arc::clone(&self.outbox), id: Some(id) };
        if !self.shared.operable {
            reply.error("hub", "a hub shows its stages; ask the daemon of the stage itself for this");
            return;
        }
        if call.changes_something() && self.role < Role::Operate {
            reply.error(
                "forbidden",
                "this token may watch; the request needs a token with the role `operate`",
            );
            return;
        }
        match self.shared.calls.try_send(PendingCall { call, reply }) {
            Ok(()) => {}
            Err(TrySendError::Full(PendingCall { reply, .. })) => {
                reply.error("busy", "too many requests are waiting; try again in a moment");
            }
            // Its reply says so as it is dropped.
            Err(TrySendError::Closed(_)) => {}
        }
    }
}

impl Dialect for Requests {
    fn outbox(&self) -> Arc<Outbox> {
        Arc::clone(&self.outbox)
    }

    async fn hear(&mut self, received: Received<'_>) -> Result<(), Close> {
        let parsed = match received {
            Received::Text(text) => parse(Encoding::Json, text.as_bytes()),
            Received::Binary(bytes) => parse(Encoding::MessagePack, bytes),
        };
        match parsed {
            Ok((id, Request::Feed(feed))) => {
                self.report(distributor::Command::Feed { client: self.id, id, feed }).await?;
            }
            Ok((id, Request::Call(call))) => self.call(id, call),
            Err(ParseError { id, code, message }) => {
                let error = ErrorReply { id, code: code.into(), message };
                let bytes = encode::whole(self.outbox.encoding(), &ServerMessage::Error(error));
                self.outbox.push_lossless(Outgoing::Whole(bytes));
            }
        }
        Ok(())
    }

    async fn leave(self) {
        let _ = self.report(distributor::Command::Disconnect { client: self.id }).await;
    }
}
