//! What is timed by one clock: a device, or one unit of a device whose units have clocks of their own.

use posed_drivers::Sample;
use posed_state::State;

use crate::clock::{ArrivalClock, Clock, RadioClock, Settings, Stamp};
use posed_stage::TimeBase;

/// Interval at which units without cycles look for something new to send, s.
const ON_CHANGE_S: f64 = 0.01;

/// One such clock.
#[derive(Clone, Debug, State)]
pub(super) enum Source {
    /// Cycles of the same length.
    Cycles(Box<Clock>),
    /// Samples when there is something new.
    OnChange(ArrivalClock),
    /// Samples on a clock of their own, behind a radio.
    Radio(Box<RadioClock>),
}

impl Source {
    pub(super) fn new(base: TimeBase, settings: Settings) -> Self {
        match base {
            TimeBase::Device | TimeBase::Unit(_) => Self::Cycles(Box::new(Clock::new(settings))),
            TimeBase::OnChange(_) => Self::OnChange(ArrivalClock::new(settings)),
            TimeBase::Radio(_) => Self::Radio(Box::new(RadioClock::new(settings))),
        }
    }

    pub(super) fn push(&mut self, sample: &Sample) -> Stamp {
        match self {
            Self::Cycles(clock) => clock.push(sample),
            Self::OnChange(clock) => clock.push(sample),
            Self::Radio(clock) => clock.push(sample),
        }
    }

    /// The device is on a port with modem lines: its bytes come over a wire.
    pub(super) fn know_wire(&mut self) {
        if let Self::Cycles(clock) = self {
            clock.know_wire();
        }
    }

    /// The device or its line began anew, and claims this rate.
    pub(super) fn restart(&mut self, rate_hz: Option<f64>) {
        match self {
            Self::Cycles(clock) => {
                clock.restart();
                clock.set_nominal_rate_hz(rate_hz);
            }
            Self::Radio(clock) => {
                clock.restart();
                clock.set_nominal_rate_hz(rate_hz);
            }
            Self::OnChange(_) => {}
        }
    }

    /// Interval of the cycles, s: measured, or nominal before that.
    pub(super) fn period_or_nominal_s(&self) -> Option<f64> {
        match self {
            Self::Cycles(clock) => clock.period_or_nominal_s(),
            Self::OnChange(_) => Some(ON_CHANGE_S),
            Self::Radio(clock) => clock.period_or_nominal_s(),
        }
    }

    /// Measured interval of the cycles, s.
    pub(super) fn period_s(&self) -> Option<f64> {
        match self {
            Self::Cycles(clock) => clock.period_s(),
            Self::OnChange(_) => None,
            Self::Radio(clock) => clock.period_s(),
        }
    }

    pub(super) fn sigma_t_s(&self) -> Option<f64> {
        match self {
            Self::Cycles(clock) => clock.sigma_t_s(),
            Self::OnChange(clock) => clock.sigma_t_s(),
            Self::Radio(clock) => clock.sigma_t_s(),
        }
    }
}
