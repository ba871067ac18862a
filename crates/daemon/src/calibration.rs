//! Calibrations of the field: a guided run becomes a map, and the stage's maps are kept with their versions.
//!
//! In: the recording that the pipeline collected, what clients decide. Out: maps for the fusion thread, as entries of the
//! log. Maps lie beside the stage file, one file per version; `active` names the one in use.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::Vector3;

use super::clock::StageClock;
use super::fusion::FusionInbox;
use super::jobs::Jobs;
use super::observers::{Observer, Times};
use super::server::{Refusal, Reply};
use posed_field::{Anchor, FieldMap, PoleRun, Prepared, solve};
use posed_protocol::{AnchorSpec, RefusalReason};
use posed_recording::AtomicFile;
use posed_stage::input::{Entry, Input, Model, Request};
use posed_stage::output::Output;
use posed_stage::{Stage, read_field_map};

/// Names the version in use.
const ACTIVE: &str = "active";

/// Why a calibration gave no map.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    /// Somebody cancelled it.
    #[error("it was cancelled")]
    Cancelled,
    /// The map is no better than none, or the run did not show enough: in the solver's words.
    #[error("{0}")]
    Inaccurate(String),
}

/// Why the version of the field's map stays as it is.
#[derive(Debug, thiserror::Error)]
pub enum FieldMapError {
    /// A map cannot be read: a sentence that names the file.
    #[error("{0}")]
    Read(String),
    /// Nothing was calibrated.
    #[error("there is no calibration to accept; field.finish makes one")]
    NoCandidate,
    /// What was calibrated is not good.
    #[error("the last calibration was refused: {0}")]
    Rejected(#[from] Unfit),
    /// The folder takes no map.
    #[error("cannot keep the map in {}: {error}", folder.display())]
    Keep {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// The folder takes no mark.
    #[error("cannot write to {}: {error}", folder.display())]
    Mark {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// There is nothing to go back from.
    #[error("no version is in use that was accepted here")]
    NoVersion,
}

/// All calibrations of a daemon; clones share them.
#[derive(Clone, Debug)]
pub(super) struct Calibration {
    clock: StageClock,
    inbox: FusionInbox,
    jobs: Jobs,
    sensors: Arc<[String]>,
    /// Where the stage's maps are kept.
    folder: PathBuf,
    /// The map that the stage file names.
    given: Option<PathBuf>,
    state: Arc<Mutex<State>>,
    /// Who changes versions holds it: they are distinguished by files.
    files: Arc<Mutex<()>>,
}

#[derive(Debug, Default)]
struct State {
    /// Who asked for the end of the run, and the anchors.
    requested: Option<(Reply, Vec<AnchorSpec>)>,
    /// What the last calibration gave, or why nothing.
    candidate: Option<Result<Prepared, Unfit>>,
}

/// The map that a stage begins with.
#[derive(Debug)]
pub(super) struct MapInUse {
    version: u32,
    map: Option<FieldMap>,
    /// Why the version that was accepted last is not it: the daemon runs with what the stage file names, or without a map.
    pub(super) left_out: Option<FieldMapError>,
}

impl MapInUse {
    /// Reads the version in use, else the map that the stage file names.
    ///
    /// # Errors
    /// That map cannot be read.
    pub(super) fn read(stage: &Stage, data: &Path) -> Result<Self, FieldMapError> {
        let folder = folder(stage, data);
        let kept = active(&folder).and_then(|version| Ok((version, read_map(&folder, None, version)?)));
        let left_out = match kept {
            Ok((version, Some(map))) => return Ok(Self { version, map: Some(map), left_out: None }),
            Ok((_, None)) => None,
            Err(error) => Some(error),
        };
        Ok(Self { version: 0, map: read_map(&folder, stage.models.field.as_deref(), 0)?, left_out })
    }
}

/// Where a stage's maps are kept; `data` is where daemons keep what they learn.
fn folder(stage: &Stage, data: &Path) -> PathBuf {
    data.join("field-maps").join(stage.file_name())
}

fn file(folder: &Path, version: u32) -> PathBuf {
    folder.join(format!("{version:04}.json"))
}

/// The version in use, 0 for none that was accepted here; a sentence where nobody can say which.
fn active(folder: &Path) -> Result<u32, FieldMapError> {
    let path = folder.join(ACTIVE);
    let reason = match std::fs::read_to_string(&path) {
        Ok(text) => match text.trim().parse() {
            Ok(version) => return Ok(version),
            Err(_) => format!("{} does not name a version", path.display()),
        },
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(0),
        Err(error) => format!("cannot read {}: {error}", path.display()),
    };
    Err(FieldMapError::Read(reason))
}

/// The map of a version: 0 is the one that the stage file names (`given`), if it does.
fn read_map(folder: &Path, given: Option<&Path>, version: u32) -> Result<Option<FieldMap>, FieldMapError> {
    let path = if version == 0 { given.map(Path::to_owned) } else { Some(file(folder, version)) };
    path.map(|path| read_field_map(&path)).transpose().map_err(FieldMapError::Read)
}

impl Calibration {
    pub(super) fn new(stage: &Stage, data: &Path, clock: StageClock, inbox: FusionInbox, jobs: Jobs) -> Self {
        Self {
            clock,
            inbox,
            jobs,
            sensors: stage.sensors.iter().map(|sensor| sensor.name.clone()).collect(),
            folder: folder(stage, data),
            given: stage.models.field.clone(),
            state: Arc::default(),
            files: Arc::default(),
        }
    }

    /// Puts the map in use on the stage into the log before anything else.
    pub(super) fn begin(&self, in_use: MapInUse) {
        let MapInUse { version, map, left_out: _ } = in_use;
        if let Some(map) = map {
            self.swap(version, Some(Prepared::new(map)));
        }
    }

    /// Begins to collect.
    pub(super) fn start(&self, sensors: Vec<String>, spacing_m: f64, reply: Reply) {
        let twice = (1..sensors.len()).any(|k| sensors[..k].contains(&sensors[k]));
        if sensors.len() < 3 || twice {
            let sentence = "sensors: name three or more, each once, in their order along the pole";
            reply.refuse(Refusal::bad_request(sentence).because(RefusalReason::PoleSensors));
        } else if !(spacing_m.is_finite() && spacing_m > 0.0) {
            let sentence = "spacing_m: give the measured distance, above 0";
            reply.refuse(Refusal::bad_request(sentence).because(RefusalReason::PoleSpacing));
        } else if let Some(name) = sensors.iter().find(|name| !self.sensors.contains(name)) {
            let sentence = format!("sensors: this stage has no sensor {name:?}");
            reply.refuse(Refusal::bad_request(sentence).because(RefusalReason::NoSensor).with("name", name));
        } else {
            self.request(Request::FieldStart { sensors, spacing_m });
            reply.ok(None);
        }
    }

    /// Ends the run; the pipeline hands its recording to [`Calibration::solve`].
    pub(super) fn finish(&self, anchors: Vec<AnchorSpec>, reply: Reply) {
        if let Some((other, _)) = self.lock().requested.replace((reply, anchors)) {
            other.error("failed", "another client has ended the run");
        }
        self.request(Request::FieldFinish {});
    }

    /// Solves a run on a thread of its own.
    fn solve(&self, run: &PoleRun) {
        let Some((reply, anchors)) = self.lock().requested.take() else { return };
        if run.frames.is_empty() {
            let sentence = "nothing was collected: begin with field.start and move the pole";
            return reply.refuse(Refusal::failed(sentence).because(RefusalReason::NothingCollected));
        }
        if let Err(error) = run.check_order() {
            reply.error("failed", error.to_string());
            return;
        }
        let anchors: Option<Vec<Anchor>> = anchors
            .into_iter()
            .map(|anchor| {
                let sensor = run.sensors.iter().position(|name| *name == anchor.sensor)?;
                let (t_s, position_m) = ([anchor.t_start, anchor.t_end], Vector3::from(anchor.position_m));
                Some(Anchor { name: anchor.name, sensor, t_s, position_m })
            })
            .collect();
        let Some(anchors) = anchors else {
            reply.error("bad_request", "anchors: each names a sensor of the pole");
            return;
        };
        let (this, run) = (self.clone(), run.clone());
        self.jobs.run("field.finish", reply, move |job| {
            let solution = solve(run, &anchors, &mut |share| job.progress(Some(share), None));
            let report = solution.report;
            job.result(serde_json::json!({ "report": report }));
            let outcome = match solution.map.filter(|_| report.accepted && !job.is_cancelled()) {
                Some(map) => {
                    let map = Prepared::new(map);
                    // Here is time to make it fast; the fusion thread has none.
                    map.corrector();
                    Ok(map)
                }
                None if job.is_cancelled() => Err(Unfit::Cancelled),
                None => {
                    let reasons: Vec<_> = report.reasons.into_iter().map(|reason| reason.text).collect();
                    Err(Unfit::Inaccurate(reasons.join("; ")))
                }
            };
            let emitted = outcome.as_ref().map(|_| {
                format!(
                    "{}: {:.2} mm held out, {:.2} mm without; field.accept uses it",
                    report.model,
                    1e3 * report.heldout_m,
                    1e3 * report.raw_m
                )
            });
            let emitted = emitted.map_err(|unfit| unfit.clone().into());
            this.lock().candidate = Some(outcome);
            emitted
        });
    }

    /// Keeps the last calibration as the newest version and uses it. Writes files: not for an asynchronous task.
    pub(super) fn accept(&self) -> Result<u32, FieldMapError> {
        let _files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
        let candidate = self.lock().candidate.take();
        let map = match candidate {
            None => return Err(FieldMapError::NoCandidate),
            Some(Err(unfit)) => {
                self.lock().candidate = Some(Err(unfit.clone()));
                return Err(unfit.into());
            }
            Some(Ok(map)) => map,
        };
        match self.keep(&map) {
            Ok(version) => {
                self.swap(version, Some(map));
                Ok(version)
            }
            Err(error) => {
                self.lock().candidate = Some(Ok(map));
                Err(FieldMapError::Keep { folder: self.folder.clone(), error })
            }
        }
    }

    /// Goes back one version. Reads a map and makes it fast: not for an asynchronous task.
    pub(super) fn rollback(&self) -> Result<u32, FieldMapError> {
        let _files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
        let active = active(&self.folder)?;
        if active == 0 {
            return Err(FieldMapError::NoVersion);
        }
        let version = active - 1;
        let map = read_map(&self.folder, self.given.as_deref(), version)?;
        let unmarked = |error| FieldMapError::Mark { folder: self.folder.clone(), error };
        self.mark(version).map_err(unmarked)?;
        self.swap(version, map.map(Prepared::new));
        Ok(version)
    }

    /// Keeps a map as the newest version, which it returns: another daemon may keep one in the same folder meanwhile.
    fn keep(&self, map: &Prepared) -> std::io::Result<u32> {
        std::fs::create_dir_all(&self.folder)?;
        let mut version = self.newest();
        loop {
            version += 1;
            let mut file = AtomicFile::create(&file(&self.folder, version))?;
            serde_json::to_writer(&mut file, map)?;
            match file.commit_new() {
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                kept => return kept.and_then(|()| self.mark(version)).map(|()| version),
            }
        }
    }

    fn mark(&self, version: u32) -> std::io::Result<()> {
        use std::io::Write;
        let mut file = AtomicFile::create(&self.folder.join(ACTIVE))?;
        writeln!(file, "{version}")?;
        file.commit()
    }

    /// The highest version that was ever kept: numbers are not used twice.
    fn newest(&self) -> u32 {
        let files = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        files
            .filter_map(|file| file.file_name().to_str()?.strip_suffix(".json")?.parse().ok())
            .max()
            .unwrap_or(0)
    }

    fn swap(&self, version: u32, map: Option<Prepared>) {
        if let Some(map) = &map {
            map.corrector();
        }
        self.push(Input::Model(Model::Field { version, map }));
    }

    fn request(&self, request: Request) {
        self.push(Input::Request(request));
    }

    fn push(&self, input: Input) {
        self.inbox.enter(Entry { t: self.clock.now(), input });
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Every change is one assignment.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Observer for Calibration {
    fn on_output(&mut self, output: &Output<'_>, _: &Times) {
        if let Output::PoleRun(run) = output {
            self.solve(run);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::inbox::Event;
    use super::*;
    use crate::inbox::Inbox;
    use crate::server::Hub;
    use posed_field::{FieldNoise, fit_known};

    fn stage() -> Stage {
        Stage::parse("name = \"Stage A\"").unwrap()
    }

    /// As a daemon begins; says what was left out.
    fn calibration(data: &Path) -> (Calibration, FusionInbox, Option<String>) {
        let clock = StageClock::start();
        let inbox: FusionInbox = Inbox::new(16);
        let jobs = Jobs::new(clock, Hub::default());
        let calibration = Calibration::new(&stage(), data, clock, inbox.clone(), jobs);
        let in_use = MapInUse::read(&stage(), data).unwrap();
        let left_out = in_use.left_out.as_ref().map(ToString::to_string);
        calibration.begin(in_use);
        (calibration, inbox, left_out)
    }

    fn map() -> Prepared {
        let pairs: Vec<_> = (0..300)
            .map(|k| {
                let p = Vector3::new(f64::from(k % 7), f64::from(k % 11), f64::from(k % 13)) * 0.1;
                (p * 1.02, p)
            })
            .collect();
        Prepared::new(fit_known(&pairs, FieldNoise { sigma_signal: 0.0, floor_m: 1e-3 }).unwrap())
    }

    #[expect(clippy::disallowed_methods, reason = "a deadline that has passed")]
    fn swapped(inbox: &FusionInbox) -> Vec<(u32, bool)> {
        let mut swapped = Vec::new();
        while let Some(event) = inbox.pop_until(Some(std::time::Instant::now())) {
            if let Event::Entry(Entry { input: Input::Model(Model::Field { version, map }), .. }) = event {
                swapped.push((version, map.is_some()));
            }
        }
        swapped
    }

    #[test]
    fn accepted_maps_are_kept_and_can_be_gone_back_from() {
        let folder = tempfile::tempdir().unwrap();
        let (calibration, inbox, _) = calibration(folder.path());
        assert!(calibration.accept().is_err() && calibration.rollback().is_err());
        calibration.lock().candidate =
            Some(Err(Unfit::Inaccurate("the pole was hardly ever held along z".into())));
        assert!(calibration.accept().unwrap_err().to_string().contains("along z"));
        for version in [1, 2] {
            calibration.lock().candidate = Some(Ok(map()));
            assert_eq!(calibration.accept().unwrap(), version);
        }
        assert_eq!(calibration.rollback().unwrap(), 1);
        assert_eq!(swapped(&inbox), [(1, true), (2, true), (1, true)]);
        // A daemon that starts again goes on with the version in use.
        let (again, inbox, left_out) = self::calibration(folder.path());
        assert_eq!(left_out, None);
        assert_eq!(swapped(&inbox), [(1, true)]);
        assert_eq!(again.rollback().unwrap(), 0);
        assert_eq!(swapped(&inbox), [(0, false)]);
        // Numbers are not used twice.
        again.lock().candidate = Some(Ok(map()));
        assert_eq!(again.accept().unwrap(), 3);
    }

    #[test]
    fn two_daemons_never_take_one_number() {
        let data = tempfile::tempdir().unwrap();
        let daemons = || {
            std::thread::scope(|scope| {
                let keep = || {
                    let (calibration, ..) = calibration(data.path());
                    (0..8).map(|_| calibration.keep(&map()).unwrap()).collect::<Vec<u32>>()
                };
                [scope.spawn(keep), scope.spawn(keep)].map(|thread| thread.join().unwrap())
            })
        };
        let mut versions = daemons().concat();
        versions.sort_unstable();
        assert_eq!(versions, Vec::from_iter(1..=16));
    }

    #[test]
    fn a_damaged_map_is_left_out_with_a_sentence_and_the_one_before_is_still_there() {
        let data = tempfile::tempdir().unwrap();
        let (calibration, ..) = calibration(data.path());
        for _ in 1..=2 {
            calibration.lock().candidate = Some(Ok(map()));
            calibration.accept().unwrap();
        }
        let kept = folder(&stage(), data.path());
        std::fs::write(file(&kept, 2), "{\"form").unwrap();
        let (again, inbox, left_out) = self::calibration(data.path());
        assert!(left_out.unwrap().contains("0002.json"));
        assert_eq!(swapped(&inbox), [], "no map rather than another one");
        assert_eq!(again.rollback().unwrap(), 1);
        assert_eq!(swapped(&inbox), [(1, true)]);
        // Nobody can say which one is in use.
        std::fs::write(kept.join(ACTIVE), "\0\0").unwrap();
        let (again, inbox, left_out) = self::calibration(data.path());
        assert!(left_out.unwrap().contains("does not name a version"));
        assert!(again.rollback().is_err() && swapped(&inbox).is_empty());
    }

    #[test]
    fn a_damaged_map_that_the_stage_file_names_is_an_error() {
        let data = tempfile::tempdir().unwrap();
        let mut stage = stage();
        stage.models.field = Some(data.path().join("named.json"));
        std::fs::write(data.path().join("named.json"), "[]").unwrap();
        assert!(MapInUse::read(&stage, data.path()).unwrap_err().to_string().contains("named.json"));
    }
}
