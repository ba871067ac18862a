//! What a hub asks a stage, in the background: the answers come back by a channel, so that frames go on meanwhile.

use std::time::Duration;

use posed_drivers::Timestamp;
use serde::de::DeserializeOwned;
use tokio::sync::mpsc;
use zenoh::Session;

use crate::wire::{Begin, ClockReading, Joined, Keys, LogChunk};
use posed_daemon::StageClock;
use posed_daemon::server::{Answered, RemoteError, RemoteRecording, RemoteRecordings};
use posed_protocol::unpack;

/// Longest wait for an answer. A question that was lost with a link is asked again.
const PATIENCE: Duration = Duration::from_secs(2);
/// The same for a file: its disk may be slow.
const FILE_PATIENCE: Duration = Duration::from_secs(10);
/// A clock is read over a quick round trip or not at all.
const CLOCK_PATIENCE: Duration = Duration::from_millis(500);

/// An answer, or why there is none.
pub(super) enum Answer {
    /// Of all there is (`after` was 0) or of what was missed; with where a remote fusion begins, if that was asked for.
    Joined {
        after: u64,
        answer: zenoh::Result<Box<(Joined, Option<Begin>)>>,
    },
    Log(zenoh::Result<LogChunk>),
    Clock {
        left: Timestamp,
        reading: ClockReading,
        came: Timestamp,
    },
}

/// Asks one stage.
#[derive(Clone)]
pub(super) struct Questions {
    pub(super) session: Session,
    pub(super) keys: Keys,
    pub(super) clock: StageClock,
    pub(super) answers: mpsc::Sender<Answer>,
}

impl Questions {
    /// What the stage is, with all that still holds, or what was missed after an event.
    pub(super) fn join(&self, after: u64, begin: bool) {
        let this = self.clone();
        tokio::spawn(async move {
            let request = async {
                // First where fusion begins: what came before that is then in the other answer.
                let begin = if begin { Some(this.ask(&this.keys.ask("begin")).await?) } else { None };
                let joined = this.ask(&format!("{}?after={after}", this.keys.ask("join"))).await?;
                Ok(Box::new((joined, begin)))
            };
            let answer = request.await;
            let _ = this.answers.send(Answer::Joined { after, answer }).await;
        });
    }

    /// Entries of the input log that were missed.
    pub(super) fn log(&self, from: u64) {
        let this = self.clone();
        tokio::spawn(async move {
            let answer = this.ask(&format!("{}?from={from}", this.keys.ask("log"))).await;
            let _ = this.answers.send(Answer::Log(answer)).await;
        });
    }

    /// The stage's clock.
    pub(super) fn clock(&self) {
        let this = self.clone();
        tokio::spawn(async move {
            let left = this.clock.now();
            let reading = this.ask_within::<ClockReading>(&this.keys.clock(), CLOCK_PATIENCE).await;
            let came = this.clock.now();
            if let Ok(reading) = reading {
                let _ = this.answers.send(Answer::Clock { left, reading, came }).await;
            }
        });
    }

    /// Its recordings.
    pub(super) fn recordings(&self) -> Recordings {
        Recordings { session: self.session.clone(), key: self.keys.recordings() }
    }

    async fn ask<T: DeserializeOwned>(&self, selector: &str) -> zenoh::Result<T> {
        self.ask_within(selector, PATIENCE).await
    }

    async fn ask_within<T: DeserializeOwned>(&self, selector: &str, patience: Duration) -> zenoh::Result<T> {
        let answer = asked(&self.session, selector, patience).await?;
        unpack(&answer).map_err(|error| format!("{selector}: the answer cannot be read: {error}").into())
    }
}

/// What is answered under a key.
async fn asked(session: &Session, selector: &str, patience: Duration) -> zenoh::Result<Vec<u8>> {
    let replies = session.get(selector).timeout(patience).await?;
    let reply = replies.recv_async().await.map_err(|_| format!("{selector} was not answered"))?;
    match reply.into_result() {
        Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
        Err(error) => Err(String::from_utf8_lossy(&error.payload().to_bytes()).into()),
    }
}

/// Asks one stage for its recordings.
pub(super) struct Recordings {
    session: Session,
    key: String,
}

impl Recordings {
    fn asked<T>(
        &self,
        selector: String,
        read: impl FnOnce(Vec<u8>) -> Result<T, RemoteError> + Send + 'static,
    ) -> Answered<T> {
        let session = self.session.clone();
        Box::pin(async move {
            read(asked(&session, &selector, FILE_PATIENCE).await.map_err(RemoteError::Unanswered)?)
        })
    }
}

impl RemoteRecordings for Recordings {
    fn list(&self) -> Answered<Vec<RemoteRecording>> {
        self.asked(self.key.clone(), |json| serde_json::from_slice(&json).map_err(RemoteError::List))
    }

    fn piece(&self, name: &str, offset: u64) -> Answered<Vec<u8>> {
        // What zenoh reads as something else than a name.
        if name.contains(['*', '$', '?', '#', '/']) {
            let name = name.to_owned();
            return Box::pin(async { Err(RemoteError::Name(name)) });
        }
        self.asked(format!("{}/{name}?offset={offset}", self.key), Ok)
    }
}
