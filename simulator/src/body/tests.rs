//! The simulator's kinematics against the poses by hand that `posed`'s are held against too.

use nalgebra::UnitQuaternion;

use super::*;

fn posture(angles: &str) -> Posture {
    let mut posture = Posture::default();
    for word in angles.split_whitespace() {
        let (name, degrees) = word.split_once('=').unwrap();
        let angle = degrees.parse::<f64>().unwrap().to_radians();
        let parts: Vec<&str> = name.split('_').collect();
        let side = usize::from(parts.get(1) == Some(&"l"));
        match parts.as_slice() {
            ["spine", "flexion"] => posture.spine[0] = angle,
            ["spine", "lateral"] => posture.spine[1] = angle,
            ["spine", "rotation"] => posture.spine[2] = angle,
            ["shoulder", _, "plane"] => posture.shoulder[side][0] = angle,
            ["shoulder", _, "elevation"] => posture.shoulder[side][1] = angle,
            ["shoulder", _, "rotation"] => posture.shoulder[side][2] = angle,
            ["elbow", _, "flexion"] => posture.elbow[side][0] = angle,
            ["elbow", _, "pronation"] => posture.elbow[side][1] = angle,
            ["hip", _, "flexion"] => posture.hip[side][0] = angle,
            ["hip", _, "adduction"] => posture.hip[side][1] = angle,
            ["hip", _, "rotation"] => posture.hip[side][2] = angle,
            ["knee", _, "flexion"] => posture.knee[side] = angle,
            ["neck", "flexion"] => posture.neck[0] = angle,
            ["neck", "lateral"] => posture.neck[1] = angle,
            ["neck", "rotation"] => posture.neck[2] = angle,
            ["wrist", _, "flexion"] => posture.wrist[side][0] = angle,
            ["wrist", _, "deviation"] => posture.wrist[side][1] = angle,
            ["ankle", _, "flexion"] => posture.ankle[side][0] = angle,
            ["ankle", _, "inversion"] => posture.ankle[side][1] = angle,
            ["ankle", _, "rotation"] => posture.ankle[side][2] = angle,
            ["sternoclavicular", _, "protraction"] => posture.girdle[side][0] = angle,
            ["sternoclavicular", _, "elevation"] => posture.girdle[side][1] = angle,
            ["sternoclavicular", _, "rotation"] => posture.girdle[side][2] = angle,
            _ => panic!("no angle {name}"),
        }
    }
    posture
}

#[test]
fn segments_stand_as_in_the_poses_by_hand() {
    let text = include_str!("../../../docs/body-poses.csv");
    let mut poses = 0;
    for line in text.lines().filter(|line| !line.starts_with('#')).skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let body = posture(cells[1]).place(&Build { girdle: true, ..Build::of_height(1.8) });
        let index = SEGMENT_NAMES.iter().position(|name| *name == cells[2]).unwrap();
        let number = |at: usize| cells[at].parse::<f64>().unwrap();
        for (column, at) in [(0, 3), (1, 6)] {
            for row in 0..3 {
                let found = body[index].axes[(row, column)];
                assert!((found - number(at + row)).abs() < 1e-12, "{line}: axis {column}, {found}");
            }
        }
        poses += 1;
    }
    assert!(poses >= 20);
}

#[test]
fn a_sensor_that_rests_feels_gravity_and_the_field_and_nothing_else() {
    let script = Script { activity: Activity::Curls, calibration: true, facing: 0.7, mistake: None };
    let build = Build::of_height(1.8);
    let spec = WearerSpec {
        script,
        build,
        errors: SensorErrors::NONE,
        magnetometer: true,
        disturbances: Vec::new(),
        rate_hz: 100.0,
        clumsiness_rad: 0.0,
        seed: 1,
    };
    let mut wearer = Wearer::new(spec);
    let (samples, truth) = wearer.step();
    for (index, sample) in samples.iter().enumerate() {
        let (mount, _) = wearer.mounting(index);
        let specific_force_m_s2 = truth.body[index].axes * (mount * sample.accel_m_s2);
        assert!(
            (specific_force_m_s2 - nalgebra::Vector3::new(0.0, 0.0, posed_geometry::GRAVITY_M_S2)).norm()
                < 1e-6
        );
        assert!(sample.gyro_rad_s.norm() < 1e-9);
        let north = truth.body[index].axes * (mount * sample.mag_ut.unwrap());
        assert!(north.x.abs() < 1e-9 && north.y > 0.0 && north.z < 0.0);
    }
}

#[test]
fn angular_velocities_add_up_to_the_rotation() {
    let script = Script { activity: Activity::Walking, calibration: false, facing: 0.0, mistake: None };
    let spec = WearerSpec {
        script,
        build: Build::of_height(1.7),
        errors: SensorErrors::NONE,
        magnetometer: false,
        disturbances: Vec::new(),
        rate_hz: 1000.0,
        clumsiness_rad: 0.0,
        seed: 2,
    };
    let mut wearer = Wearer::new(spec);
    let (_, first) = wearer.step();
    let index = 5;
    let mount = wearer.mounting(index).0;
    let mut turned = first.body[index].orientation();
    let mut last = first;
    for _ in 0..3000 {
        let (samples, truth) = wearer.step();
        turned *= UnitQuaternion::from_scaled_axis(mount * samples[index].gyro_rad_s * 1e-3);
        last = truth;
    }
    let off = last.body[index].orientation().angle_to(&turned);
    assert!(off < 2e-3, "{off} rad");
}
