//! Seventeen sensors: shoulders that rise and come forward with the arms, calibrated, seen and carried on to the arms.

use posed_simulator::body::{Activity, Build, Script, Wearer, WearerSpec};

use super::tests::{UNKNOWN, exactly, record_of, script, spec, worn_of};
use super::*;

const SEVENTEEN: [bool; SEGMENTS] = [true; SEGMENTS];

fn moving() -> Build {
    Build { girdle: true, ..Build::of_height(1.8) }
}

/// Of the sternoclavicular joint, root mean square of the whole rotation, rad, and of the place of the arm's joint against the torso's origin, m; right side.
fn followed(present: &[bool; SEGMENTS], activity: Activity) -> [f64; 2] {
    let script = Script { activity, calibration: false, facing: 0.6, mistake: None };
    let mut wearer = Wearer::new(WearerSpec { build: moving(), ..spec(script, 4) });
    let skeleton = Skeleton::from_height(1.8);
    let mounts = exactly(present, &wearer);
    let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
    let (torso, shoulder) = (BodySegment::Torso.index(), BodySegment::ShoulderR.index());
    let arm = BodySegment::UpperArmR.index();
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for k in 0..2000 {
        let (samples, truth) = wearer.step();
        let posture = filter.push(&worn_of(present, samples), 0.01).posture;
        if k < 500 {
            continue;
        }
        let origins_m = skeleton.origins_m(&posture, Vector3::zeros());
        let at_m = posture[torso].inverse() * (origins_m[arm] - origins_m[torso]);
        let truth_q = truth.body.map(|placement| placement.orientation());
        let truth_m = truth_q[torso].inverse() * (truth.body[arm].origin_m - truth.body[torso].origin_m);
        let turned = posture[torso].inverse() * posture[shoulder];
        squares[0] += turned.angle_to(&(truth_q[torso].inverse() * truth_q[shoulder])).powi(2);
        squares[1] += (at_m - truth_m).norm_squared();
        count += 1.0;
    }
    squares.map(|sum| f64::sqrt(sum / count))
}

#[test]
fn a_shoulder_that_rises_with_its_arm_is_seen_by_its_sensor_and_moves_the_arm_s_joint() {
    let [unseen_rad, unseen_m] = followed(&super::tests::FIFTEEN, Activity::Reaching);
    let [seen_rad, seen_m] = followed(&SEVENTEEN, Activity::Reaching);
    assert!(unseen_rad.to_degrees() > 6.0 && unseen_m > 0.015, "{unseen_rad} rad, {unseen_m} m");
    // The headings of torso and shoulder are each as good as a magnetometer, 1.4 degrees.
    assert!(seen_rad.to_degrees() < 3.0 && seen_m < 0.01, "{seen_rad} rad, {seen_m} m");
}

#[test]
fn an_arm_hangs_where_a_shrug_lifts_it() {
    let skeleton = Skeleton::from_height(1.8);
    let mut all = [upright(); SEGMENTS];
    let standing = skeleton.origins_m(&all, Vector3::zeros());
    let shrug = joint_rotation(BodySegment::ShoulderL, &[0.0, 0.3, 0.0]);
    all[BodySegment::ShoulderL.index()] = upright() * shrug;
    let lifted = skeleton.origins_m(&all, Vector3::zeros());
    let girdle_m = skeleton.end_in_segment_m(BodySegment::ShoulderL).norm();
    let risen = Vector3::new(0.0, -(1.0 - libm::cos(0.3)), libm::sin(0.3)) * girdle_m;
    for segment in BodySegment::ALL {
        let arm = matches!(segment, BodySegment::UpperArmL | BodySegment::ForearmL | BodySegment::HandL);
        let moved = lifted[segment.index()] - standing[segment.index()];
        let expected = if arm { risen } else { Vector3::zeros() };
        assert!((moved - expected).norm() < 1e-12, "{segment:?} {moved}");
    }
    // So it does in the 23, whose upper arm is turned against the shoulder.
    let [of_all, of_standing] = [all, [upright(); SEGMENTS]].map(|q| whole(&q));
    let [a, b] = [of_all, of_standing].map(|q| skeleton.whole_origins_m(&q, Vector3::zeros()));
    let hand = WholeSegment::HandL.index();
    assert!((a[hand] - b[hand] - risen).norm() < 1e-12);
    let inner: Vec<_> = inner_angles(&all, &SEVENTEEN).collect();
    let elevation =
        inner.iter().find(|(joint, angle, _)| (*joint, *angle) == ("glenohumeral_l", "elevation"));
    assert!((elevation.unwrap().2.unwrap() - 0.3).abs() < 1e-9, "{elevation:?}");
}

/// Who wears seventeen is asked for no more than who wears fifteen, and shoulders that rise with the arms of a T-pose are no contradiction.
#[test]
fn seventeen_sensors_are_calibrated() {
    for (magnetic, how, activity) in [
        (true, Thoroughness::Quick, Activity::Poses),
        (true, Thoroughness::Full, Activity::Bends),
        (false, Thoroughness::Full, Activity::Bends),
    ] {
        let script = Script { calibration: false, ..script(activity) };
        let clumsy = WearerSpec { build: moving(), rate_hz: 50.0, clumsiness_rad: 0.03, ..spec(script, 3) };
        let mut wearer = Wearer::new(WearerSpec { magnetometer: magnetic, ..clumsy });
        let mut guide = Guide::new(SEVENTEEN, magnetic, how);
        for (t_s, samples) in record_of(&SEVENTEEN, &mut wearer, 130.0).0 {
            guide.push(t_s, &samples);
        }
        assert_eq!((guide.prompt(), guide.objection()), (None, (0, None)), "{magnetic} {how:?}");
        let (recording, blocks) = guide.recorded();
        let found = calibrate(recording, blocks, &Skeleton::from_height(1.8), &UNKNOWN).unwrap();
        for shoulder in BodySegment::SHOULDERS {
            let mount = found.mounts[shoulder.index()].unwrap();
            let off_rad = mount.q_segment_sensor.angle_to(&wearer.mounting(shoulder.index()).0);
            let sigma_rad = mount.sigma_rad.norm();
            assert!(off_rad < 2.0 * sigma_rad && sigma_rad < 0.15, "{shoulder:?} {off_rad} of {sigma_rad}");
        }
    }
}

/// Without a field a shoulder's heading is held by the joint at its root, as those of head and hands are.
#[test]
fn a_shoulder_s_heading_is_held_without_a_field() {
    let script = Script { activity: Activity::Walking, calibration: false, facing: 0.0, mistake: None };
    let mut wearer =
        Wearer::new(WearerSpec { build: moving(), magnetometer: false, rate_hz: 50.0, ..spec(script, 5) });
    let mut mounts = exactly(&SEVENTEEN, &wearer);
    let heading = &mut mounts[BodySegment::ShoulderR.index()].as_mut().unwrap().heading_rad;
    *heading = Some(0.3);
    let mut filter = BodyFilter::new(&Skeleton::from_height(1.8), &mounts, &BodyParams::default());
    let (recording, _) = record_of(&SEVENTEEN, &mut wearer, 120.0);
    let mut off_rad = Vec::new();
    for (_, samples) in &recording {
        let found = filter.push(samples, 0.02).orientations;
        if let [Some(torso), Some(shoulder)] =
            [BodySegment::Torso, BodySegment::ShoulderR].map(|of| found[of.index()])
        {
            off_rad.push(
                posed_geometry::wrapped_rad(yaw_from_upright(&shoulder) - yaw_from_upright(&torso)).abs(),
            );
        }
    }
    let last_rad = off_rad[off_rad.len() - 500..].iter().sum::<f64>() / 500.0;
    assert!(off_rad[100] > 0.2 && last_rad < 0.1, "{} to {last_rad}", off_rad[100]);
}
