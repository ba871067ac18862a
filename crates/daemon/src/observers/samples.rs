//! Samples for a guided calibration that is under way.
//!
//! In: estimates and the pipeline behind them, on the fusion thread. Out: the samples that the calibration's [`Source`] makes of
//! them, to the one job that takes them. It never waits for that one: what it does not take in time is left out, and once it has gone
//! nothing is done.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};

use nalgebra::{Isometry3, Vector3};

use super::{Observer, Times};
use posed_fusion::ahrs::ImuSample;
use posed_fusion::body::{Places, Recorded, SEGMENTS};
use posed_fusion::chain::Epoch;
use posed_pipeline::{ImuRecords, Pipeline};
use posed_stage::input::SensorIndex;
use posed_stage::output::{Estimate, Output};

/// Samples that wait for a calibration: ten seconds at 100 Hz.
const WAITING: usize = 1024;

/// Calibrations that guide somebody; one of each kind may be under way.
#[derive(Clone, Copy, Debug)]
pub enum GuidedCalibration {
    /// Of an IMU.
    Imu,
    /// Of the stage.
    Alignment,
    /// Of the body.
    Body,
    /// Of a chain of hinges.
    Chain,
}

impl GuidedCalibration {
    pub(super) const COUNT: usize = 4;
}

/// Makes samples for one kind of calibration.
pub(crate) trait Source: Send + 'static {
    const CALIBRATION: GuidedCalibration;
    type Sample: Send;

    /// Of a frame.
    fn of_frame(&mut self, estimate: &Estimate) -> Option<Self::Sample>;

    /// Of the pipeline after an entry.
    fn of_pipeline(&mut self, _pipeline: &Pipeline) -> Option<Self::Sample> {
        None
    }
}

/// See the module.
pub(crate) struct Samples<S: Source> {
    source: S,
    /// Until nobody takes them any more.
    to: Option<SyncSender<S::Sample>>,
}

impl<S: Source> Samples<S> {
    /// What makes them, and where they are taken.
    pub(crate) fn new(source: S) -> (Self, Receiver<S::Sample>) {
        let (to, taken) = sync_channel(WAITING);
        (Self { source, to: Some(to) }, taken)
    }

    fn send(&mut self, sample: impl FnOnce(&mut S) -> Option<S::Sample>) {
        if let Some(to) = &self.to
            && let Some(sample) = sample(&mut self.source)
            && matches!(to.try_send(sample), Err(TrySendError::Disconnected(_)))
        {
            self.to = None;
        }
    }
}

impl<S: Source> Observer for Samples<S> {
    fn on_output(&mut self, output: &Output<'_>, _: &Times) {
        if let Output::Estimate(estimate) = output {
            self.send(|source| source.of_frame(estimate));
        }
    }

    fn after_entry(&mut self, pipeline: &Pipeline) {
        self.send(|source| source.of_pipeline(pipeline));
    }
}

/// IMU calibration: what the unit measures, uncorrected, with its capture time, s.
#[derive(Debug)]
pub(crate) struct ImuSource {
    pub(crate) sensor: SensorIndex,
}

impl Source for ImuSource {
    const CALIBRATION: GuidedCalibration = GuidedCalibration::Imu;
    type Sample = (f64, ImuSample);

    fn of_frame(&mut self, estimate: &Estimate) -> Option<Self::Sample> {
        let record = estimate.sensors.get(usize::from(self.sensor))?.measured?;
        Some((record.t_valid.as_secs_f64(), record.inertial?.uncorrected()?))
    }
}

/// Stage alignment: records of a magnetic sensor and of its IMU, as they come.
#[derive(Debug)]
pub(crate) struct AlignmentSource {
    sensor: SensorIndex,
    imu: Option<SensorIndex>,
    /// Of the magnetic sensor's newest record.
    newest_s: f64,
}

/// One record with its capture time, s.
#[derive(Clone, Copy, Debug)]
pub(crate) enum AlignmentSample {
    /// Sensor to transmitter, corrected, of a record that was believed.
    Magnetic(f64, Isometry3<f64>),
    /// Of the IMU.
    Imu(f64, ImuSample),
}

impl AlignmentSource {
    pub(crate) fn new(sensor: SensorIndex, imu: Option<SensorIndex>) -> Self {
        Self { sensor, imu, newest_s: f64::NEG_INFINITY }
    }
}

impl Source for AlignmentSource {
    const CALIBRATION: GuidedCalibration = GuidedCalibration::Alignment;
    type Sample = AlignmentSample;

    fn of_frame(&mut self, estimate: &Estimate) -> Option<AlignmentSample> {
        let record = estimate.sensors.get(usize::from(self.imu?))?.measured?;
        Some(AlignmentSample::Imu(record.t_valid.as_secs_f64(), record.inertial?.sample()?))
    }

    fn of_pipeline(&mut self, pipeline: &Pipeline) -> Option<AlignmentSample> {
        let (t, pose) = pipeline.estimated_pose(self.sensor)?;
        let t_s = t.as_secs_f64();
        (t_s > self.newest_s).then(|| {
            self.newest_s = t_s;
            AlignmentSample::Magnetic(t_s, pose)
        })
    }
}

/// Body calibration: samples of the whole body, frame by frame, and where trackers on it are.
#[derive(Debug)]
pub(crate) struct BodySource {
    imus: [Option<SensorIndex>; SEGMENTS],
    trackers: [Option<SensorIndex>; SEGMENTS],
    records: ImuRecords,
}

impl BodySource {
    /// Of the IMU of each segment, and of the tracker; `magnetic` if all IMUs have magnetometers.
    pub(crate) fn new(
        imus: [Option<SensorIndex>; SEGMENTS],
        trackers: [Option<SensorIndex>; SEGMENTS],
        magnetic: bool,
    ) -> Self {
        Self { imus, trackers, records: ImuRecords::new(magnetic) }
    }
}

impl Source for BodySource {
    const CALIBRATION: GuidedCalibration = GuidedCalibration::Body;
    type Sample = (Recorded, Places);

    fn of_frame(&mut self, estimate: &Estimate) -> Option<(Recorded, Places)> {
        let Self { imus, trackers, records } = self;
        let samples = std::array::from_fn(|segment| {
            let sensor = estimate.sensors.get(usize::from(imus[segment]?))?;
            records.sample(segment, sensor.measured.as_ref()?)
        });
        let places = trackers.map(|tracker| {
            let pose = estimate.sensors.get(usize::from(tracker?))?.usable_pose()?;
            pose.position_m.map(Vector3::from)
        });
        Some(((estimate.t_valid.as_secs_f64(), samples), places))
    }
}

/// Chain calibration: samples of the whole chain, frame by frame.
#[derive(Debug)]
pub(crate) struct ChainSource {
    pub(crate) imus: Vec<SensorIndex>,
}

impl Source for ChainSource {
    const CALIBRATION: GuidedCalibration = GuidedCalibration::Chain;
    type Sample = Epoch;

    fn of_frame(&mut self, estimate: &Estimate) -> Option<Epoch> {
        let sample =
            |imu: &SensorIndex| estimate.sensors.get(usize::from(*imu))?.measured?.inertial?.sample();
        let samples: Vec<_> = self.imus.iter().map(sample).collect();
        let any = samples.iter().any(Option::is_some);
        any.then(|| Epoch { t_s: estimate.t_valid.as_secs_f64(), samples })
    }
}

#[cfg(test)]
mod tests {
    use posed_stage::Stage;

    use super::*;

    /// Numbers.
    struct Counting(usize);

    impl Source for Counting {
        const CALIBRATION: GuidedCalibration = GuidedCalibration::Imu;
        type Sample = usize;

        fn of_frame(&mut self, _: &Estimate) -> Option<usize> {
            None
        }

        fn of_pipeline(&mut self, _: &Pipeline) -> Option<usize> {
            self.0 += 1;
            Some(self.0)
        }
    }

    #[test]
    fn samples_that_a_calibration_does_not_take_in_time_are_left_out_and_nobody_waits() {
        let pipeline = Pipeline::new(&Stage::parse("name = \"s\"").unwrap()).unwrap();
        let (mut samples, taken) = Samples::new(Counting(0));
        for _ in 0..WAITING + 100 {
            samples.after_entry(&pipeline);
        }
        assert_eq!(taken.try_iter().collect::<Vec<_>>(), (1..=WAITING).collect::<Vec<_>>());
        samples.after_entry(&pipeline);
        assert_eq!(taken.try_iter().collect::<Vec<_>>(), [WAITING + 101]);
        drop(taken);
        samples.after_entry(&pipeline);
        samples.after_entry(&pipeline);
        assert_eq!(samples.source.0, WAITING + 102, "nothing is made for nobody");
    }
}
