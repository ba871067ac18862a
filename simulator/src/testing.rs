//! A host for tests: it owns the time and remembers what it read.

use std::path::Path;

use posed_drivers::Timestamp;

use crate::faults::FaultHit;
use crate::scenario::{DeviceScenario, DeviceSpec, Scenario, SensorSpec, StageSpec};
use crate::stage::{Output, VirtualStage};
use crate::truth::TruthCycle;

/// A stage with one Flock.
pub(crate) fn stage(addresses: &[u16], baud: u32) -> StageSpec {
    let sensor = |&address: &u16| SensorSpec { name: format!("s{address}"), device: "flock".into(), address };
    StageSpec {
        transmitter_in_room: Some(([0.2, 0.1, 1.0], [0.0, 1.0, 0.0, 0.0])),
        devices: vec![DeviceSpec {
            name: "flock".into(),
            driver: "flock-of-birds".into(),
            baud,
            measurement_delay_ms: 2.0,
            ..DeviceSpec::default()
        }],
        sensors: addresses.iter().map(sensor).collect(),
    }
}

/// A scenario whose one Flock is this.
pub(crate) fn scenario(device: DeviceScenario) -> Scenario {
    Scenario { devices: vec![DeviceScenario { name: "flock".into(), ..device }], ..Scenario::default() }
}

/// A host on the first device.
pub(crate) struct Host {
    pub(crate) stage: VirtualStage,
    pub(crate) now: Timestamp,
    /// Chunks read, with their times.
    pub(crate) chunks: Vec<(Timestamp, Vec<u8>)>,
    pub(crate) truth: Vec<TruthCycle>,
    pub(crate) hits: Vec<FaultHit>,
    pub(crate) plugging: Vec<(Timestamp, bool)>,
}

impl Host {
    /// A host that waited until the units were up.
    pub(crate) fn new(addresses: &[u16], baud: u32, device: DeviceScenario) -> Self {
        Self::with(&stage(addresses, baud), &scenario(device))
    }

    pub(crate) fn with(stage: &StageSpec, scenario: &Scenario) -> Self {
        let stage = VirtualStage::new(stage, scenario, Path::new(".")).unwrap();
        let mut host = Self {
            stage,
            now: Timestamp::ZERO,
            chunks: Vec::new(),
            truth: Vec::new(),
            hits: Vec::new(),
            plugging: Vec::new(),
        };
        host.wait_ms(1500.0);
        host
    }

    pub(crate) fn wait_ms(&mut self, ms: f64) {
        self.wait_until(Timestamp::from_secs_f64(self.now.as_secs_f64() + ms * 1e-3));
    }

    pub(crate) fn wait_until(&mut self, t: Timestamp) {
        self.now = t;
        self.stage.step(t);
        while let Some(event) = self.stage.poll_event() {
            match event.output {
                Output::Data(bytes) => self.chunks.push((event.t, bytes)),
                Output::Truth(cycle) => self.truth.push(cycle),
                Output::Fault(hit) => self.hits.push(hit),
                Output::Unplugged => self.plugging.push((event.t, false)),
                Output::Replugged => self.plugging.push((event.t, true)),
            }
        }
    }

    pub(crate) fn tell(&mut self, bytes: &[u8]) {
        self.stage.write(0, self.now, bytes);
    }

    /// Writes, waits, and gives what was read meanwhile.
    pub(crate) fn ask(&mut self, bytes: &[u8], wait_ms: f64) -> Vec<u8> {
        self.chunks.clear();
        self.tell(bytes);
        self.wait_ms(wait_ms);
        self.read()
    }

    /// All that was read since the last question.
    pub(crate) fn read(&self) -> Vec<u8> {
        self.chunks.iter().flat_map(|(_, bytes)| bytes.clone()).collect()
    }

    /// Runs a group of birds: configured, every bird in this format, streaming.
    pub(crate) fn stream_group(&mut self, birds: u8, format: u8) {
        self.tell(&[b'P', 0x32, birds]);
        self.wait_ms(400.0);
        self.tell(b"P\x23\x01");
        for bird in 1..=birds {
            self.tell(&[0xF0 + bird, format]);
        }
        self.chunks.clear();
        self.truth.clear();
        self.tell(b"@");
    }
}
