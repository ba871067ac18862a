//! Plays a recording to the server's clients: the same log through the same pipeline, at a chosen speed.
//!
//! In: a recording, and what clients ask of it. Out: messages through the [`Hub`], and a status that states where it is. The
//! thread stands in the place of the fusion thread, so a client cannot tell the two apart but by `status.replay`. Seeking
//! is a job: filters have to pass through all that lies between, a batch at a time, while clients are listened to.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use posed_drivers::Timestamp;

use super::clock::StageClock;
use super::jobs::{Failure, Job, Jobs};
use super::library::{Held, TakeLibrary, Use};
use super::look::Looks;
use super::observers::Health;
use super::recordings;
use super::server::{Hub, PendingCall, Refusal};
use super::track;
use super::waypoints::{Resumed, Waypoints};
use posed_pipeline::SupervisedPipeline;
use posed_protocol::{Answer, Call, Recordings, ReplayStatus, Started};
use posed_recording::{Chunks, Header, Item, Machine, MachineError, Outline, ReadError, Reader};
use posed_stage::Stage;
use posed_stage::input::{Entry, Model};

/// Distance of two `status` messages, and the longest time without looking at the clients.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);
/// Entries between two looks at the clients while seeking.
const SEEK_BATCH: usize = 1024;
/// What lies so shortly before the place sought is published: who seeks in a pause sees where he is.
const SEEK_SHOWN: Duration = Duration::from_millis(100);

/// The thread's state.
pub(super) struct Player {
    clock: StageClock,
    calls: Receiver<PendingCall>,
    hub: Hub,
    jobs: Jobs,
    library: TakeLibrary,
    looks: Looks,
    /// The recording stays where it is.
    held: Held,
    folder: PathBuf,
    stage: Stage,
    health: Health,
    playing: Playing,
    /// Of what is played.
    waypoints: Option<Waypoints>,
    seeking: Option<Seeking>,
}

/// Where a player speaks.
pub(super) struct Outlet {
    pub(super) clock: StageClock,
    pub(super) hub: Hub,
    pub(super) jobs: Jobs,
    pub(super) library: TakeLibrary,
    pub(super) looks: Looks,
}

/// A recording's file and what its index says.
#[derive(Clone)]
pub(super) struct Played {
    pub(super) path: PathBuf,
    pub(super) end: Timestamp,
    /// Absent where it has no index: it was torn.
    pub(super) chunks: Option<Arc<Chunks>>,
}

impl Played {
    /// Reads the index, or all of a recording that has none.
    pub(super) fn read(path: &Path) -> Result<Self, ReadError> {
        let chunks = Chunks::read(path)?.map(Arc::new);
        let end = match &chunks {
            Some(chunks) => chunks.end(),
            None => Outline::read(path)?.end,
        };
        Ok(Self { path: path.to_owned(), end, chunks })
    }

    /// Makes what is costly of the models that are in use at the beginning.
    pub(super) fn prepare(&self) {
        for model in self.chunks.iter().flat_map(|chunks| chunks.header().models.iter()) {
            if let Model::Field { map: Some(map), .. } = model {
                map.corrector();
            }
        }
    }

    /// What stands in front, rather as it was read once: what is costly of its models is made once then.
    pub(super) fn header<'a, R: Read>(&'a self, reader: &'a Reader<R>) -> &'a Header {
        self.chunks.as_ref().map_or_else(|| reader.header(), |chunks| chunks.header())
    }
}

/// On the way to another time.
struct Seeking {
    from: Timestamp,
    to: Timestamp,
    job: Job,
}

/// An open recording.
struct Playing {
    played: Played,
    reader: Reader<std::io::BufReader<std::fs::File>>,
    pipeline: SupervisedPipeline,
    begun: Timestamp,
    /// The next entry, read and not yet played.
    next: Option<Entry>,
    /// Where the recording stands.
    at: Timestamp,
    /// Multiple of real time; 0 is a pause, infinity as fast as it goes.
    speed: f64,
    /// Host time and stream time at which `speed` was set.
    since: (Timestamp, Timestamp),
    ended: Option<String>,
}

impl Player {
    pub(super) fn new(
        outlet: Outlet,
        calls: Receiver<PendingCall>,
        played: Played,
        folder: PathBuf,
        speed: f64,
    ) -> Result<Self, PlayError> {
        let Outlet { clock, hub, jobs, library, looks } = outlet;
        let held = library.in_use().hold(&played.path, Use::Played);
        let waypoints = Waypoints::look_for(&played);
        let playing = Playing::open(played, None, speed, clock.now())?;
        let stage = Stage::parse(&playing.reader.header().stage_toml).map_err(MachineError::from)?;
        let health = Health::new(&stage);
        let seeking = None;
        Ok(Self {
            clock,
            calls,
            hub,
            jobs,
            library,
            looks,
            held,
            folder,
            stage,
            health,
            playing,
            waypoints,
            seeking,
        })
    }

    /// Runs until nobody can call any more.
    pub(super) fn run(mut self) {
        let mut next_status = self.clock.now();
        loop {
            let now = self.clock.now();
            if now >= next_status {
                next_status = now + STATUS_INTERVAL;
                self.publish_status(now);
            }
            let due = match self.seeking {
                Some(_) => Some(now),
                None => self.playing.due(),
            };
            let wake = due.map_or(next_status, |due| due.min(next_status));
            let wait = Duration::try_from_secs_f64(wake.seconds_since(now)).unwrap_or_default();
            match self.calls.recv_timeout(wait) {
                Ok(PendingCall { call: Call::ReplayTrack { name, columns }, reply }) => {
                    track::answer(&self.folder, &name, columns, reply);
                }
                Ok(PendingCall { call, reply }) if call.is_of_library() => {
                    self.library.ask(call, reply, &self.jobs);
                }
                Ok(PendingCall { call, reply }) => {
                    reply.answer(self.carry_out(call));
                    next_status = self.clock.now();
                }
                Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => {
                    if self.seeking.is_some() {
                        if self.seek_on() {
                            next_status = self.clock.now();
                        }
                    } else if due.is_some_and(|due| due <= self.clock.now()) {
                        let Self { playing, hub, health, clock, .. } = &mut self;
                        let read = clock.now();
                        playing.step(|output| {
                            if let posed_stage::output::Output::Estimate(estimate) = output {
                                health.estimate(clock.now().seconds_since(read), estimate);
                            }
                            hub.publish(output);
                        });
                        if self.playing.ended.is_some() {
                            next_status = self.clock.now();
                        }
                    }
                }
            }
        }
    }

    fn carry_out(&mut self, call: Call) -> Result<Option<Answer>, Refusal> {
        match call {
            Call::ReplayList {} => {
                let recordings = recordings::list(&self.folder)?;
                Ok(Some(Answer::Recordings(Recordings { recordings })))
            }
            Call::ReplayOpen { name } => {
                let path = recordings::find(&self.folder, &name)?;
                let played = Played::read(&path).map_err(Refusal::failed)?;
                let (speed, now) = (self.playing.speed, self.clock.now());
                self.playing =
                    Playing::open(played.clone(), Some(&self.stage), speed, now).map_err(Refusal::failed)?;
                self.waypoints = Waypoints::look_for(&played);
                self.looks.open(played.chunks.clone());
                self.held = self.library.in_use().hold(&played.path, Use::Played);
                self.end_seeking(Err("another recording was opened".into()));
                self.hub.rewind();
                Ok(None)
            }
            Call::ReplaySeek { t_s } => {
                if !t_s.is_finite() {
                    return Err(Refusal::bad_request("t_s: give a number of seconds"));
                }
                let job = self.seek(Timestamp::from_secs_f64(t_s)).map_err(Refusal::failed)?;
                Ok(Some(Answer::Started(Started { job })))
            }
            Call::ReplaySpeed { speed } => {
                let speed = speed.times();
                if speed.is_nan() || speed < 0.0 {
                    return Err(Refusal::bad_request("speed: give 0 or more, or \"max\""));
                }
                self.playing.set_speed(speed, self.clock.now());
                Ok(None)
            }
            // Not for this thread: they are answered beside it.
            Call::ReplayTrack { .. }
            | Call::ReplayLook { .. }
            | Call::ReplayLabels { .. }
            | Call::ReplayLabel { .. }
            | Call::LibraryList { .. }
            | Call::LibraryDigest { .. }
            | Call::LibraryRename { .. }
            | Call::LibraryRemove { .. }
            | Call::LibraryRestore { .. }
            | Call::LibraryEmptyBin {}
            | Call::LibraryExport { .. } => Err(Refusal::new("replay", "this is answered beside the replay")),
            Call::HealthHistory {}
            | Call::RecordStart { .. }
            | Call::RecordStop {}
            | Call::ModelLoad { .. }
            | Call::FieldStart { .. }
            | Call::FieldFinish { .. }
            | Call::FieldAccept {}
            | Call::FieldRollback {}
            | Call::ExerciseList {}
            | Call::ExerciseDemonstration { .. }
            | Call::ExerciseTeach { .. }
            | Call::ExerciseSelect { .. }
            | Call::ExerciseReset { .. }
            | Call::FaultsTrain { .. }
            | Call::FaultsNameCell { .. }
            | Call::SegmentsTrain { .. }
            | Call::BodyCalibrate { .. }
            | Call::Mark { .. }
            | Call::SetupRead { .. }
            | Call::SetupSave { .. }
            | Call::SetupFind { .. }
            | Call::PhoneInvite {}
            | Call::PhoneList {}
            | Call::PhoneBlink { .. }
            | Call::HeadingReset { .. }
            | Call::StageAlign { .. }
            | Call::ImuCalibrate { .. }
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
            | Call::SessionDeletePlan { .. } => Err(Refusal::new(
                "replay",
                "this daemon replays a recording; recording, models, exercises, sessions and calibrations belong to a live stage",
            )),
            Call::JobCancel { job } => {
                self.jobs.cancel(job).map(|()| None).map_err(|error| Refusal::new("no_such_job", error))
            }
        }
    }

    /// Sets out for `t`, through the pipeline: filters arrive there as they did live. Says the job's number.
    fn seek(&mut self, t: Timestamp) -> Result<u64, PlayError> {
        let (now, back) = (self.clock.now(), t < self.playing.at);
        // The last known place before it, where that is closer than where it stands.
        let than = if back { self.playing.begun } else { self.playing.at };
        let resumed = self.waypoints.as_ref().and_then(|waypoints| waypoints.before(t, than));
        if let Some(resumed) = resumed {
            self.playing.resume(resumed, now);
        } else if back {
            let Playing { played, speed, .. } = &self.playing;
            self.playing = Playing::open(played.clone(), Some(&self.stage), *speed, now)?;
        }
        self.end_seeking(Err("another time was sought".into()));
        self.hub.rewind();
        let to = t.min(self.playing.played.end);
        let job = self.jobs.begin("replay.seek");
        let number = job.number();
        self.seeking = Some(Seeking { from: self.playing.at, to, job });
        Ok(number)
    }

    /// A batch of the way. True at its end, or where it was cancelled: it plays on from there.
    fn seek_on(&mut self) -> bool {
        let Self { playing, hub, seeking: Some(Seeking { from, to, job }), .. } = self else { return true };
        for _ in 0..SEEK_BATCH {
            match &playing.next {
                Some(next) if next.t < *to && !job.is_cancelled() => {
                    let shown = next.t + SEEK_SHOWN >= *to;
                    playing.step(|output| {
                        if shown {
                            hub.publish(output);
                        }
                    });
                }
                _ => {
                    if !job.is_cancelled() {
                        playing.at = playing.at.max(*to);
                    }
                    playing.set_speed(playing.speed, self.clock.now());
                    let at = format!("at {:.2} s", playing.at.as_secs_f64());
                    self.end_seeking(Ok(at));
                    return true;
                }
            }
        }
        let way_s = to.seconds_since(*from).max(f64::MIN_POSITIVE);
        job.progress(Some(playing.at.seconds_since(*from) / way_s), None);
        false
    }

    fn end_seeking(&mut self, outcome: Result<String, Failure>) {
        if let Some(Seeking { job, .. }) = self.seeking.take() {
            job.end(outcome);
        }
    }

    fn publish_status(&mut self, now: Timestamp) {
        let Playing { played: Played { path, end, .. }, pipeline, begun, at, speed, ended, .. } =
            &self.playing;
        let mut status = self.health.status(now, &pipeline.status(), None, &self.clock);
        status.replay = Some(ReplayStatus {
            name: path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            begun_s: begun.as_secs_f64(),
            end_s: end.as_secs_f64(),
            t_s: at.as_secs_f64(),
            speed: speed.is_finite().then_some(*speed),
            ended: ended.clone(),
            passed_s: self.waypoints.as_ref().map_or(*at, Waypoints::until).max(*begun).as_secs_f64(),
        });
        self.hub.publish_status(status);
    }
}

impl Playing {
    /// Opens a recording at its beginning; on the stage of a running server, where that has one.
    fn open(played: Played, server: Option<&Stage>, speed: f64, now: Timestamp) -> Result<Self, PlayError> {
        let reader = Reader::open(&played.path)?;
        let (stage, machine) = Machine::as_recorded(played.header(&reader))?;
        let names =
            |stage: &Stage| stage.sensors.iter().map(|sensor| sensor.name.clone()).collect::<Vec<_>>();
        if let Some(server) = server
            && names(server) != names(&stage)
        {
            return Err(PlayError::OtherStage { stage: stage.name });
        }
        let begun = reader.header().begun;
        let mut playing = Self {
            played,
            reader,
            pipeline: machine.pipeline,
            begun,
            next: None,
            at: begun,
            speed,
            since: (now, begun),
            ended: None,
        };
        playing.read_next();
        Ok(playing)
    }

    /// Goes on from a waypoint.
    fn resume(&mut self, Resumed { t, reader, pipeline }: Resumed, now: Timestamp) {
        (self.reader, self.pipeline, self.at) = (reader, pipeline, t);
        (self.next, self.ended, self.since) = (None, None, (now, t));
        self.read_next();
    }

    /// Host time of the next entry; `None` in a pause and at the end.
    fn due(&self) -> Option<Timestamp> {
        let next = self.next.as_ref()?;
        if self.speed <= 0.0 {
            return None;
        }
        let (host, stream) = self.since;
        // Division by infinity: everything is due at once.
        let wait_s = next.t.seconds_since(stream).max(0.0) / self.speed;
        Some(host + Duration::try_from_secs_f64(wait_s).unwrap_or(Duration::MAX / 4))
    }

    /// Plays the next entry.
    fn step(&mut self, mut emit: impl FnMut(&posed_stage::output::Output<'_>)) {
        if let Some(entry) = self.next.take() {
            self.at = self.at.max(entry.t);
            self.pipeline.push(&entry, &mut |output| emit(&output));
            self.read_next();
        }
    }

    fn read_next(&mut self) {
        for item in &mut self.reader {
            match item {
                Ok(Item::Entry(entry)) => {
                    self.next = Some(entry);
                    return;
                }
                Ok(Item::Message(_) | Item::Transmitted { .. }) => {}
                Err(error) => {
                    self.ended = Some(error.to_string());
                    return;
                }
            }
        }
        self.ended = Some("the recording ends here".into());
    }

    fn set_speed(&mut self, speed: f64, now: Timestamp) {
        self.speed = speed;
        self.since = (now, self.at);
    }
}

/// Why a recording cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum PlayError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// It cannot be replayed.
    #[error(transparent)]
    Machine(#[from] MachineError),
    /// Clients know other sensors.
    #[error(
        "that recording was made on stage {stage:?} with other sensors; end this replay and open it with `posed replay`"
    )]
    OtherStage {
        /// Where it was made.
        stage: String,
    },
}
