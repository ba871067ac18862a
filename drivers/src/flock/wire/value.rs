//! Parameters of EXAMINE and CHANGE VALUE, status words, error codes, rates.
//!
//! These travel as plain 8-bit bytes, 16-bit words least significant byte first.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::super::family::Family;
use super::{Addressing, Format, Range};
use crate::rate::{ImpossibleRate, Rate};

/// Parameter numbers that the driver uses; lengths and write access: [`PARAMETERS`].
pub mod parameter {
    #![expect(missing_docs, reason = "the names are those of the table below")]
    pub const BIRD_STATUS: u8 = 0x00;
    pub const SOFTWARE_REVISION: u8 = 0x01;
    pub const CRYSTAL_SPEED: u8 = 0x02;
    pub const POSITION_SCALING: u8 = 0x03;
    pub const FILTER_STATUS: u8 = 0x04;
    pub const RATE_COUNT: u8 = 0x06;
    pub const MEASUREMENT_RATE: u8 = 0x07;
    pub const ERROR_CODE: u8 = 0x0A;
    pub const SUDDEN_OUTPUT_CHANGE: u8 = 0x0E;
    pub const MODEL_ID: u8 = 0x0F;
    pub const EXPANDED_ERROR_CODE: u8 = 0x10;
    pub const FBB_ADDRESSING_MODE: u8 = 0x13;
    pub const FBB_ADDRESS: u8 = 0x15;
    pub const HEMISPHERE: u8 = 0x16;
    pub const SENSOR_SERIAL: u8 = 0x1A;
    pub const REPORT_RATE: u8 = 0x1D;
    pub const GROUP_MODE: u8 = 0x23;
    pub const FLOCK_SYSTEM_STATUS: u8 = 0x24;
    pub const FBB_AUTO_CONFIG: u8 = 0x32;
}

/// One parameter of EXAMINE and CHANGE VALUE. A unit whose firmware is too old for it does not answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Its number.
    pub number: u8,
    /// Its name in the vendor's words.
    pub name: &'static str,
    /// Bytes of the answer in normal, expanded, super-expanded addressing.
    read: [u8; 3],
    /// Bytes of data after CHANGE VALUE; none where it is read-only.
    write: Option<[u8; 3]>,
}

impl Parameter {
    /// Bytes that EXAMINE VALUE answers, without head or checksum.
    pub const fn read_len(&self, addressing: Addressing) -> usize {
        self.read[addressing as usize] as usize
    }

    /// Bytes of data that CHANGE VALUE takes; `None` where the parameter is read-only.
    pub fn write_len(&self, addressing: Addressing) -> Option<usize> {
        self.write.map(|len| usize::from(len[addressing as usize]))
    }

    /// Whether CHANGE VALUE is allowed.
    pub const fn writable(&self) -> bool {
        self.write.is_some()
    }
}

const fn read_only(number: u8, name: &'static str, len: u8) -> Parameter {
    Parameter { number, name, read: [len; 3], write: None }
}

const fn read_write(number: u8, name: &'static str, len: u8) -> Parameter {
    Parameter { number, name, read: [len; 3], write: Some([len; 3]) }
}

/// All parameters, by rising number.
pub const PARAMETERS: [Parameter; 36] = [
    read_only(0x00, "BIRD STATUS", 2),
    read_only(0x01, "SOFTWARE REVISION", 2),
    read_only(0x02, "CRYSTAL SPEED", 2),
    read_write(0x03, "POSITION SCALING", 2),
    read_write(0x04, "FILTER STATUS", 2),
    read_write(0x05, "ALPHA_MIN TABLE", 14),
    read_write(0x06, "RATE COUNT", 2),
    read_write(0x07, "MEASUREMENT RATE", 2),
    read_write(0x08, "DATA READY OUTPUT", 1),
    read_write(0x09, "DATA READY CHARACTER", 1),
    read_only(0x0A, "ERROR CODE", 1),
    read_write(0x0B, "ERROR MASK", 1),
    read_write(0x0C, "VM TABLE", 14),
    read_write(0x0D, "ALPHA_MAX TABLE", 14),
    read_write(0x0E, "SUDDEN OUTPUT CHANGE LOCK", 1),
    read_only(0x0F, "MODEL ID", 10),
    read_only(0x10, "EXPANDED ERROR CODE", 2),
    read_write(0x11, "XYZ REFERENCE FRAME", 1),
    read_write(0x12, "TRANSMITTER MODE", 1),
    read_only(0x13, "FBB ADDRESSING MODE", 1),
    read_write(0x14, "LINE FREQUENCY", 1),
    read_only(0x15, "FBB ADDRESS", 1),
    read_write(0x16, "HEMISPHERE", 2),
    read_write(0x17, "ANGLE ALIGN 2", 6),
    read_write(0x18, "REFERENCE FRAME 2", 6),
    read_only(0x19, "BIRD SERIAL NUMBER", 2),
    read_only(0x1A, "SENSOR SERIAL NUMBER", 2),
    read_only(0x1B, "TRANSMITTER SERIAL NUMBER", 2),
    read_write(0x1C, "METAL DETECTION", 10),
    read_write(0x1D, "REPORT RATE", 1),
    read_write(0x20, "FBB HOST DELAY", 2),
    Parameter { number: 0x21, name: "FBB CONFIGURATION", read: [5, 7, 7], write: Some([5, 7, 7]) },
    Parameter { number: 0x22, name: "FBB ARM", read: [14, 30, 30], write: Some([14, 30, 30]) },
    read_write(0x23, "GROUP MODE", 1),
    Parameter { number: 0x24, name: "FLOCK SYSTEM STATUS", read: [14, 30, 126], write: None },
    // Writing takes the number of units; reading gives bit maps.
    Parameter { number: 0x32, name: "FBB AUTO-CONFIGURATION", read: [5, 7, 19], write: Some([1; 3]) },
];

/// The parameter of this number; `None` where none is known.
pub fn parameter(number: u8) -> Option<&'static Parameter> {
    PARAMETERS.iter().find(|parameter| parameter.number == number)
}

/// The BIRD STATUS word, parameter 0: what the unit on the line does. Bits: the constants; bits 4 to 1: [`Self::format`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[serde(transparent)]
pub struct BirdStatus(pub u16);

impl BirdStatus {
    /// The unit is the master of its flock, or alone.
    pub const MASTER: u16 = 1 << 15;
    /// Auto-configured, or stand-alone.
    pub const INITIALISED: u16 = 1 << 14;
    /// An error waits to be read.
    pub const ERROR: u16 = 1 << 13;
    /// Measuring.
    pub const RUNNING: u16 = 1 << 12;
    /// Synchronised by the host.
    pub const HOST_SYNC: u16 = 1 << 11;
    /// Expanded addressing (revision 3.33 and later).
    pub const EXPANDED: u16 = 1 << 10;
    /// Synchronised to a screen.
    pub const CRT_SYNC: u16 = 1 << 9;
    /// No synchronisation.
    pub const NO_SYNC: u16 = 1 << 8;
    /// Factory test commands are on.
    pub const FACTORY_TEST: u16 = 1 << 7;
    /// Stopped by XOFF.
    pub const XOFF: u16 = 1 << 6;
    /// Asleep.
    pub const ASLEEP: u16 = 1 << 5;
    /// Streaming.
    pub const STREAMING: u16 = 1 << 0;

    /// Reads the answer of EXAMINE VALUE, least significant byte first.
    pub const fn from_bytes(bytes: [u8; 2]) -> Self {
        Self(u16::from_le_bytes(bytes))
    }

    /// Whether all bits of `mask` are set.
    pub const fn has(self, mask: u16) -> bool {
        self.0 & mask == mask
    }

    /// The record format, where bits 4 to 1 name one; `None`: factory data, or nothing that is known.
    pub fn format(self) -> Option<Format> {
        Format::from_status_code(((self.0 >> 1) & 0x0F) as u8)
    }

    /// The same status with another format.
    pub const fn with_format(self, format: Format) -> Self {
        Self((self.0 & !0x1E) | ((format.status_code() as u16) << 1))
    }
}

/// One unit's byte of the FLOCK SYSTEM STATUS, parameter 36; byte k of the answer is that of address k + 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[serde(transparent)]
pub struct UnitStatus(pub u8);

impl UnitStatus {
    /// There, and its switch is on FLY.
    pub const ACCESSIBLE: u8 = 1 << 7;
    /// Running.
    pub const RUNNING: u8 = 1 << 6;
    /// Has a sensor.
    pub const SENSOR: u8 = 1 << 5;
    /// Is an extended range controller.
    pub const EXTENDED_RANGE: u8 = 1 << 4;
    /// Transmitters 3 to 0, in the low four bits.
    pub const TRANSMITTERS: u8 = 0x0F;

    /// Whether all bits of `mask` are set.
    pub const fn has(self, mask: u8) -> bool {
        self.0 & mask == mask
    }

    /// Lowest number (0 to 3) of a transmitter at this unit; `None` where it has none.
    pub const fn transmitter(self) -> Option<u8> {
        match (self.0 & Self::TRANSMITTERS).trailing_zeros() {
            n @ 0..=3 => Some(n as u8),
            _ => None,
        }
    }
}

/// What a unit does on an error, by the vendor's table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorClass {
    /// It stops and blinks the code for ever.
    Fatal,
    /// It blinks once and goes on.
    Warning,
    /// It only notes the code.
    Noted,
}

/// An error code in words and its class; parameters 10 and 16. Codes above 35 are unknown, and [`ErrorClass::Noted`].
pub fn error(code: u8) -> (&'static str, ErrorClass) {
    use ErrorClass::{Fatal, Noted, Warning};
    match code {
        0 => ("no error", Noted),
        1 => ("RAM failure", Fatal),
        2 => ("non-volatile memory could not be written", Fatal),
        3 => ("the board's configuration is corrupt", Warning),
        4 => ("transmitter calibration corrupt, or no transmitter connected", Warning),
        5 => ("sensor calibration corrupt, or no sensor connected", Warning),
        6 => ("invalid RS-232 command", Noted),
        7 => ("the unit is not the master of the flock", Noted),
        8 => ("no birds accessible; check the FLY switches and the bus cable", Noted),
        9 => ("the bird is not initialised", Noted),
        10 => ("receive error on the bus between the birds", Warning),
        11 => ("RS-232 overrun or framing error; check the baud switches", Warning),
        12 => ("receive error on the host bus", Warning),
        13 => ("a bird does not answer on the bus; check its power, cable and FLY switch", Warning),
        14 => ("invalid command on the host bus", Warning),
        15 => ("run time error on the bus", Fatal),
        16 => ("invalid CPU speed", Fatal),
        17 => ("a slave gets no data from the bus", Warning),
        18 => ("illegal baud rate; check the switches", Warning),
        19 => ("a slave does not acknowledge", Warning),
        20..=27 => ("processor fault", Fatal),
        28 => ("CRT synchronisation lost", Warning),
        29 => ("transmitter not accessible", Warning),
        30 => ("extended range transmitter not attached", Warning),
        31 => ("the processor ran out of time", Noted),
        32 => ("sensor saturated: too near to the transmitter", Warning),
        33 => ("slave configuration", Warning),
        34 => ("watchdog", Warning),
        35 => ("over temperature", Warning),
        _ => ("unknown error code", Noted),
    }
}

/// Measurement rates that a Flock can have, Hz. The maker states 14 to 144 Hz; crystals and firmware differ by less than what is
/// left to either side, and damage that lands inside harms no more than another setting would.
pub const RATES_HZ: std::ops::RangeInclusive<f64> = 10.0..=200.0;

/// The measurement rate that a unit answers (parameter 7, two bytes), if a unit of the family can have it.
///
/// # Errors
/// It is not one of [`Family::rates_hz`]. A break on the line makes two zero bytes.
pub fn claimed_rate(answer: [u8; 2], family: Family) -> Result<Rate, ImpossibleRate> {
    Rate::claimed(rate_hz(u16::from_le_bytes(answer)), &family.rates_hz())
}

/// Measurement rate in Hz of parameter 7's word, as it stands: 1/256 Hz per step. What a unit claims is for [`claimed_rate`].
pub fn rate_hz(word: u16) -> f64 {
    f64::from(word) / 256.0
}

/// Parameter 7's word of a rate in Hz (103.3 Hz is `4D 67` on the wire), rounded to 1/256 Hz, at most 255.996 Hz.
pub fn rate_word(rate_hz: f64) -> u16 {
    (rate_hz * 256.0).clamp(0.0, 65535.0).round() as u16
}

/// Measurement rate in Hz of parameter 6's count at this crystal (MHz); a speed of 0 reads as 20 MHz.
pub fn rate_of_count_hz(count: u16, crystal_mhz: u8) -> f64 {
    1000.0 / (4.0 * f64::from(count) * clock_us(crystal_mhz) / 1000.0 + 0.3)
}

/// Parameter 6's count for a rate in Hz at this crystal (MHz, 0 as 20); held within 16 bits, rounded to the nearest.
pub fn count_of_rate(rate_hz: f64, crystal_mhz: u8) -> u16 {
    let settle_ms = (1000.0 / rate_hz - 0.3) / 4.0;
    (settle_ms * 1000.0 / clock_us(crystal_mhz)).clamp(0.0, 65535.0).round() as u16
}

fn clock_us(crystal_mhz: u8) -> f64 {
    8.0 / f64::from(if crystal_mhz == 0 { 20 } else { crystal_mhz })
}

/// Parameter 3's value for a range; `None` for extended range, which ignores it.
pub const fn scaling_word(range: Range) -> Option<u16> {
    match range {
        Range::In36 => Some(0),
        Range::In72 => Some(1),
        Range::In144 => None,
    }
}

/// Whether a coordinate of a position, m, is at the end of words that have so many steps to a full scale of `range_m`, m.
pub fn is_clipped(position_m: Option<[f64; 3]>, range_m: f64, steps: f64) -> bool {
    // The last step is the end; half of one is for what was rounded.
    let end_m = range_m * (1.0 - 1.5 / steps);
    position_m.is_some_and(|position_m| position_m.iter().any(|at_m| at_m.abs() >= end_m))
}
