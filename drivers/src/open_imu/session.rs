//! The live session with all devices of one port, whatever carries their messages.
//!
//! What comes in: bytes of a line, or envelopes of datagrams and text messages ([`crate::datagram`]); line events; timeouts. What goes
//! out: samples, answers, the state of the whole. A device is known by its identifier, and one never waits for another.
//!
//! Addresses of samples: sensor `s` of the device with number `n` (its place in the settings, from 1) is `256 * s + n`.

use std::net::SocketAddr;

use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::unit::{LOST_S, Presence, RATES_HZ, STALE_S, Unit, Verdict};
use super::wire::json::{self, Item, Problem, Reply};
use super::wire::{self, Count, Hello, Kind, Message, Motion, Refused, csv, osc};
use crate::arrivals::Arrivals;
use crate::datagram::{Datagram, datagrams};
use crate::flock::SettingsError;
use crate::outbox::Outbox;
use crate::sample::{Arrival, Measurement, Sample, Timestamp};
use crate::session::{Condition, Counters, Found, LineEvent, Loss, Output, SensorInfo, Session, State};
use crate::x_imu3::wire::Lines;

/// Most devices, named and found, that are followed at a time.
const MOST: usize = 64;
/// Most connections: each device has one, and some may come anew before the old one is known to be gone.
const MOST_CONNECTIONS: usize = 2 * MOST;
/// So many bad messages in a second close a connection.
const STRIKES: u32 = 3;
/// Strength of Earth's magnetic field that is taken for 1, µT; it is 25 to 65.
const FIELD_UT: f64 = 50.0;

/// Settings of devices that speak the open format; every key has a default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Identifiers of the devices (`esp-7f3a`), in the order of their numbers. Others are found, and feed nothing.
    pub devices: Vec<String>,
    /// Samples per second that devices are asked for, 1 to 1000; without it they send as they like.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub rate_hz: Option<f64>,
    /// Whether lines without a checksum are taken.
    pub unchecked_lines: bool,
}

/// What brings the messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// The bytes of a serial line or a TCP stream: lines of text.
    Line,
    /// Envelopes, each with one datagram or one text message of a connection. One without data ends a connection.
    Envelopes {
        /// The UDP port at which they come, for whoever looks for it; 0 where they come another way.
        port: u16,
        /// The port of the daemon's websocket, for the same; 0 where nobody else reaches it.
        websocket: u16,
    },
}

/// Who sends over a websocket.
#[derive(Clone, Debug, Plain)]
struct Connection {
    peer: SocketAddr,
    /// The device, by its identifier; `None` before its hello.
    id: Option<String>,
    heard: Timestamp,
    strikes: u32,
    first_strike: Timestamp,
}

/// The receiver of all devices at one port.
///
/// A sample is taken once, in the order of its number; what is missing is counted by those numbers ([`Session::losses`]), late and doubled
/// ones are refused. A device that the settings do not name is listed by [`Session::found`], and so is a sensor that nobody asked for.
/// Whoever claims a name on the network is believed, but for as long as another sends under it.
#[derive(Clone, Debug, posed_state::State)]
pub struct OpenImuSession {
    #[state(keep)]
    carrier: Carrier,
    #[state(keep)]
    rate_hz: Option<f64>,
    #[state(keep)]
    unchecked_lines: bool,
    #[state(keep)]
    wanted: Vec<u16>,
    /// Devices of the settings, and behind them those that were found.
    units: Vec<Unit>,
    #[state(keep)]
    named: usize,
    connections: Vec<Connection>,
    lines: Lines,
    arrivals: Arrivals,
    /// Bytes of all chunks so far.
    offset: u64,
    outbox: Outbox,
    bytes_skipped: u64,
    sensors: Vec<SensorInfo>,
    losses: Vec<Loss>,
    conditions: Vec<Condition>,
    found: Vec<Found>,
}

impl OpenImuSession {
    /// A receiver for the sensors `wanted`, see the module for their addresses; none at all only finds devices. Closed until the line
    /// opens.
    ///
    /// # Errors
    /// A text under `devices` is no identifier, or is there twice, or there are too many; `rate_hz` is out of its range; `wanted` names a
    /// sensor twice, or one of a device that the settings do not have.
    pub fn new(settings: Settings, carrier: Carrier, wanted: &[u16]) -> Result<Self, SettingsError> {
        let Settings { devices, rate_hz, unchecked_lines } = settings;
        let distinct =
            devices.iter().enumerate().all(|(k, id)| wire::is_id(id) && !devices[..k].contains(id));
        if !distinct || devices.len() > MOST {
            let expected = "different identifiers of 1 to 32 letters, digits, _ and -, 64 at most";
            return Err(SettingsError { key: "devices", expected });
        }
        if rate_hz.is_some_and(|rate_hz| !RATES_HZ.contains(&rate_hz)) {
            return Err(SettingsError { key: "rate_hz", expected: "1 to 1000" });
        }
        let mut addresses = wanted.to_vec();
        addresses.sort_unstable();
        addresses.dedup();
        let in_range =
            addresses.iter().all(|address| (1..=devices.len()).contains(&usize::from(address & 0xFF)));
        if addresses.len() != wanted.len() || !in_range {
            let expected = "256 * sensor + device, the device's number in `devices` counting from 1";
            return Err(SettingsError { key: "address", expected });
        }
        Ok(Self {
            carrier,
            rate_hz,
            unchecked_lines,
            named: devices.len(),
            units: devices.into_iter().map(Unit::new).collect(),
            connections: Vec::new(),
            lines: Lines::default(),
            arrivals: Arrivals::default(),
            offset: 0,
            outbox: Outbox::new(),
            bytes_skipped: 0,
            sensors: addresses.iter().map(|&address| SensorInfo { address, serial: None }).collect(),
            losses: addresses.iter().map(|&address| Loss { address, ..Loss::default() }).collect(),
            conditions: addresses.iter().map(|&address| Condition::unknown(address)).collect(),
            found: Vec::new(),
            wanted: addresses,
        })
    }

    fn refuse(&mut self, bytes: usize) {
        self.outbox.counters.rejected += 1;
        self.bytes_skipped += bytes as u64;
    }

    fn send(&mut self, peer: SocketAddr, data: &[u8]) {
        self.outbox.transmit(Datagram { peer, data }.encode());
    }

    fn datagram(&mut self, now: Timestamp, offset: u64, datagram: Datagram<'_>) {
        let Datagram { peer, data } = datagram;
        if data.is_empty() {
            return self.closed(now, peer);
        }
        let kind = Kind::of(data);
        if kind != Kind::Json
            && let Some(at) = self.connections.iter().position(|connection| connection.peer == peer)
        {
            return self.mistake(now, at, Problem::BadType, "one JSON object per text message", data.len());
        }
        match kind {
            Kind::Json => self.text(now, offset, peer, data),
            Kind::Osc => {
                let mut refused = 0;
                osc::messages(data, &mut |message| match message {
                    Ok((id, message)) => self.said(now, offset, Some(peer), id, &message),
                    Err(Refused) => refused += 1,
                });
                self.outbox.counters.rejected += refused;
                self.bytes_skipped += if refused > 0 { data.len() as u64 } else { 0 };
            }
            Kind::Lines => {
                for line in data.split(|&byte| byte == b'\n').filter(|line| !line.is_empty()) {
                    self.line(now, offset, Some(peer), line);
                }
            }
            Kind::Discovery => {
                if let Carrier::Envelopes { port, websocket } = self.carrier {
                    self.send(peer, &wire::discovered("posed", websocket, port, port));
                }
            }
            Kind::Unknown => self.refuse(data.len()),
        }
    }

    /// A line without its LF. One that has swallowed the end of another is read from its last beginning that makes sense.
    fn line(&mut self, now: Timestamp, offset: u64, peer: Option<SocketAddr>, line: &[u8]) {
        let Some(first) = line.iter().position(|&byte| byte == b'$') else {
            let text = String::from_utf8_lossy(line);
            if let Some(text) = wire::name(&text) {
                self.outbox.warn(now, 2, || format!("the device writes: {text}"));
            }
            self.bytes_skipped += line.len() as u64 + 1;
            return;
        };
        match csv::find(line, self.unchecked_lines) {
            Some((at, message)) => {
                if at > first {
                    self.outbox.counters.rejected += 1;
                }
                self.bytes_skipped += at as u64;
                if let Some((id, message)) = message {
                    self.said(now, offset + at as u64, peer, id, &message);
                }
            }
            None => self.refuse(line.len() + 1),
        }
    }

    /// A text message of a connection.
    fn text(&mut self, now: Timestamp, offset: u64, peer: SocketAddr, data: &[u8]) {
        let Some(at) = self.connection(now, peer) else {
            self.refuse(data.len());
            let why = "there are too many connections";
            return self.send(peer, &Reply::Err { err: Problem::TooMany, why }.text());
        };
        self.connections[at].heard = now;
        if data.len() > json::MAX_MESSAGE {
            return self.mistake(now, at, Problem::TooBig, "a message has 16 KiB at most", data.len());
        }
        let mut id = self.connections[at].id.take();
        let mut problem = None;
        let read = json::items(data, &mut |item| {
            let first = problem.is_none();
            let found = match (item, &id) {
                (Item::Hello { id: named, hello }, _) => match self.hello(now, peer, &named, &hello) {
                    Ok(()) => {
                        id = Some(named);
                        None
                    }
                    Err(problem) => Some(problem),
                },
                (_, None) => Some((Problem::NoHello, "the first message is the hello")),
                (Item::Message(message), Some(id)) => {
                    self.said(now, offset, Some(peer), id, &message);
                    None
                }
                (Item::Ping(pong), _) => {
                    self.send(peer, &Reply::Pong { pong, t: now.as_nanos() / 1000 }.text());
                    None
                }
                (Item::Bye(why), Some(id)) => {
                    self.gone(now, id, &format!("says goodbye: {why}"));
                    None
                }
            };
            problem = if first { found } else { problem };
        });
        // A hello may have ended another connection, whose place this one may have now.
        let Some(at) = self.connections.iter().position(|connection| connection.peer == peer) else { return };
        self.connections[at].id = id;
        let bad = (Problem::BadJson, "an object with the keys of the format, version 1");
        if let Some((err, why)) = problem.or(read.err().map(|Refused| bad)) {
            self.mistake(now, at, err, why, data.len());
        }
    }

    /// The place of a connection, which is made if it is new; `None` where there are too many.
    fn connection(&mut self, now: Timestamp, peer: SocketAddr) -> Option<usize> {
        if let Some(at) = self.connections.iter().position(|connection| connection.peer == peer) {
            return Some(at);
        }
        if self.connections.len() == MOST_CONNECTIONS {
            // Whoever has said nothing for long gives way.
            let silent = |connection: &Connection| now.seconds_since(connection.heard) >= LOST_S;
            let at = self.connections.iter().position(silent)?;
            self.connections.remove(at);
        }
        self.connections.push(Connection { peer, id: None, heard: now, strikes: 0, first_strike: now });
        Some(self.connections.len() - 1)
    }

    /// A connection has said what it must not.
    fn mistake(&mut self, now: Timestamp, at: usize, err: Problem, why: &str, bytes: usize) {
        self.refuse(bytes);
        let connection = &mut self.connections[at];
        if now.seconds_since(connection.first_strike) >= 1.0 {
            (connection.strikes, connection.first_strike) = (0, now);
        }
        connection.strikes += 1;
        let (peer, is_last) = (connection.peer, connection.strikes >= STRIKES);
        self.send(peer, &Reply::Err { err, why }.text());
        if is_last {
            self.end(now, at, "has sent what the format does not have");
        }
    }

    /// Closes a connection.
    fn end(&mut self, now: Timestamp, at: usize, why: &str) {
        let Connection { peer, id, .. } = self.connections.swap_remove(at);
        self.send(peer, &[]);
        if let Some(id) = id {
            self.gone(now, &id, why);
        }
    }

    /// A connection was closed by its other end.
    fn closed(&mut self, now: Timestamp, peer: SocketAddr) {
        let Some(at) = self.connections.iter().position(|connection| connection.peer == peer) else { return };
        if let Some(id) = self.connections.swap_remove(at).id {
            self.gone(now, &id, "has closed its connection");
        }
    }

    /// A device has said that it goes, or its connection has ended.
    fn gone(&mut self, now: Timestamp, id: &str, why: &str) {
        let Some(k) = self.units.iter().position(|unit| unit.id == id) else { return };
        let unit = &mut self.units[k];
        unit.peer = None;
        if std::mem::take(&mut unit.presence) != Presence::Away && k < self.named {
            self.outbox.warn(now, 0x100 + k as u32, || format!("{id} {why}"));
        }
        self.forget_condition(k);
        self.update_state();
    }

    /// A device says on its connection who it is.
    fn hello(
        &mut self,
        now: Timestamp,
        peer: SocketAddr,
        id: &str,
        hello: &Hello,
    ) -> Result<(), (Problem, &'static str)> {
        if hello.version != wire::VERSION {
            return Err((Problem::BadJson, "this is version 1 of the format"));
        }
        let k = self.unit(now, id).ok_or((Problem::TooMany, "there are 64 devices already"))?;
        let same = |other: &Connection| other.peer != peer && other.id.as_deref() == Some(id);
        while let Some(at) = self.connections.iter().position(same) {
            let other = self.connections.swap_remove(at).peer;
            let why = "another connection has come for this device";
            self.send(other, &Reply::Err { err: Problem::DupId, why }.text());
            self.send(other, &[]);
        }
        let unit = &mut self.units[k];
        unit.peer = Some(peer);
        unit.begin_anew();
        let epoch = unit.epoch;
        self.introduced(now, k, hello);
        self.heard(now, k);
        self.send(peer, &Reply::Ok { ok: 1, id, epoch }.text());
        if let Some(rate) = self.rate_hz {
            self.send(peer, &Reply::Rate { rate }.text());
        }
        Ok(())
    }

    /// Takes what a device says of itself.
    fn introduced(&mut self, now: Timestamp, k: usize, hello: &Hello) {
        let unit = &mut self.units[k];
        if !unit.hello(hello) {
            let (id, claimed_hz) = (unit.id.clone(), hello.rate_hz.unwrap_or_default());
            self.outbox.warn(now, 0x200 + k as u32, || {
                format!("{id} claims {claimed_hz} samples a second; 1 to 1000 are possible")
            });
        }
        let unit = &self.units[k];
        for found in self.found.iter_mut().filter(|found| found.id == unit.id) {
            found.name.clone_from(&unit.name);
            found.rate_hz = unit.rate.map(|rate| rate.hz());
            let place = hello.places.iter().find(|(sensor, _)| *sensor == found.sensor);
            found.place = place.map(|(_, place)| place.clone());
        }
    }

    /// The place of a device by its identifier; one that is new takes that of one which is lost where there are too many.
    fn unit(&mut self, now: Timestamp, id: &str) -> Option<usize> {
        if let Some(k) = self.units.iter().position(|unit| unit.id == id) {
            return Some(k);
        }
        if self.units.len() < MOST {
            self.units.push(Unit::new(id.to_owned()));
            return Some(self.units.len() - 1);
        }
        let lost = |unit: &Unit| unit.silent_s(now) >= LOST_S;
        let k = self.named + self.units[self.named..].iter().position(lost)?;
        let old = std::mem::replace(&mut self.units[k], Unit::new(id.to_owned()));
        self.found.retain(|found| found.id != old.id);
        Some(k)
    }

    /// A device has been heard.
    fn heard(&mut self, now: Timestamp, k: usize) {
        let unit = &mut self.units[k];
        unit.heard = Some(now);
        let was_stale = std::mem::replace(&mut unit.presence, Presence::Here) == Presence::Stale;
        if was_stale && k < self.named {
            let id = unit.id.clone();
            self.outbox.warn(now, 0x300 + k as u32, || format!("{id} is back"));
        }
    }

    /// A device has said something, over whatever carrier.
    fn said(&mut self, now: Timestamp, offset: u64, peer: Option<SocketAddr>, id: &str, message: &Message) {
        let Some(k) = self.unit(now, id) else {
            self.outbox.counters.rejected += 1;
            return self.outbox.warn(now, 1, || "more than 64 devices send; the rest is refused".to_owned());
        };
        if self.units[k].is_anothers(now, peer) {
            self.outbox.counters.rejected += 1;
            return self.outbox.warn(now, 0x400 + k as u32, || {
                format!("two devices call themselves {id}; the second is refused: give each an identifier of its own")
            });
        }
        let unit = &mut self.units[k];
        unit.peer = peer;
        if unit.epoch == 0 {
            unit.epoch = 1;
        }
        match message {
            Message::Hello(hello) => {
                self.introduced(now, k, hello);
                if hello.version != wire::VERSION {
                    let (id, version) = (id.to_owned(), hello.version);
                    self.outbox.warn(now, 0x500 + k as u32, || {
                        format!("{id} speaks version {version} of the format; version 1 is known here")
                    });
                }
            }
            Message::Battery(battery) => self.conditions_of(k).for_each(|condition| {
                condition.battery = battery.level.or(condition.battery);
                condition.battery_v = battery.volts.or(condition.battery_v);
            }),
            Message::Buttons(buttons) => {
                let pressed = unit.pressed(*buttons);
                let first = self.wanted.iter().find(|address| usize::from(**address & 0xFF) == k + 1);
                if let Some(&address) = first.filter(|_| pressed != 0 && k < self.named) {
                    self.outbox.pressed(address);
                }
            }
            Message::Motion { sensor, count, motion } => match motion {
                Ok(motion) => {
                    if let Some(arrival) = self.arrivals.of(offset) {
                        self.motion(now, k, *sensor, *count, motion, arrival);
                    }
                }
                Err(Refused) => self.outbox.counters.rejected += 1,
            },
        }
        self.heard(now, k);
    }

    fn motion(
        &mut self,
        now: Timestamp,
        k: usize,
        sensor: u8,
        count: Count,
        motion: &Motion,
        arrival: Arrival,
    ) {
        let unit = &mut self.units[k];
        let Some((at, is_new)) = unit.stream(sensor) else {
            self.outbox.counters.rejected += 1;
            let id = unit.id.clone();
            return self.outbox.warn(now, 0x700 + k as u32, || {
                format!("{id} has more than 16 sensors; the rest is refused")
            });
        };
        let address = (k < self.named).then_some(u16::from(sensor) << 8 | (k as u16 + 1));
        let index = address.and_then(|address| self.wanted.binary_search(&address).ok());
        let verdict = unit.judge(now, at, count, motion.number, motion.time);
        let Verdict::Follows(lost) = verdict else {
            self.outbox.counters.rejected += 1;
            if verdict == Verdict::TooMany {
                let id = unit.id.clone();
                self.outbox.warn(now, 0x800 + k as u32, || {
                    format!("{id} sends more than 1000 samples a second; the rest is refused")
                });
            }
            return;
        };
        let t_device = unit.device_time(motion.number, motion.time);
        self.outbox.counters.records += 1;
        if is_new {
            self.introduce(k, sensor, index);
        }
        let Some(index) = index else { return };
        self.losses[index].lost += u64::from(lost);
        self.outbox.streaming();
        self.outbox.sample(Sample {
            address: self.wanted[index],
            arrival,
            t_device,
            measurement: Measurement::Imu {
                angular_velocity_rad_s: motion.gyro_rad_s,
                specific_force_m_s2: motion.acc_m_s2,
                linear_acceleration_m_s2: None,
                magnetic_field: motion.mag_ut.map(|field| field.map(|value| value / FIELD_UT)),
                orientation_wxyz: motion.orientation_wxyz,
            },
        });
    }

    /// A sensor has sent for the first time: it is the one that was asked for at `index`, or it is found.
    fn introduce(&mut self, k: usize, sensor: u8, index: Option<usize>) {
        let unit = &self.units[k];
        let Some(index) = index else {
            let rate_hz = unit.rate.map(|rate| rate.hz());
            self.found.push(Found {
                id: unit.id.clone(),
                sensor,
                name: unit.name.clone(),
                place: None,
                rate_hz,
            });
            return;
        };
        let id = &unit.id;
        self.sensors[index].serial = Some(if sensor == 0 { id.clone() } else { format!("{id}/{sensor}") });
    }

    /// Of all sensors of a device of the settings.
    fn conditions_of(&mut self, k: usize) -> impl Iterator<Item = &mut Condition> {
        self.conditions.iter_mut().filter(move |condition| usize::from(condition.address & 0xFF) == k + 1)
    }

    /// Nothing is known any more of a device that is gone.
    fn forget_condition(&mut self, k: usize) {
        self.conditions_of(k).for_each(|condition| *condition = Condition::unknown(condition.address));
    }

    fn update_state(&mut self) {
        let named = &self.units[..self.named];
        if *self.outbox.state() == State::Streaming
            && named.iter().all(|unit| unit.presence != Presence::Here)
        {
            self.outbox
                .silent("no device sends; check their batteries, their network and the address they send to");
        }
    }
}

impl Session for OpenImuSession {
    fn handle_line(&mut self, _: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { .. } => {
                self.lines.interrupt();
                self.arrivals.reopen();
                self.outbox.connecting("waiting for devices");
                if self.carrier == Carrier::Line {
                    self.outbox.transmit(csv::WHO.to_vec());
                    if let Some(rate_hz) = self.rate_hz {
                        self.outbox.transmit(csv::rate(rate_hz.round() as u32));
                    }
                }
            }
            LineEvent::Closed { reason } => {
                self.lines.interrupt();
                self.connections.clear();
                for unit in &mut self.units {
                    (unit.peer, unit.presence) = (None, Presence::Away);
                }
                for condition in &mut self.conditions {
                    *condition = Condition::unknown(condition.address);
                }
                self.outbox.connecting(reason.clone());
            }
            LineEvent::Dropped { bytes } => {
                self.lines.lose();
                self.bytes_skipped += bytes;
            }
        }
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        self.arrivals.read(now, bytes.len());
        if self.carrier == Carrier::Line {
            // The lines lie in the buffer while the session changes.
            let mut lines = std::mem::take(&mut self.lines);
            lines.push(bytes);
            while let Some(line) = lines.find() {
                self.line(now, line.offset, None, lines.line(line));
            }
            self.lines = lines;
            return;
        }
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
        for k in 0..self.units.len() {
            let unit = &mut self.units[k];
            let silent_s = unit.silent_s(now);
            let before = unit.presence;
            match before {
                Presence::Here if silent_s >= STALE_S => unit.presence = Presence::Stale,
                Presence::Stale if silent_s >= LOST_S => (unit.presence, unit.peer) = (Presence::Away, None),
                _ => continue,
            }
            let (id, is_lost) = (unit.id.clone(), before == Presence::Stale);
            if is_lost {
                self.forget_condition(k);
            }
            if k < self.named {
                self.outbox.warn(now, 0x900 + 2 * k as u32 + u32::from(is_lost), || match is_lost {
                    false => format!("{id} is silent"),
                    true => format!("{id} is gone; check its battery and the network"),
                });
            }
        }
        self.update_state();
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        let due = |unit: &Unit| match unit.presence {
            Presence::Here => Some(unit.heard? + std::time::Duration::from_secs_f64(STALE_S)),
            Presence::Stale => Some(unit.heard? + std::time::Duration::from_secs_f64(LOST_S)),
            Presence::Away => None,
        };
        self.units.iter().filter_map(due).min()
    }

    fn state(&self) -> &State {
        self.outbox.state()
    }

    fn counters(&self) -> Counters {
        let bytes_skipped = self.bytes_skipped + self.lines.bytes_skipped();
        Counters { bytes_skipped, ..self.outbox.counters }
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        let claimed = self.units[..self.named].iter().filter_map(|unit| Some(unit.rate?.hz()));
        claimed.max_by(f64::total_cmp)
    }

    fn losses(&self) -> &[Loss] {
        &self.losses
    }

    fn conditions(&self) -> &[Condition] {
        &self.conditions
    }

    fn found(&self) -> &[Found] {
        &self.found
    }
}
