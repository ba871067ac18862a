//! One websocket: writes what its outbox holds, reads requests, notices when nobody is there any more.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use axum::extract::ws::{CloseFrame, Message, WebSocket};
use futures_util::SinkExt;
use serde_json::Value;
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval, timeout};

use super::Shared;
use super::distributor::{ClientId, Command};
use super::outbox::{Close, Outbox, Outgoing};
use crate::protocol::{
    Call, Encoding, ErrorReply, Hello, OkReply, ParseError, Request, RequestId, ServerMessage, encode, parse,
};
use crate::stage::Role;

/// Messages written before the socket is flushed.
const BATCH: usize = 32;
/// Time for the closing handshake with one client.
const GOODBYE: Duration = Duration::from_secs(1);

/// Distance of the messages that are read while closing.
const PACE: Duration = Duration::from_millis(5);

/// A client's request that the daemon carries out.
#[derive(Debug)]
pub struct PendingCall {
    /// What to do; the client's role allows it.
    pub call: Call,
    /// Where the answer goes.
    pub reply: Reply,
}

/// Answers one request; dropped without an answer, the client gets an `error`.
#[derive(Debug)]
pub struct Reply {
    outbox: Arc<Outbox>,
    id: Option<RequestId>,
}

impl Reply {
    /// It is done; `result` is what was asked for, if something was.
    pub fn ok(mut self, result: Option<Value>) {
        let id = self.id.take();
        self.send(&ServerMessage::Ok(OkReply { id, result }));
    }

    /// It is not done: a code for programs, a sentence for people.
    pub fn error(mut self, code: &str, message: impl Into<String>) {
        let id = self.id.take();
        self.send(&ServerMessage::Error(ErrorReply { id, code: code.into(), message: message.into() }));
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

/// Why a connection ends.
enum End {
    /// We close it.
    Close(Close),
    /// The other side has closed it, or it broke.
    Gone,
}

/// Serves one client until it ends.
pub(super) async fn serve(
    socket: WebSocket,
    id: ClientId,
    encoding: Encoding,
    role: Role,
    shared: Arc<Shared>,
) {
    let outbox = Arc::new(Outbox::new(encoding, shared.limits.clone()));
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
    let connect = Command::Connect { client: id, outbox: Arc::clone(&outbox) };
    if shared.commands.send(connect).await.is_err() {
        return;
    }
    shared.metrics.clients.inc();
    let budget = Budget::new(shared.limits.messages_per_s, shared.limits.message_burst);
    let mut client = Client { socket, id, role, outbox, budget, shared };
    let end = client.run().await;
    client.shared.metrics.clients.dec();
    let _ = client.shared.commands.send(Command::Disconnect { client: id }).await;
    if let End::Close(close) = end {
        if close != Close::SHUTDOWN {
            client.shared.metrics.refuse("policy");
        }
        client.goodbye(close).await;
    }
}

struct Client {
    socket: WebSocket,
    id: ClientId,
    role: Role,
    outbox: Arc<Outbox>,
    budget: Budget,
    shared: Arc<Shared>,
}

impl Client {
    async fn run(&mut self) -> End {
        let mut pings = interval(self.shared.limits.ping_interval);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut shutdown = self.shared.shutdown.clone();
        let outbox = Arc::clone(&self.outbox);
        let mut heard = now();
        loop {
            let step = tokio::select! {
                biased;
                () = ended(&mut shutdown) => return End::Close(Close::SHUTDOWN),
                incoming = self.socket.recv() => {
                    heard = now();
                    match incoming {
                        Some(Ok(message)) => self.handle(message).await,
                        Some(Err(error)) => Err(end_of(error)),
                        None => Err(End::Gone),
                    }
                }
                () = outbox.filled() => self.write().await,
                _ = pings.tick() => {
                    if heard.elapsed() > self.shared.limits.silence_timeout {
                        Err(End::Close(Close::SILENT))
                    } else {
                        self.send(Message::Ping(Default::default())).await
                    }
                }
            };
            if let Err(end) = step {
                return end;
            }
        }
    }

    /// Writes all that waits, then flushes.
    async fn write(&mut self) -> Result<(), End> {
        loop {
            let mut written = 0;
            while written < BATCH {
                let mut bytes = Vec::new();
                if !self.outbox.pop(&mut bytes).map_err(End::Close)? {
                    break;
                }
                self.shared.metrics.bytes.inc_by(bytes.len() as u64);
                let message = self.message(bytes)?;
                let fed = self.socket.feed(message);
                patiently(&self.shared, fed).await?;
                written += 1;
            }
            if written == 0 {
                return Ok(());
            }
            let flushed = self.socket.flush();
            patiently(&self.shared, flushed).await?;
        }
    }

    async fn send(&mut self, message: Message) -> Result<(), End> {
        let sent = self.socket.send(message);
        patiently(&self.shared, sent).await
    }

    fn message(&self, bytes: Vec<u8>) -> Result<Message, End> {
        match self.outbox.encoding() {
            Encoding::MessagePack => Ok(Message::Binary(bytes.into())),
            Encoding::Json => match String::from_utf8(bytes) {
                Ok(text) => Ok(Message::Text(text.into())),
                // JSON from serde_json is text.
                Err(_) => Err(End::Gone),
            },
        }
    }

    async fn handle(&mut self, message: Message) -> Result<(), End> {
        self.shared.metrics.requests.inc();
        if !self.budget.spend(now()) {
            return Err(End::Close(Close::TOO_MANY));
        }
        let parsed = match &message {
            Message::Text(text) => parse(Encoding::Json, text.as_bytes()),
            Message::Binary(bytes) => parse(Encoding::MessagePack, bytes),
            // Pings are answered by the websocket itself.
            Message::Ping(_) | Message::Pong(_) => return Ok(()),
            Message::Close(_) => {
                // The websocket answers as it is read to its end.
                let rest = async { while let Some(Ok(_)) = self.socket.recv().await {} };
                let _ = timeout(GOODBYE, rest).await;
                return Err(End::Gone);
            }
        };
        match parsed {
            Ok((id, Request::Feed(feed))) => {
                let command = Command::Feed { client: self.id, id, feed };
                self.shared.commands.send(command).await.map_err(|_| End::Close(Close::SHUTDOWN))?;
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

    fn call(&self, id: RequestId, call: Call) {
        let reply = Reply { outbox: Arc::clone(&self.outbox), id: Some(id) };
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

    /// The closing handshake: our reason, then what was still under way from the other side, up to its own close.
    async fn goodbye(&mut self, Close { code, reason }: Close) {
        let frame = CloseFrame { code, reason: reason.into() };
        let closing = async {
            self.socket.send(Message::Close(Some(frame))).await?;
            // At a walking pace: who is sent away for flooding must not be read at full speed once more.
            let mut pace = interval(PACE);
            while let Some(Ok(_)) = self.socket.recv().await {
                pace.tick().await;
            }
            Ok::<_, axum::Error>(())
        };
        let _ = timeout(GOODBYE, closing).await;
    }
}

/// Waits for a write, but not for a client that has stopped reading for ever, and not past the shutdown.
async fn patiently(shared: &Shared, write: impl Future<Output = Result<(), axum::Error>>) -> Result<(), End> {
    let mut shutdown = shared.shutdown.clone();
    tokio::select! {
        biased;
        written = timeout(shared.limits.silence_timeout, write) => match written {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) => Err(End::Gone),
            Err(_) => Err(End::Close(Close::SILENT)),
        },
        () = ended(&mut shutdown) => Err(End::Close(Close::SHUTDOWN)),
    }
}

/// Resolves at shutdown.
async fn ended(shutdown: &mut watch::Receiver<bool>) {
    // A sender that is gone ended as well.
    let _ = shutdown.wait_for(|ends| *ends).await;
}

fn end_of(error: axum::Error) -> End {
    match error.into_inner().downcast::<tungstenite::Error>().map(|error| *error) {
        Ok(tungstenite::Error::Capacity(_)) => End::Close(Close::TOO_LARGE),
        Ok(tungstenite::Error::Utf8(_)) => {
            End::Close(Close { code: 1007, reason: "a text message must be UTF-8" })
        }
        Ok(tungstenite::Error::Protocol(tungstenite::error::ProtocolError::ResetWithoutClosingHandshake)) => {
            End::Gone
        }
        Ok(tungstenite::Error::Protocol(_)) => {
            End::Close(Close { code: 1002, reason: "this is not the websocket protocol" })
        }
        _ => End::Gone,
    }
}

/// Messages that a client may still send: refilled at a steady rate up to a burst.
struct Budget {
    per_s: f64,
    burst: f64,
    left: f64,
    at: Instant,
}

impl Budget {
    fn new(per_s: f64, burst: f64) -> Self {
        Self { per_s, burst, left: burst, at: now() }
    }

    fn spend(&mut self, now: Instant) -> bool {
        let elapsed_s = now.saturating_duration_since(self.at).as_secs_f64();
        self.left = (self.left + elapsed_s * self.per_s).min(self.burst) - 1.0;
        self.at = now;
        self.left >= 0.0
    }
}

#[expect(clippy::disallowed_methods, reason = "rate limit and silence of a connection")]
fn now() -> Instant {
    Instant::now()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_allows_bursts_and_a_rate() {
        let mut budget = Budget::new(10.0, 3.0);
        let start = budget.at;
        assert!((0..3).all(|_| budget.spend(start)));
        assert!(!budget.spend(start));
        let later = start + Duration::from_millis(250);
        assert!(budget.spend(later), "two and a half came back, one was owed");
    }
}
