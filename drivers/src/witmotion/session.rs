//! The live session with one WitMotion sensor: set-up, stream, recovery.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, commands, the state of the link. What it never does: save
//! settings in the sensor, calibrate it, choose whether its heading follows the magnetometer, of which the sources disagree how.
//!
//! Writing is acknowledged by nothing: the registers are unlocked, written, and read back. The life of its line is that of
//! [`crate::serial`], its losses are those of one sensor's turns.

use std::time::Duration;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::wire::{self, GROUP_LEN, Group, Groups, Piece, RATES, register};
use crate::flock::SettingsError;
use crate::flock::wire::rotation;
use crate::link::Timing;
use crate::sample::{DeviceTime, Measurement, Timestamp};
use crate::serial::{Line, Protocol, RecordTime, SerialSession, Words};
use crate::session::Loss;
use crate::turns::Turns;

/// How far quaternion and angles, which say the same, may be apart: 5 degrees.
const APART_RAD: f64 = 0.087;
/// Samples whose quaternion agrees with the angles in no order, after which that is taken for the sensor's own way.
const UNPROVEN: u16 = 50;

/// Settings of a WitMotion sensor; every key has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Samples per second: the nearest of 10, 20, 50, 100 and 200; a slower one is taken, with a warning, where the line needs it.
    #[schemars(range(min = 10.0, max = 200.0))]
    pub rate_hz: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { rate_hz: 100.0 }
    }
}

impl Settings {
    /// Checks values that the types cannot.
    ///
    /// # Errors
    /// The first value out of its range, by key.
    pub fn validate(&self) -> Result<(), SettingsError> {
        if (10.0..=200.0).contains(&self.rate_hz) {
            Ok(())
        } else {
            Err(SettingsError { key: "rate_hz", expected: "10 to 200" })
        }
    }

    /// The rate to set and its code, and whether it is less than was asked for because the line carries no more.
    fn rate(&self, line_baud: u32) -> (f64, u16, bool) {
        let fits = |rate_hz: f64| line_baud == 0 || 10.0 * GROUP_LEN as f64 * rate_hz <= f64::from(line_baud);
        let distance = |(rate_hz, _): &&(f64, u16)| (rate_hz - self.rate_hz).abs();
        let wanted = RATES.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(&RATES[0]);
        let carried = RATES.iter().rev().find(|(rate_hz, _)| *rate_hz <= wanted.0 && fits(*rate_hz));
        let &(rate_hz, code) = carried.unwrap_or(&RATES[0]);
        (rate_hz, code, rate_hz < wanted.0)
    }
}

/// In which order the quaternion stands on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
enum Order {
    /// So many samples did not show it.
    Open(u16),
    ScalarFirst,
    ScalarLast,
    /// It agrees with the angles in neither order; it is read scalar first, as the maker's names have it.
    Unproven,
}

/// Quaternion and angles, which always agreed, do not.
struct Contradiction;

/// A live session with one sensor: samples are angular velocity, specific force and the sensor's own orientation, of any heading.
///
/// Losses are estimated from time and from damaged bytes: frames have no number.
pub type WitMotionSession = SerialSession<WitMotion>;

/// What is a WitMotion sensor's own.
#[derive(Clone, Debug, posed_state::State)]
pub struct WitMotion {
    #[state(keep)]
    rate_hz: f64,
    #[state(keep)]
    rate_code: u16,
    #[state(keep)]
    is_lowered: bool,
    order: Order,
    /// A group came since the last preparation began.
    sends_groups: bool,
    turns: Turns,
}

impl WitMotionSession {
    /// A session for one sensor, whose address is 0. Closed until the line opens. A `line_baud` of 0 is a line that carries anything.
    ///
    /// # Errors
    /// A setting is out of its range; `wanted` is anything but 0 alone.
    pub fn new(settings: Settings, line_baud: u32, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        if wanted != [0] {
            return Err(SettingsError { key: "address", expected: "0, and a device for each sensor" });
        }
        let (rate_hz, rate_code, is_lowered) = settings.rate(line_baud);
        let turns = Turns::new(std::iter::once(0));
        let protocol =
            WitMotion { rate_hz, rate_code, is_lowered, order: Order::Open(0), sends_groups: false, turns };
        Ok(Self::of(protocol, Groups, std::iter::once(0)))
    }
}

impl WitMotion {
    fn start(&mut self, now: Timestamp, line: &mut Line) {
        self.turns.start();
        line.started(now);
        let rate_hz = self.rate_hz;
        if self.is_lowered {
            line.warn(now, 1, || {
                format!("the line carries {rate_hz} samples per second, not as many as `rate_hz` has; raise `baud`, at the sensor too")
            });
        }
    }

    fn registers(&mut self, now: Timestamp, registers: [u16; 4], line: &mut Line) {
        if !line.is_asking() {
            return;
        }
        // They may hold something else: an answer to another program, or what was there before a write that a lock has refused.
        if registers[..2] == [wire::OUTPUT, self.rate_code] {
            return self.start(now, line);
        }
        line.warn(now, 2, || {
            "the sensor does not keep its settings; switch it off and on, and end other programs that use it"
                .to_owned()
        });
    }

    fn group(&mut self, now: Timestamp, offset: u64, group: Group, line: &mut Line) {
        self.sends_groups = true;
        if !line.is_streaming() {
            return;
        }
        line.heard(now);
        self.turns.record(now, 0, GROUP_LEN as u64, line.skipped(), self.rate_hz);
        let Ok(orientation_wxyz) = self.orientation(now, &group, line) else {
            line.refuse(GROUP_LEN);
            return self.turns.refuse(0, line.skipped());
        };
        let t_device = DeviceTime::Cycle(self.turns.cycle());
        let time = RecordTime { t_device, cycle_bytes_before: 0, after_loss: self.turns.take_doubt(0) };
        let measured = Measurement::Imu {
            angular_velocity_rad_s: Some(group.angular_velocity_rad_s),
            specific_force_m_s2: Some(group.specific_force_m_s2),
            linear_acceleration_m_s2: None,
            magnetic_field: None,
            orientation_wxyz,
        };
        line.publish(offset, 0, time, measured);
    }

    /// The sensor's orientation, once it is known how it is written.
    ///
    /// # Errors
    /// It contradicts the angles, which always agreed: the group is damaged.
    fn orientation(
        &mut self,
        now: Timestamp,
        group: &Group,
        line: &mut Line,
    ) -> Result<Option<[f64; 4]>, Contradiction> {
        let [a, b, c, d] = rotation::normalised(group.quaternion);
        let [roll, pitch, yaw] = group.angles_rad;
        let by_angles = rotation::from_angles([yaw, pitch, roll]);
        let agrees = |q: [f64; 4]| {
            let dot: f64 = q.iter().zip(by_angles).map(|(one, other)| one * other).sum();
            2.0 * libm::acos(dot.abs().min(1.0)) <= APART_RAD
        };
        let (first, last) = ([a, b, c, d], [d, a, b, c]);
        if let Order::Open(samples) = self.order {
            self.order = match (agrees(first), agrees(last)) {
                (true, false) => Order::ScalarFirst,
                (false, true) => {
                    line.warn(now, 3, || {
                        "the sensor writes its quaternion scalar last; it is read so from now on".to_owned()
                    });
                    Order::ScalarLast
                }
                // Of a few rotations both are the same.
                (true, true) => Order::Open(samples),
                (false, false) if samples < UNPROVEN => Order::Open(samples + 1),
                (false, false) => {
                    line.warn(now, 4, || {
                        "the sensor's quaternion and its angles disagree; its orientation may be wrong"
                            .to_owned()
                    });
                    Order::Unproven
                }
            };
        }
        match self.order {
            Order::Open(_) => Ok(None),
            Order::Unproven => Ok(Some(first)),
            Order::ScalarFirst if agrees(first) => Ok(Some(first)),
            Order::ScalarLast if agrees(last) => Ok(Some(last)),
            Order::ScalarFirst | Order::ScalarLast => Err(Contradiction),
        }
    }
}

impl Protocol for WitMotion {
    type Grammar = Groups;
    /// The key and three registers, each with the pause that the maker's program leaves; then what they hold, behind up to a whole
    /// group. At 10 Hz, as a new sensor sends, there are 100 ms between two.
    const TIMING: Timing = Timing {
        steps: 4,
        step: Duration::from_millis(100),
        answer: Duration::from_millis(500),
        questions: 3,
        reset: Duration::ZERO,
        start: Duration::from_secs(1),
        silence: Duration::from_millis(500),
    };
    const WORDS: Words = Words {
        opened: "setting the sensor up",
        no_answer: "the sensor does not answer; check power, cable and baud rate (9600 unless set otherwise)",
        silent: "no sample any more; check the sensor's power and the cable",
    };

    fn opened(&mut self) {
        self.order = Order::Open(0);
    }

    fn prepare(&mut self, step: u8, line: &mut Line) {
        self.sends_groups &= step > 0;
        line.transmit(match step {
            0 => wire::write(register::KEY, wire::KEY),
            // The widest there is: nothing below the rate is to be cut off.
            1 => wire::write(register::BANDWIDTH, 0),
            2 => wire::write(register::OUTPUT, wire::OUTPUT),
            _ => wire::write(register::RATE, self.rate_code),
        });
    }

    fn ask(&mut self, line: &mut Line) {
        line.transmit(wire::read(register::OUTPUT));
    }

    fn unanswered(&mut self, now: Timestamp, line: &mut Line) -> bool {
        if self.sends_groups {
            line.warn(now, 5, || {
                "the sensor sends what it was set to, but does not answer; its rate is not known for sure"
                    .to_owned()
            });
            self.start(now, line);
        }
        self.sends_groups
    }

    fn take(&mut self, now: Timestamp, piece: Piece, line: &mut Line) {
        match piece {
            Piece::Group { offset, group } => self.group(now, offset, group, line),
            Piece::Registers(registers) => self.registers(now, registers, line),
        }
    }

    fn rate_hz(&self) -> Option<f64> {
        Some(self.rate_hz)
    }

    fn losses(&self) -> &[Loss] {
        self.turns.losses()
    }
}
