//! Sensors that poses left on the wrong segments, and people who wear theirs as they say.

use posed_simulator::body::{Activity, Wearer, WearerSpec};

use super::block::BlockKind;
use super::calibrate::calibrate;
use super::moving::Moving;
use super::tests::{UNKNOWN, blocks, record, script, spec, worn};
use super::worn::{Verdict, Worn};
use super::*;

use BodySegment::{ForearmL, ForearmR, HandL, HandR, ShankL, ShankR, ThighL, ThighR, UpperArmL, UpperArmR};

type Pairs = &'static [[BodySegment; 2]];

const ARMS: Pairs = &[[UpperArmR, UpperArmL], [ForearmR, ForearmL], [HandR, HandL]];
const LEGS: Pairs = &[[ThighR, ThighL], [ShankR, ShankL]];
const SHANKS: Pairs = &[[ShankR, ShankL]];
const ARM: Pairs = &[[UpperArmR, ForearmR]];
const LEG: Pairs = &[[ThighR, ShankR]];

/// Somebody as people are, calibrated by two poses with these sensors exchanged, half a minute later: the filter, and after how long it said so, s.
fn walked(swapped: Pairs, activity: Activity, seed: u64) -> (BodyFilter, Wearer, Option<f64>) {
    let mut wearer = Wearer::new(WearerSpec { clumsiness_rad: 0.03, ..spec(script(activity), seed) });
    let mut exchanged = |seconds: f64| {
        let (mut recording, _) = record(&mut wearer, seconds);
        for (_, samples) in &mut recording {
            swapped.iter().for_each(|[one, other]| samples.swap(one.index(), other.index()));
        }
        recording
    };
    let poses = exchanged(script(activity).activity_s());
    let mut blocks = blocks(activity);
    blocks.retain(|block| matches!(block.kind, BlockKind::NPose | BlockKind::TPose));
    let skeleton = Skeleton::from_height(1.8);
    let mounts = calibrate(&poses, &blocks, &skeleton, &UNKNOWN).unwrap().mounts;
    let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
    let mut said_s = None;
    for (k, (_, samples)) in exchanged(40.0).iter().enumerate() {
        let faults = filter.push(samples, 0.01).faults;
        if faults.contains(&Some(Cause::Swapped)) {
            said_s.get_or_insert(0.01 * k as f64);
        }
    }
    (filter, wearer, said_s)
}

/// By how much the mounting of the worst sensor is wrong, degrees; half a turn where it counts on another segment than it sits on.
fn worst_deg(filter: &BodyFilter, wearer: &Wearer, swapped: Pairs) -> f64 {
    let (mounts, from) = (filter.mounts(), filter.taken_from());
    BodySegment::ALL.into_iter().fold(0.0, |worst: f64, segment| {
        let index = segment.index();
        let exchanged = swapped.iter().find(|pair| pair.contains(&segment));
        let sits = exchanged.map_or(segment, |[one, other]| if segment == *one { *other } else { *one });
        if from[index] != sits.index() {
            return 180.0;
        }
        let Some(mount) = mounts[sits.index()] else { return worst };
        worst.max(mount.q_segment_sensor.angle_to(&wearer.mounting(index).0).to_degrees())
    })
}

#[test]
fn sensors_on_the_wrong_limbs_are_found_by_walking() {
    for (name, swapped) in [("arms", ARMS), ("legs", LEGS), ("shanks", SHANKS), ("arm", ARM), ("leg", LEG)] {
        // Whose hips do not turn, as on the spot, shows which leg is which by nothing.
        let (filter, wearer, said_s) = walked(swapped, Activity::Strolling, 3);
        let off_deg = worst_deg(&filter, &wearer, swapped);
        println!("{name}: said after {said_s:?} s, {off_deg:.1} degrees off");
        assert!(said_s.is_some() && off_deg < 12.0, "{name}: {said_s:?}, {off_deg}");
    }
}

#[test]
fn whoever_wears_them_as_said_hears_nothing() {
    for (activity, seed) in [(Activity::Reaching, 4), (Activity::Strolling, 5)] {
        let (filter, wearer, said_s) = walked(&[], activity, seed);
        assert_eq!(said_s, None, "{activity:?}");
        assert!(worst_deg(&filter, &wearer, &[]) < 12.0);
    }
}

/// What trunk, legs and feet show that accelerate along one axis so, m/s²: right and left thigh and shank as one, then the feet.
fn accelerating(legs_m_s2: [f64; 2], feet_m_s2: [f64; 2]) -> [Option<Moving>; SEGMENTS] {
    let moving = |accel_m_s2: f64| Moving {
        q_room_segment: UnitQuaternion::identity(),
        angular_velocity_rad_s: Vector3::new(0.0, 0.6, 0.0),
        accel_rad_s2: Vector3::zeros(),
        specific_force_m_s2: Vector3::new(accel_m_s2, 0.0, 0.0),
    };
    let mut shown = [None; SEGMENTS];
    let [right, left] = legs_m_s2;
    let of = [(ThighR, right), (ShankR, right), (ThighL, left), (ShankL, left), (BodySegment::Pelvis, 0.0)];
    let feet = [(BodySegment::FootR, feet_m_s2[0]), (BodySegment::FootL, feet_m_s2[1])];
    for (segment, accel_m_s2) in of.into_iter().chain(feet) {
        shown[segment.index()] = Some(moving(accel_m_s2));
    }
    shown
}

/// What is found after minutes in which legs and feet go to and fro so, m/s².
fn found(legs_m_s2: [f64; 2], feet_m_s2: [f64; 2]) -> Option<Verdict> {
    let mounts = [Some(SensorMount::exact(UnitQuaternion::identity(), Vector3::zeros())); SEGMENTS];
    let skeleton = Skeleton::from_height(1.8);
    let mut worn = Worn::default();
    (0..6000).find_map(|k| {
        let to_and_fro = libm::sin(0.5 * f64::from(k));
        if worn.is_due(0.05) {
            let [legs, feet] = [legs_m_s2, feet_m_s2].map(|both| both.map(|accel| accel * to_and_fro));
            worn.push(&accelerating(legs, feet), &mounts, &skeleton);
        }
        worn.verdict(&skeleton, &mounts)
    })
}

/// Feet whose places are wrong disagree with either shank, by a little less with the wrong ones: minutes of that are no evidence. Where the difference of both legs is in what they
/// disagree by, it is.
#[test]
fn what_fits_nowhere_is_not_exchanged() {
    assert_eq!(found([0.0, 1.3], [5.6, -6.5]), None);
    let exchanged = found([1.0, -1.0], [-1.4, 1.4]).expect("the feet are on one another's legs");
    assert_eq!(exchanged.taken_from[BodySegment::FootR.index()], BodySegment::FootL.index());
}

/// Sensors that somebody takes off, and straps on again on the wrong legs while standing, are found as those that poses left there.
#[test]
fn sensors_that_are_exchanged_later_are_found() {
    const EXCHANGED: Pairs = &[[ShankR, ShankL], [BodySegment::FootR, BodySegment::FootL]];
    let (mut filter, mut wearer, said_s) = walked(&[], Activity::Strolling, 3);
    assert_eq!(said_s, None);
    for _ in 0..200 {
        let mut samples = worn(wearer.step().0);
        EXCHANGED.iter().flatten().for_each(|segment| samples[segment.index()] = None);
        filter.push(&samples, 0.01);
    }
    let stands = script(Activity::Strolling);
    let strolls_s = stands.activity_s() + 60.0;
    let mut wearer = Wearer::new(WearerSpec { clumsiness_rad: 0.03, ..spec(stands, 3) });
    let said_s = (0..(100.0 * strolls_s) as usize).find(|_| {
        let mut samples = worn(wearer.step().0);
        for [one, other] in EXCHANGED.iter().map(|pair| pair.map(BodySegment::index)) {
            // It sits on the other leg as it sat on its own.
            let on = |at: usize, own: usize| wearer.mounting(own).0.inverse() * wearer.mounting(at).0;
            let strapped = |sample: Option<ImuSample>, q: UnitQuaternion<f64>| {
                sample.map(|sample| ImuSample {
                    gyro_rad_s: q * sample.gyro_rad_s,
                    accel_m_s2: q * sample.accel_m_s2,
                    mag: sample.mag.map(|mag| q * mag),
                })
            };
            let there = strapped(samples[other], on(other, one));
            samples[other] = strapped(samples[one], on(one, other));
            samples[one] = there;
        }
        filter.push(&samples, 0.01).faults.contains(&Some(Cause::Swapped))
    });
    println!("said {:?} frames after it was put on", said_s);
    assert!(said_s.is_some());
}
