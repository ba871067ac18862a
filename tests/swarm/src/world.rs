//! One case, run: virtual devices, the host that reads them, the pipeline, and everything that must hold of it.

use nalgebra::Isometry3;
use posed_drivers::Timestamp;
use posed_geometry::isometry;
use posed_pipeline::SupervisedPipeline;
use posed_rig::counting::peak_bytes;
use posed_rig::{Host, Said, Sleepy};
use posed_simulator::scenario::StageSpec;
use posed_simulator::stage::VirtualStage;
use posed_stage::Stage;
use posed_stage::input::{Entry, Input, Model};
use posed_stage::output::{Estimate, OutcomeKind, Output, SensorState};

use crate::judge::Judge;
use crate::plan::{CALM_S, Plan};
use crate::trouble::{Event, LEAD_S};

/// Most bytes that an entry may take beyond what is there: its outputs' copies are among them.
const ENTRY_BYTES: i64 = 8 << 20;
/// The same of a model, which is made ready.
const MODEL_BYTES: i64 = 512 << 20;
/// Most time of a processor that entries may take, s: those that are timed together, and a model.
const ENTRY_S: f64 = 1.0;
const MODEL_S: f64 = 20.0;
/// Entries that are timed together, for asking costs as much as many of them.
const TIMED_ENTRIES: u32 = 64;
/// So far a frame's time may lie after its end, s: times rise by microseconds where they would be equal.
const AHEAD_S: f64 = 1e-4;
/// Panics further apart are not in a row, s.
const APART_S: f64 = 1.5;
/// A device whose last trouble is this long over streams again.
const RETURN_S: f64 = CALM_S - 6.0;

/// What cases that held came to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Summary {
    /// Simulated time, s.
    pub simulated_s: f64,
    /// Stage files that were refused, as they may be.
    pub refused: u64,
    /// Frames.
    pub frames: u64,
    /// Good values that were held against the truth.
    pub compared: u64,
}

impl Summary {
    /// Takes those of others with its own.
    pub(crate) fn add(&mut self, other: Self) {
        self.simulated_s += other.simulated_s;
        self.refused += other.refused;
        self.frames += other.frames;
        self.compared += other.compared;
    }
}

struct World<'a> {
    stage: &'a Stage,
    host: Host,
    pipeline: SupervisedPipeline,
    /// Restored from a snapshot of the pipeline, given all that it is given since.
    twin: Option<SupervisedPipeline>,
    /// Panics that are to come, and the entries that have brought one.
    panics_owed: u8,
    panicked_at: Option<f64>,
    panics: Vec<usize>,
    judge: Judge,
    log: Vec<Entry>,
    said: Vec<Said>,
    last: Option<(u64, Timestamp)>,
    frames: u64,
    /// By sensor, the last time that it was good, and that it was doubtful.
    good: Vec<Timestamp>,
    doubtful: Vec<Timestamp>,
    /// By device, whether a client has said how noisy it is: a gate that is narrower than the device refuses it, as it must.
    noise_told: Vec<bool>,
    /// Entries since the processor's time was looked at, and that time, s.
    timed_entries: u32,
    timed_from_s: f64,
    failure: Option<String>,
}

/// Time of a processor that this thread has had, s: what else the machine does does not count.
fn processor_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Runs a case to its end.
///
/// # Errors
/// A sentence: what did not hold, and when.
pub(crate) fn run(plan: &Plan, seed: u64) -> Result<(Summary, Vec<Entry>), String> {
    let stage = match Stage::parse(&plan.stage_toml) {
        Ok(stage) => stage,
        Err(_) => return Ok((Summary { refused: 1, ..Summary::default() }, Vec::new())),
    };
    let pipeline = SupervisedPipeline::new(&stage)
        .map_err(|error| format!("a stage that is right is refused: {error}"))?;
    let spec = StageSpec::of(&stage).map_err(|error| error.to_string())?;
    let virtual_stage =
        VirtualStage::new(&spec, &plan.scenario, ".".as_ref()).map_err(|error| error.to_string())?;
    let mut host = Host::new(virtual_stage, plan.modem_lines.clone());
    host.sleepy = plan.sleep.map(|sleep| Sleepy::new(seed, sleep.share, sleep.longest_s * 1e3, LEAD_S));
    let mut world = World {
        stage: &stage,
        host,
        pipeline,
        twin: None,
        panics_owed: 0,
        panicked_at: None,
        panics: Vec::new(),
        judge: Judge::new(&stage, plan),
        log: Vec::new(),
        said: Vec::new(),
        last: None,
        frames: 0,
        good: vec![Timestamp::ZERO; stage.sensors.len()],
        doubtful: vec![Timestamp::ZERO; stage.sensors.len()],
        noise_told: vec![false; stage.devices.len()],
        timed_entries: 0,
        timed_from_s: processor_s(),
        failure: None,
    };
    for input in world.host.opened() {
        world.push(input);
    }
    for (t_s, event) in &plan.events {
        world.run_until(*t_s)?;
        match event {
            Event::Snapshot => world.snapshot()?,
            // In a row are those of one event: of more, a pipeline that has begun anew is given up.
            Event::Panic(times) if world.panicked_at.is_none_or(|at| *t_s > at + APART_S) => {
                world.panics_owed = *times;
            }
            Event::Panic(_) => {}
            Event::Input(input) => world.push(input.clone()),
        }
        world.check()?;
    }
    world.run_until(plan.calm_from_s)?;
    world.host.wake_for_good();
    world.run_until(plan.end_s)?;
    world.all_are_back(plan)?;
    world.replay()?;
    let summary =
        Summary { simulated_s: plan.end_s, refused: 0, frames: world.frames, compared: world.judge.compared };
    Ok((summary, world.log))
}

impl World<'_> {
    fn check(&mut self) -> Result<(), String> {
        match self.failure.take() {
            Some(failure) => Err(format!("at {:.4} s: {failure}", self.host.now.as_secs_f64())),
            None => Ok(()),
        }
    }

    fn fail(&mut self, failure: impl FnOnce() -> String) {
        self.failure.get_or_insert_with(failure);
    }

    fn run_until(&mut self, end_s: f64) -> Result<(), String> {
        let end = Timestamp::from_secs_f64(end_s);
        while let Some(input) = self.host.next(self.pipeline.poll_timeout(), end) {
            self.push(input);
            self.check()?;
        }
        Ok(())
    }

    fn snapshot(&mut self) -> Result<(), String> {
        let bytes = self.pipeline.snapshot();
        let twin =
            SupervisedPipeline::restore(self.stage, self.pipeline.models(), &bytes).map_err(|error| {
                format!("at {:.4} s: its own snapshot is refused: {error}", self.host.now.as_secs_f64())
            })?;
        if twin.snapshot() != bytes {
            return Err(format!(
                "at {:.4} s: restored, a snapshot is another one",
                self.host.now.as_secs_f64()
            ));
        }
        self.twin = Some(twin);
        Ok(())
    }

    fn push(&mut self, input: Input) {
        let is_model = matches!(input, Input::Model(_) | Input::SegmentationNetwork(_));
        let panics = self.panics_owed > 0;
        if panics {
            self.panics_owed -= 1;
            self.panics.push(self.log.len());
            self.panicked_at = Some(self.host.now.as_secs_f64());
            self.pipeline.panic_next();
            self.twin.iter_mut().for_each(SupervisedPipeline::panic_next);
        }
        // One that has panicked is made anew, with its models.
        let large = is_model || panics;
        let (bytes, most_s) = if large { (MODEL_BYTES, MODEL_S) } else { (ENTRY_BYTES, ENTRY_S) };
        let entry = Entry { t: self.host.now, input };
        let Self { pipeline, said, .. } = self;
        said.clear();
        let peak = peak_bytes(|| pipeline.push(&entry, &mut |output| said.push(Said::of(&output))));
        if peak > bytes {
            self.fail(|| format!("an entry takes {} kB", peak >> 10));
        }
        self.timed_entries += 1;
        if large || self.timed_entries == TIMED_ENTRIES {
            self.timed_entries = 0;
            // With what the devices and this program took in between, which is little beside what an entry may take.
            let now_s = processor_s();
            let took_s = now_s - std::mem::replace(&mut self.timed_from_s, now_s);
            if took_s > most_s {
                self.fail(|| format!("an entry, or {TIMED_ENTRIES} together, takes {took_s:.3} s"));
            }
        }
        if self.pipeline.entries_left_out() != self.panics.len() as u64 {
            self.fail(|| "the pipeline has panicked by itself".into());
        }
        if self.pipeline.begun_anew() > self.judge.begun_anew {
            self.judge.begin_anew(self.pipeline.begun_anew(), entry.t.as_secs_f64());
        }
        self.hold(&entry);
        if let Some(twin) = &mut self.twin {
            let mut expected = self.said.iter();
            let mut differs = false;
            twin.push(&entry, &mut |output| differs |= expected.next() != Some(&Said::of(&output)));
            if differs || expected.next().is_some() {
                self.fail(|| "a restored pipeline reports something else".into());
            }
        }
        self.log.push(entry);
    }

    /// What must hold of an entry's outputs.
    fn hold(&mut self, entry: &Entry) {
        let said = std::mem::take(&mut self.said);
        for said in &said {
            match said {
                Said::Transmit(device, bytes) => {
                    self.host.devices.write(usize::from(*device), self.host.now, bytes);
                }
                Said::Estimate(estimate) => {
                    if let Err(failure) = self.estimate(estimate, entry.t) {
                        self.fail(|| failure);
                    }
                }
                Said::Outcome(outcome) => {
                    if let OutcomeKind::ModelSwapped(model) = &outcome.what {
                        self.swapped(model);
                    }
                }
                Said::State(..) | Said::Warning(..) => self.judge.trace_said(entry.t, said),
                Said::Body(_) | Said::Other(_) => {}
            }
        }
        self.said = said;
    }

    fn swapped(&mut self, model: &Model) {
        match model {
            Model::Transmitter { position_m, orientation_wxyz } => {
                let placed = isometry(*position_m, *orientation_wxyz);
                self.judge.room_transmitter = placed.unwrap_or_else(Isometry3::identity);
                // Where numbers end, so do millimetres.
                if position_m.iter().any(|x| x.abs() > 1e6) {
                    self.judge.judged.fill(false);
                }
            }
            // Who says of a tracker that it is another one believes it, too.
            Model::TrackerNoise { device, .. } => {
                let at = self.stage.devices.iter().position(|known| known.name == *device);
                if let Some(at) = at {
                    self.judge.judged[at] = false;
                    self.noise_told[at] = true;
                }
            }
            _ => {}
        }
    }

    fn estimate(&mut self, estimate: &Estimate, t: Timestamp) -> Result<(), String> {
        self.frames += 1;
        if let Some((frame, t_valid)) = self.last
            && (estimate.frame <= frame || estimate.t_valid <= t_valid)
        {
            return Err(format!(
                "frame {} follows {frame}, of {:?} {t_valid:?}",
                estimate.frame, estimate.t_valid
            ));
        }
        self.last = Some((estimate.frame, estimate.t_valid));
        if estimate.t_closed != t || estimate.t_valid.seconds_since(estimate.t_closed) > AHEAD_S {
            return Err(format!("frame {} of {:?} closed at {t:?}", estimate.frame, estimate.t_valid));
        }
        let times = self.good.iter_mut().zip(&mut self.doubtful);
        for (sensor, (good, doubtful)) in estimate.sensors.iter().zip(times) {
            if sensor.pose.as_ref().is_some_and(|pose| !pose.is_finite()) {
                return Err(format!("frame {}: a number of a pose is not finite", estimate.frame));
            }
            // Formats without a position have no pose, and what averages for long is always late.
            if sensor.state.is_usable() || sensor.state == SensorState::Late {
                *good = estimate.t_valid;
            }
            if matches!(sensor.state, SensorState::Suspect | SensorState::Stuck) {
                *doubtful = estimate.t_valid;
            }
        }
        self.judge.frame(estimate)
    }

    /// All that the plan has not taken away for good is good again.
    fn all_are_back(&self, plan: &Plan) -> Result<(), String> {
        let status = self.pipeline.status();
        let since_s = plan.calm_from_s + RETURN_S;
        let sensors = self.stage.sensors.iter().zip(&self.good).zip(&self.doubtful).enumerate();
        for (number, ((sensor, good), doubtful)) in sensors {
            let at = self.stage.devices.iter().position(|device| device.name == sensor.device);
            let at = at.ok_or("a sensor of no device")?;
            if plan.devices[at].returns
                && !self.noise_told[at]
                && !(doubtful.as_secs_f64() >= since_s && self.judge.may_stay_doubtful(number))
                && good.as_secs_f64() < since_s
            {
                return Err(format!(
                    "{} is not back {CALM_S} s after the last fault, which ended at {:.3} s: last good at {:.3} s, doubtful at {:.3} s, {:?}",
                    sensor.name,
                    plan.calm_from_s,
                    good.as_secs_f64(),
                    doubtful.as_secs_f64(),
                    status.devices[at]
                ));
            }
        }
        Ok(())
    }

    /// The log, given to another pipeline, leads where the first one is.
    fn replay(&self) -> Result<(), String> {
        let mut again = SupervisedPipeline::new(self.stage).map_err(|error| error.to_string())?;
        for (number, entry) in self.log.iter().enumerate() {
            if self.panics.contains(&number) {
                again.panic_next();
            }
            again.push(entry, &mut |_: Output<'_>| {});
        }
        if again.snapshot() == self.pipeline.snapshot() && again.status() == self.pipeline.status() {
            Ok(())
        } else {
            Err("a replay of the log ends elsewhere".into())
        }
    }
}
