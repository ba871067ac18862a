//! Virtual SlimeVR trackers: each a network peer of its own, all looking for one server.
//!
//! What comes in: datagrams of the server, each in an envelope with the tracker that it is for. What goes out:
//! the trackers' datagrams. A tracker calls once a second until a server answers, states what it is, sends its
//! motion every 10 ms, and calls again after three seconds without a word.

pub(crate) mod receiver;
#[cfg(test)]
mod tests;

use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::datagram::datagrams;
use posed_drivers::slimevr::wire;

use crate::chassis::{Chassis, Unit};
use crate::device::{DeviceOutput, Pace};
use crate::faults::Fault;
use crate::inertial::{Imu, Inertial};
use crate::line::RecordByte;

/// Time between two motions, s.
const MOTION_S: f64 = 0.01;
/// Time between two calls for a server, two words about a sensor, two questions for features.
const CALL: Duration = Duration::from_secs(1);
const FEATURES: Duration = Duration::from_millis(500);
const MOST_FEATURES: u8 = 15;
const BATTERY: Duration = Duration::from_secs(10);
/// Strength of every tracker's radio signal, dBm.
const SIGNAL_DBM: i8 = -58;
/// Silence of the server after which a tracker looks for one again, s.
const SILENCE_S: f64 = 3.0;
/// Protocol version of the firmware.
const PROTOCOL: u32 = 22;
/// First network port of the trackers.
const FIRST_PORT: u16 = 40_000;
/// The server's features: bundles, compact bundles with packed motion.
const COMPACT: u8 = 2;
const BUNDLES: u8 = 1;

/// One tracker.
#[derive(Debug)]
pub(crate) struct Tracker {
    /// Its number in the stage, from 1.
    number: u16,
    mac: [u8; 6],
    peer: SocketAddr,
    /// Sensors by their number on the tracker.
    sensors: Vec<(u8, Imu)>,
    acknowledged: Vec<bool>,
    connected: bool,
    received_at: Timestamp,
    /// Number of the next packet.
    packet: u64,
    /// What the server can, once it has said so.
    features: Option<u8>,
    requested_features: u8,
    next_call: Timestamp,
    next_features: Timestamp,
    next_battery: Timestamp,
    level: f64,
    pace: Pace,
    cycle: u64,
    leave_out: u32,
    /// The last motion of each sensor: one that does not change is not sent.
    last: Vec<Option<Inertial>>,
}

impl Tracker {
    pub(crate) fn new(number: u16, mac: [u8; 6], sensors: Vec<(u8, Imu)>, chassis: &mut Chassis) -> Self {
        let start = Timestamp::from_secs_f64(MOTION_S * chassis.random.uniform());
        let port = FIRST_PORT + 256 * (chassis.config.device as u16 % 64) + number;
        Self {
            number,
            mac,
            peer: SocketAddr::from((Ipv4Addr::LOCALHOST, port)),
            acknowledged: vec![false; sensors.len()],
            last: vec![None; sensors.len()],
            sensors,
            connected: false,
            received_at: Timestamp::ZERO,
            packet: 0,
            features: None,
            requested_features: 0,
            next_call: Timestamp::ZERO,
            next_features: Timestamp::ZERO,
            next_battery: Timestamp::ZERO,
            level: 0.9,
            pace: Pace::new(start, 0, MOTION_S, chassis.config.drift_ppm),
            cycle: 0,
            leave_out: 0,
        }
    }

    fn address(&self, sensor: u8) -> u16 {
        u16::from(sensor) << 8 | self.number
    }

    /// It looks for a server from now on.
    fn search(&mut self, t: Timestamp) {
        self.connected = false;
        self.features = None;
        self.requested_features = 0;
        // One after the other, so that a server numbers them in the order of their numbers.
        self.next_call = t + Duration::from_millis(20 * u64::from(self.number));
        self.acknowledged.fill(false);
    }

    fn poll_timeout(&self) -> Timestamp {
        let motion = self.pace.time(self.cycle);
        let call = (!self.connected || self.acknowledged.contains(&false)).then_some(self.next_call);
        let asks = self.connected && self.features.is_none() && self.requested_features < MOST_FEATURES;
        let features = asks.then_some(self.next_features);
        let battery = self.connected.then_some(self.next_battery);
        [call, features, battery].into_iter().flatten().fold(motion, Timestamp::min)
    }

    /// A packet with the next number.
    fn packet(&mut self, kind: u32, body: &[u8]) -> Vec<u8> {
        let packet = wire::encode(self.packet, kind, body);
        self.packet += 1;
        packet
    }
}

/// Trackers of one server; see the module.
#[derive(Debug)]
pub(crate) struct SlimeVr {
    trackers: Vec<Tracker>,
}

impl SlimeVr {
    pub(crate) fn new(trackers: Vec<Tracker>) -> Self {
        Self { trackers }
    }

    /// A datagram of a tracker that is no record.
    fn emit(&self, chassis: &mut Chassis, t: Timestamp, k: usize, packet: &[u8]) {
        let wire = chassis.transmitter.answer(t, packet);
        chassis.emit(DeviceOutput::SendFrom(self.trackers[k].peer, wire));
    }

    fn is_quiet(&self, chassis: &Chassis, k: usize, t: Timestamp) -> bool {
        !chassis.is_on() || chassis.is_gone(self.trackers[k].number, t)
    }

    fn motion(&mut self, chassis: &mut Chassis, k: usize, t: Timestamp) {
        let is_quiet = self.is_quiet(chassis, k, t);
        let is_wrong =
            chassis.config.faults.iter().any(|f| matches!(f, Fault::WrongOutput { .. }) && f.is_active(t));
        let tracker = &mut self.trackers[k];
        let cycle = tracker.cycle;
        tracker.cycle += 1;
        let rows = tracker.sensors.iter().map(|(_, imu)| imu.truth(t)).collect();
        chassis.truth(t, cycle, rows);
        if is_quiet && t.seconds_since(tracker.received_at) > SILENCE_S && tracker.connected {
            tracker.search(t);
        }
        if !tracker.connected {
            return;
        }
        if t.seconds_since(tracker.received_at) > SILENCE_S {
            return tracker.search(t);
        }
        let measured: Vec<Inertial> =
            tracker.sensors.iter_mut().map(|(_, imu)| imu.measure(t, MOTION_S)).collect();
        let fresh: Vec<usize> =
            (0..measured.len()).filter(|&s| tracker.last[s] != Some(measured[s])).collect();
        if fresh.is_empty() {
            return;
        }
        let left_out = tracker.leave_out > 0;
        tracker.leave_out = tracker.leave_out.saturating_sub(1);
        if is_quiet || left_out {
            // A packet that is left out had its number; a tracker that is gone counts no further.
            tracker.packet += u64::from(left_out && !is_quiet);
            for &s in &fresh {
                chassis.lose(cycle, Some(tracker.address(tracker.sensors[s].0)));
            }
            return;
        }
        let features = tracker.features.unwrap_or_default();
        // Bytes of a packet's body with the sensor that each is of.
        let mut packets: Vec<(u32, Vec<(u8, u16)>)> = Vec::new();
        let mut bundle: Vec<(u8, u16)> = Vec::new();
        for &s in &fresh {
            tracker.last[s] = Some(measured[s]);
            let sensor = tracker.sensors[s].0;
            let address = tracker.address(sensor);
            let q = measured[s].orientation;
            let mut q = [q.w, q.i, q.j, q.k];
            if is_wrong {
                q = if cycle.is_multiple_of(2) { [f64::NAN; 4] } else { [0.0; 4] };
            }
            let acceleration = measured[s].linear_acceleration_m_s2.into();
            let tagged = |bytes: &[u8]| bytes.iter().map(|&byte| (byte, address)).collect::<Vec<_>>();
            if features & COMPACT != 0 {
                let body = wire::motion_body(sensor, q, acceleration);
                bundle.extend(tagged(&[body.len() as u8 + 1, 23]));
                bundle.extend(tagged(&body));
                continue;
            }
            for (kind, body) in
                [(17, wire::rotation_body(sensor, q)), (4, wire::acceleration_body(sensor, acceleration))]
            {
                if features & BUNDLES != 0 {
                    bundle.extend(tagged(&(body.len() as u16 + 4).to_be_bytes()));
                    bundle.extend(tagged(&u32::to_be_bytes(kind)));
                    bundle.extend(tagged(&body));
                } else {
                    packets.push((kind, tagged(&body)));
                }
            }
        }
        if !bundle.is_empty() {
            packets.push((if features & COMPACT != 0 { 101 } else { 100 }, bundle));
        }
        for (kind, body) in packets {
            let header = tracker.packet(kind, &[]);
            let first = body.first().map_or(0, |&(_, address)| address);
            let bytes: Vec<(u8, u16)> = header.into_iter().map(|byte| (byte, first)).chain(body).collect();
            let frame_len = bytes.len() as u16;
            let tagged = bytes.into_iter().zip(0..).map(|((byte, address), index)| {
                let address = Some(address);
                (byte, Some(RecordByte { cycle, address, index, frame_index: index, frame_len }))
            });
            let wire = chassis.transmitter.wire(t + chassis.config.measurement_delay, tagged);
            chassis.emit(DeviceOutput::SendFrom(tracker.peer, wire));
        }
    }

    /// A call for a server, or a word about sensors that the server has not taken note of.
    fn call(&mut self, chassis: &mut Chassis, k: usize, t: Timestamp) {
        let is_quiet = self.is_quiet(chassis, k, t);
        let tracker = &mut self.trackers[k];
        tracker.next_call = t + CALL;
        if is_quiet {
            return;
        }
        let mut packets = Vec::new();
        if tracker.connected {
            for s in (0..tracker.sensors.len()).filter(|&s| !tracker.acknowledged[s]).collect::<Vec<_>>() {
                // State ok, BNO085, magnetometer off, no place on the body, a rotation.
                let body = [tracker.sensors[s].0, 1, 4, 0, 0, 1, 0, 0];
                packets.push(tracker.packet(15, &body));
            }
        } else {
            packets.push(wire::encode(0, 3, &wire::handshake_body(tracker.mac, PROTOCOL, "0.6.0")));
        }
        packets.iter().for_each(|packet| self.emit(chassis, t, k, packet));
    }

    /// A datagram of the server.
    fn hear(&mut self, chassis: &mut Chassis, t: Timestamp, k: usize, data: &[u8]) {
        if self.is_quiet(chassis, k, t) {
            return;
        }
        let tracker = &mut self.trackers[k];
        if data.get(1..13) == Some(b"Hey OVR =D 5") {
            if !tracker.connected {
                tracker.connected = true;
                tracker.next_call = t;
                tracker.next_features = t;
                tracker.next_battery = t;
                // Number 0 is for handshakes and pings.
                tracker.packet = tracker.packet.max(1);
            }
            tracker.received_at = t;
            return;
        }
        if !tracker.connected {
            return;
        }
        tracker.received_at = t;
        match data {
            [0, 0, 0, 1, ..] => {
                let packet = tracker.packet(0, &[]);
                self.emit(chassis, t, k, &packet);
            }
            // A ping goes back as it came.
            [0, 0, 0, 10, ..] => self.emit(chassis, t, k, data),
            [0, 0, 0, 15, sensor, 1] => {
                if let Some(s) = tracker.sensors.iter().position(|(number, _)| number == sensor) {
                    tracker.acknowledged[s] = true;
                }
            }
            [0, 0, 0, 22, _, _, _, _, _, _, _, _, flags, ..] => tracker.features = Some(*flags),
            // Set a configuration flag: taken note of.
            [0, 0, 0, 25, _, _, _, _, _, _, _, _, sensor, high, low, _] => {
                let packet = tracker.packet(24, &[*sensor, *high, *low]);
                self.emit(chassis, t, k, &packet);
            }
            _ => {}
        }
    }
}

impl Unit for SlimeVr {
    fn reset(&mut self, _chassis: &mut Chassis, t: Timestamp) {
        for tracker in &mut self.trackers {
            tracker.packet = 0;
            tracker.search(t);
        }
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        for datagram in datagrams(bytes).flatten() {
            if let Some(k) = self.trackers.iter().position(|tracker| tracker.peer == datagram.peer) {
                self.hear(chassis, t, k, datagram.data);
            }
        }
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let Some(k) = (0..self.trackers.len()).min_by_key(|&k| self.trackers[k].poll_timeout()) else {
            return;
        };
        let is_quiet = self.is_quiet(chassis, k, t);
        let tracker = &mut self.trackers[k];
        if tracker.pace.time(tracker.cycle) <= t {
            self.motion(chassis, k, t);
        } else if (!tracker.connected || tracker.acknowledged.contains(&false)) && tracker.next_call <= t {
            self.call(chassis, k, t);
        } else if tracker.features.is_none()
            && tracker.requested_features < MOST_FEATURES
            && tracker.next_features <= t
        {
            tracker.requested_features += 1;
            tracker.next_features = t + FEATURES;
            // Remote command and sensor configuration are what this firmware can.
            let packet = tracker.packet(22, &[6]);
            if !is_quiet {
                self.emit(chassis, t, k, &packet);
            }
        } else {
            tracker.next_battery = t + BATTERY;
            let volts = 3.2 + tracker.level;
            let body: Vec<u8> =
                [volts, tracker.level].iter().flat_map(|v| (*v as f32).to_be_bytes()).collect();
            let signal = [255, SIGNAL_DBM.cast_unsigned()];
            let packets = [tracker.packet(12, &body), tracker.packet(19, &signal)];
            if !is_quiet {
                packets.iter().for_each(|packet| self.emit(chassis, t, k, packet));
            }
        }
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        self.trackers.iter().map(Tracker::poll_timeout).min()
    }

    fn fault(&mut self, chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool {
        let number = fault.address().map(|address| address & 0xFF);
        let named = self.trackers.iter().position(|tracker| Some(tracker.number) == number);
        match (fault, named) {
            (Fault::BirdDies { .. }, Some(_)) | (Fault::WrongOutput { .. }, _) => {}
            (Fault::Error { address, code, .. }, Some(k)) => {
                let packet = self.trackers[k].packet(14, &[(address >> 8) as u8, *code]);
                if !self.is_quiet(chassis, k, t) {
                    self.emit(chassis, t, k, &packet);
                }
            }
            (Fault::Button { .. }, Some(k)) => {
                let packet = self.trackers[k].packet(21, &[wire::YAW_RESET]);
                if !self.is_quiet(chassis, k, t) {
                    self.emit(chassis, t, k, &packet);
                }
            }
            (Fault::LowBattery { .. }, Some(k)) => {
                self.trackers[k].level = 0.05;
                self.trackers[k].next_battery = t;
            }
            (Fault::AddressChange { .. }, Some(k)) => {
                // The tracker does not know: it sends on, and calls only when nobody answers.
                let peer = &mut self.trackers[k].peer;
                peer.set_port(peer.port() + 100);
            }
            (Fault::CounterRestart { .. }, _) => self.reset(chassis, t),
            (Fault::LostPeriods { count, .. }, _) => {
                self.trackers.iter_mut().for_each(|tracker| tracker.leave_out = *count);
            }
            _ => return false,
        }
        true
    }
}
