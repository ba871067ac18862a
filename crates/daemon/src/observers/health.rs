//! What `status` says: the pipeline's counts, the links' states, how long things took, what is wrong now.

use posed_drivers::{State, Timestamp};

use super::super::clock::StageClock;
use super::super::free_space::FreeSpace;
use super::super::fusion::Recording;
use super::super::host_clock;
use super::super::timecode::TimecodeProblem;
use super::history::{History, Kept};
use super::{Observer, Times};
use posed_fusion::faults::Cause;
use posed_pipeline::PipelineStatus;
use posed_protocol::{DeviceStatus, Problem, RecordingStatus, SensorStatus, StageLatency, Status};
use posed_stage::Stage;
use posed_stage::input::DeviceIndex;
use posed_stage::output::{Body, Estimate, Output};
use posed_timecode::Rate as PictureRate;
use std::time::Duration;

/// Samples of each latency between two status messages; more than a second holds.
const SAMPLES: usize = 4096;
/// A machine keeps up where all but a hundredth of the frames are estimated so soon after their bytes were read, ms; and does not where
/// that is so for longer than this, s.
const KEEPS_UP_MS: f64 = 50.0;
const BEHIND_S: f64 = 3.0;
/// Frames that say so in one status.
const BEHIND_FRAMES: usize = 10;
/// A battery is reported to be low below this share of its charge.
const LOW_BATTERY: f64 = 0.1;
/// Warnings about one device that are kept.
const WARNINGS: usize = 4;

/// Collects what the status needs; belongs to the fusion thread.
pub(crate) struct Health {
    devices: Vec<Device>,
    sensors: Vec<Sensor>,
    /// Read of a frame's last byte to its estimate, s.
    read_to_estimate: Latency,
    /// Capture of a frame to its estimate, s.
    capture_to_estimate: Latency,
    /// Work of the network of segments per frame, s; absent without one.
    segments: Option<Latency>,
    /// What is wrong with each segment's sensor.
    bodies: Vec<Vec<Option<Cause>>>,
    /// The bodies' names.
    names: Vec<String>,
    recording_failure: Option<String>,
    /// What the disk of the recordings still takes; absent where nothing is recorded.
    disk: Option<FreeSpace>,
    /// What is wrong with the source of time code; absent where the stage has none.
    timecode: Option<TimecodeProblem>,
    /// The rate of its pictures by the stage file, and as the code has it.
    timecode_rate: (Option<PictureRate>, Option<PictureRate>),
    /// Entries that tracking has left out, and how often it has begun anew, by the last status.
    recovered: (u64, u64),
    /// The time since which this machine does not keep up, and by how much, ms.
    behind: Option<(Timestamp, f64)>,
    history: History,
    changed: bool,
    last_status: Timestamp,
}

struct Sensor {
    name: String,
    /// Index of its device.
    device: Option<usize>,
    rate: Rate,
}

/// How often something is counted.
#[derive(Default)]
struct Rate {
    since: Timestamp,
    count: u64,
    hz: Option<f64>,
}

impl Rate {
    /// Over this long at least, s.
    const LEAST_S: f64 = 0.9;

    /// Per second since about a second ago.
    fn of(&mut self, now: Timestamp, count: u64) -> Option<f64> {
        let interval_s = now.seconds_since(self.since);
        if interval_s >= Self::LEAST_S {
            self.hz = Some(count.saturating_sub(self.count) as f64 / interval_s);
            (self.since, self.count) = (now, count);
        }
        self.hz
    }
}

struct Device {
    name: String,
    driver: String,
    port: String,
    warnings: Vec<String>,
}

impl Health {
    pub(crate) fn new(stage: &Stage) -> Self {
        let device = |device: &posed_stage::Device| Device {
            name: device.name.clone(),
            driver: device.driver.word().to_owned(),
            port: device.port.clone(),
            warnings: Vec::new(),
        };
        let sensor = |sensor: &posed_stage::Sensor| Sensor {
            name: sensor.name.clone(),
            device: stage.devices.iter().position(|device| device.name == sensor.device),
            rate: Rate::default(),
        };
        Self {
            devices: stage.devices.iter().map(device).collect(),
            sensors: stage.sensors.iter().map(sensor).collect(),
            read_to_estimate: Latency::new("read to estimate"),
            capture_to_estimate: Latency::new("capture to estimate"),
            segments: None,
            bodies: vec![Vec::new(); stage.bodies.len()],
            names: stage.bodies.iter().map(|body| body.name.clone()).collect(),
            recording_failure: None,
            disk: None,
            timecode: None,
            timecode_rate: (stage.timecode.as_ref().and_then(|timecode| timecode.rate), None),
            recovered: (0, 0),
            behind: None,
            history: History::new(stage),
            changed: true,
            last_status: Timestamp::ZERO,
        }
    }

    /// The network of segments took so long for a frame.
    fn named(&mut self, seconds: f64) {
        self.segments.get_or_insert_with(|| Latency::new("segments")).add(seconds);
    }

    /// A frame was estimated `after_read_s` after its last bytes had been read.
    pub(crate) fn estimate(&mut self, after_read_s: f64, estimate: &Estimate) {
        self.read_to_estimate.add(after_read_s);
        self.capture_to_estimate.add(after_read_s + estimate.t_closed.seconds_since(estimate.t_valid));
        self.history.estimate(estimate);
    }

    /// News of the body: a sensor that becomes faulty is reported at once.
    fn body(&mut self, body: &Body) {
        let Some(known) = self.bodies.get_mut(usize::from(body.index)) else { return };
        let faults = body.segments.iter().map(|segment| segment.fault);
        if !faults.clone().eq(known.iter().copied()) {
            known.clear();
            known.extend(faults);
            self.changed = true;
        }
    }

    /// A link's state changed.
    fn device_changed(&mut self, device: DeviceIndex, state: &State) {
        let Some(device) = self.devices.get_mut(usize::from(device)) else { return };
        match state {
            State::Streaming => tracing::info!(device = device.name, "streaming"),
            State::Connecting { reason } => tracing::debug!(device = device.name, reason, "connecting"),
            State::Silent { reason } => tracing::warn!(device = device.name, reason, "silent"),
            State::Failed { reason } => tracing::warn!(device = device.name, reason, "failed"),
        }
        if matches!(state, State::Connecting { .. }) {
            // What was wrong before belongs to the set-up before.
            device.warnings.clear();
        }
        self.changed = true;
    }

    /// A sentence about a device.
    fn warn(&mut self, device: DeviceIndex, text: &str) {
        let Some(device) = self.devices.get_mut(usize::from(device)) else { return };
        if device.warnings.iter().any(|known| known == text) {
            return;
        }
        tracing::warn!(device = device.name, "{text}");
        if device.warnings.len() == WARNINGS {
            device.warnings.remove(0);
        }
        device.warnings.push(text.to_owned());
        self.changed = true;
    }

    /// The recording has ended by itself.
    pub(crate) fn recording_failed(&mut self, reason: String) {
        tracing::error!("recording ended: {reason}");
        self.recording_failure = Some(reason);
        self.changed = true;
    }

    /// A recording begins: what happened to the one before is reported.
    pub(crate) fn recording_started(&mut self) {
        self.recording_failure = None;
        self.changed = true;
    }

    /// Something else in the status has changed.
    pub(crate) fn touch(&mut self) {
        self.changed = true;
    }

    /// Whether there is something to tell and the last status is `min` old.
    pub(crate) fn changed_since_status(&self, now: Timestamp, min: Duration) -> bool {
        self.changed && now >= self.last_status + min
    }

    /// The last hour, to be read from elsewhere.
    pub(crate) fn history(&self) -> Kept {
        self.history.kept()
    }

    /// The status tells from now on what this disk still takes.
    pub(crate) fn watch_disk(&mut self, disk: FreeSpace) {
        self.disk = Some(disk);
    }

    /// The status tells from now on what is wrong with this source of time code.
    pub(crate) fn watch_timecode(&mut self, timecode: Option<TimecodeProblem>) {
        self.timecode = timecode;
    }

    /// The status as of `now`; begins the next interval.
    pub(crate) fn status(
        &mut self,
        now: Timestamp,
        pipeline: &PipelineStatus,
        recording: Option<&Recording>,
        clock: &StageClock,
    ) -> Status {
        self.changed = false;
        self.history.count(now, pipeline);
        let since = std::mem::replace(&mut self.last_status, now);
        let frames = self.read_to_estimate.samples_s.len();
        let latency: Vec<StageLatency> = [&mut self.read_to_estimate, &mut self.capture_to_estimate]
            .into_iter()
            .chain(&mut self.segments)
            .map(Latency::take)
            .collect();
        self.watch_load(since, frames, latency[0].p99_ms);
        self.recovered = (pipeline.entries_left_out, pipeline.begun_anew);
        let age_s = |newest: Option<Timestamp>| newest.map(|newest| now.seconds_since(newest).max(0.0));
        let mut newest = vec![None; self.devices.len()];
        for (sensor, counted) in self.sensors.iter().zip(&pipeline.sensors) {
            if let Some(newest) = sensor.device.and_then(|device| newest.get_mut(device)) {
                *newest = counted.newest.max(*newest);
            }
        }
        let device =
            |((device, counted), newest): ((&Device, &posed_pipeline::DeviceStatus), _)| DeviceStatus {
                name: device.name.clone(),
                driver: device.driver.clone(),
                port: device.port.clone(),
                state: (&counted.state).into(),
                reason: match &counted.state {
                    State::Streaming => None,
                    State::Connecting { reason } | State::Silent { reason } | State::Failed { reason } => {
                        Some(reason.clone())
                    }
                },
                rate_hz: counted.rate_hz,
                age_s: age_s(newest),
                sigma_t_s: counted.clock.map(|clock| clock.sigma_t_s),
                records: counted.counters.records,
                rejected: counted.counters.rejected,
                bytes_skipped: counted.counters.bytes_skipped,
            };
        let sensor = |(sensor, counted): (&mut Sensor, &posed_pipeline::SensorStatus)| SensorStatus {
            name: sensor.name.clone(),
            samples: counted.samples,
            rate_hz: sensor.rate.of(now, counted.samples),
            age_s: age_s(counted.newest),
            lost: counted.lost,
            missed: counted.missed,
            estimated: counted.estimated,
            battery: counted.condition.battery,
            battery_v: counted.condition.battery_v,
            signal_dbm: counted.condition.signal_dbm,
            corrected: counted.corrected,
            firmware: counted
                .condition
                .firmware
                .map(|[major, minor, patch]| format!("{major}.{minor}.{patch}")),
            registered: counted.condition.registered,
        };
        Status {
            t_s: now.as_secs_f64(),
            devices: self.devices.iter().zip(&pipeline.devices).zip(newest).map(device).collect(),
            sensors: self.sensors.iter_mut().zip(&pipeline.sensors).map(sensor).collect(),
            latency,
            recording: recording.map(|recording| RecordingStatus {
                name: recording.name.clone(),
                bytes: recording.recorder.bytes_written(),
                started_s: recording.started.as_secs_f64(),
            }),
            free_bytes: self.disk.as_ref().and_then(FreeSpace::bytes),
            replay: None,
            host_clock: host_clock::ask(),
            problems: self.problems(clock, pipeline),
            // The server knows and fills it in.
            clients: 0,
        }
    }

    /// Notes whether this machine has kept up since then: all but a hundredth of so many frames were ready after `late_ms`.
    fn watch_load(&mut self, since: Timestamp, frames: usize, late_ms: f64) {
        if frames < BEHIND_FRAMES {
            return;
        }
        let from = self.behind.map_or(since, |(from, _)| from);
        self.behind = (late_ms > KEEPS_UP_MS).then_some((from, late_ms));
    }

    fn problems(&self, clock: &StageClock, pipeline: &PipelineStatus) -> Vec<Problem> {
        let mut problems = Vec::new();
        for device in &self.devices {
            problems.extend(device.warnings.iter().map(|text| {
                Problem::new("device", format!("{}: {text}", device.name))
                    .with("device", &device.name)
                    .with("warning", text)
            }));
        }
        for (body, name) in pipeline.bodies.iter().zip(&self.names) {
            let Some(body) = body else { continue };
            let of = if self.names.len() > 1 { format!("{name}: ") } else { String::new() };
            let problem = |code: &str, message: String| Problem::new(code, message).with("of", &of);
            if !body.mounted {
                let sentence = format!(
                    "{of}nobody knows how the body's sensors sit: calibrate the body (page: Calibrate; request \
                     `body.calibrate`), or set mounting = \"given\" with `mount_quat_wxyz` for each"
                );
                problems.push(problem("body_not_calibrated", sentence));
            }
            problems.extend(body.faults.iter().map(|(sensor, segment, fault)| {
                let name = self.sensors.get(usize::from(*sensor)).map_or("", |sensor| sensor.name.as_str());
                problem("body_sensor", format!("{of}{segment}: the sensor {name} {}", emitted(*fault)))
                    .with("segment", segment)
                    .with("sensor", name)
                    .with("cause", fault.name())
            }));
        }
        for (sensor, counted) in self.sensors.iter().zip(&pipeline.sensors) {
            let Some(charge) = counted.condition.battery.filter(|charge| *charge < LOW_BATTERY) else {
                continue;
            };
            let percent = format!("{:.0}", charge * 100.0);
            let sentence = format!("the battery of {} is at {percent} %: charge it", sensor.name);
            problems.push(
                Problem::new("battery", sentence).with("sensor", &sensor.name).with("percent", percent),
            );
        }
        let lasts = |from: &Timestamp| self.last_status.seconds_since(*from) > BEHIND_S;
        if let Some((_, late_ms)) = self.behind.filter(|(from, _)| lasts(from)) {
            let late_ms = format!("{late_ms:.0}");
            let sentence = format!(
                "this machine does not keep up: one frame in a hundred is ready more than {late_ms} ms after its bytes came, and \
                 devices may fall silent; end other programs, or track fewer sensors or at a lower rate"
            );
            problems.push(Problem::new("load", sentence).with("late_ms", late_ms));
        }
        problems.extend(self.timecode.as_ref().and_then(TimecodeProblem::get));
        if let (Some(stated), Some(code)) = self.timecode_rate
            && stated != code
        {
            let sentence = format!(
                "the time code is that of {code} pictures per second, and timecode.rate says {stated}: set the generator or the \
                 stage file right"
            );
            problems.push(Problem::new("timecode_rate", sentence).with("code", code).with("stated", stated));
        }
        let (left_out, begun_anew) = self.recovered;
        if left_out > 0 {
            let anew = match begun_anew {
                0 => String::new(),
                times => format!(", {times} times from the beginning, with all devices set up anew"),
            };
            let sentence = format!(
                "tracking had a fault of its own and went on without the bytes that brought it ({left_out} times{anew}); \
                 please report this with a recording"
            );
            problems.push(
                Problem::new("tracking", sentence).with("times", left_out).with("begun_anew", begun_anew),
            );
        }
        if let Some(reason) = &self.recording_failure {
            problems
                .push(Problem::new("recording", format!("recording ended: {reason}")).with("reason", reason));
        }
        if let Some(jump_s) = clock.wall_clock_jump_s() {
            let jump_s = format!("{jump_s:+.1}");
            let sentence = format!(
                "the computer's clock was set by {jump_s} s; times of this run still count from its epoch, so \
                 restart posed before comparing with other computers"
            );
            problems.push(Problem::new("wall_clock", sentence).with("jump_s", jump_s));
        }
        problems
    }
}

impl Observer for Health {
    fn on_output(&mut self, output: &Output<'_>, times: &Times) {
        match *output {
            Output::Device { device, state } => self.device_changed(device, state),
            Output::Warning { device, text } => self.warn(device, text),
            Output::Estimate(estimate) => self.estimate(times.now.seconds_since(times.read), estimate),
            Output::Body(body) => self.body(body),
            Output::Timecode(timecode) => self.timecode_rate.1 = timecode.relation.rate(),
            Output::Named => self.named(times.now.seconds_since(times.published)),
            _ => {}
        }
    }
}

/// Durations of one interval.
struct Latency {
    stage: &'static str,
    samples_s: Vec<f64>,
}

impl Latency {
    fn new(stage: &'static str) -> Self {
        Self { stage, samples_s: Vec::with_capacity(SAMPLES) }
    }

    fn add(&mut self, seconds: f64) {
        if self.samples_s.len() < SAMPLES {
            self.samples_s.push(seconds);
        }
    }

    /// The quantiles of the interval, which ends with it; 0 of one without samples.
    fn take(&mut self) -> StageLatency {
        self.samples_s.sort_unstable_by(f64::total_cmp);
        let last = self.samples_s.len().saturating_sub(1) as f64;
        let at =
            |q: f64| self.samples_s.get((q * last).round() as usize).map_or(0.0, |seconds| seconds * 1e3);
        let [p50_ms, p99_ms, max_ms] = [0.5, 0.99, 1.0].map(at);
        let latency = StageLatency { stage: self.stage.to_owned(), p50_ms, p99_ms, max_ms };
        self.samples_s.clear();
        latency
    }
}

/// What a sensor on the body does that it should not, and what to do.
fn emitted(fault: Cause) -> &'static str {
    match fault {
        Cause::Missing => "sends nothing: see to its battery and cable",
        Cause::NotFinite => "sends numbers that are not finite",
        Cause::Stuck => "repeats itself: switch it off and on",
        Cause::Saturated => "is at the end of its range",
        Cause::Misfit => {
            "does not move as its segment can: its strap has slipped (a limb that was calibrated shows by its movements how it sits now), or it is swapped with another"
        }
        Cause::Swapped => {
            "sits here, as movements have shown, and counts here: not where the stage file has it; put that right, or calibrate every limb"
        }
        other => other.words(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_of_the_wall_clock_is_a_problem_with_a_sentence() {
        use std::sync::atomic::{AtomicI64, Ordering};
        static UTC_NS: AtomicI64 = AtomicI64::new(1_700_000_000_000_000_000);
        let health = Health::new(&Stage::parse("name = \"A\"\n").unwrap());
        let clock = StageClock::with_utc(|| UTC_NS.load(Ordering::Relaxed));
        UTC_NS.fetch_add(7_200_000_000_000, Ordering::Relaxed);
        let pipeline =
            posed_pipeline::Pipeline::new(&Stage::parse("name = \"A\"\n").unwrap()).unwrap().status();
        let problems = health.problems(&clock, &pipeline);
        assert_eq!((problems.len(), problems[0].code.as_str()), (1, "wall_clock"));
        assert!(problems[0].message.contains("restart posed"), "{}", problems[0].message);
    }

    #[test]
    fn a_battery_that_is_nearly_empty_is_a_problem_with_the_name_of_its_sensor() {
        let stage = Stage::parse(
            "name = \"A\"\n[[device]]\nname = \"d\"\ndriver = \"slimevr\"\nport = \"udp://0.0.0.0:6969\"\n\
             [[sensor]]\nname = \"hips\"\ndevice = \"d\"\naddress = 1\n",
        )
        .unwrap();
        let mut health = Health::new(&stage);
        let clock = StageClock::with_utc(|| 0);
        let mut pipeline = posed_pipeline::Pipeline::new(&stage).unwrap().status();
        for (charge, named) in [(None, false), (Some(0.6), false), (Some(0.07), true)] {
            pipeline.sensors[0].condition.battery = charge;
            let status = health.status(Timestamp::ZERO, &pipeline, None, &clock);
            assert_eq!(status.sensors[0].battery, charge);
            let said: Vec<_> = status
                .problems
                .iter()
                .filter(|problem| problem.code == "battery")
                .map(|found| &found.message)
                .collect();
            assert_eq!(said, if named { vec!["the battery of hips is at 7 %: charge it"] } else { vec![] });
        }
    }

    #[test]
    fn a_machine_that_does_not_keep_up_is_a_problem_until_it_does() {
        let mut health = Health::new(&Stage::parse("name = \"A\"\n").unwrap());
        let clock = StageClock::with_utc(|| 0);
        let pipeline =
            posed_pipeline::Pipeline::new(&Stage::parse("name = \"A\"\n").unwrap()).unwrap().status();
        let mut named = |second: i64, late_s: f64| {
            (0..100).for_each(|_| health.read_to_estimate.add(late_s));
            let now = Timestamp::from_nanos(second * 1_000_000_000);
            health.status(now, &pipeline, None, &clock).problems.iter().any(|problem| problem.code == "load")
        };
        assert!((1..10).all(|second| !named(second, 0.002)));
        // A moment is none.
        assert!(!named(10, 0.2) && !named(11, 0.2) && !named(12, 0.002));
        assert_eq!(
            (13..18).map(|second| named(second, 0.2)).collect::<Vec<_>>(),
            [false, false, false, true, true]
        );
        assert!(!named(18, 0.002));
    }

    #[test]
    fn quantiles_are_those_of_the_interval() {
        let mut latency = Latency::new("read to estimate");
        for ms in 1..=101 {
            latency.add(f64::from(ms) * 1e-3);
        }
        let taken = latency.take();
        assert!((taken.p50_ms - 51.0).abs() < 1e-9 && (taken.p99_ms - 100.0).abs() < 1e-9);
        assert!((taken.max_ms - 101.0).abs() < 1e-9);
        assert!(latency.take().max_ms < 1e-9, "each interval starts anew");
    }
}
