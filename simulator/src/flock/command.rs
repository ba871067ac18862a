//! What each command does.

use std::time::Duration;

use nalgebra::Vector3;
use posed_drivers::Timestamp;
use posed_drivers::flock::Family;
use posed_drivers::flock::wire::value::{self, parameter};
use posed_drivers::flock::wire::{Addressed, BirdStatus, Command, Hemisphere, Refused, UnitStatus};

use super::unit::{knows, rotation_of_angles, rotation_of_sines};
use super::{Job, VirtualFlock};

/// Time that an auto-configuration takes.
const AUTO_CONFIG: Duration = Duration::from_millis(270);
/// The same of a 3D Guidance unit: drivers give it 600 ms.
const GUIDANCE_CONFIG: Duration = Duration::from_millis(590);
/// Model of the virtual 3D Guidance unit: what a real one writes is not known.
const GUIDANCE_MODEL: &[u8; 10] = b"3DGUIDANCE";
/// From POINT to the record's first bit.
const POINT: Duration = Duration::from_millis(3);
/// Input that a unit holds while it is busy; more is an overrun.
const INPUT_MAX: usize = 1024;

impl VirtualFlock {
    /// Reads waiting input until a command keeps the unit busy.
    pub(super) fn work(&mut self, t: Timestamp) {
        if self.input.len() > INPUT_MAX {
            self.input.truncate(INPUT_MAX);
            self.set_error(0, 11, 0);
        }
        while self.busy.is_none() {
            let Some(byte) = self.input.pop_front() else { return };
            match self.parser.push(byte) {
                None => {}
                Some(Ok(command)) => self.execute(t, command),
                Some(Err(refused)) => self.refuse(refused),
            }
        }
    }

    fn refuse(&mut self, _refused: Refused) {
        self.set_error(0, 6, 0);
    }

    fn execute(&mut self, t: Timestamp, Addressed { to, command }: Addressed) {
        let Some(index) = self.unit_of(to).filter(|&index| self.is_accessible(index, t)) else {
            self.set_error(0, 13, to.unwrap_or_default());
            return;
        };
        if !self.has_command(&command) {
            self.set_error(index, 6, 0);
            return;
        }
        let unit = &mut self.units[index];
        match command {
            Command::Format(format) => unit.format = format,
            Command::Hemisphere(bytes) => match Hemisphere::from_bytes(bytes) {
                Some(hemisphere) => unit.hemisphere = hemisphere,
                None => self.set_error(index, 6, 0),
            },
            Command::ButtonMode(on) => unit.button_mode = on,
            Command::ReferenceFrame1(words) => unit.reference_frame = rotation_of_sines(words),
            Command::ReferenceFrame2(words) => unit.reference_frame = rotation_of_angles(words),
            Command::AngleAlign1(words) => unit.angle_align = rotation_of_sines(words),
            Command::AngleAlign2(words) => unit.angle_align = rotation_of_angles(words),
            Command::Offset(words) => {
                unit.offset = Vector3::from(words.map(|word| f64::from(word) / 32768.0));
            }
            Command::Boresight => {
                unit.reference_frame = unit.present.map_or(unit.reference_frame, |m| m.orientation);
            }
            Command::RemoveBoresight => unit.reference_frame = Default::default(),
            Command::Point => {
                self.streaming = false;
                self.busy = Some((t + POINT, Job::Point(index)));
            }
            Command::Stream => {
                if !self.streaming {
                    self.settle_from(t);
                    self.last_frame = None;
                }
                self.streaming = true;
                if !self.configured {
                    self.set_error(0, 9, 0);
                }
            }
            Command::StreamStop => self.streaming = false,
            Command::ReportRate(rate) => self.report_every = rate.cycles(),
            Command::Run => {
                if std::mem::replace(&mut self.asleep, false) {
                    self.settle_from(t);
                }
            }
            Command::Sleep => {
                self.asleep = true;
                self.streaming = false;
            }
            Command::FbbReset => {
                for slave in 1..self.units.len() {
                    self.reset_unit(slave);
                }
                self.configured = self.config.stand_alone;
            }
            Command::NextTransmitter { address, .. } => {
                let there =
                    self.unit_of(Some(address)).is_some_and(|unit| self.config.units[unit].transmitter);
                if !there {
                    self.set_error(0, 29, address);
                }
            }
            Command::Xoff => self.xoff = true,
            Command::Xon => {
                self.xoff = false;
                let held_back = std::mem::take(&mut self.held_back);
                self.send_answer(t, held_back);
            }
            Command::FactoryTest => self.factory_test = true,
            Command::ReadMemory { .. } | Command::FactoryWord(_) if !self.factory_test => {
                self.set_error(index, 6, 0);
            }
            Command::ReadMemory { .. } | Command::ButtonRead | Command::MetalError => {
                self.answer(t, to, vec![0], None);
            }
            Command::FactoryWord(_) => self.answer(t, to, vec![0, 0], None),
            Command::Sync(255) => self.answer(t, to, vec![0; 4], None),
            Command::Sync(_) | Command::Metal(_) => {}
            Command::Examine(number) => self.examine(t, to, index, number),
            Command::Change { parameter, data } => self.change(t, index, parameter, data),
        }
    }

    /// Whether the unit has a command: of a 3D Guidance unit only those are taken which drivers have been seen to send.
    fn has_command(&self, command: &Command) -> bool {
        let family = self.config.family;
        match *command {
            _ if family == Family::Flock => true,
            Command::Format(format) => family.has_format(format),
            Command::Hemisphere(bytes) => {
                Hemisphere::from_bytes(bytes).is_some_and(|hemisphere| family.has_hemisphere(hemisphere))
            }
            Command::Examine(number) | Command::Change { parameter: number, .. } => family.knows(number),
            Command::Point | Command::Stream | Command::StreamStop | Command::Run | Command::Sleep => true,
            _ => false,
        }
    }

    /// Keeps the unit busy until its answer leaves.
    ///
    /// Delays as seen on real units: 4.5 ms to the first byte from a stand-alone unit, 7 to 11 ms from a
    /// pair, 42 to 52 ms for the flock's status; about half a millisecond of each is the byte itself.
    fn answer(&mut self, t: Timestamp, to: Option<u8>, bytes: Vec<u8>, number: Option<u8>) {
        let delay_us = match (number, to) {
            (Some(parameter::FLOCK_SYSTEM_STATUS), _) => 46_000,
            _ if self.config.stand_alone => 4_000,
            (_, Some(address)) if address != self.units[0].address => 9_000,
            _ => 8_000,
        };
        self.busy = Some((t + Duration::from_micros(delay_us), Job::Answer(bytes)));
    }

    fn examine(&mut self, t: Timestamp, to: Option<u8>, index: usize, number: u8) {
        if self.config.family == Family::Flock && !knows(self.config.revision, number) {
            self.set_error(index, 6, 0);
            return;
        }
        let addressing = self.config.addressing;
        let has_sensor = self.config.units[index].sensor.is_some() && !self.is_dead(index, t);
        let unit = &mut self.units[index];
        let bytes = match number {
            parameter::BIRD_STATUS => self.status(index).0.to_le_bytes().to_vec(),
            parameter::SOFTWARE_REVISION => self.config.revision.to_vec(),
            parameter::ERROR_CODE | parameter::EXPANDED_ERROR_CODE => {
                let error = std::mem::take(&mut unit.error);
                unit.error_waiting = false;
                error[..if number == parameter::ERROR_CODE { 1 } else { 2 }].to_vec()
            }
            parameter::MODEL_ID if self.config.family == Family::Guidance => GUIDANCE_MODEL.to_vec(),
            parameter::SENSOR_SERIAL if !has_sensor => vec![0, 0],
            parameter::MODEL_ID if self.config.units[index].extended_controller => b"6DERC     ".to_vec(),
            parameter::MODEL_ID => b"6DFOB     ".to_vec(),
            parameter::FBB_ADDRESSING_MODE => vec![addressing.code()],
            parameter::FBB_ADDRESS => vec![unit.address],
            parameter::HEMISPHERE => unit.hemisphere.bytes().to_vec(),
            parameter::REPORT_RATE => vec![self.report_every.min(127) as u8],
            parameter::GROUP_MODE => vec![u8::from(self.group)],
            parameter::FLOCK_SYSTEM_STATUS => self.flock_status(t),
            parameter::FBB_AUTO_CONFIG => self.configuration(t),
            _ => {
                let mut bytes = unit.parameters.get(&number).cloned().unwrap_or_default();
                bytes.resize(value::parameter(number).map_or(0, |p| p.read_len(addressing)), 0);
                bytes
            }
        };
        self.answer(t, to, bytes, Some(number));
    }

    fn change(&mut self, t: Timestamp, index: usize, number: u8, data: Vec<u8>) {
        if self.config.family == Family::Flock && !knows(self.config.revision, number) {
            self.set_error(index, 6, 0);
            return;
        }
        let word = |data: &[u8]| u16::from_le_bytes([data[0], data[1]]);
        match number {
            parameter::FBB_AUTO_CONFIG if self.config.stand_alone => self.set_error(index, 7, 0),
            parameter::FBB_AUTO_CONFIG => {
                self.streaming = false;
                let guidance = self.config.family == Family::Guidance;
                let time = if guidance { GUIDANCE_CONFIG } else { AUTO_CONFIG };
                self.busy = Some((t + time, Job::AutoConfig(data[0])));
            }
            parameter::GROUP_MODE => self.group = data[0] == 1 && !self.config.stand_alone,
            parameter::REPORT_RATE => self.report_every = u16::from(data[0].clamp(1, 127)),
            parameter::HEMISPHERE => match Hemisphere::from_bytes([data[0], data[1]]) {
                Some(hemisphere) => self.units[index].hemisphere = hemisphere,
                None => self.set_error(index, 6, 0),
            },
            parameter::MEASUREMENT_RATE => self.change_rate(t, index, value::rate_hz(word(&data))),
            parameter::RATE_COUNT => {
                let crystal_mhz = self.units[index].parameters[&parameter::CRYSTAL_SPEED][0];
                self.change_rate(t, index, value::rate_of_count_hz(word(&data), crystal_mhz));
            }
            0x17 | 0x18 => {
                let words = std::array::from_fn(|i| i16::from_le_bytes([data[2 * i], data[2 * i + 1]]));
                let unit = &mut self.units[index];
                let rotation = rotation_of_angles(words);
                if number == 0x17 {
                    unit.angle_align = rotation
                } else {
                    unit.reference_frame = rotation
                }
                unit.parameters.insert(number, data);
            }
            // One for all inputs.
            parameter::POSITION_SCALING if self.config.family == Family::Guidance => {
                for unit in &mut self.units {
                    unit.parameters.insert(number, vec![data[0], 0]);
                }
            }
            _ => {
                self.units[index].parameters.insert(number, data);
            }
        }
    }

    /// A new measurement rate; what a unit cannot have it refuses.
    fn change_rate(&mut self, t: Timestamp, index: usize, rate_hz: f64) {
        let possible_hz = match self.config.family {
            Family::Flock => 14.0..=144.0,
            family => family.rates_hz(),
        };
        if !possible_hz.contains(&rate_hz) {
            self.set_error(index, 6, 0);
            return;
        }
        self.set_rate(t, rate_hz);
        let parameters = &mut self.units[index].parameters;
        let crystal_mhz = parameters[&parameter::CRYSTAL_SPEED][0];
        let count = value::count_of_rate(rate_hz, crystal_mhz);
        parameters.insert(parameter::MEASUREMENT_RATE, value::rate_word(rate_hz).to_le_bytes().to_vec());
        parameters.insert(parameter::RATE_COUNT, count.to_le_bytes().to_vec());
    }

    /// What was being done is done.
    pub(super) fn finish(&mut self, t: Timestamp, job: Job) {
        match job {
            Job::Nothing => {}
            Job::Answer(bytes) => self.send_answer(t, bytes),
            Job::Point(unit) => self.send_point(t, unit),
            Job::AutoConfig(count) => {
                let silent = (0..usize::from(count))
                    .find(|&unit| unit >= self.units.len() || !self.is_accessible(unit, t));
                match silent {
                    None if count > 0 => {
                        self.configured = true;
                        self.asleep = false;
                        self.settle_from(t);
                    }
                    _ => self.set_error(0, 13, silent.map_or(0, |unit| unit as u8 + 1)),
                }
            }
        }
    }

    /// The status word of a unit.
    fn status(&self, index: usize) -> BirdStatus {
        let unit = &self.units[index];
        let expanded = self.config.addressing.code() != 0;
        let bits = [
            (index == 0, BirdStatus::MASTER),
            (self.configured, BirdStatus::INITIALISED),
            (unit.error_waiting, BirdStatus::ERROR),
            (self.is_running(index), BirdStatus::RUNNING),
            (expanded, BirdStatus::EXPANDED),
            (true, BirdStatus::NO_SYNC),
            (self.factory_test, BirdStatus::FACTORY_TEST),
            (self.xoff, BirdStatus::XOFF),
            (self.asleep, BirdStatus::ASLEEP),
            (self.streaming, BirdStatus::STREAMING),
        ];
        let word = bits.into_iter().filter(|&(on, _)| on).fold(0, |word, (_, bit)| word | bit);
        BirdStatus(word).with_format(unit.format)
    }

    /// One byte per address; all zeros from a stand-alone unit.
    fn flock_status(&self, t: Timestamp) -> Vec<u8> {
        let mut bytes = vec![0; usize::from(self.config.addressing.max_address())];
        if self.config.stand_alone {
            return bytes;
        }
        for (index, unit) in self.config.units.iter().enumerate() {
            if !self.is_accessible(index, t) {
                continue;
            }
            let bits = [
                (true, UnitStatus::ACCESSIBLE),
                (self.is_running(index), UnitStatus::RUNNING),
                (unit.sensor.is_some(), UnitStatus::SENSOR),
                (unit.extended_controller, UnitStatus::EXTENDED_RANGE),
                (unit.transmitter, 1),
            ];
            bytes[index] = bits.into_iter().filter(|&(on, _)| on).fold(0, |byte, (_, bit)| byte | bit);
        }
        bytes
    }

    /// The answer of parameter 50: mode, then bit maps of units present and dependent on the master.
    fn configuration(&self, t: Timestamp) -> Vec<u8> {
        let len =
            value::parameter(parameter::FBB_AUTO_CONFIG).map_or(5, |p| p.read_len(self.config.addressing));
        let mut bytes = vec![0; len];
        if self.config.stand_alone {
            return bytes;
        }
        bytes[0] = 1;
        let half = (len - 1) / 2;
        for index in (0..self.units.len()).filter(|&index| self.is_accessible(index, t)) {
            let (byte, bit) = ((index + 1) / 8, 1 << ((index + 1) % 8));
            if byte < half {
                bytes[1 + byte] |= bit;
                if self.configured {
                    bytes[1 + half + byte] |= bit;
                }
            }
        }
        bytes
    }
}
