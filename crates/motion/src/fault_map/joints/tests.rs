//! Three sensors in a row on segments that turn, with lever arms that are to be found.

use super::*;
use crate::fault_map::frames::Frames;
use crate::fault_map::{FaultMap, Size, Training};
use posed_fusion::faults::Class;

const RATE_HZ: f64 = 60.0;

/// A chain of three, each a lever arm from its joints; `change` may move positions.
fn chain(frames: usize, change: impl Fn(usize, usize, Vector3<f64>) -> Vector3<f64>) -> Frames {
    worn(frames, |_, _| Vector3::zeros(), change)
}

/// The same; `moved` is how far a sensor sits from where it sat, on its segment.
fn worn(
    frames: usize,
    moved: impl Fn(usize, usize) -> Vector3<f64>,
    change: impl Fn(usize, usize, Vector3<f64>) -> Vector3<f64>,
) -> Frames {
    let mut made = Frames { sensors: ["a", "b", "c"].map(str::to_owned).into(), ..Frames::default() };
    let mounts = [0.4, 1.1, 2.0]
        .map(|angle| UnitQuaternion::from_scaled_axis(Vector3::new(angle, 0.3 - angle, 0.5 * angle)));
    let mut state = 1u64;
    let mut noise = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((state >> 40) as f64 / (1u64 << 24) as f64 - 0.5) * 6e-3
    };
    for k in 0..frames {
        let t = k as f64 / RATE_HZ;
        let mut joint = Vector3::new(1.2 + 0.2 * libm::sin(0.4 * t), 0.3 * libm::cos(0.3 * t), 0.5);
        let (mut positions, mut orientations) = (Vec::new(), Vec::new());
        for (sensor, mount) in mounts.iter().enumerate() {
            let s = sensor as f64 + 1.0;
            let turned = UnitQuaternion::from_scaled_axis(Vector3::new(
                0.8 * libm::sin(0.9 * s * t),
                0.7 * libm::cos(1.3 * t + s),
                0.6 * libm::sin(0.5 * t * s + 1.0),
            ));
            let p = joint + turned * (Vector3::new(0.02, 0.03, -0.12) + moved(k, sensor));
            joint += turned * Vector3::new(0.0, 0.0, -0.3);
            let p = change(k, sensor, p) + Vector3::new(noise(), noise(), noise());
            positions.extend(p.iter().copied());
            let q = turned * mount;
            orientations.extend([q.w, q.i, q.j, q.k]);
        }
        made.push_poses(t, Frame { positions_m: &positions, orientations_wxyz: &orientations });
    }
    made
}

fn believed(frames: &Frames) -> impl Fn(usize, usize) -> Option<Point> + '_ {
    |k, sensor| {
        let p = &frames.positions(k)[3 * sensor..3 * sensor + 3];
        Some([p[0], p[1], p[2]])
    }
}

/// Places of all sensors, live, where the rules believe everything.
fn live(joints: &Joints, frames: &Frames) -> Vec<[Option<Place>; 3]> {
    let mut limbs = joints.limbs(3);
    let place = |k: usize| {
        joints.follow(&mut limbs, frames.frame(k), |sensor| {
            believed(frames)(k, sensor).map_or(Hint::Missing, Hint::Here)
        });
        std::array::from_fn(|sensor| limbs.place(sensor))
    };
    (0..frames.len()).map(place).collect()
}

#[test]
fn lever_arms_are_found_and_then_a_pull_and_both_mirrors_are_known() {
    let (joints, arms) = learn(&chain(3000, |_, _, p| p), believed(&chain(3000, |_, _, p| p)));
    assert!(joints.fit(3) && joints.0.len() == 2, "{joints:?}");
    assert!(arms.iter().all(|arms| arms.iter().all(|value| value.is_finite())));
    // A gradual pull of the last, mirrors of the middle one and of all.
    let session = chain(3000, |k, sensor, p| match (k, sensor) {
        (1500..1700, 2) => p + Vector3::y() * 1e-3 * (k - 1500) as f64,
        (2000..2060, 1) | (2300..2360, _) => -p,
        (2600..2660, 1) => Vector3::new(p.x, p.y, -p.z),
        _ => p,
    });
    let places = live(&joints, &session);
    let known = places.iter().position(|row| row.iter().all(Option::is_some)).unwrap();
    assert!(known < 1000, "{known}");
    let (here, point) = (Some(Place::Here), Some(Place::Mirrored(Mirror::Point)));
    let vertical = Some(Place::Mirrored(Mirror::Vertical));
    for (k, row) in places.iter().enumerate().skip(known) {
        match k {
            1500..1600 => {}
            1600..1700 => assert_eq!(*row, [here, here, Some(Place::Elsewhere)], "{k}"),
            2000..2060 => assert_eq!(*row, [here, point, here], "{k}"),
            2300..2360 => assert_eq!(*row, [point; 3], "{k}"),
            2600..2660 => assert_eq!(*row, [here, vertical, here], "{k}"),
            _ => assert_eq!(*row, [here; 3], "{k}"),
        }
    }
}

#[test]
fn a_sensor_that_is_put_on_anew_meanwhile_is_learnt_anew() {
    let still = chain(3000, |_, _, p| p);
    let (joints, _) = learn(&still, believed(&still));
    let slipped =
        |k, sensor| if k > 2000 && sensor == 2 { Vector3::new(0.3, 0.0, 0.0) } else { Vector3::zeros() };
    let places = live(&joints, &worn(6000, slipped, |_, _, p| p));
    assert_eq!(places[2100], [Some(Place::Here), Some(Place::Here), Some(Place::Elsewhere)]);
    assert!(places[5000..].iter().all(|row| *row == [Some(Place::Here); 3]));
}

#[test]
fn two_sensors_and_sensors_without_orientations_have_no_joints() {
    let mut frames = chain(1000, |_, _, p| p);
    let but = |k: usize, sensor: usize| believed(&frames)(k, sensor).filter(|_| sensor < 2);
    assert!(learn(&frames, but).0.is_empty());
    frames.orientations_wxyz = Vec::new();
    assert!(learn(&frames, believed(&frames)).0.is_empty());
}

#[test]
fn what_is_no_forest_does_not_fit() {
    let joint = |a, b| Joint { a, b, variance_m2: 1e-4, variance_per_m8: 0.0 };
    assert!(Joints(vec![joint(0, 1), joint(1, 2)]).fit(3));
    for wrong in [
        vec![joint(0, 1), joint(1, 0)],
        vec![joint(1, 2), joint(0, 1)],
        vec![joint(0, 2), joint(1, 2)],
        vec![joint(0, 3)],
        vec![joint(1, 1)],
        vec![Joint { variance_m2: f64::NAN, ..joint(0, 1) }],
    ] {
        assert!(!Joints(wrong.clone()).fit(3), "{wrong:?}");
    }
}

#[test]
fn a_map_receives_what_they_leave_over_unless_it_is_the_published_one() {
    let recording = chain(1500, |_, _, p| p);
    let train = |body| {
        let training = Training { body, epochs: 5, ..Training::default() };
        FaultMap::train(&recording, Size { neurons: 5, side: 4 }, &training).unwrap().0
    };
    let (ours, published) = (train(true), train(false));
    assert_eq!((ours.map.dimension, published.map.dimension), (5, 3));
    // Two sensors are where they were, the last is pulled: the cells of ours are far from that.
    let pulled = chain(1500, |k, sensor, p| if k > 900 && sensor == 2 { p + Vector3::x() * 0.15 } else { p });
    for fault_map in [ours, published] {
        let text = serde_json::to_string(&fault_map).unwrap();
        assert_eq!(serde_json::from_str::<FaultMap>(&text).unwrap(), fault_map);
        let mut shares = Vec::new();
        fault_map.watch().follow(&fault_map, &pulled, |k, judged| {
            if k > 910 {
                shares.push(judged.by_map == Class::Anomalous);
            }
        });
        let found = shares.iter().filter(|found| **found).count();
        assert!(fault_map.map.dimension == 3 || 10 * found > 9 * shares.len(), "{found} of {}", shares.len());
    }
}
