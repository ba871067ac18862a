//! A server for many stages: each has its page, its websocket, its metrics and its recordings below its name, as if it were alone; the server itself
//! has a page and a websocket for all of them.
//!
//! In: items of stages with the stamps they got there. Out: the same messages as at the stages. Never: anything that changes a stage.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::Router;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Path as PathOf, State};
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tokio::sync::{mpsc, watch};
use tokio::time::{MissedTickBehavior, interval};

use super::demand::{Demand, GRACE};
use super::directory::{self, Directory, Member};
use super::distributor::Distributor;
use super::hub::Item;
use super::listen::ConnectionContext;
use super::listener::Listener;
use super::metrics::Metrics;
use super::remote_files::{Asked, RemoteRecordings};
use super::viewer::{self, Coding};
use super::{BindError, Command, Shared, StageInfo, StageServices, client, http, rfc3339, topics_of};
use crate::ports::ended;
use posed_protocol::{
    Counters, Encoding, SUBPROTOCOL_JSON, SUBPROTOCOL_MSGPACK, Selection, Stages, Stamp, Topic, Wish,
};
use posed_stage::Stage;

/// Items that wait for a stage's distributor.
const WAITING: usize = 256;
/// What stages and clients have reported to the hub's directory and what waits for it.
const DIRECTORY_REPORTS: usize = 1024;

/// A server for many stages that is bound and not yet running.
pub struct HubServer {
    listener: Listener,
    registry: StageRegistry,
    commands: mpsc::Receiver<directory::Command>,
}

/// Where stages come in; clones share it.
#[derive(Clone)]
pub struct StageRegistry {
    registered: Arc<Registered>,
}

struct Registered {
    context: Arc<ConnectionContext>,
    stages: Mutex<BTreeMap<String, Joined>>,
    directory: mpsc::Sender<directory::Command>,
    greeting: directory::Greeting,
}

/// A stage that has come in.
#[derive(Clone)]
struct Joined {
    shared: Arc<Shared>,
    recordings: Arc<dyn RemoteRecordings>,
}

/// Where one stage's items go in; clients are notified of the end when it is dropped.
pub struct StageEndpoint {
    items: mpsc::Sender<Incoming>,
    wish: watch::Receiver<Wish>,
    shutdown: watch::Sender<bool>,
}

/// An item of a stage, with the stamp that it got there.
pub struct Incoming {
    /// What was published.
    pub item: Item,
    /// When, and as which event.
    pub stamp: Stamp,
    /// How much of it is there, of a frame's poses; what is not is not shown.
    pub held: Selection,
}

impl HubServer {
    /// Binds the address of the settings, or `listen` (`HOST:PORT`) in its place, and gives the registry by which stages come in.
    /// `name` is what its own clients see, `epoch_utc_ns` the UTC of its epoch in nanoseconds since 1970; relative paths of the
    /// settings start from `folder`.
    ///
    /// # Errors
    /// The address does not serve, needs a token that is not there, or TLS files do not serve; see [`BindError`].
    ///
    /// # Panics
    /// Outside a tokio runtime with IO.
    pub fn bind(
        name: &str,
        epoch_utc_ns: i64,
        settings: &posed_stage::Server,
        listen: Option<String>,
        folder: &Path,
    ) -> Result<(Self, StageRegistry), BindError> {
        crate::process_limits::raise();
        let listener = Listener::open(settings, listen, None, folder)?;
        let (directory, commands) = mpsc::channel(DIRECTORY_REPORTS);
        let greeting = directory::Greeting { name: name.to_owned(), epoch_utc: rfc3339(epoch_utc_ns) };
        let registered = Registered {
            context: Arc::clone(&listener.context),
            stages: Mutex::default(),
            directory,
            greeting,
        };
        let registry = StageRegistry { registered: Arc::new(registered) };
        Ok((Self { listener, registry: registry.clone(), commands }, registry))
    }

    /// The address it listens on, with the port that the system chose if it was 0.
    pub fn address(&self) -> SocketAddr {
        self.listener.address()
    }

    /// The address to open in a browser, where all stages are listed.
    pub fn url(&self) -> String {
        self.listener.url()
    }

    /// Serves until `shutdown` resolves; then tells the hub's own clients goodbye (1001) and returns once all have left, within
    /// the shutdown timeout. Clients of a stage get theirs when its [`StageEndpoint`] is dropped.
    pub async fn run(self, shutdown: impl Future<Output = ()>) {
        let Self { listener, registry, commands } = self;
        let directory = tokio::spawn(Directory::new(Arc::clone(&listener.context.metrics)).run(commands));
        let context = Arc::clone(&listener.context);
        let routes = Router::new()
            .route("/", get(async |coding: Coding| viewer::file("hub.html", coding)))
            .route("/assets/{name}", get(http::asset))
            .route("/health", get(async || "ok\n"))
            .route("/metrics", get(metrics))
            .route("/ws", get(everything))
            .route("/{stage}", get(http::with_slash))
            .route("/{stage}/", get(stage_root))
            .route(
                "/{stage}/assets/{name}",
                get(async |PathOf((_, name)): PathOf<(String, String)>, coding: Coding| {
                    http::asset(PathOf(name), coding).await
                }),
            )
            .route("/{stage}/health", get(stage_health))
            .route("/{stage}/metrics", get(stage_metrics))
            .route("/{stage}/ws", get(stage_websocket))
            .route("/{stage}/recordings", get(stage_recordings))
            .route("/{stage}/recordings/{name}", get(stage_recording))
            .with_state(registry);
        listener.serve(http::guarded(routes, context), shutdown).await;
        directory.abort();
    }
}

impl StageRegistry {
    /// A stage comes in under the name `id`, in the place of who had that name before, whose clients stay with the old endpoint.
    ///
    /// `epoch_utc_ns`: UTC of the stage's epoch, in nanoseconds since 1970. `published`: topics beside those that its file shows.
    /// `last_event_id`: number of its newest event. `recordings`: how it is asked for those. Clients here may look on and change nothing.
    pub async fn join(
        &self,
        id: &str,
        stage: &Stage,
        epoch_utc_ns: i64,
        published: &[Topic],
        last_event_id: u64,
        recordings: Arc<dyn RemoteRecordings>,
    ) -> StageEndpoint {
        let (shutdown, seen) = watch::channel(false);
        let context = self.registered.context.until(seen);
        let topics = topics_of(stage, published);
        // What is wrong at the stage's own daemon comes with its status.
        let problems = Vec::new();
        let about =
            StageInfo { epoch_utc_ns, topics, last_event_id, replay: false, operable: false, problems };
        let services = StageServices::new(stage, about, &Arc::new(context), Arc::new(Metrics::new()));
        let (items, fed) = mpsc::channel(WAITING);
        let commands = services.shared.commands.clone();
        let joined = Joined { shared: Arc::clone(&services.shared), recordings };
        self.stages().insert(id.to_owned(), joined);
        let (asked, wish) = watch::channel(Wish::default());
        tokio::spawn(distribute(services, fed, Demand::new(asked), shutdown.subscribe()));
        let _ = self.registered.directory.send(directory::Command::Joined { id: id.into(), commands }).await;
        StageEndpoint { items, wish, shutdown }
    }

    /// A stage is forgotten: its page and its clients' subscriptions end.
    pub async fn leave(&self, id: &str) {
        self.stages().remove(id);
        let _ = self.registered.directory.send(directory::Command::Left { id: id.into() }).await;
    }

    /// Tells clients of the hub itself how all stages are now.
    pub async fn report(&self, stages: Stages) {
        let _ = self.registered.directory.send(directory::Command::Tell(stages)).await;
    }

    fn stage(&self, id: &str) -> Option<Arc<Shared>> {
        Some(self.joined(id)?.shared)
    }

    fn joined(&self, id: &str) -> Option<Joined> {
        self.stages().get(id).cloned()
    }

    fn stages(&self) -> MutexGuard<'_, BTreeMap<String, Joined>> {
        // Every change is complete before anything in it could panic.
        self.registered.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl StageEndpoint {
    /// Publishes an item of which everything is there. Waits while 256 items wait.
    pub async fn publish(&self, item: Item, stamp: Stamp) {
        self.pass(Incoming { item, stamp, held: Selection::whole() }).await;
    }

    /// Publishes an item; frames that no client here has asked for are passed over. Waits while 256 items wait.
    pub async fn pass(&self, incoming: Incoming) {
        let _ = self.items.send(incoming).await;
    }

    /// The way in for a thread: what [`StageEndpoint::pass`] takes, where sending may block.
    pub fn items(&self) -> mpsc::Sender<Incoming> {
        self.items.clone()
    }

    /// What clients here want of the stage's states: all of them together, and what those wanted who have just left.
    pub fn wish(&self) -> watch::Receiver<Wish> {
        self.wish.clone()
    }
}

impl Drop for StageEndpoint {
    fn drop(&mut self) {
        self.shutdown.send_replace(true);
    }
}

/// Feeds a stage's clients, until the stage has left.
async fn distribute(
    services: StageServices,
    mut items: mpsc::Receiver<Incoming>,
    mut demand: Demand,
    mut shutdown: watch::Receiver<bool>,
) {
    let StageServices { shared, mut viewers, mut commands, .. } = services;
    let (names, limits) = (Arc::clone(&shared.names), shared.context.limits.clone());
    let mut distributor = Distributor::new(names, limits, Arc::clone(&shared.metrics), Counters::default());
    let mut looks = interval(GRACE);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            biased;
            incoming = items.recv() => {
                let Some(Incoming { item, stamp, held }) = incoming else { return };
                distributor.follow(&stamp);
                if stamp.topic.is_frequent() && !demand.has(stamp.topic) {
                    // It was under way as the last one left, and would be taken for the newest by the next one to come.
                    continue;
                }
                let is_whole = held == Selection::whole();
                match &item {
                    Item::Estimate(_) => _ = shared.metrics.frames.inc(),
                    Item::Status(status) => shared.metrics.take(status),
                    _ => {}
                }
                if matches!(item, Item::Estimate(_)) {
                    distributor.hold(held);
                }
                if is_whole {
                    viewers.publish(&item, Some(&stamp));
                }
                if let Item::Status(status) = &item {
                    shared.reports.passed_on(status);
                }
                distributor.publish(item, Some(stamp));
                shared.last_event_id.store(distributor.last_event_id(), Ordering::Relaxed);
                tokio::task::yield_now().await;
            }
            Some(command) = commands.recv() => {
                match command {
                    Command::Client(command) => distributor.handle(command),
                    Command::Viewer(command) => viewers.handle(command),
                }
                let mut wish = distributor.wish();
                wish.join(&viewers.wish());
                demand.want(wish);
            }
            _ = looks.tick() => {
                let given_up = demand.look();
                // What comes seldom comes without being asked for, and stays true until the next.
                let frequent = given_up.into_iter().filter(|topic| topic.is_frequent());
                frequent.for_each(|topic| distributor.forget(topic));
            }
            () = ended(&mut shutdown) => return,
        }
    }
}

async fn metrics(State(registry): State<StageRegistry>, headers: HeaderMap, uri: Uri) -> Response {
    let context = &registry.registered.context;
    http::counts(context, &context.metrics, &headers, &uri)
}

/// The websocket for all stages.
async fn everything(
    State(registry): State<StageRegistry>,
    http::SlotOf(slot): http::SlotOf,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    let context = Arc::clone(&registry.registered.context);
    if let Err((reason, refusal)) = http::admit(&context, &headers, &uri, slot.as_deref()) {
        return http::refuse(&context, reason, refusal);
    }
    let upgrade = http::bounded(upgrade, &context).protocols([SUBPROTOCOL_MSGPACK, SUBPROTOCOL_JSON]);
    let protocol = upgrade.selected_protocol().and_then(|protocol| protocol.to_str().ok()).unwrap_or("");
    let encoding = if protocol == SUBPROTOCOL_MSGPACK { Encoding::MessagePack } else { Encoding::Json };
    upgrade.on_upgrade(async move |socket| {
        let Registered { directory, greeting, .. } = &*registry.registered;
        if let Some(member) = Member::begin(encoding, greeting, directory.clone(), &context).await {
            client::serve(socket, member, context.limits.message_burst, Arc::clone(&context), slot).await;
        }
    })
}

async fn stage_root(
    State(registry): State<StageRegistry>,
    PathOf(id): PathOf<String>,
    slot: http::SlotOf,
    coding: Coding,
    headers: HeaderMap,
    uri: Uri,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    match registry.stage(&id) {
        Some(shared) => http::root(State(shared), slot, coding, headers, uri, upgrade).await,
        None => unknown(),
    }
}

async fn stage_websocket(
    State(registry): State<StageRegistry>,
    PathOf(id): PathOf<String>,
    slot: http::SlotOf,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    match registry.stage(&id) {
        Some(shared) => http::websocket(State(shared), slot, headers, uri, upgrade).await,
        None => unknown(),
    }
}

async fn stage_metrics(
    State(registry): State<StageRegistry>,
    PathOf(id): PathOf<String>,
    headers: HeaderMap,
    uri: Uri,
) -> Response {
    match registry.stage(&id) {
        Some(shared) => http::metrics(State(shared), headers, uri).await,
        None => unknown(),
    }
}

async fn stage_health(State(registry): State<StageRegistry>, PathOf(id): PathOf<String>) -> Response {
    match registry.stage(&id) {
        Some(shared) => http::health(State(shared)).await.into_response(),
        None => unknown(),
    }
}

async fn stage_recordings(
    State(registry): State<StageRegistry>,
    PathOf(id): PathOf<String>,
    http::SlotOf(slot): http::SlotOf,
    headers: HeaderMap,
    uri: Uri,
) -> Response {
    let Some(Joined { shared, recordings }) = registry.joined(&id) else { return unknown() };
    Asked { context: &shared.context, slot, headers: &headers, uri: &uri }.list(recordings).await
}

async fn stage_recording(
    State(registry): State<StageRegistry>,
    PathOf((id, name)): PathOf<(String, String)>,
    http::SlotOf(slot): http::SlotOf,
    headers: HeaderMap,
    uri: Uri,
) -> Response {
    let Some(Joined { shared, recordings }) = registry.joined(&id) else { return unknown() };
    Asked { context: &shared.context, slot, headers: &headers, uri: &uri }.file(recordings, &name).await
}

fn unknown() -> Response {
    (StatusCode::NOT_FOUND, "this hub has not heard of such a stage; / lists those it has\n").into_response()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    async fn waits(telling: impl Future<Output = ()>) -> bool {
        tokio::time::timeout(Duration::from_millis(50), telling).await.is_err()
    }

    #[tokio::test]
    async fn who_brings_more_than_a_stages_distributor_has_room_for_waits_and_nothing_is_lost() {
        let (items, mut fed) = mpsc::channel(WAITING);
        let end = StageEndpoint {
            items,
            wish: watch::channel(Wish::default()).1,
            shutdown: watch::channel(false).0,
        };
        let bring = |t_us| {
            let stamp = Stamp { topic: Topic::Status, body: 0, t_us, event_id: None, timecode: None };
            end.publish(Item::Status(Box::default()), stamp)
        };
        for t_us in 0..WAITING as i64 {
            bring(t_us).await;
        }
        assert!(waits(bring(-1)).await);
        for t_us in 0..WAITING as i64 {
            assert_eq!(fed.recv().await.unwrap().stamp.t_us, t_us);
        }
        bring(-2).await;
        assert_eq!(fed.recv().await.unwrap().stamp.t_us, -2);
    }

    #[tokio::test]
    async fn who_reports_more_to_the_directory_than_it_has_room_for_waits_until_it_has() {
        let folder = tempfile::tempdir().unwrap();
        let listen = Some("127.0.0.1:0".to_owned());
        let settings = posed_stage::Server::default();
        let (server, registry) = HubServer::bind("hub", 0, &settings, listen, folder.path()).unwrap();
        for _ in 0..DIRECTORY_REPORTS {
            registry.report(Stages::default()).await;
        }
        let mut more = tokio::spawn(async move { registry.report(Stages::default()).await });
        assert!(waits(async { (&mut more).await.unwrap() }).await);
        let (end, mut ended) = watch::channel(false);
        let run = tokio::spawn(server.run(async move { _ = ended.changed().await }));
        more.await.unwrap();
        end.send_replace(true);
        run.await.unwrap();
    }
}
