//! Asks a port for a Fastrak.

use super::wire::STATIONS;
use crate::probe::{Identity, Inquiry, Listener, Question};
use crate::sample::Timestamp;
use crate::session::SensorInfo;

/// Line rates, bit/s, the likeliest first.
pub const BAUD_RATES: [u32; 4] = [115_200, 9_600, 38_400, 19_200];

/// Bytes that are kept: more than all answers together.
const KEPT: usize = 4096;

/// An inquiry of about 0.7 s where nothing answers, up to 1.3 s where a unit does; `now` is the time at which the port is open.
///
/// It stops a stream and does not start it again. Serial numbers are not asked for; a unit that does not state which stations
/// are on counts as one with station 1.
pub fn inquiry(now: Timestamp) -> Inquiry {
    let mut questions = vec![Question::new(*b"\rc", 300), Question::new(*b"S", 400)];
    questions.extend((1..=STATIONS).map(|station| Question::new(format!("l{station}\r"), 150)));
    Inquiry::new(now, questions, Box::new(Answers::default()))
}

#[derive(Debug, Default)]
struct Answers {
    bytes: Vec<u8>,
}

impl Answers {
    /// Version and identification of the status answer: `2`, station, `S`, 6 flags, 6 blanks, 6 version, 32 text, CR LF.
    fn status(&self) -> Option<(String, String)> {
        let at = self
            .bytes
            .windows(3)
            .position(|head| head[0] == b'2' && (b'1'..=b'4').contains(&head[1]) && head[2] == b'S')?;
        let answer = self.bytes[at..].split(|&byte| byte == b'\n').next()?;
        let complete = self.bytes.get(at + answer.len()) == Some(&b'\n');
        let text = std::str::from_utf8(answer).ok().filter(|_| complete && answer.len() >= 40)?;
        let part = |range: std::ops::Range<usize>| text.get(range).unwrap_or_default().trim().to_owned();
        Some((part(15..21), part(21..text.len())))
    }

    /// State of a station: `2?l` and four digits, one per station.
    fn stations(&self) -> Option<[bool; STATIONS as usize]> {
        let answers = self.bytes.windows(7).rev();
        let mut fits = answers.filter(|a| {
            a[0] == b'2' && a[2] == b'l' && a[3..].iter().all(|digit| matches!(digit, b'0' | b'1'))
        });
        fits.next().map(|answer| std::array::from_fn(|k| answer[3 + k] == b'1'))
    }
}

impl Listener for Answers {
    fn listen(&mut self, bytes: &[u8]) {
        let room = KEPT.saturating_sub(self.bytes.len());
        self.bytes.extend(&bytes[..bytes.len().min(room)]);
    }

    fn has_answer(&self, k: usize) -> bool {
        match k {
            0 => false,
            1 => self.status().is_some(),
            _ => self.stations().is_some(),
        }
    }

    fn goes_on(&self, k: usize) -> bool {
        // One answer tells all stations.
        k == 0 || (self.status().is_some() && self.stations().is_none())
    }

    fn identity(&self) -> Option<Identity> {
        let (version, text) = self.status()?;
        let active = self.stations().unwrap_or([true, false, false, false]);
        let sensors: Vec<SensorInfo> = (1..)
            .zip(active)
            .filter(|(_, active)| *active)
            .map(|(address, _)| SensorInfo { address, serial: None })
            .collect();
        let problem = sensors.is_empty().then(|| {
            (
                "no station is switched on".to_owned(),
                "plug in a receiver, and set the station's switch".to_owned(),
            )
        });
        let kept = |text: String| (!text.is_empty()).then_some(text);
        Some(Identity { model: kept(text), revision: kept(version), rate_hz: None, sensors, problem })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn status_and_stations_are_read() {
        let mut now = Timestamp::ZERO;
        let mut inquiry = inquiry(now);
        while let Some(due) = inquiry.poll_timeout() {
            now = due;
            match inquiry.poll_transmit().as_deref() {
                Some(b"S") => {
                    let answer = format!("21S000000      {:>6}{:<32}\r\n", "3.02b", "3SPACE FASTRAK");
                    inquiry.handle_bytes(now, answer.as_bytes());
                }
                Some(b"l1\r") => inquiry.handle_bytes(now, b"21l1010\r\n"),
                _ => inquiry.handle_timeout(now),
            }
        }
        let found = inquiry.result().unwrap().as_ref().unwrap();
        assert_eq!(found.revision.as_deref(), Some("3.02b"));
        assert_eq!(found.model.as_deref(), Some("3SPACE FASTRAK"));
        assert_eq!(found.sensors.iter().map(|sensor| sensor.address).collect::<Vec<_>>(), [1, 3]);
    }
}
