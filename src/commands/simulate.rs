//! `posed simulate STAGE.toml`: the virtual devices of a stage, and nothing else, until it is stopped.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use posed_daemon::StageClock;
use posed_drivers::Timestamp;
use posed_simulator::host::{Clock, DeviceInfo, Host, Watcher};
use posed_simulator::stage::{Event, Output};
use posed_simulator::truth::{TruthCycle, TruthWriter};
use posed_stage::Stage;
use serde::Serialize;
use tokio::sync::mpsc;

use super::end::End;
use super::{Error, print, print_json, simulation};

/// What to simulate.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed simulate config/demo.toml --truth truth.csv\n\n\
    Devices at tcp:// and udp:// ports are on this machine, at the same port number.\n\
    Ends at Ctrl-C, at SIGTERM, or after the simulation's duration; the truth is complete then.")]
pub(crate) struct Args {
    /// The stage file; its [simulation] table states what moves and what goes wrong.
    stage: PathBuf,
    /// Write the ground truth: poses in the room and a class, one row per sensor and measurement cycle.
    #[arg(long, value_name = "FILE.csv")]
    truth: Option<PathBuf>,
    /// End after so many seconds; absent: as the [simulation] table says, else at Ctrl-C.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration_s: Option<f64>,
    /// Folder for the serial ports, one link per device with its name; absent: a folder that goes with the simulation.
    #[arg(long, value_name = "FOLDER")]
    ports: Option<PathBuf>,
    /// Print one JSON object once the ports are there: devices, each with name, driver and port.
    #[arg(long)]
    json: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds <= 1e9 => Ok(seconds),
        _ => Err("write a number of seconds above 0".to_owned()),
    }
}

/// What is there to open.
#[derive(Serialize)]
struct Answer<'a> {
    devices: &'a [DeviceInfo],
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let stage = Stage::load(&args.stage).map_err(Error::failed)?;
    if stage.devices.is_empty() {
        return Err(Error::Failed(format!("{} has no [[device]] to simulate", args.stage.display())));
    }
    let temporary;
    let ports = match &args.ports {
        Some(folder) => folder.as_path(),
        None => {
            temporary = tempfile::Builder::new()
                .prefix("posed-")
                .tempdir()
                .map_err(|error| Error::Failed(format!("cannot make a folder for the ports: {error}")))?;
            temporary.path()
        }
    };
    // The devices have threads of their own, so that writing the truth does not delay them.
    super::run::block_on(simulate(&args, &stage, ports))
}

async fn simulate(args: &Args, stage: &Stage, ports: &Path) -> Result<(), Error> {
    let folder = args.stage.parent().unwrap_or(Path::new(""));
    let duration_s = args.duration_s.or(simulation::scenario(stage)?.duration_s);
    let devices = simulation::virtual_stage(stage, folder)?;
    let clock = StageClock::start();
    let truth = args.truth.as_deref().map(|path| Truth::create(path, stage, clock)).transpose()?;
    let mut end = End::new(duration_s)?;

    let (cycles, mut incoming) = mpsc::unbounded_channel();
    let watcher: Watcher = match truth {
        None => Arc::new(|_: &Event| {}),
        Some(_) => Arc::new(move |event: &Event| {
            if let Output::Truth(cycle) = &event.output {
                // Nobody listens any more once writing has failed.
                let _ = cycles.send(cycle.clone());
            }
        }),
    };
    let host = Host::open(devices, ports, Clock::since(clock.instant(Timestamp::ZERO)), watcher)
        .map_err(|error| Error::Failed(format!("cannot make the ports in {}: {error}", ports.display())))?;
    announce(&host, args.json)?;

    let mut truth = truth;
    let ended = loop {
        tokio::select! {
            () = end.wait() => break Ok(()),
            Some(cycle) = incoming.recv() => {
                if let Some(truth) = &mut truth && let Err(error) = truth.write(&cycle) {
                    break Err(error);
                }
            }
        }
    };
    let stopped =
        host.stop().await.map_err(|error| Error::Failed(format!("a virtual device failed: {error}")));
    if let Some(mut truth) = truth {
        // What the devices have reported between the last look and their end.
        while let Ok(cycle) = incoming.try_recv() {
            truth.write(&cycle)?;
        }
        truth.finish()?;
    }
    ended.and(stopped)
}

fn announce(host: &Host, json: bool) -> Result<(), Error> {
    if json {
        return print_json(&Answer { devices: host.devices() });
    }
    for DeviceInfo { name, driver, port } in host.devices() {
        print(&format!("{name}: {driver} at {port}\n"))?;
    }
    print("Ctrl-C ends the simulation.\n")
}

/// The file of the truth.
struct Truth {
    path: PathBuf,
    writer: TruthWriter<BufWriter<File>>,
}

impl Truth {
    fn create(path: &Path, stage: &Stage, clock: StageClock) -> Result<Self, Error> {
        let failed = |error: std::io::Error| Error::file("write", path, &error);
        let file = File::create(path).map_err(failed)?;
        let names = stage.sensors.iter().map(|sensor| sensor.name.clone()).collect();
        let epoch =
            jiff::Timestamp::from_nanosecond(i128::from(clock.epoch_utc_ns())).map_err(Error::failed)?;
        let epoch_utc = format!("{epoch:.9}");
        let writer = TruthWriter::new(BufWriter::new(file), names, &epoch_utc).map_err(failed)?;
        Ok(Self { path: path.to_owned(), writer })
    }

    fn write(&mut self, cycle: &TruthCycle) -> Result<(), Error> {
        self.writer.write(cycle).map_err(|error| Error::file("write", &self.path, &error))
    }

    fn finish(self) -> Result<(), Error> {
        self.writer.finish().map(drop).map_err(|error| Error::file("write", &self.path, &error))
    }
}
