//! `posed run STAGE.toml`: the daemon on the stage's own devices.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use posed_daemon::{MakeOptions, Options, StageFile, Stages, StartError};
use posed_stage::{PortAddress, Stage};

use super::end::End;
use super::{Error, check, output, service, watch};

/// Time between two attempts to get the address.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);
/// The stage file that the page sets up.
const NEW: &str = "# Every key is explained in config/README.md.\n\nname = \"Stage\"\n";

/// What to run.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  posed run stage.toml\n  posed run --new stage.toml\n  posed run stage.toml --record take-1.mcap\n\n\
    Ctrl-C or SIGTERM ends it within 5 s with exit code 0."
)]
pub(crate) struct Args {
    /// The stage file; `posed check` states whether it is right, `posed doctor --write-stage` writes a first one.
    stage: PathBuf,
    /// Where there is no such file, begin one without devices: the view Set up of the page finds them and writes them into it.
    #[arg(long)]
    new: bool,
    /// Record everything that comes in, from the first byte on.
    #[arg(long, value_name = "REC.mcap")]
    record: Option<PathBuf>,
    /// Address for the page and the websocket, in place of the stage's; anything but loopback needs a token in the stage.
    #[arg(long, value_name = "HOST:PORT")]
    listen: Option<String>,
    /// Where recordings, maps of the field and of faults, and taught exercises are kept unless the stage file specifies otherwise;
    /// absent: beside the stage file.
    #[arg(long, value_name = "FOLDER")]
    data: Option<PathBuf>,
    /// Where the address is not there yet, or another program has its port: try again for as long as it takes, as a service should.
    #[arg(long)]
    wait: bool,
    /// Another port for a device than the stage file specifies; may be given for several.
    #[arg(long = "port", value_name = "DEVICE=PORT", value_parser = port)]
    ports: Vec<(String, String)>,
}

fn port(text: &str) -> Result<(String, String), String> {
    let (device, port) = text.split_once('=').ok_or("write DEVICE=PORT, like flock=/dev/ttyUSB1")?;
    port.parse::<PortAddress>().map_err(|error| error.to_string())?;
    Ok((device.to_owned(), port.to_owned()))
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    if args.new && !args.stage.exists() {
        output::create(&args.stage, |file| file.write_all(NEW.as_bytes()))?;
    }
    let text =
        std::fs::read_to_string(&args.stage).map_err(|error| Error::file("read", &args.stage, &error))?;
    let stage = Stage::load(&args.stage).map_err(Error::failed)?;
    if let Some((name, _)) =
        args.ports.iter().find(|(name, _)| stage.devices.iter().all(|device| device.name != *name))
    {
        return Err(Error::Usage(format!("--port: the stage has no device {name:?}")));
    }
    let folder = args.stage.parent().unwrap_or(Path::new("")).to_owned();
    let data = args.data.unwrap_or_else(|| folder.clone());
    let (listen, ports) = (args.listen, args.ports);
    // The same for the stage as clients change it.
    let options: MakeOptions = Arc::new(move |mut stage, text| {
        for (name, port) in &ports {
            if let Some(device) = stage.devices.iter_mut().find(|device| device.name == *name) {
                device.port.clone_from(port);
            }
        }
        let (listen, data) = (listen.clone(), data.clone());
        Options { listen, data, ..self::options(stage, text, folder.clone()) }
    });
    let first = Options { record: args.record, ..options(stage, text) };
    let file = StageFile { path: args.stage, check: check::of_text, options };
    block_on(async {
        let Some(daemon) = start(first, file, args.wait).await? else { return Ok(()) };
        watch::announce(daemon.vrpn_address())?;
        let ended = watch::until_end(daemon.url(), daemon.status(), daemon.part_ended(), None).await;
        daemon.shutdown().await;
        ended
    })
}

/// Starts the daemon, as often as it takes if it is to `wait` for its address; `None` if it is asked to end meanwhile.
async fn start(options: Options, file: StageFile, wait: bool) -> Result<Option<Stages>, Error> {
    let (mut reported, mut end) = (String::new(), None);
    loop {
        let reason = match Stages::start(options.clone(), file.clone()) {
            Ok(daemon) => return Ok(Some(daemon)),
            Err(StartError::Bind(error)) if wait && error.may_pass() => error.to_string(),
            Err(error) => return Err(Error::failed(error)),
        };
        // Not before, for until then a signal ends the program by itself; and not after it has said that it waits.
        let end = match &mut end {
            Some(end) => end,
            end => end.insert(End::new(None)?),
        };
        if reason != reported {
            tracing::warn!("{reason}; trying again until it goes");
            service::waits(&reason);
            reported = reason;
        }
        if tokio::time::timeout(RETRY_INTERVAL, end.wait()).await.is_ok() {
            return Ok(None);
        }
    }
}

/// What every daemon of this program is started with.
pub(crate) fn options(stage: Stage, text: String, folder: PathBuf) -> Options {
    let options = Options::new(stage, text, folder);
    #[cfg(feature = "zenoh")]
    let options =
        Options { link: Some(posed_mesh::connect), ros2: Some(posed_mesh::publish_ros2), ..options };
    options
}

/// Runs a daemon, or what asks one, on two threads for sockets and ports; the fusion thread is the daemon's own. What hangs on a
/// disk at the end is left behind.
pub(crate) fn block_on<T>(future: impl Future<Output = Result<T, Error>>) -> Result<T, Error> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(|error| Error::Failed(format!("cannot start: {error}")))?;
    let result = runtime.block_on(future);
    runtime.shutdown_background();
    result
}
