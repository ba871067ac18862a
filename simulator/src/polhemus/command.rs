//! What each command does.

use nalgebra::Vector3;
use posed_drivers::Timestamp;
use posed_drivers::polhemus::wire::{ACTIVE_STATIONS, POINT, WHO_AM_I};

use super::{CM, INCH, Polhemus};
use crate::chassis::{Chassis, Unit};

/// Longest line of a command.
const MAX_LINE: usize = 100;
/// The re-initialisation: control and Y.
const RESET: u8 = 0x19;
/// Length of what a unit says of itself, as one was seen to.
const WHO_LEN: usize = 195;

impl Polhemus {
    /// Works through the commands that are whole.
    pub(super) fn work(&mut self, chassis: &mut Chassis, t: Timestamp) {
        while let Some(first) = self.input.first().map(u8::to_ascii_uppercase) {
            if first == POINT {
                self.input.remove(0);
                self.point(chassis, t);
                continue;
            }
            let Some(end) = self.input.iter().position(|&byte| byte == b'\r') else {
                self.input.truncate(MAX_LINE);
                return;
            };
            let line: Vec<u8> = self.input.drain(..=end).take(end).collect();
            if !line.is_empty() {
                let arguments = String::from_utf8_lossy(&line[1..]).into_owned();
                self.line(chassis, t, first, &arguments);
            }
        }
    }

    /// One record of each station; a stream ends.
    fn point(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.is_continuous = false;
        for k in 0..self.ports.len() {
            if !chassis.is_gone(self.ports[k].station.address, t) {
                let record = self.record(chassis, k, POINT, t, self.next_frame.max(1) - 1);
                chassis.answer(t, &record);
            }
        }
    }

    fn line(&mut self, chassis: &mut Chassis, t: Timestamp, command: u8, arguments: &str) {
        let values: Vec<&str> = arguments.split(',').map(str::trim).collect();
        let of = |number: u8| values[0] == "*" || values[0].parse() == Ok(number);
        match (command, values[0]) {
            (b'C', _) => {
                self.is_continuous = true;
                self.wrong_until = None;
            }
            (b'F', "0" | "1") => self.text = values[0] == "0",
            (b'U', "0") => self.per_metre = INCH,
            (b'U', "1") => self.per_metre = CM,
            (b'O', _) => {
                let items: Vec<u8> = values[1..].iter().filter_map(|text| text.parse().ok()).collect();
                for port in self.ports.iter_mut().filter(|port| of(port.number())) {
                    port.items.clone_from(&items);
                }
            }
            (b'H', _) => {
                let zenith: Vec<f64> = values[1..].iter().filter_map(|text| text.parse().ok()).collect();
                if let [x, y, z] = zenith[..] {
                    for port in self.ports.iter_mut().filter(|port| of(port.number())) {
                        port.station.hemisphere = Vector3::new(x, y, z);
                    }
                }
            }
            (b'Q', "0") => self.counted_from = (t, self.next_frame),
            (ACTIVE_STATIONS, "0") => self.active(chassis, t),
            (WHO_AM_I, "") => self.who(chassis, t),
            (RESET, _) => {
                self.reset(chassis, t);
                chassis.power_cycle(t);
            }
            // Filters, boresight, alignment, tip: heard, and without effect here.
            (b'X' | b'Y' | b'B' | 0x02 | b'A' | b'N', _) => {}
            _ if self.text => {}
            _ => {
                let refusal = self.header(0, command, 1, 0);
                chassis.answer(t, &refusal);
            }
        }
    }

    fn active(&self, chassis: &mut Chassis, t: Timestamp) {
        // What the answer looks like as text is not known.
        if self.text {
            return;
        }
        let here = self.ports.iter().filter(|port| !chassis.is_gone(port.station.address, t));
        let map = here.fold(0_u16, |map, port| map | 1 << (port.number() - 1));
        let mut answer = self.header(0, ACTIVE_STATIONS, b' ', 4);
        answer.extend([map.to_le_bytes(), map.to_le_bytes()].concat());
        chassis.answer(t, &answer);
    }

    fn who(&self, chassis: &mut Chassis, t: Timestamp) {
        let text =
            format!("00 {:<width$}\r\n", format!("Polhemus {:?}, virtual", self.model), width = WHO_LEN - 5);
        if self.text {
            return chassis.answer(t, text.as_bytes());
        }
        let mut answer = self.header(0, WHO_AM_I, b' ', 8 + text.len());
        answer.extend([self.ports.len() as u8, self.model as u8, 0, 0, 0, 0, 0, 0]);
        answer.extend(text.bytes());
        chassis.answer(t, &answer);
    }
}
