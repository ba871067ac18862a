//! The closed forms of the statistic, and key poses by it.

use nalgebra::Vector3;

use super::*;
use crate::keyframes::{Detector, testing};

const N: usize = 12;

fn raw(window: usize) -> MeanDifference {
    MeanDifference::new(MeanDifferenceSettings {
        window,
        neighbourhood: window,
        metres_per_radian: 0.3,
        acceptance: 0.5,
        smooth: false,
    })
}

fn twist(angular: [f64; 3], linear: [f64; 3]) -> se3::Twist {
    se3::Twist { angular: Vector3::from(angular), linear: Vector3::from(linear) }
}

/// Poses whose twist between frames k and k + 1 is `at(k)`.
fn poses(frames: usize, at: impl Fn(usize) -> se3::Twist) -> Vec<Isometry3<f64>> {
    let mut pose = se3::exp(&twist([0.4, -1.0, 0.3], [1.0, 2.0, -0.5]));
    let mut poses = vec![pose];
    for k in 0..frames - 1 {
        pose *= se3::exp(&at(k));
        poses.push(pose);
    }
    poses
}

/// (frame, eta)
fn etas(mut statistic: MeanDifference, poses: &[Isometry3<f64>]) -> Vec<(usize, f64)> {
    let lag = statistic.lag_frames();
    let score = |(k, pose)| statistic.push(pose).map(|score| (k - lag, score.value));
    poses.iter().enumerate().filter_map(score).collect()
}

fn frobenius(twist: &se3::Twist) -> f64 {
    (2.0 * (0.3 * twist.angular.norm()).powi(2) + twist.linear.norm_squared()).sqrt()
}

const A: ([f64; 3], [f64; 3]) = ([0.03, -0.01, 0.02], [0.01, 0.02, -0.005]);
const B: ([f64; 3], [f64; 3]) = ([-0.01, 0.02, 0.05], [-0.02, 0.01, 0.01]);

#[test]
fn a_constant_screw_gives_zero() {
    let etas = etas(raw(N), &poses(100, |_| twist(A.0, A.1)));
    assert_eq!(etas.len(), 100 - 2 * N);
    assert!(etas.iter().all(|(_, eta)| *eta < 1e-13));
}

#[test]
fn a_step_of_the_velocity_gives_one_peak_of_known_height() {
    let (a, b) = (twist(A.0, A.1), twist(B.0, B.1));
    let etas = etas(raw(N), &poses(120, |k| if k < 60 { a } else { b }));
    let step = se3::Twist { angular: b.angular - a.angular, linear: b.linear - a.linear };
    let n = N as f64;
    let height = n * (n + 1.0) / (2.0 * (2.0 * n + 1.0)) * frobenius(&step);
    let peak = etas.iter().max_by(|x, y| x.1.total_cmp(&y.1)).unwrap();
    assert_eq!(peak.0, 60);
    assert!((peak.1 - height).abs() < 1e-12, "{} {height}", peak.1);
    assert_eq!(etas.iter().filter(|(_, eta)| (eta - height).abs() < 1e-9).count(), 1);
}

#[test]
fn a_jump_gives_two_equal_peaks() {
    let jump = twist([0.2, 0.1, -0.3], [0.3, 0.0, 0.1]);
    let etas = etas(raw(N), &poses(120, |k| if k == 60 { jump } else { twist([0.0; 3], [0.0; 3]) }));
    let n = N as f64;
    let height = n / (2.0 * n + 1.0) * frobenius(&jump);
    let peaks: Vec<_> = etas.iter().filter(|(_, eta)| (eta - height).abs() < 1e-12).collect();
    assert_eq!(peaks.iter().map(|peak| peak.0).collect::<Vec<_>>(), [60, 61]);
    assert!(etas.iter().all(|(_, eta)| *eta < height + 1e-12));
}

/// A motion without rule, and of some length so that the sums are renewed.
fn tumble(k: usize) -> se3::Twist {
    let t = k as f64;
    twist(
        [0.05 * libm::sin(0.11 * t), 0.04 * libm::cos(0.07 * t), 0.03 * libm::sin(0.3 * t)],
        [0.02 * libm::cos(0.05 * t), 0.03 * libm::sin(0.13 * t), 0.01 * libm::cos(0.9 * t)],
    )
}

#[test]
fn the_running_sums_agree_with_the_definition_and_with_the_mean_of_the_running_twist() {
    let poses = poses(2500, tumble);
    let statistic = raw(N);
    let phi: Vec<Scaled> =
        poses.windows(2).map(|pair| statistic.scaled(&se3::log(&pair[0].inv_mul(&pair[1])))).collect();
    let mut running = vec![[0.0; 6]];
    for phi in &phi {
        let last = *running.last().unwrap();
        running.push(std::array::from_fn(|c| last[c] + phi[c]));
    }
    let scale = 1.0 / (2 * N + 1) as f64;
    for (i, eta) in etas(raw(N), &poses) {
        let mut by_weights = [0.0; 6];
        let mut by_mean = [0.0; 6];
        for c in 0..6 {
            for k in 0..N {
                by_weights[c] +=
                    scale * ((N - k) as f64 * phi[i + k][c] - (k + 1) as f64 * phi[i - N + k][c]);
            }
            by_mean[c] = scale * (i - N..=i + N).map(|j| running[j][c]).sum::<f64>() - running[i][c];
        }
        for delta in [by_weights, by_mean] {
            let norm = delta.iter().map(|d| d * d).sum::<f64>().sqrt();
            assert!((eta - norm).abs() < 1e-12, "frame {i}");
        }
    }
}

#[test]
fn the_frame_of_reference_does_not_matter_but_the_mounting_does() {
    let poses = poses(300, tumble);
    let shift = se3::exp(&twist([1.0, -0.4, 0.7], [3.0, -1.0, 0.5]));
    let plain = etas(raw(N), &poses);
    let moved = etas(raw(N), &poses.iter().map(|pose| shift * pose).collect::<Vec<_>>());
    assert!(plain.iter().zip(&moved).all(|(a, b)| (a.1 - b.1).abs() < 1e-12));
    let mounted = etas(raw(N), &poses.iter().map(|pose| pose * shift).collect::<Vec<_>>());
    assert!(plain.iter().zip(&mounted).any(|(a, b)| (a.1 - b.1).abs() > 1e-3));
}

#[test]
fn smoothing_leaves_a_constant_screw_a_screw_and_keeps_a_step_where_it_is() {
    let settings = MeanDifferenceSettings { window: N, ..MeanDifferenceSettings::default() };
    let still = etas(MeanDifference::new(settings), &poses(200, |_| twist(A.0, A.1)));
    assert_eq!(still.first().unwrap().0, N + MOTION_HALF + SCORE_HALF);
    assert!(still.iter().all(|(_, eta)| *eta < 1e-9));
    let (a, b) = (twist(A.0, A.1), twist(B.0, B.1));
    let step = etas(MeanDifference::new(settings), &poses(200, |k| if k < 90 { a } else { b }));
    assert_eq!(step.iter().max_by(|x, y| x.1.total_cmp(&y.1)).unwrap().0, 90);
}

/// A motion with changes at frames 100 and 190, that trembles by a millimetre and some milliradians.
fn motion(frames: usize) -> Vec<Isometry3<f64>> {
    let mut pose = Isometry3::identity();
    let mut poses = Vec::new();
    for k in 0..frames {
        let tremble = |c: f64| libm::sin(12.9 * (k * k) as f64 + c);
        let (a, b) = ([tremble(0.0), tremble(1.0), tremble(2.0)], [tremble(3.0), tremble(4.0), tremble(5.0)]);
        poses.push(pose * se3::exp(&twist(a.map(|x| 2e-3 * x), b.map(|x| 1e-3 * x))));
        pose *= se3::exp(&match k {
            0..100 => twist([0.0, 0.0, 0.01], [0.01, 0.0, 0.0]),
            100..190 => twist([0.02, 0.0, 0.0], [0.0, 0.012, 0.0]),
            _ => twist([0.0; 3], [0.0; 3]),
        });
    }
    poses
}

fn detector() -> Detector<MeanDifference> {
    Detector::new(MeanDifference::new(MeanDifferenceSettings::default()))
}

#[test]
fn changes_are_found_where_they_are_and_none_in_a_pose_that_never_changes() {
    let (keys, _) = detector().run(&motion(300));
    let frames: Vec<u64> = keys.iter().map(|key| key.frame).collect();
    assert_eq!(frames.len(), 2, "{frames:?}");
    assert!(frames[0].abs_diff(100) <= 3 && frames[1].abs_diff(190) <= 3, "{frames:?}");
    assert_eq!(detector().run(&vec![Isometry3::identity(); 500]).0, []);
    assert_eq!(detector().run(&[]).0, []);
}

#[test]
fn what_is_confirmed_was_said_before_and_is_late_by_the_stated_delay() {
    assert_eq!(detector().delay_frames(), 2 * 30 + 18);
    assert_eq!(testing::confirms_as_stated(detector(), &motion(300)), 2);
}

#[test]
fn the_future_does_not_change_what_was_confirmed() {
    testing::does_not_look_ahead(detector, &motion(300), &[160, 200, 260, 290]);
}

#[test]
fn a_detector_that_was_stored_and_restored_goes_on_as_if_nothing_had_been() {
    testing::goes_on_when_restored(detector, &motion(400));
}
