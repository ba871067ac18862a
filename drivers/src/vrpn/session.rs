//! The live session with a VRPN server: greet it, learn its numbers, take the poses of the trackers asked for.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, a greeting and pings, the state of the link.
//! Life: `Closed -> Greeting -> Receiving`; a server of another version leads to a pause. A server whose trackers are silent is
//! asked for a sign of life each second; one that gives none is greeted anew, which a server that has begun anew takes for the
//! first greeting, and one that hangs for a reason to hang up.
//!
//! Addresses of samples: sensor `s` of the tracker with number `n` (its place in the settings, from 1) is `256 * s + n`.

use std::time::Duration;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::reader::{Piece, Reader};
use super::wire::{self, CONTROL, From, GREETING, MAX_NAME, Message, Pose, system, types};
use crate::arrivals::Arrivals;
use crate::flock::SettingsError;
use crate::outbox::Outbox;
use crate::sample::{DeviceTime, Measurement, Sample, Timestamp};
use crate::session::{Counters, LineEvent, Output, SensorInfo, Session, State};

/// Time for the server's greeting.
const ANSWER: Duration = Duration::from_secs(3);
/// Pause after a server that does not speak VRPN 7.
const PAUSE: Duration = Duration::from_secs(5);
/// Silence of all trackers, and time between two signs of life that are asked for then.
const SILENCE: Duration = Duration::from_secs(1);
/// So many of them unanswered, and the server is greeted anew.
const PINGS: u8 = 4;
/// Most trackers.
const MOST: usize = 64;
/// The numbers of the trackers that are named in a sentence where one is missing.
const NAMED: usize = 8;
/// Our number for the type of pings.
const PING: i32 = 0;

/// Settings of a VRPN server.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Names of the trackers as the server has them, case included, in the order of their numbers; one at least.
    pub trackers: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Plain)]
enum Phase {
    Closed,
    Greeting { until: Timestamp },
    Receiving { until: Timestamp, pings: u8 },
    Pausing { until: Timestamp },
}

/// A live session with one server: samples are poses in the server's axes, of the trackers asked for.
///
/// Their time is the server's, µs since 1970. Nothing is lost on the way, and the server does not say what it left out: losses are
/// not counted. Whoever answers at the port is believed.
#[derive(Clone, Debug, posed_state::State)]
pub struct VrpnSession {
    #[state(keep)]
    trackers: Vec<String>,
    phase: Phase,
    reader: Reader,
    arrivals: Arrivals,
    outbox: Outbox,
    /// The server's number of each tracker.
    senders: Vec<Option<i32>>,
    /// Names of others, some of them.
    others: Vec<String>,
    /// Whether a pose has come since the greeting.
    received: bool,
    /// Of refused messages, and dropped in front of the session.
    refused_bytes: u64,
    /// The latest time of each sensor, µs.
    latest_us: Vec<Option<u64>>,
    sensors: Vec<SensorInfo>,
}

impl VrpnSession {
    /// A session for the sensors `wanted`, see the module for their addresses. Closed until the line opens.
    ///
    /// # Errors
    /// A name under `trackers` is empty, longer than 95 bytes or there twice, or there is none or more than 64; `wanted` is
    /// empty, names a sensor twice, or one of a tracker that the settings do not have.
    pub fn new(settings: Settings, wanted: &[u16]) -> Result<Self, SettingsError> {
        let trackers = settings.trackers;
        let is_name = |name: &String| (1..=MAX_NAME).contains(&name.len()) && !name.contains('\0');
        let distinct = trackers.iter().enumerate().all(|(k, name)| !trackers[..k].contains(name));
        if !(1..=MOST).contains(&trackers.len()) || !distinct || !trackers.iter().all(is_name) {
            let expected = "the different names that the server's trackers have, 1 to 64 of them";
            return Err(SettingsError { key: "trackers", expected });
        }
        let mut addresses = wanted.to_vec();
        addresses.sort_unstable();
        addresses.dedup();
        let in_range =
            addresses.iter().all(|address| (1..=trackers.len()).contains(&usize::from(address & 0xFF)));
        if addresses.is_empty() || addresses.len() != wanted.len() || !in_range {
            let expected = "256 * sensor + tracker, the tracker's number in `trackers` counting from 1";
            return Err(SettingsError { key: "address", expected });
        }
        Ok(Self {
            phase: Phase::Closed,
            reader: Reader::default(),
            arrivals: Arrivals::default(),
            outbox: Outbox::new(),
            senders: vec![None; trackers.len()],
            others: Vec::new(),
            received: false,
            refused_bytes: 0,
            latest_us: vec![None; addresses.len()],
            sensors: addresses.iter().map(|&address| SensorInfo { address, serial: None }).collect(),
            trackers,
        })
    }

    /// Says who we are, and expects the server to begin.
    fn greet(&mut self, now: Timestamp) {
        self.reader.begin();
        self.senders.fill(None);
        self.others.clear();
        self.received = false;
        self.latest_us.fill(None);
        self.outbox.transmit(GREETING.to_vec());
        self.phase = Phase::Greeting { until: now + ANSWER };
    }

    /// Asks for signs of life.
    fn ping(&mut self) {
        let mut bytes = Vec::new();
        for sender in (0..).take(self.trackers.len()) {
            wire::message(From { sender, kind: PING, utc_ns: 0 }, &[], &mut bytes);
        }
        self.outbox.transmit(bytes);
    }

    fn greeted(&mut self, now: Timestamp, greeting: [u8; 24]) {
        if !wire::is_version_7(&greeting) {
            let version = wire::version(&greeting);
            self.outbox.failed(format!("the server speaks VRPN {version}, and must speak 7"));
            self.phase = Phase::Pausing { until: now + PAUSE };
            return;
        }
        let mut bytes = Vec::new();
        for (number, name) in (0..).zip(&self.trackers) {
            wire::description(system::SENDER, number, name, 0, &mut bytes);
        }
        wire::description(system::TYPE, PING, types::PING, 0, &mut bytes);
        self.outbox.transmit(bytes);
        self.outbox.connecting("waiting for the first pose");
        self.phase = Phase::Receiving { until: now + SILENCE, pings: 0 };
    }

    /// Whose number is whose.
    fn described(&mut self, message: Message<'_>, bytes: usize) {
        let Ok((number, name)) = message.description() else { return self.refuse(bytes) };
        let mut is_wanted = false;
        for (sender, tracker) in self.senders.iter_mut().zip(&self.trackers) {
            // A number that changes its name is not what it was.
            *sender = sender.filter(|sender| *sender != number);
            if *tracker == name {
                *sender = Some(number);
                is_wanted = true;
            }
        }
        if !is_wanted && name != CONTROL && self.others.len() < NAMED && !self.others.contains(&name) {
            self.others.push(name);
        }
    }

    fn pose(&mut self, now: Timestamp, message: Message<'_>) {
        if !std::mem::replace(&mut self.received, true)
            && let Some(sentence) = self.unknown_tracker()
        {
            self.outbox.warn(now, 0, || sentence);
        }
        let Some(tracker) = self.senders.iter().position(|sender| *sender == Some(message.sender)) else {
            self.outbox.counters.records += 1;
            return;
        };
        let pose = match Pose::parse(message.payload) {
            Ok(pose) => pose,
            Err(bad) => {
                self.refuse(wire::HEADER + wire::POSE);
                let name = &self.trackers[tracker];
                let kind = 0x100 * (bad as u32 + 1) + tracker as u32;
                return self.outbox.warn(now, kind, || format!("a pose of {name:?} is not used: {bad}"));
            }
        };
        let address = u16::try_from(u64::from(pose.sensor) * 256 + tracker as u64 + 1);
        let place =
            address.ok().and_then(|address| self.sensors.iter().position(|info| info.address == address));
        let Some(place) = place else {
            self.outbox.counters.records += 1;
            return;
        };
        // The same measurement again, or a clock that stands still: then nobody knows when it was true.
        if self.latest_us[place].replace(message.utc_us) == Some(message.utc_us) {
            self.refuse(wire::HEADER + wire::POSE);
            let name = &self.trackers[tracker];
            return self.outbox.warn(now, 0x1000 + tracker as u32, || {
                format!("poses of {name:?} come with the time of the one before and are not used; look at the server's clock")
            });
        }
        self.outbox.counters.records += 1;
        self.phase = Phase::Receiving { until: now + SILENCE, pings: 0 };
        self.outbox.streaming();
        let Some(arrival) = self.arrivals.of(message.offset) else { return };
        self.outbox.sample(Sample {
            address: self.sensors[place].address,
            arrival,
            t_device: DeviceTime::Counter { ticks: message.utc_us, tick_s: 1e-6 },
            measurement: Measurement::Pose {
                position_m: Some(pose.position_m),
                clipped: false,
                orientation_wxyz: Some(pose.orientation_wxyz),
                button: None,
            },
        });
    }

    fn refuse(&mut self, bytes: usize) {
        self.outbox.counters.rejected += 1;
        self.refused_bytes += bytes as u64;
    }

    /// What is said where the server has not named a tracker.
    fn unknown_tracker(&self) -> Option<String> {
        let (name, _) = self.trackers.iter().zip(&self.senders).find(|(_, sender)| sender.is_none())?;
        let others: Vec<String> = self.others.iter().map(|name| format!("{name:?}")).collect();
        let has = if others.is_empty() { "no other one".to_owned() } else { others.join(", ") };
        Some(format!(
            "the server has not named a tracker {name:?} so far; beside those of the stage file it has {has}"
        ))
    }
}

impl Session for VrpnSession {
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { .. } => {
                self.arrivals.reopen();
                self.outbox.connecting("greeting the server");
                self.greet(now);
            }
            LineEvent::Closed { reason } => {
                self.reader.begin();
                self.phase = Phase::Closed;
                self.outbox.connecting(reason.clone());
            }
            LineEvent::Dropped { bytes } => {
                self.reader.interrupt();
                self.refused_bytes += bytes;
            }
        }
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.arrivals.read(now, bytes.len());
        // The messages lie in the reader while the session changes.
        let mut reader = std::mem::take(&mut self.reader);
        reader.push(bytes);
        while let Some(piece) = reader.find() {
            match (piece, self.phase) {
                (Piece::Greeting(greeting), Phase::Greeting { .. }) => self.greeted(now, greeting),
                (Piece::Greeting(_), _) => self.refuse(GREETING.len()),
                (Piece::Pose(message), Phase::Receiving { .. }) => self.pose(now, message),
                (Piece::Other(message), Phase::Receiving { until, .. }) => {
                    self.phase = Phase::Receiving { until, pings: 0 };
                    if message.kind == system::SENDER {
                        self.described(message, wire::HEADER + message.payload.len());
                    }
                }
                (Piece::Pose(_) | Piece::Other(_), _) => {}
            }
        }
        self.reader = reader;
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        if self.poll_timeout().is_none_or(|at| now < at) {
            return;
        }
        match self.phase {
            Phase::Closed => {}
            Phase::Greeting { .. } => {
                self.outbox
                    .silent("the server does not greet; check that a VRPN server listens at this port");
                self.greet(now);
            }
            Phase::Receiving { pings, .. } if pings < PINGS => {
                let reason = self.unknown_tracker().unwrap_or_else(|| {
                    "no pose any more; check that the trackers are switched on and in sight".to_owned()
                });
                self.outbox.silent(reason);
                self.ping();
                self.phase = Phase::Receiving { until: now + SILENCE, pings: pings + 1 };
            }
            Phase::Receiving { .. } => {
                self.outbox.silent("the server gives no sign of life; check its computer and the network");
                self.greet(now);
            }
            Phase::Pausing { .. } => self.greet(now),
        }
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        match self.phase {
            Phase::Closed => None,
            Phase::Greeting { until } | Phase::Receiving { until, .. } | Phase::Pausing { until } => {
                Some(until)
            }
        }
    }

    fn state(&self) -> &State {
        self.outbox.state()
    }

    fn counters(&self) -> Counters {
        Counters {
            rejected: self.outbox.counters.rejected + self.reader.rejected(),
            bytes_skipped: self.refused_bytes + self.reader.bytes_skipped(),
            ..self.outbox.counters
        }
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        None
    }
}
