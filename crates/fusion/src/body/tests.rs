//! The table by hand, then whole bodies from the simulator, which shares no code with the filters.

use nalgebra::{UnitQuaternion, Vector3};
use posed_simulator::body::{Activity, Build, Sample, Script, SensorErrors, Wearer, WearerSpec};

use super::block::{Block, BlockKind, Recorded};
use super::calibrate::{CalibrationError, calibrate};
use super::*;

type V = Vector3<f64>;

fn index(name: &str) -> usize {
    ANGLE_NAMES.iter().position(|known| *known == name).unwrap()
}

/// Segment orientations from named angles.
fn posture(words: &str) -> [UnitQuaternion<f64>; SEGMENTS] {
    let mut values = [0.0; ANGLES];
    for word in words.split_whitespace() {
        let (name, degrees) = word.split_once('=').unwrap();
        values[index(name)] = degrees.parse::<f64>().unwrap().to_radians();
    }
    let mut all = [upright(); SEGMENTS];
    for segment in Skeleton::PARENTS_FIRST {
        if let Some(parent) = segment.parent() {
            all[segment.index()] = all[parent.index()] * joint_rotation(segment, &values[of_joint(segment)]);
        }
    }
    all
}

fn lines() -> impl Iterator<Item = Vec<&'static str>> {
    let text = include_str!("../../../../docs/body-poses.csv");
    text.lines().filter(|line| !line.starts_with('#')).skip(1).map(|line| line.split(',').collect())
}

#[test]
fn segments_stand_as_in_the_poses_by_hand() {
    for cells in lines() {
        let body = posture(cells[1]);
        let q = body[BodySegment::named(cells[2]).unwrap().index()];
        let vector = |at: usize| V::from_fn(|i, _| cells[at + i].parse().unwrap());
        assert!((q * V::x() - vector(3)).norm() < 1e-12, "{cells:?}");
        assert!((q * V::y() - vector(6)).norm() < 1e-12, "{cells:?}");
    }
}

#[test]
fn angles_come_back_from_the_poses_by_hand() {
    for cells in lines() {
        let found = angles(&posture(cells[1]).map(Some));
        for word in cells[1].split_whitespace() {
            let (name, degrees) = word.split_once('=').unwrap();
            let off = found[index(name)].unwrap().to_degrees() - degrees.parse::<f64>().unwrap();
            assert!(off.abs() < 1e-9, "{name} of {cells:?}: {off}");
        }
    }
}

#[test]
fn kinds_of_calibration_are_found_by_their_names() {
    for name in ["n_pose", "t_pose", "bow", "elbow_pronation_l", "hip_rotation_r", "shrug_l"] {
        assert_eq!(BlockKind::named(name).unwrap().name(), name);
    }
    assert_eq!(BlockKind::named("knee_pronation_r"), None);
}

#[test]
fn joints_sit_where_the_lengths_say() {
    let skeleton = Skeleton::from_height(2.0);
    let body = posture("elbow_r_flexion=90 knee_l_flexion=90 spine_flexion=90");
    let origins = skeleton.origins_m(&body, V::new(0.0, 0.0, 1.0));
    // Bent forward by 90 degrees the trunk points along x; arms hang parallel to it, backwards.
    let shoulder = V::new(0.576, -0.258, 1.0);
    assert!((origins[BodySegment::Torso.index()] - V::new(0.288, 0.0, 1.0)).norm() < 1e-12);
    assert!((origins[BodySegment::UpperArmR.index()] - shoulder).norm() < 1e-12);
    assert!((origins[BodySegment::ForearmR.index()] - (shoulder - V::x() * 0.372)).norm() < 1e-12);
    assert!((origins[BodySegment::ShankL.index()] - V::new(0.0, 0.1, 1.0 - 0.49)).norm() < 1e-12);
    // It stands on the right ankle, the lower one.
    let standing = skeleton.standing_m(&body);
    assert!((standing.z - (0.078 + 0.49 + 0.492)).abs() < 1e-12);
}

fn wearer(activity: Activity, magnetometer: bool, seed: u64) -> Wearer {
    wearer_of(script(activity), magnetometer, seed)
}

pub(super) fn wearer_of(script: Script, magnetometer: bool, seed: u64) -> Wearer {
    Wearer::new(WearerSpec { magnetometer, ..spec(script, seed) })
}

/// Somebody of 1.8 m who stands exactly straight, with calibrated sensors at 100 Hz in a field.
pub(super) fn spec(script: Script, seed: u64) -> WearerSpec {
    WearerSpec {
        script,
        build: Build::of_height(1.8),
        errors: SensorErrors::calibrated(),
        magnetometer: true,
        disturbances: Vec::new(),
        rate_hz: 100.0,
        clumsiness_rad: 0.0,
        seed,
    }
}

pub(super) fn script(activity: Activity) -> Script {
    Script { activity, calibration: true, facing: 0.6, mistake: None }
}

pub(super) type Orientations = [UnitQuaternion<f64>; SEGMENTS];

/// Which segments wear a sensor where nothing else is said: all but the shoulders.
pub(super) const FIFTEEN: [bool; SEGMENTS] = {
    let mut worn = [true; SEGMENTS];
    worn[BodySegment::ShoulderR as usize] = false;
    worn[BodySegment::ShoulderL as usize] = false;
    worn
};

/// These segments.
pub(super) fn fifteen() -> impl Iterator<Item = BodySegment> {
    BodySegment::ALL.into_iter().take(BodySegment::BEFORE_SHOULDERS)
}

pub(super) fn record(wearer: &mut Wearer, seconds: f64) -> (Vec<Recorded>, Vec<Orientations>) {
    record_of(&FIFTEEN, wearer, seconds)
}

/// What the sensors on these segments measure.
pub(super) fn record_of(
    present: &[bool; SEGMENTS],
    wearer: &mut Wearer,
    seconds: f64,
) -> (Vec<Recorded>, Vec<Orientations>) {
    (0..(seconds * wearer.rate_hz()) as usize)
        .map(|_| {
            let (samples, truth) = wearer.step();
            ((truth.t_s, worn_of(present, samples)), truth.body.map(|p| p.orientation()))
        })
        .unzip()
}

/// What fifteen sensors measure, for the filter.
pub(super) fn worn(samples: [Sample; SEGMENTS]) -> BodySamples {
    worn_of(&FIFTEEN, samples)
}

pub(super) fn worn_of(present: &[bool; SEGMENTS], samples: [Sample; SEGMENTS]) -> BodySamples {
    BodySegment::ALL.map(|segment| {
        let Sample { gyro_rad_s, accel_m_s2, mag_ut } = samples[segment.index()];
        present[segment.index()].then_some(ImuSample { gyro_rad_s, accel_m_s2, mag: mag_ut })
    })
}

/// How the sensors on these segments sit.
pub(super) fn exactly(present: &[bool; SEGMENTS], wearer: &Wearer) -> [Option<SensorMount>; SEGMENTS] {
    BodySegment::ALL.map(|segment| {
        let (q_segment_sensor, offset_m) = wearer.mounting(segment.index());
        present[segment.index()].then(|| SensorMount::exact(q_segment_sensor, offset_m))
    })
}

pub(super) fn blocks(activity: Activity) -> Vec<Block> {
    let spans = script(activity).blocks().into_iter();
    spans
        .map(|b| Block { kind: BlockKind::named(b.kind).unwrap(), start_s: b.start_s, end_s: b.end_s })
        .collect()
}

/// Root mean square of the difference of an angle after `from_s`, degrees.
fn rms(
    recording: &[Recorded],
    truth: &[Orientations],
    filter: &mut BodyFilter,
    from_s: f64,
    name: &str,
) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for ((t_s, samples), truth) in recording.iter().zip(truth) {
        let estimate = filter.push(samples, 0.01);
        if *t_s >= from_s {
            let off =
                estimate.angles_rad[index(name)].unwrap() - angles(&truth.map(Some))[index(name)].unwrap();
            sum += off * off;
            count += 1.0;
        }
    }
    f64::sqrt(sum / count).to_degrees()
}

pub(super) const UNKNOWN: [Option<V>; SEGMENTS] = [None; SEGMENTS];

#[test]
fn a_body_is_calibrated_and_followed() {
    for (activity, magnetometer, name, limit) in
        [(Activity::Walking, true, "knee_r_flexion", 2.0), (Activity::Squats, false, "knee_l_flexion", 2.0)]
    {
        let mut wearer = wearer(activity, magnetometer, 7);
        let begin_s = script(activity).activity_s();
        let (mut recording, truth) = record(&mut wearer, begin_s + 15.0);
        // Without magnetometers each of them needs a movement that this script does not have.
        let worn = BodySegment::ALL
            .map(|s| if magnetometer { FIFTEEN[s.index()] } else { !BodySegment::LEAVES.contains(&s) });
        for (_, samples) in &mut recording {
            samples.iter_mut().zip(worn).filter(|(_, worn)| !worn).for_each(|(sample, _)| *sample = None);
        }
        let skeleton = Skeleton::from_height(1.8);
        let found = calibrate(&recording, &blocks(activity), &skeleton, &UNKNOWN).unwrap();
        for segment in BodySegment::ALL.into_iter().filter(|segment| worn[segment.index()]) {
            let off = found.mounts[segment.index()]
                .unwrap()
                .q_segment_sensor
                .angle_to(&wearer.mounting(segment.index()).0)
                .to_degrees();
            assert!(off < 3.0, "{activity:?}: {} is {off} degrees off", segment.name());
        }
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        let mut filter = BodyFilter::new(&skeleton, &found.mounts, &BodyParams::default());
        let off = rms(&recording, &truth, &mut filter, begin_s, name);
        assert!(off < limit, "{activity:?}: {name} {off} degrees");
        let field = matches!(filter.estimate().heading, Heading::Field);
        assert_eq!(field, magnetometer, "{:?}", filter.estimate().heading);
    }
}

#[test]
fn what_a_calibration_lacks_is_named() {
    let mut wearer = wearer(Activity::Curls, true, 3);
    let (recording, _) = record(&mut wearer, 20.0);
    let skeleton = Skeleton::from_height(1.8);
    let all = blocks(Activity::Curls);
    let solve = |blocks: &[Block]| calibrate(&recording, blocks, &skeleton, &UNKNOWN);
    let error = solve(&all[..1]).unwrap_err();
    assert!(matches!(error, CalibrationError::Facing { of: "the body", .. }), "{error}");
    let error = solve(&all[2..3]).unwrap_err();
    assert_eq!(error, CalibrationError::NoPose);
    // A pose that was none.
    let moving = Block { start_s: all[2].start_s, end_s: all[2].end_s, ..all[0] };
    let error = solve(&[moving, all[1]]).unwrap_err();
    assert!(error.to_string().contains("forearm_r moved: stand still"), "{error}");
    // A movement that was none.
    let still = Block { start_s: 0.2, end_s: 3.0, ..all[2] };
    let error = solve(&[all[0], still]).unwrap_err();
    assert!(
        error.to_string().starts_with("elbow_flexion_r from 0.2 to 3 s: the movement shows too little"),
        "{error}"
    );
    assert_eq!(calibrate(&[], &all, &skeleton, &UNKNOWN).unwrap_err(), CalibrationError::Empty);
}

/// Somebody who reaches, and a filter that knows how the sensors sit but has seen nothing.
fn reaching(seed: u64) -> (BodyFilter, Wearer) {
    mounted(Activity::Reaching, seed)
}

/// A person who begins with that, and a filter that knows how the sensors sit.
pub(super) fn mounted(activity: Activity, seed: u64) -> (BodyFilter, Wearer) {
    let wearer = wearer_of(Script { activity, calibration: false, facing: 0.6, mistake: None }, true, seed);
    let mounts = exactly(&FIFTEEN, &wearer);
    (BodyFilter::new(&Skeleton::from_height(1.8), &mounts, &BodyParams::default()), wearer)
}

/// A body in the middle of its activity, perfectly mounted.
pub(super) fn running(seed: u64) -> (BodyFilter, Wearer) {
    let (mut filter, mut wearer) = reaching(seed);
    let (recording, _) = record(&mut wearer, 8.0);
    for (_, samples) in &recording {
        filter.push(samples, 0.01);
    }
    (filter, wearer)
}

#[test]
fn every_fault_is_named_within_a_second_and_the_rest_goes_on() {
    type Spoil = fn(&mut BodySamples, usize);
    let cases: [(BodySegment, Spoil, Cause); 5] = [
        (BodySegment::ForearmR, |s, i| s[i] = None, Cause::Missing),
        (
            BodySegment::ThighL,
            |s, i| s[i] = s[i].map(|s| ImuSample { accel_m_s2: V::repeat(f64::NAN), ..s }),
            Cause::NotFinite,
        ),
        (
            BodySegment::Torso,
            |s, i| {
                s[i] = s[i].map(|_| ImuSample {
                    gyro_rad_s: V::x(),
                    accel_m_s2: V::z() * GRAVITY_M_S2,
                    mag: None,
                })
            },
            Cause::Stuck,
        ),
        (
            BodySegment::ShankR,
            |s, i| s[i] = s[i].map(|s| ImuSample { accel_m_s2: V::new(156.9, 0.0, s.accel_m_s2.z), ..s }),
            Cause::Saturated,
        ),
        (BodySegment::ForearmL, |s, i| s.swap(i, BodySegment::UpperArmL.index()), Cause::Misfit),
    ];
    let (filter, wearer) = running(11);
    assert_eq!(filter.estimate().faults, [None; SEGMENTS]);
    for (segment, spoil, expected) in cases {
        let (mut filter, mut wearer) = (filter.clone(), wearer.clone());
        let (recording, truth) = record(&mut wearer, 1.0);
        for (_, samples) in &recording {
            let mut samples = *samples;
            spoil(&mut samples, segment.index());
            filter.push(&samples, 0.01);
        }
        let estimate = filter.estimate();
        let named = match expected {
            // Which of the two is wrong cannot be said.
            Cause::Misfit => estimate.faults.contains(&Some(Cause::Misfit)),
            _ => estimate.faults[segment.index()] == Some(expected),
        };
        assert!(named, "{segment:?}: {:?}", estimate.faults);
        // The leg on the other side, which hangs on nothing that was spoiled, moves on.
        let other = if segment.side() < 0.0 { "knee_r_flexion" } else { "knee_l_flexion" };
        let expected = angles(&truth.last().unwrap().map(Some))[index(other)].unwrap();
        let off = (estimate.angles_rad[index(other)].unwrap() - expected).to_degrees();
        assert!(off.abs() < 3.0, "{segment:?}: {other} {off} degrees");
    }
}

#[test]
fn a_strap_that_slips_is_named() {
    let (mut filter, mut wearer) = running(5);
    wearer.slip(BodySegment::ForearmR.index(), V::new(0.9, 0.0, 0.0));
    let (recording, _) = record(&mut wearer, 1.0);
    for (_, samples) in &recording {
        filter.push(samples, 0.01);
    }
    let faults = filter.estimate().faults;
    let arm = [BodySegment::UpperArmR, BodySegment::ForearmR].map(|s| faults[s.index()]);
    assert!(arm.contains(&Some(Cause::Misfit)), "{faults:?}");
}

#[test]
fn who_begins_or_comes_back_in_the_middle_of_a_movement_is_no_misfit() {
    for seed in 1..=8 {
        let (fresh, mut wearer) = reaching(seed);
        let (recording, _) = record(&mut wearer, 12.0);
        // A whole chain is away for a third of a second, one arm for longer; and everything begins anywhere.
        for begin in [150, 290, 410] {
            let mut filter = fresh.clone();
            for (tick, (_, samples)) in recording.iter().enumerate().skip(begin) {
                let mut samples = *samples;
                let since = tick - begin;
                if (200..235).contains(&since) {
                    samples = BodySamples::default();
                }
                if (300..345).contains(&since) {
                    samples[BodySegment::UpperArmR.index()] = None;
                }
                filter.push(&samples, 0.01);
                let misfit = filter.estimate().faults.contains(&Some(Cause::Misfit));
                assert!(!misfit, "seed {seed}: begun at {begin}, {since} samples later");
            }
        }
    }
}

/// Of those that wear sensors in these tests.
fn shown(estimate: &BodyEstimate) -> impl Iterator<Item = &Option<UnitQuaternion<f64>>> {
    estimate.orientations.iter().take(BodySegment::BEFORE_SHOULDERS)
}

#[test]
fn a_blow_as_sensors_are_switched_on_tilts_nothing() {
    let (mut filter, mut wearer) = reaching(3);
    let mut worst_deg: f64 = 0.0;
    for frame in 0..1500 {
        let (samples, truth) = wearer.step();
        let mut samples = worn(samples);
        for sample in samples.iter_mut().skip(2).flatten().filter(|_| frame < 3) {
            sample.accel_m_s2 += V::new(-300.0, 2000.0, 900.0);
        }
        let estimate = filter.push(&samples, 0.01);
        for (found, truth) in shown(estimate).zip(&truth.body).filter(|_| frame > 500) {
            let truth = truth.orientation();
            worst_deg = worst_deg.max(found.unwrap().angle_to(&truth).to_degrees());
        }
    }
    assert!(worst_deg < 12.0, "{worst_deg}");
}

/// Switched on while somebody walks or curls: no sensor keeps a heading of chance, and nobody hears of a strap.
#[test]
fn who_is_switched_on_in_the_middle_of_a_movement_finds_back() {
    for (activity, seeds) in [(Activity::Strolling, 0..6), (Activity::Walking, 0..6), (Activity::Curls, 0..4)]
    {
        for seed in seeds {
            let (mut filter, mut wearer) = mounted(activity, seed);
            filter.await_field();
            record(&mut wearer, 5.0 + 0.07 * seed as f64);
            for _ in 0..800 {
                filter.push(&worn(wearer.step().0), 0.01);
            }
            for _ in 0..300 {
                let (samples, truth) = wearer.step();
                let estimate = filter.push(&worn(samples), 0.01);
                assert_eq!(estimate.faults, [None; SEGMENTS], "{activity:?} {seed}");
                for (found, truth) in shown(estimate).zip(&truth.body) {
                    let off_rad = found.unwrap().angle_to(&truth.orientation());
                    assert!(off_rad.to_degrees() < 12.0, "{activity:?} {seed}: {off_rad}");
                }
            }
        }
    }
}

#[test]
fn a_body_goes_on_from_its_serialised_state() {
    let (filter, mut wearer) = running(2);
    let (mut restored, _) = running(3);
    posed_state::restore(&mut restored, &posed_state::snapshot(&filter)).unwrap();
    let mut filter = filter;
    let (recording, _) = record(&mut wearer, 0.5);
    for (_, samples) in &recording {
        assert_eq!(filter.push(samples, 0.01), restored.push(samples, 0.01));
    }
}

/// Trackers on some segments of a body that moves, and what the rest of it does.
#[test]
fn trackers_alone_show_the_limbs_between_them() {
    use nalgebra::{Isometry3, Translation3};
    let skeleton = Skeleton::from_height(1.8);
    let mut follower = Follower::new(skeleton);
    let mounts = [
        BodySegment::Torso,
        BodySegment::Pelvis,
        BodySegment::ForearmR,
        BodySegment::ForearmL,
        BodySegment::ShankR,
        BodySegment::ShankL,
    ];
    let segment_from_sensor = Isometry3::from_parts(
        Translation3::new(0.03, -0.1, 0.02),
        UnitQuaternion::from_euler_angles(0.4, -0.8, 1.9),
    );
    let script = Script { activity: Activity::Squats, calibration: false, facing: 2.5, mistake: None };
    let build = Build::of_height(1.8);
    let (mut worst_m, mut worst_rad) = (0.0_f64, 0.0_f64);
    for k in 0..200 {
        let t_s = 0.02 * f64::from(k);
        let truth = script.at(t_s, &build).place(&build);
        let orientation = |segment: BodySegment| truth[segment.index()].orientation();
        let trackers = mounts.map(|segment| {
            let translation = Translation3::from(truth[segment.index()].origin_m);
            let room_from_segment = Isometry3::from_parts(translation, orientation(segment));
            Tracked {
                segment,
                room_from_sensor: room_from_segment * segment_from_sensor,
                segment_from_sensor,
            }
        });
        let figure = follower.push(&trackers).unwrap();
        if k < 20 {
            continue;
        }
        let origins = skeleton.origins_m(&figure.orientations, figure.pelvis_m);
        for segment in BodySegment::ALL {
            let off_m = (origins[segment.index()] - truth[segment.index()].origin_m).norm();
            worst_m = worst_m.max(off_m);
            // Feet stand on the floor, which no tracker on them shows.
            if !matches!(segment, BodySegment::FootR | BodySegment::FootL) {
                let off_rad = figure.orientations[segment.index()].angle_to(&orientation(segment));
                worst_rad = worst_rad.max(off_rad);
            }
        }
        let knee = inverse::hinge_angle(&figure, BodySegment::ShankR);
        let above = orientation(BodySegment::ThighR).inverse() * orientation(BodySegment::ShankR);
        assert!((knee - joint_angles(BodySegment::ShankR, &above)[0]).abs() < 0.05, "knee at {t_s} s");
    }
    assert!(worst_m < 0.01, "{worst_m} m");
    assert!(worst_rad < 0.06, "{} degrees", worst_rad.to_degrees());
    assert!(follower.push(&[]).is_none());
}

/// Gyros drift; who stands and looks ahead takes it away.
#[test]
fn headings_begin_anew_from_who_looks_ahead() {
    let script = Script { activity: Activity::Poses, calibration: false, facing: 0.6, mistake: None };
    let mut wearer = wearer_of(script, false, 4);
    let mut mounts = exactly(&FIFTEEN, &wearer);
    for (index, mount) in mounts.iter_mut().enumerate() {
        *mount = mount.map(|mount| SensorMount { heading_rad: Some(0.4 * index as f64), ..mount });
    }
    let mut filter = BodyFilter::new(&Skeleton::from_height(1.8), &mounts, &BodyParams::default());
    let mut worst_deg = |filter: &mut BodyFilter, seconds: f64| {
        let (recording, truth) = record(&mut wearer, seconds);
        recording.iter().for_each(|(_, samples)| _ = filter.push(samples, 0.01));
        let (found, truth) = (filter.estimate().orientations, truth.last().unwrap());
        let off = |segment: BodySegment| {
            found[segment.index()].unwrap().angle_to(&truth[segment.index()]).to_degrees()
        };
        fifteen().map(off).fold(0.0, f64::max)
    };
    assert!(worst_deg(&mut filter, 1.0) > 30.0);
    assert!(filter.reset_heading(&[true; SEGMENTS], 0.6));
    let off_deg = worst_deg(&mut filter, 0.5);
    assert!(off_deg < 4.0, "{off_deg}");
    // One alone, on no limb and on one: the others go on as they were.
    for segment in [BodySegment::Head, BodySegment::ThighR] {
        let turned = UnitQuaternion::from_axis_angle(&V::z_axis(), 0.7);
        let sensor = filter.sensors[segment.index()].as_mut().unwrap();
        sensor.heading = turned * sensor.heading;
        let mut only = [false; SEGMENTS];
        only[segment.index()] = true;
        assert!(filter.reset_heading(&only, 0.6));
        let off_deg = worst_deg(&mut filter, 0.2);
        assert!(off_deg < 4.0, "{segment:?} {off_deg}");
    }
    // Where a field tells it nobody has to.
    let (mut filter, mut wearer) = mounted(Activity::Poses, 4);
    record(&mut wearer, 0.5).0.iter().for_each(|(_, samples)| _ = filter.push(samples, 0.01));
    assert!(!filter.reset_heading(&[true; SEGMENTS], 0.0) && !filter.drifts(BodySegment::Torso));
}

/// As people wear who play in virtual reality.
#[test]
fn head_hands_and_feet_are_turned_as_their_trackers() {
    use nalgebra::Isometry3;
    let skeleton = Skeleton::from_height(1.8);
    let body = posture(
        "spine_flexion=20 neck_rotation=30 elbow_r_flexion=70 wrist_r_flexion=40 \
         hip_l_flexion=40 knee_l_flexion=60 ankle_l_flexion=15",
    );
    let pelvis_m = V::new(0.4, -0.3, 1.0);
    let origins = skeleton.origins_m(&body, pelvis_m);
    let worn = [BodySegment::Pelvis].into_iter().chain(BodySegment::EXTREMITIES);
    let trackers: Vec<_> = worn
        .map(|segment| Tracked {
            segment,
            room_from_sensor: Isometry3::from_parts(origins[segment.index()].into(), body[segment.index()]),
            segment_from_sensor: Isometry3::identity(),
        })
        .collect();
    let mut follower = Follower::new(skeleton);
    let figure = (0..20).filter_map(|_| follower.push(&trackers)).last().unwrap();
    let found = skeleton.origins_m(&figure.orientations, figure.pelvis_m);
    for segment in BodySegment::EXTREMITIES {
        let off_rad = figure.orientations[segment.index()].angle_to(&body[segment.index()]);
        let off_m = (found[segment.index()] - origins[segment.index()]).norm();
        assert!(off_rad < 1e-6 && off_m < 0.01, "{segment:?} {off_rad} {off_m}");
    }
    // Without its tracker a hand goes with the forearm.
    let hand = BodySegment::HandR;
    let without: Vec<_> = trackers.iter().filter(|tracker| tracker.segment != hand).copied().collect();
    let on = figure.orientations[BodySegment::ForearmR.index()].inverse() * figure.orientations[hand.index()];
    let figure = follower.push(&without).unwrap();
    let off = on.angle_to(
        &(figure.orientations[BodySegment::ForearmR.index()].inverse() * figure.orientations[hand.index()]),
    );
    assert!(off < 1e-9, "{off}");
}
