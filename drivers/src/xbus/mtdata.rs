//! MTData (0x32): the data message of older devices and of an Xbus Master.
//!
//! A message holds no description of itself: what a tracker's block holds is identified by its [`Layout`],
//! which only the configuration message knows. A stand-alone tracker sends its block and then, if set so,
//! its sample counter; an Xbus Master sends the counter first and then a block per tracker.

use posed_state::Plain;
use thiserror::Error;

use super::number::{Number, be16};

/// What a tracker's block holds: its output mode and settings, as the configuration message states them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Plain)]
pub struct Layout {
    /// Output mode: which quantities; bits as in the constants below.
    pub mode: u16,
    /// Output settings: in which form. Bits 3 and 2 orientation (0 quaternion, 1 Euler, 2 matrix), 9 and 8 number format
    /// ([`Number::from_code`]), 4 to 6 and 10, 11 switch parts off; [`Layout::COUNTER`], [`Layout::NED`].
    pub settings: u32,
}

/// Why a [`Layout`] cannot be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum LayoutError {
    /// Bits of the output mode that have no known place in the block.
    #[error("output mode {0:#06x} has parts whose place in the message is not known")]
    Mode(u16),
    /// Settings that are not known.
    #[error("output settings {0:#010x} select a form that is not known")]
    Settings(u32),
}

impl Layout {
    /// Unprocessed words, without any of the processed quantities beside them.
    pub const RAW: u16 = 0x4000;
    /// Temperature.
    pub const TEMPERATURE: u16 = 0x0001;
    /// Acceleration, rate of turn, magnetic field; settings may switch each off.
    pub const CALIBRATED: u16 = 0x0002;
    /// Orientation.
    pub const ORIENTATION: u16 = 0x0004;
    /// Analogue inputs; settings may switch each off.
    pub const AUXILIARY: u16 = 0x0008;
    /// Position (MTi-G).
    pub const POSITION: u16 = 0x0010;
    /// Velocity (MTi-G).
    pub const VELOCITY: u16 = 0x0020;
    /// Status byte.
    pub const STATUS: u16 = 0x0800;

    /// Settings: the sample counter, behind the block of a stand-alone tracker.
    pub const COUNTER: u32 = 1;
    /// Settings: north, east, down.
    pub const NED: u32 = 0x8000_0000;

    const KNOWN: u16 = Self::RAW
        | Self::TEMPERATURE
        | Self::CALIBRATED
        | Self::ORIENTATION
        | Self::AUXILIARY
        | Self::POSITION
        | Self::VELOCITY
        | Self::STATUS;

    /// Refuses what cannot be decoded.
    ///
    /// # Errors
    /// Modes with unknown parts or with raw and processed data together, and unknown settings.
    pub fn check(self) -> Result<(), LayoutError> {
        let processed = Self::KNOWN & !Self::RAW & !Self::STATUS;
        if self.mode & !Self::KNOWN != 0 || self.has(Self::RAW) && self.mode & processed != 0 {
            return Err(LayoutError::Mode(self.mode));
        }
        if self.settings & 2 != 0 || self.settings & 0x0C == 0x0C {
            return Err(LayoutError::Settings(self.settings));
        }
        Ok(())
    }

    const fn has(self, part: u16) -> bool {
        self.mode & part != 0
    }

    const fn lacks(self, switched_off_by: u32) -> bool {
        self.settings & switched_off_by != 0
    }

    /// Whether the sample counter follows the block of a stand-alone tracker.
    pub const fn has_counter(self) -> bool {
        self.settings & 3 == Self::COUNTER
    }

    /// The format of real numbers in the block.
    pub const fn number(self) -> Number {
        Number::from_code((self.settings >> 8) as u16 & 3)
    }

    /// Real numbers of the orientation.
    const fn orientation_numbers(self) -> usize {
        match self.settings & 0x0C {
            0 => 4,
            4 => 3,
            _ => 9,
        }
    }

    /// Bytes of the block, without the sample counter, for a layout that [`Self::check`] accepts.
    pub fn block_len(self) -> usize {
        let triple = |there: bool| if there { 3 } else { 0 };
        let calibrated = self.has(Self::CALIBRATED);
        let numbers = usize::from(self.has(Self::TEMPERATURE))
            + triple(calibrated && !self.lacks(0x10))
            + triple(calibrated && !self.lacks(0x20))
            + triple(calibrated && !self.lacks(0x40))
            + if self.has(Self::ORIENTATION) { self.orientation_numbers() } else { 0 }
            + triple(self.has(Self::POSITION))
            + triple(self.has(Self::VELOCITY));
        let words = if self.has(Self::RAW) { 10 } else { 0 }
            + usize::from(self.has(Self::AUXILIARY) && !self.lacks(0x400))
            + usize::from(self.has(Self::AUXILIARY) && !self.lacks(0x800));
        numbers * self.number().size() + 2 * words + usize::from(self.has(Self::STATUS))
    }

    /// Reads a block; `None` unless its length is [`Layout::block_len`].
    ///
    /// A block says nothing of its own form: one of another layout with the same length reads as wrong numbers. Check the layout
    /// first ([`Self::check`]).
    pub fn decode(self, block: &[u8]) -> Option<Block> {
        if block.len() != self.block_len() {
            return None;
        }
        let mut reader = Reader { rest: block, number: self.number() };
        let calibrated = self.has(Self::CALIBRATED);
        let auxiliary = self.has(Self::AUXILIARY);
        Some(Block {
            raw: reader.when(self.has(Self::RAW), Reader::words)?,
            temperature_c: reader
                .when(self.has(Self::TEMPERATURE), |r| r.numbers().map(|[t]: [f64; 1]| t))?,
            acceleration: reader.when(calibrated && !self.lacks(0x10), Reader::numbers)?,
            rate_of_turn: reader.when(calibrated && !self.lacks(0x20), Reader::numbers)?,
            magnetic_field: reader.when(calibrated && !self.lacks(0x40), Reader::numbers)?,
            orientation: reader.when(self.has(Self::ORIENTATION), |r| {
                Some(match self.orientation_numbers() {
                    4 => Orientation::Quaternion(r.numbers()?),
                    3 => Orientation::EulerDeg(r.numbers()?),
                    _ => Orientation::Matrix([r.numbers()?, r.numbers()?, r.numbers()?]),
                })
            })?,
            auxiliary: [
                reader.when(auxiliary && !self.lacks(0x400), Reader::word)?,
                reader.when(auxiliary && !self.lacks(0x800), Reader::word)?,
            ],
            position: reader.when(self.has(Self::POSITION), Reader::numbers)?,
            velocity: reader.when(self.has(Self::VELOCITY), Reader::numbers)?,
            status: reader.when(self.has(Self::STATUS), Reader::byte)?,
        })
    }

    /// Appends `block`; parts that the layout selects and the block lacks are zero, parts that it does not select are left out.
    /// An orientation must have the form that the settings select.
    pub fn encode(self, block: &Block, out: &mut Vec<u8>) {
        let number = self.number();
        let mut numbers = |values: &[f64]| values.iter().for_each(|&value| number.encode(value, out));
        if self.has(Self::TEMPERATURE) {
            numbers(&[block.temperature_c.unwrap_or_default()]);
        }
        if self.has(Self::CALIBRATED) {
            for (off, part) in
                [(0x10, block.acceleration), (0x20, block.rate_of_turn), (0x40, block.magnetic_field)]
            {
                if !self.lacks(off) {
                    numbers(&part.unwrap_or_default());
                }
            }
        }
        if self.has(Self::ORIENTATION) {
            match block.orientation {
                Some(Orientation::Quaternion(q)) => numbers(&q),
                Some(Orientation::EulerDeg(angles)) => numbers(&angles),
                Some(Orientation::Matrix(rows)) => numbers(rows.as_flattened()),
                None => numbers(&[0.0; 9][..self.orientation_numbers()]),
            }
        }
        if self.has(Self::RAW) {
            block.raw.unwrap_or_default().iter().for_each(|word| out.extend(word.to_be_bytes()));
        }
        if self.has(Self::AUXILIARY) {
            for (off, word) in [(0x400, block.auxiliary[0]), (0x800, block.auxiliary[1])] {
                if !self.lacks(off) {
                    out.extend(word.unwrap_or_default().to_be_bytes());
                }
            }
        }
        for (part, values) in [(Self::POSITION, block.position), (Self::VELOCITY, block.velocity)] {
            if self.has(part) {
                values.unwrap_or_default().iter().for_each(|&value| number.encode(value, out));
            }
        }
        if self.has(Self::STATUS) {
            out.push(block.status.unwrap_or_default());
        }
    }
}

/// The orientation of a block, in the form that the settings select: sensor to the axes of the settings ([`Layout::NED`]), as
/// the device computed it; not normalised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Orientation {
    /// w, x, y, z.
    Quaternion([f64; 4]),
    /// Roll, pitch, yaw in degrees.
    EulerDeg([f64; 3]),
    /// Rows of the rotation matrix. The vendor's sources disagree about rows and columns here, and no
    /// recording settles it; the session does not use it.
    Matrix([[f64; 3]; 3]),
}

/// What one tracker sent in one message, in the units of the wire; `None`, also in [`Block::auxiliary`]: the layout does not
/// have it. Vectors are in sensor axes, but for position and velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Block {
    /// Acceleration, rate of turn, magnetic field (3 words each) and temperature as converted, unscaled.
    pub raw: Option<[u16; 10]>,
    /// Temperature, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Acceleration, m/s², gravity included (+g upwards at rest).
    pub acceleration: Option<[f64; 3]>,
    /// Angular velocity, rad/s (the manual's "rate of turn").
    pub rate_of_turn: Option<[f64; 3]>,
    /// Magnetic field, about 1 at the place of calibration.
    pub magnetic_field: Option<[f64; 3]>,
    /// Orientation as the device computed it.
    pub orientation: Option<Orientation>,
    /// Analogue inputs 1 and 2, as converted, unscaled.
    pub auxiliary: [Option<u16>; 2],
    /// Position (MTi-G): latitude and longitude in degrees, altitude in m.
    pub position: Option<[f64; 3]>,
    /// Velocity (MTi-G), m/s, in the axes that the device is set to.
    pub velocity: Option<[f64; 3]>,
    /// Status byte, as sent.
    pub status: Option<u8>,
}

struct Reader<'a> {
    rest: &'a [u8],
    number: Number,
}

impl<'a> Reader<'a> {
    /// Reads a part if it is `there`; the outer `None` means that the bytes have run out.
    fn when<T>(&mut self, there: bool, read: impl FnOnce(&mut Self) -> Option<T>) -> Option<Option<T>> {
        if there { read(self).map(Some) } else { Some(None) }
    }

    fn take(&mut self, len: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(len)?;
        self.rest = rest;
        Some(taken)
    }

    fn numbers<const N: usize>(&mut self) -> Option<[f64; N]> {
        let bytes = self.take(N * self.number.size())?;
        self.number.decode_array(bytes)
    }

    fn word(&mut self) -> Option<u16> {
        be16(self.take(2)?, 0)
    }

    fn words(&mut self) -> Option<[u16; 10]> {
        let mut words = [0; 10];
        for word in &mut words {
            *word = self.word()?;
        }
        Some(words)
    }

    fn byte(&mut self) -> Option<u8> {
        self.take(1).map(|byte| byte[0])
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A block with every part, of which a layout takes what it selects.
    fn full(layout: Layout, seed: f64) -> Block {
        let triple = |k: f64| Some([seed + k, -seed, 0.25 * k]);
        let selected = |part, value: Option<[f64; 3]>| if layout.has(part) { value } else { None };
        let on = |off: u32, value| if layout.lacks(off) { None } else { selected(Layout::CALIBRATED, value) };
        let aux = |off, word| (layout.has(Layout::AUXILIARY) && !layout.lacks(off)).then_some(word);
        Block {
            raw: layout.has(Layout::RAW).then_some([1, 2, 3, 4, 5, 6, 7, 8, 9, 0xFA00]),
            temperature_c: layout.has(Layout::TEMPERATURE).then_some(21.5),
            acceleration: on(0x10, triple(1.0)),
            rate_of_turn: on(0x20, triple(2.0)),
            magnetic_field: on(0x40, triple(3.0)),
            orientation: layout.has(Layout::ORIENTATION).then_some(match layout.settings & 0x0C {
                0 => Orientation::Quaternion([0.5, -0.5, 0.5, 0.5]),
                4 => Orientation::EulerDeg([1.0, -2.0, seed]),
                _ => Orientation::Matrix([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
            }),
            auxiliary: [aux(0x400, 7), aux(0x800, 0xFFFF)],
            position: selected(Layout::POSITION, triple(4.0)),
            velocity: selected(Layout::VELOCITY, triple(5.0)),
            status: layout.has(Layout::STATUS).then_some(0x45),
        }
    }

    proptest! {
        #[test]
        fn every_layout_round_trips(mode in 0_u16..0x40, status: bool, raw: bool, settings in 0_u32..0x1000, k in -500_i32..500) {
            let mode = if raw { Layout::RAW } else { mode } | if status { Layout::STATUS } else { 0 };
            let layout = Layout { mode, settings };
            prop_assume!(layout.check().is_ok());
            let block = full(layout, f64::from(k) / 4.0);
            let mut bytes = Vec::new();
            layout.encode(&block, &mut bytes);
            prop_assert_eq!(bytes.len(), layout.block_len());
            prop_assert_eq!(layout.decode(&bytes), Some(block));
            bytes.push(0);
            prop_assert_eq!(layout.decode(&bytes), None);
        }
    }

    #[test]
    fn unknown_forms_are_refused() {
        let check = |mode, settings| Layout { mode, settings }.check();
        assert_eq!(check(0x1000, 0), Err(LayoutError::Mode(0x1000)));
        assert_eq!(check(0x4002, 0), Err(LayoutError::Mode(0x4002)));
        assert_eq!(check(6, 0x0C), Err(LayoutError::Settings(0x0C)));
        assert_eq!(check(6, 2), Err(LayoutError::Settings(2)));
        assert_eq!(check(0x0FFF & !0x07C0, 0x8000_0305), Ok(()));
    }
}
