//! Asks an address for a MotionStar.

use super::wire::{Header, Packets, SystemStatus, kind};
use crate::probe::{Identity, Inquiry, Listener, Question};
use crate::rate::Rate;
use crate::sample::Timestamp;
use crate::session::SensorInfo;

/// An inquiry of at most 1.5 s; `now` is the time at which the socket is open.
///
/// It stops a stream, and wakes the system; it sets nothing. A unit's serial number and model are not asked for.
pub fn inquiry(now: Timestamp) -> Inquiry {
    let ask = |sequence, kind, wait_ms| {
        let mut packet = Vec::new();
        Header { sequence, kind, ..Header::default() }.encode(&[], &mut packet);
        Question::new(packet, wait_ms)
    };
    let questions =
        vec![ask(1, kind::STOP_DATA, 300), ask(2, kind::WAKE_UP, 500), ask(3, kind::GET_STATUS, 700)];
    Inquiry::new(now, questions, Box::new(Answers::default()))
}

#[derive(Debug, Default)]
struct Answers {
    packets: Packets,
    stopped: bool,
    awake: bool,
    system: Option<(SystemStatus, Option<(u8, u8)>)>,
}

impl Listener for Answers {
    fn listen(&mut self, bytes: &[u8]) {
        self.packets.push(bytes);
        while let Some(found) = self.packets.find() {
            match found.header.kind {
                kind::RSP_STOP_DATA | kind::RSP_ILLEGAL => self.stopped = true,
                kind::RSP_WAKE_UP => self.awake = true,
                kind::RSP_GET_STATUS if found.header.unit == 0 => {
                    let body = self.packets.body(found);
                    let revision = body.get(14).copied().zip(body.get(15).copied());
                    self.system = SystemStatus::parse(body).map(|system| (system, revision));
                }
                _ => {}
            }
        }
    }

    fn has_answer(&self, k: usize) -> bool {
        [self.stopped, self.awake, self.system.is_some()].get(k).is_some_and(|answered| *answered)
    }

    fn goes_on(&self, _: usize) -> bool {
        true
    }

    fn identity(&self) -> Option<Identity> {
        let (system, revision) = self.system.as_ref()?;
        let sensors: Vec<SensorInfo> =
            system.sensors().map(|address| SensorInfo { address: address.into(), serial: None }).collect();
        let problem = sensors.is_empty().then(|| {
            (
                "the system answers, but none of its units has a sensor".to_owned(),
                "plug in the sensors, and switch the system off and on".to_owned(),
            )
        });
        Some(Identity {
            model: None,
            revision: revision.map(|(major, minor)| format!("{major}.{minor}")),
            rate_hz: system.rate().ok().map(Rate::hz),
            sensors,
            problem,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_system_names_its_birds() {
        let now = Timestamp::ZERO;
        let mut inquiry = inquiry(now);
        let mut answer = |sequence, kind, body: &[u8]| {
            let mut packet = Vec::new();
            Header { sequence, kind, ..Header::default() }.encode(body, &mut packet);
            inquiry.handle_bytes(now, &packet);
        };
        answer(1, kind::RSP_STOP_DATA, &[]);
        answer(2, kind::RSP_WAKE_UP, &[]);
        let status =
            [0x84, 0, 3, 1, 0x10, b'1', b'0', b'3', b'3', b'0', b'0', 1, 3, 1, 1, 2, 0xD1, 0xE0, 0xE0];
        answer(3, kind::RSP_GET_STATUS, &status);
        let found = inquiry.result().unwrap().as_ref().unwrap();
        assert_eq!((found.rate_hz, found.revision.as_deref()), (Some(103.3), Some("1.2")));
        assert_eq!(found.sensors.iter().map(|sensor| sensor.address).collect::<Vec<_>>(), [2, 3]);
    }
}
