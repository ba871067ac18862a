//! The live session with a MotionStar: wake it, read what is there, set it up, run it.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, packets, the state of the link.
//! Life: `Closed -> Stopping -> Waking -> System -> Birds -> Running`; silence leads back to Stopping. Nothing
//! is set while data run: some servers hang from it.

use std::time::Duration;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::wire::{self, BirdStatus, Found, Header, Packets, SystemStatus, kind};
use crate::arrivals::Arrivals;
use crate::flock::SettingsError;
use crate::flock::wire::{Format, Hemisphere, QuaternionSense};
use crate::outbox::Outbox;
use crate::rate::too_seldom;
use crate::sample::{Arrival, DeviceTime, Measurement, Sample, Timestamp};
use crate::session::{Counters, LineEvent, Loss, Output, SensorInfo, Session, State};

/// Time for an answer, and how often a question is repeated.
const ANSWER: Duration = Duration::from_millis(500);
const TRIES: u8 = 3;
/// How often all are set up again for a unit that comes later, until the line is opened anew.
const JOINS: u8 = 3;
/// Pause after a failure.
const PAUSE: Duration = Duration::from_secs(1);
/// Silence of a stream.
const SILENCE: Duration = Duration::from_millis(500);
/// The same in intervals of its packets, where these are long.
const SILENT_PERIODS: f64 = 3.0;
/// Greatest step of the sequence number that is a loss, and not a new count.
const MOST_LOST: u16 = 1000;

/// Settings of a MotionStar; every key has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// What each bird's records hold.
    pub format: Format,
    /// Measurement rate to set, Hz, 20 to 144; absent: as the system has it.
    #[schemars(range(min = 20.0, max = 144.0))]
    pub measurement_rate_hz: Option<f64>,
    /// Records are sent every so many measurement cycles, 1 to 127.
    #[schemars(range(min = 1, max = 127))]
    pub report_every_cycles: u8,
    /// The half-space around the transmitter in which the sensors start.
    pub hemisphere: Hemisphere,
    /// Which rotation the quaternion on the wire describes.
    pub quaternion_sense: QuaternionSense,
    /// Whether records carry button bytes.
    pub button: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            format: Format::PositionQuaternion,
            measurement_rate_hz: None,
            report_every_cycles: 1,
            hemisphere: Hemisphere::Forward,
            quaternion_sense: QuaternionSense::Vendor,
            button: false,
        }
    }
}

impl Settings {
    /// Checks values that the types cannot.
    ///
    /// # Errors
    /// The first value out of its range, by key.
    pub fn validate(&self) -> Result<(), SettingsError> {
        if self.measurement_rate_hz.is_some_and(|hz| !(20.0..=144.0).contains(&hz)) {
            return Err(SettingsError { key: "measurement_rate_hz", expected: "20 to 144" });
        }
        if !(1..=127).contains(&self.report_every_cycles) {
            return Err(SettingsError { key: "report_every_cycles", expected: "1 to 127" });
        }
        Ok(())
    }

    fn hemisphere_code(&self) -> u8 {
        match self.hemisphere {
            Hemisphere::Forward => 0,
            Hemisphere::Aft => 1,
            Hemisphere::Upper => 2,
            Hemisphere::Lower => 3,
            Hemisphere::Left => 4,
            Hemisphere::Right => 5,
        }
    }
}

/// The question that is open, by what it is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
enum Step {
    Stop,
    Wake,
    ReadSystem,
    WriteSystem,
    ReadBird(usize),
    WriteBird(usize),
    Run,
}

#[derive(Clone, Copy, Debug, PartialEq, Plain)]
enum Phase {
    Closed,
    Asking { step: Step, tries: u8, until: Timestamp },
    Running { silent_at: Timestamp },
    Pausing { until: Timestamp },
}

/// A bird of the stage file.
#[derive(Clone, Debug, Plain)]
struct Bird {
    address: u8,
    status: Option<BirdStatus>,
    range_m: f64,
    /// It was set up: until then nobody knows what its records mean.
    set_up: bool,
    /// How often all were set up again for its sake.
    joined: u8,
}

/// A live session with one MotionStar: samples are poses in the transmitter frame, of the birds asked for.
///
/// Their time is the server's, ms since 1970, one for all records of a packet. The full scale of positions is read from each
/// bird, not set. Losses are counted by the packets' numbers, one record of each bird for a missing packet; after a break by
/// time.
#[derive(Clone, Debug, posed_state::State)]
pub struct MotionStarSession {
    #[state(keep)]
    settings: Settings,
    birds: Vec<Bird>,
    phase: Phase,
    sequence: u16,
    packets: Packets,
    arrivals: Arrivals,
    outbox: Outbox,
    dropped: u64,
    /// Of whole packets and records.
    refused_bytes: u64,
    system: Option<SystemStatus>,
    sensors: Vec<SensorInfo>,
    losses: Vec<Loss>,
    rate_hz: Option<f64>,
    last_sequence: Option<u16>,
    /// That of a packet that did not follow the one before.
    strange_sequence: Option<u16>,
    last_data: Option<Timestamp>,
}

impl MotionStarSession {
    /// A session for the birds `wanted`, by their address on the bus, in any order. Closed until the line opens.
    ///
    /// # Errors
    /// A setting is out of its range; `wanted` is empty, names an address twice, or one that is not 1 to 126.
    pub fn new(settings: Settings, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        let bad = SettingsError { key: "address", expected: "different numbers from 1 to 126" };
        let mut addresses: Vec<u8> =
            wanted.iter().map(|&address| u8::try_from(address).map_err(|_| bad)).collect::<Result<_, _>>()?;
        addresses.sort_unstable();
        addresses.dedup();
        let in_range = addresses.iter().all(|address| (1..=126).contains(address));
        if addresses.is_empty() || addresses.len() != wanted.len() || !in_range {
            return Err(bad);
        }
        let wide = addresses.iter().copied().map(u16::from);
        Ok(Self {
            settings,
            sensors: wide.clone().map(|address| SensorInfo { address, serial: None }).collect(),
            losses: wide.map(|address| Loss { address, ..Loss::default() }).collect(),
            birds: addresses
                .into_iter()
                .map(|address| Bird { address, status: None, range_m: 0.0, set_up: false, joined: 0 })
                .collect(),
            phase: Phase::Closed,
            sequence: 0,
            packets: Packets::default(),
            arrivals: Arrivals::default(),
            outbox: Outbox::new(),
            dropped: 0,
            refused_bytes: 0,
            system: None,
            rate_hz: None,
            last_sequence: None,
            strange_sequence: None,
            last_data: None,
        })
    }

    fn go(&mut self, now: Timestamp, step: Step) {
        self.phase = Phase::Asking { step, tries: TRIES, until: now + ANSWER };
        self.ask(step);
    }

    fn ask(&mut self, step: Step) {
        let (kind, unit, body) = match step {
            Step::Stop => (kind::STOP_DATA, 0, vec![]),
            Step::Wake => (kind::WAKE_UP, 0, vec![]),
            Step::ReadSystem => (kind::GET_STATUS, 0, vec![]),
            Step::WriteSystem => {
                let system = self.system.as_ref();
                let rate_hz = self.settings.measurement_rate_hz.or(self.rate_hz).unwrap_or_default();
                (kind::SEND_SETUP, 0, system.map_or_else(Vec::new, |system| system.with_rate(rate_hz)))
            }
            Step::ReadBird(k) => (kind::GET_STATUS, self.birds[k].address, vec![]),
            Step::WriteBird(k) => {
                let settings = &self.settings;
                let body = self.birds[k].status.as_ref().map_or_else(Vec::new, |status| {
                    let (every, hemisphere) = (settings.report_every_cycles, settings.hemisphere_code());
                    status.with(settings.format, every, hemisphere, settings.button)
                });
                (kind::SEND_SETUP, self.birds[k].address, body)
            }
            Step::Run => (kind::RUN_CONTINUOUS, 0, vec![]),
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut packet = Vec::new();
        Header { sequence: self.sequence, kind, unit, ..Header::default() }.encode(&body, &mut packet);
        self.outbox.transmit(packet);
    }

    fn fail(&mut self, now: Timestamp, reason: String) {
        self.outbox.failed(reason);
        self.phase = Phase::Pausing { until: now + PAUSE };
    }

    /// Takes a packet, and whether what has come behind it can be the next one: else its last record is not what was sent.
    fn packet(&mut self, now: Timestamp, found: Found, body: &[u8], is_followed: bool) {
        let Found { offset, header, .. } = found;
        if header.error != 0 {
            let code = header.error;
            self.outbox.warn(now, u32::from(code), || {
                format!("the server reports error {code}: {}", wire::error_words(code))
            });
        }
        match (header.kind, self.phase) {
            (kind::DATA_PACKET | kind::DATA_SINGLE, Phase::Running { .. }) => {
                self.data(now, offset, header, (body, is_followed))
            }
            (kind::DATA_PACKET, Phase::Asking { step, .. }) if !matches!(step, Step::Stop | Step::Run) => {
                // It did not hear the question to stop, and must not be set up while it runs.
                self.go(now, Step::Stop);
            }
            (_, Phase::Asking { step, .. }) => self.answer(now, step, header, body),
            _ => {}
        }
    }

    fn answer(&mut self, now: Timestamp, step: Step, header: Header, body: &[u8]) {
        match (step, header.kind) {
            (Step::Stop, kind::RSP_STOP_DATA | kind::RSP_ILLEGAL | kind::RSP_UNKNOWN) => {
                self.go(now, Step::Wake)
            }
            (Step::Wake, kind::RSP_WAKE_UP) => self.go(now, Step::ReadSystem),
            (Step::ReadSystem, kind::RSP_GET_STATUS) if header.unit == 0 => {
                let Some(system) = SystemStatus::parse(body) else { return };
                match system.rate() {
                    Ok(rate) => self.rate_hz = Some(rate.hz()),
                    // What it had before, or nothing, is the better guess.
                    Err(refused) => self.outbox.warn(now, 0x200, || {
                        format!("the system answers its measurement rate with damage: {refused}; it is not believed")
                    }),
                }
                for bird in &self.birds {
                    if !system.sensors().any(|address| address == bird.address) {
                        let address = bird.address;
                        self.outbox.warn(now, 0x100 + u32::from(address), || {
                            format!(
                                "no sensor answers at address {address}; check its plug and the stage file"
                            )
                        });
                    }
                }
                self.system = Some(system);
                let as_wanted =
                    self.settings.measurement_rate_hz.is_none_or(|wanted| Some(wanted) == self.rate_hz);
                self.go(now, if as_wanted { Step::ReadBird(0) } else { Step::WriteSystem });
            }
            (Step::WriteSystem, kind::RSP_SEND_SETUP) => {
                self.rate_hz = self.settings.measurement_rate_hz;
                self.go(now, Step::ReadBird(0));
            }
            (Step::ReadBird(k), kind::RSP_GET_STATUS) if header.unit == self.birds[k].address => {
                let Some(status) = BirdStatus::parse(body) else { return };
                let address = self.birds[k].address;
                let Some(range_m) = status.range_m() else {
                    return self.fail(
                        now,
                        format!("unit {address} does not measure in inches; set its scaling to inches"),
                    );
                };
                self.birds[k].range_m = range_m;
                self.birds[k].set_up = false;
                let has_sensor = status.has_sensor();
                self.birds[k].status = Some(status);
                if has_sensor { self.go(now, Step::WriteBird(k)) } else { self.next_bird(now, k + 1) }
            }
            // A unit that is not there: the others go on without it.
            (Step::ReadBird(k), kind::RSP_ILLEGAL | kind::RSP_UNKNOWN) => {
                self.birds[k].set_up = false;
                self.next_bird(now, k + 1);
            }
            (Step::WriteBird(k), kind::RSP_SEND_SETUP) => {
                self.birds[k].set_up = true;
                self.next_bird(now, k + 1);
            }
            (Step::Run, kind::RSP_RUN_CONTINUOUS) => {
                if let Some(warning) = self.rate_hz().and_then(too_seldom) {
                    self.outbox.warn(now, 0x300, || warning);
                }
                self.last_sequence = None;
                self.strange_sequence = None;
                self.phase = Phase::Running { silent_at: now + self.silence() };
            }
            _ => {}
        }
    }

    fn next_bird(&mut self, now: Timestamp, k: usize) {
        if k < self.birds.len() {
            self.go(now, Step::ReadBird(k));
        } else if self.birds.iter().all(|bird| bird.status.as_ref().is_none_or(|status| !status.has_sensor()))
        {
            self.fail(now, "no sensor of the stage file is there; check plugs and addresses".into());
        } else {
            self.go(now, Step::Run);
        }
    }

    fn data(&mut self, now: Timestamp, start: u64, header: Header, (body, is_followed): (&[u8], bool)) {
        let records = wire::records(body).filter(|_| is_followed);
        let Some(records) = records.filter(|_| self.follows(header.sequence)) else {
            self.outbox.counters.rejected += 1;
            self.refused_bytes += (wire::HEADER + body.len()) as u64;
            return;
        };
        let Some(arrival) = self.arrivals.of(start) else { return };
        self.count_losses(now, header.sequence);
        let (mut any_good, mut joins) = (false, None);
        let millis = u64::from(header.seconds) * 1000 + u64::from(header.millis);
        let t_device = DeviceTime::Counter { ticks: millis, tick_s: 1e-3 };
        let mut offset = wire::HEADER as u32;
        for record in records {
            let buttons = if record.buttons.is_some() { 2 } else { 0 };
            let arrival = Arrival { cycle_bytes_before: offset, ..arrival };
            let len = 2 + 2 * record.words.len() as u32 + buttons;
            offset += len;
            let Some(k) = self.birds.iter().position(|bird| bird.address == record.address) else { continue };
            if !self.birds[k].set_up {
                joins = joins.or(Some(k));
                continue;
            }
            match record.pose(self.birds[k].range_m, self.settings.quaternion_sense) {
                Ok(Some(pose)) => {
                    any_good = true;
                    self.outbox.counters.records += 1;
                    self.outbox.sample(Sample {
                        address: record.address.into(),
                        arrival,
                        t_device,
                        measurement: Measurement::Pose {
                            position_m: pose.position_m,
                            clipped: pose.is_clipped(self.birds[k].range_m),
                            orientation_wxyz: pose.orientation_wxyz,
                            button: record.buttons.map(|[_, low]| low),
                        },
                    });
                }
                Ok(None) => any_good = true,
                Err(wire::BadRecord) => {
                    self.outbox.counters.rejected += 1;
                    self.refused_bytes += u64::from(len);
                    self.losses[k].lost += 1;
                }
            }
        }
        // What sends bad records alone sends something else than it was set to, and is set up again.
        if any_good {
            self.phase = Phase::Running { silent_at: now + self.silence() };
            self.outbox.streaming();
        }
        if let Some(k) = joins {
            self.join(now, k);
        }
    }

    /// A bird sends that was not there at set-up: all are set up again, unless that was in vain before.
    fn join(&mut self, now: Timestamp, k: usize) {
        let Bird { address, joined, .. } = &mut self.birds[k];
        let address = *address;
        if *joined >= JOINS {
            self.outbox.warn(now, 0x400 + u32::from(address), || {
                format!("unit {address} sends though it reports no sensor; its records are left out")
            });
            return;
        }
        *joined += 1;
        self.outbox.connecting(format!("unit {address} has come; all are set up again"));
        self.go(now, Step::Stop);
    }

    /// How long a system that runs may send nothing.
    fn silence(&self) -> Duration {
        let periods = self.rate_hz().map(|rate_hz| Duration::from_secs_f64(SILENT_PERIODS / rate_hz));
        SILENCE.max(periods.unwrap_or_default())
    }

    /// Whether a packet comes after the latest one by its number. One that does not lacks a byte of its header, or has one of the packet
    /// before it for its first, and then the time at which that was read; where the next follows it, the server counts anew.
    fn follows(&mut self, sequence: u16) -> bool {
        let follows = |before: u16| sequence.wrapping_sub(before) <= MOST_LOST;
        let believed = self.last_sequence.is_none_or(follows) || self.strange_sequence.is_some_and(follows);
        self.strange_sequence = (!believed).then_some(sequence);
        believed
    }

    /// Data packets are numbered; after a break only time tells what was missed.
    fn count_losses(&mut self, now: Timestamp, sequence: u16) {
        let last_sequence = self.last_sequence.replace(sequence);
        let inferred = last_sequence.is_none();
        let lost = match (last_sequence, self.last_data.replace(now)) {
            (Some(last), _) => match sequence.wrapping_sub(last) {
                step @ 2..=MOST_LOST => u64::from(step) - 1,
                _ => 0,
            },
            (None, Some(then)) => {
                let rate_hz = self.rate_hz.unwrap_or_default() / f64::from(self.settings.report_every_cycles);
                ((now.seconds_since(then) * rate_hz).round() as u64).saturating_sub(1)
            }
            (None, None) => 0,
        };
        for loss in &mut self.losses {
            loss.lost += lost;
            loss.estimated |= inferred && lost > 0;
        }
    }
}

impl Session for MotionStarSession {
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { .. } => {
                self.packets.interrupt();
                self.arrivals.reopen();
                self.outbox.connecting("waking the system");
                self.birds.iter_mut().for_each(|bird| bird.joined = 0);
                self.go(now, Step::Stop);
            }
            LineEvent::Closed { reason } => {
                self.packets.interrupt();
                self.phase = Phase::Closed;
                self.outbox.connecting(reason.clone());
            }
            LineEvent::Dropped { bytes } => {
                self.packets.interrupt();
                self.dropped += bytes;
            }
        }
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.arrivals.read(now, bytes.len());
        // The packets lie in the buffer while the session changes.
        let mut packets = std::mem::take(&mut self.packets);
        packets.push(bytes);
        while let Some(found) = packets.find() {
            self.packet(now, found, packets.body(found), packets.is_followed(found));
        }
        self.packets = packets;
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        if self.poll_timeout().is_none_or(|at| now < at) {
            return;
        }
        match self.phase {
            Phase::Closed => {}
            Phase::Asking { step, tries, .. } if tries > 0 => {
                self.phase = Phase::Asking { step, tries: tries - 1, until: now + ANSWER };
                self.ask(step);
            }
            // Some servers do not answer a stop when nothing runs.
            Phase::Asking { step: Step::Stop, .. } => self.go(now, Step::Wake),
            Phase::Asking { step: Step::ReadBird(k) | Step::WriteBird(k), .. } => self.next_bird(now, k + 1),
            Phase::Asking { .. } => {
                self.outbox.silent(
                    "the system does not answer; check its power, network and address (TCP 6000, UDP 5000)",
                );
                self.phase = Phase::Pausing { until: now + PAUSE };
            }
            Phase::Pausing { .. } => self.go(now, Step::Stop),
            Phase::Running { .. } => {
                self.outbox.silent("no data any more; check the system's power and network");
                self.go(now, Step::Stop);
            }
        }
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        match self.phase {
            Phase::Closed => None,
            Phase::Asking { until, .. } | Phase::Pausing { until } => Some(until),
            Phase::Running { silent_at } => Some(silent_at),
        }
    }

    fn state(&self) -> &State {
        self.outbox.state()
    }

    fn counters(&self) -> Counters {
        let bytes_skipped = self.dropped + self.refused_bytes + self.packets.bytes_skipped();
        Counters { bytes_skipped, ..self.outbox.counters }
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        self.rate_hz.map(|rate| rate / f64::from(self.settings.report_every_cycles))
    }

    fn losses(&self) -> &[Loss] {
        &self.losses
    }
}
