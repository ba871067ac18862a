//! Message identifiers, and the contents of the messages that are not data.
//!
//! A reply carries the identifier of its request plus one and the bus identifier of the request. A
//! request without data asks, one with data sets.

use super::frame::Frame;
use super::mtdata::Layout;
use super::number::be16;
use crate::rate::{ImpossibleRate, Rate};

/// Bus identifier of the master, or of a stand-alone device.
pub const MASTER: u8 = 0xFF;

/// Asks for the device identifier (reply: 4 or 8 bytes).
pub const REQ_DEVICE_ID: u8 = 0x00;
/// Makes an Xbus Master find its trackers (reply: 4 bytes per tracker, in the order of the bus).
pub const INIT_BUS: u8 = 0x02;
/// Sampling period, 2 bytes, in ticks of 1/115200 s.
pub const PERIOD: u8 = 0x04;
/// Asks for the [`Configuration`].
pub const REQ_CONFIGURATION: u8 = 0x0C;
/// The answer; also sent by a device that begins to measure by itself.
pub const CONFIGURATION: u8 = 0x0D;
/// Begins to measure.
pub const GOTO_MEASUREMENT: u8 = 0x10;
/// Asks for the firmware revision (reply: major, minor, revision, one byte each; newer devices add 8 bytes).
pub const REQ_FIRMWARE: u8 = 0x12;
/// Stops measuring: settings can be read and written now.
pub const GOTO_CONFIG: u8 = 0x30;
/// Data message of older devices and of an Xbus Master, see [`super::mtdata`].
pub const MTDATA: u8 = 0x32;
/// Data message of newer devices, see [`super::mtdata2`].
pub const MTDATA2: u8 = 0x36;
/// The device has started; it waits half a second for [`WAKE_UP_ACK`].
pub const WAKE_UP: u8 = 0x3E;
/// Keeps a starting device from measuring by itself.
pub const WAKE_UP_ACK: u8 = 0x3F;
/// Starts the device anew.
pub const RESET: u8 = 0x40;
/// An error: code (see [`error_words`]), and the bus identifier at fault where there is one.
pub const ERROR: u8 = 0x42;
/// A warning of a device with a satellite receiver.
pub const WARNING: u8 = 0x43;
/// What newer devices send, and how often: see [`output_configuration`].
pub const OUTPUT_CONFIGURATION: u8 = 0xC0;
/// What older devices send, 2 bytes: [`Layout::mode`].
pub const OUTPUT_MODE: u8 = 0xD0;
/// How older devices send it, 4 bytes: [`Layout::settings`].
pub const OUTPUT_SETTINGS: u8 = 0xD2;

/// Ticks of a period per second: a rate in Hz is this by the period.
pub const PERIOD_TICKS_PER_S: f64 = 115_200.0;

/// Rates of data messages that a device can have, Hz: 2000 is the most that any of them sends inertial data with, and the
/// longest period with a skip factor of 1 is 0.9.
pub const RATES_HZ: std::ops::RangeInclusive<f64> = 0.8..=2000.0;

/// Whether a message of this name may have `len` bytes of data; false for unknown names. Contents are not looked at.
pub fn fits(mid: u8, len: usize) -> bool {
    match mid {
        0x00 | 0x02 | 0x07 | 0x09 | 0x0A | 0x0C | 0x10..=0x12 | 0x1C | 0x30 | 0x31 | 0x34 | 0x3E | 0x3F => {
            len == 0
        }
        0x40 | 0x41 | 0x44 | 0x88 | 0xA5 => len == 0,
        0x01 => len == 4 || len == 8,
        0x03 => len > 0 && len <= 80 && len.is_multiple_of(4),
        0x04 | 0x05 | 0x08 | 0x82 | 0x83 | 0xD0 | 0xD1 | 0xD4 | 0xD5 | 0xDA..=0xDD => len == 0 || len == 2,
        0x06 => len == 5,
        0x0B | 0xA4 => len == 2,
        0x0D => len >= 118 && (len % 20 == 18 || len % 20 == 2),
        0x13 => len == 3 || len == 11,
        0x18 | 0x19 => len <= 1,
        0x1D => (1..=24).contains(&len),
        0x2C | 0x2D => len.is_multiple_of(12) && len <= 144,
        0x32 => len >= 2,
        0x36 => len >= 3,
        0x42 => (1..=16).contains(&len),
        0x43 => (4..=254).contains(&len),
        0x89 => len == 1,
        0x91 => len > 0,
        0xC0 | 0xC1 => len.is_multiple_of(4) && len <= 128,
        0xD2 | 0xD3 => len == 0 || len == 4,
        0xD6..=0xD9 => (1..=5).contains(&len),
        0xE0 | 0xE1 => len == 0 || len == 36,
        _ => false,
    }
}

/// A request as it travels, from host to device; `bid` is [`MASTER`], or that of a tracker on the bus.
///
/// # Panics
/// With more than [`super::frame::MAX_DATA`] bytes of data.
pub fn request(bid: u8, mid: u8, data: &[u8]) -> Vec<u8> {
    Frame { bid, mid, data }.encode()
}

/// What kind of device an identifier belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceKind {
    /// MT9.
    Mt9,
    /// Xbus Master: a chain.
    XbusMaster,
    /// MTi or MTx.
    Mt,
    /// MTi-G.
    MtiG,
    /// Any other, such as the newer MTi.
    Other,
}

impl DeviceKind {
    /// The kind identified by the type digit (bits 23 to 20) of a device identifier.
    pub const fn of(device_id: u64) -> Self {
        match (device_id & 0x00F0_0000) >> 20 {
            0 => Self::Mt9,
            1 => Self::XbusMaster,
            3 => Self::Mt,
            5 => Self::MtiG,
            _ => Self::Other,
        }
    }
}

/// A device identifier as it is printed on the device: eight hexadecimal digits (sixteen for long ones).
pub fn device_id_text(id: u64) -> String {
    if id <= u64::from(u32::MAX) { format!("{id:08X}") } else { format!("{id:016X}") }
}

/// Reads a device identifier of 4 or 8 bytes, big-endian; `None` for another length.
pub fn device_id(data: &[u8]) -> Option<u64> {
    match data.len() {
        4 => data.first_chunk().map(|&bytes| u64::from(u32::from_be_bytes(bytes))),
        8 => data.first_chunk().map(|&bytes| u64::from_be_bytes(bytes)),
        _ => None,
    }
}

/// One tracker of a [`Configuration`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tracker {
    /// Device identifier.
    pub device_id: u32,
    /// Bytes of its block in a data message, as the device reports. Decoding goes by [`Layout::block_len`] instead.
    pub data_len: u16,
    /// What the block holds; not checked, see [`Layout::check`].
    pub layout: Layout,
}

/// What the master and its trackers are set to (message 0x0D).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Configuration {
    /// Device identifier of the master; of the tracker itself where it stands alone.
    pub master_id: u64,
    /// Sampling period, in ticks of 1/115200 s; 0 counts as 1.
    pub period_ticks: u16,
    /// Periods left out after each message.
    pub skip_factor: u16,
    /// Trackers, in the order of their bus identifiers 1, 2, ...; a stand-alone device lists itself.
    pub trackers: Vec<Tracker>,
}

impl Configuration {
    /// Reads the data of a configuration message, of 118 bytes or more; `None` when its length does not fit its contents.
    ///
    /// Devices of the 600 series have a master identifier of 8 bytes, others of 4: the length tells which.
    pub fn parse(data: &[u8]) -> Option<Self> {
        // The MTi-600 series has a master identifier of 8 bytes, and all the rest 4 bytes later.
        let shift = match data.len() % 20 {
            18 => 0,
            2 => 4,
            _ => return None,
        };
        let master_id = device_id(data.get(..4 + shift)?)?;
        let rest = data.get(4 + shift..)?;
        let count = usize::from(be16(rest, 92)?);
        let trackers = rest.get(94..)?;
        if trackers.len() != 20 * count {
            return None;
        }
        let trackers = trackers
            .chunks_exact(20)
            .map(|tracker| {
                Some(Tracker {
                    device_id: u32::from_be_bytes(*tracker.first_chunk()?),
                    data_len: be16(tracker, 4)?,
                    layout: Layout {
                        mode: be16(tracker, 6)?,
                        settings: u32::from_be_bytes(*tracker.get(8..)?.first_chunk()?),
                    },
                })
            })
            .collect::<Option<_>>()?;
        Some(Self { master_id, period_ticks: be16(rest, 0)?, skip_factor: be16(rest, 2)?, trackers })
    }

    /// The data of a configuration message, big-endian; fields that [`Configuration`] does not have are zero.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        match u32::try_from(self.master_id) {
            Ok(id) => out.extend(id.to_be_bytes()),
            Err(_) => out.extend(self.master_id.to_be_bytes()),
        }
        out.extend(self.period_ticks.to_be_bytes());
        out.extend(self.skip_factor.to_be_bytes());
        out.resize(out.len() + 88, 0);
        out.extend((self.trackers.len() as u16).to_be_bytes());
        for tracker in &self.trackers {
            out.extend(tracker.device_id.to_be_bytes());
            out.extend(tracker.data_len.to_be_bytes());
            out.extend(tracker.layout.mode.to_be_bytes());
            out.extend(tracker.layout.settings.to_be_bytes());
            out.resize(out.len() + 8, 0);
        }
        out
    }

    /// Whether a chain of trackers stands behind a master: its identifier is that of an Xbus Master, or not that of the first
    /// tracker.
    pub fn is_chain(&self) -> bool {
        DeviceKind::of(self.master_id) == DeviceKind::XbusMaster
            || self.trackers.first().is_some_and(|first| u64::from(first.device_id) != self.master_id)
    }

    /// Data messages per second, by the period and the skip factor.
    ///
    /// # Errors
    /// It is not one of [`RATES_HZ`].
    pub fn rate(&self) -> Result<Rate, ImpossibleRate> {
        let periods = f64::from(self.skip_factor) + 1.0;
        Rate::claimed(PERIOD_TICKS_PER_S / f64::from(self.period_ticks.max(1)) / periods, &RATES_HZ)
    }
}

/// The pairs of identifier (see [`super::mtdata2::id`]) and rate in Hz of an output configuration, in order; 0xFFFF: with every
/// message. `None` where the length is no multiple of 4. The answer states what the device does, which need not be what was
/// asked.
pub fn output_configuration(data: &[u8]) -> Option<Vec<(u16, u16)>> {
    if !data.len().is_multiple_of(4) {
        return None;
    }
    data.chunks_exact(4).map(|pair| Some((be16(pair, 0)?, be16(pair, 2)?))).collect()
}

/// What an error code means, in words for the operator; a sentence that says so for unknown codes.
pub fn error_words(code: u8) -> &'static str {
    match code {
        0x01 => "no communication on the bus: check the cable between master and trackers",
        0x02 => "the bus has not been initialised",
        0x03 => "the sampling period is out of range",
        0x04 => "the message is invalid or not implemented",
        0x10 => "a tracker did not answer the bus scan",
        0x11 => "a tracker gave a wrong answer to the bus scan",
        0x12 => "some trackers stayed undetected after four bus scans: check their cables",
        0x14 | 0x15 => "a tracker did not accept its bus address",
        0x18 => "the period is too short to collect the data of all trackers: lower the rate",
        0x19 => "a tracker answered with something else",
        0x1A => "the data of all trackers do not fit one message: ask for fewer quantities",
        0x1B | 0x1C => "the timer overflowed while measuring",
        0x1D => "a tracker did not answer in time",
        0x1E => "the rate is too high for the amount of data: lower it or raise the baud rate",
        0x20 => "the baud rate is not allowed",
        0x21 => "a parameter is invalid",
        0x23 | 0x24 => "the device's transmit buffer is full: lower the rate or raise the baud rate",
        0x28 => "the device has a fault",
        0x29 => "more data than the baud rate allows: lower the rate or raise the baud rate",
        0x2A => "the device's sample buffer is full",
        0x2B..=0x35 => "a newer kind of device error",
        _ => "an error that is not documented",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_survives_the_wire() {
        let tracker = |device_id| Tracker {
            device_id,
            data_len: 52,
            layout: Layout { mode: 6, settings: 0x8000_0000 },
        };
        for master_id in [0x0010_0021, 0x1_0000_0002] {
            for count in 1..=20 {
                let configuration = Configuration {
                    master_id,
                    period_ticks: 1152,
                    skip_factor: 1,
                    trackers: (0..count).map(|k| tracker(0x0032_03E9 + k)).collect(),
                };
                let data = configuration.encode();
                assert!(fits(CONFIGURATION, data.len()));
                assert_eq!(Configuration::parse(&data), Some(configuration));
                assert_eq!(Configuration::parse(&data[1..]), None);
            }
        }
        assert_eq!(Configuration::parse(&[]), None);
    }

    #[test]
    fn a_chain_is_identified_by_its_master() {
        let lone = |master_id, device_id| Configuration {
            master_id,
            period_ticks: 2304,
            skip_factor: 0,
            trackers: vec![Tracker { device_id, data_len: 36, layout: Layout { mode: 2, settings: 0 } }],
        };
        assert!(lone(0x0010_0021, 0x0032_03E9).is_chain());
        assert!(!lone(0x0032_03E9, 0x0032_03E9).is_chain());
        assert_eq!(lone(1, 1).rate().map(Rate::hz), Ok(50.0));
    }
}
