//! One websocket of a phone: text both ways, limits, and once a second what the stage thinks of it.

use std::sync::Arc;

use axum::extract::ws::{Message, WebSocket};
use posed_protocol::Status;
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval};

use super::super::budget::{Budget, now};
use super::super::client::{End, end_of, goodbye, patiently};
use super::super::listen::{ConnectionContext, seconds};
use super::super::outbox::Close;
use super::super::slots::Slot;
use super::gate::{Entered, ToPeer};
use super::placing::Placing;
use crate::ports::ended;

/// Bytes of a message.
pub(super) const MESSAGE_BYTES: usize = 16 * 1024;
/// Messages a second on average: a sensor of 1000 Hz that puts each sample into a message of its own.
const MESSAGES_PER_S: f64 = 1200.0;
/// Binary messages a second; a device that sends more of them speaks something else.
const BINARY_PER_S: f64 = 3.0;

const BAD_TYPE: &str = r#"{"err":"bad_type","why":"imu.v1 is text"}"#;

/// A phone that is served.
pub(super) struct Phone {
    pub(super) socket: WebSocket,
    pub(super) entered: Entered,
    pub(super) placing: Placing,
    pub(super) status: watch::Receiver<Status>,
    pub(super) context: Arc<ConnectionContext>,
    pub(super) slot: Option<Arc<Slot>>,
}

impl Phone {
    /// Serves it until it ends.
    pub(super) async fn serve(mut self) {
        let end = self.run().await;
        let End::Close(close) = end else { return };
        if close.is_breach() {
            self.context.metrics.refuse("policy");
        }
        goodbye(&mut self.socket, close).await;
    }

    async fn run(&mut self) -> End {
        let mut pings = interval(seconds(self.context.limits.ping_interval_s));
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut shutdown = self.context.shutdown.clone();
        let mut messages = Budget::new(MESSAGES_PER_S, 2.0 * MESSAGES_PER_S);
        let mut binary = Budget::new(BINARY_PER_S, BINARY_PER_S);
        let mut received = now();
        loop {
            let step = tokio::select! {
                biased;
                () = ended(&mut shutdown) => return End::Close(self.context.makes_way.goodbye()),
                outgoing = self.entered.outgoing.recv() => match outgoing {
                    Some(ToPeer::Text(text)) => self.send(Message::Text(text.into())).await,
                    Some(ToPeer::Close(close)) => {
                        self.breach();
                        Err(End::Close(close))
                    }
                    None => Err(End::Close(Close::SHUTDOWN)),
                },
                incoming = self.socket.recv() => {
                    received = now();
                    let Some(incoming) = incoming else { return End::Gone };
                    if !messages.spend(1.0, received) {
                        self.breach();
                        return End::Close(Close::TOO_MANY);
                    }
                    match incoming {
                        Ok(Message::Text(text)) => {
                            self.entered.hear(&text);
                            Ok(())
                        }
                        Ok(Message::Binary(_)) if !binary.spend(1.0, received) => {
                            self.breach();
                            Err(End::Close(Close::TOO_MANY))
                        }
                        Ok(Message::Binary(_)) => self.send(Message::Text(BAD_TYPE.into())).await,
                        Ok(Message::Ping(_) | Message::Pong(_)) => Ok(()),
                        Ok(Message::Close(_)) => Err(End::Gone),
                        Err(error) => Err(end_of(error)),
                    }
                }
                Ok(()) = self.status.changed() => self.report().await,
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

    /// What the stage thinks of it.
    async fn report(&mut self) -> Result<(), End> {
        let Some(hello) = self.entered.hello() else { return Ok(()) };
        let report = self.placing.report(&hello.id, &self.status.borrow_and_update());
        self.send(Message::Text(report.to_string().into())).await
    }

    async fn send(&mut self, message: Message) -> Result<(), End> {
        patiently(&self.context, self.socket.send(message)).await
    }

    fn breach(&self) {
        if let Some(slot) = &self.slot {
            slot.breach();
        }
    }
}
