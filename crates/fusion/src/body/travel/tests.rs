//! Whole bodies that walk, squat and lose a sensor, from the simulator.

use crate::body::{BodyFilter, BodyParams};
use posed_simulator::body::{Activity, Script};

use super::*;
use crate::body::tests::{FIFTEEN, exactly, mounted, wearer_of, worn};
use crate::body::{Anchor, BodySegment};

/// Who walks gets as far as the feet bring it, stands on both feet before, and turns where it walked; a sensor that is lost stops it.
#[test]
fn feet_that_stand_bring_the_body_where_it_walks() {
    let script = Script { activity: Activity::Strolling, calibration: false, facing: 0.6, mistake: None };
    let (filter, mut wearer) = mounted(Activity::Strolling, 3);
    // By the ankles.
    let mut mounts = filter.mounts();
    [BodySegment::FootR, BodySegment::FootL].into_iter().for_each(|foot| mounts[foot.index()] = None);
    let mut filter = BodyFilter::new(&Skeleton::from_height(1.8), &mounts, &BodyParams::default());
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
            right += f64::from(u8::from(stands || contact.foot < 0.5));
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
    let anchor = Anchor {
        segment: BodySegment::Pelvis,
        offset_m: Vector3::zeros(),
        position_m: Vector3::new(4.0, 5.0, 1.0),
        sigma_m: 0.01,
        orientation: None,
    };
    assert!(filter.anchor(&[anchor]).is_some());
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
        let stands = travel.contacts.unwrap().iter().all(|contact| contact.foot > 0.5);
        assert!(truth.t_s < 1.2 || stands, "{travel:?}");
    }
    assert!(off_m < 0.05, "{off_m}");

    // Legs that are shaken all the time.
    let mut legs = Legs {
        sensor_m: Vector3::new(-0.08, 0.0, 0.02),
        specific_force_m_s2: Some(Vector3::new(0.1, -0.1, GRAVITY_M_S2 + 0.2)),
        rests: false,
        ankles_m: [Vector3::new(0.0, -0.09, -0.9), Vector3::new(0.0, 0.09, -0.9)],
        feet: [Foot::Ankle(Point {
            at_m: Vector3::zeros(),
            accel_m_s2: Some(Vector3::new(12.0, 0.0, 3.0)),
            turns_rad_s: None,
        }); 2],
    };
    let mut filter = TravelFilter::new(&Skeleton { foot_m: 0.07, ..Skeleton::from_height(1.8) });
    for frame in 0..60_000 {
        let swing = libm::sin(f64::from(frame) * 0.2);
        legs.ankles_m.iter_mut().for_each(|ankle_m| ankle_m.x = 0.1 * swing);
        for (foot, ankle_m) in legs.feet.iter_mut().zip(legs.ankles_m) {
            if let Foot::Ankle(point) = foot {
                point.at_m = ankle_m;
            }
        }
        let travel = filter.push(&legs, 0.02, 0.01);
        assert!((travel.pelvis_m - Vector3::new(0.0, 0.0, 0.97)).norm() < 3.0, "{frame} {travel:?}");
    }
}

/// A foot that wears a sensor stands first by its heel, then by both, and last by its ball, which is found where this person has it; the heel that rises does not
/// stop the ball from holding the body.
#[test]
fn a_foot_with_a_sensor_stands_by_heel_and_ball() {
    let (mut filter, mut wearer) = mounted(Activity::Strolling, 3);
    let pelvis = BodySegment::Pelvis.index();
    let (mut way_m, mut last) = ([0.0; 2], None);
    let mut seen = [0; 4];
    for frame in 0..4000 {
        let (samples, truth) = wearer.step();
        let travel = filter.push(&worn(samples), 0.01).travel;
        if frame < 300 {
            continue;
        }
        let travel = travel.expect("all sensors are worn");
        let hips_m = [truth.body[pelvis].origin_m, travel.pelvis_m];
        if let Some(last) = last.replace(hips_m) {
            let last: [Vector3<f64>; 2] = last;
            (0..2).for_each(|k| way_m[k] += (hips_m[k] - last[k]).xy().norm());
        }
        let feet = travel.contacts.unwrap();
        for foot in feet {
            let [heel, ball] = foot.sole.expect("both feet wear sensors").map(|contact| contact > 0.5);
            seen[usize::from(heel) + 2 * usize::from(ball)] += 1;
        }
        assert!(feet.iter().any(|foot| foot.foot > 0.5), "{frame}: the body is never without a foot");
    }
    assert!((way_m[1] / way_m[0] - 1.0).abs() < 0.02 && way_m[0] > 20.0, "{way_m:?}");
    let [none, heel, ball, both] = seen;
    assert!(none > 1000 && heel > 200 && ball > 700 && both > 1000, "{seen:?}");
    // The simulated foot turns about a point 0.061 of the height ahead of its ankle; the proportions say 0.081.
    for side in 0..2 {
        let [_, ball_m] = filter.travel.sole_m(side);
        assert!((ball_m.x / 1.8 - 0.061).abs() < 0.008, "{}", ball_m.x / 1.8);
    }
}

/// Two feet whose points are accelerated so, m/s², and that turn so fast, rad/s, below a pelvis that is accelerated along x, m/s².
fn thrown(foot_m_s2: f64, turns_rad_s: f64, pelvis_m_s2: f64) -> Legs {
    let feet = [0.1, -0.1].map(|left_m| {
        Foot::Sole([-0.05, 0.1].map(|ahead_m| Point {
            at_m: Vector3::new(ahead_m, -left_m, -0.95),
            accel_m_s2: Some(Vector3::new(foot_m_s2, 0.0, 0.0)),
            turns_rad_s: Some(Vector3::new(0.0, 0.0, turns_rad_s)),
        }))
    });
    Legs {
        sensor_m: Vector3::new(-0.08, 0.0, 0.02),
        specific_force_m_s2: Some(Vector3::new(pelvis_m_s2, 0.0, GRAVITY_M_S2)),
        rests: false,
        ankles_m: [Vector3::new(0.0, -0.1, -0.88), Vector3::new(0.0, 0.1, -0.88)],
        feet,
    }
}

/// A body whose velocity was lost while no foot stood is found again as soon as the feet lie still by their own sensors, whatever the velocity says.
#[test]
fn feet_that_lie_still_find_a_lost_velocity_again() {
    let mut filter = TravelFilter::new(&Skeleton::from_height(1.8));
    for _ in 0..200 {
        filter.push(&thrown(0.0, 0.0, 0.0), 0.02, 0.01);
    }
    // Feet that are thrown about tell nothing, and the pelvis's accelerometer something wrong: 0.8 m/s.
    for _ in 0..40 {
        filter.push(&thrown(20.0, 8.0, 2.0), 0.02, 0.01);
    }
    let lost_m_s = filter.axes[0].value(VELOCITY);
    assert!(lost_m_s > 0.5, "{lost_m_s}");
    for _ in 0..20 {
        filter.push(&thrown(0.0, 0.0, 0.0), 0.02, 0.01);
    }
    let travel = filter.push(&thrown(0.0, 0.0, 0.0), 0.02, 0.01);
    assert!(travel.contacts.unwrap().iter().all(|contact| contact.foot > 0.9), "{travel:?}");
    let found_m_s = filter.axes[0].value(VELOCITY);
    assert!(found_m_s.abs() < 0.05, "{found_m_s}");
}

/// Feet that do not turn hold the body, though its velocity is wrong: what seems to move is the body.
#[test]
fn feet_that_do_not_turn_are_not_loose() {
    let mut filter = TravelFilter::new(&Skeleton::from_height(1.8));
    for _ in 0..200 {
        filter.push(&thrown(0.0, 0.0, 0.0), 0.02, 0.01);
    }
    let stood_m = filter.sensor_m().x;
    for _ in 0..15 {
        filter.push(&thrown(20.0, 8.0, 2.0), 0.02, 0.01);
    }
    let (lost_m_s, away_m) = (filter.axes[0].value(VELOCITY), filter.sensor_m().x - stood_m);
    for _ in 0..50 {
        filter.push(&thrown(0.0, 0.0, 0.0), 0.02, 0.01);
    }
    let left_m = filter.sensor_m().x - stood_m;
    println!("{lost_m_s:.2} m/s, {away_m:.4} m, {left_m:.4} m are left");
    assert!(away_m > 0.015 && left_m.abs() < 0.005, "{away_m} {left_m}");
}

/// Whoever sits with swinging feet stays where he is: the pelvis rests by its own sensor.
#[test]
fn who_sits_and_swings_the_feet_stays() {
    let foot = |x_m: f64| {
        Foot::Ankle(Point {
            at_m: Vector3::new(x_m, 0.1, -0.45),
            accel_m_s2: Some(Vector3::new(9.0, 0.0, 2.0)),
            turns_rad_s: None,
        })
    };
    let mut filter = TravelFilter::new(&Skeleton::from_height(1.8));
    let sits = |x_m: f64| Legs {
        sensor_m: Vector3::new(-0.08, 0.0, 0.02),
        specific_force_m_s2: Some(Vector3::new(0.08, -0.05, GRAVITY_M_S2 + 0.05)),
        rests: true,
        ankles_m: [Vector3::new(x_m, -0.1, -0.45), Vector3::new(-x_m, 0.1, -0.45)],
        feet: [foot(x_m), foot(-x_m)],
    };
    let began_m = filter.push(&sits(0.0), 0.02, 0.01).pelvis_m;
    for frame in 1..12_000 {
        let travel = filter.push(&sits(0.15 * libm::sin(f64::from(frame) * 0.06)), 0.02, 0.01);
        assert!((travel.pelvis_m - began_m).norm() < 0.1, "{frame} {travel:?}");
    }
}

/// A tracker on a hand or on the head says where the whole body is and which way it faces; one that leaps is not believed, two that agree are, and one that
/// stays elsewhere is in the end.
#[test]
fn a_tracker_on_any_segment_anchors_the_body() {
    for segment in [BodySegment::Head, BodySegment::HandR, BodySegment::FootL, BodySegment::Torso] {
        // Whoever has stood for a calibration wears gyros whose biases are known.
        let script = Script { activity: Activity::Strolling, calibration: true, facing: 0.6, mistake: None };
        let stands_s = script.activity_s();
        let mut wearer = wearer_of(script, false, 4);
        let skeleton = Skeleton::from_height(1.8);
        let mut filter = BodyFilter::new(&skeleton, &exactly(&FIFTEEN, &wearer), &BodyParams::default());
        for _ in 0..(stands_s * 100.0) as usize {
            filter.push(&worn(wearer.step().0), 0.01);
        }
        let away_m = Vector3::new(2.0, -1.0, 0.3);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -0.6);
        let offset_m = Vector3::new(0.02, -0.05, 0.01);
        let anchor = |truth: &posed_simulator::body::TrueBody, leap_m: f64| {
            let placed = &truth[segment.index()];
            let axes = placed.orientation();
            Anchor {
                segment,
                offset_m,
                position_m: turned.inverse() * (placed.origin_m + axes * offset_m)
                    + away_m
                    + Vector3::x() * leap_m,
                sigma_m: 0.005,
                orientation: Some((turned.inverse() * axes, 0.02)),
            }
        };
        for frame in 0..3000 {
            let (samples, truth) = wearer.step();
            // No compass, so that the body begins looking along the room's x.
            filter.push(&worn(samples), 0.01);
            if frame < 200 {
                continue;
            }
            let leaps = frame > 2400 && frame < 2500;
            let placed = filter.anchor(&[anchor(&truth.body, if leaps { 0.6 } else { 0.0 })]);
            if frame > 400 {
                assert_eq!(placed.is_none(), leaps, "{segment:?} {frame}");
                let hips = &truth.body[BodySegment::Pelvis.index()];
                let truth_m = turned.inverse() * hips.origin_m + away_m;
                let found_m = placed.map_or(filter.estimate().travel.unwrap().pelvis_m, |(at_m, _)| at_m);
                assert!((found_m - truth_m).norm() < 0.1, "{segment:?} {frame}: {found_m} for {truth_m}");
                let pelvis = filter.estimate().orientations[BodySegment::Pelvis.index()].unwrap();
                let facing = turned.inverse() * hips.orientation();
                assert!(pelvis.angle_to(&facing) < 0.15, "{segment:?} {frame}: {}", pelvis.angle_to(&facing));
            }
        }
        // It stays elsewhere: two that agree are believed at once, one after a while.
        let (samples, truth) = wearer.step();
        let samples = worn(samples);
        filter.push(&samples, 0.01);
        let mut alone = filter.clone();
        let elsewhere = anchor(&truth.body, 1.0);
        assert!(filter.anchor(&[elsewhere; 2]).is_some(), "{segment:?}");
        assert!(alone.anchor(&[elsewhere]).is_none(), "{segment:?}");
        let until = (0..1000).position(|_| {
            alone.push(&samples, 0.01);
            alone.anchor(&[elsewhere]).is_some()
        });
        assert!(until.is_some_and(|frames| (25..600).contains(&frames)), "{segment:?} {until:?}");
    }
}
