//! What `status` tells of the pipeline.

use posed_drivers::{Condition, Counters, Found, State, Timestamp};

use posed_fusion::faults::Cause;
use posed_stage::input::SensorIndex;

/// Counts since the pipeline was made (a restored one goes on with those of its snapshot), and measured rates; a copy.
#[derive(Clone, Debug, PartialEq)]
pub struct PipelineStatus {
    /// One per device, in the stage's order.
    pub devices: Vec<DeviceStatus>,
    /// One per sensor, in the stage's order.
    pub sensors: Vec<SensorStatus>,
    /// One per body of the stage, human or a chain of hinges; `None` where it wears no sensor.
    pub bodies: Vec<Option<BodyStatus>>,
    /// Models and networks that were not swapped in: their numbers are wrong, or they speak of what the stage does not have.
    pub models_refused: u64,
    /// Requests that could not be carried out; they changed nothing.
    pub requests_refused: u64,
    /// Entries that were left out because the pipeline panicked at them: faults of the program. Of a
    /// [`SupervisedPipeline`](crate::SupervisedPipeline); another one ends with the first.
    pub entries_left_out: u64,
    /// How often the pipeline has begun anew, because leaving out did not help; all devices were set up again.
    pub begun_anew: u64,
}

/// What is known of a body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BodyStatus {
    /// Whether it is known how the sensors sit, given or by calibration; without, no body is published.
    pub mounted: bool,
    /// Sensors that are faulty in the latest body, each with the name of its segment and why; none on a chain of hinges.
    pub faults: Vec<(SensorIndex, &'static str, Cause)>,
}

/// What is known of one device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceStatus {
    /// What its session is doing.
    pub state: State,
    /// Measured rate of its cycles, Hz, on the host's clock; absent before it is known, while the device does not stream, and
    /// for devices without cycles. Of units with clocks of their own, that of the first that is known.
    pub rate_hz: Option<f64>,
    /// Records, rejected ones, skipped bytes, as its session counts them; never reset.
    pub counters: Counters,
    /// Clock model; absent as [`Self::rate_hz`] is.
    pub clock: Option<ClockStatus>,
    /// Sensors that send to it and are not on the stage, as its session lists them.
    pub found: Vec<Found>,
}

/// A device's clock model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockStatus {
    /// Measured interval of its cycles on the host's clock, s.
    pub period_s: f64,
    /// Standard deviation of its latest capture time, s: an estimate of the model itself.
    pub sigma_t_s: f64,
}

/// What was received of one sensor, and what is missing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorStatus {
    /// Samples that came into frames, whatever their state.
    pub samples: u64,
    /// Capture time of the newest one; absent before the first.
    pub newest: Option<Timestamp>,
    /// Expected samples that did not come, and frames whose samples were not published as `ok`.
    pub lost: u64,
    /// Those of `lost` that did not come, by the device's own count where it has one.
    pub missed: u64,
    /// Part of `lost` comes from the time that passed: nothing on the line shows how many samples there were.
    pub estimated: bool,
    /// What it reports of itself, as far as it does.
    pub condition: Condition,
    /// Its last record was corrected by its unit's own intrinsics.
    pub corrected: bool,
}
