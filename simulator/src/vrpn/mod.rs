//! A virtual VRPN server: trackers that cameras see.
//!
//! What comes in: a client's greeting, descriptions and pings. What goes out: the server's greeting, descriptions and pongs, and
//! while a client is there a pose of each tracker in every cycle. Cameras see where a tracker is, with the same small noise
//! everywhere; no field bends it and no half-space is mirrored.

#[cfg(test)]
mod tests;

use std::time::Duration;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use posed_drivers::vrpn::wire::{self, CONTROL, From, GREETING, Messages, system, types};

use crate::chassis::{Chassis, Unit};
use crate::device::{Pace, Sensor, shown_s};
use crate::faults::Fault;
use crate::random::Random;
use crate::truth::{Class, TruthRow};

/// Seconds of 1970 at which its clock starts.
const CLOCK_START_S: i64 = 1_000_000_000;
/// Noise of a pose along and about an axis, m and rad: what makers of motion capture cameras state for a rigid body.
const SIGMA_M: f64 = 2e-4;
const SIGMA_RAD: f64 = 1e-3;
/// Its numbers of types; those of senders begin at 1, behind that of the original's own.
const POSE: i32 = 4;
const TEXT: i32 = 7;
const PONG: i32 = 8;

/// One sensor of a tracker.
#[derive(Debug)]
pub(crate) struct Target {
    /// 256 times the sensor, and the tracker's number.
    address: u16,
    sensor: Sensor,
    random: Random,
    /// What was seen last, in the server's axes.
    latest: Option<Isometry3<f64>>,
}

impl Target {
    pub(crate) fn new(address: u16, sensor: Sensor, random: Random) -> Self {
        Self { address, sensor, random, latest: None }
    }

    fn measure(&mut self, room_from_server: &Isometry3<f64>, hidden: bool, t: Timestamp) -> TruthRow {
        let pose = self.sensor.pose_in_room(t);
        if !hidden {
            let mut three = |sigma: f64| Vector3::from_fn(|_, _| sigma * self.random.normal());
            let noise = Isometry3::from_parts(
                three(SIGMA_M).into(),
                UnitQuaternion::from_scaled_axis(three(SIGMA_RAD)),
            );
            let seen = room_from_server.inverse() * pose;
            self.latest = Some(Isometry3::from_parts(
                (seen.translation.vector + noise.translation.vector).into(),
                seen.rotation * noise.rotation,
            ));
        }
        let class = if hidden { Class::Stuck } else { Class::Clean };
        TruthRow { sensor: self.sensor.index, pose, class, distortion_m: Vector3::zeros() }
    }
}

/// A server; see the module.
#[derive(Debug)]
pub(crate) struct Vrpn {
    /// Names of the trackers, in the order of their numbers.
    names: Vec<String>,
    targets: Vec<Target>,
    room_from_server: Isometry3<f64>,
    client: Option<Client>,
    input: Messages,
    pace: Pace,
    next_cycle: u64,
    clock_start: Timestamp,
    leave_out: u32,
    wrong_until: Option<Timestamp>,
}

/// What the client calls what it asks for.
#[derive(Debug, Default)]
struct Client {
    senders: Vec<(i32, String)>,
    ping: Option<i32>,
}

impl Vrpn {
    pub(crate) fn new(
        names: Vec<String>,
        targets: Vec<Target>,
        room_from_server: Isometry3<f64>,
        rate_hz: f64,
        chassis: &mut Chassis,
    ) -> Self {
        let phase = Duration::from_secs_f64(chassis.random.uniform() / rate_hz);
        Self {
            names,
            targets,
            room_from_server,
            client: None,
            input: Messages::default(),
            pace: Pace::new(Timestamp::ZERO + phase, 0, 1.0 / rate_hz, chassis.config.drift_ppm),
            next_cycle: 0,
            clock_start: Timestamp::ZERO,
            leave_out: 0,
            wrong_until: None,
        }
    }

    fn utc_ns(&self, chassis: &Chassis, t: Timestamp) -> i64 {
        let shown = shown_s(self.clock_start, t, chassis.config.drift_ppm).max(0.0);
        CLOCK_START_S * 1_000_000_000 + (shown * 1e9) as i64
    }

    fn cycle(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let cycle = self.next_cycle;
        self.next_cycle += 1;
        let faults = &chassis.config.faults;
        let hidden = |address: u16| {
            let is =
                |fault: &Fault| matches!(fault, Fault::OutOfRange { .. }) && fault.address() == Some(address);
            faults.iter().any(|fault| is(fault) && fault.is_active(t))
        };
        let room = self.room_from_server;
        let rows = self.targets.iter_mut().map(|target| target.measure(&room, hidden(target.address), t));
        let rows = rows.collect();
        chassis.truth(t, cycle, rows);
        if self.client.is_none() {
            return;
        }
        if self.leave_out > 0 || !chassis.is_on() {
            self.leave_out = self.leave_out.saturating_sub(1);
            return chassis.lose(cycle, None);
        }
        let is_wrong = self.wrong_until.is_some_and(|until| t < until);
        let utc_ns = self.utc_ns(chassis, t);
        let mut bytes = Vec::new();
        for target in &self.targets {
            let address = target.address;
            let Some(seen) = target.latest.filter(|_| !chassis.is_gone(address, t)) else {
                chassis.lose(cycle, Some(address));
                continue;
            };
            let q = seen.rotation;
            let mut orientation_wxyz = [q.w, q.i, q.j, q.k];
            if is_wrong {
                orientation_wxyz = if cycle.is_multiple_of(2) { [f64::NAN; 4] } else { [0.0; 4] };
                chassis.lose(cycle, Some(address));
            }
            let from = From { sender: i32::from(address & 0xFF), kind: POSE, utc_ns };
            let position_m = seen.translation.vector.into();
            wire::pose(from, u32::from(address >> 8), position_m, orientation_wxyz, &mut bytes);
        }
        if !bytes.is_empty() {
            chassis.record(t + chassis.config.measurement_delay, &bytes, cycle, None);
        }
    }

    /// A client has greeted.
    fn welcome(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let utc_ns = self.utc_ns(chassis, t);
        let mut bytes = GREETING.to_vec();
        let names = [CONTROL].into_iter().chain(self.names.iter().map(String::as_str));
        for (number, name) in (0..).zip(names) {
            wire::description(system::SENDER, number, name, utc_ns, &mut bytes);
        }
        for (number, name) in [(POSE, types::POSE), (TEXT, types::TEXT), (PONG, types::PONG)] {
            wire::description(system::TYPE, number, name, utc_ns, &mut bytes);
        }
        chassis.answer(t, &bytes);
        self.client = Some(Client::default());
    }
}

impl Unit for Vrpn {
    fn reset(&mut self, _chassis: &mut Chassis, _t: Timestamp) {
        self.client = None;
        self.input = Messages::default();
        self.wrong_until = None;
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        // A device does not see who connects: a greeting is another connection.
        if bytes.starts_with(wire::ANY_VERSION) {
            self.reset(chassis, t);
        }
        self.input.push(bytes);
        if self.client.is_none() {
            if self.input.pending().len() < GREETING.len() {
                return;
            }
            if !self.input.pending().starts_with(wire::ANY_VERSION) {
                return self.input.skip(usize::MAX);
            }
            self.input.skip(GREETING.len());
            self.welcome(chassis, t);
        }
        let utc_ns = self.utc_ns(chassis, t);
        let mut pongs = Vec::new();
        while let (Ok(Some(message)), Some(client)) = (self.input.find(), &mut self.client) {
            match (message.kind, message.description()) {
                (system::SENDER, Ok(described)) => client.senders.push(described),
                (system::TYPE, Ok((number, name))) if name == types::PING => client.ping = Some(number),
                (kind, _) if client.ping == Some(kind) => {
                    let named = client.senders.iter().find(|(number, _)| *number == message.sender);
                    let ours = named.and_then(|(_, name)| self.names.iter().position(|own| own == name));
                    if let Some(ours) = ours {
                        wire::message(From { sender: ours as i32 + 1, kind: PONG, utc_ns }, &[], &mut pongs);
                    }
                }
                _ => {}
            }
        }
        if !pongs.is_empty() {
            chassis.answer(t, &pongs);
        }
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.cycle(chassis, t);
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        Some(self.pace.time(self.next_cycle))
    }

    fn fault(&mut self, chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool {
        match *fault {
            Fault::BirdDies { .. } | Fault::OutOfRange { .. } => {}
            Fault::Error { address, code, .. } => {
                let mut bytes = Vec::new();
                let from =
                    From { sender: i32::from(address & 0xFF), kind: TEXT, utc_ns: self.utc_ns(chassis, t) };
                wire::text(from, &format!("error {code}"), true, &mut bytes);
                if self.client.is_some() {
                    chassis.answer(t, &bytes);
                }
            }
            // Its clock is set: back to where it began.
            Fault::CounterRestart { .. } => self.clock_start = t,
            Fault::LostPeriods { count, .. } => self.leave_out = count,
            Fault::WrongOutput { .. } => {
                self.wrong_until = Some(fault.until());
            }
            _ => return false,
        }
        true
    }
}
