//! A server for many stages: each has its page, its websocket and its metrics below its name, as if it were alone; the hall itself
//! has a page and a websocket for all of them.
//!
//! In: items of stages with the stamps they got there. Out: the same messages as at the stages. Never: anything that changes a stage.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::Router;
use axum::extract::rejection::ExtensionRejection;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Extension, Path as PathOf, State};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;
use tokio::sync::{mpsc, watch};

use super::directory::{self, Directory, Member};
use super::distributor::Distributor;
use super::gate::{Door, Gate};
use super::hub::Item;
use super::listen::Slot;
use super::metrics::Metrics;
use super::{About, BindError, Command, Limits, Shared, Side, client, http, rfc3339, topics_of, viewer};
use crate::daemon::ports::ended;
use crate::protocol::{
    Counters, Encoding, Names, SUBPROTOCOL_JSON, SUBPROTOCOL_MSGPACK, Stages, Stamp, Topic,
};
use crate::stage::{self, Stage};

/// Items that wait for a stage's distributor.
const WAITING: usize = 256;

/// A hall that is bound and not yet open.
pub(in crate::daemon) struct Hall {
    door: Door,
    house: House,
    asked: mpsc::Receiver<directory::Command>,
}

/// Where stages come in; clones share it.
#[derive(Clone)]
pub(in crate::daemon) struct House {
    rooms: Arc<Rooms>,
}

struct Rooms {
    gate: Arc<Gate>,
    stages: Mutex<BTreeMap<String, Arc<Shared>>>,
    directory: mpsc::Sender<directory::Command>,
    greeting: directory::Greeting,
}

/// Where one stage's items go in; clients are told goodbye when it is dropped.
pub(in crate::daemon) struct StageEnd {
    items: mpsc::Sender<(Item, Stamp)>,
    shutdown: watch::Sender<bool>,
}

impl Hall {
    /// Binds the address of the settings, or `listen` in its place.
    pub(in crate::daemon) fn bind(
        name: &str,
        epoch_utc_ns: i64,
        settings: &stage::Server,
        listen: Option<String>,
        folder: &Path,
    ) -> Result<(Self, House), BindError> {
        let door = Door::open(settings, listen, folder, Limits::default())?;
        let (directory, asked) = mpsc::channel(1024);
        let greeting = directory::Greeting { name: name.to_owned(), epoch_utc: rfc3339(epoch_utc_ns) };
        let rooms = Rooms { gate: Arc::clone(&door.gate), stages: Mutex::default(), directory, greeting };
        let house = House { rooms: Arc::new(rooms) };
        Ok((Self { door, house: house.clone(), asked }, house))
    }

    pub(in crate::daemon) fn address(&self) -> SocketAddr {
        self.door.address()
    }

    pub(in crate::daemon) fn url(&self) -> String {
        self.door.url()
    }

    /// Serves until `shutdown` resolves.
    pub(in crate::daemon) async fn run(self, shutdown: impl Future<Output = ()>) {
        let Self { door, house, asked } = self;
        let directory = tokio::spawn(Directory::new(Arc::clone(&door.gate.metrics)).run(asked));
        let gate = Arc::clone(&door.gate);
        let routes = Router::new()
            .route("/", get(async || viewer::file("hub.html")))
            .route("/assets/{name}", get(http::asset))
            .route("/health", get(http::health))
            .route("/metrics", get(metrics))
            .route("/ws", get(everything))
            .route("/{stage}", get(with_slash))
            .route("/{stage}/", get(stage_root))
            .route(
                "/{stage}/assets/{name}",
                get(async |PathOf((_, name)): PathOf<(String, String)>| http::asset(PathOf(name)).await),
            )
            .route("/{stage}/health", get(stage_health))
            .route("/{stage}/metrics", get(stage_metrics))
            .route("/{stage}/ws", get(stage_websocket))
            .with_state(house);
        door.serve(http::guarded(routes, gate), shutdown).await;
        directory.abort();
    }
}

impl House {
    /// A stage comes in under a name, in the place of who had that name before.
    pub(in crate::daemon) async fn join(
        &self,
        id: &str,
        stage: &Stage,
        epoch_utc_ns: i64,
        published: &[Topic],
        last_event_id: u64,
    ) -> StageEnd {
        let Gate { access, limits, metrics, slots, .. } = &*self.rooms.gate;
        let (shutdown, seen) = watch::channel(false);
        let gate = Gate {
            access: access.clone(),
            limits: limits.clone(),
            metrics: Arc::clone(metrics),
            slots: slots.clone(),
            shutdown: seen,
        };
        let topics = topics_of(stage, published);
        let about = About { epoch_utc_ns, topics, last_event_id, replay: false, operable: false };
        let side = Side::new(stage, about, &Arc::new(gate), Arc::new(Metrics::new()));
        let (items, fed) = mpsc::channel(WAITING);
        let commands = side.shared.commands.clone();
        self.stages().insert(id.to_owned(), Arc::clone(&side.shared));
        tokio::spawn(distribute(side, fed, shutdown.subscribe()));
        let _ = self.rooms.directory.send(directory::Command::Joined { id: id.into(), commands }).await;
        StageEnd { items, shutdown }
    }

    /// What is said of all stages now.
    pub(in crate::daemon) async fn tell(&self, stages: Stages) {
        let _ = self.rooms.directory.send(directory::Command::Tell(stages)).await;
    }

    fn stage(&self, id: &str) -> Option<Arc<Shared>> {
        self.stages().get(id).map(Arc::clone)
    }

    fn stages(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Shared>>> {
        // Every change is complete before anything in it could panic.
        self.rooms.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl StageEnd {
    /// Publishes an item with the stamp that it got at its stage.
    pub(in crate::daemon) async fn publish(&self, item: Item, stamp: Stamp) {
        let _ = self.items.send((item, stamp)).await;
    }

    /// The way in for a thread.
    pub(in crate::daemon) fn items(&self) -> mpsc::Sender<(Item, Stamp)> {
        self.items.clone()
    }
}

impl Drop for StageEnd {
    fn drop(&mut self) {
        self.shutdown.send_replace(true);
    }
}

/// Feeds a stage's clients, until the stage has left.
async fn distribute(
    side: Side,
    mut items: mpsc::Receiver<(Item, Stamp)>,
    mut shutdown: watch::Receiver<bool>,
) {
    let Side { shared, mut viewers, mut commands, .. } = side;
    let (names, limits): (Arc<Names>, Limits) = (Arc::clone(&shared.names), shared.gate.limits.clone());
    let mut distributor = Distributor::new(names, limits, Arc::clone(&shared.metrics), Counters::default());
    loop {
        tokio::select! {
            biased;
            item = items.recv() => {
                let Some((item, stamp)) = item else { return };
                distributor.follow(&stamp);
                match &item {
                    Item::Estimate(_) => _ = shared.metrics.frames.inc(),
                    Item::Status(status) => shared.metrics.take(status),
                    _ => {}
                }
                viewers.publish(&item, Some(&stamp));
                distributor.publish(item, Some(stamp));
                shared.last_event_id.store(distributor.last_event_id(), Ordering::Relaxed);
                tokio::task::yield_now().await;
            }
            Some(command) = commands.recv() => match command {
                Command::Client(command) => distributor.handle(command),
                Command::Viewer(command) => viewers.handle(command),
            },
            () = ended(&mut shutdown) => return,
        }
    }
}

type SlotOf = Result<Extension<Arc<Slot>>, ExtensionRejection>;

async fn metrics(State(house): State<House>, headers: HeaderMap, uri: Uri) -> Response {
    let gate = &house.rooms.gate;
    http::counts(gate, &gate.metrics, &headers, &uri)
}

/// The websocket for all stages.
async fn everything(
    State(house): State<House>,
    slot: SlotOf,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    let gate = Arc::clone(&house.rooms.gate);
    if let Err((reason, refusal)) = http::admit(&gate, &headers, &uri) {
        return http::refuse(&gate, reason, refusal);
    }
    let upgrade = http::bounded(upgrade, &gate).protocols([SUBPROTOCOL_MSGPACK, SUBPROTOCOL_JSON]);
    let protocol = upgrade.selected_protocol().and_then(|protocol| protocol.to_str().ok()).unwrap_or("");
    let encoding = if protocol == SUBPROTOCOL_MSGPACK { Encoding::MessagePack } else { Encoding::Json };
    upgrade.on_upgrade(async move |socket| {
        let Rooms { directory, greeting, .. } = &*house.rooms;
        if let Some(member) = Member::begin(encoding, greeting, directory.clone(), &gate.limits).await {
            client::serve(socket, member, gate.limits.message_burst, Arc::clone(&gate)).await;
        }
        drop(slot);
    })
}

/// Relative addresses on the page begin below the stage's name.
async fn with_slash(uri: Uri) -> Redirect {
    let query = uri.query().map(|query| format!("?{query}")).unwrap_or_default();
    // Relative, so that it leads nowhere else, whatever the path looks like.
    let name = uri.path().trim_start_matches('/').to_owned();
    Redirect::temporary(&format!("./{name}/{query}"))
}

async fn stage_root(
    State(house): State<House>,
    PathOf(id): PathOf<String>,
    slot: SlotOf,
    headers: HeaderMap,
    uri: Uri,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    match house.stage(&id) {
        Some(shared) => http::root(State(shared), slot, headers, uri, upgrade).await,
        None => unknown(),
    }
}

async fn stage_websocket(
    State(house): State<House>,
    PathOf(id): PathOf<String>,
    slot: SlotOf,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    match house.stage(&id) {
        Some(shared) => http::websocket(State(shared), slot, headers, uri, upgrade).await,
        None => unknown(),
    }
}

async fn stage_metrics(
    State(house): State<House>,
    PathOf(id): PathOf<String>,
    headers: HeaderMap,
    uri: Uri,
) -> Response {
    match house.stage(&id) {
        Some(shared) => http::metrics(State(shared), headers, uri).await,
        None => unknown(),
    }
}

async fn stage_health(State(house): State<House>, PathOf(id): PathOf<String>) -> Response {
    match house.stage(&id) {
        Some(_) => http::health().await.into_response(),
        None => unknown(),
    }
}

fn unknown() -> Response {
    (StatusCode::NOT_FOUND, "this hub has not heard of such a stage; / lists those it has\n").into_response()
}
