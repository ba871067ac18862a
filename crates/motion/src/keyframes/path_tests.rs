//! The path passes through its key poses, smoothly.

use super::*;
use crate::keyframes::ScrewPath;

fn key(frame: u64, corner: bool) -> KeyPose {
    KeyPose { frame, score: 1.0, corner, decided: frame }
}

/// A motion with a change of velocity at frames 60 and 130, and otherwise curved.
fn motion(frames: usize) -> Vec<Isometry3<f64>> {
    let mut pose = Isometry3::identity();
    let mut poses = Vec::new();
    for k in 0..frames {
        poses.push(pose);
        let t = k as f64 / 100.0;
        let (w, v) = match k {
            0..60 => (Vector3::new(0.02, 0.01 * t, 0.0), Vector3::new(0.01, 0.0, 0.01 * t)),
            60..130 => (Vector3::new(0.0, -0.03, 0.01), Vector3::new(0.0, 0.02 * t, 0.0)),
            _ => (Vector3::new(-0.01, 0.0, 0.02), Vector3::new(-0.02, 0.0, 0.01)),
        };
        pose *= Isometry3::from_parts(Translation3::from(v), so3::exp(&w));
    }
    poses
}

#[test]
fn it_passes_through_the_recorded_key_poses() {
    let poses = motion(200);
    let keys = [key(60, true), key(130, false)];
    let spline = Spline::fit(&poses, &keys).unwrap();
    for frame in [0, 60, 130, 199] {
        let off = spline.pose(frame as f64).inv_mul(&poses[frame]);
        assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-7, "frame {frame}");
    }
}

#[test]
fn the_velocity_is_continuous_at_every_knot_but_corners() {
    let poses = motion(200);
    let spline = Spline::fit(&poses, &[key(60, true), key(130, false)]).unwrap();
    let step = 1e-5;
    let speed = |from: f64, to: f64| {
        let (a, b) = (spline.pose(from), spline.pose(to));
        let angular = so3::log(&(a.rotation.inverse() * b.rotation)) / (to - from);
        ((b.translation.vector - a.translation.vector) / (to - from), angular)
    };
    for (frame, arrival, departure) in spline.knots() {
        let at = frame as f64;
        if frame == 0 || frame == 199 {
            continue;
        }
        let (before, after) = (speed(at - step, at), speed(at, at + step));
        assert!((before.0 - arrival.linear).norm() < 1e-6 && (after.0 - departure.linear).norm() < 1e-6);
        assert!((before.1 - arrival.angular).norm() < 1e-6 && (after.1 - departure.angular).norm() < 1e-6);
        assert_eq!(arrival == departure, frame != 60, "knot at {frame}");
    }
}

#[test]
fn few_poses_and_keys_out_of_place_are_no_trouble() {
    let poses = motion(3);
    assert!(Spline::fit(&poses[..1], &[]).is_none());
    let keys = [key(0, true), key(1, false), key(1, true), key(900, true), key(u64::MAX, true)];
    let spline = Spline::fit(&poses, &keys).unwrap();
    for frame in [-3.0, 0.0, 0.5, 1.0, 2.0, 10.0] {
        assert!(spline.pose(frame).translation.vector.iter().all(|value| value.is_finite()));
    }
}

#[test]
fn a_cubic_motion_is_met_exactly_by_one_piece() {
    let position = |k: usize| {
        let t = k as f64 / 50.0;
        Vector3::new(t * t * t - t, 2.0 * t * t, 0.3 * t)
    };
    let poses: Vec<_> =
        (0..51).map(|k| Isometry3::from_parts(position(k).into(), so3::exp(&Vector3::zeros()))).collect();
    let spline = Spline::fit(&poses, &[]).unwrap();
    assert_eq!(spline.knots().count(), 2);
    assert!(spline.deviation(&poses, 0..=50).position_m < 1e-9);
}

#[test]
fn it_is_nearer_to_a_curved_recording_than_screws() {
    let poses = motion(200);
    let keys = [key(60, true), key(130, true)];
    let spline = Spline::fit(&poses, &keys).unwrap().deviation(&poses, 0..=199);
    let screw = ScrewPath::new(&poses, &keys).unwrap().deviation(&poses, 0..=199);
    assert!(spline.position_m < 0.1 * screw.position_m, "{spline:?} {screw:?}");
    assert!(spline.rotation_rad < 0.1 * screw.rotation_rad, "{spline:?} {screw:?}");
}
