//! Whether angles are as uncertain as is said: whole bodies from the simulator.

use posed_simulator::body::{Activity, Wearer, WearerSpec};

use super::block::BlockKind;
use super::calibrate::calibrate;
use super::tests::{FIFTEEN, UNKNOWN, blocks, exactly, fifteen, record, script, spec};
use super::*;

/// How a body's sensors are known to sit.
#[derive(Clone, Copy, PartialEq)]
enum Known {
    Exactly,
    /// By the poses and movements of somebody whose joints are off by so much, standard deviation, rad; calibrated as a guide asks for.
    ByCalibration {
        clumsiness_rad: f64,
        quick: bool,
    },
}

/// Normalised squared error per degree of freedom of every joint, mean over both sides: the angles' error over their covariance.
/// `POSED_SEEDS=8 cargo test --lib -- angles_are_as_sure --nocapture` prints what `docs/body.md` says.
fn joints_nees(
    known: Known,
    activities: &[Activity],
    seeds: u64,
    until_s: f64,
) -> [(BodySegment, f64, f64); 8] {
    let joints = [
        BodySegment::Torso,
        BodySegment::UpperArmR,
        BodySegment::ForearmR,
        BodySegment::ThighR,
        BodySegment::ShankR,
        BodySegment::Head,
        BodySegment::HandR,
        BodySegment::FootR,
    ];
    let mut sums = joints.map(|joint| (joint, 0.0_f64, 0.0_f64));
    for activity in activities {
        for seed in 1..=seeds {
            let clumsiness_rad = match known {
                Known::Exactly => 0.0,
                Known::ByCalibration { clumsiness_rad, .. } => clumsiness_rad,
            };
            let mut wearer = Wearer::new(WearerSpec { clumsiness_rad, ..spec(script(*activity), seed) });
            let skeleton = Skeleton::from_height(1.8);
            let (recording, truth) = record(&mut wearer, until_s);
            let mounts = match known {
                Known::Exactly => exactly(&FIFTEEN, &wearer),
                Known::ByCalibration { quick, .. } => {
                    let mut blocks = blocks(*activity);
                    blocks
                        .retain(|block| !quick || matches!(block.kind, BlockKind::NPose | BlockKind::TPose));
                    calibrate(&recording, &blocks, &skeleton, &UNKNOWN).unwrap().mounts
                }
            };
            let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
            for (k, ((_, samples), truth)) in recording.iter().zip(&truth).enumerate() {
                let estimate = filter.push(samples, 0.01);
                if k < 9600 || k % 10 != 0 {
                    continue;
                }
                let expected = angles(&truth.map(Some));
                for segment in fifteen().filter(|segment| segment.parent().is_some()) {
                    let (n, range) = (independent(segment), of_joint(segment));
                    // Where two axes of a sequence fall together no covariance states what the angles are.
                    if estimate.spread.sigma_rad[range.start..range.start + n]
                        .iter()
                        .any(|sigma| *sigma > 0.3)
                    {
                        continue;
                    }
                    let off: Vec<f64> = (range.start..range.start + n)
                        .map(|k| {
                            posed_geometry::wrapped_rad(
                                estimate.angles_rad[k].unwrap() - expected[k].unwrap(),
                            )
                        })
                        .collect();
                    let upper = &estimate.spread.covariance_rad2[segment.index()];
                    let at = |i: usize, j: usize| upper[i * n + j - i * (i + 1) / 2];
                    let covariance = nalgebra::DMatrix::from_fn(n, n, |i, j| at(i.min(j), i.max(j)));
                    let off = nalgebra::DVector::from_vec(off);
                    let inverse = covariance.try_inverse().unwrap();
                    let right = segment.name().replace("_l", "_r");
                    let joint = joints.iter().position(|joint| joint.name() == right).unwrap();
                    sums[joint].1 += (off.transpose() * inverse * &off)[(0, 0)] / n as f64;
                    sums[joint].2 += 1.0;
                }
            }
        }
    }
    sums.map(|(joint, sum, count)| (joint, sum / count, count))
}

#[test]
fn angles_are_as_sure_as_is_said() {
    let requested: Option<u64> = std::env::var("POSED_SEEDS").ok().map(|seeds| seeds.parse().unwrap());
    let (long, seeds) = (requested.is_some(), requested.unwrap_or(2));
    let activities = [Activity::Walking, Activity::Reaching, Activity::Curls, Activity::Squats];
    let activities = if long { &activities[..] } else { &activities[..2] };
    let nees = joints_nees(Known::Exactly, activities, seeds, if long { 130.0 } else { 102.0 });
    for (joint, nees, count) in nees {
        println!("{}: {nees:.2} of {count}", joint.name());
        // Two draws of what sensors are systematically wrong by are as good as their luck: eight seeds are within 0.5 to 2.
        let limits = if long { 0.5..2.0 } else { 0.25..3.5 };
        assert!(count > 80.0 && limits.contains(&nees), "{joint:?}: {nees}");
    }
}

/// Who stands as people do is measured by a calibration that is wrong by that, and says so.
#[test]
fn angles_of_a_calibrated_body_are_as_sure_as_is_said() {
    let requested: Option<u64> = std::env::var("POSED_SEEDS").ok().map(|seeds| seeds.parse().unwrap());
    let (long, seeds) = (requested.is_some(), requested.unwrap_or(1));
    let activities = [Activity::Reaching, Activity::Walking, Activity::Curls, Activity::Squats];
    for quick in [true, false].into_iter().take(if long { 2 } else { 1 }) {
        let activities = if long { &activities[..] } else { &activities[3..] };
        let known = Known::ByCalibration { clumsiness_rad: 0.03, quick };
        let nees = joints_nees(known, activities, seeds, if long { 130.0 } else { 104.0 });
        for (joint, nees, count) in nees {
            println!("quick {quick}, {}: {nees:.2} of {count}", joint.name());
            // Never more certain than it deserves; how far a few people are off is their luck.
            assert!(count > 40.0 && nees < if long { 2.0 } else { 4.0 }, "{quick} {joint:?}: {nees}");
        }
    }
}
