//! Asks a port for a Liberty or Patriot.

use super::wire::{HEADER, Header, Model, POINT, STATIONS, STREAM, WHO_AM_I};
use crate::probe::{Identity, Inquiry, Listener, Question};
use crate::sample::Timestamp;
use crate::session::SensorInfo;

/// Line rates, bit/s, the likeliest first; the unit's switches have slower ones, too.
pub const BAUD_RATES: [u32; 3] = [115_200, 9_600, 57_600];

/// Bytes that are kept: more than all answers together.
const KEPT: usize = 8192;
/// The shortest answer to "who are you" that is known has 195 bytes, and is mostly words.
const LEAST_TEXT: usize = 150;
const LEAST_LETTERS: usize = 20;

/// An inquiry of about 0.8 s where nothing answers, up to 1.1 s where a unit does; `now` is the time at which the port is open.
///
/// It stops a stream and does not start it again; it sets nothing. Stations are those that have a record. Their serial numbers
/// are not asked for: how the unit says them is not known.
pub fn inquiry(now: Timestamp) -> Inquiry {
    let questions =
        vec![Question::new(*b"\rP", 400), Question::new(*b"\x16\r", 400), Question::new(*b"P", 300)];
    Inquiry::new(now, questions, Box::new(Answers::default()))
}

#[derive(Debug, Default)]
struct Answers {
    bytes: Vec<u8>,
}

impl Answers {
    /// All places that hold a binary header.
    fn headers(&self) -> impl Iterator<Item = Header> {
        self.bytes.windows(HEADER).filter_map(Header::parse)
    }

    fn lines(&self) -> impl Iterator<Item = &[u8]> {
        self.bytes.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii_end)
    }

    /// Model, where the unit says who it is: in binary by its letters, as text in words.
    fn who(&self) -> Option<Option<&'static str>> {
        if let Some(header) = self.headers().find(|header| header.command == WHO_AM_I && header.size >= 8) {
            return Some(Some(match header.model {
                Model::Liberty => "Liberty",
                Model::Patriot => "Patriot",
            }));
        }
        let printable = |byte: &u8| (b' '..=b'~').contains(byte) || matches!(byte, b'\r' | b'\n' | b'\t');
        let mut texts = self.bytes.split(|byte| !printable(byte)).filter_map(|text| {
            // Records as text may stand in front; what is meant ends with a line.
            let begin = text.iter().position(|&byte| byte == b'0')?;
            let end = text.iter().rposition(|&byte| byte == b'\n')?;
            text.get(begin..=end)
        });
        let letters = |text: &&[u8]| text.iter().filter(|byte| byte.is_ascii_alphabetic()).count();
        let text = texts.find(|text| text.len() >= LEAST_TEXT && letters(text) >= LEAST_LETTERS)?;
        let text = String::from_utf8_lossy(text).to_ascii_lowercase();
        Some(["Liberty", "Patriot"].into_iter().find(|model| text.contains(&model.to_ascii_lowercase())))
    }

    /// Whether the station has a record, binary or as a line of text.
    fn is_active(&self, station: u8) -> bool {
        let is_record = |header: &Header| matches!(header.command, POINT | STREAM) && header.size >= 12;
        let number = format!("{station:02}");
        let is_line = |line: &[u8]| {
            let Some((head, numbers)) = line.split_at_checked(3) else { return false };
            let mut fields = numbers.split(u8::is_ascii_whitespace).filter(|field| !field.is_empty());
            let is_number =
                |field: &[u8]| std::str::from_utf8(field).is_ok_and(|text| text.parse::<f64>().is_ok());
            head.starts_with(number.as_bytes()) && fields.clone().count() >= 3 && fields.all(is_number)
        };
        self.headers().any(|header| header.station == station && is_record(&header))
            || self.lines().any(is_line)
    }
}

impl Listener for Answers {
    fn listen(&mut self, bytes: &[u8]) {
        let room = KEPT.saturating_sub(self.bytes.len());
        self.bytes.extend(&bytes[..bytes.len().min(room)]);
    }

    fn has_answer(&self, _: usize) -> bool {
        // Each answer ends with silence.
        false
    }

    fn goes_on(&self, k: usize) -> bool {
        k == 0 || self.who().is_some()
    }

    fn identity(&self) -> Option<Identity> {
        let model = self.who()?.map(str::to_owned);
        let sensors: Vec<SensorInfo> = (1..=STATIONS)
            .filter(|&station| self.is_active(station))
            .map(|station| SensorInfo { address: station.into(), serial: None })
            .collect();
        let problem = sensors.is_empty().then(|| {
            (
                "no station has a sensor that is switched on".to_owned(),
                "plug in a sensor, and ask again".to_owned(),
            )
        });
        Some(Identity { model, revision: None, rate_hz: None, sensors, problem })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(answers: [&[u8]; 3]) -> Option<Identity> {
        let mut now = Timestamp::ZERO;
        let mut inquiry = inquiry(now);
        for answer in answers {
            if inquiry.poll_transmit().is_some() {
                inquiry.handle_bytes(now, answer);
                now = inquiry.poll_timeout().unwrap();
                inquiry.handle_timeout(now);
            }
        }
        inquiry.result().unwrap().clone().ok()
    }

    #[test]
    fn a_unit_is_known_in_binary_and_by_its_text() {
        let record = |station| {
            let mut bytes = Vec::new();
            Header { model: Model::Patriot, station, command: POINT, error: b' ', size: 26 }
                .encode(&mut bytes);
            bytes.extend([0; 24]);
            bytes.extend(b"\r\n");
            bytes
        };
        let mut who = Vec::new();
        Header { model: Model::Patriot, station: 0, command: WHO_AM_I, error: b' ', size: 40 }
            .encode(&mut who);
        who.extend([0; 40]);
        let found = asked([b"", &who, &[record(1), record(2)].concat()]).unwrap();
        assert_eq!(found.model.as_deref(), Some("Patriot"));
        assert_eq!(found.sensors.iter().map(|sensor| sensor.address).collect::<Vec<_>>(), [1, 2]);

        let text = format!("00 {:<192}\r\n", "Polhemus Liberty, words of no known order");
        let lines = b"01   12.000   -3.500   20.250   10.000    0.000    5.000\r\n03A   1.000   -3.500   20.250   10.000    0.000    5.000\r\n";
        let found = asked([lines, text.as_bytes(), lines]).unwrap();
        assert_eq!(found.model.as_deref(), Some("Liberty"));
        assert_eq!(found.sensors.iter().map(|sensor| sensor.address).collect::<Vec<_>>(), [1, 3]);
        // A Fastrak answers `P` with a record, too, and `^V` with nothing.
        assert_eq!(asked([lines, b"", lines]), None);
    }
}
