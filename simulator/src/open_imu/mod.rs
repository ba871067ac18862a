//! Virtual devices of the open format: boards that send OSC or lines over UDP, boards on a line, and phones whose browser has a websocket.
//!
//! What comes in: the host's questions, in envelopes where devices have addresses of their own. What goes out: samples at the device's own
//! rate and clock, who it is every five seconds, its battery every ten. Boards have run for an hour when the stage begins: their clocks and
//! numbers wrap within its first half minute. A phone rounds as browsers do, and each time it comes back it has another connection, with a
//! new count.

#[cfg(test)]
mod tests;

use std::fmt::Write as _;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::datagram::datagrams;
use posed_drivers::open_imu::wire::osc::{Value, Writer};
use posed_drivers::open_imu::wire::{DISCOVERY, csv};

use crate::chassis::{Chassis, Unit};
use crate::device::{DeviceOutput, Pace, shown_s};
use crate::faults::Fault;
use crate::inertial::{Imu, Inertial};

/// Samples a second of a board, and of a phone.
const BOARD_HZ: f64 = 100.0;
const PHONE_HZ: f64 = 60.0;
const HELLO: Duration = Duration::from_secs(5);
const BATTERY: Duration = Duration::from_secs(10);
/// Between two tries of a phone to connect.
const CONNECT: Duration = Duration::from_secs(1);
/// First network port of the devices.
const FIRST_PORT: u16 = 45_000;
/// Strength of the field, µT.
const FIELD_UT: f64 = 50.0;
/// What browsers round to: m/s², and degrees per second.
const ROUNDED: f64 = 0.1;
/// A clock of 32 bits wraps so long after the stage's beginning, s, and numbers after so many samples.
const WRAPS_AFTER_S: f64 = 20.0;
const WRAPS_AFTER: u32 = 1000;

/// What carries a device's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Carrier {
    /// Datagrams of numbers.
    Osc,
    /// Lines of text, in datagrams or on a wire.
    Lines {
        /// Whether there is a wire, and nobody has an address.
        on_wire: bool,
    },
    /// Text messages of a browser's websocket.
    Browser,
}

/// One device.
#[derive(Debug)]
pub(crate) struct Board {
    /// Its number in the stage, from 1.
    number: u16,
    id: String,
    peer: SocketAddr,
    carrier: Carrier,
    /// Sensors by their number on the device.
    sensors: Vec<(u8, Imu)>,
    pace: Pace,
    /// How much slower than nominal its crystal is.
    drift_ppm: f64,
    cycle: u64,
    rate_hz: f64,
    /// Number of the next sample.
    next: u32,
    /// When its clock showed so many µs.
    clock: (Timestamp, f64),
    /// Whether the server has taken its hello (a browser's only).
    is_connected: bool,
    was_quiet: bool,
    has_sent: bool,
    next_hello: Timestamp,
    next_battery: Timestamp,
    level: f64,
    leave_out: u32,
}

impl Board {
    pub(crate) fn new(
        number: u16,
        id: String,
        carrier: Carrier,
        sensors: Vec<(u8, Imu)>,
        chassis: &mut Chassis,
    ) -> Self {
        let rate_hz = if carrier == Carrier::Browser { PHONE_HZ } else { BOARD_HZ };
        let start = Timestamp::from_secs_f64(chassis.random.uniform() / rate_hz);
        // Each crystal is its own.
        let drift_ppm = chassis.config.drift_ppm * (2.0 * chassis.random.uniform() - 1.0);
        let begins = if carrier == Carrier::Browser {
            (0, 0.0)
        } else {
            (u32::MAX - WRAPS_AFTER, 4_294_967_296.0 - WRAPS_AFTER_S * 1e6)
        };
        let port = FIRST_PORT + 256 * (chassis.config.device as u16 % 64) + number;
        Self {
            number,
            id,
            peer: SocketAddr::from((Ipv4Addr::LOCALHOST, port)),
            carrier,
            sensors,
            pace: Pace::new(start, 0, 1.0 / rate_hz, drift_ppm),
            drift_ppm,
            cycle: 0,
            rate_hz,
            next: begins.0,
            clock: (Timestamp::ZERO, begins.1),
            is_connected: carrier != Carrier::Browser,
            was_quiet: true,
            has_sent: false,
            next_hello: Timestamp::ZERO,
            next_battery: Timestamp::ZERO,
            level: 0.9,
            leave_out: 0,
        }
    }

    fn address(&self, sensor: u8) -> u16 {
        u16::from(sensor) << 8 | self.number
    }

    /// It was off: everything counts from the beginning.
    fn restart(&mut self, t: Timestamp) {
        self.next = 0;
        self.clock = (t, 0.0);
        self.next_hello = t;
        self.disconnect();
    }

    /// A browser comes again from another port.
    fn disconnect(&mut self) {
        if self.carrier == Carrier::Browser {
            self.is_connected = false;
            self.peer.set_port(self.peer.port().wrapping_add(100));
        }
    }

    /// Microseconds that its clock shows, in its 32 bits; a browser's has no such end.
    fn time_us(&self, t: Timestamp) -> u64 {
        let (since, shown_us) = self.clock;
        let us = (shown_us + 1e6 * shown_s(since, t, self.drift_ppm)).max(0.0) as u64;
        if self.carrier == Carrier::Browser { us } else { us % (1 << 32) }
    }

    fn poll_timeout(&self) -> Timestamp {
        self.pace.time(self.cycle).min(self.next_hello).min(self.next_battery)
    }

    fn hello(&self) -> Vec<u8> {
        let Self { id, rate_hz, .. } = self;
        match self.carrier {
            Carrier::Osc => {
                let arguments = [Value::Text("board"), Value::Text("virtual"), Value::Int(*rate_hz as i32)];
                Writer::message(id, "hello", &arguments)
            }
            Carrier::Lines { .. } => csv::line(&format!("H,{id},1,board,virtual,{rate_hz},us,32")),
            Carrier::Browser => format!(
                r#"{{"imu":1,"id":"{id}","name":"phone","rate":{rate_hz},"unit":"us","bits":0,"caps":["gyro","acc","ori","bat"],"src":"browser"}}"#
            )
            .into_bytes(),
        }
    }

    fn battery(&self) -> Vec<u8> {
        let (id, level) = (&self.id, self.level);
        match self.carrier {
            Carrier::Osc => Writer::message(id, "bat", &[Value::Float(level as f32), Value::Float(3.9)]),
            Carrier::Lines { .. } => csv::line(&format!("B,{id},{},3.90,0", (100.0 * level).round())),
            Carrier::Browser => format!(r#"{{"bat":{level},"chg":false}}"#).into_bytes(),
        }
    }

    fn button(&self, down: u32) -> Vec<u8> {
        match self.carrier {
            Carrier::Osc => Writer::message(&self.id, "btn", &[Value::Int(down as i32)]),
            Carrier::Lines { .. } => csv::line(&format!("K,{},{down}", self.id)),
            Carrier::Browser => format!(r#"{{"btn":{down},"ev":"button"}}"#).into_bytes(),
        }
    }

    /// A sample as it travels.
    fn sample(&self, sensor: u8, t_us: u64, measured: &Inertial) -> Vec<u8> {
        let Self { id, next, .. } = self;
        let gyro = measured.angular_velocity_rad_s;
        let acc = measured.specific_force_m_s2;
        let mag = FIELD_UT * measured.magnetic_field;
        match self.carrier {
            Carrier::Osc => {
                let mut arguments = vec![Value::Int(*next as i32), Value::Long(t_us as i64)];
                let values = gyro.iter().chain(&acc).chain(&mag);
                arguments.extend(values.map(|&value| Value::Float(value as f32)));
                Writer::message(id, &sensor.to_string(), &arguments)
            }
            Carrier::Lines { .. } => {
                let mut fields = format!("I,{id},{sensor},{next},{t_us}");
                for (values, digits) in [(gyro, 4), (acc, 4), (mag, 1)] {
                    for value in values.iter() {
                        write!(fields, ",{value:.digits$}").expect("a text takes what is written");
                    }
                }
                csv::line(&fields)
            }
            Carrier::Browser => {
                let list = |values: [f64; 3]| format!("[{:?},{:?},{:?}]", values[0], values[1], values[2]);
                let rounded = |value: f64| (value / ROUNDED).round() * ROUNDED;
                let gyro = gyro.map(|value| rounded(value.to_degrees()).to_radians());
                let acc = acc.map(rounded);
                let q = measured.orientation;
                format!(
                    r#"{{"s":{sensor},"n":{next},"t":{t_us},"g":{},"a":{},"q":[{:.5},{:.5},{:.5},{:.5}]}}"#,
                    list(gyro.into()),
                    list(acc.into()),
                    q.w,
                    q.i,
                    q.j,
                    q.k
                )
                .into_bytes()
            }
        }
    }
}

/// Devices of one server; see the module.
#[derive(Debug)]
pub(crate) struct OpenImu {
    boards: Vec<Board>,
    /// What the host has said on a wire, up to the end of its line.
    heard: Vec<u8>,
}

impl OpenImu {
    pub(crate) fn new(boards: Vec<Board>) -> Self {
        Self { boards, heard: Vec::new() }
    }

    fn is_quiet(&self, chassis: &Chassis, k: usize, t: Timestamp) -> bool {
        !chassis.is_on() || chassis.is_gone(self.boards[k].number, t)
    }

    /// A message that is no record.
    fn emit(&self, chassis: &mut Chassis, t: Timestamp, k: usize, message: &[u8]) {
        let wire = chassis.transmitter.answer(t, message);
        let board = &self.boards[k];
        chassis.emit(match board.carrier {
            Carrier::Lines { on_wire: true } => DeviceOutput::Send(wire),
            _ => DeviceOutput::SendFrom(board.peer, wire),
        });
    }

    fn measure(&mut self, chassis: &mut Chassis, k: usize, t: Timestamp) {
        let is_quiet = self.is_quiet(chassis, k, t);
        let wrong =
            chassis.config.faults.iter().any(|f| matches!(f, Fault::WrongOutput { .. }) && f.is_active(t));
        let board = &mut self.boards[k];
        let cycle = board.cycle;
        board.cycle += 1;
        let rows = board.sensors.iter().map(|(_, imu)| imu.truth(t)).collect();
        chassis.truth(t, cycle, rows);
        let was_quiet = std::mem::replace(&mut board.was_quiet, is_quiet);
        if is_quiet {
            return;
        }
        if was_quiet && board.has_sent {
            board.restart(t);
        }
        if !board.is_connected {
            return;
        }
        let t_us = board.time_us(t);
        let left_out = board.leave_out > 0;
        board.leave_out = board.leave_out.saturating_sub(1);
        let period_s = 1.0 / board.rate_hz;
        let measured: Vec<(u8, Inertial)> =
            board.sensors.iter_mut().map(|(sensor, imu)| (*sensor, imu.measure(t, period_s))).collect();
        for (sensor, mut measured) in measured {
            let board = &self.boards[k];
            let address = board.address(sensor);
            if left_out {
                chassis.lose(cycle, Some(address));
                continue;
            }
            if wrong {
                measured.angular_velocity_rad_s.x = 1e6;
            }
            let message = board.sample(sensor, t_us, &measured);
            let wire = chassis.transmitter.record(
                t + chassis.config.measurement_delay,
                &message,
                cycle,
                Some(address),
            );
            chassis.emit(match board.carrier {
                Carrier::Lines { on_wire: true } => DeviceOutput::Send(wire),
                _ => DeviceOutput::SendFrom(board.peer, wire),
            });
        }
        self.boards[k].next = self.boards[k].next.wrapping_add(1);
        self.boards[k].has_sent = true;
    }

    /// The host says something to a device.
    fn hear(&mut self, chassis: &mut Chassis, t: Timestamp, k: usize, message: &[u8]) {
        if self.is_quiet(chassis, k, t) {
            return;
        }
        let board = &mut self.boards[k];
        match message {
            // The server has closed the connection.
            [] => {
                board.disconnect();
                board.next_hello = t + CONNECT;
            }
            b"$?" => {
                let hello = board.hello();
                self.emit(chassis, t, k, &hello);
            }
            _ if message.starts_with(br#"{"ok""#) => board.is_connected = true,
            _ if message.starts_with(b"$R,") => {
                let text = std::str::from_utf8(&message[3..]).unwrap_or_default();
                if let Ok(rate_hz) = text.trim().parse::<f64>()
                    && (1.0..=1000.0).contains(&rate_hz)
                {
                    board.pace = Pace::new(t, board.cycle, 1.0 / rate_hz, board.drift_ppm);
                    board.rate_hz = rate_hz;
                    board.next_hello = t;
                }
            }
            _ => {}
        }
    }
}

impl Unit for OpenImu {
    fn reset(&mut self, _: &mut Chassis, t: Timestamp) {
        self.heard.clear();
        if t > Timestamp::ZERO {
            self.boards.iter_mut().for_each(|board| board.restart(t));
        }
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        if self.boards.iter().any(|board| board.carrier == Carrier::Lines { on_wire: true }) {
            self.heard.extend(bytes);
            while let Some(end) = self.heard.iter().position(|&byte| byte == b'\n') {
                let line: Vec<u8> = self.heard.drain(..=end).collect();
                (0..self.boards.len()).for_each(|k| self.hear(chassis, t, k, line.trim_ascii_end()));
            }
            return;
        }
        for datagram in datagrams(bytes).flatten() {
            if let Some(k) = self.boards.iter().position(|board| board.peer == datagram.peer) {
                self.hear(chassis, t, k, datagram.data);
            }
        }
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let Some(k) = (0..self.boards.len()).min_by_key(|&k| self.boards[k].poll_timeout()) else { return };
        let is_quiet = self.is_quiet(chassis, k, t);
        let board = &mut self.boards[k];
        if board.next_hello <= t {
            let is_browser = board.carrier == Carrier::Browser;
            let knows_already = is_browser && board.is_connected;
            let says = !is_quiet && !knows_already;
            board.next_hello = t + if is_browser { CONNECT } else { HELLO };
            if says {
                let hello = board.hello();
                self.emit(chassis, t, k, &hello);
                let is_in_network =
                    matches!(self.boards[k].carrier, Carrier::Osc | Carrier::Lines { on_wire: false });
                if is_in_network && !self.boards[k].has_sent {
                    self.emit(chassis, t, k, DISCOVERY);
                }
            }
        } else if board.next_battery <= t {
            board.next_battery = t + BATTERY;
            if !is_quiet && board.is_connected {
                let battery = board.battery();
                self.emit(chassis, t, k, &battery);
            }
        } else {
            self.measure(chassis, k, t);
        }
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        self.boards.iter().map(Board::poll_timeout).min()
    }

    fn fault(&mut self, chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool {
        let number = fault.address().map(|address| address & 0xFF);
        let named = self.boards.iter().position(|board| Some(board.number) == number);
        match (fault, named) {
            (Fault::WrongOutput { .. }, _) => {}
            (Fault::BirdDies { .. }, Some(k)) => {
                // A phone whose page is hidden says so.
                if self.boards[k].carrier == Carrier::Browser && self.boards[k].is_connected {
                    self.emit(chassis, t, k, br#"{"bye":"page hidden"}"#);
                }
            }
            (Fault::Button { .. }, Some(k)) => {
                for down in [1, 0] {
                    let message = self.boards[k].button(down);
                    self.emit(chassis, t, k, &message);
                }
            }
            (Fault::LowBattery { .. }, Some(k)) => {
                self.boards[k].level = 0.05;
                self.boards[k].next_battery = t;
            }
            (Fault::AddressChange { .. }, Some(k)) => {
                let peer = &mut self.boards[k].peer;
                peer.set_port(peer.port() + 100);
            }
            (Fault::CounterRestart { .. }, _) => self.boards.iter_mut().for_each(|board| board.restart(t)),
            (Fault::LostPeriods { count, .. }, _) => {
                self.boards.iter_mut().for_each(|board| board.leave_out = *count);
            }
            _ => return false,
        }
        true
    }
}
