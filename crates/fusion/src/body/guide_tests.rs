//! A simulated person follows the guide, from any moment on, and makes the mistakes that people make.

use nalgebra::UnitQuaternion;
use posed_simulator::body::{Activity, Mistake, Script, SensorErrors, Wearer, WearerSpec};

use super::tests::{FIFTEEN, fifteen, record, spec};
use super::*;

struct Case {
    how: Thoroughness,
    activity: Activity,
    magnetometer: bool,
    mistake: Option<Mistake>,
    /// How the person stands, standard deviation of every joint, rad.
    clumsiness_rad: f64,
    /// When in the person's round the guide begins, s.
    begin_s: f64,
    seed: u64,
}

/// Somebody who does this from the beginning on, and looks along the room's x.
fn ahead(activity: Activity) -> Script {
    Script { activity, calibration: false, facing: 0.0, mistake: None }
}

/// What was objected to, in the end too, and the worst mounting, degrees.
fn guided(case: &Case) -> (Vec<String>, Option<f64>) {
    let script = Script { activity: case.activity, calibration: false, facing: 0.6, mistake: case.mistake };
    let mut wearer = Wearer::new(WearerSpec {
        magnetometer: case.magnetometer,
        // As slow as a guide may be fed: these are minutes of many people.
        rate_hz: 50.0,
        clumsiness_rad: case.clumsiness_rad,
        ..spec(script, case.seed)
    });
    record(&mut wearer, case.begin_s);
    let mut guide = Guide::new(FIFTEEN, case.magnetometer, case.how);
    let mut objections = Vec::new();
    for _ in 0..300 {
        for (t_s, samples) in record(&mut wearer, 1.0).0 {
            guide.push(t_s, &samples);
            let (count, objection) = guide.objection();
            if count > objections.len() {
                objections.push(objection.unwrap().to_owned());
            }
        }
        if guide.prompt().is_none() {
            break;
        }
    }
    assert_eq!(guide.prompt(), None, "{:?} {} {objections:?}", case.how, case.begin_s);
    let (recording, blocks) = guide.recorded();
    let found = calibrate(recording, blocks, &Skeleton::from_height(1.8), &[None; SEGMENTS]);
    let worst_deg = found.as_ref().ok().map(|found| {
        fifteen().fold(0.0, |worst: f64, segment| {
            let mount: UnitQuaternion<f64> = found.mounts[segment.index()].unwrap().q_segment_sensor;
            worst.max(mount.angle_to(&wearer.mounting(segment.index()).0).to_degrees())
        })
    });
    objections.extend(found.err().map(|error| error.to_string()));
    (objections, worst_deg)
}

/// Every `how` with what a person does for it; a quick one without magnetometers asks for as much as a full one.
const HOWS: [(Thoroughness, Activity, bool); 5] = [
    (Thoroughness::Quick, Activity::Poses, true),
    (Thoroughness::Full, Activity::Bends, true),
    (Thoroughness::Assign, Activity::Movements, true),
    (Thoroughness::Full, Activity::Bends, false),
    (Thoroughness::Assign, Activity::Movements, false),
];

#[test]
fn every_how_is_followed_from_any_moment_on() {
    for (how, activity, magnetometer) in HOWS {
        for begin_s in [0.0, 5.5, 12.3] {
            let case =
                Case { how, activity, magnetometer, mistake: None, clumsiness_rad: 0.0, begin_s, seed: 3 };
            let (objections, worst_deg) = guided(&case);
            let worst_deg = worst_deg.unwrap();
            assert!(worst_deg < 5.0, "{how:?} {magnetometer} {begin_s} {objections:?} {worst_deg}");
        }
    }
}

#[test]
fn a_mistake_is_named_and_does_not_count() {
    let mistakes = |how| {
        [
            (Mistake::ArmsForward, "about which way the body faces"),
            (Mistake::ArmsLow, "was raised by"),
            (Mistake::PalmsForward, "about its length"),
            (Mistake::BentElbows, if how == Thoroughness::Assign { "leans by" } else { "was bent by" }),
            (Mistake::Stoops, "leans by"),
        ]
    };
    // `cargo bench --bench body deceit` goes through all of them.
    for (how, activity, magnetometer) in [HOWS[0], HOWS[3], HOWS[4]] {
        for (mistake, words) in mistakes(how) {
            let case = Case {
                how,
                activity,
                magnetometer,
                mistake: Some(mistake),
                clumsiness_rad: 0.02,
                begin_s: 0.0,
                seed: 5,
            };
            let (objections, worst_deg) = guided(&case);
            assert!(
                objections.iter().any(|objection| objection.contains(words)),
                "{mistake:?} {objections:?}"
            );
            // Who does not know yet who sits where hears of it in the end, and begins again.
            let is_right = worst_deg.map_or(how == Thoroughness::Assign, |worst_deg| worst_deg < 12.0);
            assert!(is_right, "{how:?} {magnetometer} {mistake:?} {worst_deg:?} {objections:?}");
        }
    }
}

#[test]
fn people_who_stand_as_people_do_hear_nothing() {
    for (how, activity, magnetometer) in HOWS {
        for seed in [10, 11] {
            let case =
                Case { how, activity, magnetometer, mistake: None, clumsiness_rad: 0.06, begin_s: 0.0, seed };
            let (objections, worst_deg) = guided(&case);
            assert_eq!(objections, Vec::<String>::new(), "{how:?} {magnetometer} {seed} {worst_deg:?}");
        }
    }
}

#[test]
fn a_unit_that_must_be_calibrated_itself_is_named_in_the_end_and_nobody_poses_in_vain() {
    let errors = SensorErrors { gyro_bias_rad_s: 0.045, ..SensorErrors::calibrated() };
    let mut wearer = Wearer::new(WearerSpec { errors, ..spec(ahead(Activity::Poses), 3) });
    let mut guide = Guide::new(FIFTEEN, true, Thoroughness::Quick);
    record(&mut wearer, 25.0).0.iter().for_each(|(t_s, samples)| guide.push(*t_s, samples));
    assert_eq!((guide.prompt(), guide.objection()), (None, (0, None)));
    let (recording, blocks) = guide.recorded();
    let found = calibrate(recording, blocks, &Skeleton::from_height(1.8), &[None; SEGMENTS]);
    assert!(found.unwrap_err().to_string().contains("posed imu calibrate"));
}

/// Who bends the right knee and wears the sensors of the shanks the wrong way round hears at once that the left one moved, and is not asked for ever.
#[test]
fn what_moves_in_the_place_of_what_was_asked_for_is_named() {
    let slow = WearerSpec { rate_hz: 50.0, clumsiness_rad: 0.02, ..spec(ahead(Activity::Bends), 3) };
    let mut wearer = Wearer::new(slow);
    let mut guide = Guide::new(FIFTEEN, true, Thoroughness::Full);
    for (t_s, mut samples) in record(&mut wearer, 90.0).0 {
        samples.swap(BodySegment::ShankR.index(), BodySegment::ShankL.index());
        guide.push(t_s, &samples);
        if let (1.., objection) = guide.objection() {
            let expected = "shank_l moved in knee_flexion_r, and shank_r did not";
            assert!(objection.is_some_and(|objection| objection.contains(expected)), "{objection:?}");
            return;
        }
    }
    panic!("nothing was said");
}

/// A sensor that is off is named at once, and nobody poses for it in vain; once it is on, the guide goes on.
#[test]
fn nothing_goes_on_while_a_sensor_is_silent() {
    let mut wearer = Wearer::new(WearerSpec { rate_hz: 50.0, ..spec(ahead(Activity::Poses), 3) });
    let mut guide = Guide::new(FIFTEEN, true, Thoroughness::Quick);
    for (t_s, mut samples) in record(&mut wearer, 60.0).0 {
        if t_s < 30.0 {
            samples[BodySegment::ForearmL.index()] = None;
        }
        guide.push(t_s, &samples);
        let silent: Vec<_> = guide.silent().collect();
        match t_s {
            1.5..30.0 => {
                assert_eq!((silent.as_slice(), guide.progress().0), (&[BodySegment::ForearmL][..], 0));
            }
            30.1.. => assert_eq!(silent, []),
            _ => {}
        }
    }
    assert_eq!((guide.prompt(), guide.objection().0), (None, 0));
}

/// Who is asked for no pose walks, and is done after twenty seconds of it.
#[test]
fn who_walks_needs_no_pose() {
    let mut wearer = Wearer::new(WearerSpec { rate_hz: 50.0, ..spec(ahead(Activity::Strolling), 3) });
    let mut guide = Guide::new(FIFTEEN, true, Thoroughness::Movement);
    assert!(guide.prompt().is_some_and(|prompt| prompt.starts_with("Walk about")), "{:?}", guide.prompt());
    record(&mut wearer, 30.0).0.iter().for_each(|(t_s, samples)| guide.push(*t_s, samples));
    assert_eq!((guide.prompt(), guide.objection()), (None, (0, None)));
    let (recording, blocks) = guide.recorded();
    let found = calibrate(recording, blocks, &Skeleton::from_height(1.8), &[None; SEGMENTS]).unwrap();
    for segment in [BodySegment::Pelvis, BodySegment::ThighR, BodySegment::ThighL, BodySegment::ShankR] {
        let mount = found.mounts[segment.index()].unwrap();
        let off_rad = mount.q_segment_sensor.angle_to(&wearer.mounting(segment.index()).0);
        assert!(
            off_rad < 1.5 * mount.sigma_rad.norm(),
            "{segment:?}: {off_rad} of {}",
            mount.sigma_rad.norm()
        );
    }
}

/// Strides that go back and forth do not show which way is ahead: it says so at once, and asks for the walk again.
#[test]
fn who_walks_back_and_forth_walks_once_more() {
    let spec = WearerSpec { rate_hz: 50.0, ..spec(ahead(Activity::Strolling), 3) };
    let (there, _) = record(&mut Wearer::new(spec.clone()), 14.0);
    let mut guide = Guide::new(FIFTEEN, true, Thoroughness::Movement);
    // The same in reverse is the way back, backwards.
    let back = there.iter().rev().map(|(_, samples)| {
        samples.map(|sample| sample.map(|sample| ImuSample { gyro_rad_s: -sample.gyro_rad_s, ..sample }))
    });
    let walk = there.iter().map(|(_, samples)| *samples).chain(back);
    let mut t_s = 0.0;
    walk.for_each(|samples| {
        t_s += 0.02;
        guide.push(t_s, &samples);
    });
    let (count, objection) = guide.objection();
    assert_eq!((count, guide.progress().0), (1, 0));
    assert!(objection.is_some_and(|sentence| sentence.contains("always forwards")), "{objection:?}");
    record(&mut Wearer::new(spec), 30.0)
        .0
        .iter()
        .for_each(|(from_s, samples)| guide.push(t_s + from_s, samples));
    assert_eq!((guide.prompt(), guide.objection().0), (None, 1));
}
