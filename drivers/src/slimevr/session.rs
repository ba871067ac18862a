//! The server of SlimeVR trackers: handshakes, sensors, order of packets, pings.
//!
//! What comes in: chunks of envelopes (see [`crate::datagram`]), line events, timeouts. What goes out:
//! samples, envelopes to send, the state of the whole. A tracker is known by its network address (MAC), so
//! it may come back under another IP; one tracker never waits for another.
//!
//! Addresses of samples: sensor `s` of the tracker with number `n` (its place in the settings, from 1) is
//! `256 * s + n`.

mod receiver;

use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::time::Duration;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::hid::RECEIVER;
use super::order::Order;
use super::wire::{self, Handshake, Item, Packet, Refused};
use crate::arrivals::Arrivals;
use crate::datagram::{Datagram, datagrams};
use crate::flock::SettingsError;
use crate::outbox::Outbox;
use crate::sample::{Arrival, DeviceTime, Measurement, Sample, Timestamp};
use crate::session::{Condition, Counters, LineEvent, Loss, Output, SensorInfo, Session, State};

/// How often a tracker hears from the server.
const BEAT: Duration = Duration::from_millis(500);
/// After so much silence a tracker has timed out; after the longer one it is gone until its next handshake.
const TIMED_OUT_S: f64 = 1.0;
const GONE_S: f64 = 3.0;
/// How often a tracker looks at its sensors, s.
const INTERVAL_S: f64 = 0.01;
/// Most trackers that are served.
const MOST: usize = 64;
/// Most sensors of one tracker.
const MOST_SENSORS: u8 = 16;
/// Protocols before this one have acceleration in other axes.
const UNTURNED: u32 = 22;

/// Settings of SlimeVR trackers; every key has a default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Network addresses (MAC, `A4:CF:12:D4:E5:F6`) of the trackers, in the order of their numbers. Empty: any
    /// tracker is served, numbered as they come.
    pub trackers: Vec<String>,
}

/// Who a tracker is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
enum Identity {
    Mac([u8; 6]),
    /// Imitations without a network address of their own are known by their IP.
    Ip(std::net::IpAddr),
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mac([a, b, c, d, e, g]) => write!(f, "{a:02X}:{b:02X}:{c:02X}:{d:02X}:{e:02X}:{g:02X}"),
            Self::Ip(ip) => write!(f, "{ip}"),
        }
    }
}

fn parse_mac(text: &str) -> Option<[u8; 6]> {
    let mut parts = text.split([':', '-']);
    let mut mac = [0; 6];
    for byte in &mut mac {
        *byte = u8::from_str_radix(parts.next().filter(|part| part.len() == 2)?, 16).ok()?;
    }
    parts.next().is_none().then_some(mac)
}

/// The numbers of a version like `0.7.3`, `None` for what is not one.
fn version(text: &[u8]) -> Option<[u8; 3]> {
    let mut parts = std::str::from_utf8(text).ok()?.trim().split('.');
    let mut version = [0; 3];
    for part in &mut version {
        *part = parts.next()?.parse().ok()?;
    }
    parts.next().is_none().then_some(version)
}

#[derive(Clone, Debug, Plain)]
struct Tracker {
    number: u16,
    identity: Identity,
    /// `None` until it has come, and when it is gone.
    peer: Option<SocketAddr>,
    protocol: u32,
    order: Order,
    received_at: Timestamp,
    timed_out: bool,
    /// Whether it has measured something, and keeps its number.
    proven: bool,
    /// How often its button was pressed when it last said so; only of one that comes by radio.
    presses: u8,
}

impl Tracker {
    /// One of the settings that has not come yet.
    fn new(number: u16, identity: Identity) -> Self {
        Self {
            number,
            identity,
            peer: None,
            protocol: 0,
            order: Order::default(),
            received_at: Timestamp::ZERO,
            timed_out: false,
            proven: true,
            presses: 0,
        }
    }
}

/// The server of all trackers on one socket: samples are orientations (z up, heading of the tracker's own) and accelerations
/// without gravity, both computed by the tracker.
///
/// It answers whoever asks, unauthenticated: a device that claims the network address of a tracker is taken for it. What it answers
/// to one datagram is no longer than that datagram, or than one reply to a handshake. Where the settings name no trackers, one
/// that has only asked and never measured gives its number to the next, once it is gone or all 64 are taken: a stranger's
/// questions lock nobody out. Losses are estimates: packets are numbered, not samples.
#[derive(Clone, Debug, posed_state::State)]
pub struct SlimeVrSession {
    #[state(keep)]
    wanted: Vec<u16>,
    /// Whether trackers that the settings do not name are served.
    #[state(keep)]
    open_to_all: bool,
    trackers: Vec<Tracker>,
    /// By its number at a receiver: the place of a tracker; and since when that receiver has spoken.
    numbered: BTreeMap<u8, usize>,
    receiver_since: Option<Timestamp>,
    next_beat: Option<Timestamp>,
    beats: u32,
    arrivals: Arrivals,
    /// Bytes of all chunks so far.
    offset: u64,
    outbox: Outbox,
    bytes_skipped: u64,
    sensors: Vec<SensorInfo>,
    losses: Vec<Loss>,
    conditions: Vec<Condition>,
    /// Per sensor: when it last sent, and whether its tracker has had to come anew since.
    sent: Vec<(Option<Timestamp>, bool)>,
}

impl SlimeVrSession {
    /// A server for the sensors `wanted`, see the module for their addresses; up to 64 trackers with up to 16 sensors each.
    /// Closed until the line opens.
    ///
    /// # Errors
    /// A text under `trackers` is no network address, or is there twice, or there are too many; `wanted` is empty, names a
    /// sensor twice, or one of a tracker that the settings do not have.
    pub fn new(settings: Settings, wanted: &[u16]) -> Result<Self, SettingsError> {
        let bad = SettingsError {
            key: "trackers",
            expected: "different addresses like A4:CF:12:D4:E5:F6, 64 at most",
        };
        let macs: Vec<[u8; 6]> =
            settings.trackers.iter().map(|text| parse_mac(text).ok_or(bad)).collect::<Result<_, _>>()?;
        let distinct = macs.iter().enumerate().all(|(k, mac)| !macs[..k].contains(mac));
        if !distinct || macs.len() > MOST {
            return Err(bad);
        }
        let most = if macs.is_empty() { MOST } else { macs.len() };
        let mut addresses = wanted.to_vec();
        addresses.sort_unstable();
        addresses.dedup();
        let in_range = addresses.iter().all(|address| {
            (1..=most).contains(&usize::from(address & 0xFF)) && address >> 8 < MOST_SENSORS.into()
        });
        if addresses.is_empty() || addresses.len() != wanted.len() || !in_range {
            let expected = "256 * sensor + tracker, the tracker's number in `trackers` counting from 1";
            return Err(SettingsError { key: "address", expected });
        }
        Ok(Self {
            open_to_all: macs.is_empty(),
            trackers: (1..).zip(macs).map(|(number, mac)| Tracker::new(number, Identity::Mac(mac))).collect(),
            numbered: BTreeMap::new(),
            receiver_since: None,
            next_beat: None,
            beats: 0,
            arrivals: Arrivals::default(),
            offset: 0,
            outbox: Outbox::new(),
            bytes_skipped: 0,
            sensors: addresses.iter().map(|&address| SensorInfo { address, serial: None }).collect(),
            losses: addresses.iter().map(|&address| Loss { address, ..Loss::default() }).collect(),
            conditions: addresses.iter().map(|&address| Condition::unknown(address)).collect(),
            sent: vec![(None, false); addresses.len()],
            wanted: addresses,
        })
    }

    fn send(&mut self, peer: SocketAddr, data: &[u8]) {
        self.outbox.transmit(Datagram { peer, data }.encode());
    }

    fn refuse(&mut self, bytes: usize) {
        self.outbox.counters.rejected += 1;
        self.bytes_skipped += bytes as u64;
    }

    fn datagram(&mut self, now: Timestamp, offset: u64, datagram: Datagram<'_>) {
        if datagram.peer == RECEIVER {
            return self.report(now, offset, datagram.data);
        }
        let Some(packet) = wire::parse(datagram.data) else { return self.refuse(datagram.data.len()) };
        if packet.is_handshake() {
            return packet.items(|item| {
                if let Ok(Item::Handshake(handshake)) = item {
                    self.handshake(now, datagram.peer, handshake);
                }
            });
        }
        // Without a handshake nobody knows whose packet it is; the tracker looks for its server again in 3 s.
        let Some(k) = self.trackers.iter().position(|tracker| tracker.peer == Some(datagram.peer)) else {
            return self.refuse(datagram.data.len());
        };
        self.hear(now, k);
        if packet.number > 0 && !self.in_order(now, k, packet.number) {
            return self.refuse(datagram.data.len());
        }
        let Some(arrival) = self.arrivals.of(offset) else { return };
        self.packet(now, k, &datagram, packet, arrival);
    }

    /// Whether a packet is new; counts those that it shows to be missing.
    fn in_order(&mut self, now: Timestamp, k: usize, number: u64) -> bool {
        let tracker = &mut self.trackers[k];
        let Some(missing) = tracker.order.push(now, number) else { return false };
        if missing > 0 {
            let of = tracker.number;
            for loss in self.losses.iter_mut().filter(|loss| loss.address & 0xFF == of) {
                // Packets are numbered, not samples: one may have held several, or none of this sensor.
                loss.lost += missing;
                loss.estimated = true;
            }
        }
        true
    }

    fn handshake(&mut self, now: Timestamp, peer: SocketAddr, handshake: Handshake<'_>) {
        let identity = handshake.mac.map_or(Identity::Ip(peer.ip()), Identity::Mac);
        let Some(k) = self.admit(now, identity) else { return };
        // Whoever had this endpoint before has it no more.
        for tracker in &mut self.trackers {
            if tracker.peer == Some(peer) {
                tracker.peer = None;
            }
        }
        self.arrive(now, k, peer);
        self.trackers[k].protocol = handshake.protocol;
        let (number, firmware) = (self.trackers[k].number, version(handshake.firmware));
        self.conditions_of(number).for_each(|condition| condition.firmware = firmware);
        self.send(peer, &wire::handshake_reply());
    }

    /// The place of a tracker, if it is served.
    fn admit(&mut self, now: Timestamp, identity: Identity) -> Option<usize> {
        if let Some(k) = self.trackers.iter().position(|tracker| tracker.identity == identity) {
            return Some(k);
        }
        let Some(k) = self.place(now) else {
            self.outbox.warn(now, 1, || {
                format!(
                    "tracker {identity} wants to join; add it to `trackers` in the stage file to serve it"
                )
            });
            return None;
        };
        let number = k as u16 + 1;
        let newcomer = Tracker { received_at: now, proven: false, ..Tracker::new(number, identity) };
        match self.trackers.get_mut(k) {
            Some(unproven) => *unproven = newcomer,
            None => self.trackers.push(newcomer),
        }
        self.numbered.retain(|_, of| *of != k);
        self.outbox.warn(now, 0x200 + u32::from(number), || {
            format!("{identity} is tracker {number}; name it under `trackers` to keep that number")
        });
        Some(k)
    }

    /// A tracker has come, from where it was or from elsewhere.
    fn arrive(&mut self, now: Timestamp, k: usize, peer: SocketAddr) {
        let tracker = &mut self.trackers[k];
        tracker.peer = Some(peer);
        tracker.order = Order::default();
        tracker.received_at = now;
        tracker.timed_out = false;
        let (number, serial) = (tracker.number, tracker.identity.to_string());
        let mine = |address: u16| address & 0xFF == number;
        for (address, (_, anew)) in self.wanted.iter().zip(&mut self.sent) {
            *anew |= mine(*address);
        }
        for sensor in self.sensors.iter_mut().filter(|sensor| mine(sensor.address)) {
            let index = sensor.address >> 8;
            sensor.serial = Some(if index == 0 { serial.clone() } else { format!("{serial}/{index}") });
        }
        self.next_beat.get_or_insert(now + BEAT);
    }

    /// A tracker has said something.
    fn hear(&mut self, now: Timestamp, k: usize) {
        let tracker = &mut self.trackers[k];
        tracker.received_at = now;
        if std::mem::take(&mut tracker.timed_out) {
            let number = tracker.number;
            self.outbox.warn(now, 0x100 + u32::from(number), || format!("tracker {number} is back"));
        }
    }

    /// Where a tracker that nobody knows may be: in the place of one that never measured and is gone, else in a new one, else in
    /// that of the one which has kept its place for nothing longest.
    fn place(&self, now: Timestamp) -> Option<usize> {
        if !self.open_to_all {
            return None;
        }
        let unproven = || self.trackers.iter().enumerate().filter(|(_, tracker)| !tracker.proven);
        let gone = |tracker: &Tracker| now.seconds_since(tracker.received_at) >= GONE_S;
        if let Some((k, _)) = unproven().find(|(_, tracker)| gone(tracker)) {
            return Some(k);
        }
        if self.trackers.len() < MOST {
            return Some(self.trackers.len());
        }
        unproven().min_by_key(|(_, tracker)| tracker.received_at).map(|(k, _)| k)
    }

    fn packet(
        &mut self,
        now: Timestamp,
        k: usize,
        datagram: &Datagram<'_>,
        packet: Packet<'_>,
        arrival: Arrival,
    ) {
        let number = self.trackers[k].number;
        let t_device = DeviceTime::Cycle(packet.number);
        let mut bytes_left = datagram.data.len();
        let mut answer = |session: &mut Self, data: &[u8]| {
            let left = bytes_left.checked_sub(data.len());
            bytes_left = left.unwrap_or_default();
            if left.is_some() {
                session.send(datagram.peer, data);
            }
        };
        packet.items(|item| {
            let mut sample = |sensor: u8, orientation_wxyz, acceleration_m_s2: Option<[f64; 3]>| {
                let tracker = &mut self.trackers[k];
                tracker.proven = true;
                let turned = tracker.protocol >= UNTURNED;
                self.motion(
                    u16::from(sensor) << 8 | number,
                    arrival,
                    t_device,
                    orientation_wxyz,
                    // Up to protocol 21 the mounting's quarter turn about z is left to the server.
                    acceleration_m_s2.map(|[x, y, z]| if turned { [x, y, z] } else { [y, -x, z] }),
                );
            };
            match item {
                Ok(Item::Rotation { sensor, orientation_wxyz }) => {
                    sample(sensor, Some(orientation_wxyz), None)
                }
                Ok(Item::Acceleration { sensor, acceleration_m_s2 }) => {
                    sample(sensor, None, Some(acceleration_m_s2))
                }
                Ok(Item::Motion { sensor, orientation_wxyz, acceleration_m_s2 }) => {
                    sample(sensor, Some(orientation_wxyz), Some(acceleration_m_s2));
                }
                Ok(Item::SensorInfo(info)) => {
                    answer(self, &wire::sensor_info_ack(info.sensor, info.state));
                    let sensor = info.sensor;
                    if info.state == 2 {
                        self.outbox.warn(now, 0x300 + (u32::from(number) << 8) + u32::from(sensor), || {
                            format!("sensor {sensor} of tracker {number} has failed; restart the tracker")
                        });
                    }
                }
                Ok(Item::FeatureFlags) => answer(self, &wire::feature_flags()),
                Ok(Item::Error { sensor, code }) => {
                    self.outbox.warn(now, 0x1_0000 + (u32::from(number) << 8) + u32::from(sensor), || {
                        format!("sensor {sensor} of tracker {number} reports error {code}")
                    });
                }
                Ok(Item::Action(wire::FULL_RESET | wire::YAW_RESET)) => self.outbox.heading_reset(number),
                Ok(Item::Battery { level, volts }) => {
                    self.conditions_of(number).for_each(|condition| {
                        (condition.battery, condition.battery_v) = (Some(level), volts);
                    });
                }
                Ok(Item::Signal { strength_dbm }) => {
                    self.conditions_of(number)
                        .for_each(|condition| condition.signal_dbm = Some(strength_dbm));
                }
                Ok(_) => {}
                Err(Refused) => self.outbox.counters.rejected += 1,
            }
        });
    }

    fn motion(
        &mut self,
        address: u16,
        arrival: Arrival,
        t_device: DeviceTime,
        orientation_wxyz: Option<[f64; 4]>,
        linear_acceleration_m_s2: Option<[f64; 3]>,
    ) {
        let Some(index) = self.wanted.iter().position(|wanted| *wanted == address) else { return };
        self.count_absence(index, arrival.t_read);
        self.outbox.counters.records += 1;
        self.outbox.streaming();
        self.outbox.sample(Sample {
            address,
            arrival,
            t_device,
            measurement: Measurement::Imu {
                angular_velocity_rad_s: None,
                specific_force_m_s2: None,
                linear_acceleration_m_s2,
                magnetic_field: None,
                orientation_wxyz,
            },
        });
    }

    /// Of all sensors of a tracker.
    fn conditions_of(&mut self, number: u16) -> impl Iterator<Item = &mut Condition> {
        self.conditions.iter_mut().filter(move |condition| condition.address & 0xFF == number)
    }

    /// Nothing is known any more of a tracker that is gone.
    fn forget_condition(&mut self, number: u16) {
        self.conditions_of(number).for_each(|condition| {
            let registered = condition.registered;
            *condition = Condition { registered, ..Condition::unknown(condition.address) };
        });
    }

    /// While a tracker is without its server it sends nothing that could be counted: time alone tells what was missed.
    fn count_absence(&mut self, index: usize, now: Timestamp) {
        let (last, anew) = &mut self.sent[index];
        let anew = std::mem::take(anew);
        if let Some(last) = last.replace(now).filter(|_| anew) {
            let missed = ((now.seconds_since(last) / INTERVAL_S).round() as u64).saturating_sub(1);
            self.losses[index].lost += missed;
            self.losses[index].estimated |= missed > 0;
        }
    }

    fn beat(&mut self, now: Timestamp) {
        self.beats = self.beats.wrapping_add(1);
        for k in 0..self.trackers.len() {
            let tracker = &mut self.trackers[k];
            let Some(peer) = tracker.peer else { continue };
            let silent_s = now.seconds_since(tracker.received_at);
            let number = tracker.number;
            if silent_s >= GONE_S {
                tracker.peer = None;
                self.forget_condition(number);
                self.outbox.warn(now, 0x400 + u32::from(number), || {
                    format!("tracker {number} is gone; check its battery and the network")
                });
                continue;
            }
            if silent_s >= TIMED_OUT_S && !tracker.timed_out {
                tracker.timed_out = true;
                self.outbox.warn(now, 0x500 + u32::from(number), || format!("tracker {number} is silent"));
            }
            // A receiver hears nothing.
            if peer != RECEIVER {
                self.send(peer, &wire::heartbeat());
                self.send(peer, &wire::ping(self.beats));
            }
        }
        let any = self.trackers.iter().any(|tracker| tracker.peer.is_some());
        self.next_beat = any.then(|| now + BEAT);
        if self.trackers.iter().all(|tracker| tracker.peer.is_none() || tracker.timed_out) {
            self.outbox.silent("no tracker sends; switch them on, in the same network as this computer");
        }
    }
}

impl Session for SlimeVrSession {
    fn handle_line(&mut self, _: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { .. } => {
                self.arrivals.reopen();
                self.outbox.connecting("waiting for trackers");
            }
            LineEvent::Closed { reason } => {
                for tracker in &mut self.trackers {
                    tracker.peer = None;
                }
                self.numbered.clear();
                self.receiver_since = None;
                for condition in &mut self.conditions {
                    *condition = Condition::unknown(condition.address);
                }
                self.next_beat = None;
                self.outbox.connecting(reason.clone());
            }
            LineEvent::Dropped { bytes } => self.bytes_skipped += bytes,
        }
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.arrivals.read(now, bytes.len());
        let mut offset = self.offset;
        self.offset += bytes.len() as u64;
        for found in datagrams(bytes) {
            match found {
                Ok(datagram) => {
                    self.datagram(now, offset, datagram);
                    offset += datagram.envelope_len() as u64;
                }
                Err(len) => self.refuse(len),
            }
        }
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        if self.next_beat.is_some_and(|at| at <= now) {
            self.beat(now);
        }
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        self.next_beat
    }

    fn state(&self) -> &State {
        self.outbox.state()
    }

    fn counters(&self) -> Counters {
        Counters { bytes_skipped: self.bytes_skipped, ..self.outbox.counters }
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        // Trackers send on change only, up to their own 100 Hz.
        None
    }

    fn losses(&self) -> &[Loss] {
        &self.losses
    }

    fn conditions(&self) -> &[Condition] {
        &self.conditions
    }
}
