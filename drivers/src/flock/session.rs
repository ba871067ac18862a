//! The live session with a Flock of Birds: set-up, stream, recovery.
//!
//! What comes in: line events, bytes, timeouts. What goes out: samples, bytes to send, the state of the
//! link. What it never does: wait; every pause is a deadline that [`Session::poll_timeout`] tells.
//!
//! Life: `Closed -> (Resetting ->) Examining -> Configuring -> Streaming`; silence leads back to Examining,
//! failure to a short pause and then there. A flock that still runs as configured is not configured
//! again: after a break of the line the stream is back in about 0.3 s. One that has to be auto-configured needs
//! 0.6 s of quiet time for it, 0.3 s more where another unit has the transmitter. Every stream settles for half a second.

mod listen;

use std::collections::VecDeque;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::asker::{Asker, Expired};
use super::examine::{self, Examination, Failure, Findings, Progress};
use super::parser::{Event, Splitter};
use super::plan::{self, Action};
use super::settings::{Mode, Settings, SettingsError};
use super::wire::value::{self, ErrorClass, parameter};
use super::wire::{Addressing, Command, Shape, Tolerance, UnitStatus};
use crate::sample::Timestamp;
use crate::session::{Counters, LineEvent, Output, SensorInfo, Session, State};

/// How long RTS holds the unit in reset, and how long it then takes to be ready.
const RESET_PULSE: Duration = Duration::from_secs(1);
const BOOT: Duration = Duration::from_secs(2);
/// How long after the start of a stream its poses are not believed: birds that have just begun to measure
/// are off by centimetres, and nothing they say tells whether they have.
const SETTLE: Duration = Duration::from_millis(500);
/// Quiet time after RUN.
const RUN_QUIET: Duration = Duration::from_millis(200);
/// How long auto-configured birds may take to run.
const RUNNING_LIMIT: Duration = Duration::from_secs(2);
/// Records of missing birds after which the flock is set up again with them: one may be damage.
const STRANGERS_TO_SET_UP: u8 = 4;
/// Pauses between attempts at a silent unit: the first, and the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_millis(250);
/// Shortest silence that counts as one.
const MIN_SILENCE: Duration = Duration::from_millis(250);
/// How long after its port was opened a unit may be starting: until then no answer is no news.
const POWER_UP: Duration = Duration::from_secs(3);
/// A reply to POINT that has not come by then was lost.
const POINT_LIMIT: Duration = Duration::from_millis(100);

/// A live session with one Flock of Birds; see the module's words.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FlockSession {
    settings: Settings,
    baud: u32,
    wanted: Vec<u8>,
    phase: Phase,
    state: State,
    counters: Counters,
    settling: u64,
    sensors: Vec<SensorInfo>,
    rate_hz: Option<f64>,
    findings: Option<Findings>,
    modem_lines: bool,
    /// Until then silence may be a unit that starts.
    powered_up_at: Timestamp,
    pause: Duration,
    /// Cycles go on counting over a new set-up.
    next_cycle: u64,
    #[serde(skip)]
    outputs: VecDeque<Output>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
enum Phase {
    Closed,
    Resetting { until: Timestamp, asserted: bool },
    Examining(Box<Examination>),
    Configuring(Box<Configuring>),
    Streaming(Box<Streaming>),
    Pausing { until: Timestamp },
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Configuring {
    findings: Findings,
    actions: VecDeque<Action>,
    /// Quiet until then, where no question is open.
    quiet_until: Timestamp,
    question: Option<(Topic, Asker)>,
    running_limit: Option<Timestamp>,
    /// Wanted birds that were on the bus; the others have been warned of, and are not waited for.
    present: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum Topic {
    Running,
    Error,
    ExpandedError,
    Rate,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Streaming {
    splitter: Splitter,
    silence: Duration,
    silent_at: Timestamp,
    settled_at: Timestamp,
    /// Birds that came back into the stream, and until when their poses are not believed.
    returned: Vec<(u16, Timestamp)>,
    /// Records of wanted birds that were not there at set-up.
    strangers: u8,
    /// In point mode: when the next question is due, and whether its reply is still awaited.
    poll: Option<Poll>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Poll {
    at: Timestamp,
    period: Duration,
    sent_at: Timestamp,
    awaiting: bool,
}

impl FlockSession {
    /// A session for the birds `wanted`: `[0]` for a stand-alone unit, else addresses on the flock's bus.
    ///
    /// # Errors
    /// A setting is out of its range, or the addresses cannot be on one flock.
    pub fn new(settings: Settings, baud: u32, wanted: &[u16]) -> Result<Self, SettingsError> {
        settings.validate()?;
        let bad = SettingsError { key: "address", expected: "0 alone, or different numbers from 1 to 126" };
        let mut addresses: Vec<u8> =
            wanted.iter().map(|&address| u8::try_from(address).map_err(|_| bad)).collect::<Result<_, _>>()?;
        addresses.sort_unstable();
        let distinct = addresses.windows(2).all(|pair| pair[0] != pair[1]);
        let in_range = addresses == [0] || addresses.iter().all(|address| (1..=126).contains(address));
        if addresses.is_empty() || !distinct || !in_range {
            return Err(bad);
        }
        Ok(Self {
            settings,
            baud,
            wanted: addresses,
            phase: Phase::Closed,
            state: State::Connecting { reason: "the port is not open yet".into() },
            counters: Counters::default(),
            settling: 0,
            sensors: Vec::new(),
            rate_hz: None,
            findings: None,
            modem_lines: false,
            powered_up_at: Timestamp::ZERO,
            pause: FIRST_PAUSE,
            next_cycle: 0,
            outputs: VecDeque::new(),
        })
    }

    /// Records that were well received but not published, because birds had just been started.
    pub fn records_settling(&self) -> u64 {
        self.settling
    }

    /// What the last examination found.
    pub fn findings(&self) -> Option<&Findings> {
        self.findings.as_ref()
    }

    fn set_state(&mut self, state: State) {
        if self.state != state {
            self.state = state;
            self.outputs.push_back(Output::StateChanged);
        }
    }

    /// Says that set-up is under way, unless a silent or failed unit is being tried again.
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

    fn take_counters(&mut self, streaming: &mut Streaming) {
        let counted = streaming.splitter.take_counters();
        self.counters.records += counted.records;
        self.counters.rejected += counted.rejected;
        self.counters.bytes_skipped += counted.bytes_skipped;
    }

    /// Ends the stream, if there is one, and counts what it left open.
    fn leave_stream(&mut self) {
        if let Phase::Streaming(mut streaming) = std::mem::replace(&mut self.phase, Phase::Closed) {
            streaming.splitter.finish();
            self.next_cycle = streaming.splitter.cycle() + 1;
            self.take_counters(&mut streaming);
        }
    }

    fn examine(&mut self, now: Timestamp) {
        self.connecting("asking the unit what it is");
        let mut examination = Examination::new(now, self.settings.addressing, 3);
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

    fn configure(&mut self, now: Timestamp, findings: Findings) {
        let plan = match plan::plan(&self.settings, &self.wanted, &findings) {
            Ok(plan) => plan,
            Err(reason) => return self.pause_and_retry(now, State::Failed { reason }),
        };
        self.connecting("setting the unit up");
        for warning in plan.warnings {
            self.warn(warning);
        }
        self.findings = Some(findings.clone());
        let sensors = findings.sensors();
        let present = self.wanted.iter().copied().filter(|address| sensors.contains(address)).collect();
        let configuring = Configuring {
            findings,
            actions: plan.actions,
            quiet_until: now,
            question: None,
            running_limit: None,
            present,
        };
        self.work_off(now, Box::new(configuring));
    }

    /// Does the planned actions up to the next one that takes time.
    fn work_off(&mut self, now: Timestamp, mut configuring: Box<Configuring>) {
        while configuring.question.is_none() && configuring.quiet_until <= now {
            let topic = match configuring.actions.pop_front() {
                Some(Action::Send { bytes, quiet_ms }) => {
                    self.transmit(bytes);
                    configuring.quiet_until = now + Duration::from_millis(quiet_ms);
                    continue;
                }
                Some(Action::Run) => {
                    self.transmit(Command::Run.to_bytes(None, Addressing::Normal));
                    configuring.quiet_until = now + RUN_QUIET;
                    continue;
                }
                Some(Action::AwaitRunning) => Topic::Running,
                Some(Action::ReadError) => Topic::Error,
                Some(Action::ReadRate) => Topic::Rate,
                Some(Action::Start) | None => return self.start(now, *configuring),
            };
            self.ask(now, topic, &mut configuring);
        }
        self.phase = Phase::Configuring(configuring);
    }

    fn ask(&mut self, now: Timestamp, topic: Topic, configuring: &mut Configuring) {
        let number = match topic {
            Topic::Running => parameter::FLOCK_SYSTEM_STATUS,
            Topic::Error => parameter::ERROR_CODE,
            Topic::ExpandedError => parameter::EXPANDED_ERROR_CODE,
            Topic::Rate => parameter::MEASUREMENT_RATE,
        };
        let addressing = configuring.findings.addressing;
        let asker = Asker::new(now, &Command::Examine(number), None, addressing, 2);
        self.transmit(asker.question());
        configuring.question = Some((topic, asker));
    }

    /// An answer came, or will not come (`None`).
    fn on_answer(
        &mut self,
        now: Timestamp,
        topic: Topic,
        answer: Option<&[u8]>,
        mut configuring: Box<Configuring>,
    ) {
        match (topic, answer) {
            (Topic::Running, answer) => {
                let limit = *configuring.running_limit.get_or_insert(now + RUNNING_LIMIT);
                if let Some(bytes) = answer {
                    configuring.findings.units = examine::units(bytes);
                }
                let Configuring { present, findings, .. } = &*configuring;
                let late: Vec<u8> =
                    present.iter().copied().filter(|&address| !runs(findings, address)).collect();
                if !late.is_empty() && now < limit {
                    configuring.actions.push_front(Action::AwaitRunning);
                    configuring.quiet_until = now + Duration::from_millis(20);
                } else if late.len() == configuring.present.len() {
                    let reason =
                        "after auto-configuration no wanted bird runs; check that the unit on the line \
                                  has address 1 and that all addresses follow each other"
                            .into();
                    return self.pause_and_retry(now, State::Failed { reason });
                } else if !late.is_empty() {
                    let list = late.iter().map(u8::to_string).collect::<Vec<_>>().join(", ");
                    self.warn(format!(
                        "bird {list} does not run after auto-configuration; the others go on without it"
                    ));
                }
                self.findings = Some(configuring.findings.clone());
            }
            (Topic::Error, Some(&[13])) => self.ask(now, Topic::ExpandedError, &mut configuring),
            (Topic::Error, Some(&[code])) => {
                let (text, class) = value::error(code);
                match class {
                    ErrorClass::Fatal => {
                        let reason = format!("the unit reports error {code}: {text}; switch it off and on");
                        return self.pause_and_retry(now, State::Failed { reason });
                    }
                    ErrorClass::Warning => self.warn(format!("the unit reports error {code}: {text}")),
                    // Noted errors are about commands, often those of a program before this one.
                    ErrorClass::Noted => {}
                }
            }
            (Topic::ExpandedError, Some(&[code, detail])) => {
                let (text, _) = value::error(code);
                let mask = match configuring.findings.addressing {
                    Addressing::Normal => 0x0F,
                    Addressing::Expanded => 0x1F,
                    Addressing::SuperExpanded => 0x7F,
                };
                self.warn(format!("the unit reports error {code} of unit {}: {text}", detail & mask));
            }
            (Topic::Rate, Some(&[low, high])) => {
                configuring.findings.rate_hz = value::rate_hz(u16::from_le_bytes([low, high]));
                self.findings = Some(configuring.findings.clone());
            }
            _ => {}
        }
        self.work_off(now, configuring);
    }

    fn start(&mut self, now: Timestamp, configuring: Configuring) {
        let group = self.wanted != [0];
        let shape = self.settings.shape(group);
        let birds: Vec<(u8, Shape)> = if group {
            configuring
                .findings
                .units
                .iter()
                .filter(|unit| unit.streams())
                .map(|unit| (unit.address, shape))
                .collect()
        } else {
            vec![(0, shape)]
        };
        if birds.is_empty() {
            let reason = "no bird runs; check the FLY switches and the sensor plugs".into();
            return self.pause_and_retry(now, State::Failed { reason });
        }
        let (rate_hz, warning) =
            plan::record_rate_hz(&self.settings, configuring.findings.rate_hz, &birds, self.baud);
        if let Some(warning) = warning {
            self.warn(warning);
        }
        self.rate_hz = Some(rate_hz);
        self.sensors = birds
            .iter()
            .map(|&(address, _)| SensorInfo { address: u16::from(address), serial: None })
            .collect();
        let scale = plan::scale(&self.settings, &configuring.findings);
        let mut splitter = Splitter::new(&birds, scale, Tolerance::LIVE, self.baud);
        splitter.start_at_cycle(self.next_cycle);
        let silence = MIN_SILENCE.max(Duration::from_secs_f64(10.0 / rate_hz));
        let poll = match self.settings.mode {
            Mode::Stream => {
                self.transmit(Command::Stream.to_bytes(None, Addressing::Normal));
                None
            }
            Mode::Point => {
                self.transmit(Command::Point.to_bytes(None, Addressing::Normal));
                let period = Duration::from_secs_f64(1.0 / rate_hz);
                Some(Poll { at: now + period, period, sent_at: now, awaiting: true })
            }
            Mode::Listen => None,
        };
        self.phase = Phase::Streaming(Box::new(Streaming {
            splitter,
            silence,
            silent_at: now + silence,
            settled_at: now + SETTLE,
            returned: Vec::new(),
            strangers: 0,
            poll,
        }));
    }

    /// Runs one input of the splitter and passes on what comes out.
    fn stream(
        &mut self,
        now: Timestamp,
        mut streaming: Box<Streaming>,
        input: impl FnOnce(&mut Splitter, &mut dyn FnMut(Event)),
    ) {
        let Self { outputs, settling, wanted, .. } = self;
        let mut heard = false;
        let mut published = false;
        let Streaming { splitter, settled_at, returned, strangers, .. } = &mut *streaming;
        let settled = now >= *settled_at;
        returned.retain(|&(_, until)| now < until);
        input(splitter, &mut |event| {
            match event {
            Event::Sample(sample) => {
                heard = true;
                if !settled || returned.iter().any(|&(address, _)| address == sample.address) {
                    *settling += 1;
                } else if wanted.iter().any(|&address| u16::from(address) == sample.address) {
                    published = true;
                    outputs.push_back(Output::Sample(sample));
                }
            }
            Event::Left(address) => outputs.push_back(Output::Warning(format!(
                "bird {address} has left the stream; the others go on. Check its power, FLY switch and bus cable"
            ))),
            Event::Returned(address) => {
                returned.push((u16::from(address), now + SETTLE));
                outputs.push_back(Output::Warning(format!("bird {address} is back in the stream")));
            }
            Event::Stranger(address) => {
                *strangers = strangers.saturating_add(u8::from(wanted.contains(&address)));
            }
        }
        });
        self.take_counters(&mut streaming);
        if streaming.strangers >= STRANGERS_TO_SET_UP && self.settings.mode != Mode::Listen {
            self.phase = Phase::Streaming(streaming);
            self.leave_stream();
            self.warn("a bird that was missing has appeared; the flock is set up again with it".into());
            return self.examine(now);
        }
        if heard {
            streaming.silent_at = now + streaming.silence;
            self.pause = FIRST_PAUSE;
            if let Some(poll) = &mut streaming.poll
                && streaming.splitter.at_cycle_start()
            {
                poll.awaiting = false;
            }
        }
        self.phase = Phase::Streaming(streaming);
        if published {
            self.set_state(State::Streaming);
        }
    }

    fn stream_timeout(&mut self, now: Timestamp, mut streaming: Box<Streaming>) {
        if now >= streaming.silent_at {
            if self.settings.mode == Mode::Listen {
                return self.heard_nothing(now, streaming);
            }
            let silence_ms = streaming.silence.as_millis();
            self.phase = Phase::Streaming(streaming);
            self.leave_stream();
            self.set_state(State::Silent {
                reason: format!(
                    "no record for {silence_ms} ms; check the unit's power, FLY switch and cable"
                ),
            });
            return self.examine(now);
        }
        if let Some(poll) = &mut streaming.poll {
            let lost = poll.awaiting && now >= poll.sent_at + POINT_LIMIT;
            if lost || (!poll.awaiting && now >= poll.at) {
                // Never two questions open, and never faster than the unit measures.
                poll.at = now + poll.period;
                poll.sent_at = now;
                poll.awaiting = true;
                self.outputs.push_back(Output::Transmit(Command::Point.to_bytes(None, Addressing::Normal)));
            }
        }
        self.stream(now, streaming, |splitter, emit| splitter.handle_timeout(now, &mut |event| emit(event)));
    }
}

fn runs(findings: &Findings, address: u8) -> bool {
    findings
        .units
        .iter()
        .any(|unit| unit.address == address && unit.status.has(UnitStatus::ACCESSIBLE | UnitStatus::RUNNING))
}

impl Session for FlockSession {
    fn handle_line(&mut self, now: Timestamp, event: &LineEvent) {
        match event {
            LineEvent::Opened { modem_lines } => {
                self.leave_stream();
                self.modem_lines = *modem_lines;
                self.pause = FIRST_PAUSE;
                self.powered_up_at = now + POWER_UP;
                self.set_state(State::Connecting { reason: "the port is open".into() });
                if self.settings.mode == Mode::Listen {
                    return self.listen(now);
                }
                if !modem_lines {
                    return self.examine(now);
                }
                // Opening has raised RTS, which holds the unit in reset: end that in any case.
                let asserted = self.settings.reset_on_open;
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
