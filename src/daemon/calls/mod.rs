//! What clients ask the daemon to do, one call at a time.
//!
//! In: calls that the server has read and whose role it has checked. Out: commands and models for the fusion thread,
//! answers. Nothing here waits for the fusion thread: it answers by itself when it has carried a command out.

mod align;
mod body;
mod chain;
mod exercise;
mod faults;
mod imu;
mod segments;

use std::path::{Path, PathBuf};

use tokio::sync::{mpsc, watch};

use super::calibration::Calibration;
use super::clock::StageClock;
use super::fusion::{Command, FusionInbox};
use super::inbox::Event;
use super::jobs::Jobs;
use super::models::{self, Library};
use super::ports::ended;
use super::server::{PendingCall, Reply};
use super::track;
use crate::input::{Entry, Input, Model, Plan, Request};
use crate::pipeline::DEFAULT_SUBJECT;
use crate::protocol::{Answer, Call, Exercises, KeptExercise, MapVersion, Recordings};
use crate::stage::Stage;

/// Longest name of a recording, bytes.
const NAME_BYTES: usize = 128;

/// Carries out clients' calls on a live stage.
pub(super) struct Calls {
    stage: Stage,
    recordings: PathBuf,
    exercises: Library,
    faults: Library,
    /// Where the intrinsics of IMUs are kept.
    imus: PathBuf,
    segments: Library,
    clock: StageClock,
    inbox: FusionInbox,
    jobs: Jobs,
    calibration: Calibration,
}

impl Calls {
    pub(super) fn new(
        stage: &Stage,
        folder: PathBuf,
        clock: StageClock,
        inbox: FusionInbox,
        jobs: Jobs,
        calibration: Calibration,
    ) -> Self {
        let recordings = stage.recording.folder.clone().unwrap_or_else(|| folder.join("recordings"));
        let exercises = stage.models.exercise_folder.clone().unwrap_or_else(|| folder.join("exercises"));
        let exercises = Library::new(exercises, "json");
        let faults = stage.models.faults_folder.clone().unwrap_or_else(|| folder.join("faults"));
        let faults = Library::new(faults, "json");
        let imus = models::imu_folder(stage, &folder);
        let segments = stage.models.segments_folder.clone().unwrap_or_else(|| folder.join("segments"));
        let segments = Library::new(segments, "safetensors");
        Self {
            stage: stage.clone(),
            recordings,
            exercises,
            faults,
            imus,
            segments,
            clock,
            inbox,
            jobs,
            calibration,
        }
    }

    /// Until shutdown.
    pub(super) async fn run(self, mut pending: mpsc::Receiver<PendingCall>, mut down: watch::Receiver<bool>) {
        loop {
            tokio::select! {
                () = ended(&mut down) => return,
                call = pending.recv() => match call {
                    Some(PendingCall { call, reply }) => self.carry_out(call, reply),
                    None => return,
                },
            }
        }
    }

    fn carry_out(&self, call: Call, reply: Reply) {
        match call {
            Call::RecordStart { name } => match self.recording_path(name) {
                Ok(path) => {
                    self.inbox.push(Event::Command(Command::StartRecording { path, reply: Some(reply) }));
                }
                Err(sentence) => reply.error("bad_request", sentence),
            },
            Call::RecordStop {} => {
                self.inbox.push(Event::Command(Command::StopRecording { reply: Some(reply) }));
            }
            Call::ModelLoad { model } => match self.check_model(&model) {
                Ok(()) => {
                    self.inbox.push(Event::Entry(Entry { t: self.clock.now(), input: Input::Model(model) }));
                    reply.ok(None);
                }
                Err(sentence) => reply.error("bad_request", sentence),
            },
            Call::ReplayList {} => match list(&self.recordings) {
                Ok(names) => reply.ok(Some(Answer::Recordings(Recordings { recordings: names }))),
                Err(sentence) => reply.error("failed", sentence),
            },
            Call::ReplayTrack { name, columns } => track::answer(&self.recordings, &name, columns, reply),
            Call::ReplayOpen { .. } | Call::ReplaySeek { .. } | Call::ReplaySpeed { .. } => reply.error(
                "live",
                "this daemon tracks a live stage; open a recording with `posed replay FILE`, which serves it to clients",
            ),
            Call::FieldStart { sensors, spacing_m } => self.calibration.start(sensors, spacing_m, reply),
            Call::FieldFinish { anchors } => self.calibration.finish(anchors, reply),
            Call::FieldAccept {} => self.with_files(reply, Calibration::accept),
            Call::FieldRollback {} => self.with_files(reply, Calibration::rollback),
            Call::ExerciseList {} => match self.exercises.list() {
                Ok(kept) => {
                    let exercise = |kept: models::Kept| KeptExercise { name: kept.name, revision: kept.revision };
                    let exercises = kept.into_iter().map(exercise).collect();
                    reply.ok(Some(Answer::Exercises(Exercises { exercises })));
                }
                Err(sentence) => reply.error("failed", sentence),
            },
            Call::ExerciseTeach { name, repetitions, last_s, sensors, channels, subject } => {
                let lesson = exercise::Lesson { name, repetitions, last_s, sensors, channels, subject };
                self.teach(lesson, reply);
            }
            Call::ExerciseSelect { exercises, repetitions, sets, rest_s, subject, sensors } => {
                let plan = Plan { repetitions, sets, rest_s: rest_s.unwrap_or(0.0) };
                self.select(exercises, plan, subject, sensors.unwrap_or_default(), reply);
            }
            Call::ExerciseReset { subject } => {
                let subject = subject.unwrap_or_else(|| DEFAULT_SUBJECT.to_owned());
                self.request(Request::ExerciseReset { subject }, Vec::new(), reply);
            }
            Call::FaultsTrain { last_s, recording } => self.train_faults(last_s, recording, reply),
            Call::FaultsNameCell { row, column, class } => self.name_cell(row, column, class, reply),
            Call::SegmentsTrain { epochs, look_ahead } => self.train_segments(epochs, look_ahead, reply),
            Call::BodyCalibrate { how } => self.calibrate_body(how.unwrap_or_default(), reply),
            Call::StageAlign { sensor, anchors } => self.align_stage(sensor, anchors, reply),
            Call::ImuCalibrate { sensor } => self.calibrate_imu(sensor, reply),
            Call::JobCancel { job } => match self.jobs.cancel(job) {
                Ok(()) => {
                    self.inbox.push(Event::Command(Command::LookAtJobs));
                    reply.ok(None);
                }
                Err(sentence) => reply.error("no_such_job", sentence),
            },
        }
    }

    /// Changes the version of the field's map where it keeps nobody waiting, and says which is in use then.
    fn with_files(&self, reply: Reply, change: fn(&Calibration) -> Result<u32, String>) {
        let calibration = self.calibration.clone();
        tokio::task::spawn_blocking(move || match change(&calibration) {
            Ok(version) => reply.ok(Some(Answer::MapVersion(MapVersion { version }))),
            Err(sentence) => reply.error("failed", sentence),
        });
    }

    /// A new file in the one folder for recordings.
    fn recording_path(&self, name: Option<String>) -> Result<PathBuf, String> {
        let name = match name {
            Some(name) => {
                let plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.' | ' ');
                if name.is_empty()
                    || name.len() > NAME_BYTES
                    || name.starts_with('.')
                    || !name.chars().all(plain)
                {
                    return Err(
                        "name: give a file name of letters, digits, '-', '_', '.', without a path".into()
                    );
                }
                if name.ends_with(".mcap") { name } else { format!("{name}.mcap") }
            }
            None => {
                let utc = i128::from(self.clock.epoch_utc_ns()) + i128::from(self.clock.now().as_nanos());
                let stage = self.stage.file_name();
                match jiff::Timestamp::from_nanosecond(utc) {
                    Ok(utc) => format!("{stage}-{}.mcap", utc.strftime("%Y%m%d-%H%M%S")),
                    Err(error) => return Err(format!("the computer's clock is out of range: {error}")),
                }
            }
        };
        std::fs::create_dir_all(&self.recordings)
            .map_err(|error| format!("cannot make the folder {}: {error}", self.recordings.display()))?;
        Ok(self.recordings.join(name))
    }

    fn check_model(&self, model: &Model) -> Result<(), String> {
        model.check()?;
        if let Model::Field { map: Some(map), .. } = model {
            // Here is time to make it fast; the fusion thread has none.
            map.corrector();
        }
        if let Model::TrackerNoise { device, .. } = model
            && !self.stage.devices.iter().any(|known| &known.name == device)
        {
            return Err(format!("device: this stage has no device {device:?}"));
        }
        if let Model::Mounting { sensors } = model
            && let Some(unknown) = sensors
                .iter()
                .find(|mounted| !self.stage.sensors.iter().any(|known| known.name == mounted.sensor))
        {
            return Err(format!("sensors: this stage has no sensor {:?}", unknown.sensor));
        }
        if let Model::FastenedImu { sensor, .. } = model
            && !self.stage.sensors.iter().any(|known| known.name == *sensor && known.imu.is_some())
        {
            return Err(format!("sensor: this stage has no sensor {sensor:?} with an `imu`"));
        }
        if let Model::Exercise { exercise } = model {
            models::check_exercise(&self.stage, exercise)?;
        }
        if let Model::Faults { network } = model {
            network.check_sensors(&self.stage.magnetic_sensors()).map_err(|error| error.to_string())?;
        }
        Ok(())
    }
}

/// The recording of that name in a folder, or the code and the sentence of the refusal.
pub(super) fn find(folder: &Path, name: &str) -> Result<PathBuf, (&'static str, String)> {
    let names = list(folder).map_err(|sentence| ("failed", sentence))?;
    if names.iter().any(|known| known == name) {
        Ok(folder.join(name))
    } else {
        Err(("not_found", format!("name: there is no recording {name:?}; replay.list names them")))
    }
}

/// Names of the recordings in a folder, in order; none where there is no folder yet.
pub(super) fn list(folder: &Path) -> Result<Vec<String>, String> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(format!("cannot read the folder {}: {error}", folder.display())),
    };
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| name.ends_with(".mcap"))
        .collect();
    names.sort();
    Ok(names)
}
