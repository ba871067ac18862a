//! The fault map: learning it from what was tracked or recorded, and naming its cells.
//!
//! Learning is a job on a thread of its own; naming a cell writes a file and keeps no task waiting either. What comes of it goes the way of every
//! model: through the input log, swapped in between two frames.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use serde_json::json;

use super::super::fusion::{Command, FusionInbox};
use super::super::jobs::{Failure, Job};
use super::super::models::{Kept, Library};
use super::super::recordings;
use super::super::server::{Refusal, Reply};
use super::Calls;
use posed_fusion::faults::Class;
use posed_motion::fault_map::Frames;
use posed_motion::fault_map::Training;
use posed_motion::fault_map::{FaultMap, Size};
use posed_protocol::{Answer, KeptFile, RefusalReason};
use posed_recording::raw_poses;
use posed_stage::input::Model;

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
    /// Begins to learn a fault map.
    pub(super) fn train_faults(&self, last_s: Option<f64>, recording: Option<String>, reply: Reply) {
        if last_s.is_some_and(|last_s| !(last_s.is_finite() && last_s > 0.0)) {
            return reply.error("bad_request", "last_s: give a number of seconds above 0");
        }
        if last_s.is_some() && recording.is_some() {
            return reply.error("bad_request", "give last_s or recording, not both");
        }
        if self.stage.magnetic_sensors().is_empty() {
            let sentence = "this stage has no magnetic sensors";
            return reply.refuse(Refusal::bad_request(sentence).because(RefusalReason::NoMagnetic));
        }
        let source = match recording.map(|name| self.recorded(&name)).transpose() {
            Ok(Some(path)) => Source::Recording(path),
            Ok(None) => Source::Live { last_s },
            Err(refusal) => return reply.refuse(refusal),
        };
        let workshop = self.workshop();
        let names: Vec<String> = self.stage.magnetic_sensors().into_iter().map(str::to_owned).collect();
        self.jobs.run("faults.train", reply, move |job| workshop.train(job, source, &names));
    }

    /// Gives a cell another class. Writes a file: not for an asynchronous task.
    pub(super) fn name_cell(&self, row: usize, column: usize, class: Class, reply: Reply) {
        let named = self.workshop().name_cell(row, column, class);
        let answer = |kept: Kept| KeptFile { revision: kept.revision, file: kept.file() };
        reply.answer(named.map(|kept| Some(Answer::KeptFile(answer(kept)))).map_err(Refusal::failed));
    }

    fn workshop(&self) -> Workshop {
        Workshop { inbox: self.inbox.clone(), library: self.faults.clone() }
    }

    /// A recording of the folder.
    fn recorded(&self, name: &str) -> Result<PathBuf, Refusal> {
        if recordings::list(&self.recordings).map_err(Refusal::bad_request)?.iter().any(|known| known == name)
        {
            Ok(self.recordings.join(name))
        } else {
            Err(Refusal::bad_request(format!("recording: there is no {name:?}; `replay.list` names them")))
        }
    }
}

/// What a map is learnt from.
enum Source {
    Live { last_s: Option<f64> },
    Recording(PathBuf),
}

impl Workshop {
    fn train(&self, job: &Job, source: Source, sensors: &[String]) -> Result<String, Failure> {
        let frames = match source {
            Source::Live { last_s } => self.inbox.ask(|to| Command::Poses { last_s, to })?,
            Source::Recording(path) => {
                job.progress(None, Some("reading the recording".into()));
                raw_poses::read(&path)?
            }
        };
        let frames = frames.in_order_of(sensors).ok_or("the recording has other magnetic sensors")?;
        let usable = (0..frames.len()).filter(|k| frames.positions(*k).iter().any(|value| !value.is_nan()));
        let usable = usable.count();
        if usable < FEWEST_FRAMES {
            return Err(
                format!("{usable} frames with positions are too few: give {FEWEST_FRAMES} or more").into()
            );
        }
        job.progress(None, Some(format!("learning from {usable} frames")));
        let (mut fault_map, counts) = learn(&frames)?;
        if job.is_cancelled() {
            return Err("cancelled; the map is as it was".into());
        }
        let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = self.keep(&mut fault_map)?;
        job.result(json!({ "revision": kept.revision, "file": kept.file(), "frames": usable }));
        self.load(fault_map);
        Ok(format!("{counts}; kept as {}", kept.file()))
    }

    fn name_cell(&self, row: usize, column: usize, class: Class) -> Result<Kept, Failure> {
        let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let fault_map = self.inbox.ask(|to| Command::Faults { to })?;
        let mut fault_map = fault_map.ok_or("this stage has no fault map; `faults.train` learns one")?;
        fault_map.name_cell(row, column, class)?;
        let kept = self.keep(&mut fault_map)?;
        self.load(*fault_map);
        Ok(kept)
    }

    /// Keeps a network under the next revision, which it gets.
    fn keep(&self, fault_map: &mut FaultMap) -> Result<Kept, Failure> {
        self.library.keep_next(NAME, |revision| {
            fault_map.revision = revision;
            Ok(serde_json::to_vec(fault_map)?)
        })
    }

    fn load(&self, fault_map: FaultMap) {
        self.inbox.command(Command::load(Model::Faults { fault_map: Box::new(fault_map) }));
    }
}

/// A network, and what its recording held in words.
fn learn(frames: &Frames) -> Result<(FaultMap, String), Failure> {
    let (fault_map, labels) = FaultMap::train(frames, Size::default(), &Training::default())?;
    let count = |class: Class| labels.frames.iter().filter(|label| label.class == class).count();
    let [clean, inverted, anomalous] = [Class::Clean, Class::Inverted, Class::Anomalous].map(count);
    let words = format!("{clean} clean, {inverted} inverted, {anomalous} anomalous frames");
    Ok((fault_map, words))
}
