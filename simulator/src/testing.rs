//! Hosts for tests: they own the time and remember what they read.

use std::path::Path;

use posed_drivers::session::Output as Said;
use posed_drivers::{LineEvent, Sample, Session, Timestamp};

use crate::faults::FaultHit;
use crate::scenario::{DeviceScenario, DeviceSpec, Scenario, SensorSpec, StageSpec};
use crate::stage::{Output, VirtualStage};
use crate::truth::{Loss, TruthCycle, TruthRow};

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
    pub(crate) losses: Vec<Loss>,
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
            losses: Vec::new(),
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
                Output::Lost(loss) => self.losses.push(loss),
                Output::Unplugged => self.plugging.push((event.t, false)),
                Output::Replugged => self.plugging.push((event.t, true)),
            }
        }
    }

    pub(crate) fn report(&mut self, bytes: &[u8]) {
        self.stage.write(0, self.now, bytes);
    }

    /// Writes, waits, and gives what was read meanwhile.
    pub(crate) fn ask(&mut self, bytes: &[u8], wait_ms: f64) -> Vec<u8> {
        self.chunks.clear();
        self.report(bytes);
        self.wait_ms(wait_ms);
        self.read()
    }

    /// All that was read since the last question.
    pub(crate) fn read(&self) -> Vec<u8> {
        self.chunks.iter().flat_map(|(_, bytes)| bytes.clone()).collect()
    }

    /// Runs a group of birds: configured, every bird in this format, streaming.
    pub(crate) fn stream_group(&mut self, birds: u8, format: u8) {
        self.report(&[b'P', 0x32, birds]);
        self.wait_ms(400.0);
        self.report(b"P\x23\x01");
        for bird in 1..=birds {
            self.report(&[0xF0 + bird, format]);
        }
        self.chunks.clear();
        self.truth.clear();
        self.report(b"@");
    }
}

/// A stage with one device, `device`, and a sensor at each address.
pub(crate) fn stage_of(driver: &str, port: &str, baud: u32, addresses: &[u16]) -> StageSpec {
    let sensor =
        |&address: &u16| SensorSpec { name: format!("s{address}"), device: "device".into(), address };
    StageSpec {
        transmitter_in_room: None,
        devices: vec![DeviceSpec {
            name: "device".into(),
            driver: driver.into(),
            port: port.into(),
            baud,
            ..DeviceSpec::default()
        }],
        sensors: addresses.iter().map(sensor).collect(),
    }
}

/// A scenario whose one device, `device`, is this; it starts at once.
pub(crate) fn scenario_of(device: DeviceScenario) -> Scenario {
    let device = DeviceScenario { name: "device".into(), boot_ms: 0.0, ..device };
    Scenario { devices: vec![device], ..Scenario::default() }
}

/// The real driver on a virtual device, in simulated time.
pub(crate) struct Pair<S> {
    pub(crate) stage: VirtualStage,
    pub(crate) session: S,
    pub(crate) now: Timestamp,
    pub(crate) samples: Vec<Sample>,
    pub(crate) truth: Vec<TruthCycle>,
    pub(crate) losses: Vec<Loss>,
    pub(crate) hits: Vec<FaultHit>,
    pub(crate) warnings: Vec<String>,
    /// Everything that the host has read.
    pub(crate) bytes: Vec<u8>,
    addresses: Vec<u16>,
}

impl<S: Session> Pair<S> {
    pub(crate) fn new(spec: &StageSpec, scenario: &Scenario, session: S) -> Self {
        let mut pair = Self {
            stage: VirtualStage::new(spec, scenario, Path::new(".")).unwrap(),
            session,
            now: Timestamp::ZERO,
            samples: Vec::new(),
            truth: Vec::new(),
            losses: Vec::new(),
            hits: Vec::new(),
            warnings: Vec::new(),
            bytes: Vec::new(),
            addresses: spec.sensors.iter().map(|sensor| sensor.address).collect(),
        };
        pair.session.handle_line(Timestamp::ZERO, &LineEvent::Opened { modem_lines: true });
        pair.listen();
        pair
    }

    pub(crate) fn run_until(&mut self, seconds: f64) {
        let end = Timestamp::from_secs_f64(seconds);
        while self.now < end {
            let due = [self.stage.poll_timeout(), self.session.poll_timeout()];
            self.now = due.into_iter().flatten().min().unwrap_or(end).clamp(self.now, end);
            self.stage.step(self.now);
            while let Some(event) = self.stage.poll_event() {
                match event.output {
                    Output::Data(bytes) => {
                        self.session.handle_bytes(self.now, &bytes);
                        self.bytes.extend(bytes);
                    }
                    Output::Truth(cycle) => self.truth.push(cycle),
                    Output::Fault(hit) => self.hits.push(hit),
                    Output::Lost(loss) => self.losses.push(loss),
                    Output::Unplugged => {
                        let event = LineEvent::Closed { reason: "unplugged".into() };
                        self.session.handle_line(self.now, &event);
                    }
                    Output::Replugged => {
                        self.session.handle_line(self.now, &LineEvent::Opened { modem_lines: true });
                    }
                }
                self.listen();
            }
            if self.session.poll_timeout().is_some_and(|due| due <= self.now) {
                self.session.handle_timeout(self.now);
                self.listen();
            }
        }
    }

    fn listen(&mut self) {
        while let Some(emitted) = self.session.poll_output() {
            match emitted {
                Said::Transmit(bytes) => self.stage.write(0, self.now, &bytes),
                Said::SetRts(on) => self.stage.device_mut(0).handle_rts(self.now, on),
                Said::Sample(sample) => self.samples.push(sample),
                Said::Warning(sentence) => self.warnings.push(sentence),
                Said::StateChanged | Said::HeadingReset { .. } | Said::Pressed { .. } => {}
            }
        }
    }

    /// Forgets what has been seen up to now.
    pub(crate) fn forget(&mut self) {
        self.samples.clear();
        self.truth.clear();
        self.losses.clear();
        self.hits.clear();
        self.warnings.clear();
    }

    /// Samples of one sensor.
    pub(crate) fn samples_of(&self, address: u16) -> Vec<Sample> {
        self.samples.iter().filter(|sample| sample.address == address).copied().collect()
    }

    /// Records of a sensor that the simulator knows to be lost.
    pub(crate) fn lost(&self, address: u16) -> u64 {
        let of = |loss: &&Loss| loss.address.is_none_or(|of| of == address);
        self.losses.iter().filter(of).count() as u64
    }

    /// What the driver counts as lost for each sensor, in the order of the stage.
    pub(crate) fn counted(&self) -> Vec<u64> {
        let of = |address| self.session.losses().iter().find(|loss| loss.address == address);
        self.addresses.iter().map(|&address| of(address).map_or(0, |loss| loss.lost)).collect()
    }

    /// The truth of a sample: the last one before it was read. Good while records leave within their cycle.
    pub(crate) fn truth_of(&self, sample: &Sample) -> (Timestamp, TruthRow) {
        let sensor = self.addresses.iter().position(|&address| address == sample.address).unwrap();
        let before = self.truth.iter().take_while(|cycle| cycle.t < sample.arrival.t_read);
        let row = |cycle: &TruthCycle| {
            let row = cycle.sensors.iter().find(|row| row.sensor == sensor)?;
            Some((cycle.t, *row))
        };
        before.filter_map(row).last().unwrap()
    }
}

/// Angle between a measured quaternion and a true rotation, rad.
pub(crate) fn angle_to(q: [f64; 4], truth: &TruthRow) -> f64 {
    let [w, x, y, z] = q;
    let q = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
    q.angle_to(&truth.pose.rotation)
}
