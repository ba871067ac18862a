//! The fusion thread: the only owner of the pipeline.
//!
//! It takes one event at a time from its [`Inbox`], writes it to the recording, pushes it through the pipeline and hands
//! the outputs on: bytes to ports, poses and events to the [`Hub`]. None of those can make it wait.

use std::path::PathBuf;
use std::sync::mpsc as std_mpsc;
use std::time::Duration;

use posed_drivers::{Found, Timestamp};
use tokio::sync::mpsc;

use super::clock::StageClock;
use super::fault_points;
use super::inbox::{Event, Inbox};
use super::jobs::{Job, Jobs};
use super::library::{Held, InUse, Use};
use super::observers::{Excerpt, GuidedCalibration, Observer, Observers, Samples, Source, Times};
use super::ports::PortCommand;
use super::recorder::{Gathering, Recorder, RecorderState};
use super::server::{Hub, Refusal, Reply};
use posed_fusion::body::SEGMENTS;
use posed_motion::fault_map::FaultMap;
use posed_motion::fault_map::Frames;
use posed_pipeline::{InputError, SupervisedPipeline};
use posed_protocol::foxglove::Views;
use posed_protocol::{Answer, Payload, Publisher, RecordingBegun, schema};
use posed_recording::{Header, Snapshot, WriteError};
use posed_stage::input::{Entry, Input, Model, Request, SensorIndex};
use posed_stage::output::{OutcomeKind, Output};
use posed_stage::{BodyIndex, RecordingContent};

/// The queue into the fusion thread; clones share it. Only the daemon takes from it.
pub type FusionInbox = Inbox<Command>;

/// The fusion thread answers at once, or is no more.
const PATIENCE: Duration = Duration::from_secs(10);

impl FusionInbox {
    /// What a fusion on another machine begins with: the pipeline as it stands now. Waits, ten seconds at most: not for an
    /// asynchronous task.
    ///
    /// # Errors
    /// The daemon ends or does not answer in time, or its state cannot be written.
    pub fn begin(&self) -> Result<Begin, BeginError> {
        Ok(self.ask(|to| Command::Begin { to })??)
    }

    /// Begins to send samples for a guided calibration; whoever took them before gets nothing more.
    pub(super) fn watch<S: Source>(&self, source: S) -> std_mpsc::Receiver<S::Sample> {
        let (observer, samples) = Samples::new(source);
        let observer = Box::new(observer);
        self.command(Command::Watch { calibration: S::CALIBRATION, observer });
        samples
    }

    /// Sends a command that is answered with a value, and waits for it: not for an asynchronous task.
    pub(super) fn ask<T>(
        &self,
        command: impl FnOnce(std_mpsc::SyncSender<T>) -> Command,
    ) -> Result<T, Ended> {
        let (to, from) = std_mpsc::sync_channel(1);
        self.command(command(to));
        from.recv_timeout(PATIENCE).map_err(|_| Ended)
    }
}

/// The pipeline as it stands before an entry, for fusion on another machine.
#[derive(Debug)]
pub struct Begin {
    /// Number of that entry: so many entries the pipeline has taken, the first has number 0.
    pub next: u64,
    /// What fusion begins with: the header of a recording that begins here.
    pub header: Header,
}

/// Why there is no [`Begin`].
#[derive(Debug, thiserror::Error)]
pub enum BeginError {
    /// The fusion thread gives no answer.
    #[error(transparent)]
    Ended(#[from] Ended),
    /// The state cannot be written.
    #[error(transparent)]
    State(#[from] rmp_serde::encode::Error),
}

/// The fusion thread is no more, or has not answered within ten seconds.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("the daemon ends")]
pub struct Ended;

/// Why nothing is recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// Another recording of this name is in progress: there is one at a time.
    #[error("{0} is being recorded already; stop that first")]
    Already(String),
    /// The file does not serve.
    #[error("cannot record to {}: {error}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        error: WriteError,
    },
    /// The state that it begins with cannot be written.
    #[error(transparent)]
    State(#[from] rmp_serde::encode::Error),
    /// The system has no thread for it.
    #[error("the system gives no thread for the recording")]
    NoThread,
}

/// Why a request or a model is not taken.
#[derive(Debug, thiserror::Error)]
enum NotTaken {
    /// The pipeline states what stands against it.
    #[error(transparent)]
    Refused(#[from] InputError),
    /// The pipeline panicked at it.
    #[error("tracking had a fault of its own at this and goes on without it; please report this")]
    Fault,
}

/// A recording that is not whole.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{name}: {reason}")]
struct Incomplete {
    name: String,
    reason: String,
    /// It never began, and who asked for it knows.
    refused: bool,
}

/// Chunks that wait at most: at 1000 reads per second, four seconds of a stalled machine.
pub(super) const INBOX_CAPACITY: usize = 4096;
/// Distance of two `status` messages when nothing changes.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);
/// Distance of two `status` messages when things change all the time.
const STATUS_MIN_INTERVAL: Duration = Duration::from_millis(100);
/// Distance of two looks at a recording that is being ended.
const ENDING_INTERVAL: Duration = Duration::from_millis(20);
/// A wake-up that is later than this shows a host with too much to do.
const LATE_WAKE: Duration = Duration::from_millis(1);
/// How long its port tasks then have to bring what they should have read.
const READERS_FIRST: Duration = Duration::from_millis(2);

/// What the fusion thread can be asked between two entries.
#[derive(Debug)]
pub enum Command {
    /// Begins a recording in this file.
    StartRecording {
        /// The file; must not exist. Its folder is made.
        path: PathBuf,
        /// Who wants to know.
        reply: Option<Reply>,
    },
    /// Ends the recording.
    StopRecording {
        /// Who wants to know.
        reply: Option<Reply>,
    },
    /// Hands a request to the pipeline, if it can be carried out.
    Request {
        /// The request.
        request: Request,
        /// Models that it needs, swapped in before where the pipeline lacks them.
        models: Vec<Model>,
        /// Who wants to know.
        reply: Option<Reply>,
    },
    /// Swaps a model in, if it can be used.
    LoadModel {
        /// The model.
        model: Model,
        /// Who wants to know.
        reply: Option<Reply>,
    },
    /// Copies what was tracked lately.
    Recent {
        /// After this time, s.
        from_s: f64,
        /// Of these columns, of those that there are.
        columns: Vec<String>,
        /// Where the copy goes.
        to: std_mpsc::SyncSender<Excerpt>,
    },
    /// Copies the raw poses of the newest seconds.
    Poses {
        /// So many; absent: all that is remembered.
        last_s: Option<f64>,
        /// Where the copy goes.
        to: std_mpsc::SyncSender<Frames>,
    },
    /// Copies the fault map in use.
    Faults {
        /// Where the copy goes.
        to: std_mpsc::SyncSender<Option<Box<FaultMap>>>,
    },
    /// Lets a guided calibration look on, in the place of an older one of its kind.
    Watch {
        /// Which.
        calibration: GuidedCalibration,
        /// What looks on.
        observer: Box<dyn Observer + Send>,
    },
    /// Reports which IMU a body wears where.
    BodyImus {
        /// Which.
        body: BodyIndex,
        /// Where the IMU of each segment goes.
        to: std_mpsc::SyncSender<[Option<SensorIndex>; SEGMENTS]>,
    },
    /// Reports, for each device, which sensors send to it and are not on the stage.
    Found {
        /// Where it goes.
        to: std_mpsc::SyncSender<Vec<Vec<Found>>>,
    },
    /// Reports how the pipeline stands, for fusion on another machine; the sentence states why not.
    Begin {
        /// Where it goes.
        to: std_mpsc::SyncSender<Result<Begin, rmp_serde::encode::Error>>,
    },
    /// Reports which unit a sensor is now.
    Unit {
        /// The sensor.
        sensor: SensorIndex,
        /// Where its serial number or name goes.
        to: std_mpsc::SyncSender<Option<String>>,
    },
    /// A job was cancelled; it may be one of this thread.
    LookAtJobs,
    /// Ends the thread.
    Shutdown,
}

impl Command {
    /// Swaps a model in that the daemon has made itself; nobody waits for the answer.
    pub(super) fn load(model: Model) -> Self {
        Self::LoadModel { model, reply: None }
    }
}

/// A recording in progress, or one that has ended by itself and is not yet reported.
pub(super) struct Recording {
    pub(super) recorder: Recorder,
    pub(super) name: String,
    pub(super) started: Timestamp,
    job: Job,
    /// Nobody moves the file until it is whole.
    _held: Held,
}

/// The thread's state.
pub(super) struct Fusion {
    pub(super) clock: StageClock,
    pub(super) inbox: FusionInbox,
    pub(super) pipeline: SupervisedPipeline,
    pub(super) publisher: Publisher,
    /// What recordings show to viewers.
    pub(super) views: Views,
    pub(super) hub: Hub,
    pub(super) jobs: Jobs,
    pub(super) ports: Vec<mpsc::Sender<PortCommand>>,
    pub(super) observers: Observers,
    pub(super) recording: Option<Recording>,
    /// Recordings that were stopped and still write their index, with who wants to know when they are whole.
    pub(super) ending: Vec<(Recording, Option<Reply>)>,
    /// Entries that the pipeline has seen.
    pub(super) entries: u64,
    /// What every recording of this run begins with.
    pub(super) recording_header: Header,
    /// What is gathered of each of them, as yet empty.
    pub(super) gathering: Gathering,
    /// Where it is said which files are in use.
    pub(super) in_use: InUse,
}

impl Fusion {
    /// Runs until [`Command::Shutdown`]; the recording is complete when it returns.
    pub(super) fn run(mut self) {
        let mut next_status = self.clock.now();
        loop {
            let mut wake =
                self.pipeline.poll_timeout().map_or(next_status, |timeout| timeout.min(next_status));
            if !self.ending.is_empty() {
                wake = wake.min(self.clock.now() + ENDING_INTERVAL);
                self.take_ended();
            }
            match self.next_event(wake) {
                Some(Event::Entry(entry)) => _ = self.step(&entry),
                Some(Event::Command(Command::Shutdown)) => break,
                Some(Event::Command(command)) => self.command(command),
                None => {}
            }
            let now = self.clock.now();
            if let Some(t) = timer_at(self.pipeline.poll_timeout(), now, self.inbox.waiting_since()) {
                self.step(&Entry { t, input: Input::Timer });
            }
            if now >= next_status || self.observers.health.changed_since_status(now, STATUS_MIN_INTERVAL) {
                next_status = now + STATUS_INTERVAL;
                self.publish_status(now);
            }
        }
        if let Some(recording) = self.recording.take() {
            // What failed has been logged by the recorder.
            let _ = whole(recording);
        }
        for (recording, reply) in self.ending.drain(..) {
            answer(reply, whole(recording).map(|()| None));
        }
    }

    /// The next event, or `None` at `wake`.
    fn next_event(&self, wake: Timestamp) -> Option<Event<Command>> {
        self.inbox.pop_until(Some(self.clock.instant(wake))).or_else(|| {
            // A host that wakes this thread late has kept the port tasks waiting too. What they bring was there
            // before the time-out, and must not make a frame miss it.
            let now = self.clock.now();
            let late = now > wake + LATE_WAKE;
            late.then(|| self.inbox.pop_until(Some(self.clock.instant(now + READERS_FIRST)))).flatten()
        })
    }

    /// One entry through recording and pipeline; whether the pipeline has taken it.
    fn step(&mut self, entry: &Entry) -> bool {
        self.entries += 1;
        let _ = fault_points::pass("fusion");
        #[cfg(feature = "fault-points")]
        if fault_points::pass("pipeline").is_err() {
            self.pipeline.panic_next();
        }
        let Self { pipeline, publisher, views, hub, ports, observers, recording, clock, .. } = self;
        let content = self.recording_header.content;
        observers.on_entry(entry);
        let mut recorder = recording.as_mut().map(|recording| &mut recording.recorder);
        if let Some(recorder) = &mut recorder {
            recorder.entry(entry);
        }
        let mut published = Timestamp::ZERO;
        let left_out = pipeline.entries_left_out();
        pipeline.push(entry, &mut |output| {
            observers.on_output(&output, &Times { read: entry.t, published, now: clock.now() });
            if let Some(recorder) = &mut recorder {
                recorder.output(&output);
            }
            match output {
                Output::Transmit { device, bytes } => {
                    if let Some(recorder) = &mut recorder {
                        recorder.transmitted(device, entry.t, bytes);
                    }
                    send(ports, device, PortCommand::Transmit(bytes.to_vec()));
                }
                Output::SetRts { device, asserted } => send(ports, device, PortCommand::SetRts(asserted)),
                Output::Outcome(outcome) => {
                    if let OutcomeKind::ModelSwapped(model) = &outcome.what {
                        views.swap(model);
                    }
                }
                Output::Device { .. }
                | Output::Warning { .. }
                | Output::Estimate(_)
                | Output::PoleRun(_)
                | Output::Named
                | Output::Body(_)
                | Output::Truth(_)
                | Output::Timecode(_) => {}
            }
            let Some(payload) = Payload::of(&output) else { return };
            // Clients first: the recording has time.
            hub.publish(&output);
            match &mut recorder {
                Some(recorder) => {
                    let stamp = match content {
                        RecordingContent::Log => publisher.skip(&payload),
                        RecordingContent::Full => {
                            let (stamp, message) = publisher.publish(&payload);
                            recorder.message(stamp.topic.name(), stamp.t(), message);
                            stamp
                        }
                    };
                    views.publish(&payload, &stamp, |channel, json| recorder.view(channel, stamp.t(), json));
                    recorder.published(&payload, &stamp);
                }
                None => _ = publisher.skip(&payload),
            }
            // What comes next is the work on segments.
            published = clock.now();
        });
        observers.after_entry(pipeline);
        let is_taken = pipeline.entries_left_out() == left_out;
        if !is_taken {
            // The panic itself stands in the log above.
            tracing::error!(
                "tracking went on without what it panicked at; please report this with a recording"
            );
            observers.health.touch();
        }
        is_taken
    }

    /// The same for what somebody waits for, if the pipeline accepts it.
    fn step_checked(&mut self, checked: Result<(), InputError>, input: Input) -> Result<(), NotTaken> {
        checked?;
        let is_taken = self.step(&Entry { t: self.clock.now(), input });
        if is_taken { Ok(()) } else { Err(NotTaken::Fault) }
    }

    fn command(&mut self, command: Command) {
        match command {
            Command::StartRecording { path, reply } => {
                let tell = |begun: Result<RecordingBegun, RecordError>| {
                    answer(reply, begun.map(|begun| Some(Answer::RecordingBegun(begun))));
                };
                self.start_recording(path, true, tell);
                self.observers.health.touch();
            }
            Command::StopRecording { reply } => match self.recording.take() {
                Some(recording) => self.stop_recording(recording, reply),
                None => answer(reply, Err("nothing is being recorded")),
            },
            Command::Request { request, models, reply } => {
                for model in models {
                    if !self.pipeline.models().iter().any(|known| known.replaced_by(&model)) {
                        self.step(&Entry { t: self.clock.now(), input: Input::Model(model) });
                    }
                }
                let checked = self.pipeline.check_request(&request);
                let carried_out = self.step_checked(checked, Input::Request(request));
                answer(reply, carried_out.map(|()| None));
            }
            Command::LoadModel { model, reply } => {
                let checked = self.pipeline.check_model(&model);
                let taken = self.step_checked(checked, Input::Model(model));
                answer(reply, taken.map(|()| None));
            }
            Command::Recent { from_s, columns, to } => {
                let wanted = |column: &str| columns.iter().any(|wanted| wanted == column);
                // A job that has ended meanwhile does not want it any more.
                let _ = to.send(self.observers.recent.after(from_s, wanted));
            }
            Command::Poses { last_s, to } => {
                let _ = to.send(self.observers.poses.newest(last_s, self.pipeline.room_transmitter()));
            }
            Command::Faults { to } => {
                let fault_map = self.pipeline.models().iter().find_map(|model| match model {
                    Model::Faults { fault_map } => Some(fault_map.clone()),
                    _ => None,
                });
                let _ = to.send(fault_map);
            }
            Command::Begin { to } => _ = to.send(self.begin()),
            Command::Watch { calibration, observer } => self.observers.watch(calibration, observer),
            Command::BodyImus { body, to } => _ = to.send(self.pipeline.body_imus(body)),
            Command::Found { to } => {
                let devices = self.pipeline.status().devices;
                let _ = to.send(devices.into_iter().map(|device| device.found).collect());
            }
            Command::Unit { sensor, to } => {
                let _ = to.send(self.pipeline.unit(sensor).map(str::to_owned));
            }
            Command::LookAtJobs => {
                if let Some(recording) = self.recording.take_if(|recording| recording.job.is_cancelled()) {
                    self.stop_recording(recording, None);
                }
            }
            Command::Shutdown => {}
        }
    }

    fn stop_recording(&mut self, mut recording: Recording, reply: Option<Reply>) {
        recording.recorder.stop("stopped by a client");
        self.ending.push((recording, reply));
        self.observers.health.touch();
    }

    /// Begins a recording; `tell` hears its name and its job's number, or why there is none, once the disk has answered. Not on this
    /// thread, which does not wait for a disk.
    pub(super) fn start_recording(
        &mut self,
        path: PathBuf,
        make_folder: bool,
        tell: impl FnOnce(Result<RecordingBegun, RecordError>) + Send + 'static,
    ) {
        // One that could not begin stands in nobody's way.
        let is_refused =
            |recording: &mut Recording| matches!(recording.recorder.state(), RecorderState::Refused { .. });
        if let Some(refused) = self.recording.take_if(is_refused) {
            self.ending.push((refused, None));
        }
        if let Some(recording) = &self.recording {
            return tell(Err(RecordError::Already(recording.name.clone())));
        }
        let header = match self.header() {
            Ok(header) => header,
            Err(error) => return tell(Err(error.into())),
        };
        let (started, job) = (header.begun, self.jobs.begin("record.start"));
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let result = RecordingBegun { name: name.clone(), job: job.number() };
        let file = path.clone();
        let begun = move |begun: Result<(), WriteError>| {
            tell(begun.map(|()| result).map_err(|error| RecordError::File { path: file, error }));
        };
        let held = self.in_use.hold(&path, Use::Recorded);
        let gathering = self.gathering.begun_at(header.begun);
        match Recorder::start(path, make_folder, (header, gathering), schema::of_topics, begun) {
            Ok(recorder) => {
                self.observers.health.recording_started();
                self.recording = Some(Recording { recorder, name, started, job, _held: held });
            }
            Err(error) => job.end(Err::<String, _>(error)),
        }
    }

    /// What a replay needs that begins here.
    fn header(&self) -> Result<Header, rmp_serde::encode::Error> {
        let publisher = rmp_serde::to_vec(&self.publisher.state())?;
        Ok(Header {
            begun: self.clock.now(),
            models: self.pipeline.models().clone(),
            // A recording of the whole run needs none: it begins where every pipeline begins.
            snapshot: (self.entries > 0).then(|| Snapshot { pipeline: self.pipeline.snapshot(), publisher }),
            ..self.recording_header.clone()
        })
    }

    /// The same for another machine, and the number of the entry that follows.
    fn begin(&self) -> Result<Begin, rmp_serde::encode::Error> {
        Ok(Begin { next: self.entries, header: self.header()? })
    }

    /// Answers for recordings that are whole now.
    fn take_ended(&mut self) {
        while let Some(at) = self.ending.iter().position(|(recording, _)| recording.recorder.is_finished()) {
            let (recording, reply) = self.ending.swap_remove(at);
            let ended = whole(recording);
            self.report(&ended);
            answer(reply, ended.map(|()| None));
        }
    }

    fn report(&mut self, ended: &Result<(), Incomplete>) {
        if let Err(reason) = ended
            && !reason.refused
        {
            self.observers.health.recording_failed(reason.to_string());
        }
    }

    fn publish_status(&mut self, now: Timestamp) {
        if let Some(recording) = self.recording.take_if(|recording| recording.recorder.is_finished()) {
            self.report(&whole(recording));
        }
        if let Some(recording) = &self.recording {
            let megabytes = recording.recorder.bytes_written() as f64 * 1e-6;
            recording.job.progress(None, Some(format!("{}: {megabytes:.1} MB", recording.name)));
        }
        let status =
            self.observers.health.status(now, &self.pipeline.status(), self.recording.as_ref(), &self.clock);
        self.observers.training.recording(status.recording.as_ref().map(|recording| recording.name.as_str()));
        self.hub.publish_status(status);
    }
}

/// When a time-out takes place, if it does: not before what was read before it, which may still be waiting.
fn timer_at(due: Option<Timestamp>, now: Timestamp, waiting_since: Option<Timestamp>) -> Option<Timestamp> {
    let t = waiting_since.map_or(now, |waiting| waiting.min(now));
    due.filter(|&due| due <= t).map(|_| t)
}

/// Waits for the end of a recording that was stopped, and returns whether it is whole.
fn whole(recording: Recording) -> Result<(), Incomplete> {
    let Recording { recorder, name, job, _held, .. } = recording;
    let ended = match recorder.wait() {
        RecorderState::Failed { reason } => Err(Incomplete { name: name.clone(), reason, refused: false }),
        RecorderState::Refused { reason } => Err(Incomplete { name: name.clone(), reason, refused: true }),
        RecorderState::Recording | RecorderState::Stopped { .. } => Ok(()),
    };
    job.end(ended.clone().map(|()| format!("{name} is complete")));
    ended
}

/// Never waits: a port that takes no bytes is about to be reported as gone, and its session asks again.
fn send(ports: &[mpsc::Sender<PortCommand>], device: u16, command: PortCommand) {
    if let Some(port) = ports.get(usize::from(device)) {
        let _ = port.try_send(command);
    }
}

fn answer(reply: Option<Reply>, result: Result<Option<Answer>, impl ToString>) {
    match (reply, result) {
        (Some(reply), result) => reply.answer(result.map_err(Refusal::failed)),
        (None, Ok(_)) => {}
        (None, Err(reason)) => tracing::error!("{}", reason.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::PORT_COMMANDS;
    use super::*;

    #[test]
    fn a_port_that_takes_nothing_is_left_out_and_the_other_gets_all_that_is_its() {
        let (stuck_in, mut stuck) = mpsc::channel(PORT_COMMANDS);
        let (other_in, mut other) = mpsc::channel(PORT_COMMANDS);
        let ports = [stuck_in, other_in];
        let bytes = |n: usize| PortCommand::Transmit(n.to_le_bytes().to_vec());
        for n in 0..2 * PORT_COMMANDS {
            send(&ports, 0, bytes(n));
            send(&ports, 1, bytes(n));
            assert_eq!(other.try_recv(), Ok(bytes(n)));
        }
        // What was said first is whole: a device must not be sent the end of something without its beginning.
        let waiting: Vec<_> = std::iter::from_fn(|| stuck.try_recv().ok()).collect();
        assert_eq!(waiting, (0..PORT_COMMANDS).map(bytes).collect::<Vec<_>>());
        send(&ports, 0, bytes(7));
        assert_eq!(stuck.try_recv(), Ok(bytes(7)));
    }

    #[test]
    fn what_was_read_before_a_time_out_comes_before_it() {
        let ms = |ms: i64| Timestamp::from_nanos(ms * 1_000_000);
        assert_eq!(timer_at(None, ms(50), None), None);
        assert_eq!(timer_at(Some(ms(40)), ms(39), None), None, "not due");
        assert_eq!(timer_at(Some(ms(40)), ms(41), None), Some(ms(41)));
        // The thread is late by 10 ms, and bytes of before the time-out wait in the queue: they go first.
        assert_eq!(timer_at(Some(ms(40)), ms(50), Some(ms(38))), None);
        // Bytes of after it do not; the time-out is entered before them in the log.
        assert_eq!(timer_at(Some(ms(40)), ms(50), Some(ms(45))), Some(ms(45)));
    }
}
