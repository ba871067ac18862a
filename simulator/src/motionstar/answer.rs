//! What each packet of the host does.

use nalgebra::Vector3;
use posed_drivers::Timestamp;
use posed_drivers::flock::wire::Format;
use posed_drivers::motionstar::wire::{BIRD_STATUS, Header, kind};

use super::{MotionStar, SCALE_IN};
use crate::chassis::Chassis;

/// Errors: not understood; no such unit; illegal setup.
const NOT_UNDERSTOOD: u8 = 7;
const NO_SUCH_UNIT: u8 = 8;
const ILLEGAL_SETUP: u8 = 9;

/// The half-space of a hemisphere code, in the transmitter frame (z down).
pub(super) fn hemisphere(code: u8) -> Vector3<f64> {
    match code {
        1 => -Vector3::x(),
        2 => -Vector3::z(),
        3 => Vector3::z(),
        4 => -Vector3::y(),
        5 => Vector3::y(),
        _ => Vector3::x(),
    }
}

impl MotionStar {
    /// A packet of the host.
    pub(super) fn request(&mut self, chassis: &mut Chassis, t: Timestamp, header: Header, body: &[u8]) {
        let unit = header.unit;
        let (answer, error, data) = match header.kind {
            kind::WAKE_UP => {
                self.awake = true;
                (kind::RSP_WAKE_UP, 0, vec![])
            }
            kind::SHUT_DOWN => {
                self.awake = false;
                self.running = false;
                return;
            }
            kind::SYNC_SEQUENCE => (kind::RSP_SYNC_SEQUENCE, 0, vec![]),
            kind::STOP_DATA => {
                self.running = false;
                (kind::RSP_STOP_DATA, 0, vec![])
            }
            // Nothing else is for one that sleeps, and nothing is set while data run.
            kind::GET_STATUS | kind::SEND_SETUP | kind::RUN_CONTINUOUS if !self.awake || self.running => {
                (kind::RSP_ILLEGAL, 100, vec![])
            }
            kind::GET_STATUS if unit == 0 => (kind::RSP_GET_STATUS, 0, self.system_status(chassis, t)),
            kind::GET_STATUS => match self.bird_status(chassis, t, unit) {
                Some(status) => (kind::RSP_GET_STATUS, 0, status),
                None => (kind::RSP_ILLEGAL, NO_SUCH_UNIT, vec![]),
            },
            kind::SEND_SETUP => {
                let error = match unit {
                    0 => self.set_up_system(chassis, body),
                    _ => self.set_up_bird(unit, body),
                };
                (kind::RSP_SEND_SETUP, error.err().unwrap_or_default(), vec![])
            }
            kind::RUN_CONTINUOUS => {
                self.running = true;
                self.run_start = self.next_cycle;
                self.wrong_until = None;
                self.sequence = header.sequence.wrapping_add(1);
                (kind::RSP_RUN_CONTINUOUS, 0, vec![])
            }
            _ => (kind::RSP_UNKNOWN, NOT_UNDERSTOOD, vec![]),
        };
        let (seconds, millis) = self.stamp(chassis, t);
        let reply = Header {
            sequence: header.sequence,
            millis,
            seconds,
            kind: answer,
            unit,
            error,
            error_extension: 0,
        };
        let mut packet = Vec::new();
        reply.encode(&data, &mut packet);
        chassis.answer(t, &packet);
    }

    fn system_status(&self, chassis: &Chassis, t: Timestamp) -> Vec<u8> {
        let units = self.birds.last().map_or(1, |last| last.address());
        let mut body = vec![0x84, 0, units, 1, 0x10];
        body.extend(format!("{:06}", (self.rate_hz * 1000.0).round() as u32).bytes());
        body.extend([1, units, 1, 1, 2]);
        for address in 1..=units {
            let bird = self.birds.iter().find(|bird| bird.address() == address);
            body.push(match bird {
                Some(bird) if chassis.is_gone(bird.station.address, t) => 0,
                Some(_) => 0xE0,
                // The transmitter's own controller.
                None if address == 1 => 0xD1,
                None => 0,
            });
        }
        body
    }

    fn bird_status(&self, chassis: &Chassis, t: Timestamp, unit: u8) -> Option<Vec<u8>> {
        let mut body = vec![0; BIRD_STATUS];
        body[2..4].copy_from_slice(&[3, 67]);
        body[8..10].copy_from_slice(&SCALE_IN.to_be_bytes());
        body[11] = unit;
        match self.birds.iter().find(|bird| bird.address() == unit) {
            Some(bird) if chassis.is_gone(bird.station.address, t) => return None,
            Some(bird) => {
                body[0] = 0x44;
                body[1] = 6;
                body[5] = bird.setup;
                body[6] = (bird.format.words() as u8) << 4 | bird.format.status_code();
                body[7] = bird.report_every;
                body[10] = bird.hemisphere;
            }
            None if unit == 1 => {
                body[0] = 0x43;
                body[1] = 2;
                body[12] = 0x8C;
            }
            None => return None,
        }
        Some(body)
    }

    /// Some hosts send the first 16 bytes only.
    fn set_up_system(&mut self, chassis: &Chassis, body: &[u8]) -> Result<(), u8> {
        let digits = body.get(5..11).and_then(|digits| std::str::from_utf8(digits).ok());
        let rate_hz = digits.and_then(|digits| digits.trim().parse::<u32>().ok()).ok_or(ILLEGAL_SETUP)?;
        self.set_rate(chassis, (f64::from(rate_hz) / 1000.0).clamp(20.0, 144.0));
        Ok(())
    }

    fn set_up_bird(&mut self, unit: u8, body: &[u8]) -> Result<(), u8> {
        let bird = self.birds.iter_mut().find(|bird| bird.address() == unit).ok_or(NO_SUCH_UNIT)?;
        let &[setup, format, report_every, _, _, code] = body.get(5..11).ok_or(ILLEGAL_SETUP)? else {
            return Err(ILLEGAL_SETUP);
        };
        let known = Format::from_status_code(format & 0x0F)
            .filter(|known| known.words() == usize::from(format >> 4))
            .ok_or(ILLEGAL_SETUP)?;
        if body.len() != BIRD_STATUS || report_every == 0 || code > 5 {
            return Err(ILLEGAL_SETUP);
        }
        (bird.setup, bird.format, bird.report_every, bird.hemisphere) = (setup, known, report_every, code);
        bird.station.hemisphere = hemisphere(code);
        Ok(())
    }
}
