//! The live session with a Fastrak: set-up, stream, recovery.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, commands, the state of the link.
//! The unit acknowledges nothing but the status question, so set-up is proved by records that fit.
//!
//! Life: `Closed -> Stopping -> Asking (-> Resetting) -> Streaming`; silence leads back to Stopping.

use std::time::Duration;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::debt::Debt;
use super::wire::{Piece, Record, STATIONS, Shape, Splitter};
use crate::arrivals::{Arrivals, hides_losses, whole_cycles};
use crate::flock::SettingsError;
use crate::outbox::Outbox;
use crate::sample::{Arrival, DeviceTime, Measurement, Sample, Timestamp};
use crate::session::{Counters, LineEvent, Loss, Output, SensorInfo, Session, State};

/// Measurements per second of a unit, shared by its stations.
const UNIT_RATE_HZ: f64 = 120.0;
/// From "stop" to a quiet line.
const STOP: Duration = Duration::from_millis(500);
/// Time for the status answer.
const ANSWER: Duration = Duration::from_millis(1000);
/// A reset unit answers after 10 to 15 s, and is not reset again before. It is asked meanwhile: one that was off has not heard the
/// reset, and answers as soon as it has power.
const RESET: Duration = Duration::from_secs(16);
/// Unanswered questions after which the unit is reset.
const QUESTIONS: u8 = 3;
/// Silence of a stream, and of one that has just been started.
const SILENCE: Duration = Duration::from_millis(300);
const START: Duration = Duration::from_secs(1);

/// Settings of a Fastrak; every key has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Whether records travel as lines of text instead of binary numbers; slower, for trackers that cannot else.
    pub text: bool,
    /// Whether the stylus button is sent.
    pub button: bool,
    /// Direction of the half-space around the transmitter in which the sensors move: (1, 0, 0) forward,
    /// (0, 0, -1) upper; (0, 0, 0) follows the sensor.
    pub hemisphere: [f64; 3],
}

impl Default for Settings {
    fn default() -> Self {
        Self { text: false, button: false, hemisphere: [1.0, 0.0, 0.0] }
    }
}

impl Settings {
    /// Checks values that the types cannot.
    ///
    /// # Errors
    /// The first value out of its range, by key.
    pub fn validate(&self) -> Result<(), SettingsError> {
        if self.hemisphere.iter().all(|value| value.abs() <= 1.0) {
            Ok(())
        } else {
            Err(SettingsError { key: "hemisphere", expected: "three numbers from -1 to 1" })
        }
    }

    fn shape(&self) -> Shape {
        Shape { text: self.text, button: self.button }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Plain)]
enum Phase {
    Closed,
    Stopping { until: Timestamp },
    Asking { until: Timestamp },
    Streaming { silent_at: Timestamp },
}

/// A live session with one Fastrak: samples are poses in the transmitter frame, of the stations asked for.
///
/// All records are read as position and quaternion in metres; those of a station with an error letter are refused. A record
/// whose bytes were damaged in the position alone cannot be distinguished from a true one within 10 m.
#[derive(Clone, Debug, posed_state::State)]
pub struct FastrakSession {
    #[state(keep)]
    settings: Settings,
    #[state(keep)]
    stations: Vec<u8>,
    phase: Phase,
    /// Questions since an answer, the opening of the line or a reset.
    questions: u8,
    /// Until then a reset unit starts.
    resets_until: Timestamp,
    splitter: Splitter,
    arrivals: Arrivals,
    outbox: Outbox,
    /// Bytes dropped in front of the session, and those of refused records.
    dropped: u64,
    sensors: Vec<SensorInfo>,
    losses: Vec<Loss>,
    cycle: u64,
    /// Index of the station whose record is due.
    due: usize,
    last_record: Option<Timestamp>,
    debt: Debt,
    /// The stream has been started anew since the last record.
    started: bool,
    /// Bytes of no record, until the last one.
    skipped_before: u64,
    /// By station: bytes were lost since its last record, and nobody knows how many.
    after_loss: Vec<bool>,
}

impl FastrakSession {
    /// A session for the stations `wanted`, 1 to 4, in any order; set-up switches the others off. Closed until the line opens.
    ///
    /// # Errors
    /// A setting is out of its range; `wanted` is empty, names a station twice, or one that is not 1 to 4.
    pub fn new(settings: Settings, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        let bad = SettingsError { key: "address", expected: "different numbers from 1 to 4" };
        let mut stations: Vec<u8> =
            wanted.iter().map(|&station| u8::try_from(station).map_err(|_| bad)).collect::<Result<_, _>>()?;
        stations.sort_unstable();
        stations.dedup();
        let in_range = stations.iter().all(|station| (1..=STATIONS).contains(station));
        if stations.is_empty() || stations.len() != wanted.len() || !in_range {
            return Err(bad);
        }
        let addresses = stations.iter().copied().map(u16::from);
        Ok(Self {
            splitter: Splitter::new(settings.shape()),
            settings,
            sensors: addresses.clone().map(|address| SensorInfo { address, serial: None }).collect(),
            losses: addresses.map(|address| Loss { address, ..Loss::default() }).collect(),
            after_loss: vec![false; stations.len()],
            stations,
            phase: Phase::Closed,
            questions: 0,
            resets_until: Timestamp::ZERO,
            arrivals: Arrivals::default(),
            outbox: Outbox::new(),
            dropped: 0,
            cycle: 0,
            due: 0,
            last_record: None,
            debt: Debt::default(),
            started: false,
            skipped_before: 0,
        })
    }

    fn stop(&mut self, now: Timestamp) {
        // CR first: it ends whatever half a command the unit may still hold.
        self.outbox.transmit(b"\rc".to_vec());
        self.phase = Phase::Stopping { until: now + STOP };
    }

    fn ask(&mut self, now: Timestamp) {
        self.outbox.transmit(b"S".to_vec());
        self.questions += 1;
        self.phase = Phase::Asking { until: now + ANSWER };
    }

    fn start(&mut self, now: Timestamp) {
        let [x, y, z] = self.settings.hemisphere;
        let mut commands = String::from("u");
        for station in 1..=STATIONS {
            let on = u8::from(self.stations.contains(&station));
            commands += &format!("l{station},{on}\r");
        }
        for station in &self.stations {
            commands += &format!("O{station},{}\rH{station},{x},{y},{z}\r", self.settings.shape().items());
            if self.settings.button {
                commands += &format!("e{station},0\r");
            }
        }
        commands += if self.settings.text { "F" } else { "f" };
        commands.push('C');
        self.outbox.transmit(commands.into_bytes());
        self.questions = 0;
        self.due = 0;
        self.started = true;
        self.splitter.interrupt();
        self.phase = Phase::Streaming { silent_at: now + START };
    }

    fn record(&mut self, now: Timestamp, offset: u64, len: usize, record: Record) {
        if !matches!(self.phase, Phase::Streaming { .. }) {
            return;
        }
        let Some(index) = self.stations.iter().position(|&station| station == record.station) else {
            self.refuse(len);
            return;
        };
        self.phase = Phase::Streaming { silent_at: now + SILENCE };
        self.count_losses(now, index, len as u64);
        if record.status != b' ' {
            self.refuse(len);
            self.skipped_before = self.skipped();
            self.losses[index].lost += 1;
            let (station, letter) = (record.station, char::from(record.status));
            self.outbox.warn(now, u32::from(station) << 8 | u32::from(record.status), || {
                format!("station {station} reports error {letter}; its poses are not used until that ends")
            });
            return;
        }
        self.outbox.counters.records += 1;
        self.outbox.streaming();
        let Some(arrival) = self.arrivals.of(offset) else { return };
        let after_loss = std::mem::take(&mut self.after_loss[index]);
        self.outbox.sample(Sample {
            address: record.station.into(),
            arrival: Arrival { after_loss, ..arrival },
            t_device: DeviceTime::Cycle(self.cycle),
            measurement: Measurement::Pose {
                position_m: Some(record.position_m),
                // Its words are numbers with a decimal point.
                clipped: false,
                orientation_wxyz: Some(record.orientation_wxyz),
                button: record.button.map(u8::from),
            },
        });
    }

    fn refuse(&mut self, len: usize) {
        self.outbox.counters.rejected += 1;
        self.dropped += len as u64;
    }

    /// Bytes of no record up to here.
    fn skipped(&self) -> u64 {
        self.dropped + self.splitter.bytes_skipped()
    }

    /// Stations come in turn: those passed over were lost, and so were whole cycles where the bytes of no record are as many.
    /// Of bytes that never came, whole cycles leave no trace but time, and are counted once that has passed: too late for the number
    /// of a cycle, which the clock puts right by itself where it knows that there is doubt. `len` are the bytes of a record.
    fn count_losses(&mut self, now: Timestamp, index: usize, len: u64) {
        let elapsed_s = self.last_record.replace(now).map_or(0.0, |last| now.seconds_since(last));
        let stations = self.stations.len();
        if std::mem::take(&mut self.started) {
            self.debt.forgive();
            let missed = (elapsed_s * UNIT_RATE_HZ / stations as f64).round() as u64;
            self.lose_cycles(missed.saturating_sub(1));
            self.due = index;
            self.skipped_before = self.skipped();
        }
        let skipped = self.skipped();
        let damaged = skipped - std::mem::replace(&mut self.skipped_before, skipped);
        let to_index = (index + stations - self.due) % stations;
        let whole = whole_cycles(damaged, to_index as u64 * len, stations as u64 * len);
        let passed = to_index as u64 + whole * stations as u64;
        if hides_losses(damaged, passed.saturating_mul(len), len) {
            self.after_loss.fill(true);
        }
        self.cycle += whole;
        self.lose_cycles(whole);
        for _ in 0..to_index {
            self.losses[self.due].lost += 1;
            self.losses[self.due].estimated = true;
            self.step();
        }
        let cycles = self.debt.record(now, passed, stations, UNIT_RATE_HZ);
        self.lose_cycles(cycles);
        self.step();
    }

    fn lose_cycles(&mut self, cycles: u64) {
        for loss in &mut self.losses {
            loss.lost += cycles;
            loss.estimated |= cycles > 0;
        }
    }

    fn step(&mut self) {
        self.due += 1;
        if self.due == self.stations.len() {
            self.due = 0;
            self.cycle += 1;
        }
    }
}

impl Session for FastrakSession {
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { .. } => {
                self.splitter.interrupt();
                self.arrivals.reopen();
                self.questions = 0;
                self.outbox.connecting("asking the unit for its status");
                self.stop(now);
            }
            LineEvent::Closed { reason } => {
                self.splitter.interrupt();
                self.phase = Phase::Closed;
                self.outbox.connecting(reason.clone());
            }
            LineEvent::Dropped { bytes } => {
                self.splitter.interrupt();
                self.dropped += bytes;
            }
        }
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.arrivals.read(now, bytes.len());
        self.splitter.push(bytes);
        while let Some(piece) = self.splitter.find() {
            match piece {
                Piece::Record { offset, len, record } => self.record(now, offset, len, record),
                Piece::Status if matches!(self.phase, Phase::Asking { .. }) => self.start(now),
                Piece::Status => {}
            }
        }
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        if self.poll_timeout().is_none_or(|at| now < at) {
            return;
        }
        match self.phase {
            Phase::Closed => {}
            Phase::Stopping { .. } => self.ask(now),
            Phase::Asking { .. } if self.questions < QUESTIONS || now < self.resets_until => self.stop(now),
            Phase::Asking { .. } => {
                self.outbox
                    .silent("the unit does not answer; it is being reset. Check power, cable and baud rate");
                self.outbox.transmit(vec![0x19]);
                self.questions = 0;
                self.resets_until = now + RESET;
                self.stop(now);
            }
            Phase::Streaming { .. } => {
                self.outbox
                    .silent("no record any more; check the unit's power, its sensors' plugs and the cable");
                self.stop(now);
            }
        }
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        match self.phase {
            Phase::Closed => None,
            Phase::Stopping { until } | Phase::Asking { until } => Some(until),
            Phase::Streaming { silent_at } => Some(silent_at),
        }
    }

    fn state(&self) -> &State {
        self.outbox.state()
    }

    fn counters(&self) -> Counters {
        Counters {
            rejected: self.outbox.counters.rejected + self.splitter.rejected(),
            bytes_skipped: self.dropped + self.splitter.bytes_skipped(),
            ..self.outbox.counters
        }
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        Some(UNIT_RATE_HZ / self.stations.len() as f64)
    }

    fn losses(&self) -> &[Loss] {
        &self.losses
    }
}
