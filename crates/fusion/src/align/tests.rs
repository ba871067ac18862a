use super::*;
use posed_geometry::GRAVITY_M_S2;
use posed_geometry::so3::exp;

type V = Vector3<f64>;

struct MovedPair {
    room_from_transmitter: Isometry3<f64>,
    q_sensor_imu: UnitQuaternion<f64>,
    lever_m: V,
}

impl MovedPair {
    /// A transmitter tilted by ten degrees.
    fn new() -> Self {
        let tilt = exp(&V::new(10_f64.to_radians(), 0.0, 0.0));
        Self {
            room_from_transmitter: Isometry3::from_parts(
                Translation3::new(0.4, -0.2, 0.9),
                exp(&V::new(0.0, 0.0, 0.7)) * tilt,
            ),
            q_sensor_imu: exp(&V::new(0.9, -1.4, 0.3)),
            lever_m: V::new(0.021, -0.013, 0.034),
        }
    }

    /// Sensor in the room.
    fn pose(t: f64, turning: f64) -> Isometry3<f64> {
        let rotation_vector_rad =
            V::new(libm::sin(1.9 * t), libm::cos(1.3 * t + 0.4), 0.9 * libm::sin(2.7 * t)) * turning;
        let position_m =
            V::new(0.3 * libm::sin(1.1 * t), 0.2 * libm::cos(1.7 * t), 1.0 + 0.15 * libm::sin(2.3 * t));
        Isometry3::from_parts(position_m.into(), exp(&rotation_vector_rad))
    }

    /// Forty seconds at 100 Hz with 0.5 mm, 0.3 degrees and a bias.
    fn samples(&self, turning: f64, noise: f64) -> Vec<PairedSample> {
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            // Uniform of variance 1.
            ((state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * 12_f64.sqrt() * noise
        };
        let imu = |t: f64| {
            let sensor = Self::pose(t, turning);
            sensor.transform_point(&self.lever_m.into()).coords
        };
        (0..4000)
            .map(|k| {
                let t_s = 0.01 * f64::from(k);
                let h = 1e-3;
                let accel = (imu(t_s + h) + imu(t_s - h) - imu(t_s) * 2.0) / (h * h);
                let room_from_sensor = Self::pose(t_s, turning);
                let mut pose = self.room_from_transmitter.inverse() * room_from_sensor;
                pose.translation.vector += V::from_fn(|_, _| 5e-4 * random());
                pose.rotation *= exp(&V::from_fn(|_, _| 0.005 * random()));
                let level_from_imu = room_from_sensor.rotation * self.q_sensor_imu;
                let specific_force_m_s2 = level_from_imu.inverse() * (accel + V::z() * GRAVITY_M_S2);
                let level_from_imu = level_from_imu * exp(&V::from_fn(|_, _| 0.01 * random()));
                PairedSample {
                    t_s,
                    transmitter_from_sensor: pose,
                    level_from_imu,
                    gyro_from_imu: level_from_imu,
                    specific_force_m_s2: specific_force_m_s2
                        + V::new(0.03, -0.02, 0.04) * noise
                        + V::from_fn(|_, _| 0.03 * random()),
                }
            })
            .collect()
    }
}

#[test]
fn a_tilted_transmitter_is_found_within_half_a_degree_and_five_millimetres() {
    let moved = MovedPair::new();
    let anchors =
        [V::new(0.3, 0.1, 0.2), V::new(-0.4, 0.5, 0.1), V::new(0.1, -0.6, 0.5)].map(|transmitter_m| {
            let room_m = moved.room_from_transmitter.transform_point(&transmitter_m.into()).coords;
            AnchorPoint { transmitter_m, room_m: room_m + V::new(0.001, -0.001, 0.001) }
        });
    let found = align(&[moved.samples(1.0, 1.0)], &anchors, true).unwrap();
    let off = found.room_from_transmitter.rotation.angle_to(&moved.room_from_transmitter.rotation);
    assert!(off.to_degrees() < 0.5, "room: {} degrees", off.to_degrees());
    let off = found.q_sensor_imu.angle_to(&moved.q_sensor_imu).to_degrees();
    assert!(off < 0.5, "IMU: {off} degrees");
    let off = (found.lever_m - moved.lever_m).norm();
    assert!(off < 5e-3, "lever: {off} m");
    let position_m = found.room_from_transmitter.translation.vector;
    let off = (position_m - moved.room_from_transmitter.translation.vector).norm();
    assert!(off < 5e-3, "transmitter: {off} m");
    assert!((found.accel_bias_m_s2 - V::new(0.03, -0.02, 0.04)).norm() < 0.02, "{:?}", found.accel_bias_m_s2);
    assert!(found.residual_rad > 0.005 && found.residual_rad < 0.03);
}

#[test]
fn without_noise_it_is_exact_and_anchors_give_the_heading() {
    let moved = MovedPair::new();
    let mut samples = moved.samples(1.0, 0.0);
    // A level frame of its own heading.
    let own = exp(&V::new(0.0, 0.0, -1.1));
    for sample in &mut samples {
        sample.level_from_imu = own * sample.level_from_imu;
    }
    let anchors = [V::new(0.3, 0.1, 0.2), V::new(-0.4, 0.5, 0.1)].map(|transmitter_m| AnchorPoint {
        transmitter_m,
        room_m: moved.room_from_transmitter.transform_point(&transmitter_m.into()).coords,
    });
    let found = align(&[samples], &anchors, false).unwrap();
    let (off, expected) = (found.room_from_transmitter, moved.room_from_transmitter);
    // What sums for integrals leave.
    assert!(
        off.rotation.angle_to(&expected.rotation) < 1e-3,
        "{}",
        off.rotation.angle_to(&expected.rotation)
    );
    assert!((off.translation.vector - expected.translation.vector).norm() < 1e-3);
    assert!((found.lever_m - moved.lever_m).norm() < 5e-4, "{:?}", found.lever_m);
    assert!(found.anchors_m < 1e-3);
}

#[test]
fn what_does_not_turn_is_refused() {
    let moved = MovedPair::new();
    assert_eq!(align(&[moved.samples(0.0, 0.0)], &[], true), Err(AlignError::OneAxis));
    assert!(matches!(
        align(&[moved.samples(1.0, 0.0)[..50].to_vec()], &[], true),
        Err(AlignError::TooShort { .. })
    ));
}
