//! A small stand-in for the unit, and a session on its line; time is advanced by the test.

use std::time::Duration;

use posed_drivers::flock::wire::{Command, CommandParser, Format, Scale, Shape, record};
use posed_drivers::flock::{FlockSession, Settings};
use posed_drivers::{LineEvent, Output, Sample, Session, State, Timestamp};

const CYCLE: Duration = Duration::from_micros(9_680);

/// Answers as the sheet says: 5 to 50 ms late, auto-configuration busy for 270 ms, records in order.
pub(super) struct Unit {
    pub(super) commands: CommandParser,
    /// Status bytes by address; empty for a stand-alone unit.
    pub(super) units: Vec<u8>,
    pub(super) initialised: bool,
    pub(super) running: bool,
    pub(super) streaming: bool,
    pub(super) group: bool,
    /// Of each bird, by address; the first one of a stand-alone unit.
    pub(super) formats: Vec<Format>,
    pub(super) error: u8,
    pub(super) dead: Vec<u8>,
    /// Birds that keep their format, whatever they are asked for.
    pub(super) deaf: Vec<u8>,
    /// It takes and gives nothing before then.
    pub(super) unresponsive_until: Timestamp,
    pub(super) next_cycle: Timestamp,
    /// How long after it was asked to stream it sends its first record.
    pub(super) late: Duration,
    pub(super) cycle: u32,
    pub(super) out: Vec<(Timestamp, Vec<u8>)>,
    pub(super) commands_seen: Vec<Command>,
    pub(super) revision: [u8; 2],
    /// What it answers to the questions for its measurement rate, in turn; the last one again and again.
    pub(super) rates: Vec<[u8; 2]>,
    /// Bits that turn over in its next answers about the flock, in turn.
    pub(super) flips: Vec<u8>,
    /// After how many answers about the flock which others come in their place: those of a line that is out of step.
    pub(super) strays: (usize, Vec<Vec<u8>>),
}

impl Unit {
    pub(super) fn flock(birds: u8) -> Self {
        let mut units = vec![0xE0; usize::from(birds)];
        units[0] = 0xA1;
        let formats = vec![Format::PositionAngles; units.len()];
        Self { units, formats, initialised: false, ..Self::alone() }
    }

    pub(super) fn alone() -> Self {
        Self {
            commands: CommandParser::default(),
            units: Vec::new(),
            initialised: true,
            running: true,
            streaming: false,
            group: false,
            formats: vec![Format::PositionAngles],
            error: 0,
            dead: Vec::new(),
            deaf: Vec::new(),
            unresponsive_until: Timestamp::ZERO,
            next_cycle: Timestamp::ZERO,
            late: Duration::ZERO,
            cycle: 0,
            out: Vec::new(),
            commands_seen: Vec::new(),
            revision: [3, 67],
            rates: vec![[0x4D, 0x67]],
            flips: Vec::new(),
            strays: (0, Vec::new()),
        }
    }

    pub(super) fn records(&mut self) -> Vec<u8> {
        self.cycle += 1;
        let q = [1.0, 0.0, 0.0, 0.0];
        let p = [0.3 + 0.001 * f64::from(self.cycle % 10), 0.1, 0.2];
        let shape = |address: u8| {
            let format = self.formats[usize::from(address.saturating_sub(1))];
            Shape { format, button: false, group: self.group }
        };
        let addresses: Vec<u8> = if self.group { (1..=self.units.len() as u8).collect() } else { vec![0] };
        let mut bytes = Vec::new();
        for address in addresses {
            let runs = !self.group || self.units[usize::from(address) - 1] & 0xE0 == 0xE0;
            if runs && !self.dead.contains(&address) {
                record::encode(p, q, (0, address), shape(address), Scale::default(), &mut bytes);
            }
        }
        bytes
    }

    pub(super) fn take(&mut self, now: Timestamp, bytes: &[u8]) {
        if now < self.unresponsive_until && !self.initialised {
            return;
        }
        for &byte in bytes {
            if let Some(parsed) = self.commands.push(byte) {
                match parsed {
                    Ok(addressed) => self.obey(now, addressed.to, addressed.command),
                    Err(_) => self.error = 6,
                }
            }
        }
    }

    pub(super) fn obey(&mut self, now: Timestamp, to: Option<u8>, command: Command) {
        let to = to.unwrap_or(1);
        self.commands_seen.push(command.clone());
        let busy = self.unresponsive_until.max(now);
        let mut answer = |ms: u64, bytes: Vec<u8>| self.out.push((busy + Duration::from_millis(ms), bytes));
        match command {
            Command::Point => {
                self.streaming = false;
                let bytes = self.records();
                self.out.push((busy + Duration::from_millis(10), bytes));
            }
            Command::Stream => {
                self.streaming = true;
                self.next_cycle = now + CYCLE.max(self.late);
            }
            Command::Run => self.running = true,
            Command::Format(_) if self.dead.contains(&to) || self.deaf.contains(&to) => {}
            Command::Format(format) => self.formats[usize::from(to) - 1] = format,
            Command::Change { parameter: 0x23, data } => self.group = data[0] != 0,
            Command::Change { parameter: 0x32, .. } => {
                self.initialised = true;
                self.unresponsive_until = now + Duration::from_millis(270);
                // A chain with a hole is not configured: the unit on the line does not run, those behind it do.
                let configured = if self.dead.is_empty() { 0x60 } else { 0 };
                self.units.iter_mut().for_each(|unit| *unit |= configured);
            }
            Command::Examine(0) => {
                let status = 0x8100u16
                    | u16::from(self.initialised) << 14
                    | u16::from(self.running) << 12
                    | u16::from(self.formats[0].status_code()) << 1;
                answer(8, status.to_le_bytes().to_vec());
            }
            Command::Examine(1) => answer(8, self.revision.to_vec()),
            Command::Examine(26) if self.revision >= [3, 71] => answer(9, vec![0x57, 0x14]),
            Command::Examine(7) => {
                answer(8, self.rates[0].to_vec());
                if self.rates.len() > 1 {
                    self.rates.remove(0);
                }
            }
            Command::Examine(10) => {
                answer(8, vec![self.error]);
                self.error = 0;
            }
            Command::Examine(15) => answer(15, b"6DFOB     ".to_vec()),
            Command::Examine(19) => answer(8, vec![0]),
            Command::Examine(36) => {
                let mut bytes = self.units.clone();
                self.dead.iter().for_each(|&address| bytes[usize::from(address) - 1] = 0);
                if !self.flips.is_empty() {
                    bytes[0] ^= self.flips.remove(0);
                }
                match &mut self.strays {
                    (0, strays) if !strays.is_empty() => bytes = strays.remove(0),
                    (left, _) => *left = left.saturating_sub(1),
                }
                bytes.resize(if bytes.len() > 14 { 30 } else { 14 }, 0);
                answer(45, bytes);
            }
            _ => {}
        }
    }

    pub(super) fn power_cycle(&mut self, now: Timestamp) {
        let birds = self.units.len() as u8;
        let fresh = if birds == 0 { Self::alone() } else { Self::flock(birds) };
        *self = Self { initialised: false, unresponsive_until: now + Duration::from_secs(2), ..fresh };
    }

    /// When something comes out, and what.
    pub(super) fn next(&self) -> Option<Timestamp> {
        let cycle = self.streaming.then_some(self.next_cycle);
        self.out.iter().map(|(at, _)| *at).chain(cycle).min()
    }

    pub(super) fn give(&mut self, now: Timestamp) -> Vec<u8> {
        if self.streaming && self.next_cycle <= now {
            self.next_cycle = self.next_cycle + CYCLE;
            return self.records();
        }
        let i = (0..self.out.len()).find(|&i| self.out[i].0 <= now).unwrap();
        self.out.remove(i).1
    }
}

pub(super) struct Bench {
    pub(super) now: Timestamp,
    pub(super) session: FlockSession,
    pub(super) unit: Unit,
    pub(super) cable: bool,
    pub(super) samples: Vec<(Timestamp, Sample)>,
    pub(super) warnings: Vec<String>,
    pub(super) states: Vec<(Timestamp, State)>,
    pub(super) rts: Vec<(Timestamp, bool)>,
}

impl Bench {
    pub(super) fn new(settings: Settings, wanted: &[u16], unit: Unit) -> Self {
        let session = FlockSession::new(settings, 115_200, wanted).unwrap();
        Self {
            now: Timestamp::ZERO,
            session,
            unit,
            cable: true,
            samples: Vec::new(),
            warnings: Vec::new(),
            states: Vec::new(),
            rts: Vec::new(),
        }
    }

    pub(super) fn open(&mut self, modem_lines: bool) {
        self.cable = true;
        self.session.handle_line(self.now, &LineEvent::Opened { modem_lines });
        self.drain();
    }

    pub(super) fn close(&mut self) {
        self.cable = false;
        self.session.handle_line(self.now, &LineEvent::Closed { reason: "unplugged".into() });
        self.drain();
    }

    pub(super) fn drain(&mut self) {
        while let Some(output) = self.session.poll_output() {
            match output {
                Output::Transmit(bytes) if self.cable => self.unit.take(self.now, &bytes),
                Output::Transmit(_) => {}
                Output::SetRts(asserted) => self.rts.push((self.now, asserted)),
                Output::Sample(sample) => self.samples.push((self.now, sample)),
                Output::StateChanged => self.states.push((self.now, self.session.state().clone())),
                Output::Warning(text) => self.warnings.push(text),
                Output::HeadingReset { .. } | Output::Pressed { .. } => {}
            }
        }
    }

    pub(super) fn run(&mut self, seconds: f64) {
        let end = self.now + Duration::from_secs_f64(seconds);
        loop {
            let unit_at = self.unit.next();
            let session_at = self.session.poll_timeout();
            let Some(at) = [unit_at, session_at].into_iter().flatten().min().filter(|&at| at <= end) else {
                break;
            };
            self.now = self.now.max(at);
            if unit_at == Some(at) {
                let bytes = self.unit.give(self.now);
                if self.cable {
                    self.session.handle_bytes(self.now, &bytes);
                }
            } else {
                self.session.handle_timeout(self.now);
            }
            self.drain();
        }
        self.now = end;
    }

    /// Time of the first sample after `t`, in seconds after it.
    pub(super) fn first_sample_after(&self, t: Timestamp) -> f64 {
        self.samples.iter().find(|(at, _)| *at > t).expect("no sample").0.seconds_since(t)
    }
}
