//! Asks a port for x-IMU3 units, and reads how they announce themselves on a network.

use serde_json::Value;

use super::wire::{self, Body, Lines, MUX};
use crate::probe::{Identity, Inquiry, Listener, Question};
use crate::sample::Timestamp;
use crate::session::SensorInfo;

/// Line rates, bit/s, the likeliest first.
pub const BAUD_RATES: [u32; 2] = [115_200, 921_600];
/// UDP port on which units announce themselves once a second.
pub const ANNOUNCEMENTS: u16 = 10_000;

/// An inquiry of about 0.6 s: a ping to one unit, then to all of a chain; `now` is the time at which the port is open.
///
/// It disturbs no stream. A unit that answers the first ping ends it at once; of a chain those count that answer within 0.35 s.
pub fn inquiry(now: Timestamp) -> Inquiry {
    let ping = wire::command(0, "ping", &Value::Null);
    let mut to_all = vec![MUX, MUX];
    to_all.extend(&ping);
    let questions = vec![Question::new(ping, 250), Question::new(to_all, 350)];
    Inquiry::new(now, questions, Box::new(Answers::default()))
}

#[derive(Debug, Default)]
struct Answers {
    lines: Lines,
    name: Option<String>,
    units: Vec<SensorInfo>,
}

impl Listener for Answers {
    fn listen(&mut self, bytes: &[u8]) {
        self.lines.push(bytes);
        let mut scratch = Vec::new();
        while let Some(line) = self.lines.find() {
            let Some(message) = wire::parse(self.lines.line(line), &mut scratch) else { continue };
            let Body::Command(json) = message.body else { continue };
            let Some((key, value)) = wire::answer(json).filter(|(key, _)| key == "ping") else { continue };
            let text = |name| value.get(name).and_then(Value::as_str).map(str::to_owned);
            // Our own question, sent back by a line that echoes, has no serial number.
            let (Some(serial), "ping") = (text("sn"), key.as_str()) else { continue };
            self.name = self.name.take().or_else(|| text("name"));
            let address = message.address;
            if self.units.iter().all(|unit| unit.address != address) {
                self.units.push(SensorInfo { address, serial: Some(serial) });
            }
        }
    }

    fn has_answer(&self, k: usize) -> bool {
        // A unit that answers for itself has no chain behind it.
        k == 0 && !self.units.is_empty()
    }

    fn goes_on(&self, _: usize) -> bool {
        self.units.is_empty()
    }

    fn identity(&self) -> Option<Identity> {
        let mut sensors = self.units.clone();
        sensors.sort_by_key(|unit| unit.address);
        let name = self.name.clone().filter(|_| sensors.len() == 1);
        (!sensors.is_empty()).then(|| Identity {
            model: Some(name.map_or_else(|| "x-IMU3".to_owned(), |name| format!("x-IMU3 {name:?}"))),
            sensors,
            ..Identity::default()
        })
    }
}

/// A unit that has announced itself on a network: what it claims, not proven.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Announcement {
    /// Name as the user set it; empty where the datagram has none.
    pub name: String,
    /// Serial number.
    pub serial: String,
    /// Address of the unit, as text and as it claims; not checked to be one.
    pub ip: String,
    /// UDP port of the computer that the unit sends to; 0 where it answers whoever asks.
    pub sends_to: u16,
    /// UDP port of the unit, above 0.
    pub listens_on: u16,
}

impl Announcement {
    /// Reads a datagram from port [`ANNOUNCEMENTS`], a JSON object. `None` where it is no announcement: serial number, address
    /// and the port of the unit must be there.
    pub fn parse(datagram: &[u8]) -> Option<Self> {
        let value: Value = serde_json::from_slice(datagram).ok()?;
        let text = |key| value.get(key).and_then(Value::as_str).map(str::to_owned);
        let port = |key| value.get(key).and_then(Value::as_u64).and_then(|port| u16::try_from(port).ok());
        Some(Self {
            name: text("name").unwrap_or_default(),
            serial: text("sn")?,
            ip: text("ip")?,
            sends_to: port("send").unwrap_or(0),
            listens_on: port("receive").filter(|port| *port > 0)?,
        })
    }

    /// The port as a stage file names it: `udp://IP:PORT`, of the unit.
    pub fn port(&self) -> String {
        format!("udp://{}:{}", self.ip, self.listens_on)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::NoAnswer;

    #[test]
    fn units_of_a_chain_are_identified_by_their_channels() {
        let mut now = Timestamp::ZERO;
        let mut inquiry = inquiry(now);
        assert_eq!(inquiry.poll_transmit().unwrap(), b"{\"ping\":null}\n");
        now = inquiry.poll_timeout().unwrap();
        inquiry.handle_timeout(now);
        assert_eq!(inquiry.poll_transmit().unwrap(), b"^^{\"ping\":null}\n");
        let answer = |channel: u8, serial: &str| {
            let mut bytes = vec![b'^', channel];
            bytes.extend(
                format!("{{\"ping\":{{\"interface\":\"Serial\",\"name\":\"x\",\"sn\":\"{serial}\"}}}}\n")
                    .bytes(),
            );
            bytes
        };
        inquiry.handle_bytes(now, &answer(3, "6A3F20C3"));
        inquiry.handle_bytes(now, &answer(2, "6A3F20C1"));
        inquiry.handle_timeout(inquiry.poll_timeout().unwrap());
        let found = inquiry.result().unwrap().as_ref().unwrap();
        let units: Vec<_> = found.sensors.iter().map(|s| (s.address, s.serial.as_deref().unwrap())).collect();
        assert_eq!(units, [(2, "6A3F20C1"), (3, "6A3F20C3")]);
    }

    #[test]
    fn an_echo_is_no_unit() {
        let mut inquiry = inquiry(Timestamp::ZERO);
        while let Some(due) = inquiry.poll_timeout() {
            if let Some(bytes) = inquiry.poll_transmit() {
                inquiry.handle_bytes(due, &bytes);
            }
            inquiry.handle_timeout(due);
        }
        assert_eq!(inquiry.result(), Some(&Err(NoAnswer::Unintelligible)));
    }

    #[test]
    fn an_announcement_says_where_the_unit_is() {
        let text = br#"{"sync":0,"name":"Thigh","sn":"6A3F20C1","ip":"192.168.1.21","port":7000,"send":8001,"receive":9000,"rssi":80,"battery":50,"status":0}"#;
        let unit = Announcement::parse(text).unwrap();
        assert_eq!((unit.port().as_str(), unit.sends_to), ("udp://192.168.1.21:9000", 8001));
        assert_eq!(Announcement::parse(br#"{"ping":null}"#), None);
        assert_eq!(Announcement::parse(b"\xff"), None);
    }
}
