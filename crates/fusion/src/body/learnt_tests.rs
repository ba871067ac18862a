//! What movements show of how sensors sit and how long segments are, and straps that slip.

use nalgebra::Vector3;
use posed_simulator::body::{Activity, Build, Script, Wearer, WearerSpec};

use super::block::{BlockKind, Recorded};
use super::calibrate::calibrate;
use super::tests::{Orientations, UNKNOWN, blocks, fifteen, record, running, script, spec};
use super::*;

type V = Vector3<f64>;

/// Somebody whose joints are off by 1.7 degrees each, and what a calibration makes of it: the filter, what it is given, and the truth. The strap on `slips` slips
/// after 30 s of the activity.
struct Refined {
    wearer: Wearer,
    filter: BodyFilter,
    recording: Vec<Recorded>,
    truth: Vec<Orientations>,
}

impl Refined {
    fn new(activity: Activity, quick: bool, thigh: f64, slips: Option<(BodySegment, V)>) -> Self {
        let mut spec = WearerSpec { clumsiness_rad: 0.03, ..spec(script(activity), 3) };
        spec.build.thigh_m *= thigh;
        let mut wearer = Wearer::new(spec);
        let (mut recording, mut truth) = record(&mut wearer, script(activity).activity_s() + 30.0);
        let mut blocks = blocks(activity);
        blocks.retain(|block| !quick || matches!(block.kind, BlockKind::NPose | BlockKind::TPose));
        let skeleton = Skeleton::from_height(1.8);
        let mounts = calibrate(&recording, &blocks, &skeleton, &UNKNOWN).unwrap().mounts;
        if let Some((segment, turned)) = slips {
            wearer.slip(segment.index(), turned);
        }
        let (more, more_truth) = record(&mut wearer, 30.0);
        recording.extend(more);
        truth.extend(more_truth);
        let filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
        Self { wearer, filter, recording, truth }
    }

    /// Takes all of it; how often in the last ten seconds one of its sensors did not fit, 0 to 1.
    fn run(&mut self) -> f64 {
        let last = self.recording.len() - 1000;
        let misfit = |estimate: &BodyEstimate| estimate.faults.contains(&Some(Cause::Misfit));
        let samples = self.recording.iter().enumerate();
        samples.filter(|(k, (_, samples))| misfit(self.filter.push(samples, 0.01)) && *k >= last).count()
            as f64
            / 1e3
    }

    /// How wrong a mounting is now and how well it is said to be known, degrees.
    fn mounting_deg(&self, segment: BodySegment) -> (f64, f64) {
        let mount = self.filter.mounts()[segment.index()].unwrap();
        let (truth, _) = self.wearer.mounting(segment.index());
        (mount.q_segment_sensor.angle_to(&truth).to_degrees(), mount.sigma_rad.norm().to_degrees())
    }

    /// How wrong the joint above a segment is at the end, the whole rotation, degrees.
    fn joint_deg(&self, segment: BodySegment) -> f64 {
        let parent = segment.parent().unwrap();
        let found = &self.filter.estimate().orientations;
        let truth = self.truth.last().unwrap();
        let found = found[parent.index()].unwrap().inverse() * found[segment.index()].unwrap();
        let truth = truth[parent.index()].inverse() * truth[segment.index()];
        found.angle_to(&truth).to_degrees()
    }
}

#[test]
fn movements_show_how_sensors_sit_and_how_long_a_thigh_is() {
    let mut person = Refined::new(Activity::Strolling, true, 1.05, None);
    let segments = [BodySegment::ThighR, BodySegment::ThighL, BodySegment::UpperArmR];
    let before = segments.map(|segment| person.mounting_deg(segment));
    person.run();
    for (segment, (before_deg, said_deg)) in segments.into_iter().zip(before) {
        let (after_deg, sigma_deg) = person.mounting_deg(segment);
        println!(
            "{}: {before_deg:.2} (+-{said_deg:.1}), now {after_deg:.2} (+-{sigma_deg:.1})",
            segment.name()
        );
        assert!(after_deg < 0.7 * before_deg && after_deg < 2.0, "{segment:?}: {before_deg} to {after_deg}");
        assert!(sigma_deg < 0.7 * said_deg && sigma_deg > 0.4 * after_deg, "{segment:?}: {sigma_deg}");
    }
    let truth_m = Build::of_height(1.8).thigh_m * 1.05;
    for segment in [BodySegment::ThighR, BodySegment::ThighL] {
        let [length_m, sigma_m] = person.filter.learnt()[segment.index()].unwrap().length_m.unwrap();
        assert!((length_m / truth_m - 1.0).abs() < 0.02, "{length_m} for {truth_m}");
        assert!(sigma_m < 0.03 * truth_m, "{sigma_m}");
    }
    let learnt = person.filter.learnt();
    assert_eq!(
        learnt[BodySegment::ForearmR.index()].unwrap().length_m,
        None,
        "nothing hangs on it that shows it"
    );
    assert!((person.filter.skeleton().thigh_m / truth_m - 1.0).abs() < 0.02, "the figure has them");
    assert_eq!(learnt[BodySegment::Torso.index()], None);
}

#[test]
fn an_arm_that_hangs_on_nothing_known_is_not_learnt_wrong() {
    let mut person = Refined::new(Activity::Walking, true, 1.0, None);
    let arm = [BodySegment::UpperArmR, BodySegment::ForearmR];
    for (_, samples) in &mut person.recording {
        for segment in BodySegment::ALL.into_iter().filter(|segment| !arm.contains(segment)) {
            samples[segment.index()] = None;
        }
    }
    let mounts = person.filter.mounts();
    let alone = BodySegment::ALL.map(|segment| mounts[segment.index()].filter(|_| arm.contains(&segment)));
    person.filter = BodyFilter::new(&Skeleton::from_height(1.8), &alone, &BodyParams::default());
    let before = arm.map(|segment| person.mounting_deg(segment).0);
    person.run();
    for (segment, before_deg) in arm.into_iter().zip(before) {
        let (after_deg, sigma_deg) = person.mounting_deg(segment);
        println!("{}: {before_deg:.2}, now {after_deg:.2} (+-{sigma_deg:.1})", segment.name());
        assert!(
            after_deg < before_deg + 0.5 && after_deg < sigma_deg,
            "{segment:?}: {before_deg} to {after_deg}"
        );
    }
}

#[test]
fn what_was_given_as_exact_stays() {
    let (mut filter, mut wearer) = running(2);
    let before = filter.mounts();
    let (recording, _) = record(&mut wearer, 10.0);
    for (_, samples) in &recording {
        filter.push(samples, 0.01);
    }
    assert_eq!(filter.mounts(), before);
    assert!(filter.learnt().iter().all(Option::is_none));
}

/// The sensor turns on its segment and is found again by how the limb moves; who does not move it hears that it does not fit.
#[test]
fn a_strap_that_slips_is_found_anew_where_the_limb_moves() {
    let turned = V::new(0.15, 0.5, -0.1);
    for (activity, segment) in
        [(Activity::Walking, BodySegment::ThighR), (Activity::Reaching, BodySegment::UpperArmR)]
    {
        let mut person = Refined::new(activity, false, 1.0, Some((segment, turned)));
        assert!(person.mounting_deg(segment).0 > 25.0);
        let misfit = person.run();
        let (off_deg, sigma_deg) = person.mounting_deg(segment);
        println!(
            "{}: {off_deg:.1} (+-{sigma_deg:.1}), joint {:.1}",
            segment.name(),
            person.joint_deg(segment)
        );
        assert!(off_deg < 4.0 && sigma_deg < 6.0, "{segment:?}: {off_deg} of {sigma_deg}");
        assert!(person.joint_deg(segment) < 5.0, "{segment:?}: {}", person.joint_deg(segment));
        assert_eq!(misfit, 0.0, "{segment:?}");
    }
    let mut person =
        Refined::new(Activity::Curls, false, 1.0, Some((BodySegment::ThighR, V::new(0.4, 0.0, 0.2))));
    let misfit = person.run();
    assert!(person.mounting_deg(BodySegment::ThighR).1 > 30.0, "whose legs stand still shows nothing");
    assert!(misfit > 0.9, "{misfit}");
}

/// Nobody stood in a pose: twenty seconds of a walk, and what the next forty show.
#[test]
fn who_only_walks_is_calibrated_roughly_and_then_better() {
    let walks = Script { activity: Activity::Walking, calibration: false, facing: 0.6, mistake: None };
    let mut wearer = Wearer::new(WearerSpec { clumsiness_rad: 0.03, ..spec(walks, 4) });
    let (recording, _) = record(&mut wearer, 20.0);
    let skeleton = Skeleton::from_height(1.8);
    let walk = [Block { kind: BlockKind::Walk, start_s: 0.0, end_s: 20.0 }];
    let mounts = calibrate(&recording, &walk, &skeleton, &UNKNOWN).unwrap().mounts;
    // Without a block the same, as nobody stands still in the first second.
    assert_eq!(
        calibrate(&recording, &[], &skeleton, &UNKNOWN).unwrap().mounts[0].map(|m| m.sigma_rad),
        mounts[0].map(|m| m.sigma_rad)
    );
    let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
    let off_deg = |filter: &BodyFilter, segment: BodySegment| {
        let mount = filter.mounts()[segment.index()].unwrap();
        let (truth, _) = wearer.mounting(segment.index());
        let off = mount.q_segment_sensor.angle_to(&truth).to_degrees();
        (off, mount.sigma_rad.norm().to_degrees())
    };
    let before: Vec<_> = fifteen().map(|segment| off_deg(&filter, segment)).collect();
    let mut more = wearer.clone();
    for (_, samples) in record(&mut more, 40.0).0 {
        filter.push(&samples, 0.01);
    }
    for (segment, (off, said)) in fifteen().zip(before) {
        let (now, sigma) = off_deg(&filter, segment);
        println!("{}: {off:.1} (+-{said:.1}), now {now:.1} (+-{sigma:.1})", segment.name());
        assert!(off < 1.5 * said && now < 1.5 * sigma, "{segment:?}: {off} of {said}, {now} of {sigma}");
    }
    for segment in [BodySegment::ThighR, BodySegment::ThighL] {
        assert!(off_deg(&filter, segment).0 < 4.0, "{segment:?}");
    }
}

/// Knees that are hardly straightened have their long tail on the other side: where the feet go shows it.
#[test]
fn who_strolls_in_small_laps_is_found_to_face_ahead() {
    for activity in [Activity::Strolling, Activity::Climbing, Activity::Lap] {
        let strolls = Script { activity, calibration: false, facing: 0.6, mistake: None };
        let mut wearer = Wearer::new(WearerSpec { clumsiness_rad: 0.03, ..spec(strolls, 4) });
        let (recording, _) = record(&mut wearer, 20.0);
        let walk = [Block { kind: BlockKind::Walk, start_s: 0.0, end_s: 20.0 }];
        let found = calibrate(&recording, &walk, &Skeleton::from_height(1.8), &UNKNOWN).unwrap();
        for segment in [BodySegment::Pelvis, BodySegment::ThighR, BodySegment::ShankL] {
            let mount = found.mounts[segment.index()].unwrap();
            let off_rad = mount.q_segment_sensor.angle_to(&wearer.mounting(segment.index()).0);
            assert!(off_rad < 0.45, "{activity:?}, {segment:?}: {off_rad}");
        }
    }
}
