//! The live session with a Liberty or Patriot: set-up, stream, recovery.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, commands, the state of the link. What it never does: save
//! settings in the unit, set its clock, switch stations off.
//!
//! Commands are acknowledged by nothing but the errors of some; the answer about active stations proves that the unit listens, and
//! records that fit the list prove the rest. The life of its line is that of [`crate::serial`].

use std::time::Duration;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::stamps::{Judged, Stamps};
use super::wire::{Model, Piece, Record, Records, STATIONS, Shape};
use crate::flock::SettingsError;
use crate::link::Timing;
use crate::sample::{DeviceTime, Measurement, Timestamp};
use crate::serial::{Line, Protocol, RecordTime, SerialSession, Words, stations};
use crate::session::Loss;

/// Settings of a Liberty or Patriot; every key has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Whether records travel as lines of text instead of binary numbers; slower, and less of what is damaged is seen.
    pub text: bool,
    /// Whether the stylus button is sent.
    pub button: bool,
    /// Direction of the half-space around the source in which the sensors move: (1, 0, 0) forward, (0, 0, -1) upper.
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
        let possible = self.hemisphere.iter().all(|value| value.abs() <= 1.0) && self.hemisphere != [0.0; 3];
        if possible {
            Ok(())
        } else {
            Err(SettingsError { key: "hemisphere", expected: "three numbers from -1 to 1, not all 0" })
        }
    }

    fn shape(&self) -> Shape {
        Shape { text: self.text, button: self.button }
    }
}

/// A live session with one unit: samples are poses in the frame of the source, of the stations asked for, with the unit's own time.
///
/// The pose of a record with an error letter is `clipped`: it is published, and nothing is tracked by it. A record whose pose alone
/// was damaged cannot be distinguished from a true one within 10 m, where the quaternion is still one.
pub type PolhemusSession = SerialSession<Polhemus>;

/// What is a Liberty's or a Patriot's own.
#[derive(Clone, Debug, posed_state::State)]
pub struct Polhemus {
    #[state(keep)]
    settings: Settings,
    /// Bit/s of the line; 0 where it limits nothing.
    #[state(keep)]
    line_baud: u32,
    #[state(keep)]
    stations: Vec<u8>,
    stamps: Stamps,
    model: Option<Model>,
    /// Stations that the unit sends in each frame, wanted or not, by bit.
    active: u16,
    losses: Vec<Loss>,
    /// By station: the last frame that is accounted for, since the unit began to count; and when its record came.
    last: Vec<Option<(u64, Timestamp)>>,
}

impl PolhemusSession {
    /// A session for the stations `wanted`, 1 to 16, in any order. Closed until the line opens. A `line_baud` of 0 is a line that
    /// carries anything.
    ///
    /// # Errors
    /// A setting is out of its range; `wanted` is empty, names a station twice, or one that is not 1 to 16.
    pub fn new(settings: Settings, line_baud: u32, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        let stations = stations(wanted, STATIONS, "different numbers from 1 to 16")?;
        let addresses: Vec<u16> = stations.iter().copied().map(u16::from).collect();
        let records = Records::new(settings.shape());
        let protocol = Polhemus {
            settings,
            line_baud,
            losses: addresses.iter().map(|&address| Loss { address, ..Loss::default() }).collect(),
            last: vec![None; stations.len()],
            stations,
            stamps: Stamps::default(),
            model: None,
            active: 0,
        };
        Ok(Self::of(protocol, records, addresses.into_iter()))
    }
}

impl Polhemus {
    fn start(&mut self, now: Timestamp, model: Model, active: u16, line: &mut Line) {
        (self.model, self.active) = (Some(model), active);
        for &station in self.stations.iter().filter(|&&station| active >> (station - 1) & 1 == 0) {
            line.warn(now, u32::from(station), || {
                format!("station {station} has no sensor, or is switched off; check its plug")
            });
        }
        let [x, y, z] = self.settings.hemisphere;
        let shape = self.settings.shape();
        let items: Vec<String> = shape.items().iter().map(u8::to_string).collect();
        let format = u8::from(!shape.text);
        let commands = format!("U1\rH*,{x},{y},{z}\rO*,{}\rF{format}\rC\r", items.join(","));
        line.transmit(commands);
        line.cut_off();
        line.started(now);
        let len = if shape.text { line_len(shape) } else { shape.binary_len() };
        self.weigh(now, model, (active.count_ones(), len), line);
    }

    /// Warns of a line that cannot carry what the unit measures: it then leaves records out, or falls behind.
    fn weigh(&self, now: Timestamp, model: Model, (stations, len): (u32, usize), line: &mut Line) {
        let needed_baud = 10.0 * len as f64 * f64::from(stations) * model.rate_hz();
        let line_baud = self.line_baud;
        if line_baud > 0 && needed_baud > f64::from(line_baud) {
            line.warn(now, 0x100, || {
                format!(
                    "{stations} stations of {len} bytes, {:.0} times per second, need {needed_baud:.0} bit/s, and the line has {line_baud}: \
                     records will be missing. Raise the unit's baud rate, or unplug sensors",
                    model.rate_hz()
                )
            });
        }
    }

    fn record(&mut self, now: Timestamp, (offset, len): (u64, usize), record: Record, line: &mut Line) {
        if !line.is_streaming() {
            return;
        }
        let model = record.model.or(self.model).unwrap_or(Model::Liberty);
        let stamp = match self.stamps.judge(now, record.time_ms, record.frame, 1e3 / model.rate_hz()) {
            Judged::Doubtful => return line.refuse(len),
            Judged::GoesOn(stamp) => stamp,
            Judged::Anew(stamp) => {
                self.count_by_time(now, model);
                stamp
            }
        };
        line.heard(now);
        let Some(index) = self.stations.iter().position(|&station| station == record.station) else {
            return line.accept();
        };
        let missing = match self.last[index] {
            // The same frame twice: one of them is no record.
            Some((frame, _)) if stamp.frame <= frame => return line.refuse(len),
            Some((frame, _)) => stamp.frame - frame - 1,
            None => 0,
        };
        self.losses[index].lost += missing;
        self.last[index] = Some((stamp.frame, now));
        let (station, letter) = (record.station, char::from(record.status));
        let is_doubted = record.status != b' ';
        if is_doubted {
            line.warn(now, u32::from(station) << 16 | u32::from(record.status), || {
                format!("station {station} reports error {letter}; nothing is tracked by its poses until that ends")
            });
        }
        let pose = Measurement::Pose {
            position_m: Some(record.position_m),
            clipped: is_doubted,
            orientation_wxyz: Some(record.orientation_wxyz),
            button: record.button.map(u8::from),
        };
        let t_device = DeviceTime::Counter { ticks: stamp.time_us as u64, tick_s: 1e-6 };
        // A frame's records come in the order of the stations, one behind the other.
        let before = self.active & ((1 << (station - 1)) - 1);
        let cycle_bytes_before = before.count_ones() * len as u32;
        line.publish(
            offset,
            station.into(),
            RecordTime { t_device, cycle_bytes_before, after_loss: false },
            pose,
        );
    }

    /// The unit counts anew: how many frames it had counted when it ceased nobody knows, but for the time that has passed.
    fn count_by_time(&mut self, now: Timestamp, model: Model) {
        for (last, loss) in self.last.iter_mut().zip(&mut self.losses) {
            if let Some((_, at)) = last.take() {
                let missed = (now.seconds_since(at) * model.rate_hz()).round().max(1.0) as u64 - 1;
                loss.lost += missed;
                loss.estimated |= missed > 0;
            }
        }
    }
}

/// Bytes of a line of text.
fn line_len(shape: Shape) -> usize {
    let record = Record {
        model: None,
        station: 1,
        status: b' ',
        time_ms: 0,
        frame: 0,
        position_m: [0.0; 3],
        orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
        button: None,
    };
    let mut line = Vec::new();
    record.encode(shape, &mut line);
    line.len()
}

impl Protocol for Polhemus {
    type Grammar = Records;
    /// "Stop", active stations, and a re-initialisation, for whose end other drivers wait 20 s.
    const TIMING: Timing = Timing {
        steps: 1,
        step: Duration::from_millis(500),
        answer: Duration::from_millis(1000),
        questions: 3,
        reset: Duration::from_secs(20),
        start: Duration::from_secs(1),
        silence: Duration::from_millis(300),
    };
    const WORDS: Words = Words {
        opened: "asking the unit for its stations",
        no_answer: "the unit does not answer; it is being reset. Check power, cable and baud rate",
        silent: "no record any more; check the unit's power, its sensors' plugs and the cable",
    };

    fn prepare(&mut self, _: u8, line: &mut Line) {
        // CR first: it ends whatever half a command the unit may still hold. `P` stops the stream, and needs no CR.
        line.transmit(*b"\rP");
    }

    fn ask(&mut self, line: &mut Line) {
        // The stream and what `P` gave are over: what proves the answer need not follow it.
        line.cut_off();
        line.transmit(*b"F1\r\x150\r");
    }

    fn unanswered(&mut self, _: Timestamp, line: &mut Line) -> bool {
        line.transmit(*b"\x19\r");
        false
    }

    fn take(&mut self, now: Timestamp, piece: Piece, line: &mut Line) {
        match piece {
            Piece::Record { offset, len, record } => self.record(now, (offset, len), record, line),
            Piece::Active { model, stations } if line.is_asking() => self.start(now, model, stations, line),
            Piece::Active { .. } => {}
            Piece::Refusal { command, code } => line.warn(now, 0x200 | u32::from(code), || {
                format!("the unit answers command 0x{command:02X} with error {code} of its manual")
            }),
        }
    }

    fn rate_hz(&self) -> Option<f64> {
        self.model.map(Model::rate_hz)
    }

    fn losses(&self) -> &[Loss] {
        &self.losses
    }
}
