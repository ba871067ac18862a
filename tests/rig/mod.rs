//! A stage in simulated time: virtual devices, the real pipeline, and nobody in between.

#![allow(
    dead_code,
    missing_docs,
    clippy::unwrap_used,
    reason = "shared by several tests, none of which uses all of it"
)]

pub(crate) mod leg;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use posed_drivers::{LineEvent, Timestamp};
use posed_field::{FieldMap, FieldNoise, fit_known};
use posed_pipeline::Pipeline;
use posed_recording::{Header, Machine, Replayable, Writer};
use posed_simulator::scenario::{Scenario, StageSpec};
use posed_simulator::stage::{Output as Virtual, VirtualStage};
use posed_simulator::truth::{Loss, TruthCycle};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};
use posed_stage::output::{Body, Estimate, Outcome, Output};
use serde::Deserialize;

/// A stage file with Flocks of so many birds each; one bird stands alone.
pub(crate) fn stage(birds: &[u16]) -> Stage {
    let mut text = String::from("name = \"test\"\n");
    for (device, &birds) in birds.iter().enumerate() {
        text += &format!("[[device]]\nname = \"d{device}\"\ndriver = \"flock-of-birds\"\nport = \"none\"\n");
        // Eight quaternions do not fit a cycle at 115200 baud, eight times three angles do.
        if birds > 6 {
            text += "format = \"position-angles\"\n";
        }
        for bird in 0..birds {
            let address = if birds == 1 { 0 } else { bird + 1 };
            text += &format!(
                "[[sensor]]\nname = \"s{device}-{bird}\"\ndevice = \"d{device}\"\naddress = {address}\n"
            );
        }
    }
    toml::from_str(&text).unwrap()
}

/// The stage of `posed demo`, as its file specifies it.
pub(crate) const DEMO: &str = include_str!("../../config/demo.toml");

/// The stage of `posed demo`, and what happens on it.
pub(crate) fn demo_stage() -> (Stage, Scenario) {
    let stage = Stage::parse(DEMO).unwrap();
    let scenario = Scenario::deserialize(stage.simulation.clone().unwrap()).unwrap();
    (stage, scenario)
}

/// The stage of `posed demo`, and its rig.
pub(crate) fn demo() -> (Stage, Rig) {
    let (stage, scenario) = demo_stage();
    let rig = Rig::new(&stage, &scenario);
    (stage, rig)
}

/// A map of a tracker that says everything three percent too long, for two metres around it.
pub(crate) fn field_map() -> FieldMap {
    let pairs: Vec<_> = (0..900)
        .map(|k| {
            let place = |n: usize| (k * n % 31) as f64 / 15.0 - 1.0;
            let p = Vector3::new(place(1), place(7), place(12)) * 2.0;
            (p * 1.03, p)
        })
        .filter(|(z, _)| z.norm() > 0.1)
        .collect();
    fit_known(&pairs, FieldNoise { sigma_signal: 1e-5, floor_m: 3e-4 }).unwrap()
}

/// A file of a real recording: `tests/recordings/README.md` states which there are, and whose.
pub(crate) fn recording(source: &str, name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings").join(source).join(name)
}

/// Virtual devices for a stage.
pub(crate) fn simulate(stage: &Stage, scenario: &Scenario) -> VirtualStage {
    let spec = StageSpec::of(stage).unwrap();
    VirtualStage::new(&spec, scenario, ".".as_ref()).unwrap()
}

/// The log of a session as a recording, and of the messages that follow from it those of one topic.
pub(crate) fn record(
    path: &Path,
    log: &[Entry],
    stage_toml: &str,
    topic_kept: &str,
) -> Vec<serde_json::Value> {
    let stage = Stage::parse(stage_toml).unwrap();
    let header = Header::new(&stage, stage_toml, 0);
    let (_, mut machine) = Machine::as_recorded(&header).unwrap();
    let mut writer = Writer::new(std::fs::File::create(path).unwrap(), header).unwrap();
    let mut kept = Vec::new();
    for entry in log {
        writer.entry(entry).unwrap();
        machine.push(entry, &mut |topic, _, json| {
            if topic == topic_kept {
                kept.push(serde_json::from_slice(json).unwrap());
            }
        });
    }
    writer.finish("the end").unwrap();
    kept
}

/// What the pipeline said of the tracking.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Said {
    Estimate(Estimate),
    Body(Box<Body>),
    Outcome(Outcome),
    State(u16, posed_drivers::State),
    Warning(u16, String),
}

/// A host that is now and then late with a read, and then reads all that has come meanwhile.
pub(crate) struct Sleepy {
    pub(crate) random: u64,
    /// Share of reads that it is late with.
    pub(crate) share: f64,
    pub(crate) longest_ms: f64,
    until: Timestamp,
    waiting: Vec<(u16, Vec<u8>)>,
}

impl Sleepy {
    pub(crate) fn new(seed: u64, share: f64, longest_ms: f64) -> Self {
        Self { random: seed, share, longest_ms, until: Timestamp::ZERO, waiting: Vec::new() }
    }

    /// Uniform in [0, 1): splitmix64.
    fn uniform(&mut self) -> f64 {
        self.random = self.random.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A pipeline with its virtual stage.
pub(crate) struct Rig {
    pub(crate) virtual_stage: VirtualStage,
    pub(crate) pipeline: Pipeline,
    pub(crate) now: Timestamp,
    pub(crate) truth: Vec<TruthCycle>,
    /// Records that did not reach the host, by device and time.
    pub(crate) losses: Vec<(usize, Timestamp, Loss)>,
    pub(crate) log: Vec<Entry>,
    pub(crate) emitted: Vec<Said>,
    pub(crate) sleepy: Option<Sleepy>,
    /// When something of the tracking was last said, and when each entry of `said` was.
    pub(crate) said_at: Vec<Timestamp>,
}

impl Rig {
    pub(crate) fn new(stage: &Stage, scenario: &Scenario) -> Self {
        let mut rig = Self {
            virtual_stage: simulate(stage, scenario),
            pipeline: Pipeline::new(stage).unwrap(),
            now: Timestamp::ZERO,
            truth: Vec::new(),
            losses: Vec::new(),
            log: Vec::new(),
            emitted: Vec::new(),
            sleepy: None,
            said_at: Vec::new(),
        };
        for device in 0..stage.devices.len() {
            let event = LineEvent::Opened { modem_lines: false };
            rig.push(Input::Line { device: device as u16, event });
        }
        rig
    }

    /// Lets time pass.
    pub(crate) fn run_until(&mut self, seconds: f64) {
        let end = Timestamp::from_secs_f64(seconds);
        while self.now < end {
            let awake = self.sleepy.as_ref().filter(|host| !host.waiting.is_empty()).map(|host| host.until);
            let due = [self.virtual_stage.poll_timeout(), self.pipeline.poll_timeout(), awake];
            let next = due.into_iter().flatten().min().unwrap_or(end).clamp(self.now, end);
            self.now = next;
            self.wake();
            self.virtual_stage.step(next);
            while let Some(event) = self.virtual_stage.poll_event() {
                let device = event.device as u16;
                match event.output {
                    Virtual::Data(bytes) => self.read(device, bytes),
                    Virtual::Truth(cycle) => self.truth.push(cycle),
                    Virtual::Unplugged => {
                        let event = LineEvent::Closed { reason: "unplugged".into() };
                        self.push(Input::Line { device, event });
                    }
                    Virtual::Replugged => {
                        let event = LineEvent::Opened { modem_lines: false };
                        self.push(Input::Line { device, event });
                    }
                    Virtual::Lost(loss) => self.losses.push((event.device, event.t, loss)),
                    Virtual::Fault(_) => {}
                }
            }
            if self.pipeline.poll_timeout().is_some_and(|due| due <= next) {
                self.push(Input::Timer);
            }
        }
    }

    /// Bytes can be read; a host that sleeps reads them later, those of one device in one go.
    fn read(&mut self, device: u16, bytes: Vec<u8>) {
        let now = self.now;
        if let Some(host) = &mut self.sleepy {
            if now >= host.until && host.uniform() < host.share {
                let sleep_s = host.uniform() * host.longest_ms * 1e-3;
                host.until = Timestamp::from_secs_f64(now.as_secs_f64() + sleep_s);
            }
            if now < host.until {
                match host.waiting.iter_mut().find(|(waiting, _)| *waiting == device) {
                    Some((_, held)) => held.extend(bytes),
                    None => host.waiting.push((device, bytes)),
                }
                return;
            }
        }
        self.push(Input::Bytes { device, bytes });
    }

    fn wake(&mut self) {
        let Some(host) = self.sleepy.as_mut().filter(|host| host.until <= self.now) else { return };
        for (device, bytes) in std::mem::take(&mut host.waiting) {
            self.push(Input::Bytes { device, bytes });
        }
    }

    /// Forgets what has been read and said up to now.
    pub(crate) fn forget(&mut self) {
        self.truth = Vec::new();
        self.losses = Vec::new();
        self.log = Vec::new();
        self.emitted = Vec::new();
        self.said_at = Vec::new();
    }

    pub(crate) fn push(&mut self, input: Input) {
        let entry = Entry { t: self.now, input };
        let Self { pipeline, virtual_stage, emitted, said_at, now, .. } = self;
        pipeline.push(&entry, &mut |output| {
            if let Output::Transmit { device, bytes } = &output {
                virtual_stage.write(usize::from(*device), *now, bytes);
            }
            emitted.extend(keep(&output));
            said_at.resize(emitted.len(), *now);
        });
        self.log.push(entry);
    }

    pub(crate) fn estimates(&self) -> impl Iterator<Item = &Estimate> {
        self.emitted.iter().filter_map(|emitted| match emitted {
            Said::Estimate(estimate) => Some(estimate),
            _ => None,
        })
    }
}

/// An output worth keeping, as one's own.
pub(crate) fn keep(output: &Output<'_>) -> Option<Said> {
    match output {
        Output::Estimate(estimate) => Some(Said::Estimate((*estimate).clone())),
        Output::Body(body) => Some(Said::Body(Box::new((*body).clone()))),
        Output::Outcome(outcome) => Some(Said::Outcome((*outcome).clone())),
        Output::Device { device, state } => Some(Said::State(*device, (*state).clone())),
        Output::Warning { device, text } => Some(Said::Warning(*device, (*text).to_owned())),
        _ => None,
    }
}

/// Feeds entries to a pipeline.
pub(crate) fn replay(pipeline: &mut Pipeline, log: &[Entry]) -> Vec<Said> {
    let mut emitted = Vec::new();
    for entry in log {
        pipeline.push(entry, &mut |output| emitted.extend(keep(&output)));
    }
    emitted
}
