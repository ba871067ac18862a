//! Asks a port for an Xbus device.

use super::frame::Framer;
use super::message::{self, DeviceKind, MASTER};
use crate::probe::{Identity, Inquiry, Listener, Question};
use crate::sample::Timestamp;
use crate::session::SensorInfo;

/// Line rates, bit/s, the likeliest first.
pub const BAUD_RATES: [u32; 6] = [115_200, 460_800, 921_600, 230_400, 57_600, 38_400];

const IDENTIFY: usize = 2;
const FIND_TRACKERS: usize = 4;

/// An inquiry of about 0.3 s where nothing answers, up to 2.8 s where a chain does; `now` is the time at which the port is open.
///
/// A device that measures is stopped and goes on in the end; one that waited for settings measures from then on. RTS is left as
/// it is, though an Xbus Master does not transmit without it.
pub fn inquiry(now: Timestamp) -> Inquiry {
    let ask = |mid, wait_ms| Question::new(message::request(MASTER, mid, &[]), wait_ms);
    let questions = vec![
        ask(message::GOTO_CONFIG, 150),
        ask(message::GOTO_CONFIG, 150),
        ask(message::REQ_DEVICE_ID, 300),
        ask(message::REQ_FIRMWARE, 200),
        ask(message::INIT_BUS, 2000),
        ask(message::GOTO_MEASUREMENT, 20),
    ];
    Inquiry::new(now, questions, Box::new(Answers::default()))
}

#[derive(Debug, Default)]
struct Answers {
    framer: Framer,
    in_config: bool,
    device_id: Option<u64>,
    firmware: Option<String>,
    trackers: Option<Vec<u64>>,
}

impl Answers {
    fn is_chain(&self) -> bool {
        self.device_id.is_some_and(|id| DeviceKind::of(id) == DeviceKind::XbusMaster)
    }
}

impl Listener for Answers {
    fn listen(&mut self, bytes: &[u8]) {
        self.framer.push(bytes);
        while let Some(found) = self.framer.find() {
            let frame = self.framer.frame(found);
            const ACK: u8 = 1;
            match frame.mid.checked_sub(ACK) {
                Some(message::GOTO_CONFIG) => self.in_config = true,
                Some(message::REQ_DEVICE_ID) => self.device_id = message::device_id(frame.data),
                Some(message::REQ_FIRMWARE) => {
                    if let [major, minor, revision, ..] = frame.data {
                        self.firmware = Some(format!("{major}.{minor}.{revision}"));
                    }
                }
                Some(message::INIT_BUS) => {
                    self.trackers = Some(frame.data.chunks_exact(4).filter_map(message::device_id).collect());
                }
                _ => {}
            }
        }
    }

    fn has_answer(&self, k: usize) -> bool {
        match k {
            0 | 1 => self.in_config,
            IDENTIFY => self.device_id.is_some(),
            FIND_TRACKERS => self.trackers.is_some() || !self.is_chain(),
            k => k < FIND_TRACKERS && self.firmware.is_some(),
        }
    }

    fn goes_on(&self, k: usize) -> bool {
        k == 0 || self.in_config
    }

    fn identity(&self) -> Option<Identity> {
        let device_id = self.device_id?;
        let info =
            |(address, id): (u16, u64)| SensorInfo { address, serial: Some(message::device_id_text(id)) };
        let sensors: Vec<SensorInfo> = if self.is_chain() {
            (1..).zip(self.trackers.iter().flatten().copied()).map(info).collect()
        } else {
            vec![info((1, device_id))]
        };
        let model = match DeviceKind::of(device_id) {
            DeviceKind::XbusMaster => "Xbus Master",
            DeviceKind::Mt9 => "MT9",
            DeviceKind::MtiG => "MTi-G",
            DeviceKind::Mt | DeviceKind::Other => "MTi",
        };
        let problem = sensors.is_empty().then(|| {
            (
                "the Xbus Master answers, and finds no tracker".to_owned(),
                "check the cables of the chain, from the master on".to_owned(),
            )
        });
        Some(Identity {
            model: Some(model.to_owned()),
            revision: self.firmware.clone(),
            rate_hz: None,
            sensors,
            problem,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reply(mid: u8, data: &[u8]) -> Vec<u8> {
        message::request(MASTER, mid + 1, data)
    }

    #[test]
    fn a_chain_names_its_trackers_and_measures_on() {
        let now = Timestamp::ZERO;
        let mut inquiry = inquiry(now);
        let mut requested = Vec::new();
        while let Some(bytes) = inquiry.poll_transmit() {
            requested.push(bytes[2]);
            match bytes[2] {
                message::GOTO_CONFIG => {
                    // Data that were on their way do not matter.
                    inquiry.handle_bytes(now, &message::request(MASTER, message::MTDATA, &[0; 8]));
                    inquiry.handle_bytes(now, &reply(message::GOTO_CONFIG, &[]));
                }
                message::REQ_DEVICE_ID => inquiry.handle_bytes(now, &reply(0, &[0x00, 0x10, 0x00, 0x05])),
                message::REQ_FIRMWARE => inquiry.handle_bytes(now, &reply(bytes[2], &[2, 8, 1])),
                message::INIT_BUS => {
                    inquiry.handle_bytes(now, &reply(bytes[2], &[0, 0x34, 0x2D, 7, 0, 0x34, 0x2D, 8]));
                }
                _ => inquiry.handle_timeout(inquiry.poll_timeout().unwrap()),
            }
        }
        let found = inquiry.result().unwrap().as_ref().unwrap();
        assert_eq!((found.model.as_deref(), found.revision.as_deref()), (Some("Xbus Master"), Some("2.8.1")));
        let sensors: Vec<_> =
            found.sensors.iter().map(|s| (s.address, s.serial.as_deref().unwrap())).collect();
        assert_eq!(sensors, [(1, "00342D07"), (2, "00342D08")]);
        assert_eq!(requested.last(), Some(&message::GOTO_MEASUREMENT), "{requested:x?}");
    }

    #[test]
    fn where_nothing_answers_it_soon_gives_up() {
        let mut now = Timestamp::ZERO;
        let mut inquiry = inquiry(now);
        while let Some(due) = inquiry.poll_timeout() {
            now = due;
            inquiry.poll_transmit();
            inquiry.handle_timeout(now);
        }
        assert_eq!(inquiry.result(), Some(&Err(crate::probe::NoAnswer::Silent)));
        assert!(now.as_secs_f64() < 0.5, "{now:?}");
    }
}
