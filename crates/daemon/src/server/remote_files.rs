//! Recordings of a stage that is elsewhere, at its hub: `/STAGE/recordings` lists them, `/STAGE/recordings/NAME` gives one.
//!
//! In: names that clients ask for, and a way to ask the stage. Out: the file, a piece at a time, to who may open a websocket. Never: a change
//! at the stage, nor more of a file in memory than a piece.

use std::pin::Pin;
use std::sync::Arc;

use axum::body::Bytes;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use tokio::sync::watch;

use super::listen::ConnectionContext;
use super::slots::Slot;
use super::{files, http};
use crate::ports::ended;

/// What a stage answers, or why it does not.
pub type Answered<T> = Pin<Box<dyn Future<Output = Result<T, RemoteError>> + Send>>;

/// Why a stage does not give what it was asked for.
#[derive(Debug, Error)]
pub enum RemoteError {
    /// It has a name that nobody can ask for over this link.
    #[error("{0:?} has a character that no key may have: rename it at the stage")]
    Name(String),
    /// The stage does not answer, or refuses; as the link has it.
    #[error(transparent)]
    Unanswered(Box<dyn std::error::Error + Send + Sync>),
    /// Its list of recordings is none.
    #[error("the stage's list cannot be read: {0}")]
    List(#[source] serde_json::Error),
}

/// A recording of a stage.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemoteRecording {
    /// Its file name.
    pub name: String,
    /// Its size.
    pub bytes: u64,
}

/// Asks a stage for its recordings.
pub trait RemoteRecordings: Send + Sync + 'static {
    /// All that there are.
    fn list(&self) -> Answered<Vec<RemoteRecording>>;

    /// Bytes of one from an offset on: as many as the stage gives at a time, none at its end.
    fn piece(&self, name: &str, offset: u64) -> Answered<Vec<u8>>;
}

/// One client's request.
pub(super) struct Asked<'a> {
    pub(super) context: &'a ConnectionContext,
    pub(super) slot: Option<Arc<Slot>>,
    pub(super) headers: &'a HeaderMap,
    pub(super) uri: &'a Uri,
}

impl Asked<'_> {
    fn refused(&self, status: StatusCode, sentence: impl ToString) -> Response {
        http::refuse(self.context, "file", (status, sentence.to_string()))
    }

    /// Who may not look at the stage gets this instead.
    fn refusal(&self) -> Option<Response> {
        let admitted = http::admit(self.context, self.headers, self.uri, self.slot.as_deref());
        admitted.err().map(|(reason, refusal)| http::refuse(self.context, reason, refusal))
    }

    /// The list, as JSON.
    pub(super) async fn list(self, recordings: Arc<dyn RemoteRecordings>) -> Response {
        if let Some(refusal) = self.refusal() {
            return refusal;
        }
        match recordings.list().await.and_then(|list| serde_json::to_vec(&list).map_err(RemoteError::List)) {
            Ok(json) => ([(header::CONTENT_TYPE, "application/json")], json).into_response(),
            Err(error) => self.refused(StatusCode::BAD_GATEWAY, error),
        }
    }

    /// One of them.
    pub(super) async fn file(self, recordings: Arc<dyn RemoteRecordings>, name: &str) -> Response {
        if let Some(refusal) = self.refusal() {
            return refusal;
        }
        match recordings.list().await {
            Ok(list) => match list.into_iter().find(|recording| recording.name == name) {
                Some(RemoteRecording { name, bytes }) => {
                    let down = self.context.shutdown.clone();
                    files::sent(&name, bytes, pieces(recordings, name.clone(), bytes, self.slot, down))
                }
                None => self.refused(StatusCode::NOT_FOUND, format!("there is no such file: {name:?}")),
            },
            Err(error) => self.refused(StatusCode::BAD_GATEWAY, error),
        }
    }
}

/// So many bytes of a file; one that shrinks, or whose stage vanishes meanwhile, breaks the answer off, so that nobody takes it for whole.
fn pieces(
    recordings: Arc<dyn RemoteRecordings>,
    name: String,
    bytes: u64,
    slot: Option<Arc<Slot>>,
    down: watch::Receiver<bool>,
) -> impl stream::Stream<Item = std::io::Result<Bytes>> + Send {
    stream::try_unfold((0, down), move |(offset, mut down)| {
        let asked = (offset < bytes).then(|| recordings.piece(&name, offset));
        let slot = slot.clone();
        async move {
            let Some(asked) = asked else { return Ok(None) };
            let mut piece = tokio::select! {
                piece = asked => piece.map_err(std::io::Error::other)?,
                () = ended(&mut down) => return Err(std::io::Error::other("the hub ends")),
            };
            if piece.is_empty() {
                return Err(std::io::ErrorKind::UnexpectedEof.into());
            }
            // One that is still being recorded has grown.
            piece.truncate(usize::try_from(bytes - offset).unwrap_or(usize::MAX));
            if let Some(slot) = &slot {
                slot.moves();
            }
            let next = offset + piece.len() as u64;
            Ok(Some((Bytes::from(piece), (next, down))))
        }
    })
}
