//! IMUs that are attached to magnetic sensors: one filter for both.
//!
//! In: a closed frame with its estimates. Out: the magnetic sensor's pose is that of the common filter
//! ([`posed_fusion::aided`]), which goes on for half a second where the tracker fails and follows between its records. It
//! believes of the tracker what `faults` and the gate let through, and leaves the estimate as it is where the IMU is
//! silent or nobody knows yet how it sits. The states of both sensors stay what they are.

use nalgebra::{Isometry3, Matrix3};
use posed_state::State;

use super::PipelineError;
use super::magnetic::{EstimatedPose, upper_triangle};
use super::sensor::Sensor;
use crate::frame::Frame;
use posed_fusion::aided::{Aided, AidedParams, AidedPose, MagneticPose};
use posed_stage::Stage;
use posed_stage::input::SensorIndex;
use posed_stage::output::{Estimate, PoseEstimate, SensorState};

/// What an alignment of half a degree and some millimetres leaves, m and rad: joins the tracker's noise.
const LEFT_M: f64 = 1e-3;
const LEFT_RAD: f64 = 5e-3;
/// An IMU that was heard so lately is there, s.
const FRESH_S: f64 = 0.05;
/// Biases of units that nobody has calibrated (standard deviations), rad/s and m/s².
const BIASES: [f64; 2] = [0.02, 0.2];

/// All pairs of a stage.
#[derive(Clone, Debug, State)]
pub(super) struct Attached {
    #[state(each)]
    pairs: Vec<Pair>,
}

#[derive(Clone, Debug, State)]
struct Pair {
    #[state(keep)]
    sensor: SensorIndex,
    #[state(keep)]
    imu: SensorIndex,
    /// Absent as long as nobody knows how the IMU sits.
    filter: Option<Aided>,
    /// A pose that is newer than the IMU's latest sample; it has its turn when that one has come.
    waiting: Option<MagneticPose>,
}

impl Attached {
    /// The pairs that a stage names.
    pub(super) fn new(stage: &Stage) -> Result<Self, PipelineError> {
        let mut pairs = Vec::new();
        for (sensor, attached) in (0..).zip(stage.sensors.iter().map(|sensor| sensor.imu.as_ref())) {
            let Some(attached) = attached else { continue };
            let unknown = PipelineError::Value {
                key: "sensor.imu.sensor",
                expected: "the name of an IMU of this stage",
            };
            let imu = stage.sensors.iter().position(|known| known.name == attached.sensor).ok_or(unknown)?;
            let mut pair = Pair { sensor, imu: imu as SensorIndex, filter: None, waiting: None };
            if let Some(quat_wxyz) = attached.quat_wxyz {
                let sits = posed_geometry::isometry(attached.offset_m, quat_wxyz);
                let wrong = PipelineError::Value {
                    key: "sensor.imu",
                    expected: "numbers up to 1e6 and a quaternion",
                };
                pair.attach(&sits.ok_or(wrong)?, attached.clock_offset_ms * 1e-3);
            }
            pairs.push(pair);
        }
        Ok(Self { pairs })
    }

    /// How the IMU of a magnetic sensor sits: IMU to sensor. False where it has none.
    pub(super) fn attach(&mut self, sensor: SensorIndex, sits: &Isometry3<f64>, clock_offset_s: f64) -> bool {
        let pair = self.pairs.iter_mut().find(|pair| pair.sensor == sensor);
        pair.map(|pair| pair.attach(sits, clock_offset_s)).is_some()
    }

    /// An IMU's samples are corrected otherwise from now on.
    pub(super) fn restart(&mut self, imu: SensorIndex) {
        for pair in self.pairs.iter_mut().filter(|pair| pair.imu == imu) {
            pair.waiting = None;
            pair.filter.iter_mut().for_each(Aided::restart);
        }
    }

    /// The transmitter stands elsewhere.
    pub(super) fn moved(&mut self) {
        for pair in &mut self.pairs {
            pair.waiting = None;
            pair.filter.iter_mut().for_each(Aided::moved);
        }
    }

    /// Takes a frame and improves the estimates of the sensors that wear an IMU.
    pub(super) fn frame(
        &mut self,
        frame: &Frame,
        sensors: &[Sensor],
        room: &Isometry3<f64>,
        estimate: &mut Estimate,
    ) {
        for pair in &mut self.pairs {
            let Some(filter) = &mut pair.filter else { continue };
            let (sensor, imu) = (usize::from(pair.sensor), usize::from(pair.imu));
            let live = estimate.sensors[imu].state != SensorState::Stuck;
            for record in frame.sensors[imu].samples.iter().filter(|_| live) {
                if let Some(sample) = record.measured.inertial.and_then(|inertial| inertial.sample()) {
                    filter.imu(record.measured.t_valid.as_secs_f64(), &sample);
                }
            }
            let believed = sensors[sensor].estimated_pose();
            for pose in
                [pair.waiting.take(), believed.map(|believed| in_room(&believed, room))].into_iter().flatten()
            {
                if filter.imu_s().is_some_and(|imu_s| imu_s < pose.t_s) {
                    pair.waiting = Some(pose);
                } else {
                    filter.magnetic(&pose);
                }
            }
            let t_s = frame.t_valid.as_secs_f64();
            let out = &mut estimate.sensors[sensor];
            if let Some(pose) = filter.at(t_s) {
                out.pose = Some(published(&pose));
                out.coasted = believed.is_none();
            } else if believed.is_none() && filter.imu_s().is_some_and(|imu_s| t_s - imu_s < FRESH_S) {
                // The tracker alone would go on as it last moved; who has an IMU knows better.
                out.pose = None;
            }
        }
    }
}

impl Pair {
    /// `sits`: IMU to sensor.
    fn attach(&mut self, sits: &Isometry3<f64>, clock_offset_s: f64) {
        let q_imu_sensor = sits.rotation.inverse();
        let lever_m = -(q_imu_sensor * sits.translation.vector);
        let params = AidedParams {
            lever_m,
            q_imu_sensor,
            offset_s: clock_offset_s,
            bias_sigmas: BIASES,
            ..AidedParams::default()
        };
        self.filter = Some(Aided::new(params));
        self.waiting = None;
    }
}

fn in_room(believed: &EstimatedPose, room: &Isometry3<f64>) -> MagneticPose {
    let rotation = room.rotation.to_rotation_matrix().into_inner();
    MagneticPose {
        t_s: believed.t.as_secs_f64(),
        room_from_sensor: room * believed.pose,
        position_cov_m2: rotation * believed.position_m2 * rotation.transpose()
            + Matrix3::identity() * LEFT_M.powi(2),
        rotation_var_rad2: believed.rotation_rad2 + LEFT_RAD.powi(2),
    }
}

fn published(pose: &AidedPose) -> PoseEstimate {
    PoseEstimate {
        position_m: Some(pose.position_m.into()),
        orientation_wxyz: posed_geometry::orientation_to_wxyz(&pose.orientation),
        velocity_m_s: Some(pose.velocity_m_s.into()),
        angular_velocity_rad_s: pose.angular_velocity_rad_s.into(),
        covariance: upper_triangle(&pose.position_m2, &pose.rotation_rad2),
        sigma_m: Some(pose.position_m2.trace().max(0.0).sqrt()),
    }
}
