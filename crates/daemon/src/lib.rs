//! The daemon: everything that owns a thread, a socket, a file or a clock.
//!
//! ```text
//!  port task ┐  read, stamp                               ┌─> hub ──> server ──> clients
//!  port task ┼──────────────> inbox ──> fusion thread ────┼─> recorder thread
//!  timer     ┘  Entry         bounded  Supervised::push   └─> port tasks
//! ```
//! Ports push what they read into one [`inbox`]; the [`fusion`] thread takes it from there, records it, pushes it
//! through the pipeline and hands the outputs on. What clients ask for is carried out by [`calls`]. No client, disk or device makes
//! that thread wait. It knows no other machine: a [`link`] is given to it.
//!
//! ```no_run
//! use posed_daemon::{Daemon, Options};
//! use posed_stage::Stage;
//!
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! let text = std::fs::read_to_string("stage.toml")?;
//! let daemon = Daemon::start(Options::new(Stage::parse(&text)?, text, ".".into()))?;
//! eprintln!("open {}", daemon.url());
//! daemon.shutdown().await;
//! # Ok(())
//! # }
//! ```

mod calibration;
mod calls;
mod clock;
mod fault_points;
pub mod find;
mod free_space;
mod fusion;
mod host_clock;
mod inbox;
mod jobs;
mod library;
pub mod link;
mod look;
mod lsl;
mod models;
mod observers;
mod playback;
mod player;
mod ports;
mod process_limits;
mod recorder;
pub mod recordings;
pub mod server;
mod service;
mod stages;
mod timecode;
mod track;
mod training;
mod vital;
mod waypoints;

use std::any::Any;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use posed_drivers::port::Port;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::{mpsc, watch};

pub use self::calibration::{FieldMapError, Unfit};
pub use self::clock::StageClock;
pub use self::fusion::{Begin, BeginError, Ended, FusionInbox, RecordError};
pub use self::library::forget as forget_recording;
pub use self::models::ModelError;
pub use self::observers::{Observer, Times};
pub use self::playback::{Playback, PlaybackError};
pub use self::ports::ended;
pub use self::stages::{Check, MakeOptions, StageFile, Stages};
pub use self::vital::{PartEnded, Vital};

use self::calibration::{Calibration, MapInUse};
use self::calls::{Calls, Services};
use self::free_space::FreeSpace;
use self::fusion::{Command, Fusion, INBOX_CAPACITY};
use self::inbox::Inbox;
use self::jobs::Jobs;
use self::library::TakeLibrary;
use self::link::Link;
use self::models::{Library, Loaded};
use self::observers::Observers;
use self::ports::{DevicePort, PortTask};
use self::recorder::Gathering;
use self::server::phones::{Gate, PhonePlace, PhoneSocket, Phones};
use self::server::{BindError, Server, Sides};
use self::service::Service;
use self::stages::Editor;
use self::timecode::TimecodeSource;
use self::training::{Tools, Training};
use posed_motion::segments::Model;
use posed_pipeline::{PipelineError, SupervisedPipeline};
use posed_protocol::foxglove::Views;
use posed_protocol::{Fields, Problem, Publisher, Status, Topic};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};
use posed_stage::layout::BodyLayout;

/// Commands that wait for a port that writes slowly.
const PORT_COMMANDS: usize = 256;

/// What a daemon is started with.
#[derive(Clone, Debug)]
pub struct Options {
    /// The stage, as its file describes it.
    pub stage: Stage,
    /// The text of its file, which every recording holds.
    pub stage_toml: String,
    /// Folder that relative paths of the stage file start from.
    pub folder: PathBuf,
    /// Folder where recordings, field maps, intrinsics of IMUs and exercises are kept unless the stage file specifies otherwise.
    pub data: PathBuf,
    /// `HOST:PORT` to listen on instead of the stage file's; port 0 lets the system choose. Absent: the stage file's, else
    /// [`server::DEFAULT_LISTEN`].
    pub listen: Option<String>,
    /// Record into this file from the start; it must not exist. Absent: nothing is recorded until a client asks for it.
    pub record: Option<PathBuf>,
    /// Whether a simulator will send ground truth: the topic `truth` is published then, as it is for every simulated stage.
    pub truth: bool,
    /// The stage's clock; its epoch is when the options were made.
    pub clock: StageClock,
    /// What connects the stage to other machines, where its file has `[zenoh]`. Absent, such a stage runs without, and its status
    /// reports the problem.
    pub link: Option<link::Connect>,
    /// What publishes for ROS 2, where the stage file has `[ros2]`; absent, as with `link`.
    pub ros2: Option<link::Connect>,
}

impl Options {
    /// For a stage in `folder`, which also takes what is kept, with everything else as the stage file specifies. Starts the
    /// clock.
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
            link: None,
            ros2: None,
        }
    }
}

/// Why a daemon cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The server cannot listen.
    #[error(transparent)]
    Bind(#[from] BindError),
    /// The pipeline refuses the stage.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A model that the stage file names cannot be read or does not fit the stage.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The field map that the stage file names cannot be read.
    #[error(transparent)]
    Field(#[from] FieldMapError),
    /// The recording asked for cannot begin.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A thread could not be made.
    #[error("the system gives no thread: {0}")]
    Thread(std::io::Error),
}

/// A running daemon; ends with [`Daemon::shutdown`]. Dropped without it, the fusion thread goes on and a recording does not end.
pub struct Daemon {
    clock: StageClock,
    service: Service,
    inbox: FusionInbox,
    ports: Vec<Option<PortTask>>,
    /// Where what comes over the websocket `/imu` meets the port of its device.
    gate: Option<Gate>,
    fusion: std::thread::JoinHandle<()>,
    /// Dropped at the end.
    links: Vec<Box<dyn Any + Send>>,
}

impl Daemon {
    /// Binds the server, starts the fusion thread, opens every device's port. Reads files: it may block for a moment. A port that
    /// does not open is no error: it is tried again until the end.
    ///
    /// # Errors
    /// The address, the stage, one of its models or the recording's file do not serve; see [`StartError`].
    ///
    /// # Panics
    /// Outside a tokio runtime with IO.
    pub fn start(options: Options) -> Result<Self, StartError> {
        Self::start_at(options, Place::default())
    }

    fn start_at(options: Options, place: Place) -> Result<Self, StartError> {
        let places: Vec<_> = (0..).map_while(|index| DevicePort::of(&options.stage, index)).collect();
        let mut daemon = Self::begin(options, place)?;
        for (place, port) in places.into_iter().zip(&mut daemon.ports) {
            let Some(task) = port.take() else { continue };
            let part = format!("the port of {}", place.device());
            match daemon.gate.clone().filter(|_| place.is_websocket()) {
                Some(gate) => daemon.service.spawn(part, task.lead_websocket(gate)),
                None => daemon.service.spawn(part, task.keep_open(place)),
            }
        }
        Ok(daemon)
    }

    /// Like [`Daemon::start`], but no port is opened: [`Daemon::attach`] gives devices their streams.
    ///
    /// # Errors
    /// As for [`Daemon::start`].
    ///
    /// # Panics
    /// As for [`Daemon::start`].
    pub fn start_without_ports(options: Options) -> Result<Self, StartError> {
        Self::begin(options, Place::default())
    }

    fn begin(options: Options, place: Place) -> Result<Self, StartError> {
        let Options { stage, stage_toml, folder, data, listen, record, truth, clock, link, ros2 } = options;
        process_limits::raise();
        let loaded = models::load(&stage, &data)?;
        let in_use = MapInUse::read(&stage, &data)?;
        let mut config = server::Config::new(&folder, clock.epoch_utc_ns());
        config.problems = left_out(&loaded, &in_use);
        config.problems.extend(place.problems);
        config.listen = listen;
        config.socket = place.socket;
        config.clock = Some(clock);
        config.more_topics = if truth { vec![Topic::Truth] } else { Vec::new() };
        let inbox = Inbox::new(INBOX_CAPACITY);
        let recordings = stage.recording.folder.clone().unwrap_or_else(|| data.join("recordings"));
        let (mut feeds, mut links, mut log) = (Vec::new(), Vec::new(), None);
        let asked = [("zenoh", stage.zenoh.is_some(), link), ("ros2", stage.ros2.is_some(), ros2)];
        for (table, _, connect) in asked.into_iter().filter(|(_, is_asked, _)| *is_asked) {
            let context =
                link::Context { stage: &stage, clock, inbox: inbox.clone(), recordings: recordings.clone() };
            match connect.ok_or_else(|| link::absent(table).into()).and_then(|connect| connect(context)) {
                Ok(Link { feed, log: logs, session }) => {
                    feeds.push(feed);
                    links.push(session);
                    log = log.or(logs);
                }
                // The stage runs without it too.
                Err(error) => {
                    tracing::warn!("{error}");
                    config.problems.push(Problem::new(table, error.to_string()));
                }
            }
        }
        let library = TakeLibrary::start(recordings.clone()).map_err(StartError::Thread)?;
        let shelf = playback::Recordings::new(recordings.clone(), library.clone());
        let phones = PhonePlace { data: data.clone(), socket: place.phones, clock };
        let sides = Sides {
            feeds,
            shelf: Some(Arc::new(shelf)),
            files: Some(recordings.clone()),
            phones: Some(phones),
        };
        let (server, hub, pending) = Server::bind_with(&stage, config, sides)?;
        let phones = server.phones();
        let gate = phones.as_ref().map(Phones::gate);
        let mut service = Service::start(server);
        let jobs = Jobs::new(clock, hub.clone());

        let mut commands = Vec::new();
        let mut ports = Vec::new();
        for device in 0..stage.devices.len() {
            let (sender, receiver) = mpsc::channel(PORT_COMMANDS);
            commands.push(sender);
            let (inbox, shutdown) = (inbox.clone(), service.down());
            let device = device as u16;
            ports.push(Some(PortTask { device, clock, inbox, commands: receiver, shutdown }));
        }
        let disk = FreeSpace::new();
        let calibration = Calibration::new(&stage, &data, clock, inbox.clone(), jobs.clone());
        calibration.begin(in_use);
        if let Some(segments) = &stage.segments {
            // First of all entries: every recording of this run holds it, and every replay begins with it.
            let input = Input::SegmentationNetwork(network(&stage, &segments.model)?);
            inbox.enter(Entry { t: clock.now(), input });
        }
        let exercises = Library::new(models::exercise_folder(&stage, &data), "json");
        let tools = Tools { clock, hub: hub.clone(), inbox: inbox.clone(), exercises };
        let (training, follow) = Training::new(&stage, &data, tools);
        let mut fusion = Fusion {
            clock,
            inbox: inbox.clone(),
            pipeline: SupervisedPipeline::new(&stage)?,
            publisher: Publisher::new(&stage, Fields::all()),
            views: Views::new(&stage, clock.epoch_utc_ns(), stage.recording.content),
            hub,
            jobs: jobs.clone(),
            ports: commands,
            observers: Observers::new(&stage, calibration.clone(), follow, log),
            recording: None,
            ending: Vec::new(),
            entries: 0,
            recording_header: posed_recording::Header::new(&stage, &stage_toml, clock.epoch_utc_ns()),
            gathering: Gathering::new(&stage),
            in_use: library.in_use().clone(),
        };
        let history = fusion.observers.health.history();
        fusion.observers.health.watch_disk(disk.clone());
        let timecode =
            stage.timecode.clone().map(|settings| TimecodeSource::new(settings, clock, inbox.clone()));
        fusion.observers.health.watch_timecode(timecode.as_ref().map(TimecodeSource::problem));
        for model in loaded.models {
            // Before anything else, and in the log.
            let input = Input::Model(model);
            inbox.enter(Entry { t: clock.now(), input });
        }
        if let Some(path) = record {
            // Nothing is tracked yet: this may wait for the disk.
            let (to, begun) = std::sync::mpsc::sync_channel(1);
            fusion.start_recording(path, false, move |begun| _ = to.send(begun));
            begun.recv().unwrap_or(Err(RecordError::NoThread))?;
        }
        let sessions = training.start().map_err(StartError::Thread)?;
        #[expect(clippy::disallowed_methods, reason = "the daemon owns the fusion thread")]
        let fusion = std::thread::Builder::new()
            .name("fusion".into())
            .spawn(service.vital().thread("tracking", move || {
                fusion.run();
                // It ends with what follows the tracking.
                let _ = sessions.join();
            }))
            .map_err(StartError::Thread)?;

        let sessions = training.clone();
        library.on_rename(Box::new(move |from, to| sessions.recording_renamed(from, to)));
        let services =
            Services { clock, inbox: inbox.clone(), jobs, calibration, training, library, history };
        let calls = Calls::new(&stage, data, services);
        let calls = calls.on_file(stage_toml, place.editor).with_phones(phones);
        let calls = calls.run(pending, service.down());
        service.spawn("what answers requests", calls);
        if let Some(timecode) = timecode {
            service.spawn("what reads time code", timecode.keep_open(service.down()));
        }
        service.spawn("what looks at the disk", disk.watch(recordings, service.down()));
        Ok(Self { clock, service, inbox, ports, gate, fusion, links })
    }

    /// Gives a device (index in the stage's list) an open stream instead of its port; it is not opened again when it ends. Does
    /// nothing where the stage has no such device, or where its port or another stream serves it already.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub fn attach<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(&mut self, device: u16, stream: S) {
        if let Some(mut task) = self.ports.get_mut(usize::from(device)).and_then(Option::take) {
            // A stream that ends is no port that can be opened again.
            self.service.spawn_aside(async move {
                if let Some(reason) = task.serve_once(Port::new(stream)).await {
                    task.closed(reason);
                }
            });
        }
    }

    /// The stage's clock: the one of the options.
    pub fn clock(&self) -> StageClock {
        self.clock
    }

    /// Where entries for the pipeline go in, beside what the ports read: a simulator's ground truth.
    pub fn inbox(&self) -> FusionInbox {
        self.inbox.clone()
    }

    /// The address the server listens on, with the port that the system chose if it was 0.
    pub fn address(&self) -> SocketAddr {
        self.service.address()
    }

    /// The address for VRPN clients; `None` where the stage does not serve them.
    pub fn vrpn_address(&self) -> Option<SocketAddr> {
        self.service.vrpn_address()
    }

    /// The address to open in a browser: `http://HOST:PORT/` or `https://...`, on loopback where the server listens on all
    /// addresses.
    pub fn url(&self) -> &str {
        self.service.url()
    }

    /// The first part of the daemon that ended before [`Self::shutdown`], once there is one: nothing more can be expected of the
    /// daemon then but an orderly end. `None` until then.
    pub fn part_ended(&self) -> watch::Receiver<Option<PartEnded>> {
        self.service.part_ended()
    }

    /// The newest status that clients have been sent: at least one a second while tracking and server live; empty before the first.
    pub fn status(&self) -> watch::Receiver<Status> {
        self.service.status()
    }

    /// Ends for another daemon at the same socket: clients are asked to connect again.
    async fn make_way(self) {
        self.service.make_way();
        self.shutdown().await;
    }

    /// Ends everything: the recording is complete, clients are notified of the end. Takes less than five seconds, and what a link
    /// to other machines takes to end. What does not end in time is left behind, and the log says so.
    pub async fn shutdown(self) {
        self.inbox.command(Command::Shutdown);
        self.service.shutdown(self.fusion).await;
        // Its threads may be waiting for a link.
        let _ = tokio::task::spawn_blocking(move || drop(self.links)).await;
    }
}

/// What a daemon has from whoever runs one after the other; nothing by default.
#[derive(Clone, Default)]
struct Place {
    /// An open socket to serve clients at.
    socket: Option<Arc<std::net::TcpListener>>,
    /// Where phones come, once one is to.
    phones: PhoneSocket,
    /// The stage file, where clients may change it.
    editor: Option<Editor>,
    /// What went wrong before.
    problems: Vec<Problem>,
}

/// Whether a daemon could start with these options, as far as can be known while another one has its ports and addresses. Reads files.
fn rehearse(options: &Options) -> Result<(), StartError> {
    let Options { stage, data, folder, .. } = options;
    models::load(stage, data)?;
    MapInUse::read(stage, data)?;
    if let Some(segments) = &stage.segments {
        network(stage, &segments.model)?;
    }
    server::check_files(stage, folder)?;
    SupervisedPipeline::new(stage)?;
    Ok(())
}

/// What is reported of kept files that cannot be used: a daemon without them is better than none.
fn left_out(loaded: &Loaded, in_use: &MapInUse) -> Vec<Problem> {
    let units = loaded.left_out.iter().map(|error| {
        let fix = "the unit runs uncalibrated: calibrate it again, or put the file right and restart posed";
        ("imu_file", format!("an IMU's calibration is left out: {error}; {fix}"))
    });
    let map = in_use.left_out.iter().map(|error| {
        let fix = "field.rollback takes the version before it; or calibrate again";
        ("field_map", format!("the field map in use is left out: {error}; {fix}"))
    });
    let problems = units.chain(map).map(|(code, message)| {
        tracing::warn!("{message}");
        Problem::new(code, message)
    });
    problems.collect()
}

/// Reads the model of segments.
fn network(stage: &Stage, path: &Path) -> Result<Vec<u8>, ModelError> {
    let unread = |error| ModelError::Read { path: path.to_owned(), error };
    let bytes = std::fs::read(path).map_err(unread)?;
    let model = Model::from_bytes(&bytes).map_err(|error| error.to_string());
    let layouts = BodyLayout::all(stage);
    let names = stage.sensors.iter().map(|sensor| sensor.name.as_str());
    let names = names.chain(layouts.iter().flatten().flat_map(BodyLayout::places));
    let fits = model.and_then(|model| model.columns(names));
    fits.map_err(|reason| ModelError::File { path: path.to_owned(), reason }).map(|_| bytes)
}
