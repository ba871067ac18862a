//! Brings a device from whatever it does to measuring what the fusion needs.
//!
//! What comes in: its messages, and timeouts. What goes out: requests, one at a time, and in the end a
//! [`Plan`] of what the data messages will hold, or why there is none. Settings are written only where they
//! differ: a device stores each in its flash memory at once.

use std::time::Duration;

use posed_state::Plain;

use super::frame::{Frame, OVERHEAD};
use super::message::{self, Configuration, DeviceKind, MASTER, PERIOD_TICKS_PER_S, RATES_HZ};
use super::mtdata::Layout;
use super::mtdata2::id;
use super::settings::Settings;
use super::stream::{Plan, Shape, Unit};
use crate::rate::{ImpossibleRate, Rate};
use crate::sample::Timestamp;

/// Slowest rate that set-up goes down to before it gives up.
const SLOWEST_HZ: f64 = 5.0;
/// Share of the line that data may fill.
const LINE_SHARE: f64 = 0.95;
/// Output rate of items that come with every message.
const ALWAYS: u16 = 0xFFFF;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
enum Step {
    GotoConfig,
    DeviceId,
    InitBus,
    Configuration,
    ReadOutputs,
    WriteOutputs,
    Mode(usize),
    Settings(usize),
    Period,
    Verify,
    Measure,
}

/// What a set-up has come to.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Progress {
    /// It waits for an answer.
    Busy,
    /// The device measures.
    Done(Plan),
    /// The device does not answer.
    Unanswered,
    /// The device answers, and refuses.
    Refused(String),
}

/// A set-up under way.
#[derive(Clone, Debug, Plain)]
pub(super) struct Setup {
    settings: Settings,
    baud: u32,
    step: Step,
    tries: u8,
    deadline: Timestamp,
    rate_hz: f64,
    orientation: bool,
    device_id: u64,
    trackers: Vec<Unit>,
    layouts: Vec<Layout>,
    period_ticks: u16,
    outputs: Vec<(u16, u16)>,
    chain: bool,
    /// Messages with a right checksum came in, whatever they were.
    pub(super) received: bool,
    requests: Vec<Vec<u8>>,
    warnings: Vec<String>,
}

impl Setup {
    /// Begins; the first request is ready.
    pub(super) fn new(now: Timestamp, settings: &Settings, baud: u32) -> Self {
        let mut setup = Self {
            settings: settings.clone(),
            baud,
            step: Step::GotoConfig,
            tries: 0,
            deadline: now,
            rate_hz: settings.rate_hz,
            orientation: settings.orientation,
            device_id: 0,
            trackers: Vec::new(),
            layouts: Vec::new(),
            period_ticks: 0,
            outputs: Vec::new(),
            chain: false,
            received: false,
            requests: Vec::new(),
            warnings: Vec::new(),
        };
        setup.go(now, Step::GotoConfig);
        setup
    }

    pub(super) fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        if self.requests.is_empty() { None } else { Some(self.requests.remove(0)) }
    }

    pub(super) fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    pub(super) fn poll_timeout(&self) -> Timestamp {
        self.deadline
    }

    /// A message came in.
    pub(super) fn handle(&mut self, now: Timestamp, frame: Frame<'_>) -> Progress {
        self.received = true;
        match frame.mid {
            message::WAKE_UP => {
                self.requests.push(message::request(MASTER, message::WAKE_UP_ACK, &[]));
                self.go(now, Step::GotoConfig);
                Progress::Busy
            }
            message::ERROR => self.on_error(now, frame.data.first().copied().unwrap_or_default()),
            // Data that was on its way, and answers to earlier tries, are passed over.
            mid if mid == self.request().1 + 1 => self.on_answer(now, frame.data),
            _ => Progress::Busy,
        }
    }

    /// The deadline has passed.
    pub(super) fn handle_timeout(&mut self, now: Timestamp) -> Progress {
        if now < self.deadline {
            return Progress::Busy;
        }
        if self.tries > 0 {
            self.tries -= 1;
            self.send(now);
            return Progress::Busy;
        }
        match self.step {
            // Older devices pass over what they do not know, newer ones may not describe themselves.
            Step::ReadOutputs if !self.layouts.is_empty() => self.legacy(now),
            Step::Configuration if !self.chain => self.go(now, Step::ReadOutputs),
            _ => return Progress::Unanswered,
        }
        Progress::Busy
    }

    fn go(&mut self, now: Timestamp, step: Step) {
        self.step = step;
        self.tries = match step {
            Step::GotoConfig => 3,
            Step::InitBus | Step::Measure => 1,
            _ => 2,
        };
        self.send(now);
    }

    fn send(&mut self, now: Timestamp) {
        let (bid, mid, data) = self.request();
        self.requests.push(message::request(bid, mid, &data));
        let wait_ms = match self.step {
            Step::InitBus => 1500,
            Step::Measure | Step::WriteOutputs => 1000,
            _ => 500,
        };
        self.deadline = now + Duration::from_millis(wait_ms);
    }

    fn request(&self) -> (u8, u8, Vec<u8>) {
        let own = |k: usize| if self.chain { k as u8 + 1 } else { MASTER };
        match self.step {
            Step::GotoConfig => (MASTER, message::GOTO_CONFIG, vec![]),
            Step::DeviceId => (MASTER, message::REQ_DEVICE_ID, vec![]),
            Step::InitBus => (MASTER, message::INIT_BUS, vec![]),
            Step::Configuration | Step::Verify => (MASTER, message::REQ_CONFIGURATION, vec![]),
            Step::ReadOutputs => (MASTER, message::OUTPUT_CONFIGURATION, vec![]),
            Step::WriteOutputs => {
                let list = self.wanted_outputs();
                let data = list.iter().flat_map(|&(id, hz)| [id, hz]).flat_map(u16::to_be_bytes).collect();
                (MASTER, message::OUTPUT_CONFIGURATION, data)
            }
            Step::Mode(k) => (own(k), message::OUTPUT_MODE, self.wanted_layout().mode.to_be_bytes().into()),
            Step::Settings(k) => {
                (own(k), message::OUTPUT_SETTINGS, self.wanted_layout().settings.to_be_bytes().into())
            }
            Step::Period => (MASTER, message::PERIOD, self.wanted_period().to_be_bytes().into()),
            Step::Measure => (MASTER, message::GOTO_MEASUREMENT, vec![]),
        }
    }

    fn wanted_layout(&self) -> Layout {
        let orientation = if self.orientation { Layout::ORIENTATION } else { 0 };
        // On a chain the master counts; a counter per tracker would only fill the line.
        let settings = if self.chain { 0 } else { Layout::COUNTER };
        Layout { mode: Layout::CALIBRATED | orientation, settings }
    }

    fn wanted_period(&self) -> u16 {
        (PERIOD_TICKS_PER_S / self.rate_hz).round().clamp(1.0, f64::from(u16::MAX)) as u16
    }

    fn wanted_outputs(&self) -> Vec<(u16, u16)> {
        let hz = self.rate_hz.round() as u16;
        let mut list = vec![(id::PACKET_COUNTER, ALWAYS), (id::SAMPLE_TIME_FINE, ALWAYS)];
        if self.orientation {
            list.push((id::QUATERNION, hz));
        }
        list.extend([(id::ACCELERATION, hz), (id::RATE_OF_TURN, hz), (id::MAGNETIC_FIELD, hz)]);
        list.push((id::STATUS_WORD, ALWAYS));
        list
    }

    fn on_answer(&mut self, now: Timestamp, data: &[u8]) -> Progress {
        match self.step {
            Step::GotoConfig => self.go(now, Step::DeviceId),
            Step::DeviceId => {
                let Some(device_id) = message::device_id(data) else { return Progress::Busy };
                self.device_id = device_id;
                self.chain = DeviceKind::of(device_id) == DeviceKind::XbusMaster;
                self.go(now, if self.chain { Step::InitBus } else { Step::Configuration });
            }
            Step::InitBus => {
                if data.is_empty() {
                    return Progress::Refused(
                        "the Xbus Master finds no tracker: check the cables of the chain".into(),
                    );
                }
                self.go(now, Step::Configuration);
            }
            Step::Configuration => {
                if !self.note_configuration(data) {
                    return Progress::Busy;
                }
                self.limit_rate();
                if self.chain { self.legacy(now) } else { self.go(now, Step::ReadOutputs) }
            }
            Step::ReadOutputs => {
                self.outputs = message::output_configuration(data).unwrap_or_default();
                let step =
                    if self.outputs == self.wanted_outputs() { Step::Measure } else { Step::WriteOutputs };
                self.go(now, step);
            }
            Step::WriteOutputs => {
                // The answer states what the device will do, which need not be what it was asked.
                let Some(outputs) = message::output_configuration(data).filter(|list| !list.is_empty())
                else {
                    return Progress::Busy;
                };
                self.outputs = outputs;
                self.go(now, Step::Measure);
            }
            Step::Mode(k) => self.go(now, Step::Settings(k)),
            Step::Settings(k) => self.write_from(now, k + 1),
            Step::Period => self.go(now, Step::Verify),
            Step::Verify => {
                if !self.note_configuration(data) {
                    return Progress::Busy;
                }
                self.go(now, Step::Measure);
            }
            Step::Measure => return self.finish(),
        }
        Progress::Busy
    }

    fn note_configuration(&mut self, data: &[u8]) -> bool {
        let Some(configuration) = Configuration::parse(data) else { return false };
        self.chain = configuration.is_chain();
        self.period_ticks = configuration.period_ticks;
        if self.step == Step::Verify {
            let claimed = configuration.rate();
            self.believe_rate(claimed);
        }
        self.trackers = (1..)
            .zip(&configuration.trackers)
            .map(|(address, tracker)| Unit { address, device_id: tracker.device_id.into() })
            .collect();
        self.layouts = configuration.trackers.iter().map(|tracker| tracker.layout).collect();
        true
    }

    /// Takes the rate that the device claims, if it can be; else what it was asked for stands.
    fn believe_rate(&mut self, claimed: Result<Rate, ImpossibleRate>) {
        match claimed {
            Ok(rate) => self.rate_hz = rate.hz(),
            Err(refused) => {
                let kept_hz = self.rate_hz;
                self.warnings
                    .push(format!("the device's answer is damaged: {refused}; going on with {kept_hz} Hz"));
            }
        }
    }

    /// Sets an older device up through output mode and settings.
    fn legacy(&mut self, now: Timestamp) {
        self.outputs.clear();
        self.write_from(now, 0);
    }

    /// Writes what differs, from tracker `k` on, then the period.
    fn write_from(&mut self, now: Timestamp, k: usize) {
        let wanted = self.wanted_layout();
        let next = (k..self.layouts.len()).find(|&k| self.layouts[k] != wanted);
        let step = match next {
            Some(k) => Step::Mode(k),
            None if self.period_ticks != self.wanted_period() => Step::Period,
            None => Step::Verify,
        };
        self.go(now, step);
    }

    /// Goes down to a rate that the line can carry.
    fn limit_rate(&mut self) {
        if self.baud == 0 {
            return;
        }
        let numbers = if self.orientation { 13 } else { 9 };
        let bytes = if self.chain {
            OVERHEAD + 4 + self.trackers.len() * 4 * numbers
        } else {
            // Counter 5, time 7, status 7, and three bytes in front of each quantity.
            OVERHEAD + 19 + 12 + 4 * numbers
        };
        let most_hz = f64::from(self.baud) * LINE_SHARE / (10.0 * bytes as f64);
        if self.rate_hz > most_hz {
            let requested = self.rate_hz;
            self.rate_hz = most_hz.floor().max(1.0);
            self.warnings.push(format!(
                "{requested} Hz of {bytes} bytes do not fit a line of {} baud; going down to {} Hz. Raise the baud rate, \
                 or set orientation = false",
                self.baud, self.rate_hz
            ));
        }
    }

    fn on_error(&mut self, now: Timestamp, code: u8) -> Progress {
        match (self.step, code) {
            // An error of the measurement that is being ended.
            (Step::GotoConfig, _) => {}
            (Step::ReadOutputs, _) if !self.layouts.is_empty() => self.legacy(now),
            (Step::Configuration, _) if !self.chain => self.go(now, Step::ReadOutputs),
            (Step::WriteOutputs | Step::Measure | Step::Mode(_), 0x1A | 0x21 | 0x35) if self.orientation => {
                self.orientation = false;
                self.warnings.push("the device does not give its orientation; going on without".into());
                if self.step == Step::WriteOutputs {
                    self.go(now, Step::WriteOutputs)
                } else {
                    self.legacy(now)
                }
            }
            (Step::Period | Step::Measure | Step::WriteOutputs, 0x03 | 0x18 | 0x1E | 0x21 | 0x29)
                if self.rate_hz * 0.75 >= SLOWEST_HZ =>
            {
                self.rate_hz = (self.rate_hz * 0.75).floor();
                self.warnings.push(format!("{}; trying {} Hz", message::error_words(code), self.rate_hz));
                self.go(now, if self.outputs.is_empty() { Step::Period } else { Step::WriteOutputs });
            }
            _ => {
                return Progress::Refused(format!(
                    "the device reports error {code:#04x}: {}",
                    message::error_words(code)
                ));
            }
        }
        Progress::Busy
    }

    fn finish(&mut self) -> Progress {
        if self.outputs.is_empty() {
            if let Some(error) = self.layouts.iter().find_map(|layout| layout.check().err()) {
                return Progress::Refused(format!("{error}; reset the device to its defaults"));
            }
            let shape = Shape::Legacy { chain: self.chain, layouts: self.layouts.clone() };
            return Progress::Done(Plan { shape, rate_hz: self.rate_hz, units: self.trackers.clone() });
        }
        let rate_of = |kind: u16| {
            self.outputs.iter().find(|(id, hz)| id & 0xFFF0 == kind && *hz > 0).map(|&(_, hz)| hz)
        };
        for (kind, name) in [
            (id::ACCELERATION, "acceleration"),
            (id::RATE_OF_TURN, "rate of turn"),
            (id::MAGNETIC_FIELD, "magnetic field"),
        ] {
            if rate_of(kind).is_none() {
                self.warnings.push(format!("the device does not send {name}; the fusion goes on without it"));
            }
        }
        let claimed = [id::RATE_OF_TURN, id::ACCELERATION, id::QUATERNION].into_iter().find_map(rate_of);
        if let Some(hz) = claimed.filter(|hz| *hz != ALWAYS) {
            self.believe_rate(Rate::claimed(hz.into(), &RATES_HZ));
        }
        let rate_hz = self.rate_hz;
        if rate_hz != self.settings.rate_hz {
            self.warnings
                .push(format!("the device measures at {rate_hz} Hz, not at {} Hz", self.settings.rate_hz));
        }
        let units = vec![Unit { address: 1, device_id: self.device_id }];
        Progress::Done(Plan { shape: Shape::Items, rate_hz, units })
    }
}
