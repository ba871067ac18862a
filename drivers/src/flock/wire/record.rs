//! Data records: the answers to POINT and STREAM.
//!
//! A record is a row of 14-bit words in pairs of 7-bit bytes, least significant first, then the button
//! byte and the address byte where these modes are on. Only the first byte has bit 7 set.

use posed_state::Plain;
use thiserror::Error;

use super::{Format, QuaternionSense, Range, rotation, value};

/// The bit that marks the first byte of a record, and no other.
pub const PHASE_BIT: u8 = 0x80;
/// Most words that a record holds.
pub const MAX_WORDS: usize = 12;
/// Bytes of the longest record.
pub const MAX_LEN: usize = 2 * MAX_WORDS + 2;
/// Full scale of a word.
const FULL_SCALE: f64 = 32768.0;
/// Words are in steps of so much: 14 bits in the upper part of 16.
const WORD_STEP: f64 = 4.0;

/// What decides the length of a bird's records. The record itself does not tell it: only the answers of set-up do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub struct Shape {
    /// Which words.
    pub format: Format,
    /// Whether a button byte follows the words.
    pub button: bool,
    /// Whether an address byte ends the record.
    pub group: bool,
}

impl Shape {
    /// Bytes of a record: two per word, button and address where they are on; 6 to [`MAX_LEN`].
    #[expect(clippy::len_without_is_empty, reason = "a record is never empty")]
    pub const fn len(self) -> usize {
        2 * self.format.words() + self.button as usize + self.group as usize
    }
}

/// What turns words into SI units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub struct Scale {
    /// Full scale of positions.
    pub range: Range,
    /// Meaning of quaternions.
    pub quaternion_sense: QuaternionSense,
}

/// How far an orientation on the wire may be from a rotation.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Tolerance {
    /// Largest accepted `| |q| - 1 |`.
    pub quaternion_norm: f64,
    /// Largest accepted element of `| m * transpose(m) - 1 |`.
    pub matrix: f64,
}

impl Tolerance {
    /// For live tracking.
    ///
    /// Quaternions: real units keep within 2e-4, one count of quantisation in each word included. A flipped
    /// bit that turns the sensor by over 5 degrees changes one word by 2048 or more (0.0625), and so the norm
    /// by more than 0.0015, unless the flip happens to mirror that word. Matrices: a flip of that size
    /// shows as 0.036 or more in some element; a unit that has just started is within 0.025.
    pub const LIVE: Self = Self { quaternion_norm: 0.0015, matrix: 0.03 };
    /// For captures, where every record that a unit sent counts, start-up included.
    pub const CAPTURE: Self = Self { quaternion_norm: 0.05, matrix: 0.1 };
}

/// A decoded record, in SI units. It is plausible, not proven: the protocol has no checksum.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Record {
    /// Position of the sensor in the transmitter frame (x forward, y right, z down), m; `None` in formats without.
    pub position_m: Option<[f64; 3]>,
    /// Unit quaternion (w, x, y, z), sensor to transmitter, normalised when decoded; `None` in the position format.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// Button byte as sent; `None` where the shape has none.
    pub button: Option<u8>,
    /// Address byte, 0 to 127 as sent; `None` without group mode.
    pub address: Option<u8>,
}

impl Record {
    /// Whether a coordinate is at the end of the words' range.
    pub fn is_clipped(&self, range: Range) -> bool {
        value::is_clipped(self.position_m, range.metres(), FULL_SCALE / WORD_STEP)
    }
}

/// Why bytes are no record.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum RecordError {
    /// The record is longer or shorter than its shape.
    #[error("the record has {got} bytes where its format has {expected}")]
    Length {
        /// Bytes of the shape.
        expected: usize,
        /// Bytes given.
        got: usize,
    },
    /// The first byte lacks bit 7, or another one has it.
    #[error("bit 7 is wrong in byte {index}")]
    Phase {
        /// Index of the byte.
        index: usize,
    },
    /// The words describe no rotation.
    #[error("the orientation is {error:.4} away from a rotation")]
    NotARotation {
        /// Deviation in the measure of [`Tolerance`]; infinite for a mirrored matrix.
        error: f64,
    },
}

/// Reads the words of a record whose length and phase bits are right; unused words are zero.
///
/// Words are in steps of 4 (14 bits in the upper part of 16), 32768 to full scale.
///
/// # Errors
/// [`RecordError::Length`] and [`RecordError::Phase`].
pub fn words(bytes: &[u8], shape: Shape) -> Result<[i16; MAX_WORDS], RecordError> {
    if bytes.len() != shape.len() {
        return Err(RecordError::Length { expected: shape.len(), got: bytes.len() });
    }
    if let Some(index) = (0..bytes.len()).find(|&i| (bytes[i] & PHASE_BIT != 0) != (i == 0)) {
        return Err(RecordError::Phase { index });
    }
    let mut words = [0; MAX_WORDS];
    for (word, pair) in words.iter_mut().zip(bytes[..2 * shape.format.words()].chunks_exact(2)) {
        *word = word_from_bytes(pair[0], pair[1]);
    }
    Ok(words)
}

/// One word from its two bytes of 7 bits, least significant first; bit 7 of each is passed over.
pub const fn word_from_bytes(low: u8, high: u8) -> i16 {
    (((high as u16 & 0x7F) << 9) | ((low as u16 & 0x7F) << 2)) as i16
}

/// The two bytes of a word, without phase bit; the word's two low bits are lost.
pub const fn word_to_bytes(word: i16) -> [u8; 2] {
    [((word >> 2) & 0x7F) as u8, ((word >> 9) & 0x7F) as u8]
}

/// Decodes one record.
///
/// Output: position in m, orientation as unit quaternion sensor to transmitter, whatever the format. `scale` holds what the
/// words do not tell: full scale and meaning of quaternions. Positions and angles can be anything, so damage in them that keeps
/// length and phase bits is not found.
///
/// # Errors
/// Wrong length, wrong phase bits, or a matrix or quaternion further than `tolerance` from a rotation.
pub fn decode(bytes: &[u8], shape: Shape, scale: Scale, tolerance: Tolerance) -> Result<Record, RecordError> {
    let words = words(bytes, shape)?;
    let position_m = shape
        .format
        .has_position()
        .then(|| [0, 1, 2].map(|i| f64::from(words[i]) / FULL_SCALE * scale.range.metres()));
    let orientation = &words[if shape.format.has_position() { 3 } else { 0 }..];
    let orientation_wxyz = match shape.format {
        Format::Position => None,
        Format::Angles | Format::PositionAngles => Some(rotation::from_angles(
            [0, 1, 2].map(|i| f64::from(orientation[i]) / FULL_SCALE * std::f64::consts::PI),
        )),
        Format::Matrix | Format::PositionMatrix => {
            let m = std::array::from_fn(|i| f64::from(orientation[i]) / FULL_SCALE);
            let error = rotation::orthonormality_error(m);
            if error > tolerance.matrix {
                return Err(RecordError::NotARotation { error });
            }
            Some(rotation::from_matrix(m))
        }
        Format::Quaternion | Format::PositionQuaternion => {
            let q = std::array::from_fn(|i| f64::from(orientation[i]) / FULL_SCALE);
            let error = (rotation::norm(q) - 1.0).abs();
            if error > tolerance.quaternion_norm {
                return Err(RecordError::NotARotation { error });
            }
            Some(sensed(rotation::normalised(q), scale.quaternion_sense))
        }
    };
    let tail = &bytes[2 * shape.format.words()..];
    Ok(Record {
        position_m,
        orientation_wxyz,
        button: shape.button.then(|| tail[0]),
        address: shape.group.then(|| tail[tail.len() - 1]),
    })
}

/// The words of a pose: position in m, orientation as unit quaternion sensor to transmitter. Values beyond full scale saturate;
/// words that the format has not are zero. On the wire each word loses its two low bits.
pub fn pose_words(
    position_m: [f64; 3],
    orientation_wxyz: [f64; 4],
    format: Format,
    scale: Scale,
) -> [i16; MAX_WORDS] {
    let mut values = [0.0; MAX_WORDS];
    let mut rest = &mut values[..];
    if format.has_position() {
        for (value, p) in rest.iter_mut().zip(position_m) {
            *value = p / scale.range.metres();
        }
        rest = &mut rest[3..];
    }
    match format {
        Format::Position => {}
        Format::Angles | Format::PositionAngles => {
            let angles = rotation::to_angles(orientation_wxyz).map(|a| a / std::f64::consts::PI);
            rest[..3].copy_from_slice(&angles);
        }
        Format::Matrix | Format::PositionMatrix => {
            rest[..9].copy_from_slice(&rotation::to_matrix(orientation_wxyz));
        }
        Format::Quaternion | Format::PositionQuaternion => {
            rest[..4].copy_from_slice(&sensed(orientation_wxyz, scale.quaternion_sense));
        }
    }
    values.map(|value| (value * FULL_SCALE).round().clamp(-32768.0, 32767.0) as i16)
}

/// Appends a record of these words to `out`, phase bit included; `button` and `address` (7 bits each) are used where the shape
/// has them, words beyond those of the format are not.
pub fn encode_words(words: &[i16; MAX_WORDS], button: u8, address: u8, shape: Shape, out: &mut Vec<u8>) {
    let start = out.len();
    for &word in &words[..shape.format.words()] {
        out.extend(word_to_bytes(word));
    }
    if shape.button {
        out.push(button & 0x7F);
    }
    if shape.group {
        out.push(address & 0x7F);
    }
    out[start] |= PHASE_BIT;
}

/// Appends the record of a pose to `out`: position in m, orientation as unit quaternion sensor to transmitter; see
/// [`pose_words`] and [`encode_words`].
pub fn encode(
    position_m: [f64; 3],
    orientation_wxyz: [f64; 4],
    (button, address): (u8, u8),
    shape: Shape,
    scale: Scale,
    out: &mut Vec<u8>,
) {
    let words = pose_words(position_m, orientation_wxyz, shape.format, scale);
    encode_words(&words, button, address, shape, out);
}

fn sensed([w, x, y, z]: [f64; 4], sense: QuaternionSense) -> [f64; 4] {
    match sense {
        QuaternionSense::Vendor => [w, -x, -y, -z],
        QuaternionSense::Direct => [w, x, y, z],
    }
}
