//! Many small pieces of the log in one message: what MCAP keeps for each message, its index too, is larger than what a device sends at a time.
//!
//! What comes in: pieces, each with its time and where it belongs. What goes out: bytes, and the same pieces again, exact to the
//! nanosecond. What it never does: look into a piece.
//!
//! A piece is four numbers and its bytes: whether its time is in µs (0) or in ns (1) plus twice its place; its time after the one
//! before, signed; the number of its bytes. Numbers have seven bits in each byte, the lowest first; all but the last byte have
//! the highest bit set. A signed number n is 2n, or -2n - 1 where it is negative.

use posed_drivers::Timestamp;

/// Nanoseconds in a microsecond: stamps are whole ones mostly, and shorter so.
const US: i64 = 1000;

/// A piece of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece<'a> {
    pub(super) place: u32,
    pub(super) t: Timestamp,
    pub(super) data: &'a [u8],
}

/// Pieces that are being put together.
#[derive(Debug, Default)]
pub(super) struct Bundle {
    bytes: Vec<u8>,
    last: Timestamp,
    /// The latest time of a piece.
    latest: Option<Timestamp>,
}

impl Bundle {
    /// Appends a piece.
    pub(super) fn push(&mut self, Piece { place, t, data }: Piece<'_>) {
        let step_ns = t.as_nanos().wrapping_sub(self.last.as_nanos());
        let (step, exact) = if step_ns % US == 0 { (step_ns / US, 0) } else { (step_ns, 1) };
        number(u64::from(place) << 1 | exact, &mut self.bytes);
        number(zigzag(step), &mut self.bytes);
        number(data.len() as u64, &mut self.bytes);
        self.bytes.extend_from_slice(data);
        self.last = t;
        self.latest = self.latest.max(Some(t));
    }

    /// The bytes so far, and the latest time in them; `None` where there is no piece.
    pub(super) fn bytes(&self) -> Option<(&[u8], Timestamp)> {
        Some((&self.bytes, self.latest?))
    }

    /// Bytes so far.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Begins anew.
    pub(super) fn clear(&mut self) {
        self.bytes.clear();
        (self.last, self.latest) = (Timestamp::ZERO, None);
    }
}

/// Takes a bundle apart; `None` in the place of a piece that is none, and nothing after it.
pub(super) fn pieces(bytes: &[u8]) -> impl Iterator<Item = Option<Piece<'_>>> {
    let mut rest = Some(bytes);
    let mut last_ns = 0;
    std::iter::from_fn(move || {
        let mut bytes = rest.filter(|bytes| !bytes.is_empty())?;
        let piece = piece(&mut bytes, &mut last_ns);
        rest = piece.is_some().then_some(bytes);
        Some(piece)
    })
}

fn piece<'a>(bytes: &mut &'a [u8], last_ns: &mut i64) -> Option<Piece<'a>> {
    let head = take_number(bytes)?;
    let unit = if head & 1 == 0 { US } else { 1 };
    *last_ns = last_ns.wrapping_add(unzigzag(take_number(bytes)?).wrapping_mul(unit));
    let length = usize::try_from(take_number(bytes)?).ok()?;
    let (data, rest) = bytes.split_at_checked(length)?;
    *bytes = rest;
    Some(Piece { place: u32::try_from(head >> 1).ok()?, t: Timestamp::from_nanos(*last_ns), data })
}

fn number(mut value: u64, out: &mut Vec<u8>) {
    while value > 0x7F {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn take_number(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..u64::BITS).step_by(7) {
        let (first, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(first & 0x7F) << shift;
        if first & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

/// Small numbers of either sign as small ones without.
fn zigzag(value: i64) -> u64 {
    (value << 1 ^ value >> 63) as u64
}

fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_come_back_to_the_nanosecond_and_a_cut_bundle_says_so() {
        let times = [0, 86_000, 85_999, i64::MAX, i64::MIN, -1, 7_000_000_000, i64::MIN + 1];
        let data = vec![7_u8; 300];
        let piece = |(n, t): (usize, &i64)| Piece {
            place: [0, 1, 200, u32::MAX][n % 4],
            t: Timestamp::from_nanos(*t),
            data: &data[..[0, 1, 127, 128, 300][n % 5]],
        };
        let put: Vec<_> = times.iter().enumerate().map(piece).collect();
        let mut bundle = Bundle::default();
        assert_eq!(bundle.bytes(), None);
        put.iter().for_each(|piece| bundle.push(*piece));
        let (bytes, latest) = bundle.bytes().unwrap();
        assert_eq!(latest, Timestamp::from_nanos(i64::MAX));
        assert_eq!(pieces(bytes).collect::<Option<Vec<_>>>().unwrap(), put);
        for cut in 0..bytes.len() {
            let back: Vec<_> = pieces(&bytes[..cut]).collect();
            let whole = back.iter().flatten().count();
            assert!(back.len() <= whole + 1 && back.iter().flatten().zip(&put).all(|(a, b)| a == b));
        }
        assert_eq!(pieces(&[0x80; 12]).collect::<Vec<_>>(), [None]);
        bundle.clear();
        assert_eq!((bundle.bytes(), bundle.len()), (None, 0));
    }
}
