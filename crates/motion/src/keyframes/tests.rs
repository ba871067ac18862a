//! Streams and whole motions, changes and quiet.

use nalgebra::Vector3;

use super::*;
use posed_geometry::se3;

/// Normal numbers (Irwin and Hall) from a fixed seed.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let uniform = |state: &mut u64| {
            *state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (*state >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| uniform(&mut self.0)).sum::<f64>() - 6.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.next(), self.next(), self.next())
    }
}

/// A motion with changes at frames 100 and 190, 1 mm and 2 mrad of noise.
fn motion(frames: usize, noise: &mut Noise) -> Vec<Isometry3<f64>> {
    let mut pose = Isometry3::identity();
    let mut poses = Vec::new();
    for k in 0..frames {
        let (angular, linear) = (noise.vector() * 2e-3, noise.vector() * 1e-3);
        poses.push(pose * se3::exp(&se3::Twist { angular, linear }));
        let (w, v) = match k {
            0..100 => ([0.0, 0.0, 0.01], [0.01, 0.0, 0.0]),
            100..190 => ([0.02, 0.0, 0.0], [0.0, 0.012, 0.0]),
            _ => ([0.0; 3], [0.0; 3]),
        };
        pose *= se3::exp(&se3::Twist { angular: Vector3::from(w), linear: Vector3::from(v) });
    }
    poses
}

fn detector() -> Detector {
    Detector::new(Hinge::new(HingeSettings::default()))
}

/// Confirmed key poses of a whole motion.
fn detect(poses: &[Isometry3<f64>]) -> Vec<KeyPose> {
    detector().run(poses).0
}

#[test]
fn the_changes_are_found_where_they_are() {
    let poses = motion(300, &mut Noise(3));
    let frames: Vec<u64> = detect(&poses).iter().map(|key| key.frame).collect();
    assert_eq!(frames.len(), 2, "{frames:?}");
    assert!(frames[0].abs_diff(100) <= 3 && frames[1].abs_diff(190) <= 3, "{frames:?}");
}

#[test]
fn what_is_confirmed_was_said_before_and_is_late_by_the_stated_delay() {
    assert_eq!(testing::confirms_as_stated(detector(), &motion(300, &mut Noise(4))), 2);
}

#[test]
fn a_detector_that_was_stored_and_restored_goes_on_as_if_nothing_had_been() {
    testing::goes_on_when_restored(detector, &motion(400, &mut Noise(5)));
}

#[test]
fn the_future_does_not_change_what_was_confirmed() {
    testing::does_not_look_ahead(detector, &motion(300, &mut Noise(6)), &[160, 200, 260]);
}

/// Confirmed detections in `frames` poses.
fn alarms(settings: HingeSettings, frames: usize, mut pose: impl FnMut(usize) -> Isometry3<f64>) -> usize {
    let mut detector = Detector::new(Hinge::new(settings));
    let mut count = 0;
    for k in 0..frames {
        detector.push(&pose(k), &mut |event| count += usize::from(matches!(event, Event::Confirmed(_))));
    }
    count
}

#[test]
fn at_rest_the_rate_of_false_alarms_is_the_stated_one() {
    for (rate_hz, correlation) in [(30.0, 0.0), (100.0, 0.0), (100.0, 0.6), (240.0, 0.85)] {
        let settings =
            HingeSettings { false_alarms_per_min: 10.0, frame_rate_hz: rate_hz, ..HingeSettings::default() };
        let mut noise = Noise(7);
        let mut state = [Vector3::zeros(); 2];
        let minutes = 50_000.0 / rate_hz / 60.0;
        let count = alarms(settings, 50_000, |_| {
            for vector in &mut state {
                *vector = *vector * correlation + noise.vector();
            }
            se3::exp(&se3::Twist { angular: state[0] * 1e-3, linear: state[1] * 1e-3 })
        });
        let ratio = count as f64 / minutes / 10.0;
        assert!((0.5..2.0).contains(&ratio), "{rate_hz} Hz, correlation {correlation}: {ratio}");
    }
}

#[test]
fn a_smooth_motion_and_a_coarse_word_raise_no_alarm() {
    let settings = HingeSettings { false_alarms_per_min: 10.0, ..HingeSettings::default() };
    for rate_hz in [30.0, 100.0, 240.0] {
        let settings = HingeSettings { frame_rate_hz: rate_hz, ..settings };
        let mut noise = Noise(8);
        let frames = (60.0 * rate_hz) as usize;
        let count = alarms(settings, frames, |k| {
            let t = k as f64 / rate_hz;
            let p = Vector3::new(libm::sin(2.0 * t), libm::cos(1.3 * t), 0.5 * libm::sin(3.1 * t));
            let w =
                Vector3::new(0.5 * libm::sin(1.7 * t), 0.3 * libm::cos(2.3 * t), 0.8 * libm::sin(0.9 * t));
            let twist = se3::Twist { angular: w + noise.vector() * 2e-3, linear: p + noise.vector() * 1e-3 };
            se3::exp(&twist)
        });
        assert!(count <= 20, "{count} in a minute at {rate_hz} Hz");
    }
    let mut noise = Noise(9);
    let count = alarms(settings, 6_000, |_| {
        let coarse = noise.vector().map(|value| (0.3 * value).round() * 1e-4);
        Isometry3::translation(coarse.x, coarse.y, coarse.z)
    });
    assert!(count <= 20, "{count}");
}

#[test]
fn the_unit_of_length_does_not_matter() {
    let poses = motion(300, &mut Noise(10));
    let scaled: Vec<_> = poses
        .iter()
        .map(|pose| Isometry3::from_parts((pose.translation.vector * 39.37).into(), pose.rotation))
        .collect();
    let (a, b) = (detect(&poses), detect(&scaled));
    assert_eq!(a.len(), b.len());
    assert!(a.iter().zip(&b).all(|(a, b)| a.frame == b.frame && (a.score / b.score - 1.0).abs() < 1e-6));
}

#[test]
fn a_pose_that_never_changes_is_no_trouble() {
    assert_eq!(detect(&vec![Isometry3::identity(); 500]), []);
    assert_eq!(detect(&[]), []);
}
