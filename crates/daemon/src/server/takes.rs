//! Recordings beside the live stage: each has its page and its websocket below `/takes/NAME/`, as a stage has at its hub, for as long as somebody
//! watches it.
//!
//! In: names that clients ask for, and a [`Shelf`] that opens recordings. Out: the messages that `posed replay` would send. Never: anything that
//! the live stage's tracking waits for; a take has a thread, a pipeline and a distributor of its own.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Path as PathOf, State};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::Response;
use axum::routing::get;
use tokio::sync::{mpsc, watch};
use tokio::time::timeout;

use super::distributor::Distributor;
use super::hub::Hub;
use super::listen::ConnectionContext;
use super::metrics::Metrics;
use super::viewer::{self, Coding};
use super::{Outlets, PendingCall, Shared, StageInfo, StageServices, distribute, http, topics_of};
use crate::ports::ended;
use crate::recordings::FindError;
use posed_protocol::{Counters, Topic};
use posed_stage::Stage;

/// So many are open at once: each has a pipeline of its own.
const MOST: usize = 4;
/// Who comes back within this finds the take where it was left: a page that is loaded anew, a tablet that slept.
const LINGER: Duration = Duration::from_secs(30);

/// Opens recordings by name.
pub(crate) trait Shelf: Send + Sync + 'static {
    /// Reads what has to be known of a recording before it is played; waits for the disk.
    fn open(&self, name: &str) -> Result<Take, TakeError>;

    /// Is given what closes a take.
    fn lend(&self, let_go: LetGo);
}

/// Closes the take of this name if nobody watches it any more, though somebody might come back; false where somebody does, and where it
/// is not open.
pub(crate) type LetGo = Box<dyn Fn(&str) -> bool + Send + Sync>;

/// A recording that can be played.
pub(crate) struct Take {
    pub(crate) stage: Stage,
    /// UTC of its epoch, ns since 1970.
    pub(crate) epoch_utc_ns: i64,
    /// Topics beside those that its stage shows.
    pub(crate) topics: Vec<Topic>,
    pub(crate) play: Play,
}

/// Begins to play into a hub, answering calls, until it is asked to end; inside a tokio runtime, and does not wait.
pub(crate) type Play =
    Box<dyn FnOnce(Hub, mpsc::Receiver<PendingCall>, watch::Receiver<bool>) -> Result<(), TakeError> + Send>;

/// Why a take cannot be watched.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TakeError {
    #[error(transparent)]
    Find(#[from] FindError),
    #[error("{0}")]
    Unplayable(String),
    #[error("{MOST} recordings are open already; close one, or wait for {} s after its last page has gone", LINGER.as_secs())]
    TooMany,
}

/// What is open; clones share it.
#[derive(Clone)]
pub(super) struct Takes {
    shelf: Arc<dyn Shelf>,
    context: Arc<ConnectionContext>,
    open: Arc<Mutex<BTreeMap<String, Open>>>,
}

/// One that is open; its clients get a goodbye when it is dropped.
struct Open {
    shared: Arc<Shared>,
    watchers: watch::Sender<usize>,
    shutdown: watch::Sender<bool>,
}

impl Open {
    fn watch(&self) -> (Arc<Shared>, Watcher) {
        (Arc::clone(&self.shared), Watcher::of(&self.watchers))
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        self.shutdown.send_replace(true);
    }
}

/// Somebody watches a take, until dropped.
struct Watcher(watch::Sender<usize>);

impl Watcher {
    fn of(watchers: &watch::Sender<usize>) -> Self {
        watchers.send_modify(|count| *count += 1);
        Self(watchers.clone())
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.0.send_modify(|count| *count -= 1);
    }
}

impl Takes {
    pub(super) fn new(shelf: Arc<dyn Shelf>, context: &Arc<ConnectionContext>) -> Self {
        let takes = Self { shelf, context: Arc::clone(context), open: Arc::default() };
        let open = Arc::clone(&takes.open);
        takes.shelf.lend(Box::new(move |name| {
            let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
            let is_left = open.get(name).is_some_and(|take| *take.watchers.borrow() == 0);
            is_left && open.remove(name).is_some()
        }));
        takes
    }

    /// What is answered below `/takes`.
    pub(super) fn routes(self) -> Router {
        Router::new()
            .route("/takes/{name}", get(http::with_slash))
            .route("/takes/{name}/", get(async |coding: Coding| viewer::file("index.html", coding)))
            .route(
                "/takes/{name}/assets/{file}",
                get(async |PathOf((_, file)): PathOf<(String, String)>, coding: Coding| {
                    http::asset(PathOf(file), coding).await
                }),
            )
            .route("/takes/{name}/ws", get(websocket))
            .with_state(self)
    }

    /// The take of that name, which is opened if it is not open.
    async fn watch(&self, name: &str) -> Result<(Arc<Shared>, Watcher), TakeError> {
        if let Some(open) = self.all().get(name) {
            return Ok(open.watch());
        }
        let (shelf, wanted) = (Arc::clone(&self.shelf), name.to_owned());
        let take = tokio::task::spawn_blocking(move || shelf.open(&wanted))
            .await
            .map_err(|error| TakeError::Unplayable(error.to_string()))??;
        self.begin(name, take)
    }

    fn begin(&self, name: &str, take: Take) -> Result<(Arc<Shared>, Watcher), TakeError> {
        let mut all = self.all();
        // Somebody else may have opened it meanwhile.
        if let Some(open) = all.get(name) {
            return Ok(open.watch());
        }
        if all.len() >= MOST {
            return Err(TakeError::TooMany);
        }
        let Take { stage, epoch_utc_ns, topics, play } = take;
        let (shutdown, down) = watch::channel(false);
        let context = Arc::new(self.context.until(down.clone()));
        let info = StageInfo {
            epoch_utc_ns,
            topics: topics_of(&stage, &topics),
            last_event_id: 0,
            replay: true,
            operable: true,
            problems: Vec::new(),
        };
        let own = Arc::new(Metrics::new());
        let StageServices { shared, viewers, commands, calls } =
            StageServices::new(&stage, info, &context, Arc::clone(&own));
        let hub = Hub::default();
        play(hub.clone(), calls, down.clone())?;
        let limits = context.limits.clone();
        let distributor = Distributor::new(Arc::clone(&shared.names), limits, own, Counters::default());
        let outlets = Outlets {
            distributor,
            viewers,
            vrpn: None,
            datagrams: Vec::new(),
            lsl: None,
            feeds: Vec::new(),
            phones: None,
        };
        let distributing = distribute(outlets, hub, commands, Arc::clone(&shared));
        let mut until = down;
        tokio::spawn(async move {
            tokio::select! {
                () = distributing => {}
                () = ended(&mut until) => {}
            }
        });
        let (watchers, seen) = watch::channel(0);
        let open = Open { shared, watchers, shutdown };
        let watched = open.watch();
        all.insert(name.to_owned(), open);
        tokio::spawn(self.clone().keep(name.to_owned(), seen));
        Ok(watched)
    }

    /// Closes a take when nobody has watched it for a while, or the server ends.
    async fn keep(self, name: String, mut watchers: watch::Receiver<usize>) {
        let mut down = self.context.shutdown.clone();
        loop {
            tokio::select! {
                left = watchers.wait_for(|count| *count == 0) => if left.is_err() { return },
                () = ended(&mut down) => break,
            }
            let comes = timeout(LINGER, watchers.wait_for(|count| *count > 0));
            let comes = tokio::select! {
                comes = comes => matches!(comes, Ok(Ok(_))),
                () = ended(&mut down) => break,
            };
            let mut all = self.all();
            if !comes && *watchers.borrow() == 0 {
                all.remove(&name);
                return;
            }
        }
        self.all().remove(&name);
    }

    fn all(&self) -> MutexGuard<'_, BTreeMap<String, Open>> {
        // Every change is complete before anything in it could panic.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

async fn websocket(
    State(takes): State<Takes>,
    PathOf(name): PathOf<String>,
    http::SlotOf(slot): http::SlotOf,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    // Nobody opens anything who may not look at it.
    let role = match http::admit(&takes.context, &headers, &uri, slot.as_deref()) {
        Ok(role) => role,
        Err((reason, refusal)) => return http::refuse(&takes.context, reason, refusal),
    };
    match takes.watch(&name).await {
        Ok((shared, watcher)) => http::admitted(shared, slot, role, upgrade, watcher),
        Err(error) => {
            let status = match &error {
                TakeError::Find(FindError::Unknown(_)) => StatusCode::NOT_FOUND,
                TakeError::TooMany => StatusCode::SERVICE_UNAVAILABLE,
                _ => StatusCode::UNPROCESSABLE_ENTITY,
            };
            http::refuse(&takes.context, "take", (status, error.to_string()))
        }
    }
}
