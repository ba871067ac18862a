//! Commands of the host, written and read.
//!
//! The driver encodes them; the simulator and the reader of captured sessions parse them.

use posed_state::Plain;
use thiserror::Error;

use super::super::family::Family;
use super::value::parameter;
use super::{Addressing, Format, ReportRate};

/// One command, without its prefix. Words among its data are signed 16-bit numbers, least significant byte first; 32768 is one
/// (for sin and cos), 180 degrees (angles) or the full scale (positions).
#[derive(Clone, Debug, PartialEq, Eq, Plain)]
pub enum Command {
    /// One record, or one of each running bird in group mode. Ends STREAM.
    Point,
    /// Records until stopped.
    Stream,
    /// Ends STREAM (newer firmware).
    StreamStop,
    /// Stream every so many cycles.
    ReportRate(ReportRate),
    /// Start measuring.
    Run,
    /// Stop measuring.
    Sleep,
    /// Record format.
    Format(Format),
    /// Hemisphere: axis and sign byte as sent; see [`super::Hemisphere::from_bytes`].
    Hemisphere([u8; 2]),
    /// Reference frame of the transmitter: sin, cos of azimuth, elevation, roll, as words.
    ReferenceFrame1([i16; 6]),
    /// The same: azimuth, elevation, roll, as words; newer firmware.
    ReferenceFrame2([i16; 3]),
    /// Alignment of the sensor: sin, cos of azimuth, elevation, roll, as words.
    AngleAlign1([i16; 6]),
    /// The same: azimuth, elevation, roll, as words; newer firmware.
    AngleAlign2([i16; 3]),
    /// Offset of the position: x, y, z, as words; newer firmware.
    Offset([i16; 3]),
    /// Take the present orientation as zero.
    Boresight,
    /// Undo [`Command::Boresight`].
    RemoveBoresight,
    /// Metal detection: flag, value.
    Metal([u8; 2]),
    /// Asks for one byte: the error of metal detection.
    MetalError,
    /// Whether records carry a button byte.
    ButtonMode(bool),
    /// Asks for one byte: the buttons now.
    ButtonRead,
    /// Synchronisation mode; 255 asks for two words.
    Sync(u8),
    /// Address and number (0 to 3) of the transmitter to use; made by [`Command::next_transmitter`].
    NextTransmitter {
        /// Unit that it is plugged into, 0 to 15: the command has four bits for it, and others are cut to them.
        address: u8,
        /// Number at that unit.
        number: u8,
    },
    /// The master resets the slaves, which forget what they were set to.
    FbbReset,
    /// Asks for a parameter, by its number; see [`super::value::PARAMETERS`].
    Examine(u8),
    /// Sets a parameter.
    Change {
        /// Its number.
        parameter: u8,
        /// Its data, of the parameter's length; [`Command::encode`] does not check it.
        data: Vec<u8>,
    },
    /// Go on sending.
    Xon,
    /// Stop sending.
    Xoff,
    /// Turns on the factory's debug commands.
    FactoryTest,
    /// Asks for one byte of memory; a factory test command.
    ReadMemory {
        /// PROM rather than RAM.
        prom: bool,
        /// Address of the byte; least significant byte first on the wire.
        address: u16,
    },
    /// Asks for one address word (0x80 to 0x90); a factory test command.
    FactoryWord(u8),
}

impl Command {
    /// Chooses a transmitter by its unit's address and its number there; `None` where the four bits that each has do not hold
    /// it.
    pub fn next_transmitter(address: u8, number: u8) -> Option<Self> {
        (address <= 15 && number <= 15).then_some(Self::NextTransmitter { address, number })
    }

    /// Appends the bytes of the command, without prefix.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let words = |out: &mut Vec<u8>, words: &[i16]| out.extend(words.iter().flat_map(|w| w.to_le_bytes()));
        match *self {
            Self::Point => out.push(b'B'),
            Self::Stream => out.push(b'@'),
            Self::StreamStop => out.push(b'?'),
            Self::ReportRate(rate) => out.push(rate.command()),
            Self::Run => out.push(b'F'),
            Self::Sleep => out.push(b'G'),
            Self::Format(format) => out.push(format.command()),
            Self::Hemisphere([axis, sign]) => out.extend([b'L', axis, sign]),
            Self::ReferenceFrame1(ref w) => {
                out.push(b'H');
                words(out, w);
            }
            Self::ReferenceFrame2(ref w) => {
                out.push(b'r');
                words(out, w);
            }
            Self::AngleAlign1(ref w) => {
                out.push(b'J');
                words(out, w);
            }
            Self::AngleAlign2(ref w) => {
                out.push(b'q');
                words(out, w);
            }
            Self::Offset(ref w) => {
                out.push(b'K');
                words(out, w);
            }
            Self::Boresight => out.push(b'u'),
            Self::RemoveBoresight => out.push(b'v'),
            Self::Metal([flag, value]) => out.extend([b's', flag, value]),
            Self::MetalError => out.push(b't'),
            Self::ButtonMode(on) => out.extend([b'M', u8::from(on)]),
            Self::ButtonRead => out.push(b'N'),
            Self::Sync(mode) => out.extend([b'A', mode]),
            Self::NextTransmitter { address, number } => out.extend([b'0', (address << 4) | (number & 0x0F)]),
            Self::FbbReset => out.push(b'/'),
            Self::Examine(parameter) => out.extend([b'O', parameter]),
            Self::Change { parameter, ref data } => {
                out.extend([b'P', parameter]);
                out.extend(data);
            }
            Self::Xon => out.push(0x11),
            Self::Xoff => out.push(0x13),
            Self::FactoryTest => out.push(b'z'),
            Self::ReadMemory { prom, address } => {
                out.push(if prom { b'k' } else { b'd' });
                out.extend(address.to_le_bytes());
            }
            Self::FactoryWord(byte) => out.push(byte),
        }
    }

    /// The command's bytes behind the prefix of `to`; `None`: without a prefix, so it is the master's (the unit on the line).
    pub fn to_bytes(&self, to: Option<u8>, addressing: Addressing) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(8);
        if let Some(address) = to {
            addressing.prefix(address, &mut bytes);
        }
        self.encode(&mut bytes);
        bytes
    }

    /// Bytes that the unit answers, records apart; 0 for a command without an answer, and for an unknown parameter.
    pub fn answer_len(&self, addressing: Addressing) -> usize {
        match *self {
            Self::Examine(number) => parameter(number).map_or(0, |p| p.read_len(addressing)),
            Self::MetalError | Self::ButtonRead | Self::ReadMemory { .. } => 1,
            Self::FactoryWord(_) => 2,
            Self::Sync(255) => 4,
            _ => 0,
        }
    }
}

/// A command and the unit that it was for, as the bytes state it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Addressed {
    /// Address of the prefix; `None` = the unit on the line.
    pub to: Option<u8>,
    /// The command, without its prefix.
    pub command: Command,
}

/// Bytes that are no command; a unit answers them with error 6.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Refused {
    /// No command begins with this byte.
    #[error("0x{0:02X} begins no command")]
    UnknownCommand(u8),
    /// EXAMINE or CHANGE of a parameter that does not exist, or may not be changed.
    #[error("parameter {parameter} cannot be {}", if *.change { "changed" } else { "examined" })]
    Parameter {
        /// Its number.
        parameter: u8,
        /// CHANGE rather than EXAMINE.
        change: bool,
    },
}

/// Reads commands from a stream of bytes that may be cut anywhere.
#[derive(Clone, Debug, Default, Plain)]
pub struct CommandParser {
    /// Decides the lengths of a few parameters; the prefixes differ, and all of them are understood.
    pub addressing: Addressing,
    /// Decides the length of the position scaling.
    pub family: Family,
    to: Option<u8>,
    prefix_open: bool,
    /// Command byte and the data so far; empty between commands.
    open: Vec<u8>,
}

impl CommandParser {
    /// A parser before the first byte, for units with this addressing.
    pub fn new(addressing: Addressing) -> Self {
        Self { addressing, ..Self::default() }
    }

    /// Whether a prefix or a part of a command has been read.
    pub fn is_open(&self) -> bool {
        self.prefix_open || self.to.is_some() || !self.open.is_empty()
    }

    /// Forgets an unfinished command and its prefix.
    pub fn reset(&mut self) {
        self.to = None;
        self.prefix_open = false;
        self.open.clear();
    }

    /// Takes one byte; returns the command or the refusal that it completes, `None` while more bytes are needed.
    ///
    /// Commands have neither frame nor checksum: after a lost byte the data of one command may be read as others.
    ///
    /// # Errors
    /// The inner `Err`: the byte begins no command, or the parameter may not be examined or changed. The bytes so far are
    /// dropped.
    pub fn push(&mut self, byte: u8) -> Option<Result<Addressed, Refused>> {
        if self.prefix_open {
            self.prefix_open = false;
            self.to = Some(byte);
            return None;
        }
        if self.open.is_empty() {
            match byte {
                0xF0..=0xFF => self.to = Some(byte - 0xF0),
                0xE0..=0xEF => self.to = Some(byte - 0xE0 + 16),
                0xA0 => self.prefix_open = true,
                _ => return self.step(byte),
            }
            return None;
        }
        self.step(byte)
    }

    fn step(&mut self, byte: u8) -> Option<Result<Addressed, Refused>> {
        self.open.push(byte);
        let done = match self.missing() {
            Ok(0) => Ok(Addressed { to: self.to, command: self.command() }),
            Ok(_) => return None,
            Err(refused) => Err(refused),
        };
        self.reset();
        Some(done)
    }

    /// How many more bytes the open command needs, as far as is known.
    fn missing(&self) -> Result<usize, Refused> {
        let command = self.open[0];
        let data = match command {
            b'B'
            | b'@'
            | b'?'
            | b'Q'
            | b'R'
            | b'S'
            | b'T'
            | b'F'
            | b'G'
            | b'u'
            | b'v'
            | b't'
            | b'N'
            | b'/'
            | b'z'
            | 0x11
            | 0x13
            | 0x80..=0x90 => 0,
            byte if Format::from_command(byte).is_some() => 0,
            b'M' | b'A' | b'0' => 1,
            b'L' | b's' | b'd' | b'k' => 2,
            b'r' | b'q' | b'K' => 6,
            b'H' | b'J' => 12,
            b'O' | b'P' => {
                let change = command == b'P';
                match self.open.get(1) {
                    None => 1,
                    Some(&number) => {
                        let known = parameter(number);
                        let len = if change {
                            known.and_then(|p| self.family.write_len(p, self.addressing))
                        } else {
                            known.map(|_| 0)
                        };
                        1 + len.ok_or(Refused::Parameter { parameter: number, change })?
                    }
                }
            }
            byte => return Err(Refused::UnknownCommand(byte)),
        };
        Ok(1 + data - self.open.len())
    }

    /// The open command, complete.
    fn command(&self) -> Command {
        let data = &self.open[1..];
        match self.open[0] {
            b'B' => Command::Point,
            b'@' => Command::Stream,
            b'?' => Command::StreamStop,
            b'Q' => Command::ReportRate(ReportRate::Every),
            b'R' => Command::ReportRate(ReportRate::Every2),
            b'S' => Command::ReportRate(ReportRate::Every8),
            b'T' => Command::ReportRate(ReportRate::Every32),
            b'F' => Command::Run,
            b'G' => Command::Sleep,
            b'L' => Command::Hemisphere([data[0], data[1]]),
            b'H' => Command::ReferenceFrame1(word_array(data)),
            b'r' => Command::ReferenceFrame2(word_array(data)),
            b'J' => Command::AngleAlign1(word_array(data)),
            b'q' => Command::AngleAlign2(word_array(data)),
            b'K' => Command::Offset(word_array(data)),
            b'u' => Command::Boresight,
            b'v' => Command::RemoveBoresight,
            b's' => Command::Metal([data[0], data[1]]),
            b't' => Command::MetalError,
            b'M' => Command::ButtonMode(data[0] != 0),
            b'N' => Command::ButtonRead,
            b'A' => Command::Sync(data[0]),
            b'0' => Command::NextTransmitter { address: data[0] >> 4, number: data[0] & 0x0F },
            b'/' => Command::FbbReset,
            b'O' => Command::Examine(data[0]),
            b'P' => Command::Change { parameter: data[0], data: data[1..].to_vec() },
            0x11 => Command::Xon,
            0x13 => Command::Xoff,
            b'z' => Command::FactoryTest,
            byte @ (b'd' | b'k') => {
                Command::ReadMemory { prom: byte == b'k', address: u16::from_le_bytes([data[0], data[1]]) }
            }
            byte => Format::from_command(byte).map_or(Command::FactoryWord(byte), Command::Format),
        }
    }
}

fn word_array<const N: usize>(data: &[u8]) -> [i16; N] {
    std::array::from_fn(|i| i16::from_le_bytes([data[2 * i], data[2 * i + 1]]))
}
