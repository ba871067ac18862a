//! The tracker on motions with known truth.

use nalgebra::{UnitQuaternion, Vector3};

use super::super::testing::Random;
use super::*;
use crate::faults::{Detector, Label};
use posed_geometry::so3;

const DT: f64 = 0.01;

/// A hand: 0.3 m strokes that reach 3 m/s and 30 m/s^2, turning with them.
fn hand(t: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let phase = 10.0 * t;
    let p = Vector3::new(
        0.6 + 0.3 * libm::sin(phase),
        0.2 * libm::cos(0.7 * phase),
        -0.2 + 0.1 * libm::sin(0.9 * phase),
    );
    (p, so3::exp(&Vector3::new(0.9 * libm::sin(phase), 0.5 * libm::cos(0.6 * phase), 0.4)))
}

fn t(k: usize) -> Timestamp {
    Timestamp::from_secs_f64(k as f64 * DT)
}

fn noisy(
    truth: &(Vector3<f64>, UnitQuaternion<f64>),
    noise: &TrackerNoise,
    random: &mut Random,
) -> MeasuredPose {
    let position: Vector3<f64> = noise.position_m2(&truth.0).cholesky().unwrap().l() * random.vector();
    let rotation_vector_rad: Vector3<f64> =
        noise.rotation_rad2(Some(&truth.0)).cholesky().unwrap().l() * random.vector();
    MeasuredPose {
        position_m: Some(truth.0 + position),
        orientation: Some(truth.1 * so3::exp(&rotation_vector_rad)),
    }
}

fn push(
    tracker: &mut Tracker,
    detector: &mut Detector,
    t: Timestamp,
    pose: &MeasuredPose,
) -> (Label, Verdict) {
    let expected = tracker.expectation(t);
    let checked = detector.check(pose, expected.as_ref(), tracker.noise(), true, None);
    (checked.label, tracker.push(t, &checked))
}

fn new() -> (Tracker, Detector) {
    (Tracker::new(TrackerNoise::default(), Tuning::default()), Detector::default())
}

#[test]
fn a_fast_hand_is_followed_within_five_sigma_whatever_the_noise() {
    for factor in [0.3, 1.0, 3.0, 8.0] {
        let quiet = TrackerNoise::default();
        let scene = TrackerNoise {
            sigma_radial_m: factor * quiet.sigma_radial_m,
            sigma_rotation_rad: factor * quiet.sigma_rotation_rad,
            ..quiet
        };
        let mut random = Random::new(5);
        let (mut tracker, mut detector) = new();
        let (mut wrong, mut lost, mut within) = (0, 0, 0);
        for k in 0..1000 {
            let truth = hand(k as f64 * DT);
            let (_, verdict) = push(&mut tracker, &mut detector, t(k), &noisy(&truth, &scene, &mut random));
            if verdict != Verdict::Used {
                lost += 1;
                continue;
            }
            let track = tracker.at(t(k)).unwrap();
            let error = (track.position_m().unwrap() - truth.0).norm();
            let sigma = scene.position_m2(&truth.0).trace().sqrt();
            let rotation_rad = track.orientation().unwrap().angle_to(&truth.1);
            let sigma_rotation_rad = scene.rotation_rad2(Some(&truth.0)).trace().sqrt();
            wrong += usize::from(error > 5.0 * sigma || rotation_rad > 5.0 * sigma_rotation_rad);
            within += usize::from(error < 3.0 * track.position_m2().trace().sqrt());
        }
        println!("noise x {factor}: wrong {wrong}, lost {lost}, within 3 stated sigma {within}");
        assert_eq!(wrong, 0, "noise x {factor}");
        assert!(lost <= 12, "noise x {factor}: lost {lost}");
        assert!(within >= 900, "noise x {factor}: {within} within 3 stated sigma");
    }
}

#[test]
fn flipped_bits_are_never_good_beyond_20_mm_or_5_degrees() {
    let mut random = Random::new(11);
    let (mut wrong, mut lost, mut flips) = (0, 0, 0);
    for run in 0..20 {
        let (mut tracker, mut detector) = new();
        for k in 0..1000 {
            let truth = hand(k as f64 * DT + f64::from(run));
            let mut pose = noisy(&truth, &TrackerNoise::default(), &mut random);
            // As many as the fault script has, twice over: a bit of one 14-bit word.
            if random.uniform() < 0.05 {
                flips += 1;
                flip(&mut pose, &mut random);
            }
            if push(&mut tracker, &mut detector, t(k), &pose).1 == Verdict::Used {
                let track = tracker.at(t(k)).unwrap();
                let error = (track.position_m().unwrap() - truth.0).norm();
                let rotation_deg = track.orientation().unwrap().angle_to(&truth.1).to_degrees();
                wrong += usize::from(error > 0.02 || rotation_deg > 5.0);
            } else {
                lost += 1;
            }
        }
    }
    println!("flips {flips}: wrong {wrong}, lost {lost}");
    assert_eq!(wrong, 0);
    assert!(lost <= 2 * flips, "{lost} lost of {flips}");
}

fn flip(pose: &mut MeasuredPose, random: &mut Random) {
    let bit = (random.uniform() * 14.0) as i32;
    let word = (random.uniform() * 7.0) as usize;
    let flipped = |value: f64, scale: f64| {
        let code = (value / scale * 8192.0).round() as i32;
        let bits = ((code as u32) & 0x3fff) ^ (1 << bit);
        let signed = if bits & 0x2000 != 0 { bits as i32 - 0x4000 } else { bits as i32 };
        f64::from(signed) / 8192.0 * scale
    };
    if word < 3 {
        let p = pose.position_m.as_mut().unwrap();
        p[word] = flipped(p[word], 72.0 * 0.0254);
    } else {
        let mut q = pose.orientation.unwrap().into_inner();
        q.coords[word - 3] = flipped(q.coords[word - 3], 1.0);
        pose.orientation = Some(UnitQuaternion::from_quaternion(q));
    }
}

#[test]
fn a_track_needs_agreeing_records_and_a_replaced_sensor_is_found_again() {
    let (mut tracker, mut detector) = new();
    let mut random = Random::new(3);
    let noise = TrackerNoise::default();
    let here = (Vector3::new(0.4, 0.1, -0.1), so3::exp(&Vector3::new(0.1, 0.2, 0.3)));
    let there = (Vector3::new(0.7, -0.3, -0.3), so3::exp(&Vector3::new(-1.0, 0.2, 0.5)));
    let mut verdicts = Vec::new();
    for k in 0..60 {
        let pose = if k < 30 { &here } else { &there };
        verdicts.push(push(&mut tracker, &mut detector, t(k), &noisy(pose, &noise, &mut random)).1);
    }
    use Verdict::{Suspect, Used};
    assert_eq!(verdicts[..4], [Suspect, Suspect, Used, Used]);
    assert_eq!(verdicts[30..36], [Suspect, Suspect, Suspect, Suspect, Used, Used]);
    assert!(verdicts[35..].iter().all(|verdict| *verdict == Used));
    assert!(tracker.at(t(59 + 49)).is_some(), "coasts for half a second");
    assert!(tracker.at(t(59 + 51)).is_none(), "and no longer");
    let late = t(60 + 1000);
    assert_eq!(push(&mut tracker, &mut detector, late, &noisy(&here, &noise, &mut random)).1, Suspect);
}

#[test]
fn flips_and_stuck_records_are_recovered_within_two_frames() {
    let (mut tracker, mut detector) = new();
    let mut random = Random::new(8);
    let noise = TrackerNoise::default();
    let mut held = None;
    for k in 0..600 {
        let truth = hand(k as f64 * DT);
        let mut pose = noisy(&truth, &noise, &mut random);
        let flipped = (200..300).contains(&k);
        let stuck = (400..420).contains(&k);
        if flipped {
            pose.position_m = pose.position_m.map(|p| -p);
        }
        if stuck {
            pose = *held.get_or_insert(pose);
        }
        let (label, verdict) = push(&mut tracker, &mut detector, t(k), &pose);
        if flipped {
            assert_eq!((label, verdict), (Label::INVERTED, Verdict::Used), "frame {k}");
        } else if (401..420).contains(&k) {
            assert_eq!(verdict, Verdict::Dropped, "frame {k}: {label:?}");
        } else if (10..400).contains(&k) {
            assert_eq!((label, verdict), (Label::CLEAN, Verdict::Used), "frame {k}");
        } else if k >= 422 + 5 {
            assert_eq!(verdict, Verdict::Used, "frame {k}: {label:?}");
        }
    }
}
