//! The fusion thread: the only owner of the pipeline.
//!
//! It takes one event at a time from its [`Inbox`], writes it to the recording, pushes it through the pipeline and hands
//! the outputs on: bytes to ports, poses and events to the [`Hub`]. None of those can make it wait.

use std::path::PathBuf;
use std::sync::mpsc as std_mpsc;
use std::time::Duration;

use posed_drivers::Timestamp;
use tokio::sync::{mpsc, watch};

use super::calibration::Calibration;
use super::chained::Chained;
use super::clock::StageClock;
use super::health::Health;
use super::inbox::{Event, Inbox};
use super::jobs::{Job, Jobs};
use super::laid::{Laid, Told};
use super::mesh::{Begin, Log};
use super::ports::PortCommand;
use super::positions::RecentPositions;
use super::recent::{Excerpt, Recent};
use super::recorder::{Recorder, RecorderState};
use super::server::{Hub, Reply};
use super::waved::{Seen, Waved};
use super::worn::Worn;
use crate::faults::som::Network;
use crate::faults::som::frames::Frames;
use crate::foxglove::Views;
use crate::fusion::body::SEGMENTS;
use crate::fusion::body::calibrate::Recorded;
use crate::fusion::chain::Epoch;
use crate::input::{Entry, Input, Model, Request, SensorIndex};
use crate::output::{OutcomeKind, Output};
use crate::pipeline::Pipeline;
use crate::protocol::{Answer, Payload, Publisher, RecordingBegun, Status, schema};
use crate::recording::{Header, Snapshot};

/// The queue into the fusion thread.
pub type FusionInbox = Inbox<Command>;

/// The fusion thread answers at once, or is no more.
const PATIENCE: Duration = Duration::from_secs(10);

impl FusionInbox {
    /// Sends a command that is answered with a value, and waits for it: not for an asynchronous task.
    pub(super) fn ask<T>(&self, command: impl FnOnce(std_mpsc::Sender<T>) -> Command) -> Result<T, String> {
        let (to, from) = std_mpsc::channel();
        self.push(Event::Command(command(to)));
        from.recv_timeout(PATIENCE).map_err(|_| "the daemon ends".to_owned())
    }
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
        /// The file; must not exist.
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
    /// Swaps a model in.
    LoadModel(Model),
    /// Copies what was tracked lately.
    Recent {
        /// After this time, s.
        from_s: f64,
        /// Of these columns, of those that there are.
        columns: Vec<String>,
        /// Where the copy goes.
        to: std_mpsc::Sender<Excerpt>,
    },
    /// Copies the raw positions of the newest seconds.
    Positions {
        /// So many; absent: all that is remembered.
        last_s: Option<f64>,
        /// Where the copy goes.
        to: std_mpsc::Sender<Frames>,
    },
    /// Copies the map of faults in use.
    Faults {
        /// Where the copy goes.
        to: std_mpsc::Sender<Option<Box<Network>>>,
    },
    /// Says which IMU is worn where, and sends their samples until nobody takes them any more.
    WatchBody {
        /// Where the IMU of each segment goes.
        worn: std_mpsc::Sender<[Option<SensorIndex>; SEGMENTS]>,
        /// Where the samples go.
        to: std_mpsc::SyncSender<Recorded>,
    },
    /// Sends the records of a magnetic sensor and of its IMU, until nobody takes them any more.
    WatchWaved {
        /// The magnetic sensor.
        sensor: SensorIndex,
        /// Its IMU, where it has one.
        imu: Option<SensorIndex>,
        /// Where they go.
        to: std_mpsc::SyncSender<Seen>,
    },
    /// Says how the pipeline stands, for fusion on another machine; the sentence says why not.
    Begin {
        /// Where it goes.
        to: std_mpsc::Sender<Result<Begin, String>>,
    },
    /// Sends the samples of the chain's IMUs, until nobody takes them any more.
    WatchChain(std_mpsc::SyncSender<Epoch>),
    /// Sends what an IMU tells, uncorrected, until nobody takes it any more.
    WatchImu {
        /// The sensor.
        sensor: SensorIndex,
        /// Where it goes.
        to: std_mpsc::SyncSender<Told>,
    },
    /// Says which unit a sensor is now.
    Unit {
        /// The sensor.
        sensor: SensorIndex,
        /// Where its serial number or name goes.
        to: std_mpsc::Sender<Option<String>>,
    },
    /// A job was cancelled; it may be one of this thread.
    LookAtJobs,
    /// Ends the thread.
    Shutdown,
}

/// A recording in progress, or one that has ended by itself and is not yet reported.
pub(super) struct Recording {
    pub(super) recorder: Recorder,
    pub(super) name: String,
    pub(super) started: Timestamp,
    job: Job,
}

/// The thread's state.
pub(super) struct Fusion {
    pub(super) clock: StageClock,
    pub(super) inbox: FusionInbox,
    pub(super) pipeline: Pipeline,
    pub(super) publisher: Publisher,
    /// What recordings show to viewers.
    pub(super) views: Views,
    pub(super) hub: Hub,
    /// The input log, for other machines.
    pub(super) log: Option<Log>,
    pub(super) jobs: Jobs,
    pub(super) calibration: Calibration,
    pub(super) ports: Vec<mpsc::Sender<PortCommand>>,
    pub(super) health: Health,
    pub(super) status: watch::Sender<Status>,
    pub(super) recording: Option<Recording>,
    /// Recordings that were stopped and still write their index, with who wants to know when they are whole.
    pub(super) ending: Vec<(Recording, Option<Reply>)>,
    /// Whether the pipeline has seen an entry.
    pub(super) begun: bool,
    /// Models swapped in so far, the newest of each kind last.
    pub(super) models: Vec<Model>,
    /// What exercises are taught from.
    pub(super) recent: Recent,
    /// What maps of faults are learnt from.
    pub(super) positions: RecentPositions,
    /// Who calibrates the body, if anybody.
    pub(super) worn: Worn,
    /// Who aligns the stage, if anybody.
    pub(super) waved: Waved,
    /// Who calibrates the chain, if anybody.
    pub(super) chained: Chained,
    /// Who calibrates an IMU, if anybody.
    pub(super) laid: Laid,
    /// What every recording of this run begins with.
    pub(super) recording_header: Header,
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
                Some(Event::Entry(entry)) => self.step(&entry),
                Some(Event::Command(Command::Shutdown)) => break,
                Some(Event::Command(command)) => self.command(command),
                None => {}
            }
            let now = self.clock.now();
            if let Some(t) = timer_at(self.pipeline.poll_timeout(), now, self.inbox.waiting_since()) {
                self.step(&Entry { t, input: Input::Timer });
            }
            if now >= next_status || self.health.changed_since_status(now, STATUS_MIN_INTERVAL) {
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

    /// One entry through recording and pipeline.
    fn step(&mut self, entry: &Entry) {
        self.begun = true;
        let Self {
            pipeline,
            publisher,
            views,
            hub,
            ports,
            health,
            recording,
            clock,
            models,
            recent,
            positions,
            worn,
            waved,
            laid,
            chained,
            calibration,
            log,
            ..
        } = self;
        if let Some(log) = log {
            log.entry(entry);
        }
        let mut recorder = recording.as_mut().map(|recording| &mut recording.recorder);
        if let Some(recorder) = &mut recorder {
            recorder.entry(entry);
        }
        let mut estimated = Timestamp::ZERO;
        pipeline.push(entry, &mut |output| {
            match output {
                Output::Transmit { device, bytes } => {
                    if let Some(recorder) = &mut recorder {
                        recorder.transmitted(device, entry.t, bytes);
                    }
                    send(ports, device, PortCommand::Transmit(bytes.to_vec()));
                }
                Output::SetRts { device, asserted } => send(ports, device, PortCommand::SetRts(asserted)),
                Output::Device { device, state } => health.device_changed(device, state),
                Output::Warning { device, text } => health.warn(device, text),
                Output::Estimate(estimate) => {
                    health.estimate(clock.now().seconds_since(entry.t), estimate);
                    recent.push(estimate);
                    worn.frame(estimate);
                    waved.frame(estimate);
                    laid.frame(estimate);
                    chained.frame(estimate);
                    positions.push(estimate);
                }
                Output::Outcome(outcome) => {
                    if let OutcomeKind::ModelSwapped(model) = &outcome.what {
                        views.swap(model);
                        models.retain(|old| !old.replaced_by(model));
                        models.push(model.clone());
                    }
                }
                Output::PoleRun(run) => calibration.solve(run),
                Output::Named => health.named(clock.now().seconds_since(estimated)),
                Output::Body(body) => {
                    health.body(body);
                    recent.body(body);
                }
                Output::Truth(_) => {}
            }
            let Some(payload) = Payload::of(&output) else { return };
            // Clients first: the recording has time.
            hub.publish(&output);
            match &mut recorder {
                Some(recorder) => {
                    let (stamp, message) = publisher.publish(&payload);
                    recorder.message(stamp.topic.name(), stamp.t(), message);
                    views.publish(&payload, &stamp, |channel, json| recorder.view(channel, stamp.t(), json));
                }
                None => _ = publisher.skip(&payload),
            }
            // What comes next is the work on segments.
            estimated = clock.now();
        });
        waved.look(pipeline);
    }

    fn command(&mut self, command: Command) {
        match command {
            Command::StartRecording { path, reply } => {
                let started = self.start_recording(path);
                self.health.touch();
                answer(reply, started.map(|begun| Some(Answer::RecordingBegun(begun))));
            }
            Command::StopRecording { reply } => match self.recording.take() {
                Some(recording) => self.stop_recording(recording, reply),
                None => answer(reply, Err("nothing is being recorded".to_owned())),
            },
            Command::Request { request, models, reply } => {
                let done = self.request(request, models);
                answer(reply, done.map(|()| None));
            }
            Command::LoadModel(model) => {
                self.step(&Entry { t: self.clock.now(), input: Input::Model(model) })
            }
            Command::Recent { from_s, columns, to } => {
                let wanted = |column: &str| columns.iter().any(|wanted| wanted == column);
                // A job that has ended meanwhile does not want it any more.
                let _ = to.send(self.recent.after(from_s, wanted));
            }
            Command::Positions { last_s, to } => {
                let _ = to.send(self.positions.newest(last_s, self.pipeline.room_transmitter()));
            }
            Command::Faults { to } => {
                let network = self.models.iter().find_map(|model| match model {
                    Model::Faults { network } => Some(network.clone()),
                    _ => None,
                });
                let _ = to.send(network);
            }
            Command::Begin { to } => _ = to.send(self.begin()),
            Command::WatchBody { worn, to } => {
                let imus = self.pipeline.worn_imus();
                let _ = worn.send(imus);
                self.worn.watch(imus, to);
            }
            Command::WatchWaved { sensor, imu, to } => self.waved.watch(sensor, imu, to),
            Command::WatchChain(to) => self.chained.watch(to),
            Command::WatchImu { sensor, to } => self.laid.watch(sensor, to),
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

    /// A request through the log, with the models that it needs.
    fn request(&mut self, request: Request, models: Vec<Model>) -> Result<(), String> {
        for model in models {
            if !self.models.iter().any(|known| known.replaced_by(&model)) {
                self.step(&Entry { t: self.clock.now(), input: Input::Model(model) });
            }
        }
        self.pipeline.check_request(&request)?;
        self.step(&Entry { t: self.clock.now(), input: Input::Request(request) });
        Ok(())
    }

    fn stop_recording(&mut self, mut recording: Recording, reply: Option<Reply>) {
        recording.recorder.stop("stopped by a client");
        self.ending.push((recording, reply));
        self.health.touch();
    }

    /// Begins a recording and says its name and its job's number.
    pub(super) fn start_recording(&mut self, path: PathBuf) -> Result<RecordingBegun, String> {
        if let Some(recording) = &self.recording {
            return Err(format!("{} is being recorded already; stop that first", recording.name));
        }
        let header = self.header()?;
        let started = header.begun;
        let recorder = Recorder::start(&path, header, &schema::of_topics())
            .map_err(|error| format!("cannot record to {}: {error}", path.display()))?;
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        self.health.recording_started();
        let job = self.jobs.begin("record.start");
        let result = RecordingBegun { name: name.clone(), job: job.number() };
        self.recording = Some(Recording { recorder, name, started, job });
        Ok(result)
    }

    /// What a replay needs that begins here.
    fn header(&self) -> Result<Header, String> {
        let publisher = rmp_serde::to_vec(&self.publisher.state()).map_err(|error| error.to_string())?;
        Ok(Header {
            begun: self.clock.now(),
            models: self.models.clone(),
            // A recording of the whole run needs none: it begins where every pipeline begins.
            snapshot: self.begun.then(|| Snapshot { pipeline: self.pipeline.snapshot(), publisher }),
            ..self.recording_header.clone()
        })
    }

    /// The same for another machine, and the number of the entry that follows.
    fn begin(&self) -> Result<Begin, String> {
        let log = self.log.as_ref().ok_or("this stage has no [zenoh]")?;
        Ok(Begin { next: log.next(), header: self.header()? })
    }

    /// Answers for recordings that are whole now.
    fn take_ended(&mut self) {
        while let Some(at) = self.ending.iter().position(|(recording, _)| recording.recorder.is_finished()) {
            let (recording, reply) = self.ending.swap_remove(at);
            let ended = whole(recording);
            if let Err(reason) = &ended {
                self.health.recording_failed(reason.clone());
            }
            answer(reply, ended.map(|()| None));
        }
    }

    fn publish_status(&mut self, now: Timestamp) {
        if let Some(recording) = self.recording.take_if(|recording| recording.recorder.is_finished())
            && let Err(reason) = whole(recording)
        {
            self.health.recording_failed(reason);
        }
        if let Some(recording) = &self.recording {
            let megabytes = recording.recorder.bytes_written() as f64 * 1e-6;
            recording.job.progress(None, Some(format!("{}: {megabytes:.1} MB", recording.name)));
        }
        let status = self.health.status(now, &self.pipeline.status(), self.recording.as_ref(), &self.clock);
        self.status.send_replace(status.clone());
        self.hub.publish_status(status);
    }
}

/// When a time-out takes place, if it does: not before what was read before it, which may still be waiting.
fn timer_at(due: Option<Timestamp>, now: Timestamp, waiting_since: Option<Timestamp>) -> Option<Timestamp> {
    let t = waiting_since.map_or(now, |waiting| waiting.min(now));
    due.filter(|&due| due <= t).map(|_| t)
}

/// Waits for the end of a recording that was stopped, and says whether it is whole.
fn whole(recording: Recording) -> Result<(), String> {
    let Recording { recorder, name, job, .. } = recording;
    let ended = match recorder.wait() {
        RecorderState::Failed { reason } => Err(format!("{name}: {reason}")),
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

fn answer(reply: Option<Reply>, result: Result<Option<Answer>, String>) {
    match (reply, result) {
        (Some(reply), Ok(result)) => reply.ok(result),
        (Some(reply), Err(sentence)) => reply.error("failed", sentence),
        (None, Ok(_)) => {}
        (None, Err(sentence)) => tracing::error!("{sentence}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
