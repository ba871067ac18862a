//! Records and answers onto the wire, paced at the line's rate.

use posed_drivers::Timestamp;
use posed_drivers::flock::wire::record::{encode_words, pose_words};
use posed_drivers::flock::wire::{QuaternionSense, Scale, Shape};

use super::VirtualFlock;
use crate::device::DeviceOutput;
use crate::line::{RecordByte, WireByte};
use crate::truth::Loss;

/// Bytes of answers that a unit keeps while XOFF holds them back.
const HELD_BACK_MAX: usize = 1024;

impl VirtualFlock {
    /// Streams a frame, unless the last one is still on its way: then the whole frame is left out.
    pub(super) fn send_frame(&mut self, t: Timestamp) {
        if self.xoff || self.line_free > t {
            let loss = Loss { cycle: self.present_cycle, address: None };
            self.output.push_back(DeviceOutput::Lost(loss));
            return;
        }
        self.send_records(t, 0);
    }

    /// Answers POINT; a unit that does not run has nothing to say.
    pub(super) fn send_point(&mut self, t: Timestamp, unit: usize) {
        if !self.xoff {
            self.send_records(t, unit);
        }
    }

    /// The record of one unit, or in group mode those of all running units with a sensor, by address.
    fn send_records(&mut self, t: Timestamp, unit: usize) {
        let mut bytes = Vec::new();
        let mut places = Vec::new();
        let units = if self.group { 0..self.units.len() } else { unit..unit + 1 };
        for index in units {
            if !self.is_running(index) || !self.is_accessible(index, t) {
                continue;
            }
            let before = bytes.len();
            if self.encode(index, &mut bytes) {
                let address = self.units[index].address;
                places.extend((0..bytes.len() - before).map(|i| (address, i as u16)));
            }
        }
        let frame_len = bytes.len() as u16;
        let cycle = self.present_cycle;
        let records = places.into_iter().enumerate().map(|(frame_index, (address, index))| {
            let address = Some(u16::from(address));
            Some(RecordByte { cycle, address, index, frame_index: frame_index as u16, frame_len })
        });
        let records: Vec<_> = records.collect();
        self.send(t, &bytes, records);
    }

    /// Appends the record of a unit; `false` where it has no measurement.
    fn encode(&self, index: usize, out: &mut Vec<u8>) -> bool {
        let unit = &self.units[index];
        let Some(present) = unit.present else { return false };
        let range = unit.range(self.config.extended_range);
        let measured = unit.adjusted(&present, range);
        let (p, q) = (measured.position_m, measured.orientation);
        let scale = Scale { range, quaternion_sense: QuaternionSense::Vendor };
        let mut words = pose_words(p.into(), [q.w, q.i, q.j, q.k], unit.format, scale);
        if measured.gain != 1.0 {
            let first = if unit.format.has_position() { 3 } else { 0 };
            let is_rotation = matches!(unit.format.words() - first, 4 | 9);
            for word in words[first..unit.format.words()].iter_mut().filter(|_| is_rotation) {
                *word = (f64::from(*word) * measured.gain) as i16;
            }
        }
        let shape = Shape { format: unit.format, button: unit.button_mode, group: self.group };
        encode_words(&words, 0, unit.address, shape, out);
        true
    }

    pub(super) fn send_answer(&mut self, t: Timestamp, bytes: Vec<u8>) {
        if self.xoff {
            self.held_back.extend(bytes);
            self.held_back.truncate(HELD_BACK_MAX);
        } else {
            let records = vec![None; bytes.len()];
            self.send(t, &bytes, records);
        }
    }

    /// Puts bytes on the wire behind what is still leaving.
    fn send(&mut self, t: Timestamp, bytes: &[u8], records: Vec<Option<RecordByte>>) {
        if bytes.is_empty() {
            return;
        }
        let start = self.line_free.max(t).as_nanos();
        let bits = |n: usize| (n as i64 * 10_000_000_000) / i64::from(self.config.baud.max(1));
        let wire: Vec<WireByte> = bytes
            .iter()
            .zip(records)
            .enumerate()
            .map(|(i, (&byte, record))| WireByte {
                t: Timestamp::from_nanos(start + bits(i + 1)),
                byte,
                record,
            })
            .collect();
        self.line_free = Timestamp::from_nanos(start + bits(bytes.len()));
        self.output.push_back(DeviceOutput::Send(wire));
    }
}
