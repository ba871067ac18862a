//! Bodies that wear few sensors: what is known stays as good, what lies between is inferred and says how well.

use nalgebra::{UnitQuaternion, Vector3};
use posed_simulator::body::{Activity, Script, Wearer, WearerSpec};

use super::BodySegment as B;
use super::block::Recorded;
use super::tests::{FIFTEEN, Orientations, exactly, record, spec};
use super::*;

const SUBSETS: [&[BodySegment]; 9] = [
    &[B::Pelvis, B::ShankR, B::ShankL],
    &[B::Pelvis, B::ThighR, B::ThighL],
    &[B::Torso, B::ForearmR, B::ForearmL],
    &[B::Torso, B::UpperArmR, B::UpperArmL],
    &[B::Torso, B::Head],
    &[B::Pelvis, B::FootR, B::FootL],
    &[B::Torso, B::ThighR, B::ThighL, B::ShankR, B::ShankL],
    &[B::Torso, B::Pelvis, B::ThighR, B::ThighL, B::ShankR, B::ShankL],
    &[B::Pelvis, B::Head, B::HandR, B::HandL, B::FootR, B::FootL],
];

fn of<T: Copy>(all: &[Option<T>; SEGMENTS], worn: &[BodySegment]) -> [Option<T>; SEGMENTS] {
    BodySegment::ALL.map(|segment| all[segment.index()].filter(|_| worn.contains(&segment)))
}

fn body(bent: &[(BodySegment, [f64; 3])]) -> Orientations {
    let mut all = [upright(); SEGMENTS];
    for segment in Skeleton::PARENTS_FIRST {
        let Some(parent) = segment.parent() else { continue };
        let angles_deg = bent.iter().find(|(at, _)| *at == segment).map_or([0.0; 3], |(_, angles)| *angles);
        let rotation = joint_rotation(segment, &angles_deg.map(f64::to_radians));
        all[segment.index()] = all[parent.index()] * rotation;
    }
    all
}

fn knee_deg(all: &Orientations, side: usize) -> f64 {
    angles(&all.map(Some))[of_joint([B::ShankR, B::ShankL][side]).start].unwrap().to_degrees()
}

/// A knee bends to where the shank is, not backwards, and turns the thigh with the shank.
#[test]
fn a_thigh_between_hips_and_shank_goes_by_a_hinge() {
    let worn = SUBSETS[0];
    for (thigh_deg, shank_deg) in [(0.0, 60.0), (30.0, 0.0), (0.0, 0.0), (20.0, 90.0)] {
        let truth = body(&[(B::ThighR, [thigh_deg, 0.0, 0.0]), (B::ShankR, [shank_deg, 0.0, 0.0])]);
        let found = completed(&of(&truth.map(Some), worn));
        assert!(knee_deg(&found, 0) > -3.0, "{thigh_deg} {shank_deg}: {}", knee_deg(&found, 0));
        let off_deg = found[B::ThighR.index()].angle_to(&truth[B::ThighR.index()]).to_degrees();
        assert!(off_deg < 30.0, "{thigh_deg} {shank_deg}: {off_deg}");
        // The other leg is left in peace, as far as the balance lets it be.
        let other_deg = found[B::ThighL.index()].angle_to(&truth[B::ThighL.index()]).to_degrees();
        assert!(other_deg < 30.0, "{thigh_deg} {shank_deg}: {other_deg}");
    }
    // The shanks look 20 degrees inwards: so do the thighs.
    let turned = body(&[(B::ThighR, [0.0, 0.0, 20.0]), (B::ThighL, [0.0, 0.0, 20.0])]);
    let found = completed(&of(&turned.map(Some), worn));
    for thigh in [B::ThighR, B::ThighL] {
        assert!(found[thigh.index()].angle_to(&turned[thigh.index()]).to_degrees() < 3.0);
    }
}

#[test]
fn hips_are_found_between_chest_and_thighs() {
    let mut truth = body(&[(B::Torso, [20.0, 0.0, 0.0])]);
    let found = completed(&of(&truth.map(Some), SUBSETS[6]));
    let off_deg = found[B::Pelvis.index()].angle_to(&truth[B::Pelvis.index()]).to_degrees();
    assert!(off_deg < 12.0, "{off_deg}");
    // Wherever somebody looks, it is the same.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.0);
    truth = truth.map(|q| turn * q);
    let turned = completed(&of(&truth.map(Some), SUBSETS[6]));
    for (a, b) in found.iter().zip(&turned) {
        assert!((turn * a).angle_to(b) < 1e-6);
    }
}

/// Left and right are mirror images, whatever is known; nothing known is upright, and nothing is ever not a number.
#[test]
fn any_subset_of_any_posture_is_completed() {
    let mut state = 7_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 31)
    };
    for _ in 0..300 {
        let known: [Option<UnitQuaternion<f64>>; SEGMENTS] = std::array::from_fn(|_| {
            let q = posed_geometry::so3::exp(&(Vector3::from_fn(|_, _| random() - 0.5) * 6.0));
            (random() < 0.3).then_some(q)
        });
        if known.iter().all(Option::is_none) {
            continue;
        }
        let inference = Inference::of(&known);
        for (k, q) in inference.orientations.iter().enumerate() {
            assert!((q.norm() - 1.0).abs() < 1e-9, "{q}");
            assert!(known[k].is_none_or(|known| known == *q));
            let variance = inference.rotations_rad2[k].trace();
            assert!(variance.is_finite() && (known[k].is_some() == (variance == 0.0)), "{k} {variance}");
        }
    }
    let nothing = Inference::of(&[None; SEGMENTS]);
    assert_eq!(nothing.orientations, [upright(); SEGMENTS]);
    let mirrored = |all: &Orientations| {
        BodySegment::ALL.map(|segment| {
            let q = all[segment.mirrored().index()];
            // The plane of symmetry is across the room's y, and the segment's z.
            let m = q.to_rotation_matrix().into_inner();
            let (room, own) = (Vector3::new(1.0, -1.0, 1.0), Vector3::new(1.0, 1.0, -1.0));
            let m = nalgebra::Matrix3::from_fn(|i, j| m[(i, j)] * room[i] * own[j]);
            UnitQuaternion::from_matrix(&m)
        })
    };
    let one = body(&[
        (B::UpperArmR, [1.0, 60.0, 0.0]),
        (B::ForearmR, [70.0, 20.0, 0.0]),
        (B::ThighL, [40.0, 5.0, 9.0]),
    ]);
    for worn in SUBSETS {
        let found = completed(&of(&one.map(Some), worn));
        let other = completed(&of(&mirrored(&one).map(Some), worn));
        for (a, b) in mirrored(&found).iter().zip(&other) {
            assert!(a.angle_to(b) < 1e-3, "{worn:?} {}", a.angle_to(b));
        }
    }
}

/// Mean square error of every segment, rad², and of the inferred ones' epochs those within two of their sigmas, and all.
fn followed(
    worn: &[BodySegment],
    mounts: &[Option<SensorMount>; SEGMENTS],
    recording: &[Recorded],
    truth: &[Orientations],
) -> ([f64; SEGMENTS], [f64; 2]) {
    const FROM: usize = 250;
    let mut filter = BodyFilter::new(&Skeleton::from_height(1.8), &of(mounts, worn), &BodyParams::default());
    let (mut squares, mut within) = ([0.0; SEGMENTS], [0.0; 2]);
    for (at, ((_, samples), truth)) in recording.iter().zip(truth).enumerate() {
        let estimate = filter.push(samples, 0.02);
        if at < FROM {
            continue;
        }
        for segment in BodySegment::ALL {
            let k = segment.index();
            let off = estimate.posture[k].angle_to(&truth[k]);
            squares[k] += off * off / (recording.len() - FROM) as f64;
            if is_between(segment, worn) && !worn.contains(&segment) {
                // Sigma is about one of three axes.
                within[0] += f64::from(off < 2.0 * 3_f64.sqrt() * estimate.sigma_rad[k]);
                within[1] += 1.0;
            }
            let angle = of_joint(segment).start;
            let is_known = segment.parent().is_some() && estimate.angles_rad[angle].is_some();
            assert!(!is_known || estimate.spread.sigma_rad[angle] > 1e-3, "{worn:?} {segment:?}");
        }
    }
    (squares, within)
}

/// Known segments are as good as with all sensors; what is inferred is within two of its sigmas in 95 of 100 epochs.
#[test]
fn a_body_of_few_sensors_knows_how_little_it_knows() {
    // `cargo bench --bench body few` has more of them, and for longer.
    let subsets = [SUBSETS[0], SUBSETS[1], SUBSETS[2], SUBSETS[6]];
    let mut within = [[0.0; 2]; 4];
    for activity in
        [Activity::Walking, Activity::Strolling, Activity::Reaching, Activity::Curls, Activity::Squats]
    {
        let script = Script { activity, calibration: false, facing: 0.6, mistake: None };
        let mut wearer = Wearer::new(WearerSpec { rate_hz: 50.0, ..spec(script, 4) });
        let mounts = exactly(&FIFTEEN, &wearer);
        let (recording, truth) = record(&mut wearer, 12.0);
        let (with_all, _) =
            followed(&BodySegment::ALL[..BodySegment::BEFORE_SHOULDERS], &mounts, &recording, &truth);
        for (worn, within) in subsets.into_iter().zip(&mut within) {
            let (found, [inside, all]) = followed(worn, &mounts, &recording, &truth);
            for k in worn.iter().map(|segment| segment.index()) {
                let [found_deg, best_deg] = [found[k], with_all[k]].map(|square| square.sqrt().to_degrees());
                assert!(found_deg < best_deg + 3.0, "{activity:?} {worn:?} {k} {found_deg} {best_deg}");
            }
            within[0] += inside;
            within[1] += all;
        }
    }
    for (worn, [inside, all]) in subsets.into_iter().zip(within) {
        assert!(inside / all > 0.95, "{worn:?} {:.3}", inside / all);
    }
}

/// Trunk, or a segment of a limb of which a sensor is worn.
fn is_between(segment: BodySegment, worn: &[BodySegment]) -> bool {
    let limbs = [B::ARMS, B::LEGS];
    let mut limbs = limbs.into_iter().filter(|limb| limb.contains(&segment));
    limbs.all(|limb| worn.iter().any(|of| of.side() == segment.side() && limb.contains(of)))
}

/// Whoever wears them is asked only for what these need, and the mountings are found.
#[test]
fn few_sensors_are_calibrated() {
    let skeleton = Skeleton::from_height(1.8);
    for (magnetic, how) in
        [(true, Thoroughness::Quick), (true, Thoroughness::Full), (false, Thoroughness::Full)]
    {
        let activity = Activity::Bends;
        let script = Script { activity, calibration: false, facing: 0.6, mistake: None };
        let mut wearer = Wearer::new(WearerSpec { magnetometer: magnetic, rate_hz: 50.0, ..spec(script, 3) });
        let (recording, _) = record(&mut wearer, 260.0);
        // Who is asked for an ankle, and bends knees on the way, is misunderstood where no shank wears a sensor.
        for worn in SUBSETS.into_iter().filter(|worn| magnetic || !worn.contains(&B::FootR)) {
            let present = BodySegment::ALL.map(|segment| worn.contains(&segment));
            let mut guide = Guide::new(present, magnetic, how);
            for (t_s, samples) in &recording {
                guide.push(*t_s, &of(samples, worn));
            }
            assert_eq!(guide.prompt(), None, "{worn:?} {magnetic} {how:?}");
            let (recorded, blocks) = guide.recorded();
            for block in blocks {
                assert!(
                    !matches!(block.kind, BlockKind::Move(of, _) if !worn.contains(&of)),
                    "{worn:?} {block:?}"
                );
            }
            let found = calibrate(recorded, blocks, &skeleton, &[None; SEGMENTS]);
            let found = found.unwrap_or_else(|error| panic!("{worn:?} {magnetic} {how:?} {error}"));
            for segment in worn {
                let mount: SensorMount = found.mounts[segment.index()].unwrap();
                let off_deg =
                    mount.q_segment_sensor.angle_to(&wearer.mounting(segment.index()).0).to_degrees();
                assert!(off_deg < 6.0, "{worn:?} {magnetic} {how:?} {segment:?} {off_deg}");
            }
        }
    }
}
