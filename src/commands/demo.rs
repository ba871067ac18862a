//! `posed demo`: a simulated stage, the daemon and the page in one process.
//!
//! The devices are virtual, everything else is what `posed run` does: the driver opens a pseudo-terminal and talks to
//! a unit that does not know it is not one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use posed_daemon::{Daemon, FusionInbox};
use posed_drivers::Timestamp;
use posed_simulator::host::{Clock, Host, Watcher};
use posed_simulator::stage::{Event, Output};
use posed_simulator::truth::{TruthCycle, TruthRow};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input, Truth, TruthSensor};

use super::run::{block_on, options};
use super::{Error, simulation, watch};

/// The stage that is built in.
const STAGE: &str = include_str!("../../config/demo.toml");

/// Names what the person of that stage does.
const MOVES: &[u8] = include_bytes!("../../config/demo-moves.safetensors");

/// What its floor and the leg of its table do to the field.
const FIELD: &[u8] = include_bytes!("../../config/demo-field.json");

/// Where its trackers are, and what they look like with faults; `rehearsal` makes it.
const FAULTS: &[u8] = include_bytes!("../../config/demo-faults.json");

/// What the person of that stage does at first: all exercises in sets, and more.
const ACTIVITY: &str = "activity = \"workout\"";

/// An exercise that its person can do without end.
struct Exercise {
    name: &'static str,
    /// As the simulator calls it.
    activity: &'static str,
    /// What was taught of it; docs/exercise.md states how.
    taught: &'static [u8],
}

const EXERCISES: [Exercise; 2] = [
    Exercise { name: "curl", activity: "curls", taught: include_bytes!("../../config/demo-curl.json") },
    Exercise { name: "squat", activity: "squats", taught: include_bytes!("../../config/demo-squat.json") },
];

/// What to show.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  posed demo\n  posed demo --exercise curl\n\nThen open the address that it prints; Ctrl-C ends it."
)]
pub(crate) struct Args {
    /// Address for the page and the websocket, in place of the stage's.
    #[arg(long, value_name = "HOST:PORT")]
    listen: Option<String>,
    /// Simulate another stage file than the one that is built in.
    #[arg(long, value_name = "STAGE.toml")]
    stage: Option<PathBuf>,
    /// The person does this exercise without end, and it is counted from the start on: `exercise.list` has it, nobody needs to teach it. One of the same name that
    /// is kept in `--data` counts in its place.
    #[arg(long, value_name = "NAME", conflicts_with = "stage", value_parser = clap::builder::PossibleValuesParser::new(EXERCISES.map(|exercise| exercise.name)))]
    exercise: Option<String>,
    /// Record everything that comes in, from the first byte on.
    #[arg(long, value_name = "REC.mcap")]
    record: Option<PathBuf>,
    /// Where recordings, exercises, sessions and maps are kept; absent: the recordings in `recordings` beside STAGE.toml, or here for
    /// the stage that is built in, and all else only until the end.
    #[arg(long, value_name = "FOLDER")]
    data: Option<PathBuf>,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let ports = tempfile::Builder::new()
        .prefix("posed-")
        .tempdir()
        .map_err(|error| Error::Failed(format!("cannot make a folder for the ports: {error}")))?;
    let exercise = EXERCISES.iter().find(|exercise| args.exercise.as_deref() == Some(exercise.name));
    let (stage, text, folder) = match &args.stage {
        Some(path) => {
            let text = std::fs::read_to_string(path).map_err(|error| Error::file("read", path, &error))?;
            let folder = path.parent().unwrap_or(Path::new("")).to_owned();
            (Stage::load(path).map_err(Error::failed)?, text, folder)
        }
        None => {
            let text = exercise.map_or_else(|| STAGE.to_owned(), Exercise::stage);
            let mut stage = Stage::parse(&text).map_err(Error::failed)?;
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
            if let Some(faults) = &mut stage.models.faults {
                unpack(faults, FAULTS)?;
            }
            (stage, text, PathBuf::new())
        }
    };
    let duration_s = simulation::scenario(&stage)?.duration_s;
    let devices = simulation::virtual_stage(&stage, &folder)?;
    let recordings = folder.join("recordings");
    let mut options = options(stage, text, folder);
    options.data = args.data.unwrap_or_else(|| {
        // What virtual devices teach is true of no room, and of nobody: it would be in the way of the real ones of this stage.
        options.stage.recording.folder.get_or_insert(recordings);
        ports.path().join("data")
    });
    if let Some(exercise) = exercise {
        options.stage.models.exercises = vec![exercise.kept(&options.data)?];
    }
    options.listen = args.listen;
    options.record = args.record;
    options.truth = true;

    block_on(async {
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
        watch::announce(daemon.vrpn_address())?;
        let ended = watch::until_end(daemon.url(), daemon.status(), daemon.part_ended(), duration_s).await;
        // The daemon first: to it, devices that end would be unplugged.
        daemon.shutdown().await;
        let stopped =
            host.stop().await.map_err(|error| Error::Failed(format!("a virtual device failed: {error}")));
        ended.and(stopped)
    })
}

impl Exercise {
    /// The stage file with a person who does it.
    fn stage(&self) -> String {
        STAGE.replace(ACTIVITY, &format!("activity = \"{}\"", self.activity))
    }

    /// Its file where exercises are kept, for whoever lists and selects them; one that is there already stays.
    fn kept(&self, data: &Path) -> Result<PathBuf, Error> {
        let folder = data.join("exercises");
        let path = folder.join(format!("{}-001.json", self.name));
        if !path.exists() {
            let written = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&path, self.taught));
            written.map_err(|error| Error::file("write", &path, &error))?;
        }
        Ok(path)
    }
}

/// Sends the truth to the `truth` topic.
fn truth_to(inbox: Arc<OnceLock<FusionInbox>>) -> Watcher {
    let thinned = Mutex::new(Thinned::default());
    Arc::new(move |event: &Event| {
        if let (Output::Truth(cycle), Some(inbox)) = (&event.output, inbox.get()) {
            let rows = thinned.lock().unwrap_or_else(PoisonError::into_inner).rows(cycle);
            if !rows.is_empty() {
                let input = Input::Truth(Truth { t_valid: cycle.t, sensors: rows });
                inbox.enter(Entry { t: cycle.t, input });
            }
        }
    })
}

/// Time between two truths of a sensor, ns: they are there to be looked at, and at the devices' own rates they would be half of
/// a recording.
const TRUTH_NS: i64 = 100_000_000;

/// Leaves out of the truth what nobody sees.
#[derive(Default)]
struct Thinned {
    /// The step of time in which each sensor was shown last.
    shown: BTreeMap<usize, i64>,
}

impl Thinned {
    /// The sensors of a cycle that are due.
    fn rows(&mut self, cycle: &TruthCycle) -> Vec<TruthSensor> {
        let step = cycle.t.as_nanos().div_euclid(TRUTH_NS);
        let due = cycle.sensors.iter().filter(|row| self.shown.insert(row.sensor, step) != Some(step));
        due.map(truth_of).collect()
    }
}

fn truth_of(row: &TruthRow) -> TruthSensor {
    // What a float cannot hold is less than a micrometre, and does not compress.
    let short = |value: f64| f64::from(value as f32);
    let (t, q) = (row.pose.translation.vector, row.pose.rotation.into_inner());
    TruthSensor {
        sensor: row.sensor as u16,
        position_m: [t.x, t.y, t.z].map(short),
        orientation_wxyz: [q.w, q.i, q.j, q.k].map(short),
        class: row.class.name().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_simulator::truth::Class;

    #[test]
    fn each_exercise_has_a_person_who_does_it_and_is_kept_once() {
        let folder = tempfile::tempdir().unwrap();
        for exercise in &EXERCISES {
            let stage = Stage::parse(&exercise.stage()).unwrap();
            assert!(exercise.stage() != STAGE && simulation::scenario(&stage).is_ok(), "{}", exercise.name);
            let path = exercise.kept(folder.path()).unwrap();
            let taught =
                posed_motion::exercise::Exercise::from_json(&std::fs::read_to_string(&path).unwrap());
            assert_eq!(taught.unwrap().name, exercise.name);
            std::fs::write(&path, "of somebody").unwrap();
            assert_eq!(exercise.kept(folder.path()).unwrap(), path);
            assert_eq!(std::fs::read_to_string(&path).unwrap(), "of somebody");
        }
    }

    #[test]
    fn the_truth_of_each_sensor_comes_ten_times_a_second() {
        let mut thinned = Thinned::default();
        let mut count = [0; 3];
        for n in 0..1000_i64 {
            // Two devices, one of them with sensors that take turns.
            let sensors = if n % 2 == 0 { vec![0] } else { vec![1 + (n as usize / 2) % 2] };
            let row = |sensor| TruthRow {
                sensor,
                pose: nalgebra::Isometry3::translation(0.1, 0.2, 0.3),
                class: Class::Clean,
                distortion_m: nalgebra::Vector3::zeros(),
            };
            let cycle = TruthCycle {
                t: Timestamp::from_nanos(n * 5_000_000),
                device: (n % 2) as usize,
                cycle: n as u64 / 2,
                sensors: sensors.into_iter().map(row).collect(),
            };
            for row in thinned.rows(&cycle) {
                count[usize::from(row.sensor)] += 1;
                assert!((row.position_m[2] - 0.3).abs() < 1e-7);
            }
        }
        assert_eq!(count, [50; 3]);
    }
}
