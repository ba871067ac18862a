//! One websocket: writes what its outbox holds, hands on what it reads, notices when nobody is there any more. What is said
//! is a [`Dialect`]'s.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket};
use futures_util::SinkExt;
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval, timeout};

use super::budget::{Budget, now};
use super::listen::{ConnectionContext, seconds};
use super::outbox::{Close, Form, Outbox};
use super::slots::Slot;

/// Messages written before the socket is flushed.
const BATCH: usize = 32;
/// Time for the closing handshake with one client.
const GOODBYE: Duration = Duration::from_secs(1);

/// Distance of the messages that are read while closing.
const PACE: Duration = Duration::from_millis(5);

/// Why a connection ends.
pub(super) enum End {
    /// We close it.
    Close(Close),
    /// The other side has closed it, or it broke.
    Gone,
}

/// What a client has said.
#[derive(Clone, Copy, Debug)]
pub(super) enum Received<'a> {
    Text(&'a str),
    Binary(&'a [u8]),
}

/// What is spoken on a websocket; chosen by the sub-protocol.
pub(super) trait Dialect: Send {
    /// What is to be written to the client.
    fn outbox(&self) -> Arc<Outbox>;
    /// Takes a message of the client; answers go to the outbox. An error ends the connection.
    fn hear(&mut self, received: Received<'_>) -> impl Future<Output = Result<(), Close>> + Send;
    /// The connection has ended.
    fn leave(self) -> impl Future<Output = ()> + Send;
}

/// Serves one client until it ends.
pub(super) async fn serve(
    socket: WebSocket,
    dialect: impl Dialect,
    burst: f64,
    context: Arc<ConnectionContext>,
    slot: Option<Arc<Slot>>,
) {
    context.metrics.clients.inc();
    let messages = Budget::new(context.limits.messages_per_s, burst);
    let mut client = Client { socket, outbox: dialect.outbox(), dialect, messages, context, slot };
    let end = client.run().await;
    let Client { mut socket, dialect, context, slot, .. } = client;
    context.metrics.clients.dec();
    dialect.leave().await;
    if let End::Close(close) = end {
        if ![Close::SHUTDOWN, Close::RESTART].contains(&close) {
            context.metrics.refuse("policy");
        }
        if close.is_breach()
            && let Some(slot) = &slot
        {
            slot.breach();
        }
        goodbye(&mut socket, close).await;
    }
}

struct Client<D> {
    socket: WebSocket,
    outbox: Arc<Outbox>,
    dialect: D,
    messages: Budget,
    context: Arc<ConnectionContext>,
    slot: Option<Arc<Slot>>,
}

impl<D: Dialect> Client<D> {
    async fn run(&mut self) -> End {
        let mut pings = interval(seconds(self.context.limits.ping_interval_s));
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut shutdown = self.context.shutdown.clone();
        let outbox = Arc::clone(&self.outbox);
        let mut received = now();
        loop {
            let step = tokio::select! {
                biased;
                () = ended(&mut shutdown) => return End::Close(self.context.makes_way.goodbye()),
                incoming = self.socket.recv() => {
                    received = now();
                    match incoming {
                        Some(Ok(message)) => self.handle(message).await,
                        Some(Err(error)) => Err(end_of(error)),
                        None => Err(End::Gone),
                    }
                }
                () = outbox.filled() => self.write().await,
                _ = pings.tick() => {
                    if received.elapsed() > seconds(self.context.limits.silence_timeout_s) {
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
                let Some(form) = self.outbox.pop(&mut bytes).map_err(End::Close)? else { break };
                self.context.metrics.bytes.inc_by(bytes.len() as u64);
                let message = message(form, bytes)?;
                let fed = self.socket.feed(message);
                patiently(&self.context, fed).await?;
                written += 1;
            }
            if written == 0 {
                return Ok(());
            }
            let flushed = self.socket.flush();
            patiently(&self.context, flushed).await?;
        }
    }

    async fn send(&mut self, message: Message) -> Result<(), End> {
        let sent = self.socket.send(message);
        patiently(&self.context, sent).await
    }

    async fn handle(&mut self, message: Message) -> Result<(), End> {
        self.context.metrics.requests.inc();
        if !self.messages.spend(1.0, now()) || self.slot.as_ref().is_some_and(|slot| !slot.may_speak()) {
            return Err(End::Close(Close::TOO_MANY));
        }
        let received = match &message {
            Message::Text(text) => Received::Text(text.as_str()),
            Message::Binary(bytes) => Received::Binary(bytes),
            // Pings are answered by the websocket itself.
            Message::Ping(_) | Message::Pong(_) => return Ok(()),
            Message::Close(_) => {
                // The websocket answers as it is read to its end.
                let rest = async { while let Some(Ok(_)) = self.socket.recv().await {} };
                let _ = timeout(GOODBYE, rest).await;
                return Err(End::Gone);
            }
        };
        self.dialect.hear(received).await.map_err(End::Close)
    }
}

fn message(form: Form, bytes: Vec<u8>) -> Result<Message, End> {
    match form {
        Form::Binary => Ok(Message::Binary(bytes.into())),
        Form::Text => match String::from_utf8(bytes) {
            Ok(text) => Ok(Message::Text(text.into())),
            // JSON from serde_json is text.
            Err(_) => Err(End::Gone),
        },
    }
}

/// The closing handshake: our reason, then what was still under way from the other side, up to its own close.
pub(super) async fn goodbye(socket: &mut WebSocket, Close { code, reason }: Close) {
    let frame = CloseFrame { code, reason: reason.into() };
    let closing = async {
        socket.send(Message::Close(Some(frame))).await?;
        // At a walking pace: who is sent away for flooding must not be read at full speed once more.
        let mut pace = interval(PACE);
        while let Some(Ok(_)) = socket.recv().await {
            pace.tick().await;
        }
        Ok::<_, axum::Error>(())
    };
    let _ = timeout(GOODBYE, closing).await;
}

/// Waits for a write, but not for a client that has stopped reading for ever, and not past the shutdown.
pub(super) async fn patiently(
    context: &ConnectionContext,
    write: impl Future<Output = Result<(), axum::Error>>,
) -> Result<(), End> {
    let mut shutdown = context.shutdown.clone();
    tokio::select! {
        biased;
        written = timeout(seconds(context.limits.silence_timeout_s), write) => match written {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) => Err(End::Gone),
            Err(_) => Err(End::Close(Close::SILENT)),
        },
        () = ended(&mut shutdown) => Err(End::Close(context.makes_way.goodbye())),
    }
}

/// Resolves at shutdown.
async fn ended(shutdown: &mut watch::Receiver<bool>) {
    // A sender that is gone ended as well.
    let _ = shutdown.wait_for(|ends| *ends).await;
}

pub(super) fn end_of(error: axum::Error) -> End {
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
