//! The live session with a Flock of Birds: set-up, stream, recovery.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, bytes to send, the state of the
//! link. What it never does: wait; every pause is a deadline that [`Session::poll_timeout`] tells.
//!
//! Life: `Closed -> (Resetting ->) Examining -> Configuring -> Streaming`; silence leads back to Examining,
//! failure to a short pause and then there. A flock that still runs as configured is not configured
//! again: after a break of the line the stream is back in about 0.3 s. One that has to be auto-configured needs
//! 0.6 s of quiet time for it, 0.3 s more where another unit has the transmitter. Every stream settles for half a second.

mod configure;
mod listen;
mod stream;

use std::collections::VecDeque;
use std::time::Duration;

use posed_state::Plain;

use super::asker::Expired;
use super::examine::{Examination, Failure, Findings, Progress};
use super::family::{Family, INPUTS};
use super::settings::{Mode, Settings, SettingsError};
use crate::sample::Timestamp;
use crate::serial::stations;
use crate::session::{Counters, LineEvent, Output, SensorInfo, Session, State};
use configure::Configuring;
use stream::{POINT_LIMIT, Streaming};

/// How long RTS holds the unit in reset, and how long it then takes to be ready.
const RESET_PULSE: Duration = Duration::from_secs(1);
const BOOT: Duration = Duration::from_secs(2);
/// Pauses between attempts at a silent unit: the first, and the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_millis(250);

/// A live session with one Flock of Birds; see the module's words. Samples are poses in the transmitter frame, of the birds
/// asked for; the unit's own estimate, without checksum, cut and checked by [`super::parser`].
#[derive(Clone, Debug, posed_state::State)]
pub struct FlockSession {
    #[state(keep)]
    settings: Settings,
    #[state(keep)]
    baud: u32,
    #[state(keep)]
    wanted: Vec<u8>,
    phase: Phase,
    state: State,
    counters: Counters,
    settling: u64,
    sensors: Vec<SensorInfo>,
    rate_hz: Option<f64>,
    findings: Option<Findings>,
    /// Serial numbers of sensors by the address of their bird, 0 where nothing is plugged in; read once per opening.
    serials: Vec<(u8, u16)>,
    modem_lines: bool,
    /// Until then silence may be a unit that starts: no answer is no news.
    powered_up_at: Timestamp,
    pause: Duration,
    /// Set-ups in a row that ended with birds which do not run.
    set_up_in_part: u8,
    /// Birds for whose format the flock was set up again, and of which no record has come since: once must do.
    set_up_for: Vec<u8>,
    /// Cycles go on counting over a new set-up.
    next_cycle: u64,
    #[state(keep)]
    outputs: VecDeque<Output>,
}

#[derive(Clone, Debug, Plain)]
enum Phase {
    Closed,
    Resetting { until: Timestamp, asserted: bool },
    Examining(Box<Examination>),
    Configuring(Box<Configuring>),
    Streaming(Box<Streaming>),
    Pausing { until: Timestamp },
}

impl FlockSession {
    /// A session for the birds `wanted`: `[0]` for a stand-alone unit, else addresses on the flock's bus, in any order. `baud`
    /// is the line rate, bit/s, which limits the rate of records; 0 where the line has no such limit. Closed until the line opens.
    ///
    /// # Errors
    /// A setting is out of its range; `wanted` is empty, names an address twice, 0 beside others, or one above 126; of a 3D Guidance
    /// unit one that is not 1 to 4.
    pub fn new(settings: Settings, baud: u32, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        let wanted = match settings.family {
            Family::Flock if wanted == [0] => vec![0],
            Family::Flock => stations(wanted, 126, "0 alone, or different numbers from 1 to 126")?,
            Family::Guidance => stations(wanted, *INPUTS.end(), "different numbers from 1 to 4")?,
        };
        Ok(Self {
            settings,
            baud,
            wanted,
            phase: Phase::Closed,
            state: State::Connecting { reason: "the port is not open yet".into() },
            counters: Counters::default(),
            settling: 0,
            sensors: Vec::new(),
            rate_hz: None,
            findings: None,
            serials: Vec::new(),
            modem_lines: false,
            powered_up_at: Timestamp::ZERO,
            pause: FIRST_PAUSE,
            set_up_in_part: 0,
            set_up_for: Vec::new(),
            next_cycle: 0,
            outputs: VecDeque::new(),
        })
    }

    /// Records that were not published because birds had just been started or had come back, well formed or not; since the
    /// session was made.
    pub fn records_settling(&self) -> u64 {
        self.settling
    }

    /// Serial number of a bird's sensor, where the unit has reported one.
    fn serial(&self, address: u8) -> Option<String> {
        let reported = self.serials.iter().find(|&&(of, serial)| of == address && serial > 0);
        reported.map(|(_, serial)| serial.to_string())
    }

    /// What the last examination found, with the rate and the running units as set-up has changed them; `None` before the first,
    /// and always where the session only listens.
    pub fn findings(&self) -> Option<&Findings> {
        self.findings.as_ref()
    }

    fn set_state(&mut self, state: State) {
        if self.state != state {
            self.state = state;
            self.outputs.push_back(Output::StateChanged);
        }
    }

    /// Reports that set-up is under way, unless a silent or failed unit is being tried again.
    fn connecting(&mut self, reason: &str) {
        if !matches!(self.state, State::Silent { .. } | State::Failed { .. }) {
            self.set_state(State::Connecting { reason: reason.into() });
        }
    }

    fn warn(&mut self, text: String) {
        self.outputs.push_back(Output::Warning(text));
    }

    fn transmit(&mut self, bytes: Vec<u8>) {
        if !bytes.is_empty() {
            self.outputs.push_back(Output::Transmit(bytes));
        }
    }

    fn examine(&mut self, now: Timestamp) {
        self.connecting("asking the unit what it is");
        let mut examination = Examination::new(now, Some(self.settings.family), self.settings.addressing, 3);
        while let Some(bytes) = examination.poll_transmit() {
            self.transmit(bytes);
        }
        self.phase = Phase::Examining(Box::new(examination));
    }

    fn pause_and_retry(&mut self, now: Timestamp, state: State) {
        self.set_state(state);
        self.phase = Phase::Pausing { until: now + self.pause };
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
    }

    fn on_progress(&mut self, now: Timestamp, progress: Progress, mut examination: Box<Examination>) {
        self.counters.bytes_skipped += examination.take_bytes_skipped();
        examination.take_warnings().into_iter().for_each(|warning| self.warn(warning));
        while let Some(bytes) = examination.poll_transmit() {
            self.transmit(bytes);
        }
        match progress {
            Progress::Busy => self.phase = Phase::Examining(examination),
            Progress::Failed(failure) => {
                if failure == Failure::Silent && now < self.powered_up_at {
                    self.connecting("no answer yet; a unit that was just switched on needs a moment");
                    self.phase = Phase::Pausing { until: now + FIRST_PAUSE };
                    return;
                }
                let reason = failure.advice(self.baud);
                let state = match failure {
                    Failure::Silent => State::Silent { reason },
                    Failure::Unintelligible | Failure::DoesNotStop => State::Failed { reason },
                };
                self.pause_and_retry(now, state);
            }
            Progress::Found(findings) => self.configure(now, *findings),
        }
    }
}

impl Session for FlockSession {
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { modem_lines } => {
                self.leave_stream();
                self.modem_lines = *modem_lines;
                self.serials.clear();
                self.set_up_for.clear();
                self.pause = FIRST_PAUSE;
                self.powered_up_at = now + self.settings.family.power_up();
                self.set_state(State::Connecting { reason: "the port is open".into() });
                if self.settings.mode == Mode::Listen {
                    return self.listen(now);
                }
                if !modem_lines {
                    return self.examine(now);
                }
                // Opening has raised RTS, which holds the unit in reset: end that in any case.
                // What RTS does to a 3D Guidance unit is not known.
                let asserted = self.settings.reset_on_open && self.settings.family == Family::Flock;
                let wait = if asserted { RESET_PULSE } else { BOOT };
                self.outputs.push_back(Output::SetRts(asserted));
                self.phase = Phase::Resetting { until: now + wait, asserted };
            }
            LineEvent::Closed { reason } => {
                self.leave_stream();
                self.phase = Phase::Closed;
                self.set_state(State::Connecting { reason: reason.clone() });
            }
            LineEvent::Dropped { bytes } => match &mut self.phase {
                Phase::Streaming(streaming) => streaming.splitter.handle_dropped(*bytes),
                _ => self.counters.bytes_skipped += bytes,
            },
        }
    }

    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
        match std::mem::replace(&mut self.phase, Phase::Closed) {
            Phase::Streaming(streaming) => {
                self.stream(now, streaming, |splitter, emit| {
                    splitter.handle_bytes(now, bytes, &mut |event| emit(event));
                });
            }
            Phase::Examining(mut examination) => {
                let progress = examination.handle_bytes(now, bytes);
                self.on_progress(now, progress, examination);
            }
            Phase::Configuring(mut configuring) => {
                let Some((topic, asker)) = &mut configuring.question else {
                    self.counters.bytes_skipped += bytes.len() as u64;
                    self.phase = Phase::Configuring(configuring);
                    return;
                };
                let topic = *topic;
                let (answer, skipped) = asker.handle_bytes(bytes);
                self.counters.bytes_skipped += skipped;
                if let Some(answer) = answer {
                    configuring.question = None;
                    self.on_answer(now, topic, Some(&answer), configuring);
                } else {
                    self.phase = Phase::Configuring(configuring);
                }
            }
            other => {
                self.counters.bytes_skipped += bytes.len() as u64;
                self.phase = other;
            }
        }
    }

    fn handle_timeout(&mut self, now: Timestamp) {
        if self.poll_timeout().is_none_or(|at| now < at) {
            return;
        }
        match std::mem::replace(&mut self.phase, Phase::Closed) {
            Phase::Closed => {}
            Phase::Resetting { asserted: true, .. } => {
                self.outputs.push_back(Output::SetRts(false));
                self.connecting("the unit starts after its reset");
                self.phase = Phase::Resetting { until: now + BOOT, asserted: false };
            }
            Phase::Resetting { asserted: false, .. } | Phase::Pausing { .. } => self.examine(now),
            Phase::Examining(mut examination) => {
                let progress = examination.handle_timeout(now);
                self.on_progress(now, progress, examination);
            }
            Phase::Configuring(mut configuring) => {
                let Some((topic, asker)) = &mut configuring.question else {
                    return self.work_off(now, configuring);
                };
                let topic = *topic;
                let (expired, lost) = asker.handle_timeout(now);
                self.counters.bytes_skipped += lost;
                match expired {
                    Expired::No => self.phase = Phase::Configuring(configuring),
                    Expired::Again(bytes) => {
                        self.transmit(bytes);
                        self.phase = Phase::Configuring(configuring);
                    }
                    Expired::GaveUp => {
                        configuring.question = None;
                        self.on_answer(now, topic, None, configuring);
                    }
                }
            }
            Phase::Streaming(streaming) => self.stream_timeout(now, streaming),
        }
    }

    fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        match &self.phase {
            Phase::Closed => None,
            Phase::Resetting { until, .. } | Phase::Pausing { until } => Some(*until),
            Phase::Examining(examination) => Some(examination.poll_timeout()),
            Phase::Configuring(configuring) => Some(match &configuring.question {
                Some((_, asker)) => asker.poll_timeout(),
                None => configuring.quiet_until,
            }),
            Phase::Streaming(streaming) => {
                let poll_at = streaming
                    .poll
                    .as_ref()
                    .map(|poll| if poll.awaiting { poll.sent_at + POINT_LIMIT } else { poll.at });
                [streaming.splitter.poll_timeout(), poll_at]
                    .into_iter()
                    .flatten()
                    .chain([streaming.silent_at])
                    .min()
            }
        }
    }

    fn state(&self) -> &State {
        &self.state
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    fn sensors(&self) -> &[SensorInfo] {
        &self.sensors
    }

    fn rate_hz(&self) -> Option<f64> {
        self.rate_hz
    }
}
