//! The server: websocket, page, metrics, health; Foxglove viewers, VRPN, VMC, MVN, LSL.
//!
//! In: frames, events, status from the fusion thread through a [`Hub`], connections from a socket. Out: messages to
//! clients, their [`PendingCall`]s to the daemon. Never: anything that makes the fusion thread, or one client, wait for another.
//!
//! ```text
//! fusion thread ── Hub ──> distributor ──> outbox of each client ──> its task ──> socket
//!                               ^ subscribe, resume                     │ calls ──> daemon ── Reply ──> outbox
//! ```
//! One task ([`distributor`], and [`foxglove`] for its viewers) owns the subscriptions and serialises each distinct body once; one task
//! per client ([`client`]) writes what is in its [`outbox`], which is bounded and which nobody waits for.

mod access;
mod budget;
mod client;
mod datagrams;
mod demand;
mod directory;
mod distributor;
mod files;
mod foxglove;
mod holding;
mod http;
mod hub;
mod hub_server;
mod listen;
mod listener;
mod metrics;
mod outbox;
pub(crate) mod phones;
mod remote_files;
mod reports;
mod requests;
mod slots;
mod streams;
mod takes;
#[cfg(test)]
pub(crate) mod testing;
mod tls;
mod viewer;
mod views;
mod vrpn;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::sync::{mpsc, watch};

use self::distributor::Distributor;
use self::files::Files;
use self::foxglove::Viewers;
use self::listen::ConnectionContext;
use self::listener::Listener;
use self::metrics::Metrics;
use self::phones::{PhonePlace, Phones};
use self::reports::Reports;
use self::streams::Streaming;
use self::takes::Takes;
use self::vrpn::{Outlet, Vrpn};
use super::clock::StageClock;
use super::fault_points;
use super::link::Feed;
use super::vital::Vital;
use posed_protocol::vrpn::{Catalogue, Publisher};
use posed_protocol::{Counters, HelloBody, HelloSensor, Names, Problem, Status, Topic};
use posed_stage::input::SensorIndex;
use posed_stage::layout::{BodyLayout, color_of};
use posed_stage::{Body, BodyIndex, Pose, Stage};

#[doc(hidden)]
pub use self::directory::fuzz_hub_message;
pub use self::holding::Holding;
pub use self::hub::{Hub, Item};
pub use self::hub_server::{HubServer, Incoming, StageEndpoint, StageRegistry};
pub(crate) use self::listen::MakesWay;
pub(crate) use self::listener::socket;
pub use self::phones::{CertificateError, write_secret};
pub use self::remote_files::{Answered, RemoteError, RemoteRecording, RemoteRecordings};
pub use self::requests::{PendingCall, Refusal, Reply};
pub(crate) use self::takes::{LetGo, Shelf, Take, TakeError};
pub use self::tls::TlsError;

/// Where the server listens unless the stage file or the command line specifies otherwise.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:8787";

/// What the server cannot know from the stage file.
#[derive(Clone, Debug)]
pub struct Config {
    /// `HOST:PORT` instead of the stage file's; port 0 lets the system choose. Absent: the stage file's, else [`DEFAULT_LISTEN`].
    pub listen: Option<String>,
    /// A socket that is open at that address already, in place of a new one.
    pub socket: Option<Arc<std::net::TcpListener>>,
    /// Folder that relative paths of the stage file start from.
    pub folder: PathBuf,
    /// UTC of the stage's epoch, in nanoseconds since 1970.
    pub epoch_utc_ns: i64,
    /// Topics that are published beside `status`, `sensors`, `faults`, `field`, `jobs`, and `truth` of a simulated stage.
    pub more_topics: Vec<Topic>,
    /// Numbers given out before; those of a recording when one is replayed.
    pub counters: Counters,
    /// Whether it is a recording that is served: its time is not that of the world, and programs that the stage itself may be
    /// serving at the same time (VRPN, VMC, MVN, LSL) are not served.
    pub replay: bool,
    /// The stage's clock; absent: times are those of nothing that goes on, and LSL gets nothing.
    pub clock: Option<StageClock>,
    /// What went wrong as the daemon was started, and does not keep it from running: reported with every status.
    pub problems: Vec<Problem>,
}

impl Config {
    /// For a live stage whose relative paths start from `folder`; `epoch_utc_ns` is the UTC of its epoch, in nanoseconds since
    /// 1970. No clock, no more topics.
    pub fn new(folder: &Path, epoch_utc_ns: i64) -> Self {
        Self {
            listen: None,
            socket: None,
            folder: folder.into(),
            epoch_utc_ns,
            more_topics: Vec::new(),
            counters: Counters::default(),
            replay: false,
            clock: None,
            problems: Vec::new(),
        }
    }
}

/// Why the server cannot start.
#[derive(Debug, thiserror::Error)]
pub enum BindError {
    /// The address cannot be read or resolved.
    #[error("cannot listen on {listen}: {error}; give HOST:PORT, like {DEFAULT_LISTEN}")]
    Address {
        /// As given.
        listen: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// Beyond loopback everybody on the network could look and operate.
    #[error(
        "refusing to listen on {listen}, which other computers can reach, without a token: add [[server.token]] with \
         secret (at least 16 characters) and role to the stage file, or listen on 127.0.0.1"
    )]
    NeedsToken {
        /// As given.
        listen: String,
    },
    /// The address is taken, or is none of this computer's.
    #[error(
        "cannot listen on {listen}: {error}; is another posed running? choose another port with --listen"
    )]
    Bind {
        /// As given.
        listen: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// The address for VRPN clients is taken, or none.
    #[error(
        "cannot listen on {listen} for VRPN clients: {error}; is a VRPN server running? choose another port in [vrpn]"
    )]
    Vrpn {
        /// As given.
        listen: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// An address that datagrams are to be sent to has no meaning here.
    #[error("cannot send to {target}: {error}; write HOST:PORT into {table}.targets, like {usual}")]
    Target {
        /// Of which table of the stage file.
        table: &'static str,
        /// As given.
        target: String,
        /// One as they usually are.
        usual: &'static str,
        /// What the system said.
        error: std::io::Error,
    },
    /// Certificate or key do not serve.
    #[error(transparent)]
    Tls(#[from] TlsError),
}

/// What clients' tasks may have sent to the distributing one before they wait for it.
const COMMANDS: usize = 1024;
/// Requests that may wait to be handed on.
const CALLS: usize = 64;

/// What a live stage has beside it; nothing by default.
#[derive(Default)]
pub(super) struct Sides {
    /// All that is published goes there too, for programs on other machines.
    pub(super) feeds: Vec<Box<dyn Feed>>,
    /// Recordings that clients may watch.
    pub(super) shelf: Option<Arc<dyn Shelf>>,
    /// Folder whose recordings and exports clients may fetch.
    pub(super) files: Option<PathBuf>,
    /// What phones need that come as sensors.
    pub(super) phones: Option<PhonePlace>,
}

/// A server that is bound and not yet running.
pub struct Server {
    listener: Listener,
    shared: Arc<Shared>,
    outlets: Outlets,
    vrpn: Option<Vrpn>,
    hub: Hub,
    commands: mpsc::Receiver<Command>,
    takes: Option<Takes>,
    files: Option<Files>,
    phones: Option<Phones>,
}

/// What every connection to a stage needs.
struct Shared {
    context: Arc<ConnectionContext>,
    /// The stage's own; those of the gate unless it leads to many stages.
    metrics: Arc<Metrics>,
    names: Arc<Names>,
    greeting: Greeting,
    /// What Foxglove viewers gets first.
    viewing: foxglove::Greeting,
    commands: mpsc::Sender<Command>,
    calls: mpsc::Sender<PendingCall>,
    /// Whether clients may change something, where their token lets them.
    operable: bool,
    /// What went wrong as the daemon was started, and does not keep it from running.
    problems: Vec<Problem>,
    reports: Reports,
    /// Newest event, for greetings.
    last_event_id: std::sync::atomic::AtomicU64,
    next_client: std::sync::atomic::AtomicU64,
}

/// What clients' tasks tell the distributing one.
enum Command {
    /// A client of our own protocol.
    Client(distributor::Command),
    /// A Foxglove viewer.
    Viewer(foxglove::Command),
}

/// What every client gets first.
struct Greeting {
    stage: String,
    epoch_utc: String,
    bodies: Vec<HelloBody>,
    /// As the stage file has it.
    transmitter: Option<Pose>,
    topics: Vec<Topic>,
}

fn hello_body(stage: &Stage, index: BodyIndex, body: &Body) -> HelloBody {
    let Body { name, skeleton, height_m, .. } = body;
    HelloBody { name: name.clone(), color: color_of(stage, index), skeleton: *skeleton, height_m: *height_m }
}

impl Shared {
    fn hello_sensors(&self) -> Vec<HelloSensor> {
        let sensor = |(index, (name, device)): (usize, (&str, &str))| HelloSensor {
            name: name.into(),
            device: device.into(),
            magnetic: self.names.is_magnetic(index as SensorIndex),
        };
        self.names.sensors().enumerate().map(sensor).collect()
    }
}

impl BindError {
    /// Whether it may be otherwise in a moment, with nothing changed: the address has not come up yet, or another program still
    /// has the port.
    pub fn may_pass(&self) -> bool {
        use std::io::ErrorKind::{AddrInUse, AddrNotAvailable};
        match self {
            Self::Bind { error, .. } | Self::Vrpn { error, .. } => {
                matches!(error.kind(), AddrInUse | AddrNotAvailable)
            }
            Self::Address { .. } | Self::NeedsToken { .. } | Self::Target { .. } | Self::Tls(_) => false,
        }
    }
}

impl Server {
    /// Binds the stage's address, and that for VRPN. Gives the server, the handle to publish with, and the calls that clients
    /// make. Nobody is let in before [`Server::run`].
    ///
    /// # Errors
    /// When an address is no address, is taken, needs a token that is not there, or TLS files do not serve; see [`BindError`].
    ///
    /// # Panics
    /// Outside a tokio runtime with IO.
    pub fn bind(
        stage: &Stage,
        config: Config,
    ) -> Result<(Self, Hub, mpsc::Receiver<PendingCall>), BindError> {
        Self::bind_with(stage, config, Sides::default())
    }

    /// The same, with what a live stage has beside it.
    pub(super) fn bind_with(
        stage: &Stage,
        config: Config,
        sides: Sides,
    ) -> Result<(Self, Hub, mpsc::Receiver<PendingCall>), BindError> {
        let listener =
            Listener::open(&stage.server, config.listen, config.socket.as_deref(), &config.folder)?;
        let metrics = Arc::clone(&listener.context.metrics);
        let limits = listener.context.limits.clone();
        let topics = topics_of(stage, &config.more_topics);
        let about = StageInfo {
            epoch_utc_ns: config.epoch_utc_ns,
            topics,
            last_event_id: config.counters.last_event_id(),
            replay: config.replay,
            operable: true,
            problems: config.problems,
        };
        let StageServices { shared, viewers, commands, calls } =
            StageServices::new(stage, about, &listener.context, Arc::clone(&metrics));
        let hub = Hub::default();
        let vrpn = match stage.vrpn.as_ref().filter(|_| !config.replay) {
            None => None,
            Some(settings) => {
                let names = stage.sensors.iter().map(|sensor| sensor.name.as_str());
                let publisher = Publisher::new(Catalogue::new(names, config.epoch_utc_ns));
                let bound = Vrpn::bind(settings, publisher, &limits, Arc::clone(&metrics));
                Some(bound.map_err(|(listen, error)| BindError::Vrpn { listen, error })?)
            }
        };
        let (vrpn, vrpn_outlet) = vrpn.unzip();
        let datagrams = if config.replay { Vec::new() } else { datagrams::Outlet::open(stage, &metrics)? };
        let lsl = stage.lsl.as_ref().zip(config.clock.filter(|_| !config.replay));
        let lsl = lsl.map(|(settings, clock)| Streaming::start(stage, settings, clock, Arc::clone(&metrics)));
        let distributor = Distributor::new(Arc::clone(&shared.names), limits, metrics, config.counters);
        let Sides { feeds, shelf, files, phones } = sides;
        let phones = phones.map(|place| Phones::new(stage, place, config.folder, &listener.context));
        if let Some(phones) = &phones {
            phones.hear_from(shared.reports.newest());
        }
        let files = files.map(|folder| Files::new(folder, &listener.context));
        let takes = shelf.map(|shelf| Takes::new(shelf, &listener.context));
        let outlets = Outlets {
            distributor,
            viewers,
            vrpn: vrpn_outlet,
            datagrams,
            lsl,
            feeds,
            phones: phones.clone(),
        };
        let hub_in = hub.clone();
        let server = Self { listener, shared, outlets, vrpn, hub: hub_in, commands, takes, files, phones };
        Ok((server, hub, calls))
    }

    /// The address it listens on, with the port that the system chose if it was 0.
    pub fn address(&self) -> SocketAddr {
        self.listener.address()
    }

    /// The address for VRPN clients; `None` where the stage does not serve them, and for a replay.
    pub fn vrpn_address(&self) -> Option<SocketAddr> {
        self.vrpn.as_ref().and_then(|vrpn| vrpn.address().ok())
    }

    /// The address to open in a browser: `http://HOST:PORT/` or `https://...`, on loopback where it listens on all addresses.
    pub fn url(&self) -> String {
        self.listener.url()
    }

    /// Whether another stage follows, which the end of a connection reports.
    pub(super) fn makes_way(&self) -> MakesWay {
        self.listener.context.makes_way.clone()
    }

    /// What serves phones; `None` for a replay.
    pub(super) fn phones(&self) -> Option<Phones> {
        self.phones.clone()
    }

    /// The newest status that clients have been sent.
    pub(super) fn status(&self) -> watch::Receiver<Status> {
        self.shared.reports.newest()
    }

    /// Serves until `shutdown` resolves; then tells every client goodbye (1001) and returns within the shutdown timeout. A part
    /// that ends before is reported by `vital`.
    pub async fn run(self, shutdown: impl Future<Output = ()>, vital: Vital) {
        let Self { listener, shared, outlets, vrpn, hub, commands, takes, files, phones } = self;
        if let Some(phones) = &phones {
            phones.open_if_read();
        }
        let distributing = distribute(outlets, hub, commands, Arc::clone(&shared));
        let distributing = tokio::spawn(vital.task("what sends to clients", distributing));
        let others = vrpn.map(|vrpn| vital.task("what serves VRPN", vrpn.run(listener.report.subscribe())));
        let others = others.map(tokio::spawn);
        listener.serve(http::router(shared, takes, files, phones), shutdown).await;
        distributing.abort();
        // What it holds has then ended too.
        let _ = distributing.await;
        if let Some(others) = others {
            // Notified at the same time, and bounded by itself.
            let _ = others.await;
        }
    }
}

/// Whether the files that the server of a stage needs serve.
pub(super) fn check_files(stage: &Stage, folder: &Path) -> Result<(), BindError> {
    stage.server.tls.as_ref().map(|files| tls::acceptor(files, folder)).transpose()?;
    Ok(())
}

/// What a stage publishes; `more` beside what its file specifies.
fn topics_of(stage: &Stage, more: &[Topic]) -> Vec<Topic> {
    let mut topics = vec![
        Topic::Status,
        Topic::Sensors,
        Topic::Faults,
        Topic::Field,
        Topic::Jobs,
        Topic::Session,
        Topic::Marks,
    ];
    // Whatever is tracked can be taught and counted, and learnt to be named.
    topics.extend((!stage.sensors.is_empty()).then_some(Topic::Exercise));
    topics.extend((!stage.sensors.is_empty()).then_some(Topic::Segments));
    topics.extend(BodyLayout::all(stage).iter().any(Option::is_some).then_some(Topic::Body));
    topics.extend(stage.keyframes.is_some().then_some(Topic::Keyframes));
    topics.extend(stage.timecode.is_some().then_some(Topic::Timecode));
    topics.extend_from_slice(more);
    topics.extend(stage.simulation.is_some().then_some(Topic::Truth));
    topics.sort();
    topics.dedup();
    topics
}

/// What clients of a stage must get first that its file does not say.
struct StageInfo {
    epoch_utc_ns: i64,
    topics: Vec<Topic>,
    last_event_id: u64,
    replay: bool,
    /// Whether its clients may change something, where their token lets them.
    operable: bool,
    /// What went wrong as the daemon was started.
    problems: Vec<Problem>,
}

/// A stage's side of a server: what its clients share, and the ends of the queues that they fill.
struct StageServices {
    shared: Arc<Shared>,
    viewers: Viewers,
    commands: mpsc::Receiver<Command>,
    calls: mpsc::Receiver<PendingCall>,
}

impl StageServices {
    fn new(stage: &Stage, about: StageInfo, context: &Arc<ConnectionContext>, metrics: Arc<Metrics>) -> Self {
        let StageInfo { epoch_utc_ns, topics, last_event_id, replay, operable, problems } = about;
        let names = Arc::new(Names::new(stage));
        let viewers = Viewers::new(stage, &topics, epoch_utc_ns, replay, &metrics);
        let epoch_utc = rfc3339(epoch_utc_ns);
        let (command_sender, commands) = mpsc::channel(COMMANDS);
        let (call_sender, calls) = mpsc::channel(CALLS);
        let shared = Arc::new(Shared {
            context: Arc::clone(context),
            metrics,
            viewing: viewers.greeting(&stage.name, &epoch_utc),
            greeting: Greeting {
                stage: stage.name.clone(),
                epoch_utc,
                bodies: (0..)
                    .zip(&stage.bodies)
                    .map(|(index, body)| hello_body(stage, index, body))
                    .collect(),
                transmitter: stage.transmitter.pose_in_room,
                topics,
            },
            names,
            commands: command_sender,
            calls: call_sender,
            operable,
            problems,
            reports: Reports::new(),
            last_event_id: last_event_id.into(),
            next_client: 0.into(),
        });
        Self { shared, viewers, commands, calls }
    }
}

/// Everything that is published to.
struct Outlets {
    distributor: Distributor,
    viewers: Viewers,
    vrpn: Option<Outlet>,
    datagrams: Vec<datagrams::Outlet>,
    lsl: Option<Streaming>,
    /// Programs on other machines.
    feeds: Vec<Box<dyn Feed>>,
    phones: Option<Phones>,
}

/// Feeds the outlets, one thing at a time; frames before commands.
async fn distribute(
    mut outlets: Outlets,
    hub: Hub,
    mut commands: mpsc::Receiver<Command>,
    shared: Arc<Shared>,
) {
    use std::sync::atomic::Ordering;
    let Outlets { distributor, viewers, vrpn, datagrams, lsl, feeds, phones } = &mut outlets;
    loop {
        while let Some(mut item) = hub.take() {
            let _ = fault_points::pass("distributor");
            if matches!(item, hub::Item::Estimate(_)) {
                shared.metrics.frames.inc();
            }
            distributor.complete(&mut item, viewers.count());
            if let hub::Item::Status(status) = &mut item {
                status.problems.extend(lsl.as_ref().and_then(Streaming::problem));
                status.problems.extend_from_slice(&shared.problems);
                status.problems.extend(feeds.iter().filter_map(|feed| feed.problem()));
                status.problems.extend(phones.as_ref().and_then(Phones::problem));
                shared.metrics.take(status);
            }
            let stamp = distributor.stamp(&item);
            if let Some(outlet) = vrpn {
                outlet.publish(&item);
            }
            datagrams.iter_mut().for_each(|outlet| outlet.publish(&item));
            if let (Some(streaming), Some(stamp)) = (&lsl, &stamp) {
                streaming.publish(&item, stamp, &shared.names);
            }
            if let Some(stamp) = &stamp {
                feeds.iter().for_each(|feed| feed.publish(&item, stamp, &shared.names));
            }
            viewers.publish(&item, stamp.as_ref());
            if let hub::Item::Status(status) = &item {
                shared.reports.passed_on(status);
            }
            if let Some(replaced) = distributor.publish(item, stamp) {
                hub.recycle(replaced);
            }
            shared.last_event_id.store(distributor.last_event_id(), Ordering::Relaxed);
            // The clients' tasks that were just woken go first.
            tokio::task::yield_now().await;
        }
        tokio::select! {
            biased;
            () = hub.filled() => {}
            Some(command) = commands.recv() => match command {
                Command::Client(command) => distributor.handle(command),
                Command::Viewer(command) => viewers.handle(command),
            },
        }
    }
}

/// A UTC time in nanoseconds since 1970 as RFC 3339 writes it, with nine decimals and `Z`; empty where that cannot.
pub fn rfc3339(utc_ns: i64) -> String {
    match jiff::Timestamp::from_nanosecond(utc_ns.into()) {
        Ok(utc) => format!("{utc:.9}"),
        Err(_) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn epoch_has_nanoseconds() {
        assert_eq!(super::rfc3339(1_700_000_000_000_000_001), "2023-11-14T22:13:20.000000001Z");
        assert_eq!(super::rfc3339(0), "1970-01-01T00:00:00.000000000Z");
    }
}
