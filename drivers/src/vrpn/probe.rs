//! Asks an address for a VRPN server.

use super::reader::{Piece, Reader};
use super::wire::{self, GREETING, Pose, system};
use crate::probe::{Identity, Inquiry, Listener, Question};
use crate::sample::Timestamp;
use crate::session::SensorInfo;

/// How long poses are listened to, ms: trackers that send more seldom are not found.
const LISTEN_MS: u64 = 1500;
/// Most trackers and sensors that are listed; their numbers must fit an address.
const MOST: usize = 64;

/// An inquiry of 1.5 s; `now` is the time at which the connection is open.
///
/// Sensors are those that report poses meanwhile, at the addresses that they have where `trackers` of the stage file lists the
/// names of all of them, each once, in this order. The serial number is the tracker's name.
pub fn inquiry(now: Timestamp) -> Inquiry {
    Inquiry::new(now, vec![Question::new(GREETING, LISTEN_MS)], Box::new(Answers::default()))
}

#[derive(Debug, Default)]
struct Answers {
    reader: Reader,
    version: Option<[u8; 24]>,
    names: Vec<(i32, String)>,
    /// Sender and sensor.
    seen: Vec<(i32, u32)>,
}

impl Listener for Answers {
    fn listen(&mut self, bytes: &[u8]) {
        self.reader.push(bytes);
        while let Some(piece) = self.reader.find() {
            match piece {
                Piece::Greeting(greeting) => self.version = Some(greeting),
                Piece::Pose(message) => {
                    let seen = Pose::parse(message.payload).map(|pose| (message.sender, pose.sensor));
                    if let Ok(seen) = seen
                        && seen.1 <= 0xFF
                        && self.seen.len() < MOST
                        && !self.seen.contains(&seen)
                    {
                        self.seen.push(seen);
                    }
                }
                Piece::Other(message) if message.kind == system::SENDER => {
                    if let Ok(described) = message.description()
                        && self.names.iter().all(|(number, _)| *number != described.0)
                    {
                        self.names.push(described);
                    }
                }
                Piece::Other(_) => {}
            }
        }
    }

    fn has_answer(&self, _: usize) -> bool {
        // Who reports poses shows with time.
        false
    }

    fn goes_on(&self, _: usize) -> bool {
        false
    }

    fn identity(&self) -> Option<Identity> {
        let greeting = self.version.as_ref()?;
        let mut seen = self.seen.clone();
        seen.sort_unstable();
        let mut trackers: Vec<i32> = seen.iter().map(|(sender, _)| *sender).collect();
        trackers.dedup();
        let sensor = |&(sender, sensor): &(i32, u32)| {
            let (_, name) = self.names.iter().find(|(number, _)| *number == sender)?;
            let place = trackers.iter().position(|tracker| *tracker == sender)?;
            Some(SensorInfo { address: (256 * sensor) as u16 + place as u16 + 1, serial: Some(name.clone()) })
        };
        let mut sensors: Vec<SensorInfo> = seen.iter().filter_map(sensor).collect();
        sensors.sort_by_key(|info| info.address);
        let problem = if !wire::is_version_7(greeting) {
            Some(("the server does not speak VRPN 7", "run a server of version 7"))
        } else if sensors.is_empty() {
            Some((
                "the server greets, but no tracker reports a pose",
                "switch the trackers on, and bring them in sight",
            ))
        } else {
            None
        };
        Some(Identity {
            model: None,
            revision: Some(wire::version(greeting)),
            rate_hz: None,
            sensors,
            problem: problem.map(|(problem, fix)| (problem.to_owned(), fix.to_owned())),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::wire::{From, types};
    use super::*;

    #[test]
    fn trackers_that_report_are_listed_with_their_names() {
        let now = Timestamp::ZERO;
        let mut inquiry = inquiry(now);
        assert_eq!(inquiry.poll_transmit().as_deref(), Some(&GREETING[..]));
        let mut bytes = GREETING.to_vec();
        for (number, name) in [(0, wire::CONTROL), (1, "Head"), (2, "Wand")] {
            wire::description(system::SENDER, number, name, 0, &mut bytes);
        }
        wire::description(system::TYPE, 4, types::POSE, 0, &mut bytes);
        for (sender, sensor) in [(2, 1), (1, 0), (2, 1), (2, 0)] {
            let from = From { sender, kind: 4, utc_ns: 0 };
            wire::pose(from, sensor, [0.0, 0.0, 1.7], [1.0, 0.0, 0.0, 0.0], &mut bytes);
        }
        inquiry.handle_bytes(now, &bytes);
        assert_eq!(inquiry.result(), None);
        inquiry.handle_timeout(inquiry.poll_timeout().unwrap());
        let found = inquiry.result().unwrap().as_ref().unwrap();
        let sensors: Vec<_> =
            found.sensors.iter().map(|info| (info.address, info.serial.as_deref().unwrap())).collect();
        assert_eq!(sensors, [(1, "Head"), (2, "Wand"), (256 + 2, "Wand")]);
        assert_eq!((found.revision.as_deref(), &found.problem), (Some("07.38"), &None));
    }
}
