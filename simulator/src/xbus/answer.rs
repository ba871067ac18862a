//! What each message of the host does.

use posed_drivers::Timestamp;
use posed_drivers::xbus::message::{self, Configuration, MASTER};
use posed_drivers::xbus::mtdata::Layout;
use posed_drivers::xbus::mtdata2::id;
use posed_drivers::xbus::{Frame, frame::MAX_DATA};

use super::{ALWAYS, SCAN, State, Xbus};
use crate::chassis::Chassis;
use crate::scenario::Personality;

/// Error: the message is not implemented; a parameter is invalid; the period is too short.
const UNKNOWN: u8 = 0x04;
const INVALID: u8 = 0x21;
const TOO_SHORT: u8 = 0x18;
/// Greatest output rate of an MTi, Hz.
const MOST_HZ: u16 = 400;

impl Xbus {
    /// A message of the host.
    pub(super) fn request(&mut self, chassis: &mut Chassis, t: Timestamp, frame: Frame<'_>) {
        let Frame { bid, mid, data } = frame;
        let alone_or_bus = if self.is_chain() { self.bus.len() as u8 } else { 1 };
        let tracker = match bid {
            MASTER => None,
            1.. if bid <= alone_or_bus => Some(usize::from(bid) - 1),
            _ => return,
        };
        match (mid, self.state) {
            (_, State::Off) => {}
            (message::WAKE_UP_ACK, State::WakingUp { .. }) => self.state = State::Config,
            (message::GOTO_CONFIG, _) => {
                // Data that is still leaving arrives before the answer.
                self.state = State::Config;
                self.emit(t, bid, mid + 1, &[]);
            }
            (message::RESET, _) => {
                self.answers.clear();
                chassis.answer(t, &message::request(bid, mid + 1, &[]));
                let sent = t + std::time::Duration::from_secs_f64(chassis.transmitter.backlog_s(t));
                chassis.power_cycle(sent);
                crate::chassis::Unit::reset(self, chassis, sent);
            }
            // Everything else is for the configuration; a device that measures passes it over.
            (_, State::Config) => self.configure(chassis, t, bid, mid, data, tracker),
            _ => {}
        }
    }

    fn configure(
        &mut self,
        chassis: &mut Chassis,
        t: Timestamp,
        bid: u8,
        mid: u8,
        data: &[u8],
        tracker: Option<usize>,
    ) {
        let word = |data: &[u8]| data.first_chunk().map(|&word| u16::from_be_bytes(word));
        let long = |data: &[u8]| data.first_chunk().map(|&long| u32::from_be_bytes(long));
        // The tracker that a message is about: of a chain the one named, else the only one.
        let unit = match tracker {
            Some(k) if self.is_chain() => self.bus.get(k).copied(),
            _ => (!self.is_chain()).then_some(0),
        };
        let is_mti = self.personality == Personality::Mti;
        let answer: Result<Vec<u8>, u8> = match (mid, data.len()) {
            (message::GOTO_MEASUREMENT, 0) => {
                let bytes = self.message_len() + 5 + if self.message_len() > 254 { 2 } else { 0 };
                if chassis.transmitter.duration_s(bytes) * self.rate_hz() > 1.0 {
                    Err(if is_mti { 0x29 } else { TOO_SHORT })
                } else if self.message_len() > MAX_DATA {
                    Err(0x1A)
                } else {
                    self.emit(t, bid, mid + 1, &[]);
                    self.measure(chassis, t);
                    return;
                }
            }
            (message::REQ_DEVICE_ID, 0) => {
                let id = match tracker {
                    Some(_) => unit.map_or(0, |k| self.trackers[k].device_id),
                    None => self.device_id(),
                };
                Ok(id.to_be_bytes().into())
            }
            (message::INIT_BUS, 0) if self.is_chain() => {
                self.scan(chassis, t);
                let ids = self
                    .bus
                    .iter()
                    .flat_map(|&k| self.trackers[k].device_id.to_be_bytes())
                    .collect::<Vec<_>>();
                self.emit(t + SCAN, bid, mid + 1, &ids);
                return;
            }
            // Bus power.
            (0x08, 0 | 2) if self.is_chain() => Ok(vec![]),
            (message::PERIOD, 0) => Ok(self.period_ticks.to_be_bytes().into()),
            (message::PERIOD, 2) if is_mti => Err(UNKNOWN),
            (message::PERIOD, 2) => match word(data) {
                Some(ticks) if ticks >= 225 => {
                    self.period_ticks = ticks;
                    Ok(vec![])
                }
                _ => Err(0x03),
            },
            // Data length of a tracker's block.
            (0x0A, 0) => unit.map(|k| (self.block_len(k) as u16).to_be_bytes().into()).ok_or(INVALID),
            (message::REQ_CONFIGURATION, 0) => Ok(self.configuration().encode()),
            (message::REQ_FIRMWARE, 0) => Ok(vec![2, 4, 0]),
            // Baud rate, product code, battery level.
            (0x18, 0) => Ok(vec![0x02]),
            (0x18, 1) => Ok(vec![]),
            (0x1C, 0) => Ok(format!("{:<20}", if self.is_chain() { "XM-B" } else { "MTi" }).into_bytes()),
            (0x88, 0) if self.is_chain() => Ok(vec![83]),
            (message::OUTPUT_CONFIGURATION, 0) if is_mti => Ok(self.output_list()),
            (message::OUTPUT_CONFIGURATION, _) if is_mti => match message::output_configuration(data) {
                Some(list) if list.len() <= 32 => {
                    self.outputs = list.into_iter().filter_map(|(id, hz)| granted(id, hz)).collect();
                    Ok(self.output_list())
                }
                _ => Err(INVALID),
            },
            (message::OUTPUT_MODE, 0) if !is_mti => {
                unit.map(|k| self.trackers[k].layout.mode.to_be_bytes().into()).ok_or(INVALID)
            }
            (message::OUTPUT_SETTINGS, 0) if !is_mti => {
                unit.map(|k| self.trackers[k].layout.settings.to_be_bytes().into()).ok_or(INVALID)
            }
            (message::OUTPUT_MODE, 2) if !is_mti => self.set_layout(unit, |layout| {
                layout.mode = word(data).unwrap_or_default();
            }),
            (message::OUTPUT_SETTINGS, 4) if !is_mti => self.set_layout(unit, |layout| {
                layout.settings = long(data).unwrap_or_default();
            }),
            // Output skip factor: on a chain it is folded into the period.
            (0xD4, 0) if !self.is_chain() => Ok(self.skip_factor.to_be_bytes().into()),
            (0xD4, 2) if self.personality == Personality::Mtx => {
                self.skip_factor = word(data).unwrap_or_default().min(1000);
                Ok(vec![])
            }
            // Error mode.
            (0xDA | 0x82, 0) => Ok(self.error_mode.to_be_bytes().into()),
            (0xDA | 0x82, 2) => match word(data) {
                Some(mode) if mode <= 3 => {
                    self.error_mode = mode;
                    Ok(vec![])
                }
                _ => Err(INVALID),
            },
            // Transmit delay, reset of the orientation, object alignment.
            (0xDC | 0xA4, 2) => Ok(vec![]),
            (0xE0, 0) => Ok([1f32, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
                .iter()
                .flat_map(|v| v.to_be_bytes())
                .collect()),
            (0xE0, 36) => Ok(vec![]),
            _ => Err(UNKNOWN),
        };
        match answer {
            Ok(data) => self.emit(t, bid, mid + 1, &data),
            Err(code) => self.emit(t, MASTER, message::ERROR, &[code]),
        }
    }

    fn set_layout(&mut self, unit: Option<usize>, change: impl FnOnce(&mut Layout)) -> Result<Vec<u8>, u8> {
        let tracker = &mut self.trackers[unit.ok_or(INVALID)?];
        let mut layout = tracker.layout;
        change(&mut layout);
        layout.check().map_err(|_| INVALID)?;
        tracker.layout = layout;
        Ok(vec![])
    }

    fn output_list(&self) -> Vec<u8> {
        self.outputs.iter().flat_map(|&(id, hz)| [id, hz]).flat_map(u16::to_be_bytes).collect()
    }

    /// What the host is reported that the device is set to.
    pub(super) fn configuration(&self) -> Configuration {
        let on_bus: Vec<usize> = if self.is_chain() { self.bus.clone() } else { vec![0] };
        let tracker = |&k: &usize| message::Tracker {
            device_id: if self.is_chain() { self.trackers[k].device_id } else { self.device_id() },
            data_len: self.block_len(k) as u16,
            layout: self.trackers[k].layout,
        };
        Configuration {
            master_id: self.device_id().into(),
            period_ticks: self.period_ticks,
            skip_factor: self.skip_factor,
            trackers: on_bus.iter().map(tracker).collect(),
        }
    }

    /// The rate that all output rates divide.
    pub(super) fn base_hz(&self) -> u16 {
        self.outputs.iter().map(|&(_, hz)| hz).filter(|&hz| hz != ALWAYS).max().unwrap_or(100).max(1)
    }
}

/// What an MTi makes of a request for an output; absent: it does not have it.
fn granted(id: u16, hz: u16) -> Option<(u16, u16)> {
    match id & 0xFFF0 {
        id::PACKET_COUNTER
        | id::SAMPLE_TIME_FINE
        | id::SAMPLE_TIME_COARSE
        | id::STATUS_WORD
        | id::STATUS_BYTE => Some((id, ALWAYS)),
        id::QUATERNION | id::EULER | id::ACCELERATION | id::RATE_OF_TURN | id::FREE_ACCELERATION => {
            Some((id, if hz == 0 || hz > MOST_HZ { MOST_HZ } else { hz }))
        }
        // The magnetometer has a rate of its own.
        id::MAGNETIC_FIELD => Some((id, if hz == 0 || hz > 100 { 100 } else { hz })),
        id::TEMPERATURE => Some((id, 1)),
        _ => None,
    }
}
