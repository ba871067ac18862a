//! `posed doctor [PORT]`: lists the ports, asks each what is there, and states what is wrong.
//!
//! Ports are asked side by side, each at one rate after the other, and none for longer than [`survey::LIMIT`]. A unit that
//! streams is stopped by the question; nothing else is changed.

mod installation;
mod sync;

use std::path::{Path, PathBuf};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use posed_daemon::find::Kind;
use posed_daemon::find::proposal::propose;
use posed_daemon::find::survey::{self, Wanted};
use posed_protocol::{FoundPort, FoundSensor};
use posed_stage::Stage;
use posed_stage::edit::edit;
use serde::Serialize;

use super::{Error, output, print, print_json};

/// What a written stage file begins with.
const HEAD: &str =
    "# Written by `posed doctor`. Every key is explained in config/README.md.\n\nname = \"Stage\"\n";

/// What to look at.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed doctor\n  posed doctor /dev/ttyUSB0 --write-stage stage.toml\n  \
    posed doctor --sync stage.toml\n\n\
    Exit code 1 if nothing answers. A unit that streams is stopped by the question.")]
pub(crate) struct Args {
    /// Path of a serial port, tcp://HOST:PORT or udp://HOST:PORT; absent: all serial ports of this machine, and the units
    /// that announce themselves on the network.
    port: Option<String>,
    /// Ask at this line rate only, bit/s.
    #[arg(long, value_name = "RATE", value_parser = clap::value_parser!(u32).range(1..))]
    baud: Option<u32>,
    /// Ask for this kind of device only.
    #[arg(long, value_name = "DRIVER", value_parser = kind)]
    driver: Option<Kind>,
    /// Write a stage file with the devices that answered; an existing file is not touched.
    #[arg(long, value_name = "FILE")]
    write_stage: Option<PathBuf>,
    /// Measure by how much one device's motion appears later than another's: a recording, or a stage file that is then run.
    /// Fasten a sensor of each device to the same stick and turn it quickly and irregularly.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["port", "baud", "driver", "write_stage"])]
    sync: Option<PathBuf>,
    /// How long the stage is run for --sync.
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0, requires = "sync")]
    sync_s: f64,
    /// Print one JSON object: ports, each with port, driver, revision, sensors, problem and fix; installation, each with check,
    /// problem and fix.
    #[arg(long)]
    json: bool,
}

fn kind(word: &str) -> Result<Kind, String> {
    let mut all = Kind::SERIAL.into_iter().chain([Kind::MotionStar, Kind::Vrpn]);
    all.find(|kind| kind.word() == word).ok_or_else(|| {
        "write flock-of-birds, xbus, x-imu3, fastrak, polhemus, witmotion, motionstar or vrpn".to_owned()
    })
}

/// What `doctor` answers.
#[derive(Serialize)]
struct Report {
    ports: Vec<FoundPort>,
    /// What of this computer was looked at; empty where a port was named.
    installation: Vec<installation::Finding>,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    if let Some(path) = args.write_stage.as_deref().filter(|path| path.exists()) {
        return Err(output::exists(path));
    }
    if let Some(file) = &args.sync {
        if !(5.0..=600.0).contains(&args.sync_s) {
            return Err(Error::Usage(format!("--sync-s {}: give 5 to 600", args.sync_s)));
        }
        return sync::run(file, args.sync_s, args.json);
    }
    let ports = match &args.port {
        Some(port) => vec![port.clone()],
        None => posed_drivers::port::list(),
    };
    let wanted = Wanted { baud: args.baud, kind: args.driver };
    let alone = args.port.is_some() || args.driver.is_some_and(|kind| kind != Kind::XImu3);
    let progress = ProgressBar::new_spinner().with_style(ProgressStyle::default_spinner());
    progress.enable_steady_tick(Duration::from_millis(120));
    progress.set_message(format!("asking {} ports", ports.len()));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|error| Error::Failed(format!("cannot start: {error}")))?;
    let ports = runtime.block_on(async {
        let network = async { if alone { Vec::new() } else { survey::network().await } };
        let (mut ports, network) =
            tokio::join!(survey::ports(ports, wanted, survey::LIMIT, |_, _| {}), network);
        ports.extend(network);
        ports
    });
    let installation = match args.port {
        None => installation::look(Path::new("/"), &posed_drivers::port::list()),
        Some(_) => Vec::new(),
    };
    let report = Report { ports, installation };
    progress.finish_and_clear();

    if args.json {
        print_json(&report)?;
    } else {
        print(&report.sentences())?;
    }
    if report.ports.iter().all(|port| port.driver.is_none()) {
        return Err(Error::Reported);
    }
    if let Some(path) = &args.write_stage {
        let text = stage(report.ports)?;
        output::create(path, |file| file.write_all(text.as_bytes()))?;
        super::notify(&format!("wrote {}; next: posed run {0}", path.display()));
    }
    Ok(())
}

/// The text of a stage file with every device that answered and every sensor it has.
fn stage(mut ports: Vec<FoundPort>) -> Result<String, Error> {
    propose(&mut ports, &[]);
    let changes: Vec<_> = ports.into_iter().flat_map(|port| port.adds).collect();
    if changes.is_empty() {
        return Err(Error::Failed("no device has a sensor, so there is no stage to write".to_owned()));
    }
    let text = edit(HEAD, &changes).map_err(Error::failed)?;
    // What is written must be what `check` and `run` take.
    Stage::parse(&text)
        .map_err(|problems| Error::Failed(format!("cannot write a stage for this: {problems}")))?;
    Ok(text)
}

impl Report {
    /// For people: one paragraph per port.
    fn sentences(&self) -> String {
        self.of_ports() + &self.of_installation()
    }

    fn of_installation(&self) -> String {
        let wrong =
            self.installation.iter().filter_map(|finding| Some((finding.problem.as_ref()?, &finding.fix)));
        wrong
            .map(|(problem, fix)| format!("{problem}\n    fix: {}\n", fix.as_deref().unwrap_or_default()))
            .collect()
    }

    fn of_ports(&self) -> String {
        if self.ports.is_empty() {
            return "There is no serial port on this machine, and no unit announces itself on the network; plug in the \
                    adapter, or name a port: posed doctor tcp://HOST:PORT\n"
                .to_owned();
        }
        self.ports.iter().map(sentences).collect()
    }
}

fn sentences(port: &FoundPort) -> String {
    let mut text = format!("{}\n", port.port);
    if let Some(driver) = port.driver.as_deref() {
        let name = match driver {
            "flock-of-birds" if port.family.is_some() => "3D Guidance unit",
            "flock-of-birds" => "Flock of Birds",
            "motionstar" => "MotionStar",
            "fastrak" => "Fastrak",
            "polhemus" => "Polhemus Liberty or Patriot",
            "xbus" => "Xbus device",
            "x-imu3" => "x-IMU3",
            "slimevr" => "SlimeVR trackers",
            "vrpn" => "VRPN server",
            "open-imu" => "boards of the open format",
            "witmotion" => "WitMotion sensor",
            other => other,
        };
        let model = port.model.as_deref().map(|model| format!(" ({model})")).unwrap_or_default();
        let revision = port.revision.as_deref().map(|text| format!(", revision {text}")).unwrap_or_default();
        let rate = port.rate_hz.map(|rate| format!(", {rate:.1} Hz")).unwrap_or_default();
        let baud = port.baud.map(|baud| format!(", {baud} baud")).unwrap_or_default();
        text.push_str(&format!("    {name}{model}{revision}{baud}{rate}\n"));
        let serial = |s: &FoundSensor| s.serial.as_ref().map(|s| format!(" ({s})")).unwrap_or_default();
        let addresses: Vec<String> =
            port.sensors.iter().map(|s| format!("{}{}", s.address, serial(s))).collect();
        match port.sensors.as_slice() {
            [] => {}
            [only] if only.address == 0 => {
                text.push_str(&format!("    stand-alone unit: address 0{}\n", serial(only)));
            }
            _ if driver == "flock-of-birds" => {
                text.push_str(&format!("    birds at addresses {}\n", addresses.join(", ")));
            }
            _ => text.push_str(&format!("    sensors at addresses {}\n", addresses.join(", "))),
        }
    }
    if let Some(problem) = &port.problem {
        text.push_str(&format!("    {problem}\n"));
    }
    if let Some(fix) = &port.fix {
        text.push_str(&format!("    fix: {fix}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_found_is_reported_in_sentences() {
        let found = FoundPort {
            port: "/dev/ttyUSB0".into(),
            driver: Some("flock-of-birds".into()),
            revision: Some("3.67".into()),
            model: Some("6DFOB".into()),
            baud: Some(115_200),
            rate_hz: Some(103.3),
            sensors: [1, 2].map(|address| FoundSensor { address, serial: None }).into(),
            ..FoundPort::default()
        };
        let silent = FoundPort {
            port: "/dev/ttyS0".into(),
            problem: Some("nothing answers".into()),
            fix: Some("check the cable".into()),
            ..FoundPort::default()
        };
        let installation = vec![installation::Finding {
            check: "latency",
            problem: Some("the adapter of ttyUSB0 collects bytes for 16 ms".into()),
            fix: Some("plug it in again".into()),
        }];
        let text = Report { ports: vec![found, silent], installation }.sentences();
        let expected = "/dev/ttyUSB0\n    Flock of Birds (6DFOB), revision 3.67, 115200 baud, 103.3 Hz\n    \
                        birds at addresses 1, 2\n/dev/ttyS0\n    nothing answers\n    fix: check the cable\n\
                        the adapter of ttyUSB0 collects bytes for 16 ms\n    fix: plug it in again\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn a_stage_without_a_sensor_is_not_written() {
        assert!(stage(vec![FoundPort { driver: Some("xbus".into()), ..FoundPort::default() }]).is_err());
    }
}
