//! The live session with a Fastrak: set-up, stream, recovery.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, commands, the state of the link.
//! The unit acknowledges nothing but the status question, so set-up is proved by records that fit.
//!
//! The life of its line is that of [`crate::serial`], its losses are those of its turns.

use std::time::Duration;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::wire::{Piece, Record, Records, STATIONS, Shape};
use crate::flock::SettingsError;
use crate::link::Timing;
use crate::sample::{DeviceTime, Measurement, Timestamp};
use crate::serial::{Line, Protocol, RecordTime, SerialSession, Words, stations};
use crate::session::Loss;
use crate::turns::Turns;

/// Measurements per second of a unit, shared by its stations.
const UNIT_RATE_HZ: f64 = 120.0;
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

/// A live session with one Fastrak: samples are poses in the transmitter frame, of the stations asked for.
///
/// All records are read as position and quaternion in metres; those of a station with an error letter are refused. A record
/// whose bytes were damaged in the position alone cannot be distinguished from a true one within 10 m.
pub type FastrakSession = SerialSession<Fastrak>;

/// What is a Fastrak's own.
#[derive(Clone, Debug, posed_state::State)]
pub struct Fastrak {
    #[state(keep)]
    settings: Settings,
    #[state(keep)]
    stations: Vec<u8>,
    turns: Turns,
}

impl FastrakSession {
    /// A session for the stations `wanted`, 1 to 4, in any order; set-up switches the others off. Closed until the line opens.
    ///
    /// # Errors
    /// A setting is out of its range; `wanted` is empty, names a station twice, or one that is not 1 to 4.
    pub fn new(settings: Settings, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        let stations = stations(wanted, STATIONS, "different numbers from 1 to 4")?;
        let addresses: Vec<u16> = stations.iter().copied().map(u16::from).collect();
        let records = Records::new(settings.shape());
        let turns = Turns::new(addresses.iter().copied());
        Ok(Self::of(Fastrak { settings, stations, turns }, records, addresses.into_iter()))
    }
}

impl Fastrak {
    fn start(&mut self, now: Timestamp, line: &mut Line) {
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
        line.transmit(commands);
        self.turns.start();
        line.cut_off();
        line.started(now);
    }

    fn record(&mut self, now: Timestamp, (offset, len): (u64, usize), record: Record, line: &mut Line) {
        if !line.is_streaming() {
            return;
        }
        let Some(index) = self.stations.iter().position(|&station| station == record.station) else {
            return line.refuse(len);
        };
        line.heard(now);
        self.turns.record(now, index, len as u64, line.skipped(), UNIT_RATE_HZ);
        if record.status != b' ' {
            line.refuse(len);
            self.turns.refuse(index, line.skipped());
            let (station, letter) = (record.station, char::from(record.status));
            line.warn(now, u32::from(station) << 8 | u32::from(record.status), || {
                format!("station {station} reports error {letter}; its poses are not used until that ends")
            });
            return;
        }
        let t_device = DeviceTime::Cycle(self.turns.cycle());
        let time = RecordTime { t_device, cycle_bytes_before: 0, after_loss: self.turns.take_doubt(index) };
        let pose = Measurement::Pose {
            position_m: Some(record.position_m),
            // Its words are numbers with a decimal point.
            clipped: false,
            orientation_wxyz: Some(record.orientation_wxyz),
            button: record.button.map(u8::from),
        };
        line.publish(offset, record.station.into(), time, pose);
    }
}

impl Protocol for Fastrak {
    type Grammar = Records;
    /// "Stop", its status, and a reset, from which it takes 10 to 15 s to come back.
    const TIMING: Timing = Timing {
        steps: 1,
        step: Duration::from_millis(500),
        answer: Duration::from_millis(1000),
        questions: 3,
        reset: Duration::from_secs(16),
        start: Duration::from_secs(1),
        silence: Duration::from_millis(300),
    };
    const WORDS: Words = Words {
        opened: "asking the unit for its status",
        no_answer: "the unit does not answer; it is being reset. Check power, cable and baud rate",
        silent: "no record any more; check the unit's power, its sensors' plugs and the cable",
    };

    fn prepare(&mut self, _: u8, line: &mut Line) {
        // CR first: it ends whatever half a command the unit may still hold.
        line.transmit(*b"\rc");
    }

    fn ask(&mut self, line: &mut Line) {
        line.transmit(*b"S");
    }

    fn unanswered(&mut self, _: Timestamp, line: &mut Line) -> bool {
        line.transmit([0x19]);
        false
    }

    fn take(&mut self, now: Timestamp, piece: Piece, line: &mut Line) {
        match piece {
            Piece::Record { offset, len, record } => self.record(now, (offset, len), record, line),
            Piece::Status if line.is_asking() => self.start(now, line),
            Piece::Status => {}
        }
    }

    fn rate_hz(&self) -> Option<f64> {
        Some(UNIT_RATE_HZ / self.stations.len() as f64)
    }

    fn losses(&self) -> &[Loss] {
        self.turns.losses()
    }
}
