//! Frames, groups and commands of a WitMotion sensor, both ways.
//!
//! What comes in: bytes in pieces of any size. What goes out: groups in SI units, and what registers hold.

use posed_geometry::GRAVITY_M_S2;
use posed_state::Plain;

use crate::cut::{Cutter, Front, Grammar};

/// First byte of every frame; it also occurs inside.
pub const START: u8 = 0x55;
/// Bytes of a frame: start, kind, eight of contents, sum.
pub const FRAME: usize = 11;
/// Kinds of frame.
pub mod kind {
    /// Acceleration, 16 g full scale; temperature.
    pub const ACCELERATION: u8 = 0x51;
    /// Angular velocity, 2000 degrees/s full scale.
    pub const ANGULAR_VELOCITY: u8 = 0x52;
    /// Roll, pitch, yaw, 180 degrees full scale; firmware.
    pub const ANGLE: u8 = 0x53;
    /// Quaternion.
    pub const QUATERNION: u8 = 0x59;
    /// Four registers, as asked.
    pub const REGISTERS: u8 = 0x5F;
}
/// The frames of a group, in the order in which a sensor sends them.
pub const GROUP: [u8; 4] = [kind::ACCELERATION, kind::ANGULAR_VELOCITY, kind::ANGLE, kind::QUATERNION];
/// Bytes of a group.
pub const GROUP_LEN: usize = FRAME * GROUP.len();
/// Registers.
pub mod register {
    /// Which frames are sent; rate and line rate follow.
    pub const OUTPUT: u8 = 0x02;
    /// How often.
    pub const RATE: u8 = 0x03;
    /// Low-pass filter of the sensors.
    pub const BANDWIDTH: u8 = 0x1F;
    /// Acceleration, the first of the measured ones.
    pub const ACCELERATION: u8 = 0x34;
    /// Whoever writes the key here may write for 10 s.
    pub const KEY: u8 = 0x69;
}
/// The output register that asks for a [`GROUP`].
pub const OUTPUT: u16 = 0x020E;
/// What unlocks the registers.
pub const KEY: u16 = 0xB588;
/// Rates, Hz, and their codes.
pub const RATES: [(f64, u16); 5] = [(10.0, 0x06), (20.0, 0x07), (50.0, 0x08), (100.0, 0x09), (200.0, 0x0B)];
/// How far from 1 the norm of a quaternion may be: the words are of 15 bits, and nobody says how well a sensor computes it.
const NORM: f64 = 0.02;
const FULL_WORD: f64 = 32_768.0;

/// The command that writes a register; nothing acknowledges it.
pub fn write(register: u8, value: u16) -> [u8; 5] {
    let [low, high] = value.to_le_bytes();
    [0xFF, 0xAA, register, low, high]
}

/// The command that asks for four registers from this one on; the answer does not say which they are.
pub fn read(register: u8) -> [u8; 5] {
    [0xFF, 0xAA, 0x27, register, 0]
}

/// Appends a frame as it travels.
pub fn frame(kind: u8, words: [i16; 4], out: &mut Vec<u8>) {
    let start = out.len();
    out.extend([START, kind]);
    out.extend(words.iter().flat_map(|word| word.to_le_bytes()));
    out.push(sum(&out[start..]));
}

fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum: u8, &byte| sum.wrapping_add(byte))
}

/// Kind and words of the frame at the front; `None` where its start or its sum is wrong, or it is cut short.
pub fn parse(bytes: &[u8]) -> Option<(u8, [i16; 4])> {
    let (frame, _) = bytes.split_first_chunk::<FRAME>()?;
    let [START, kind, words @ .., end] = frame else { return None };
    let (words, _) = words.as_chunks::<2>();
    let words = std::array::from_fn(|k| i16::from_le_bytes(words[k]));
    (*end == sum(&frame[..FRAME - 1])).then_some((*kind, words))
}

/// One measurement, in SI units and sensor axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Group {
    /// What an accelerometer feels: +g upwards at rest, m/s².
    pub specific_force_m_s2: [f64; 3],
    /// rad/s.
    pub angular_velocity_rad_s: [f64; 3],
    /// Roll about x, pitch about y, yaw about z, rad.
    pub angles_rad: [f64; 3],
    /// Of norm 1 within 0.02, in the order of the wire.
    pub quaternion: [f64; 4],
}

impl Group {
    /// Reads a group's words; `None` where the quaternion is none.
    pub fn of([acceleration, angular_velocity, angle, quaternion]: [[i16; 4]; 4]) -> Option<Self> {
        let scaled =
            |[x, y, z, _]: [i16; 4], full: f64| [x, y, z].map(|word| f64::from(word) * (full / FULL_WORD));
        let quaternion = quaternion.map(|word| f64::from(word) / FULL_WORD);
        let norm = quaternion.iter().map(|value| value * value).sum::<f64>().sqrt();
        (1.0 - NORM..=1.0 + NORM).contains(&norm).then(|| Self {
            specific_force_m_s2: scaled(acceleration, 16.0 * GRAVITY_M_S2),
            angular_velocity_rad_s: scaled(angular_velocity, 2000_f64.to_radians()),
            angles_rad: scaled(angle, std::f64::consts::PI),
            quaternion,
        })
    }

    /// Appends it as it travels; what is beyond full scale stands at its end. The fourth words are 0.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let word = |value: f64| (value * FULL_WORD).round() as i16;
        let words = |[x, y, z]: [f64; 3], full: f64| [word(x / full), word(y / full), word(z / full), 0];
        frame(kind::ACCELERATION, words(self.specific_force_m_s2, 16.0 * GRAVITY_M_S2), out);
        frame(kind::ANGULAR_VELOCITY, words(self.angular_velocity_rad_s, 2000_f64.to_radians()), out);
        frame(kind::ANGLE, words(self.angles_rad, std::f64::consts::PI), out);
        frame(kind::QUATERNION, self.quaternion.map(word), out);
    }
}

/// What the stream of a sensor holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece {
    /// A measurement.
    Group {
        /// Place in the stream of its first byte: bytes pushed before it.
        offset: u64,
        /// What it says.
        group: Group,
    },
    /// Registers that were asked for, or what stands for them.
    Registers([u16; 4]),
}

/// Cuts a stream of bytes into groups and answers. What comes out does not depend on how the bytes were cut.
pub type Splitter = Cutter<Groups>;

/// Whole groups only: frames of one measurement follow on each other, and what is missing or too much between them shows.
#[derive(Clone, Copy, Debug, Default, Plain)]
pub struct Groups;

impl Splitter {
    /// A splitter before the first byte.
    pub fn new() -> Self {
        Self::of(Groups)
    }
}

impl Default for Splitter {
    fn default() -> Self {
        Self::new()
    }
}

impl Grammar for Groups {
    type Message = Piece;

    fn front(&mut self, offset: u64, bytes: &[u8], _: bool) -> Front<Piece> {
        if bytes[0] != START {
            return Front::No;
        }
        if bytes.get(1) == Some(&kind::REGISTERS) {
            return match parse(bytes) {
                Some((_, words)) => Front::Message(FRAME, Piece::Registers(words.map(|word| word as u16))),
                None if bytes.len() < FRAME => Front::Wait,
                None => Front::No,
            };
        }
        let mut group = [[0; 4]; 4];
        for (k, (kind, words)) in GROUP.into_iter().zip(&mut group).enumerate() {
            let at = k * FRAME;
            match bytes.get(at..).unwrap_or_default() {
                [] | [START] => return Front::Wait,
                [START, found, ..] if *found == kind => {}
                _ => return Front::No,
            }
            match parse(&bytes[at..]) {
                Some((_, found)) => *words = found,
                None if bytes.len() < at + FRAME => return Front::Wait,
                None => return Front::No,
            }
        }
        match Group::of(group) {
            Some(group) => Front::Message(GROUP_LEN, Piece::Group { offset, group }),
            None => Front::No,
        }
    }
}
