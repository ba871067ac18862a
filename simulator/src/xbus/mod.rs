//! A virtual Xbus device: an MTi, an older MTx, or an Xbus Master with its chain of trackers.
//!
//! What comes in: messages of the host. What goes out: answers, data messages, errors between them. States:
//! starting (half a second in which a host may keep it from measuring), configuration, measurement.
//!
//! - `answer`: what each message does
//! - `data`: the data messages

mod answer;
mod data;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::xbus::message::{self, MASTER, PERIOD_TICKS_PER_S};
use posed_drivers::xbus::mtdata::Layout;
use posed_drivers::xbus::mtdata2::id;
use posed_drivers::xbus::{Frame, Framer};

use crate::chassis::{Chassis, Unit};
use crate::device::{Pace, shown_s};
use crate::faults::Fault;
use crate::inertial::Imu;
use crate::scenario::Personality;

/// How long a device that has started waits for a host.
const WAKE_UP: Duration = Duration::from_millis(500);
/// How long an Xbus Master looks for its trackers.
const SCAN: Duration = Duration::from_millis(400);
/// From a request to its answer.
const ANSWER: Duration = Duration::from_millis(2);
/// Error mode of a master: the counter steps over a failed period, and an error states which tracker.
const TELL_ERRORS: u16 = 2;
/// Output rate of items that come with every message.
const ALWAYS: u16 = 0xFFFF;

/// One tracker.
#[derive(Debug)]
pub(crate) struct Tracker {
    /// Address in the stage.
    pub(crate) address: u16,
    /// Absent where the stage has no such sensor: the tracker is there and lies still.
    pub(crate) imu: Option<Imu>,
    device_id: u32,
    layout: Layout,
    /// Its last block, for periods in which it does not answer.
    block: Vec<u8>,
}

impl Tracker {
    pub(crate) fn new(device: usize, address: u16, imu: Option<Imu>) -> Self {
        let device_id = 0x0032_03E8 + 0x100 * device as u32 + u32::from(address.max(1));
        let layout = Layout { mode: Layout::CALIBRATED, settings: 0 };
        Self { address, imu, device_id, layout, block: Vec::new() }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Without power, or starting.
    Off,
    WakingUp {
        until: Timestamp,
    },
    Config,
    Measuring,
}

/// A device; see the module.
#[derive(Debug)]
pub(crate) struct Xbus {
    personality: Personality,
    trackers: Vec<Tracker>,
    /// Trackers by bus identifier, from 1: those that the last scan has found.
    bus: Vec<usize>,
    state: State,
    period_ticks: u16,
    skip_factor: u16,
    outputs: Vec<(u16, u16)>,
    error_mode: u16,
    /// RTS is asserted, or there is none.
    may_send: bool,
    framer: Framer,
    answers: VecDeque<(Timestamp, Vec<u8>)>,
    pace: Pace,
    next_cycle: u64,
    /// Cycle in which the counter was 0.
    counter_start: u64,
    /// When the device's own time was 0.
    clock_start: Timestamp,
    /// Periods still to leave out.
    leave_out: u32,
    /// It sends something else than it was set to, until then.
    wrong_until: Option<Timestamp>,
    /// It has reported that the line is too slow.
    overflow_reported: bool,
}

impl Xbus {
    pub(crate) fn new(personality: Personality, trackers: Vec<Tracker>, chassis: &mut Chassis) -> Self {
        let phase = Duration::from_secs_f64(0.01 * chassis.random.uniform());
        Self {
            personality,
            trackers,
            bus: Vec::new(),
            state: State::Off,
            period_ticks: 1152,
            skip_factor: 0,
            outputs: vec![(id::PACKET_COUNTER, ALWAYS), (id::QUATERNION, 100), (id::STATUS_WORD, ALWAYS)],
            error_mode: TELL_ERRORS,
            may_send: true,
            framer: Framer::default(),
            answers: VecDeque::new(),
            pace: Pace::new(Timestamp::ZERO + phase, 0, 0.01, chassis.config.drift_ppm),
            next_cycle: 0,
            counter_start: 0,
            clock_start: Timestamp::ZERO,
            leave_out: 0,
            wrong_until: None,
            overflow_reported: false,
        }
    }

    fn is_chain(&self) -> bool {
        self.personality == Personality::Chain
    }

    fn device_id(&self) -> u32 {
        let own = self.trackers.first().map_or(0x0030_0001, |tracker| tracker.device_id);
        match self.personality {
            Personality::Chain => 0x0010_0021 + (own & 0xFF00),
            Personality::Mtx => own,
            Personality::Mti => 0x0770_0000 | own & 0xFFFF,
        }
    }

    /// Data messages per second by the settings.
    fn rate_hz(&self) -> f64 {
        match self.personality {
            Personality::Mti => f64::from(self.base_hz()),
            _ => {
                PERIOD_TICKS_PER_S / f64::from(self.period_ticks.max(1)) / (f64::from(self.skip_factor) + 1.0)
            }
        }
    }

    fn emit(&mut self, t: Timestamp, bid: u8, mid: u8, data: &[u8]) {
        self.answers.push_back((t + ANSWER, Frame { bid, mid, data }.encode()));
    }

    /// The trackers that answer a scan, in the order of the bus.
    fn scan(&mut self, chassis: &Chassis, t: Timestamp) {
        self.bus =
            (0..self.trackers.len()).filter(|&k| !chassis.is_gone(self.trackers[k].address, t)).collect();
    }

    fn measure(&mut self, chassis: &mut Chassis, t: Timestamp) {
        let period_s = 1.0 / self.rate_hz();
        self.pace = Pace::new(
            t + Duration::from_secs_f64(period_s),
            self.next_cycle,
            period_s,
            chassis.config.drift_ppm,
        );
        self.counter_start = self.next_cycle;
        self.leave_out = 0;
        self.wrong_until = None;
        self.overflow_reported = false;
        self.state = State::Measuring;
    }

    /// `sample_time_fine` at `t`: 0.1 ms ticks of the device's own clock.
    fn fine_time(&self, chassis: &Chassis, t: Timestamp) -> u32 {
        (shown_s(self.clock_start, t, chassis.config.drift_ppm) * 1e4).round() as u64 as u32
    }
}

impl Unit for Xbus {
    fn reset(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.state = State::Off;
        self.framer = Framer::default();
        self.answers.clear();
        self.clock_start = t;
        self.scan(chassis, t);
    }

    fn start(&mut self, chassis: &mut Chassis, t: Timestamp) {
        self.state = State::WakingUp { until: t + WAKE_UP };
        chassis.answer(t, &message::request(MASTER, message::WAKE_UP, &[]));
    }

    fn receive(&mut self, chassis: &mut Chassis, t: Timestamp, bytes: &[u8]) {
        self.framer.push(bytes);
        let mut framer = std::mem::take(&mut self.framer);
        while let Some(found) = framer.find() {
            let frame = framer.frame(found);
            self.request(chassis, t, frame);
        }
        self.framer = framer;
    }

    fn set_rts(&mut self, _chassis: &mut Chassis, _t: Timestamp, asserted: bool) {
        // Only a master looks at the line.
        self.may_send = asserted || !self.is_chain();
    }

    fn step(&mut self, chassis: &mut Chassis, t: Timestamp) {
        if let Some((at, bytes)) = self.answers.pop_front_if(|(at, _)| *at <= t) {
            if chassis.is_on() && self.may_send {
                chassis.answer(at, &bytes);
            }
        } else if let State::WakingUp { until } = self.state
            && until <= t
        {
            let configuration = self.configuration().encode();
            chassis.answer(t, &message::request(MASTER, message::CONFIGURATION, &configuration));
            self.measure(chassis, t);
        } else {
            self.cycle(chassis, t);
        }
    }

    fn poll_timeout(&self) -> Option<Timestamp> {
        let answer = self.answers.front().map(|&(t, _)| t);
        let waking = if let State::WakingUp { until } = self.state { Some(until) } else { None };
        let cycle = Some(self.pace.time(self.next_cycle));
        [answer, waking, cycle].into_iter().flatten().min()
    }

    fn fault(&mut self, chassis: &mut Chassis, t: Timestamp, fault: &Fault) -> bool {
        match *fault {
            Fault::Error { code, detail, .. } => {
                if chassis.is_on() && self.may_send {
                    let data = if detail == 0 { vec![code] } else { vec![code, detail] };
                    chassis.answer(t, &message::request(MASTER, message::ERROR, &data));
                }
            }
            Fault::CounterRestart { .. } => {
                self.counter_start = self.next_cycle;
                self.clock_start = t;
            }
            Fault::LostPeriods { count, .. } => self.leave_out = count,
            Fault::WrongOutput { .. } => {
                self.wrong_until = Some(fault.until());
            }
            Fault::BirdDies { .. } => {}
            Fault::DoubleTap { address, .. } => {
                let tracker = self.trackers.iter_mut().find(|tracker| tracker.address == address);
                let Some(imu) = tracker.and_then(|tracker| tracker.imu.as_mut()) else { return false };
                imu.tap(t);
                imu.tap(t + Duration::from_millis(250));
            }
            _ => return false,
        }
        true
    }
}
