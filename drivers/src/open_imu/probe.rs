//! Asks a line who sends on it, and reads what comes over a network.

use super::wire::{Kind, Message, csv, osc};
use crate::probe::{Identity, Inquiry, Listener, Question};
use crate::sample::Timestamp;
use crate::session::SensorInfo;
use crate::x_imu3::wire::Lines;

/// Line rates, bit/s, the likeliest first.
pub const BAUD_RATES: [u32; 3] = [115_200, 921_600, 460_800];
/// UDP ports to which devices send.
pub const PORTS: [u16; 2] = [9301, 9302];

/// An inquiry of at most 0.6 s: who is there, and what comes by itself. It changes nothing; `now` is the time at which the port is open.
pub fn inquiry(now: Timestamp) -> Inquiry {
    Inquiry::new(now, vec![Question::new(csv::WHO, 600)], Box::new(Answers::default()))
}

/// What devices have said of themselves, and which of their sensors have sent.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    devices: Vec<Device>,
}

#[derive(Clone, Debug)]
struct Device {
    id: String,
    name: Option<String>,
    software: Option<String>,
    rate_hz: Option<f64>,
    sensors: Vec<u8>,
}

impl Heard {
    /// Takes a datagram from one of [`PORTS`]; false where it is nothing of this format.
    pub fn datagram(&mut self, data: &[u8]) -> bool {
        match Kind::of(data) {
            Kind::Osc => osc::messages(data, &mut |message| {
                if let Ok((id, message)) = message {
                    self.said(id, &message);
                }
            }),
            Kind::Lines => data.split(|&byte| byte == b'\n').for_each(|line| self.line(line)),
            Kind::Json | Kind::Discovery | Kind::Unknown => return false,
        }
        true
    }

    fn line(&mut self, line: &[u8]) {
        if let Ok(Some((id, message))) = csv::parse(line, false) {
            self.said(id, &message);
        }
    }

    fn said(&mut self, id: &str, message: &Message) {
        let k = self.devices.iter().position(|device| device.id == id).unwrap_or_else(|| {
            let device =
                Device { id: id.to_owned(), name: None, software: None, rate_hz: None, sensors: Vec::new() };
            self.devices.push(device);
            self.devices.len() - 1
        });
        let device = &mut self.devices[k];
        match message {
            Message::Hello(hello) => {
                device.name.clone_from(&hello.name);
                device.software.clone_from(&hello.software);
                device.rate_hz = hello.rate_hz;
            }
            Message::Motion { sensor, .. } if !device.sensors.contains(sensor) => {
                device.sensors.push(*sensor)
            }
            Message::Motion { .. } | Message::Battery(_) | Message::Buttons(_) => {}
        }
    }

    /// What they are, together: their sensors by `256 * sensor + number of the device`. `None` where nobody has said anything.
    pub fn identity(&self) -> Option<Identity> {
        let only = match self.devices.as_slice() {
            [] => return None,
            [only] => Some(only),
            _ => None,
        };
        let mut sensors = Vec::new();
        for (number, device) in (1..).zip(&self.devices) {
            // A device that has only introduced itself has one sensor at least.
            let numbers = if device.sensors.is_empty() { &[0][..] } else { &device.sensors };
            for &sensor in numbers {
                let serial = if sensor == 0 { device.id.clone() } else { format!("{}/{sensor}", device.id) };
                let address = u16::from(sensor) << 8 | number;
                sensors.push(SensorInfo { address, serial: Some(serial) });
            }
        }
        sensors.sort_by_key(|sensor| sensor.address);
        Some(Identity {
            model: only.and_then(|device| device.name.clone()),
            revision: only.and_then(|device| device.software.clone()),
            rate_hz: only.and_then(|device| device.rate_hz),
            sensors,
            problem: None,
        })
    }
}

#[derive(Debug, Default)]
struct Answers {
    lines: Lines,
    heard: Heard,
}

impl Listener for Answers {
    fn listen(&mut self, bytes: &[u8]) {
        self.lines.push(bytes);
        while let Some(line) = self.lines.find() {
            self.heard.line(self.lines.line(line));
        }
    }

    fn has_answer(&self, _: usize) -> bool {
        // The name may come before the samples, or behind them.
        let complete = |device: &Device| !device.sensors.is_empty() && device.rate_hz.is_some();
        self.heard.devices.first().is_some_and(complete)
    }

    fn goes_on(&self, _: usize) -> bool {
        self.heard.devices.is_empty()
    }

    fn identity(&self) -> Option<Identity> {
        self.heard.identity()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::NoAnswer;

    #[test]
    fn a_board_is_known_by_what_it_sends() {
        let mut inquiry = inquiry(Timestamp::ZERO);
        assert_eq!(inquiry.poll_transmit().unwrap(), b"$?\n");
        let now = Timestamp::from_secs_f64(0.1);
        inquiry.handle_bytes(now, b"boot ok\r\n");
        inquiry.handle_bytes(now, &csv::line("I,esp-7f3a,1,1,10000,0,0,0,0,0,9.81"));
        assert_eq!(inquiry.result(), None);
        inquiry.handle_bytes(now, &csv::line("H,esp-7f3a,1,Left thigh,0.3,100,us,32"));
        let found = inquiry.result().unwrap().as_ref().unwrap();
        assert_eq!((found.model.as_deref(), found.rate_hz), (Some("Left thigh"), Some(100.0)));
        assert_eq!(found.sensors, [SensorInfo { address: 0x101, serial: Some("esp-7f3a/1".to_owned()) }]);
    }

    #[test]
    fn an_echo_is_no_board() {
        let mut inquiry = inquiry(Timestamp::ZERO);
        let question = inquiry.poll_transmit().unwrap();
        inquiry.handle_bytes(Timestamp::ZERO, &question);
        inquiry.handle_timeout(inquiry.poll_timeout().unwrap());
        assert_eq!(inquiry.result(), Some(&Err(NoAnswer::Unintelligible)));
    }

    #[test]
    fn who_sends_over_a_network_is_listed_by_number() {
        let mut heard = Heard::default();
        assert!(heard.identity().is_none() && !heard.datagram(b"IMU?1"));
        for line in ["H,b,1,Wrist,1,50,us,32", "I,a,0,1,2,0,0,0,0,0,9.81", "I,a,3,1,2,0,0,0,0,0,9.81"] {
            assert!(heard.datagram(&csv::line(line)));
        }
        let identity = heard.identity().unwrap();
        let sensors: Vec<_> =
            identity.sensors.iter().map(|info| (info.address, info.serial.as_deref().unwrap())).collect();
        assert_eq!(sensors, [(1, "b"), (2, "a"), (0x302, "a/3")]);
    }
}
