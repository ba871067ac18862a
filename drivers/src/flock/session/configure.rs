//! Set-up: works off the plan, one action or question at a time.
//!
//! What comes in: findings, answers and the passing of quiet times. What goes out: commands and questions, then a
//! stream. What it never does: have two questions open.

use std::collections::VecDeque;
use std::time::Duration;

use posed_state::Plain;

use super::stream::NEWCOMER;
use super::{FlockSession, Phase};
use crate::flock::asker::Asker;
use crate::flock::examine::{self, Findings};
use crate::flock::plan::{self, Action};
use crate::flock::wire::value::{self, ErrorClass, parameter};
use crate::flock::wire::{Addressing, Command, UnitStatus};
use crate::sample::Timestamp;
use crate::session::State;

/// Quiet time after RUN.
const RUN_QUIET: Duration = Duration::from_millis(200);
/// How long auto-configured birds may take to run.
const RUNNING_LIMIT: Duration = Duration::from_secs(2);
/// Set-ups after which those that run go on alone. One in which a bird does not run may have met a unit that was switched off
/// and on meanwhile: what it had been set to is lost.
const SET_UPS: u8 = 2;

#[derive(Clone, Debug, Plain)]
pub(super) struct Configuring {
    pub(super) findings: Findings,
    pub(super) actions: VecDeque<Action>,
    /// Quiet until then, where no question is open.
    pub(super) quiet_until: Timestamp,
    pub(super) question: Option<(Topic, Asker)>,
    pub(super) running_limit: Option<Timestamp>,
    /// Wanted birds that were on the bus; the others have been warned of, and are not waited for.
    pub(super) present: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) enum Topic {
    Running,
    Error,
    ExpandedError,
    Rate,
    /// Of this bird's sensor; 0 for a stand-alone unit.
    Serial(u8),
}

impl FlockSession {
    pub(super) fn configure(&mut self, now: Timestamp, findings: Findings) {
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
    pub(super) fn work_off(&mut self, now: Timestamp, mut configuring: Box<Configuring>) {
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
                Some(Action::ReadSerial(address)) if self.serial(address).is_some() => continue,
                Some(Action::ReadSerial(address)) => Topic::Serial(address),
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
            Topic::Serial(_) => parameter::SENSOR_SERIAL,
        };
        let to = match topic {
            Topic::Serial(address) => Some(address).filter(|&address| address > 0),
            _ => None,
        };
        let addressing = configuring.findings.addressing;
        let asker = Asker::new(now, &Command::Examine(number), to, addressing, 2);
        self.transmit(asker.question());
        configuring.question = Some((topic, asker));
    }

    /// Whether birds stream that were not there when this set-up began: it has not set their format, and the order needs the
    /// length of their records.
    fn has_newcomers(&self, configuring: &Configuring) -> bool {
        let examined = self.findings.as_ref().map(Findings::sensors).unwrap_or_default();
        configuring.findings.units.iter().any(|unit| unit.streams() && !examined.contains(&unit.address))
    }

    /// An answer came, or will not come (`None`).
    pub(super) fn on_answer(
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
                    let before = configuring.findings.extended_range();
                    let units = std::mem::replace(&mut configuring.findings.units, examine::units(bytes));
                    if configuring.findings.extended_range() != before {
                        // Two answers had said so: this one is damaged.
                        configuring.findings.units = units;
                    }
                }
                if self.has_newcomers(&configuring) {
                    self.warn(NEWCOMER.into());
                    return self.examine(now);
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
                    self.set_up_in_part += 1;
                    if self.set_up_in_part < SET_UPS {
                        let reason = format!(
                            "bird {list} does not run after auto-configuration, which is tried again"
                        );
                        return self.pause_and_retry(now, State::Failed { reason });
                    }
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
                // It has just been set: what was asked for is the best guess where the answer is damaged.
                let asked = self.settings.measurement_rate_hz.unwrap_or(configuring.findings.rate_hz);
                configuring.findings.rate_hz = match value::claimed_rate([low, high], self.settings.family) {
                    Ok(rate) => rate.hz(),
                    Err(refused) => {
                        self.warn(examine::not_believed(&refused, asked));
                        asked
                    }
                };
                self.findings = Some(configuring.findings.clone());
            }
            (Topic::Serial(address), Some(&[low, high])) => {
                self.serials.push((address, u16::from_le_bytes([low, high])));
            }
            _ => {}
        }
        self.work_off(now, configuring);
    }
}

fn runs(findings: &Findings, address: u8) -> bool {
    findings
        .units
        .iter()
        .any(|unit| unit.address == address && unit.status.has(UnitStatus::ACCESSIBLE | UnitStatus::RUNNING))
}
