//! `posed demo`: a simulated stage, the daemon and the page in one process.
//!
//! The devices are virtual, everything else is what `posed run` does: the driver opens a pseudo-terminal and talks to
//! a unit that does not know it is not one. The fault map is learnt from a rehearsal while the stage already runs.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use posed_daemon::{Daemon, FusionInbox, StageClock};
use posed_drivers::Timestamp;
use posed_simulator::host::{Clock, Host, Watcher};
use posed_simulator::stage::{Event, Output};
use posed_simulator::truth::TruthCycle;
use posed_stage::Stage;
use posed_stage::input::{Entry, Input, Model, Truth, TruthSensor};

use super::run::{options, runtime};
use super::{Error, rehearsal, simulation, watch};

/// The stage that is built in.
const STAGE: &str = include_str!("../../config/demo.toml");

/// Names what the person of that stage does.
const MOVES: &[u8] = include_bytes!("../../config/demo-moves.safetensors");

/// What its floor and the leg of its table do to the field.
const FIELD: &[u8] = include_bytes!("../../config/demo-field.json");

/// What to show.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed demo\n\nThen open the address that it prints; Ctrl-C ends it.")]
pub(crate) struct Args {
    /// Address for the page and the websocket, in place of the stage's.
    #[arg(long, value_name = "HOST:PORT")]
    listen: Option<String>,
    /// Simulate another stage file than the one that is built in.
    #[arg(long, value_name = "STAGE.toml")]
    stage: Option<PathBuf>,
    /// Record everything that comes in, from the first byte on.
    #[arg(long, value_name = "REC.mcap")]
    record: Option<PathBuf>,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let ports = tempfile::Builder::new()
        .prefix("posed-")
        .tempdir()
        .map_err(|error| Error::Failed(format!("cannot make a folder for the ports: {error}")))?;
    let (stage, text, folder) = match &args.stage {
        Some(path) => {
            let text = std::fs::read_to_string(path).map_err(|error| Error::file("read", path, &error))?;
            let folder = path.parent().unwrap_or(Path::new("")).to_owned();
            (Stage::load(path).map_err(Error::failed)?, text, folder)
        }
        None => {
            let mut stage = Stage::parse(STAGE).map_err(Error::failed)?;
            let unpack = |path: &mut PathBuf, bytes: &[u8]| {
                *path = ports.path().join(&*path);
                std::fs::write(&*path, bytes).map_err(|error| Error::file("write", path, &error))
            };
            if let Some(segments) = &mut stage.segments {
                unpack(&mut segments.model, MOVES)?;
            }
            if let Some(field) = &mut stage.models.field {
                unpack(field, FIELD)?;
            }
            (stage, STAGE.to_owned(), PathBuf::new())
        }
    };
    let duration_s = simulation::scenario(&stage)?.duration_s;
    let devices = simulation::virtual_stage(&stage, &folder)?;
    let rehearsed = args.stage.is_none().then(|| stage.clone());
    let mut options = options(stage, text, folder);
    options.listen = args.listen;
    options.record = args.record;
    options.truth = true;

    runtime()?.block_on(async {
        // The devices come first, since the daemon must know their ports; their truth waits for its inbox.
        let inbox = Arc::new(OnceLock::new());
        let clock = Clock::since(options.clock.instant(Timestamp::ZERO));
        let host = Host::open(devices, ports.path(), clock, truth_to(Arc::clone(&inbox)))
            .map_err(|error| Error::Failed(format!("cannot make the virtual ports: {error}")))?;
        for (device, info) in options.stage.devices.iter_mut().zip(host.devices()) {
            device.port.clone_from(&info.port);
        }
        let daemon = Daemon::start(options).map_err(Error::failed)?;
        let _ = inbox.set(daemon.inbox());
        if let Some(stage) = rehearsed {
            rehearse(stage, daemon.inbox(), daemon.clock());
        }
        watch::announce(daemon.vrpn_address())?;
        let ended = watch::until_end(daemon.url(), daemon.status(), daemon.part_ended(), duration_s).await;
        // The daemon first: to it, devices that end would be unplugged.
        daemon.shutdown().await;
        let stopped =
            host.stop().await.map_err(|error| Error::Failed(format!("a virtual device failed: {error}")));
        ended.and(stopped)
    })
}

/// Learns a fault map beside the stage, and swaps it in.
#[expect(
    clippy::disallowed_methods,
    reason = "nobody waits for it: neither the page at the start, nor the end"
)]
fn rehearse(stage: Stage, inbox: FusionInbox, clock: StageClock) {
    std::thread::spawn(move || match rehearsal::learn_faults(&stage, Path::new("")) {
        Ok(Some(fault_map)) => {
            let input = Input::Model(Model::Faults { fault_map: Box::new(fault_map) });
            inbox.enter(Entry { t: clock.now(), input });
        }
        Ok(None) => {}
        Err(error) => tracing::warn!("the fault map was not learnt: {error}"),
    });
}

/// Sends the truth to the `truth` topic.
fn truth_to(inbox: Arc<OnceLock<FusionInbox>>) -> Watcher {
    Arc::new(move |event: &Event| {
        if let (Output::Truth(cycle), Some(inbox)) = (&event.output, inbox.get()) {
            publish(inbox, cycle);
        }
    })
}

fn publish(inbox: &FusionInbox, cycle: &TruthCycle) {
    let sensor = |row: &posed_simulator::truth::TruthRow| {
        let (t, q) = (row.pose.translation.vector, row.pose.rotation.into_inner());
        TruthSensor {
            sensor: row.sensor as u16,
            position_m: t.into(),
            orientation_wxyz: [q.w, q.i, q.j, q.k],
            class: row.class.name().to_owned(),
        }
    };
    let truth = Truth { t_valid: cycle.t, sensors: cycle.sensors.iter().map(sensor).collect() };
    inbox.enter(Entry { t: cycle.t, input: Input::Truth(truth) });
}
