//! Sensors that poses left on the wrong segments, and people who wear theirs as they say.

use posed_simulator::body::{Activity, Wearer, WearerSpec};

use super::block::BlockKind;
use super::calibrate::calibrate;
use super::tests::{UNKNOWN, blocks, record, script, spec};
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
