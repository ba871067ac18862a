//! What each command does.

use nalgebra::Vector3;
use posed_drivers::Timestamp;

use super::{CM, Fastrak, INCH};
use crate::chassis::{Chassis, Unit};

/// Longest line of a command.
const MAX_LINE: usize = 100;
/// The reset: control and Y.
const RESET: u8 = 0x19;

impl Fastrak {
    /// Works through the commands that are whole.
    pub(super) fn work(&mut self, chassis: &mut Chassis, t: Timestamp) {
        while let Some(&first) = self.input.first() {
            match first {
                b'P' | b'C' | b'c' | b'f' | b'F' | b'u' | b'U' | b'S' | RESET => {
                    self.input.remove(0);
                    self.letter(chassis, t, first);
                }
                b'\r' | b'\n' => {
                    self.input.remove(0);
                }
                _ => {
                    let Some(end) = self.input.iter().position(|&byte| byte == b'\r') else {
                        self.input.truncate(MAX_LINE);
                        return;
                    };
                    let line: Vec<u8> = self.input.drain(..=end).collect();
                    self.line(chassis, t, &String::from_utf8_lossy(&line[..end]));
                }
            }
        }
    }

    fn letter(&mut self, chassis: &mut Chassis, t: Timestamp, letter: u8) {
        match letter {
            b'P' => {
                for k in 0..self.stations.len() {
                    if self.stations[k].on && !chassis.is_gone(self.stations[k].station.address, t) {
                        let record = self.record(k, t);
                        chassis.answer(t, &record);
                    }
                }
            }
            b'C' => {
                self.continuous = true;
                self.turn = 0;
                self.wrong_until = None;
            }
            b'c' => self.continuous = false,
            b'f' => self.text = false,
            b'F' => self.text = true,
            b'u' => self.per_metre = CM,
            b'U' => self.per_metre = INCH,
            b'S' => {
                let station = self.stations.first().map_or(1, |stylus| stylus.number());
                let status =
                    format!("2{station}S{:3}{:3}{:6}{:>6}{:32}\r\n", "000", "", "", "2.37", "FASTRAK");
                chassis.answer(t, status.as_bytes());
            }
            _ => {
                self.reset(chassis, t);
                chassis.power_cycle(t);
            }
        }
    }

    /// A command with arguments.
    fn line(&mut self, chassis: &mut Chassis, t: Timestamp, line: &str) {
        let Some(command) = line.chars().next() else { return };
        let Some(rest) = line.get(1..) else { return };
        let mut arguments = rest.split(',');
        let number: u8 = arguments.next().and_then(|text| text.trim().parse().ok()).unwrap_or_default();
        let Some(stylus) = self.stations.iter_mut().find(|stylus| stylus.number() == number) else {
            // A station without a sensor cannot be switched on.
            if command == 'l' && rest.len() == 1 {
                chassis.answer(t, b"21l0000\r\n");
            }
            return;
        };
        let arguments: Vec<&str> = arguments.map(str::trim).collect();
        match command {
            'O' => stylus.items = arguments.iter().filter_map(|text| text.parse().ok()).collect(),
            'l' => match arguments.first() {
                Some(state) => stylus.on = *state == "1",
                None => {
                    let answer = format!("2{number}l{:04}\r\n", u8::from(stylus.on));
                    chassis.answer(t, answer.as_bytes());
                }
            },
            'H' => {
                let values: Vec<f64> = arguments.iter().filter_map(|text| text.parse().ok()).collect();
                if let [x, y, z] = values[..] {
                    stylus.station.hemisphere = Vector3::new(x, y, z);
                }
            }
            // Alignment, boresight, stylus, filters: heard, and without effect here.
            _ => {}
        }
    }
}
