//! The map of faults: learning it from what was tracked or recorded, and naming its cells.
//!
//! Learning is a job on a thread of its own; naming a cell writes a file and keeps no task waiting either. What comes of it goes the way of every
//! model: through the input log, swapped in between two frames.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use serde_json::json;

use super::super::fusion::{Command, FusionInbox};
use super::super::inbox::Event;
use super::super::jobs::Job;
use super::super::models::{Kept, Library};
use super::super::server::Reply;
use super::Calls;
use crate::faults::som::frames::Frames;
use crate::faults::som::map::Training;
use crate::faults::som::rules::Class;
use crate::faults::som::{Network, Size};
use crate::input::Model;
use crate::protocol::{Answer, KeptFile};
use crate::recording::positions;

/// Fewer frames tell nothing of how a body moves.
const FEWEST_FRAMES: usize = 300;
/// Under this name networks are kept in their folder.
const NAME: &str = "faults";

/// Changes of the network, one at a time: each begins with what the one before has left.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Where networks come from and go to.
#[derive(Clone)]
struct Workshop {
    inbox: FusionInbox,
    library: Library,
}

impl Calls {
    /// Begins to learn a map of faults.
    pub(super) fn train_faults(&self, last_s: Option<f64>, recording: Option<String>, reply: Reply) {
        if last_s.is_some_and(|last_s| !(last_s.is_finite() && last_s > 0.0)) {
            return reply.error("bad_request", "last_s: give a number of seconds above 0");
        }
        if last_s.is_some() && recording.is_some() {
            return reply.error("bad_request", "give last_s or recording, not both");
        }
        if self.stage.magnetic_sensors().is_empty() {
            return reply.error("bad_request", "this stage has no magnetic sensors");
        }
        let source = match recording.map(|name| self.recorded(&name)).transpose() {
            Ok(Some(path)) => Source::Recording(path),
            Ok(None) => Source::Live { last_s },
            Err(sentence) => return reply.error("bad_request", sentence),
        };
        let workshop = self.workshop();
        let names: Vec<String> = self.stage.magnetic_sensors().into_iter().map(str::to_owned).collect();
        self.jobs.run("faults.train", reply, move |job| workshop.train(job, source, &names));
    }

    /// Gives a cell another class.
    pub(super) fn name_cell(&self, row: usize, column: usize, class: Class, reply: Reply) {
        let workshop = self.workshop();
        tokio::task::spawn_blocking(move || match workshop.name_cell(row, column, class) {
            Ok(kept) => {
                let kept = KeptFile { revision: kept.revision, file: kept.file() };
                reply.ok(Some(Answer::KeptFile(kept)));
            }
            Err(sentence) => reply.error("failed", sentence),
        });
    }

    fn workshop(&self) -> Workshop {
        Workshop { inbox: self.inbox.clone(), library: self.faults.clone() }
    }

    /// A recording of the folder.
    fn recorded(&self, name: &str) -> Result<PathBuf, String> {
        if super::list(&self.recordings)?.iter().any(|known| known == name) {
            Ok(self.recordings.join(name))
        } else {
            Err(format!("recording: there is no {name:?}; `replay.list` names them"))
        }
    }
}

/// What a map is learnt from.
enum Source {
    Live { last_s: Option<f64> },
    Recording(PathBuf),
}

impl Workshop {
    fn train(&self, job: &Job, source: Source, sensors: &[String]) -> Result<String, String> {
        let frames = match source {
            Source::Live { last_s } => self.inbox.ask(|to| Command::Positions { last_s, to })?,
            Source::Recording(path) => {
                job.progress(None, Some("reading the recording".into()));
                positions::read(&path).map_err(|error| error.to_string())?
            }
        };
        let frames = frames.in_order_of(sensors).ok_or("the recording has other magnetic sensors")?;
        let usable = (0..frames.len()).filter(|k| frames.frame(*k).iter().any(|value| !value.is_nan()));
        let usable = usable.count();
        if usable < FEWEST_FRAMES {
            return Err(format!("{usable} frames with positions are too few: give {FEWEST_FRAMES} or more"));
        }
        job.progress(None, Some(format!("learning from {usable} frames")));
        let (mut network, counts) = learn(&frames)?;
        if job.is_cancelled() {
            return Err("cancelled; the map is as it was".into());
        }
        let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = self.keep(&mut network)?;
        job.result(json!({ "revision": kept.revision, "file": kept.file(), "frames": usable }));
        self.load(network);
        Ok(format!("{counts}; kept as {}", kept.file()))
    }

    fn name_cell(&self, row: usize, column: usize, class: Class) -> Result<Kept, String> {
        let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let network = self.inbox.ask(|to| Command::Faults { to })?;
        let mut network = network.ok_or("this stage has no map of faults; `faults.train` learns one")?;
        network.name_cell(row, column, class).map_err(|error| error.to_string())?;
        let kept = self.keep(&mut network)?;
        self.load(*network);
        Ok(kept)
    }

    /// Keeps a network under the next revision, which it gets.
    fn keep(&self, network: &mut Network) -> Result<Kept, String> {
        let kept = self.library.next(NAME)?;
        network.revision = kept.revision;
        let text = serde_json::to_string(network).map_err(|error| error.to_string())?;
        self.library.write(&kept, text.as_bytes())?;
        Ok(kept)
    }

    fn load(&self, network: Network) {
        self.inbox.push(Event::Command(Command::LoadModel(Model::Faults { network: Box::new(network) })));
    }
}

/// A network, and what its recording held in words.
fn learn(frames: &Frames) -> Result<(Network, String), String> {
    let (network, labels) =
        Network::train(frames, Size::default(), &Training::default()).map_err(|error| error.to_string())?;
    let count = |class: Class| labels.frames.iter().filter(|label| label.0 == class).count();
    let [clean, inverted, anomalous] = [Class::Clean, Class::Inverted, Class::Anomalous].map(count);
    let words = format!("{clean} clean, {inverted} inverted, {anomalous} anomalous frames");
    Ok((network, words))
}
