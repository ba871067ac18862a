//! MIDI time code: eight quarter frames say a time, which is that of the first of them; or one message says it in full.
//!
//! A quarter frame is sent four times a frame, so that a time takes two frames to say. What a full message says is where a machine
//! was put, not that it runs: it gives no reading.

use posed_geometry::Timestamp;

use crate::{Counting, Frame, Reading};

/// A quarter frame, and the first status byte that ends a message of the system.
const QUARTER_FRAME: u8 = 0xf1;
/// Bytes from here on may come in the middle of a message.
const REAL_TIME: u8 = 0xf8;
/// Quarter frames of a time.
const PIECES: usize = 8;
/// Quarter frames further apart are not of one time, s: at a quarter of the usual speed.
const APART_S: f64 = 0.05;

/// Reads MIDI time code from a MIDI port's bytes, in any pieces.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    /// A quarter frame's data byte comes next.
    expects_data: bool,
    digits: [u8; PIECES],
    /// When each came.
    came: [Timestamp; PIECES],
    /// How many have come in order.
    count: usize,
    backwards: bool,
    latest: Option<u8>,
}

impl Decoder {
    /// Takes the bytes of one read. Gives the times that are whole with them.
    pub fn push(&mut self, t_read: Timestamp, bytes: &[u8], stream: u32, mut time: impl FnMut(Reading)) {
        for byte in bytes {
            match *byte {
                REAL_TIME.. => {}
                QUARTER_FRAME => self.expects_data = true,
                0x80.. => self.expects_data = false,
                data if std::mem::take(&mut self.expects_data) => {
                    if let Some(reading) = self.quarter(data, t_read, stream) {
                        time(reading);
                    }
                }
                _ => {}
            }
        }
    }

    fn quarter(&mut self, data: u8, t: Timestamp, stream: u32) -> Option<Reading> {
        let piece = data >> 4;
        let before = self.latest.replace(piece);
        let apart = before.is_none_or(|before| t.seconds_since(self.came[usize::from(before)]) > APART_S);
        let (up, down) = (before.map(|at| (at + 1) % 8), before.map(|at| (at + 7) % 8));
        let backwards = up != Some(piece) && down == Some(piece);
        let first = if backwards { 7 } else { 0 };
        if apart || (up != Some(piece) && !backwards) || backwards != self.backwards {
            self.count = 0;
        }
        self.backwards = backwards;
        if piece == first {
            self.count = 0;
        } else if self.count == 0 {
            self.came[usize::from(piece)] = t;
            return None;
        }
        self.digits[usize::from(piece)] = data & 0xf;
        self.came[usize::from(piece)] = t;
        self.count += 1;
        (self.count == PIECES).then(|| self.reading(t, stream)).flatten()
    }

    fn reading(&mut self, t: Timestamp, stream: u32) -> Option<Reading> {
        self.count = 0;
        let number = |at: usize| self.digits[at] | self.digits[at + 1] << 4;
        let (frames_per_s, drop) = match self.digits[7] >> 1 & 3 {
            0 => (24, false),
            1 => (25, false),
            2 => (30, true),
            _ => (30, false),
        };
        let frame = Frame::new(number(6) & 0x1f, number(4) & 0x3f, number(2) & 0x3f, number(0) & 0x1f);
        Counting { frames_per_s, drop }.number(frame)?;
        // None can come before it was sent: the soonest says when the first was.
        let quarter_s = 0.25 / f64::from(frames_per_s);
        let behind = |at: usize| t.seconds_since(self.came[at]) + at as f64 * quarter_s;
        let behind_s = (0..PIECES).map(behind).fold(0.0, f64::max);
        let (user_bits, position_s, reversed) = (0, None, self.backwards);
        let frames_per_s = Some(frames_per_s);
        Some(Reading { frame, drop, frames_per_s, user_bits, stream, position_s, behind_s, reversed })
    }
}

/// The eight quarter frames that say a time, two bytes each.
pub fn quarter_frames(frame: Frame, counting: Counting) -> [[u8; 2]; PIECES] {
    let rate = match (counting.frames_per_s, counting.drop) {
        (24, _) => 0,
        (25, _) => 1,
        (_, true) => 2,
        (_, false) => 3,
    };
    let numbers = [frame.frames, frame.seconds, frame.minutes, frame.hours | rate << 5];
    std::array::from_fn(|at| {
        let number = numbers[at / 2];
        let digit = if at % 2 == 0 { number & 0xf } else { number >> 4 };
        [QUARTER_FRAME, (at as u8) << 4 | digit]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNTING: Counting = Counting { frames_per_s: 25, drop: false };

    fn t(quarter: usize) -> Timestamp {
        Timestamp::from_secs_f64(quarter as f64 * 0.01)
    }

    /// Two times, a quarter frame each 10 ms.
    fn bytes() -> Vec<[u8; 2]> {
        let frames = [Frame::new(23, 59, 58, 22), Frame::new(23, 59, 58, 24)];
        frames.into_iter().flat_map(|frame| quarter_frames(frame, COUNTING)).collect()
    }

    fn read(bytes: impl IntoIterator<Item = (Timestamp, Vec<u8>)>) -> Vec<Reading> {
        let (mut decoder, mut readings) = (Decoder::default(), Vec::new());
        bytes.into_iter().for_each(|(t, bytes)| decoder.push(t, &bytes, 0, |reading| readings.push(reading)));
        readings
    }

    #[test]
    fn a_time_is_that_of_its_first_quarter_frame() {
        let readings = read(bytes().into_iter().enumerate().map(|(at, bytes)| (t(at), bytes.to_vec())));
        assert_eq!(readings.len(), 2);
        assert_eq!(readings[1].frame, Frame::new(23, 59, 58, 24));
        assert_eq!(
            (readings[1].frames_per_s, readings[1].drop, readings[1].reversed),
            (Some(25), false, false)
        );
        assert!((readings[1].behind_s - 0.07).abs() < 1e-9, "{readings:?}");
    }

    #[test]
    fn one_late_quarter_frame_does_not_make_the_time_late() {
        let late = |at: usize| if at == 9 { t(11) } else { t(at) };
        let readings = read(bytes().into_iter().enumerate().map(|(at, bytes)| (late(at), bytes.to_vec())));
        assert!((readings[1].behind_s - 0.07).abs() < 1e-9);
    }

    #[test]
    fn what_comes_in_between_does_not_disturb_it_and_half_a_time_is_none() {
        let clock = bytes().into_iter().enumerate().flat_map(|(at, [status, data])| {
            // Timing clock within a message, a note before it.
            [(t(at), vec![0x90, 60, 64, status, 0xf8]), (t(at), vec![data])]
        });
        assert_eq!(read(clock).len(), 2);
        let missing = bytes().into_iter().enumerate().filter(|(at, _)| *at != 3);
        assert_eq!(read(missing.map(|(at, bytes)| (t(at), bytes.to_vec()))).len(), 1);
        assert!(read([(t(0), vec![0xf0, 0x7f, 0x7f, 1, 1, 1, 2, 3, 4, 0xf7])]).is_empty());
    }

    #[test]
    fn backwards_is_said() {
        let mut bytes = bytes();
        bytes.reverse();
        let readings = read(bytes.into_iter().enumerate().map(|(at, bytes)| (t(at), bytes.to_vec())));
        assert!(!readings.is_empty() && readings.iter().all(|reading| reading.reversed), "{readings:?}");
    }

    #[test]
    fn garbage_gives_no_time_that_does_not_exist() {
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        let garbage: Vec<u8> = (0..100_000).map(|_| random()).collect();
        for reading in read(garbage.chunks(7).map(|bytes| (Timestamp::ZERO, bytes.to_vec()))) {
            let counting = Counting { frames_per_s: reading.frames_per_s.unwrap(), drop: reading.drop };
            assert!(counting.number(reading.frame).is_some());
        }
    }
}
