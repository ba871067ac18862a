//! Whole bodies that walk, squat and lose a sensor, from the simulator.

use posed_simulator::body::{Activity, Script};

use super::tests::{mounted, worn};
use super::*;

/// Who walks gets as far as the feet bring it, stands on both feet before, and turns where it walked; a sensor that is lost stops it.
#[test]
fn feet_that_stand_bring_the_body_where_it_walks() {
    let script = Script { activity: Activity::Strolling, calibration: false, facing: 0.6, mistake: None };
    let (mut filter, mut wearer) = mounted(Activity::Strolling, 3);
    let pelvis = BodySegment::Pelvis.index();
    let (mut began_m, mut way_m, mut last) = (None, [0.0; 2], None);
    let (mut right, mut count) = (0.0, 0.0);
    for frame in 0..4000 {
        let (samples, truth) = wearer.step();
        let travel = filter.push(&worn(samples), 0.01).travel;
        if frame < 100 {
            continue;
        }
        let travel = travel.expect("all sensors are worn");
        let hips_m = [truth.body[pelvis].origin_m, travel.pelvis_m];
        let began_m = *began_m.get_or_insert(hips_m[1] - hips_m[0]);
        assert!((hips_m[1] - hips_m[0] - began_m).norm() < 0.3, "{frame}: {hips_m:?}");
        if let Some(last) = last.replace(hips_m) {
            let last: [Vector3<f64>; 2] = last;
            (0..2).for_each(|k| way_m[k] += (hips_m[k] - last[k]).xy().norm());
        }
        let stand = script.contacts(truth.t_s).expect("it walks");
        for (stands, contact) in stand.into_iter().zip(travel.contacts.unwrap()) {
            // A heel that has just landed, and a toe that is about to leave, are not seen.
            right += f64::from(u8::from(stands || contact < 0.5));
            count += 1.0;
        }
    }
    assert!((way_m[1] / way_m[0] - 1.0).abs() < 0.02 && way_m[0] > 20.0, "{way_m:?}");
    assert!(right / count > 0.98, "{}", right / count);

    let was_m = filter.estimate().travel.unwrap().pelvis_m;
    let shank = BodySegment::ShankL.index();
    for _ in 0..50 {
        let mut samples = worn(wearer.step().0);
        samples[shank] = None;
        filter.push(&samples, 0.01);
    }
    let travel = filter.estimate().travel.unwrap();
    assert_eq!(travel.contacts, None);
    assert!((travel.pelvis_m - was_m).norm() < 0.3, "{was_m:?} {travel:?}");
    for _ in 0..120 {
        filter.push(&worn(wearer.step().0), 0.01);
    }
    assert!(filter.estimate().travel.unwrap().contacts.is_some());
    filter.place_at(Vector3::new(4.0, 5.0, 1.0));
    let travel = filter.push(&worn(wearer.step().0), 0.01).travel.unwrap();
    assert!((travel.pelvis_m - Vector3::new(4.0, 5.0, 1.0)).norm() < 0.05, "{travel:?}");
}

/// A foot that does not move stands, however the body above it moves; and who never stands is somewhere all the same.
#[test]
fn who_squats_stays_and_who_floats_does_not_fly_off() {
    let (mut filter, mut wearer) = mounted(Activity::Squats, 5);
    let pelvis = BodySegment::Pelvis.index();
    let mut off_m: f64 = 0.0;
    for _ in 0..1500 {
        let (samples, truth) = wearer.step();
        let Some(travel) = filter.push(&worn(samples), 0.01).travel else {
            assert!(truth.t_s < 1.1);
            continue;
        };
        off_m = off_m.max((travel.pelvis_m - truth.body[pelvis].origin_m).norm());
        let stands = travel.contacts.unwrap().iter().all(|contact| *contact > 0.5);
        assert!(truth.t_s < 1.2 || stands, "{travel:?}");
    }
    assert!(off_m < 0.05, "{off_m}");

    // Legs that are shaken all the time.
    let mut legs = Legs {
        sensor_m: Vector3::new(-0.08, 0.0, 0.02),
        specific_force_m_s2: Some(Vector3::new(0.1, -0.1, GRAVITY_M_S2 + 0.2)),
        ankles_m: [Vector3::new(0.0, -0.09, -0.9), Vector3::new(0.0, 0.09, -0.9)],
        accels_m_s2: [Some(Vector3::new(12.0, 0.0, 3.0)); 2],
    };
    let mut filter = TravelFilter::new(0.07);
    for frame in 0..60_000 {
        let swing = libm::sin(f64::from(frame) * 0.2);
        legs.ankles_m.iter_mut().for_each(|ankle_m| ankle_m.x = 0.1 * swing);
        let travel = filter.push(&legs, 0.02, 0.01);
        assert!((travel.pelvis_m - Vector3::new(0.0, 0.0, 0.97)).norm() < 3.0, "{frame} {travel:?}");
    }
}
