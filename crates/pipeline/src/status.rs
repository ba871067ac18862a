//! What `status` tells of the pipeline.

use posed_drivers::{Counters, State, Timestamp};

use posed_fusion::faults::Cause;
use posed_stage::input::SensorIndex;

/// Counts and measured rates; a copy.
#[derive(Clone, Debug, PartialEq)]
pub struct PipelineStatus {
    /// In the stage's order.
    pub devices: Vec<DeviceStatus>,
    /// In the stage's order.
    pub sensors: Vec<SensorStatus>,
    /// The body; absent where nobody wears the sensors.
    pub body: Option<BodyStatus>,
    /// Models that were not swapped in: not finite, or of an unknown device.
    pub models_refused: u64,
    /// Requests that could not be carried out.
    pub requests_refused: u64,
}

/// The body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BodyStatus {
    /// Whether it is known how the sensors sit; without, there is no body.
    pub mounted: bool,
    /// Sensors that are faulty, with their segments.
    pub faults: Vec<(SensorIndex, &'static str, Cause)>,
}

/// One device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceStatus {
    /// What its session is doing.
    pub state: State,
    /// Measured rate of its cycles, Hz, once known.
    pub rate_hz: Option<f64>,
    /// Records, rejected ones, skipped bytes.
    pub counters: Counters,
    /// Clock model, once there is one.
    pub clock: Option<ClockStatus>,
}

/// A device's clock model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockStatus {
    /// Measured interval of its cycles on the host's clock, s.
    pub period_s: f64,
    /// Standard deviation of its capture times, s.
    pub sigma_t_s: f64,
}

/// One sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorStatus {
    /// Samples received.
    pub samples: u64,
    /// Capture time of the newest one.
    pub newest: Option<Timestamp>,
    /// Expected samples that were not published as `ok`.
    pub lost: u64,
    /// Part of `lost` comes from the time that passed: nothing on the line tells how many samples there were.
    pub estimated: bool,
}
