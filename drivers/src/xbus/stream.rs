//! Data messages to samples, with the loss of each tracker counted.

use posed_state::Plain;

use super::counter::{PacketCounter, SAMPLE_TIME_TICK_S, SampleTime, Step};
use super::frame::Frame;
use super::message;
use super::mtdata::{Block, Layout, Orientation};
use super::mtdata2::{self, Axes, Value};
use super::number::be16;
use super::orientation;
use crate::sample::{Arrival, DeviceTime, Measurement, Sample};
use crate::session::{Loss, SensorInfo};

/// A tracker.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Unit {
    pub(super) address: u16,
    pub(super) device_id: u64,
}

/// What the data messages hold.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) enum Shape {
    /// MTData2: each message reports it.
    Items,
    /// MTData: a block per tracker.
    Legacy { chain: bool, layouts: Vec<Layout> },
}

/// What a set-up has brought about.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Plan {
    pub(super) shape: Shape,
    pub(super) rate_hz: f64,
    pub(super) units: Vec<Unit>,
}

/// What became of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// So many samples.
    Data(u32),
    /// Not what was configured, or impossible.
    Refused,
    /// No data message.
    Other,
}

/// Follows the data messages of one measurement.
#[derive(Clone, Debug, Plain)]
pub(super) struct Stream {
    plan: Plan,
    packets: PacketCounter,
    times: SampleTime,
    cycle: u64,
}

impl Stream {
    pub(super) fn new(plan: Plan) -> Self {
        Self { plan, packets: PacketCounter::default(), times: SampleTime::default(), cycle: 0 }
    }

    pub(super) fn rate_hz(&self) -> f64 {
        self.plan.rate_hz
    }

    pub(super) fn sensors(&self) -> impl Iterator<Item = SensorInfo> {
        self.plan.units.iter().map(|unit| SensorInfo {
            address: unit.address,
            serial: Some(message::device_id_text(unit.device_id)),
        })
    }

    /// Takes a message that arrived so; `losses` has an entry per unit, in order.
    pub(super) fn handle(
        &mut self,
        frame: Frame<'_>,
        arrival: Arrival,
        losses: &mut [Loss],
        emit: &mut impl FnMut(Sample),
    ) -> Outcome {
        match (frame.mid, &self.plan.shape) {
            (message::MTDATA2, Shape::Items) => self.items(frame.data, arrival, losses, emit),
            (message::MTDATA, Shape::Legacy { .. }) => {
                // The layouts are looked at while the counters change.
                let shape = std::mem::replace(&mut self.plan.shape, Shape::Items);
                let outcome = match &shape {
                    Shape::Legacy { chain, layouts } => {
                        self.blocks(*chain, layouts, frame.data, arrival, losses, emit)
                    }
                    Shape::Items => Outcome::Other,
                };
                self.plan.shape = shape;
                outcome
            }
            (message::MTDATA | message::MTDATA2, _) => Outcome::Refused,
            _ => Outcome::Other,
        }
    }

    fn items(
        &mut self,
        data: &[u8],
        arrival: Arrival,
        losses: &mut [Loss],
        emit: &mut impl FnMut(Sample),
    ) -> Outcome {
        let mut imu = Imu::default();
        let (mut packet, mut time) = (None, None);
        for item in mtdata2::items(data) {
            let axes = mtdata2::axes(item.id);
            let fits = match item.value {
                Value::Acceleration(value) => imu.specific_force(value),
                Value::RateOfTurn(value) => imu.angular_velocity(value),
                Value::MagneticField(value) => imu.magnetic_field(value),
                _ => true,
            };
            if !fits {
                return Outcome::Refused;
            }
            match item.value {
                Value::PacketCounter(value) => packet = Some(value),
                Value::SampleTimeFine(value) => time = Some(value),
                // One that is no rotation is left out: the checksum was right, so the device's filter has not
                // settled yet, and what its sensors measure is good all the same.
                Value::Quaternion(value) => imu.orientation = orientation::from_quaternion(value, axes),
                Value::RotationMatrix(value) => imu.orientation = orientation::from_matrix(value, axes),
                Value::EulerDeg(value) => imu.orientation = orientation::from_euler_deg(value, axes),
                _ => {}
            }
        }
        if let Some(packet) = packet {
            self.count(packet, losses);
        }
        self.cycle += 1;
        let t_device = match (time, packet) {
            (Some(time), _) => {
                self.times.step(time);
                DeviceTime::Counter { ticks: self.times.unwrapped(), tick_s: SAMPLE_TIME_TICK_S }
            }
            (None, Some(_)) => {
                DeviceTime::Counter { ticks: self.packets.unwrapped(), tick_s: 1.0 / self.plan.rate_hz }
            }
            (None, None) => DeviceTime::Cycle(self.cycle),
        };
        // A message may hold only satellite data, or nothing new.
        let Some(measurement) = imu.measurement() else { return Outcome::Data(0) };
        let Some(unit) = self.plan.units.first() else { return Outcome::Refused };
        emit(Sample { address: unit.address, arrival, t_device, measurement });
        Outcome::Data(1)
    }

    fn blocks(
        &mut self,
        chain: bool,
        layouts: &[Layout],
        data: &[u8],
        arrival: Arrival,
        losses: &mut [Loss],
        emit: &mut impl FnMut(Sample),
    ) -> Outcome {
        let len = |layout: &Layout| layout.block_len() + if layout.has_counter() { 2 } else { 0 };
        let expected = layouts.iter().map(len).sum::<usize>() + if chain { 2 } else { 0 };
        if data.len() != expected {
            return Outcome::Refused;
        }
        let counter =
            if chain { be16(data, 0) } else { data.len().checked_sub(2).and_then(|at| be16(data, at)) };
        let counter = counter.filter(|_| chain || layouts.first().is_some_and(|layout| layout.has_counter()));
        self.cycle += 1;
        let t_device = match counter {
            Some(counter) => {
                self.count(counter, losses);
                DeviceTime::Counter { ticks: self.packets.unwrapped(), tick_s: 1.0 / self.plan.rate_hz }
            }
            None => DeviceTime::Cycle(self.cycle),
        };
        let mut rest = if chain { &data[2..] } else { data };
        let mut samples = 0;
        for (k, (layout, unit)) in layouts.iter().zip(&self.plan.units).enumerate() {
            let (block, after) = rest.split_at(len(layout));
            rest = after;
            let measurement = layout
                .decode(&block[..layout.block_len()])
                .and_then(|block| Imu::from_block(&block, layout.settings))
                .and_then(Imu::measurement);
            match measurement {
                Some(measurement) => {
                    samples += 1;
                    emit(Sample { address: unit.address, arrival, t_device, measurement });
                }
                None => {
                    if let Some(loss) = losses.get_mut(k) {
                        loss.lost += 1;
                    }
                }
            }
        }
        if samples == 0 { Outcome::Refused } else { Outcome::Data(samples) }
    }

    /// A gap of the counter is so many periods lost for every tracker.
    fn count(&mut self, packet: u16, losses: &mut [Loss]) {
        if let Step::Forward(step) = self.packets.step(packet) {
            for loss in losses {
                loss.lost += step.saturating_sub(1);
            }
        }
    }
}

/// Most that a tracker can measure, with room above: rad/s, m/s², units of the calibration field.
const MOST_RAD_S: f64 = 200.0;
const MOST_M_S2: f64 = 4000.0;
const MOST_FIELD: f64 = 100.0;

#[derive(Clone, Copy, Default)]
struct Imu {
    angular_velocity: Option<[f64; 3]>,
    specific_force: Option<[f64; 3]>,
    magnetic_field: Option<[f64; 3]>,
    orientation: Option<[f64; 4]>,
}

/// Whether all values are numbers of at most this size.
fn within(values: [f64; 3], most: f64) -> bool {
    values.iter().all(|value| value.abs() <= most)
}

impl Imu {
    fn angular_velocity(&mut self, value: [f64; 3]) -> bool {
        self.angular_velocity = Some(value);
        within(value, MOST_RAD_S)
    }

    fn specific_force(&mut self, value: [f64; 3]) -> bool {
        self.specific_force = Some(value);
        within(value, MOST_M_S2)
    }

    fn magnetic_field(&mut self, value: [f64; 3]) -> bool {
        self.magnetic_field = Some(value);
        within(value, MOST_FIELD)
    }

    fn from_block(block: &Block, settings: u32) -> Option<Self> {
        let axes = if settings & Layout::NED != 0 { Axes::Ned } else { Axes::Enu };
        let mut imu = Self::default();
        let fits = block.rate_of_turn.is_none_or(|value| imu.angular_velocity(value))
            && block.acceleration.is_none_or(|value| imu.specific_force(value))
            && block.magnetic_field.is_none_or(|value| imu.magnetic_field(value));
        imu.orientation = match block.orientation {
            Some(Orientation::Quaternion(q)) => orientation::from_quaternion(q, axes),
            Some(Orientation::EulerDeg(angles)) => orientation::from_euler_deg(angles, axes),
            // Rows or columns? See `mtdata::Orientation::Matrix`.
            Some(Orientation::Matrix(_)) | None => None,
        };
        fits.then_some(imu)
    }

    fn measurement(self) -> Option<Measurement> {
        let there = self.angular_velocity.is_some()
            || self.specific_force.is_some()
            || self.magnetic_field.is_some()
            || self.orientation.is_some();
        there.then_some(Measurement::Imu {
            angular_velocity_rad_s: self.angular_velocity,
            specific_force_m_s2: self.specific_force,
            linear_acceleration_m_s2: None,
            magnetic_field: self.magnetic_field,
            orientation_wxyz: self.orientation,
        })
    }
}
