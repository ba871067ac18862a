//! What clients of our own protocol ask for: feeds go to the distributor, calls to the daemon, everything is answered.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::time::timeout;

use super::client::{Dialect, Received};
use super::distributor::{self, ClientId};
use super::outbox::{Close, Outbox, Outgoing};
use super::{Command, Shared};
use posed_protocol::{
    Answer, Call, Encoding, ErrorReply, Hello, OkReply, ParseError, RefusalReason, Request, RequestId,
    ServerMessage, encode, parse,
};
use posed_stage::{Pose, Role};

/// How long a request waits for a place among those that are handed on.
const A_MOMENT: Duration = Duration::from_millis(100);

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
    /// Which sentence, for who says it in another language.
    reason: Option<RefusalReason>,
    values: BTreeMap<String, String>,
}

impl Refusal {
    pub(crate) fn new(code: &'static str, message: impl ToString) -> Self {
        Self { code, message: message.to_string(), reason: None, values: BTreeMap::new() }
    }

    /// The same, as a sentence that other languages have: this one of them.
    pub(crate) fn because(mut self, reason: RefusalReason) -> Self {
        self.reason = Some(reason);
        self
    }

    /// The same with something that the sentence names.
    pub(crate) fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.values.insert(name.to_owned(), value.to_string());
        self
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
    pub(super) fn new(outbox: Arc<Outbox>, id: RequestId) -> Self {
        Self { outbox, id: Some(id) }
    }

    /// Answers that it is done; `result` is what was asked for, `None` where there is nothing to tell.
    pub fn ok(mut self, result: Option<Answer>) {
        let id = self.id.take();
        self.send(&ServerMessage::Ok(OkReply { id, result }));
    }

    /// Answers that it is not done: a code for programs, a sentence for people.
    pub fn error(mut self, code: &str, message: impl Into<String>) {
        let id = self.id.take();
        self.send(&ServerMessage::Error(ErrorReply::new(id, code, message)));
    }

    /// Answers how it came out.
    pub(crate) fn answer(self, outcome: Result<Option<Answer>, Refusal>) {
        match outcome {
            Ok(result) => self.ok(result),
            Err(refusal) => self.refuse(refusal),
        }
    }

    /// It is not done, for this reason.
    pub(crate) fn refuse(mut self, Refusal { code, message, reason, values }: Refusal) {
        let id = self.id.take();
        self.send(&ServerMessage::Error(ErrorReply { id, code: code.into(), message, reason, values }));
    }

    fn send(&self, message: &ServerMessage) {
        self.outbox.push_lossless(Outgoing::Whole(encode::whole(self.outbox.encoding(), message)));
    }
}

impl Drop for Reply {
    fn drop(&mut self) {
        if let Some(id) = self.id.take() {
            let message = "the daemon did not carry this out: it is busy with something else, or ends";
            self.send(&ServerMessage::Error(ErrorReply::new(Some(id), "unavailable", message)));
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
            skeleton: shared.greeting.bodies.first().map(|body| body.skeleton),
            height_m: shared.greeting.bodies.first().and_then(|body| body.height_m),
            bodies: shared.greeting.bodies.clone(),
            transmitter: shared.greeting.transmitter.unwrap_or(Pose::IDENTITY),
            transmitter_given: shared.greeting.transmitter.is_some(),
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

    async fn call(&self, id: RequestId, call: Call) {
        let reply = Reply::new(Arc::clone(&self.outbox), id);
        if !self.shared.operable {
            let sentence = "a hub shows its stages; ask the daemon of the stage itself for this";
            return reply.refuse(Refusal::new("hub", sentence).because(RefusalReason::Hub));
        }
        if call.changes_something() && self.role < Role::Operate {
            let sentence = "this token may watch; the request needs a token with the role `operate`";
            return reply.refuse(Refusal::new("forbidden", sentence).because(RefusalReason::Watches));
        }
        // In turn, so that who asks without end takes nobody's place.
        match timeout(A_MOMENT, self.shared.calls.reserve()).await {
            Ok(Ok(place)) => place.send(PendingCall { call, reply }),
            Err(_) => {
                let sentence = "too many requests are waiting; try again in a moment";
                reply.refuse(Refusal::new("busy", sentence).because(RefusalReason::RequestsWait));
            }
            // Its reply says so as it is dropped.
            Ok(Err(_)) => {}
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
            Ok((id, Request::Call(call))) => self.call(id, call).await,
            Err(ParseError { id, code, message }) => {
                let error = ErrorReply::new(id, code, message);
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

#[cfg(test)]
mod tests {
    use std::pin::pin;

    use futures_util::FutureExt;
    use tokio::sync::mpsc;

    use super::super::distributor::Distributor;
    use super::super::hub::Item;
    use super::super::testing::{ids, received, services};
    use super::super::{CALLS, COMMANDS, StageServices};
    use super::*;
    use posed_protocol::Counters;
    use posed_stage::Stage;
    use posed_stage::output::Estimate;

    const SUBSCRIBE: &str = r#"{"id": 1, "type": "subscribe", "topics": ["sensors"]}"#;

    fn stage() -> StageServices {
        services(&Stage::parse("name = \"s\"").unwrap())
    }

    async fn operator(shared: &Arc<Shared>) -> Requests {
        Requests::begin(Encoding::Json, Role::Operate, shared).await.unwrap()
    }

    async fn ask(requests: &mut Requests, id: usize) {
        let request = format!(r#"{{"id": {id}, "type": "record.stop"}}"#);
        requests.hear(Received::Text(&request)).await.unwrap();
    }

    /// Carries out what clients have sent so far; how much that was.
    fn distribute(distributor: &mut Distributor, commands: &mut mpsc::Receiver<Command>) -> usize {
        let sent = std::iter::from_fn(|| commands.try_recv().ok());
        sent.map(|command| match command {
            Command::Client(command) => distributor.handle(command),
            Command::Viewer(_) => panic!("nobody views"),
        })
        .count()
    }

    fn distributor(shared: &Shared) -> Distributor {
        let limits = shared.context.limits.clone();
        Distributor::new(Arc::clone(&shared.names), limits, Arc::clone(&shared.metrics), Counters::default())
    }

    fn frame(distributor: &mut Distributor) {
        let item = Item::Estimate(Estimate::default());
        let stamp = distributor.stamp(&item);
        distributor.publish(item, stamp);
    }

    #[tokio::test]
    async fn more_requests_than_may_wait_are_refused_and_those_that_wait_are_carried_out() {
        let StageServices { shared, mut commands, mut calls, .. } = stage();
        let (mut asking, mut other) = (operator(&shared).await, operator(&shared).await);
        for id in 0..CALLS + 10 {
            ask(&mut asking, id).await;
        }
        let refused = received(&asking.outbox).split_off(1);
        assert!(refused.iter().all(|answer| answer["code"] == "busy"), "{refused:?}");
        assert_eq!(ids(&refused), (CALLS..CALLS + 10).collect::<Vec<_>>());
        // Who watches is served all the same.
        let mut distributor = distributor(&shared);
        other.hear(Received::Text(SUBSCRIBE)).await.unwrap();
        distribute(&mut distributor, &mut commands);
        frame(&mut distributor);
        let received_meanwhile = received(&other.outbox);
        assert_eq!(
            (&received_meanwhile[1]["type"], &received_meanwhile[2]["type"]),
            (&"ok".into(), &"sensors".into())
        );
        // All that wait are answered, in their order, and then there is room for everybody.
        while let Ok(PendingCall { reply, .. }) = calls.try_recv() {
            reply.ok(None);
        }
        let answered = received(&asking.outbox);
        assert!(answered.iter().all(|answer| answer["type"] == "ok"), "{answered:?}");
        assert_eq!(ids(&answered), (0..CALLS).collect::<Vec<_>>());
        ask(&mut other, 7).await;
        assert!(calls.try_recv().is_ok());
    }

    #[tokio::test]
    async fn who_asks_while_another_has_taken_all_places_waits_a_moment_and_is_heard() {
        let StageServices { shared, commands: _commands, mut calls, .. } = stage();
        let (mut asking, mut other) = (operator(&shared).await, operator(&shared).await);
        for id in 0..CALLS {
            ask(&mut asking, id).await;
        }
        let outbox = Arc::clone(&other.outbox);
        let mut one_more = pin!(ask(&mut other, 7));
        assert!(one_more.as_mut().now_or_never().is_none());
        calls.try_recv().unwrap().reply.ok(None);
        one_more.await;
        while let Ok(PendingCall { reply, .. }) = calls.try_recv() {
            reply.ok(None);
        }
        let answered = received(&outbox).split_off(1);
        assert_eq!((answered[0]["type"].as_str(), ids(&answered)), (Some("ok"), vec![7]));
    }

    #[tokio::test]
    async fn who_tells_more_than_the_distributor_has_room_for_waits_and_nothing_told_is_lost() {
        let StageServices { shared, mut commands, mut calls, .. } = stage();
        let (mut eager, mut other) = (operator(&shared).await, operator(&shared).await);
        let outbox = Arc::clone(&eager.outbox);
        // Both have said that they are there.
        for _ in 2..COMMANDS {
            eager.hear(Received::Text(SUBSCRIBE)).await.unwrap();
        }
        assert_eq!(shared.commands.capacity(), 0);
        let mut one_more = pin!(eager.hear(Received::Text(SUBSCRIBE)));
        assert!(one_more.as_mut().now_or_never().is_none());
        // What another one asks of the daemon goes out past it.
        ask(&mut other, 7).await;
        assert!(calls.try_recv().is_ok());
        let mut distributor = distributor(&shared);
        assert_eq!(distribute(&mut distributor, &mut commands), COMMANDS);
        one_more.await.unwrap();
        other.hear(Received::Text(SUBSCRIBE)).await.unwrap();
        assert_eq!(distribute(&mut distributor, &mut commands), 2);
        frame(&mut distributor);
        // A greeting, the answers, the frame.
        assert_eq!(received(&outbox).len(), 1 + (COMMANDS - 2) + 1 + 1);
        let types: Vec<_> =
            received(&other.outbox).into_iter().map(|message| message["type"].clone()).collect();
        assert_eq!(types, ["hello", "error", "ok", "sensors"]);
    }
}
