//! What clients ask the daemon to do, one call at a time.
//!
//! In: calls that the server has read and whose role it has checked. Out: commands and models for the fusion thread,
//! answers. Nothing here waits for the fusion thread: it answers by itself when it has carried a command out. What reads or writes
//! files, or computes for long, is done in its order on a thread beside: a disk that hangs holds up nothing else.

mod align;
mod body;
mod chain;
mod demonstration;
mod exercise;
mod faults;
mod guided;
mod imu;
mod phone;
mod segments;
mod setup;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::{mpsc, watch};

use super::calibration::{Calibration, FieldMapError};
use super::clock::StageClock;
use super::fault_points;
use super::fusion::{Command, FusionInbox};
use super::jobs::Jobs;
use super::library::TakeLibrary;
use super::models::{self, Library};
use super::observers::Kept;
use super::ports::ended;
use super::recordings;
use super::server::phones::Phones;
use super::server::{PendingCall, Refusal, Reply};
use super::stages::Editor;
use super::track;
use super::training::Training;
use posed_pipeline::DEFAULT_SUBJECT;
use posed_protocol::{Answer, Call, Exercises, KeptExercise, MapVersion, Recordings};
use posed_stage::Stage;
use posed_stage::input::{Model, Plan, Request};

/// Calls that may wait for the disk.
const WAITING: usize = 64;
/// Commands that may wait for the thread that tracks.
const COMMANDS: usize = 256;

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
    training: Training,
    library: TakeLibrary,
    history: Kept,
    file: setup::File,
    /// `None` where phones cannot come.
    phones: Option<Phones>,
}

/// What carries calls out.
pub(super) struct Services {
    pub(super) clock: StageClock,
    pub(super) inbox: FusionInbox,
    pub(super) jobs: Jobs,
    pub(super) calibration: Calibration,
    pub(super) training: Training,
    pub(super) library: TakeLibrary,
    pub(super) history: Kept,
}

impl Calls {
    pub(super) fn new(stage: &Stage, folder: PathBuf, services: Services) -> Self {
        let recordings = stage.recording.folder.clone().unwrap_or_else(|| folder.join("recordings"));
        let exercises = Library::new(models::exercise_folder(stage, &folder), "json");
        let faults = stage.models.faults_folder.clone().unwrap_or_else(|| folder.join("faults"));
        let faults = Library::new(faults, "json");
        let imus = models::imu_folder(stage, &folder);
        let segments = stage.models.segments_folder.clone().unwrap_or_else(|| folder.join("segments"));
        let segments = Library::new(segments, "safetensors");
        let Services { clock, inbox, jobs, calibration, training, library, history } = services;
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
            training,
            library,
            history,
            file: setup::File::default(),
            phones: None,
        }
    }

    /// The same where phones can come.
    pub(super) fn with_phones(self, phones: Option<Phones>) -> Self {
        Self { phones, ..self }
    }

    /// The same for the stage file of this text, which clients may change where there is an `editor`.
    pub(super) fn on_file(self, text: String, editor: Option<Editor>) -> Self {
        Self { file: setup::File::new(text, editor), ..self }
    }

    /// Until shutdown.
    pub(super) async fn run(self, mut pending: mpsc::Receiver<PendingCall>, mut down: watch::Receiver<bool>) {
        let this = Arc::new(self);
        let (aside, mut waiting) = mpsc::channel(WAITING);
        let beside = Arc::clone(&this);
        let mut files = tokio::task::spawn_blocking(move || {
            while let Some(PendingCall { call, reply }) = waiting.blocking_recv() {
                let _ = fault_points::pass("file");
                beside.carry_out(call, reply);
            }
        });
        loop {
            tokio::select! {
                () = ended(&mut down) => return,
                // Only if it panics: then this part is over, too.
                _ = &mut files => return,
                call = pending.recv() => match call {
                    Some(pending) if is_slow(&pending.call) => {
                        if let Err(mpsc::error::TrySendError::Full(pending)) = aside.try_send(pending) {
                            let busy = "the disk is slow, and many requests wait for it already; try again later";
                            pending.reply.error("busy", busy);
                        }
                    }
                    Some(PendingCall { call, reply }) => this.carry_out(call, reply),
                    None => return,
                },
            }
        }
    }

    /// One that panics is answered as one that was not carried out; the others go on.
    fn carry_out(&self, call: Call, reply: Reply) {
        let carried_out = catch_unwind(AssertUnwindSafe(|| self.attempt(call, reply)));
        if carried_out.is_err() {
            tracing::error!("a request was given up for a fault of the daemon's own; please report this");
        }
    }

    fn attempt(&self, call: Call, reply: Reply) {
        let _ = fault_points::pass("call");
        if self.inbox.commands() >= COMMANDS {
            return reply.error("busy", "many requests wait already; try again later");
        }
        match call {
            Call::RecordStart { name } => match self.recording_path(name) {
                Ok(path) => {
                    self.inbox.command(Command::StartRecording { path, reply: Some(reply) });
                }
                Err(refusal) => reply.refuse(refusal),
            },
            Call::RecordStop {} => {
                self.inbox.command(Command::StopRecording { reply: Some(reply) });
            }
            Call::Mark { label } => {
                self.request(Request::Mark { label: label.unwrap_or_default() }, Vec::new(), reply);
            }
            Call::ModelLoad { model } => match self.check_model(&model) {
                Ok(()) => {
                    self.inbox.command(Command::LoadModel { model, reply: Some(reply) });
                }
                Err(refusal) => reply.refuse(refusal),
            },
            Call::ReplayList {} => {
                let listed = recordings::list(&self.recordings).map_err(Refusal::from);
                let answer = |recordings| Some(Answer::Recordings(Recordings { recordings }));
                reply.answer(listed.map(answer));
            }
            Call::ReplayTrack { name, columns } => track::answer(&self.recordings, &name, columns, reply),
            call @ (Call::ReplayLabels { .. }
            | Call::ReplayLabel { .. }
            | Call::LibraryList { .. }
            | Call::LibraryDigest { .. }
            | Call::LibraryRename { .. }
            | Call::LibraryRemove { .. }
            | Call::LibraryRestore { .. }
            | Call::LibraryEmptyBin {}
            | Call::LibraryExport { .. }) => self.library.ask(call, reply, &self.jobs),
            Call::HealthHistory {} => reply.ok(Some(Answer::History(self.history.history()))),
            Call::ReplayOpen { .. }
            | Call::ReplaySeek { .. }
            | Call::ReplaySpeed { .. }
            | Call::ReplayLook { .. } => reply.error(
                "live",
                "this daemon tracks a live stage; a recording of its folder is watched at /takes/NAME/, any other with `posed replay FILE`",
            ),
            Call::FieldStart { sensors, spacing_m } => self.calibration.start(sensors, spacing_m, reply),
            Call::FieldFinish { anchors } => self.calibration.finish(anchors, reply),
            Call::FieldAccept {} => reply.answer(in_use(self.calibration.accept())),
            Call::FieldRollback {} => reply.answer(in_use(self.calibration.rollback())),
            Call::ExerciseList {} => {
                let exercise = |kept: models::Kept| KeptExercise { name: kept.name, revision: kept.revision };
                let all = |kept: Vec<models::Kept>| kept.into_iter().map(exercise).collect();
                let answer = |kept| Some(Answer::Exercises(Exercises { exercises: all(kept) }));
                reply.answer(self.exercises.list().map(answer).map_err(Refusal::failed));
            }
            Call::ExerciseDemonstration { exercise } => {
                reply.answer(self.demonstration(&exercise).map(|shown| Some(Answer::Demonstration(shown))));
            }
            Call::ExerciseTeach { name, repetitions, last_s, sensors, channels, subject, body } => {
                let lesson = exercise::Lesson { name, repetitions, last_s, sensors, channels, subject, body };
                self.teach(lesson, reply);
            }
            Call::ExerciseSelect { exercises, repetitions, sets, rest_s, subject, body, sensors } => {
                let plan = Plan { repetitions, sets, rest_s: rest_s.unwrap_or(0.0) };
                let who = exercise::Who { subject, body };
                self.select(exercises, plan, who, sensors.unwrap_or_default(), reply);
            }
            Call::ExerciseReset { subject } => {
                let subject = subject.unwrap_or_else(|| DEFAULT_SUBJECT.to_owned());
                self.request(Request::ExerciseReset { subject }, Vec::new(), reply);
            }
            Call::FaultsTrain { last_s, recording } => self.train_faults(last_s, recording, reply),
            Call::FaultsNameCell { row, column, class } => self.name_cell(row, column, class, reply),
            Call::SegmentsTrain { epochs, look_ahead } => self.train_segments(epochs, look_ahead, reply),
            Call::BodyCalibrate { how, body } => {
                self.calibrate_body(body.as_deref(), how.unwrap_or_default(), reply);
            }
            Call::HeadingReset { body, sensor, heading_deg } => {
                let heading_rad = heading_deg.unwrap_or(0.0).to_radians();
                self.request(Request::HeadingReset { body, sensor, heading_rad }, Vec::new(), reply);
            }
            Call::StageAlign { sensor, anchors } => self.align_stage(sensor, anchors, reply),
            Call::ImuCalibrate { sensor } => self.calibrate_imu(sensor, reply),
            Call::SessionBegin { person, plan, subject } => {
                reply.answer(self.training.begin(&person, plan.as_deref(), subject));
            }
            Call::SessionEnd { subject } => reply.answer(self.training.end(subject)),
            Call::SessionList { person, limit } => reply.answer(self.training.list(person.as_deref(), limit)),
            Call::SessionShow { session } => reply.answer(self.training.show(session)),
            Call::SessionReport { session, person, language, time_zone } => {
                let (person, time_zone) = (person.as_deref(), time_zone.as_deref());
                reply.answer(self.training.report(session, person, language.unwrap_or_default(), time_zone));
            }
            Call::SessionCorrect { session, set, counted } => {
                reply.answer(self.training.correct(session, set, counted));
            }
            Call::SessionPeople {} => reply.answer(self.training.people()),
            Call::SessionForget { person, recordings } => {
                reply.answer(self.training.forget(&person, recordings.then_some(&*self.recordings)));
            }
            Call::SessionPlans {} => reply.answer(self.training.plans()),
            Call::SessionSavePlan { plan } => reply.answer(self.training.save_plan(&plan)),
            Call::SessionDeletePlan { name } => reply.answer(self.training.delete_plan(&name)),
            Call::SetupRead { changes } => {
                let read = self.read_setup(&changes);
                reply.answer(read.map(|setup| Some(Answer::Setup(Box::new(setup)))));
            }
            Call::SetupSave { changes, revision } => {
                reply.answer(self.save_setup(&changes, &revision).map(|()| None));
            }
            Call::SetupFind { port } => self.find_ports(port, reply),
            Call::PhoneInvite {} => reply.answer(self.invite_phone()),
            Call::PhoneList {} => reply.answer(self.list_phones()),
            Call::PhoneBlink { phone_id } => reply.answer(self.blink_phone(&phone_id)),
            Call::JobCancel { job } => match self.jobs.cancel(job) {
                Ok(()) => {
                    self.inbox.command(Command::LookAtJobs);
                    reply.ok(None);
                }
                Err(error) => reply.refuse(Refusal::new("no_such_job", error)),
            },
        }
    }

    /// A new file in the one folder for recordings.
    fn recording_path(&self, name: Option<String>) -> Result<PathBuf, Refusal> {
        let name = match name {
            Some(name) => recordings::new_name(&name)?,
            None => {
                let utc = i128::from(self.clock.epoch_utc_ns()) + i128::from(self.clock.now().as_nanos());
                let stage = self.stage.file_name();
                match jiff::Timestamp::from_nanosecond(utc) {
                    Ok(utc) => format!("{stage}-{}.mcap", utc.strftime("%Y%m%d-%H%M%S")),
                    Err(error) => {
                        let reason = format!("the computer's clock is out of range: {error}");
                        return Err(Refusal::bad_request(reason));
                    }
                }
            }
        };
        Ok(self.recordings.join(name))
    }

    fn check_model(&self, model: &Model) -> Result<(), Refusal> {
        model.check().map_err(Refusal::bad_request)?;
        if let Model::Field { map: Some(map), .. } = model {
            // Here is time to make it fast; the fusion thread has none.
            map.corrector();
        }
        if let Model::TrackerNoise { device, .. } = model
            && !self.stage.devices.iter().any(|known| &known.name == device)
        {
            return Err(Refusal::bad_request(format!("device: this stage has no device {device:?}")));
        }
        if let Model::Mounting { body, .. } | Model::Chain { body, .. } = model {
            self.body(body.as_deref())?;
        }
        if let Model::Mounting { sensors, .. } = model
            && let Some(unknown) = sensors
                .iter()
                .find(|mounted| !self.stage.sensors.iter().any(|known| known.name == mounted.sensor))
        {
            let reason = format!("sensors: this stage has no sensor {:?}", unknown.sensor);
            return Err(Refusal::bad_request(reason));
        }
        if let Model::AttachedImu { sensor, .. } = model
            && !self.stage.sensors.iter().any(|known| known.name == *sensor && known.imu.is_some())
        {
            let reason = format!("sensor: this stage has no sensor {sensor:?} with an `imu`");
            return Err(Refusal::bad_request(reason));
        }
        if let Model::Exercise { exercise } = model {
            models::check_exercise(&self.stage, exercise).map_err(Refusal::bad_request)?;
        }
        if let Model::Faults { fault_map } = model {
            fault_map.check_sensors(&self.stage.magnetic_sensors()).map_err(Refusal::bad_request)?;
        }
        Ok(())
    }
}

/// Whether it reads or writes files, takes a while, or has to come behind what does.
fn is_slow(call: &Call) -> bool {
    matches!(
        call,
        Call::ModelLoad { .. }
            | Call::ReplayList {}
            | Call::ReplayTrack { .. }
            | Call::FieldAccept {}
            | Call::FieldRollback {}
            | Call::ExerciseList {}
            | Call::ExerciseDemonstration { .. }
            | Call::ExerciseSelect { .. }
            | Call::ExerciseReset { .. }
            | Call::FaultsNameCell { .. }
            | Call::SessionBegin { .. }
            | Call::SessionEnd { .. }
            | Call::SessionList { .. }
            | Call::SessionShow { .. }
            | Call::SessionReport { .. }
            | Call::SessionCorrect { .. }
            | Call::SessionPeople {}
            | Call::SessionForget { .. }
            | Call::SessionPlans {}
            | Call::SessionSavePlan { .. }
            | Call::SessionDeletePlan { .. }
            | Call::SetupRead { .. }
            | Call::SetupSave { .. }
            | Call::PhoneInvite {}
            | Call::PhoneList {}
            | Call::PhoneBlink { .. }
    )
}

/// Which version of the field's map is in use now.
fn in_use(changed: Result<u32, FieldMapError>) -> Result<Option<Answer>, Refusal> {
    changed.map(|version| Some(Answer::MapVersion(MapVersion { version }))).map_err(Refusal::failed)
}

#[cfg(test)]
mod tests {
    use super::super::fusion::INBOX_CAPACITY;
    use super::super::inbox::{Event, Inbox};
    use super::super::observers::Health;
    use super::super::server::Hub;
    use super::super::server::testing::{Asking, ids};
    use super::super::training::Tools;
    use super::*;
    use posed_stage::input::{Entry, Input};

    #[test]
    fn more_commands_than_may_wait_are_refused_and_what_devices_say_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let (stage, clock) = (Stage::parse("name = \"s\"").unwrap(), StageClock::start());
        let inbox = Inbox::new(INBOX_CAPACITY);
        let jobs = Jobs::new(clock, Hub::default());
        let calibration = Calibration::new(&stage, folder.path(), clock, inbox.clone(), jobs.clone());
        let exercises = Library::new(folder.path().join("exercises"), "json");
        let tools = Tools { clock, hub: Hub::default(), inbox: inbox.clone(), exercises };
        let (training, _follow) = Training::new(&stage, folder.path(), tools);
        let data = folder.path().to_owned();
        let library = TakeLibrary::start(data.join("recordings")).unwrap();
        let history = Health::new(&stage).history();
        let services =
            Services { clock, inbox: inbox.clone(), jobs, calibration, training, library, history };
        let calls = Calls::new(&stage, data, services);
        let (flooding, other) = (Asking::new(), Asking::new());
        for id in 0..COMMANDS + 50 {
            calls.carry_out(Call::RecordStop {}, flooding.reply(id));
            inbox.enter(Entry { t: clock.now(), input: Input::Timer });
        }
        let refused = flooding.answers();
        assert!(refused.iter().all(|answer| answer["code"] == "busy"), "{refused:?}");
        assert_eq!(ids(&refused), (COMMANDS..COMMANDS + 50).collect::<Vec<_>>());
        // The thread goes on: all that waits for it is there, and there is room again.
        let mut entries = 0;
        while let Some(event) = inbox.pop_until(Some(clock.instant(clock.now()))) {
            match event {
                Event::Entry(_) => entries += 1,
                Event::Command(Command::StopRecording { reply }) => reply.unwrap().ok(None),
                Event::Command(command) => panic!("{command:?}"),
            }
        }
        assert_eq!(entries, COMMANDS + 50);
        assert_eq!(ids(&flooding.answers()), (0..COMMANDS).collect::<Vec<_>>());
        calls.carry_out(Call::RecordStop {}, other.reply(7));
        assert_eq!((inbox.commands(), other.answers().len()), (1, 0));
    }
}
