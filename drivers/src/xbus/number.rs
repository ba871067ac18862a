//! The four formats of real numbers in Xbus data, and its words, big-endian.

use serde::{Deserialize, Serialize};

/// How a real number is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Number {
    /// IEEE-754 single precision.
    Float32,
    /// Signed fixed point, 12 bits before and 20 after the point.
    Fp1220,
    /// Signed fixed point, 16 bits before and 32 after the point. The fraction travels first.
    Fp1632,
    /// IEEE-754 double precision.
    Float64,
}

impl Number {
    /// All formats, in the order of their codes.
    pub const ALL: [Self; 4] = [Self::Float32, Self::Fp1220, Self::Fp1632, Self::Float64];

    /// The format of the low two bits of `code`; other bits are passed over.
    pub const fn from_code(code: u16) -> Self {
        Self::ALL[(code & 3) as usize]
    }

    /// The two-bit code.
    pub const fn code(self) -> u16 {
        self as u16
    }

    /// Bytes of one number.
    pub const fn size(self) -> usize {
        match self {
            Self::Float32 | Self::Fp1220 => 4,
            Self::Fp1632 => 6,
            Self::Float64 => 8,
        }
    }

    /// Reads one big-endian number from the front of `bytes`; `None` when there are too few.
    ///
    /// Exact: each format fits an `f64`. A float may be infinite or NaN.
    pub fn decode(self, bytes: &[u8]) -> Option<f64> {
        Some(match self {
            Self::Float32 => f64::from(f32::from_be_bytes(*bytes.first_chunk()?)),
            Self::Fp1220 => f64::from(i32::from_be_bytes(*bytes.first_chunk()?)) / 1_048_576.0,
            Self::Fp1632 => {
                let [f3, f2, f1, f0, i1, i0] = *bytes.first_chunk()?;
                let fraction = i64::from(u32::from_be_bytes([f3, f2, f1, f0]));
                let integer = i64::from(i16::from_be_bytes([i1, i0]));
                ((integer << 32) + fraction) as f64 / 4_294_967_296.0
            }
            Self::Float64 => f64::from_be_bytes(*bytes.first_chunk()?),
        })
    }

    /// Reads `N` numbers that fill `bytes` exactly; `None` when they do not.
    pub fn decode_array<const N: usize>(self, bytes: &[u8]) -> Option<[f64; N]> {
        if bytes.len() != N * self.size() {
            return None;
        }
        let mut values = [0.0; N];
        for (value, chunk) in values.iter_mut().zip(bytes.chunks_exact(self.size())) {
            *value = self.decode(chunk)?;
        }
        Some(values)
    }

    /// Appends `value`, big-endian, rounded to the nearest number of the format. Fixed point is held at its limits, and 0 for
    /// NaN; single precision goes to infinity beyond its own.
    pub fn encode(self, value: f64, out: &mut Vec<u8>) {
        match self {
            Self::Float32 => out.extend((value as f32).to_be_bytes()),
            // A cast from float to integer saturates.
            Self::Fp1220 => out.extend(((value * 1_048_576.0).round() as i32).to_be_bytes()),
            Self::Fp1632 => {
                const LIMIT: i64 = 1 << 47;
                let fixed = ((value * 4_294_967_296.0).round() as i64).clamp(-LIMIT, LIMIT - 1);
                out.extend((fixed as u32).to_be_bytes());
                out.extend(((fixed >> 32) as i16).to_be_bytes());
            }
            Self::Float64 => out.extend(value.to_be_bytes()),
        }
    }
}

/// Big-endian word at `at`.
pub(super) fn be16(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|&word| u16::from_be_bytes(word))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn bytes(number: Number, value: f64) -> Vec<u8> {
        let mut out = Vec::new();
        number.encode(value, &mut out);
        out
    }

    #[test]
    fn worked_examples() {
        let table: [(f64, [&[u8]; 4]); 8] = [
            (
                1.0,
                [&[0x3F, 0x80, 0, 0], &[0, 0x10, 0, 0], &[0, 0, 0, 0, 0, 1], &[0x3F, 0xF0, 0, 0, 0, 0, 0, 0]],
            ),
            (
                -1.0,
                [
                    &[0xBF, 0x80, 0, 0],
                    &[0xFF, 0xF0, 0, 0],
                    &[0, 0, 0, 0, 0xFF, 0xFF],
                    &[0xBF, 0xF0, 0, 0, 0, 0, 0, 0],
                ],
            ),
            (
                9.81,
                [
                    &[0x41, 0x1C, 0xF5, 0xC3],
                    &[0x00, 0x9C, 0xF5, 0xC3],
                    &[0xCF, 0x5C, 0x28, 0xF6, 0x00, 0x09],
                    &[0x40, 0x23, 0x9E, 0xB8, 0x51, 0xEB, 0x85, 0x1F],
                ],
            ),
            (
                -9.81,
                [
                    &[0xC1, 0x1C, 0xF5, 0xC3],
                    &[0xFF, 0x63, 0x0A, 0x3D],
                    &[0x30, 0xA3, 0xD7, 0x0A, 0xFF, 0xF6],
                    &[0xC0, 0x23, 0x9E, 0xB8, 0x51, 0xEB, 0x85, 0x1F],
                ],
            ),
            (
                2047.9999990463257,
                [
                    &[0x45, 0, 0, 0],
                    &[0x7F, 0xFF, 0xFF, 0xFF],
                    &[0xFF, 0xFF, 0xF0, 0x00, 0x07, 0xFF],
                    &[0x40, 0x9F, 0xFF, 0xFF, 0xFF, 0xC0, 0, 0],
                ],
            ),
            (
                -2048.0,
                [&[0xC5, 0, 0, 0], &[0x80, 0, 0, 0], &[0, 0, 0, 0, 0xF8, 0], &[0xC0, 0xA0, 0, 0, 0, 0, 0, 0]],
            ),
            (
                31.393166223541,
                [
                    &[0x41, 0xFB, 0x25, 0x34],
                    &[0x01, 0xF6, 0x4A, 0x69],
                    &[0x64, 0xA6, 0x8A, 0xA8, 0x00, 0x1F],
                    &[0x40, 0x3F, 0x64, 0xA6, 0x8A, 0xA8, 0x00, 0x1C],
                ],
            ),
            (
                -0.25,
                [
                    &[0xBE, 0x80, 0, 0],
                    &[0xFF, 0xFC, 0, 0],
                    &[0xC0, 0, 0, 0, 0xFF, 0xFF],
                    &[0xBF, 0xD0, 0, 0, 0, 0, 0, 0],
                ],
            ),
        ];
        for (value, forms) in table {
            for (number, form) in Number::ALL.into_iter().zip(forms) {
                assert_eq!(bytes(number, value), form, "{value} as {number:?}");
                let back = number.decode(form).unwrap();
                assert!((back - value).abs() <= 1e-6 * value.abs().max(1.0), "{value} as {number:?}: {back}");
            }
        }
    }

    #[test]
    fn out_of_range_values_are_held_at_the_limits() {
        assert_eq!(bytes(Number::Fp1220, 1e9), [0x7F, 0xFF, 0xFF, 0xFF]);
        assert_eq!(bytes(Number::Fp1632, -1e9), [0, 0, 0, 0, 0x80, 0]);
        assert_eq!(Number::Float64.decode(&[0; 7]), None);
        assert_eq!(Number::Fp1220.decode_array::<3>(&[0; 13]), None);
    }

    proptest! {
        #[test]
        fn round_trip(value in -2047.9..2047.9_f64) {
            for (number, tolerance) in Number::ALL.into_iter().zip([2e-7 * value.abs(), 5e-7, 1.2e-10, 0.0]) {
                let back = number.decode(&bytes(number, value)).unwrap();
                prop_assert!((back - value).abs() <= tolerance);
                prop_assert_eq!(bytes(number, back), bytes(number, value));
            }
        }
    }
}
