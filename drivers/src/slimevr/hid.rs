//! Reports of a SlimeVR receiver ("dongle"), both ways: packets of trackers that came by radio.
//!
//! What comes in: a report as the system gives it, without an identifier in front: packets of 16 bytes, four in a whole one. What goes
//! out: who is where, orientations, accelerations, battery and radio. USB and radio have checksums of their own, and the receiver
//! gives none on; nothing can be sent to it.

use std::net::{Ipv4Addr, SocketAddr};

use crate::flock::wire::rotation;

/// Whose reports stand in the envelopes of a datagram ([`crate::datagram`]): an address that no tracker on a network has.
pub const RECEIVER: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::UNSPECIFIED), 0);
/// Bytes of a packet, and of a whole report.
pub const PACKET: usize = 16;
/// Bytes of a whole report.
pub const REPORT: usize = 64;
/// Packets that name the tracker behind a number.
pub const REGISTRATION: u8 = 255;
/// How far from 1 the norm of a quaternion of 16-bit words may be.
const NORM: f64 = 0.05;
/// Steps of an acceleration per m/s².
const ACCELERATION_STEPS: f64 = 128.0;
/// Milliseconds of "switching off now" in the place of the time until a tracker sleeps.
const NOW: u16 = 1;

/// One packet: a tracker by its number at the receiver, and what it says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packet {
    /// Number of the tracker, a slot of the receiver.
    pub id: u8,
    /// What it says.
    pub contents: Contents,
}

/// What a packet says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contents {
    /// The number is that of this tracker, by its address; whether it is switched on is not said.
    Registration([u8; 6]),
    /// Device info.
    Info {
        /// Battery.
        battery: Battery,
        /// Version of the firmware.
        firmware: [u8; 3],
        /// Strength of the radio signal, dBm; 0 of a tracker on USB.
        signal_dbm: f64,
    },
    /// A measurement.
    Motion {
        /// Tracker to a frame z up of any heading, unit quaternion.
        orientation_wxyz: [f64; 4],
        /// Without gravity, in the tracker's axes, m/s²; absent beside a magnetic field.
        acceleration_m_s2: Option<[f64; 3]>,
        /// What a reduced packet has beside it.
        battery: Option<Battery>,
        /// Button and sleep, where a reduced packet has these.
        button: Option<Button>,
        /// Strength of the radio signal, dBm.
        signal_dbm: Option<f64>,
    },
    /// How the tracker is: 1 is well, 3 an error.
    Status {
        /// As the server of SlimeVR numbers it.
        code: u8,
        /// Strength of the radio signal, dBm.
        signal_dbm: f64,
    },
    /// The button, and when it will sleep.
    Button(Button),
    /// Time that the battery will last, and kinds that are not known.
    Other(u8),
}

/// Charge of a battery.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Battery {
    /// Share of a full charge; absent without a battery.
    pub level: Option<f64>,
    /// V.
    pub volts: Option<f64>,
}

/// What somebody does with the tracker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Button {
    /// 0 not pressed, 1 once, 2 twice; repeated for a second.
    pub presses: u8,
    /// It switches itself off now.
    pub switches_off: bool,
}

/// The packets of a report, in their order, `Err` where a rotation is none; `None` where the report is no whole number of packets, or
/// longer than any. A packet that is the same as the one before counts once: older receivers fill with copies.
pub fn packets(report: &[u8]) -> Option<impl Iterator<Item = Result<Packet, Impossible>>> {
    let (packets, rest) = report.as_chunks::<PACKET>();
    if packets.is_empty() || !rest.is_empty() || report.len() > REPORT {
        return None;
    }
    let is_copy = move |k: usize| k > 0 && packets[k - 1] == packets[k];
    let once = packets.iter().enumerate().filter(move |(k, _)| !is_copy(*k));
    Some(once.map(|(_, packet)| parse(packet)))
}

/// A packet that cannot be: its rotation is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Impossible;

fn parse(packet: &[u8; PACKET]) -> Result<Packet, Impossible> {
    let word = |at: usize| i16::from_le_bytes([packet[at], packet[at + 1]]);
    let vector = |at: usize, steps: f64| [0, 2, 4].map(|k| f64::from(word(at + k)) / steps);
    let signal_dbm = -f64::from(packet[15]);
    let motion = |orientation_wxyz, acceleration_m_s2| Contents::Motion {
        orientation_wxyz,
        acceleration_m_s2,
        battery: None,
        button: None,
        signal_dbm: None,
    };
    let full = || {
        let [x, y, z, w] = [2, 4, 6, 8].map(|at| f64::from(word(at)) / 32_768.0);
        let q = [w, x, y, z];
        let is_rotation = (rotation::norm(q) - 1.0).abs() <= NORM;
        if is_rotation { Ok(rotation::normalised(q)) } else { Err(Impossible) }
    };
    let reduced = |battery, button| Contents::Motion {
        orientation_wxyz: unpack(u32::from_le_bytes([packet[5], packet[6], packet[7], packet[8]])),
        acceleration_m_s2: Some(vector(9, ACCELERATION_STEPS)),
        battery,
        button,
        signal_dbm: Some(signal_dbm),
    };
    let button =
        || Button { presses: packet[2] & 3, switches_off: u16::from_le_bytes([packet[3], packet[4]]) == NOW };
    let contents = match packet[0] {
        0 => Contents::Info {
            battery: battery(packet[2], packet[3]),
            firmware: [packet[12], packet[13], packet[14]],
            signal_dbm,
        },
        1 => motion(full()?, Some(vector(10, ACCELERATION_STEPS))),
        2 => reduced(Some(battery(packet[2], packet[3])), None),
        3 => Contents::Status { code: packet[2], signal_dbm },
        // The field beside it is in gauss, and not used.
        4 => motion(full()?, None),
        6 => Contents::Button(button()),
        7 => reduced(None, Some(button())),
        REGISTRATION => {
            let address = [7, 6, 5, 4, 3, 2].map(|at| packet[at]);
            Contents::Registration(address)
        }
        other => Contents::Other(other),
    };
    Ok(Packet { id: packet[1], contents })
}

fn battery(share: u8, volts: u8) -> Battery {
    let is_there = share & 0x80 != 0;
    Battery {
        level: is_there.then(|| (f64::from(share & 0x7F) / 100.0).min(1.0)),
        volts: (is_there && volts != 0).then(|| (f64::from(volts) + 245.0) / 100.0),
    }
}

/// The rotation in 32 bits: 10 of x, 11 each of y and z, of a vector along the axis, the scalar part not negative. A word stands for the
/// middle of its step.
fn unpack(packed: u32) -> [f64; 4] {
    let part = |shift: u32, bits: u32| {
        let n = packed >> shift & ((1 << bits) - 1);
        2.0 * (f64::from(n) + 0.5) / f64::from(1_u32 << bits) - 1.0
    };
    let v = [part(0, 10), part(10, 11), part(21, 11)];
    let d = v.iter().map(|value| value * value).sum::<f64>();
    let i = 1.0 / (d + 1e-6).sqrt();
    let (sin, cos) = libm::sincos(std::f64::consts::FRAC_PI_2 * d * i);
    rotation::normalised([cos, sin * i * v[0], sin * i * v[1], sin * i * v[2]])
}

/// The packet that names a tracker.
pub fn registration(id: u8, mac: [u8; 6]) -> [u8; PACKET] {
    let mut packet = [0; PACKET];
    packet[..2].copy_from_slice(&[REGISTRATION, id]);
    for (to, from) in packet[2..8].iter_mut().zip(mac.iter().rev()) {
        *to = *from;
    }
    packet
}

/// A full measurement as it travels.
pub fn full(id: u8, [w, x, y, z]: [f64; 4], acceleration_m_s2: [f64; 3]) -> [u8; PACKET] {
    let mut packet = [0; PACKET];
    packet[..2].copy_from_slice(&[1, id]);
    let words = [x, y, z, w].map(|value| (value * 32_768.0).round() as i16);
    let accelerations = acceleration_m_s2.map(|value| (value * ACCELERATION_STEPS).round() as i16);
    for (k, word) in words.into_iter().chain(accelerations).enumerate() {
        packet[2 + 2 * k..4 + 2 * k].copy_from_slice(&word.to_le_bytes());
    }
    packet
}

/// A reduced measurement as it travels, with the battery's bytes and the signal.
pub fn reduced(
    id: u8,
    q: [f64; 4],
    acceleration_m_s2: [f64; 3],
    [share, volts]: [u8; 2],
    signal: u8,
) -> [u8; PACKET] {
    let mut packet = [0; PACKET];
    packet[..5].copy_from_slice(&[2, id, share, volts, 0]);
    packet[5..9].copy_from_slice(&pack(q).to_le_bytes());
    for (k, value) in acceleration_m_s2.into_iter().enumerate() {
        let word = (value * ACCELERATION_STEPS).round() as i16;
        packet[9 + 2 * k..11 + 2 * k].copy_from_slice(&word.to_le_bytes());
    }
    packet[15] = signal;
    packet
}

/// A word about the device as it travels: battery's bytes, firmware, signal.
pub fn info(id: u8, [share, volts]: [u8; 2], [major, minor, patch]: [u8; 3], signal: u8) -> [u8; PACKET] {
    let mut packet = [0; PACKET];
    packet[..4].copy_from_slice(&[0, id, share, volts]);
    packet[12..].copy_from_slice(&[major, minor, patch, signal]);
    packet
}

/// Status as it travels.
pub fn status(id: u8, code: u8, signal: u8) -> [u8; PACKET] {
    let mut packet = [0; PACKET];
    packet[..3].copy_from_slice(&[3, id, code]);
    packet[15] = signal;
    packet
}

/// Button and time until sleep, ms, as they travel.
pub fn button(id: u8, presses: u8, sleep_ms: u16) -> [u8; PACKET] {
    let mut packet = [0; PACKET];
    packet[..3].copy_from_slice(&[6, id, presses]);
    packet[3..5].copy_from_slice(&sleep_ms.to_le_bytes());
    packet
}

fn pack(q: [f64; 4]) -> u32 {
    let [w, x, y, z] = if q[0] < 0.0 { q.map(|value| -value) } else { q };
    let sin = (x * x + y * y + z * z).sqrt();
    let scale = if sin > 0.0 { libm::atan2(sin, w) / std::f64::consts::FRAC_PI_2 / sin } else { 0.0 };
    let part = |value: f64, bits: u32| {
        let steps = f64::from(1_u32 << bits);
        (steps * (value * scale + 1.0) / 2.0).floor().clamp(0.0, steps - 1.0) as u32
    };
    part(x, 10) | part(y, 11) << 10 | part(z, 11) << 21
}
