//! Recordings and exports as files: `/recordings/NAME` and `/exports/FILE`, to be kept elsewhere.
//!
//! In: names that clients ask for. Out: the file, a piece at a time, to who may open a websocket. Never: a file outside of its folder, nor more of
//! one in memory than a piece.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{Path as PathOf, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::stream;
use tokio::fs::File;
use tokio::io::AsyncReadExt;
use tokio::sync::watch;

use super::http;
use super::listen::ConnectionContext;
use super::slots::Slot;
use crate::library::EXPORTS;
use crate::ports::ended;

/// Bytes that are read at a time.
const PIECE: usize = 256 << 10;

/// The folder with recordings and their exports.
#[derive(Clone)]
pub(super) struct Files {
    folder: PathBuf,
    context: Arc<ConnectionContext>,
}

/// Which of the two.
#[derive(Clone, Copy)]
enum Kind {
    Recording,
    Export,
}

impl Files {
    pub(super) fn new(folder: PathBuf, context: &Arc<ConnectionContext>) -> Self {
        Self { folder, context: Arc::clone(context) }
    }

    /// What is answered below `/recordings` and `/exports`.
    pub(super) fn routes(self) -> Router {
        let answer = |kind| {
            get(
                async move |State(files): State<Self>,
                            PathOf(name): PathOf<String>,
                            http::SlotOf(slot): http::SlotOf,
                            headers: HeaderMap,
                            uri: Uri| {
                    files.answer(kind, &name, slot, &headers, &uri).await
                },
            )
        };
        Router::new()
            .route("/recordings/{name}", answer(Kind::Recording))
            .route("/exports/{name}", answer(Kind::Export))
            .with_state(self)
    }

    async fn answer(
        &self,
        kind: Kind,
        name: &str,
        slot: Option<Arc<Slot>>,
        headers: &HeaderMap,
        uri: &Uri,
    ) -> Response {
        let context = &self.context;
        if let Err((reason, refusal)) = http::admit(context, headers, uri, slot.as_deref()) {
            return http::refuse(context, reason, refusal);
        }
        let (folder, wanted) = (self.folder.clone(), name.to_owned());
        let found = tokio::task::spawn_blocking(move || open(&folder, kind, &wanted)).await;
        let refused = |status, sentence: String| http::refuse(context, "file", (status, sentence));
        match found.unwrap_or_else(|error| Err(io::Error::other(error))) {
            Ok(Some((file, bytes))) => {
                let down = context.shutdown.clone();
                sent(name, bytes, pieces(File::from_std(file), bytes, slot, down))
            }
            Ok(None) => refused(StatusCode::NOT_FOUND, format!("there is no such file: {name:?}")),
            Err(error) => refused(StatusCode::INTERNAL_SERVER_ERROR, format!("cannot read it: {error}")),
        }
    }
}

/// An open file and its size; `None` where the folder has none of that name.
fn open(folder: &Path, kind: Kind, name: &str) -> io::Result<Option<(std::fs::File, u64)>> {
    let folder = match kind {
        Kind::Recording => folder.to_owned(),
        Kind::Export => folder.join(EXPORTS),
    };
    let entries = match std::fs::read_dir(&folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        entries => entries?,
    };
    // Only what the folder itself names: no name leads elsewhere. What is being written (it begins with a dot) is not there yet.
    let is_it = |entry: &std::fs::DirEntry| entry.file_name() == name && !name.starts_with('.');
    let Some(entry) = entries.filter_map(Result::ok).find(is_it) else { return Ok(None) };
    let path = entry.path();
    if matches!(kind, Kind::Recording) && !posed_recording::is_recording(&path) {
        return Ok(None);
    }
    // Before it is opened: a pipe would wait for who writes into it.
    if !path.metadata()?.is_file() {
        return Ok(None);
    }
    let file = std::fs::File::open(path)?;
    let bytes = file.metadata()?.len();
    Ok(Some((file, bytes)))
}

/// So many bytes of a file; one that shrinks meanwhile breaks the answer off, so that nobody takes it for whole.
fn pieces(
    file: File,
    bytes: u64,
    slot: Option<Arc<Slot>>,
    down: watch::Receiver<bool>,
) -> impl stream::Stream<Item = io::Result<Bytes>> {
    let state = (file.take(bytes), bytes, slot, down);
    stream::try_unfold(state, async |(mut file, left, slot, mut down)| {
        if left == 0 {
            return Ok(None);
        }
        let mut piece = vec![0; PIECE.min(usize::try_from(left).unwrap_or(PIECE))];
        let read = tokio::select! {
            read = file.read(&mut piece) => read?,
            () = ended(&mut down) => return Err(io::Error::other("the daemon ends")),
        };
        if read == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if let Some(slot) = &slot {
            slot.moves();
        }
        piece.truncate(read);
        Ok(Some((Bytes::from(piece), (file, left - read as u64, slot, down))))
    })
}

/// An answer with so many bytes of a file.
pub(super) fn sent(
    name: &str,
    bytes: u64,
    pieces: impl stream::Stream<Item = io::Result<Bytes>> + Send + 'static,
) -> Response {
    let mut response = Body::from_stream(pieces).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(bytes));
    // What is no letter or digit is written as its bytes: whatever the name is, the header is one.
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.');
    let written = name.bytes().map(|byte| match plain(byte) {
        true => char::from(byte).to_string(),
        false => format!("%{byte:02X}"),
    });
    let disposition = format!("attachment; filename*=UTF-8''{}", written.collect::<String>());
    if let Ok(disposition) = HeaderValue::from_str(&disposition) {
        headers.insert(header::CONTENT_DISPOSITION, disposition);
    }
    response
}
