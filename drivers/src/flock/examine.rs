//! Finds out what is on the line: revision, status, model, the units of the flock, their rate.
//!
//! What comes in: bytes and timeouts. What goes out: bytes to send and, at the end, [`Findings`]. It
//! changes nothing at the device except that it stops a stream.

use std::collections::VecDeque;
use std::time::Duration;

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::asker::{Asker, Expired};
use super::family::{Family, INPUTS};
use super::wire::value::{self, parameter};
use super::wire::{Addressing, BirdStatus, Command, UnitStatus};
use crate::rate::ImpossibleRate;
use crate::sample::Timestamp;

/// Silence after POINT before the first question.
const FIRST_QUIET: Duration = Duration::from_millis(100);
/// Silence after the last stray byte.
const QUIET: Duration = Duration::from_millis(40);
/// How long a stream may go on after the stop command.
const STOP_LIMIT: Duration = Duration::from_millis(600);
/// Answers about the flock that may differ from the one before, the first one among them.
const DISPUTES: u8 = 4;
/// Tries to stop a stream.
const STOP_TRIES: u8 = 3;

/// One unit of a flock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub struct Unit {
    /// Address on the bus, from 1.
    pub address: u8,
    /// What it is and does, as it was at the examination.
    pub status: UnitStatus,
}

impl Unit {
    /// Whether it sends records in group mode.
    pub fn streams(self) -> bool {
        self.status.has(UnitStatus::ACCESSIBLE | UnitStatus::RUNNING | UnitStatus::SENSOR)
    }
}

/// What an examination found: the unit's own answers, which carry no checksum. What it did not answer has a default.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Findings {
    /// As the caller has fixed it, else as the model and the answers about sensors show.
    pub family: Family,
    /// Software revision: integer part, fraction in hundredths ((3, 67) is 3.67).
    pub revision: (u8, u8),
    /// Status of the unit on the line.
    pub status: BirdStatus,
    /// Model as the unit writes it, without padding; empty where it does not tell. Bytes that are not UTF-8 are replaced.
    pub model: String,
    /// How units are numbered: as the caller has fixed it, else as the unit reports it, else normal.
    pub addressing: Addressing,
    /// Units that are accessible on the bus, by rising address; empty for a stand-alone unit. Of a 3D Guidance unit the inputs with a
    /// sensor.
    pub units: Vec<Unit>,
    /// Measurement rate that the unit is set to, Hz, one of [`Family::rates_hz`]; [`Family::power_up_rate_hz`] where it does not
    /// report it, or reports another.
    pub rate_hz: f64,
}

impl Findings {
    /// Whether the unit is alone, and so without address.
    pub fn stand_alone(&self) -> bool {
        self.family == Family::Flock && self.units.is_empty()
    }

    /// Whether positions have the full scale of an extended range transmitter.
    pub fn extended_range(&self) -> bool {
        self.model.starts_with("6DERC")
            || self.units.iter().any(|unit| unit.status.has(UnitStatus::EXTENDED_RANGE))
    }

    /// Addresses of accessible units that have a sensor, rising; `[0]` for a stand-alone unit, whether it has one or not.
    pub fn sensors(&self) -> Vec<u8> {
        if self.stand_alone() {
            return vec![0];
        }
        let sensing = |unit: &&Unit| unit.status.has(UnitStatus::SENSOR);
        self.units.iter().filter(sensing).map(|unit| unit.address).collect()
    }
}

/// Why an examination failed; [`Failure::advice`] has the words for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Failure {
    /// Not a byte came.
    Silent,
    /// Bytes came, but no answers to the first questions.
    Unintelligible,
    /// The stream could not be stopped in three tries.
    DoesNotStop,
}

impl Failure {
    /// What to check, for the operator; `baud` is the line rate that was tried, bit/s.
    pub fn advice(self, baud: u32) -> String {
        match self {
            Self::Silent => format!(
                "nothing answers at {baud} baud; check the unit's power and FLY switch, the cable (a straight \
                 one with RTS not held), and that the baud switches 1 to 3 say {baud}"
            ),
            Self::Unintelligible => format!(
                "bytes come in, but no answers that a Flock would give; check that the unit's baud switches are set to {baud}, \
                 and that no other program uses the port"
            ),
            Self::DoesNotStop => format!(
                "bytes keep coming after the stop command; check that the unit's baud switches are set to {baud}, \
                 and that the line from the computer to the unit is connected"
            ),
        }
    }
}

/// Progress of an examination after an input.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress {
    /// Not done yet: wait for bytes, or for the next deadline.
    Busy,
    /// Done: give it no more inputs.
    Found(Box<Findings>),
    /// Failed: give it no more inputs.
    Failed(Failure),
}

#[derive(Clone, Copy, Debug, PartialEq, Plain)]
enum Step {
    Stop,
    Revision,
    Status,
    Addressing,
    Model,
    /// Whether a 3D Guidance unit has a sensor at this input.
    Input(u8),
    Topology,
    Rate,
}

/// A running examination: after every input drain [`Self::poll_transmit`], and wait for [`Self::poll_timeout`]. It stops a
/// stream and changes nothing else.
#[derive(Clone, Debug, Plain)]
pub struct Examination {
    step: Step,
    /// While stopping: the line is quiet at the first, given up at the second.
    quiet_at: Timestamp,
    stop_limit: Timestamp,
    stops_left: u8,
    asker: Option<Asker>,
    received: bool,
    findings: Findings,
    fixed_addressing: bool,
    fixed_family: bool,
    tries: u8,
    /// The latest answer about the flock, but for who runs: none has a checksum, so that two in a row must agree.
    topology: Option<Vec<u8>>,
    /// How often they may still differ.
    disputes_left: u8,
    #[state(skip)]
    transmits: VecDeque<Vec<u8>>,
    bytes_skipped: u64,
    warnings: Vec<String>,
}

impl Examination {
    /// Begins: stops a stream, then asks for revision and status, `tries` times each (at least once), and for the rest twice
    /// each. `family` and `addressing` fix what it is and how units are numbered; `None`: as the unit reports it.
    pub fn new(now: Timestamp, family: Option<Family>, addressing: Option<Addressing>, tries: u8) -> Self {
        let fixed_family = family.is_some();
        let family = family.unwrap_or_default();
        Self {
            step: Step::Stop,
            quiet_at: now + FIRST_QUIET,
            stop_limit: now + STOP_LIMIT,
            stops_left: STOP_TRIES - 1,
            asker: None,
            received: false,
            findings: Findings {
                family,
                revision: (0, 0),
                status: BirdStatus(0),
                model: String::new(),
                addressing: addressing.unwrap_or_default(),
                units: Vec::new(),
                rate_hz: family.power_up_rate_hz(),
            },
            fixed_addressing: addressing.is_some(),
            fixed_family,
            tries,
            topology: None,
            disputes_left: DISPUTES,
            transmits: VecDeque::from([Command::Point.to_bytes(None, Addressing::Normal)]),
            bytes_skipped: 0,
            warnings: Vec::new(),
        }
    }

    /// Bytes to send, in order, until `None`.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        self.transmits.pop_front()
    }

    /// When to call [`Self::handle_timeout`].
    pub fn poll_timeout(&self) -> Timestamp {
        match &self.asker {
            Some(asker) => asker.poll_timeout(),
            None => self.quiet_at.min(self.stop_limit),
        }
    }

    /// Bytes that were no part of an answer since the last call; the rest of a stopped stream is not counted.
    pub fn take_bytes_skipped(&mut self) -> u64 {
        std::mem::take(&mut self.bytes_skipped)
    }

    /// Sentences for the operator since the last call: answers that were not believed.
    pub fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// Bytes were read at `now`, cut anywhere. While the stream is being stopped they only prolong the wait.
    pub fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) -> Progress {
        self.received |= !bytes.is_empty();
        let Some(asker) = &mut self.asker else {
            self.quiet_at = self.quiet_at.max(now + QUIET);
            return Progress::Busy;
        };
        let (answer, skipped) = asker.handle_bytes(bytes);
        self.bytes_skipped += skipped;
        match answer {
            Some(answer) => self.answered(now, &answer),
            None => Progress::Busy,
        }
    }

    /// The time of [`Self::poll_timeout`] has come. A call before that time does nothing.
    pub fn handle_timeout(&mut self, now: Timestamp) -> Progress {
        let Some(asker) = &mut self.asker else {
            return self.stopping(now);
        };
        let (expired, lost) = asker.handle_timeout(now);
        self.bytes_skipped += lost;
        match expired {
            Expired::No => Progress::Busy,
            Expired::Again(bytes) => {
                self.transmits.push_back(bytes);
                Progress::Busy
            }
            Expired::GaveUp => match self.step {
                Step::Revision | Step::Status | Step::Stop => {
                    Progress::Failed(if self.received { Failure::Unintelligible } else { Failure::Silent })
                }
                // No inputs: a Flock of a model that nobody has listed.
                Step::Input(_) if self.findings.family == Family::Flock => self.ask(now, Step::Topology),
                Step::Topology if self.topology.is_some() => Progress::Failed(Failure::Unintelligible),
                // Firmware without this parameter gives no answer; the defaults stand.
                _ => self.next_step(now),
            },
        }
    }

    fn stopping(&mut self, now: Timestamp) -> Progress {
        if now >= self.quiet_at {
            return self.next_step(now);
        }
        if now < self.stop_limit {
            return Progress::Busy;
        }
        if self.stops_left == 0 {
            return Progress::Failed(Failure::DoesNotStop);
        }
        self.stops_left -= 1;
        self.stop_limit = now + STOP_LIMIT;
        self.quiet_at = now + FIRST_QUIET;
        // Newer firmware has a command of its own; older answers it with an error that nobody reads.
        self.transmits.push_back(Command::StreamStop.to_bytes(None, Addressing::Normal));
        self.transmits.push_back(Command::Point.to_bytes(None, Addressing::Normal));
        Progress::Busy
    }

    fn ask(&mut self, now: Timestamp, step: Step) -> Progress {
        let number = match step {
            Step::Stop | Step::Revision => parameter::SOFTWARE_REVISION,
            Step::Status => parameter::BIRD_STATUS,
            Step::Addressing => parameter::FBB_ADDRESSING_MODE,
            Step::Model => parameter::MODEL_ID,
            Step::Input(_) => parameter::SENSOR_SERIAL,
            Step::Topology => parameter::FLOCK_SYSTEM_STATUS,
            Step::Rate => parameter::MEASUREMENT_RATE,
        };
        let tries = if matches!(step, Step::Revision | Step::Status) { self.tries } else { 2 };
        let to = if let Step::Input(address) = step { Some(address) } else { None };
        let asker = Asker::new(now, &Command::Examine(number), to, self.findings.addressing, tries);
        self.transmits.push_back(asker.question());
        self.asker = Some(asker);
        self.step = step;
        Progress::Busy
    }

    fn answered(&mut self, now: Timestamp, answer: &[u8]) -> Progress {
        let found = &mut self.findings;
        match (self.step, answer) {
            (Step::Revision, &[integer, fraction]) => found.revision = (integer, fraction),
            (Step::Status, &[low, high]) => {
                found.status = BirdStatus::from_bytes([low, high]);
                if found.status.has(BirdStatus::EXPANDED)
                    && !self.fixed_addressing
                    && found.revision >= (3, 33)
                {
                    found.addressing = Addressing::Expanded;
                }
            }
            (Step::Addressing, &[code]) => {
                if let (Some(addressing), false) = (Addressing::from_code(code), self.fixed_addressing) {
                    found.addressing = addressing;
                }
            }
            (Step::Model, model) => {
                let model = String::from_utf8_lossy(model).trim_matches([' ', '\0']).to_owned();
                if !model.chars().all(|c| c.is_ascii_graphic() || c == ' ') {
                    // Not its name: answers are out of step with the questions.
                    return Progress::Failed(Failure::Unintelligible);
                }
                found.model = model;
            }
            (Step::Input(address), &[low, high]) => {
                if std::mem::replace(&mut found.family, Family::Guidance) == Family::Flock {
                    found.rate_hz = Family::Guidance.power_up_rate_hz();
                }
                // Without a sensor the number is 0.
                if [low, high] != [0, 0] {
                    let status = UnitStatus::ACCESSIBLE | UnitStatus::RUNNING | UnitStatus::SENSOR;
                    found.units.push(Unit { address, status: UnitStatus(status) });
                }
            }
            (Step::Topology, bytes) => {
                found.units = units(bytes);
                let answer = Some(bytes.iter().map(|status| status & !UnitStatus::RUNNING).collect());
                if self.topology != answer {
                    self.topology = answer;
                    if self.disputes_left == 0 {
                        return Progress::Failed(Failure::Unintelligible);
                    }
                    self.disputes_left -= 1;
                    return self.ask(now, Step::Topology);
                }
            }
            (Step::Rate, &[low, high]) => match value::claimed_rate([low, high], found.family) {
                Ok(rate) => found.rate_hz = rate.hz(),
                Err(refused) => self.warnings.push(not_believed(&refused, found.rate_hz)),
            },
            _ => {}
        }
        self.next_step(now)
    }

    fn next_step(&mut self, now: Timestamp) -> Progress {
        let revision = self.findings.revision;
        let guidance = self.findings.family == Family::Guidance;
        match self.step {
            // Nobody has shown that such a unit reports a revision as a Flock does.
            Step::Stop if guidance => self.ask(now, Step::Status),
            Step::Stop => self.ask(now, Step::Revision),
            Step::Revision => self.ask(now, Step::Status),
            Step::Status if revision >= (3, 67) && !guidance => self.ask(now, Step::Addressing),
            Step::Status | Step::Addressing => self.ask(now, Step::Model),
            Step::Model
                if guidance || !self.fixed_family && Family::may_be_guidance(&self.findings.model) =>
            {
                self.ask(now, Step::Input(*INPUTS.start()))
            }
            Step::Model => self.ask(now, Step::Topology),
            Step::Input(address) if address < *INPUTS.end() => self.ask(now, Step::Input(address + 1)),
            Step::Input(_) => self.ask(now, Step::Rate),
            // Before revision 3 this number gave 36 other bytes.
            Step::Topology if revision.0 >= 3 => self.ask(now, Step::Rate),
            Step::Topology | Step::Rate => {
                self.asker = None;
                Progress::Found(Box::new(self.findings.clone()))
            }
        }
    }
}

/// What the operator hears of a measurement rate that cannot be; `kept_hz` is taken in its place, Hz.
pub(super) fn not_believed(refused: &ImpossibleRate, kept_hz: f64) -> String {
    format!("the unit answers its measurement rate with damage: {refused}; going on with {kept_hz} Hz")
}

/// Units of a FLOCK SYSTEM STATUS answer.
pub(super) fn units(bytes: &[u8]) -> Vec<Unit> {
    (1u8..)
        .zip(bytes)
        .map(|(address, &status)| Unit { address, status: UnitStatus(status) })
        .filter(|unit| unit.status.has(UnitStatus::ACCESSIBLE))
        .collect()
}
