//! The daemon: everything that owns a thread, a socket, a file or a clock.
//!
//! ```text
//!  port task ┐  read, stamp                               ┌─> hub ──> server ──> clients
//!  port task ┼──────────────> inbox ──> fusion thread ────┼─> recorder thread
//!  timer     ┘  Entry         bounded   Pipeline::push    └─> port tasks
//! ```
//! Ports push what they read into one [`inbox`]; the [`fusion`] thread takes it from there, records it, pushes it
//! through the pipeline and hands the outputs on. What clients ask for is carried out by [`calls`].

mod calibration;
pub mod calls;
mod chained;
pub mod clock;
#[cfg(feature = "zenoh")]
pub mod collector;
pub mod find;
pub mod fusion;
mod health;
pub mod inbox;
mod jobs;
mod laid;
mod limits;
mod lsl;
mod mesh;
pub mod models;
mod playback;
mod player;
pub mod ports;
mod positions;
mod recent;
pub mod recorder;
pub mod server;
mod service;
mod track;
mod waved;
mod worn;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use posed_drivers::port::Port;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::{mpsc, watch};

pub use self::playback::{Playback, PlaybackError};

use self::calibration::Calibration;
use self::calls::Calls;
use self::chained::Chained;
use self::clock::StageClock;
use self::fusion::{Command, Fusion, FusionInbox, INBOX_CAPACITY};
use self::health::Health;
use self::inbox::{Event, Inbox};
use self::jobs::Jobs;
use self::laid::Laid;
use self::mesh::Mesh;
use self::ports::{Place, PortTask};
use self::positions::RecentPositions;
use self::recent::Recent;
use self::server::{BindError, Server};
use self::service::Service;
use self::waved::Waved;
use self::worn::Worn;
use crate::foxglove::Views;
use crate::input::{Entry, Input};
use crate::layout::BodyLayout;
use crate::motion::segments::Model;
use crate::pipeline::{Pipeline, PipelineError};
use crate::protocol::{Fields, Problem, Publisher, Status, Topic};
use crate::stage::Stage;

/// Commands that wait for a port that writes slowly.
const PORT_COMMANDS: usize = 256;

/// What a daemon is started with.
#[derive(Clone, Debug)]
pub struct Options {
    /// The stage.
    pub stage: Stage,
    /// Its file's text, for recordings.
    pub stage_toml: String,
    /// Folder that relative paths of the stage file start from.
    pub folder: PathBuf,
    /// Where recordings, maps and exercises are kept unless the stage file says otherwise.
    pub data: PathBuf,
    /// `HOST:PORT` instead of the stage file's.
    pub listen: Option<String>,
    /// Record into this file from the start.
    pub record: Option<PathBuf>,
    /// Whether a simulator will send ground truth.
    pub truth: bool,
    /// The stage's clock; its epoch is when the options were made.
    pub clock: StageClock,
}

impl Options {
    /// For a stage in `folder`, which also takes what is kept, with everything else as the stage file says.
    pub fn new(stage: Stage, stage_toml: String, folder: PathBuf) -> Self {
        Self {
            stage,
            stage_toml,
            data: folder.clone(),
            folder,
            listen: None,
            record: None,
            truth: false,
            clock: StageClock::start(),
        }
    }
}

/// Why a daemon cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The server.
    #[error(transparent)]
    Bind(#[from] BindError),
    /// The pipeline.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A model that the stage file names.
    #[error("{0}")]
    Model(String),
    /// The recording asked for.
    #[error("{0}")]
    Record(String),
    /// The model of segments.
    #[error("{0}")]
    Segments(String),
    /// A thread could not be made.
    #[error("the system gives no thread: {0}")]
    Thread(std::io::Error),
}

/// A running daemon; ends with [`Daemon::shutdown`].
pub struct Daemon {
    clock: StageClock,
    service: Service,
    inbox: FusionInbox,
    status: watch::Receiver<Status>,
    ports: Vec<Option<PortTask>>,
    fusion: std::thread::JoinHandle<()>,
    mesh: Option<Mesh>,
}

impl Daemon {
    /// Binds the server, starts the fusion thread, opens every device's port. Needs a tokio runtime.
    ///
    /// # Errors
    /// The address, the stage or the recording's file do not serve.
    pub fn start(options: Options) -> Result<Self, StartError> {
        let places: Vec<_> = (0..).map_while(|index| Place::of(&options.stage, index)).collect();
        let mut daemon = Self::start_without_ports(options)?;
        for (place, port) in places.into_iter().zip(&mut daemon.ports) {
            if let Some(task) = port.take() {
                daemon.service.spawn(task.keep_open(place));
            }
        }
        Ok(daemon)
    }

    /// Like [`Daemon::start`], but no port is opened: [`Daemon::attach`] gives devices their streams.
    ///
    /// # Errors
    /// As for [`Daemon::start`].
    pub fn start_without_ports(options: Options) -> Result<Self, StartError> {
        let Options { stage, stage_toml, folder, data, listen, record, truth, clock } = options;
        limits::raise();
        let models = models::load(&stage, &data).map_err(StartError::Model)?;
        let mut config = server::Config::new(&folder, clock.epoch_utc_ns());
        config.listen = listen;
        config.clock = Some(clock);
        config.more_topics = if truth { vec![Topic::Truth] } else { Vec::new() };
        let inbox = Inbox::new(INBOX_CAPACITY);
        let recordings = stage.recording.folder.clone().unwrap_or_else(|| data.join("recordings"));
        let mesh = stage.zenoh.as_ref().and_then(|settings| {
            let started = Mesh::start(&stage, settings, clock, inbox.clone(), recordings);
            // The stage runs without it too.
            started
                .inspect_err(|sentence| tracing::warn!("{sentence}"))
                .map_err(|sentence| {
                    config.problems.push(Problem { code: "zenoh".to_owned(), message: sentence });
                })
                .ok()
        });
        let feed = mesh.as_ref().map(Mesh::feed);
        let (server, hub, pending) = Server::bind_fed(&stage, config, feed)?;
        let mut service = Service::start(server);
        let jobs = Jobs::new(clock, hub.clone());

        let (status_sender, status) = watch::channel(Status::default());
        let mut commands = Vec::new();
        let mut ports = Vec::new();
        for device in 0..stage.devices.len() {
            let (sender, receiver) = mpsc::channel(PORT_COMMANDS);
            commands.push(sender);
            let (inbox, shutdown) = (inbox.clone(), service.down());
            let device = device as u16;
            ports.push(Some(PortTask { device, clock, inbox, commands: receiver, shutdown }));
        }
        let calibration = Calibration::new(&stage, &data, clock, inbox.clone(), jobs.clone());
        calibration.begin().map_err(StartError::Model)?;
        if let Some(segments) = &stage.segments {
            // First of all entries: every recording of this run holds it, and every replay begins with it.
            let input = Input::Network(network(&stage, &segments.model).map_err(StartError::Segments)?);
            inbox.push(Event::Entry(Entry { t: clock.now(), input }));
        }
        let mut fusion = Fusion {
            clock,
            inbox: inbox.clone(),
            pipeline: Pipeline::new(&stage)?,
            publisher: Publisher::new(&stage, Fields::all()),
            views: Views::new(&stage, clock.epoch_utc_ns()),
            hub,
            log: mesh.as_ref().map(Mesh::log),
            jobs: jobs.clone(),
            calibration: calibration.clone(),
            ports: commands,
            health: Health::new(&stage),
            status: status_sender,
            recording: None,
            ending: Vec::new(),
            begun: false,
            models: Vec::new(),
            recent: Recent::new(&stage),
            worn: Worn::new(&stage),
            waved: Waved::default(),
            laid: Laid::default(),
            chained: Chained::new(&stage),
            positions: RecentPositions::new(&stage),
            recording_header: crate::recording::Header::new(&stage, &stage_toml, clock.epoch_utc_ns()),
        };
        for model in models {
            // Before anything else, and in the log.
            let input = Input::Model(model);
            inbox.push(Event::Entry(Entry { t: clock.now(), input }));
        }
        if let Some(path) = record {
            fusion.start_recording(path).map_err(StartError::Record)?;
        }
        #[expect(clippy::disallowed_methods, reason = "the daemon owns the fusion thread")]
        let fusion = std::thread::Builder::new()
            .name("fusion".into())
            .spawn(move || fusion.run())
            .map_err(StartError::Thread)?;

        let calls = Calls::new(&stage, data, clock, inbox.clone(), jobs, calibration);
        service.spawn(calls.run(pending, service.down()));
        Ok(Self { clock, service, inbox, status, ports, fusion, mesh })
    }

    /// Gives a device an open stream instead of its port; it is not opened again when it ends.
    pub fn attach<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(&mut self, device: u16, stream: S) {
        if let Some(mut task) = self.ports.get_mut(usize::from(device)).and_then(Option::take) {
            self.service.spawn(async move {
                if let Some(reason) = task.pump(Port::new(stream)).await {
                    task.closed(reason);
                }
            });
        }
    }

    /// The stage's clock.
    pub fn clock(&self) -> StageClock {
        self.clock
    }

    /// Where entries go in: for a simulator's truth.
    pub fn inbox(&self) -> FusionInbox {
        self.inbox.clone()
    }

    /// The address the server listens on.
    pub fn address(&self) -> SocketAddr {
        self.service.address()
    }

    /// The address for VRPN clients, if the stage wants them.
    pub fn vrpn_address(&self) -> Option<SocketAddr> {
        self.service.vrpn_address()
    }

    /// What to open in a browser.
    pub fn url(&self) -> &str {
        self.service.url()
    }

    /// The newest status.
    pub fn status(&self) -> watch::Receiver<Status> {
        self.status.clone()
    }

    /// Ends everything: the recording is complete, clients are told goodbye. Takes less than five seconds.
    pub async fn shutdown(self) {
        self.inbox.push(Event::Command(Command::Shutdown));
        self.service.shutdown(self.fusion).await;
        // Its threads may be waiting for a link.
        let _ = tokio::task::spawn_blocking(move || drop(self.mesh)).await;
    }
}

/// Reads the model of segments; the sentence says why it does not serve this stage.
fn network(stage: &Stage, path: &Path) -> Result<Vec<u8>, String> {
    let bytes = std::fs::read(path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    let model = Model::from_bytes(&bytes).map_err(|error| error.to_string());
    let layout = BodyLayout::of(stage);
    let names = stage.sensors.iter().map(|sensor| sensor.name.as_str());
    let names = names.chain(layout.iter().flat_map(BodyLayout::places));
    let fits = model.and_then(|model| model.columns(names));
    fits.map_err(|what| format!("{}: {what}", path.display())).map(|_| bytes)
}
