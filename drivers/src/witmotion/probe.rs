//! Asks a port for a WitMotion sensor.

use super::wire::{self, FRAME, START, register};
use crate::probe::{Identity, Inquiry, Listener, Question};
use crate::sample::Timestamp;
use crate::session::SensorInfo;

/// Line rates, bit/s: of those with an adapter, of a new one, of the WT931, and of those that somebody has set.
pub const BAUD_RATES: [u32; 4] = [115_200, 9_600, 921_600, 230_400];

/// Bytes that are kept: several groups of all frames.
const KEPT: usize = 1024;
/// Frames in a row that prove it: a sum of one byte fits noise too often.
const IN_A_ROW: usize = 2;

/// An inquiry of 0.35 s; `now` is the time at which the port is open.
///
/// It asks for the accelerometer's registers, which disturbs nothing; a sensor that streams answers by that. Serial numbers are not
/// asked for.
pub fn inquiry(now: Timestamp) -> Inquiry {
    let question = Question::new(wire::read(register::ACCELERATION), 350);
    Inquiry::new(now, vec![question], Box::new(Answers::default()))
}

#[derive(Debug, Default)]
struct Answers {
    bytes: Vec<u8>,
}

impl Answers {
    fn is_known(&self) -> bool {
        let is_frame = |at: usize| {
            let frame = self.bytes.get(at..).and_then(wire::parse);
            frame.is_some_and(|(kind, _)| (0x50..=0x5F).contains(&kind))
        };
        // An answer alone is one frame: that a line is silent before and behind it is proof, too.
        let alone = self.bytes.len() == FRAME && is_frame(0);
        let starts = (0..self.bytes.len()).filter(|&at| self.bytes[at] == START);
        alone || starts.into_iter().any(|at| (0..IN_A_ROW).all(|k| is_frame(at + k * FRAME)))
    }
}

impl Listener for Answers {
    fn listen(&mut self, bytes: &[u8]) {
        let room = KEPT.saturating_sub(self.bytes.len());
        self.bytes.extend(&bytes[..bytes.len().min(room)]);
    }

    fn has_answer(&self, _: usize) -> bool {
        self.bytes.len() > FRAME && self.is_known()
    }

    fn goes_on(&self, _: usize) -> bool {
        false
    }

    fn identity(&self) -> Option<Identity> {
        self.is_known().then(|| Identity {
            sensors: vec![SensorInfo { address: 0, serial: None }],
            ..Identity::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_frames_in_a_row_or_one_alone_are_a_sensor() {
        let asked = |bytes: &[u8]| {
            let mut inquiry = inquiry(Timestamp::ZERO);
            inquiry.handle_bytes(Timestamp::ZERO, bytes);
            while let Some(due) = inquiry.poll_timeout() {
                inquiry.handle_timeout(due);
            }
            inquiry.result().unwrap().is_ok()
        };
        let mut frame = Vec::new();
        wire::frame(wire::kind::ANGLE, [1, 2, 3, 4], &mut frame);
        assert!(asked(&frame) && asked(&[&[0x55, 0x01][..], &frame, &frame].concat()));
        let mut damaged = frame.clone();
        damaged[5] ^= 1;
        assert!(!asked(&damaged) && !asked(&[&frame[..], &damaged].concat()) && !asked(b""));
    }
}
