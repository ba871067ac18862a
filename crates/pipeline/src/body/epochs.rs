//! From a frame's records to samples of the whole body at one time.
//!
//! In: frames. Out: epochs: the newest sample of every worn IMU, how old each is, and the time since the epoch before. Sensors
//! of one chain measure together and make one epoch per cycle; units with clocks of their own make one per frame.

use nalgebra::{UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use posed_state::Plain;

use crate::frame::{Frame, FrameSample};
use posed_fusion::ahrs::ImuSample;
use posed_fusion::body::{BodySamples, SEGMENTS};
use posed_geometry::GRAVITY_M_S2;
use posed_stage::input::SensorIndex;
use posed_stage::output::Measured;

/// Without a sample of any sensor for so long, an empty epoch lets the body know, s.
const SILENT_S: f64 = 0.1;
/// What the first epoch stands for, s.
const FIRST_S: f64 = 0.01;
/// Two orientations this far apart show no angular velocity, s.
const APART_S: f64 = 0.2;

/// Samples of one time.
pub(super) struct Epoch {
    pub(super) t: Timestamp,
    /// Since the one before, s.
    pub(super) dt_s: f64,
    pub(super) samples: BodySamples,
    /// How long before `t` each was taken, s.
    pub(super) ages_s: [f64; SEGMENTS],
}

/// Sorts records into epochs.
#[derive(Clone, Debug, Plain)]
pub(super) struct Epochs {
    imus: [Option<SensorIndex>; SEGMENTS],
    frame: Option<Timestamp>,
    last: Option<Timestamp>,
    records: ImuRecords,
}

/// From records of worn IMUs to samples, one sensor per segment. Causal: it keeps the last record of each.
#[derive(Clone, Debug, Plain)]
pub struct ImuRecords {
    /// Whether all sensors have magnetometers; a body of which some lack them is solved without.
    field: bool,
    sensors: [Last; SEGMENTS],
}

/// The last record of a sensor.
#[derive(Clone, Copy, Debug, Default, Plain)]
struct Last {
    t: Option<Timestamp>,
    /// Of a unit that tells its orientation only.
    reported: Option<UnitQuaternion<f64>>,
}

impl Epochs {
    pub(super) fn new(imus: [Option<SensorIndex>; SEGMENTS], field: bool) -> Self {
        Self { imus, frame: None, last: None, records: ImuRecords::new(field) }
    }

    /// The IMU on each segment.
    pub(super) fn imus(&self) -> &[Option<SensorIndex>; SEGMENTS] {
        &self.imus
    }

    /// Sensors sit elsewhere from now on: what they sent before gives no information about their segments.
    pub(super) fn wear(&mut self, imus: [Option<SensorIndex>; SEGMENTS]) {
        if imus != self.imus {
            self.records = ImuRecords::new(self.records.field);
            self.imus = imus;
        }
    }

    /// Whether all of them have magnetometers.
    pub(super) fn field(&self) -> bool {
        self.records.field
    }

    /// Takes a frame, and returns its epochs in order.
    pub(super) fn frame(&mut self, frame: &Frame, mut emit: impl FnMut(&Epoch)) {
        let records = |index: &SensorIndex| frame.sensors[usize::from(*index)].samples.as_slice();
        let most = self.imus.iter().flatten().map(|index| records(index).len()).max().unwrap_or(0);
        let begun = self.frame.replace(frame.t_valid).unwrap_or(frame.t_valid);
        if most == 0 {
            let dt_s = self.last.map_or(0.0, |last| frame.t_valid.seconds_since(last));
            if dt_s >= SILENT_S {
                self.last = Some(frame.t_valid);
                emit(&Epoch { t: frame.t_valid, dt_s, samples: [None; SEGMENTS], ages_s: [0.0; SEGMENTS] });
            }
            return;
        }
        let span_s = frame.t_valid.seconds_since(begun);
        let mut taken = [0; SEGMENTS];
        for part in 1..=most {
            let until_s = span_s * part as f64 / most as f64;
            let mut newest: [Option<FrameSample>; SEGMENTS] = [None; SEGMENTS];
            for ((slot, taken), index) in newest.iter_mut().zip(&mut taken).zip(&self.imus) {
                let Some(index) = index else { continue };
                // The last part takes what rounding would leave over.
                let due = |sample: &&FrameSample| {
                    part == most || sample.measured.t_valid.seconds_since(begun) <= until_s
                };
                for sample in records(index)[*taken..].iter().take_while(due) {
                    *slot = Some(*sample);
                    *taken += 1;
                }
            }
            if let Some(epoch) = self.epoch(&newest) {
                emit(&epoch);
            }
        }
    }

    fn epoch(&mut self, newest: &[Option<FrameSample>; SEGMENTS]) -> Option<Epoch> {
        let t = newest.iter().flatten().map(|sample| sample.measured.t_valid).max()?;
        let dt_s = self.last.map_or(FIRST_S, |last| t.seconds_since(last));
        if dt_s <= 0.0 {
            // All of it came too late.
            return None;
        }
        self.last = Some(t);
        let mut epoch = Epoch { t, dt_s, samples: [None; SEGMENTS], ages_s: [0.0; SEGMENTS] };
        for (segment, record) in newest.iter().enumerate() {
            let Some(record) = record else { continue };
            epoch.samples[segment] = self.records.sample(segment, &record.measured);
            epoch.ages_s[segment] = t.seconds_since(record.measured.t_valid);
        }
        Some(epoch)
    }
}

impl ImuRecords {
    /// Before the first record. `field`: every sensor of the body has a magnetometer that its heading may follow
    /// ([`all_have_field`](super::all_have_field)); without, the samples carry no field.
    pub fn new(field: bool) -> Self {
        Self { field, sensors: [Last::default(); SEGMENTS] }
    }

    /// The sample, sensor axes, that a record of the sensor on `segment` (`BodySegment::index`) holds: corrected by the unit's
    /// intrinsics where those are known.
    ///
    /// Of a unit that sends its orientation only it is an estimate: the mean angular velocity since the orientation before, zero
    /// without one in the last 0.2 s; as specific force gravity along the reported vertical, with the linear acceleration if
    /// there is one; no field. `None` for a record that is no later than the one before, or that holds neither.
    ///
    /// # Panics
    /// `segment` is not below 10.
    pub fn sample(&mut self, segment: usize, measured: &Measured) -> Option<ImuSample> {
        let last = &mut self.sensors[segment];
        let since_s = last.t.map(|before| measured.t_valid.seconds_since(before));
        if since_s.is_some_and(|since_s| since_s <= 0.0) {
            return None;
        }
        last.t = Some(measured.t_valid);
        let inertial = measured.inertial?;
        if let Some(sample) = inertial.sample() {
            return Some(ImuSample { mag: sample.mag.filter(|_| self.field), ..sample });
        }
        let reported = measured.orientation_wxyz.and_then(posed_geometry::orientation_from_wxyz)?;
        let before = last.reported.replace(reported);
        let gyro_rad_s = match (before, since_s) {
            (Some(before), Some(dt_s)) if dt_s < APART_S => {
                (before.inverse() * reported).scaled_axis() / dt_s
            }
            _ => Vector3::zeros(),
        };
        let moved = inertial.linear_acceleration_m_s2.map_or_else(Vector3::zeros, Vector3::from);
        let accel_m_s2 = reported.inverse() * Vector3::z() * GRAVITY_M_S2 + moved;
        Some(ImuSample { gyro_rad_s, accel_m_s2, mag: None })
    }
}
