//! What movements show of how sensors sit and how long segments are, and what becomes of a strap that slips: two tables of `docs/body.md`.

use nalgebra::{UnitQuaternion, Vector3};
use posed_fusion::body::{BodyFilter, BodyParams, BodySegment, Learnt, Skeleton};
use posed_simulator::body::Activity;

use super::{
    Case, HEIGHT_M, Mounting, RATE_HZ, Run, Sensors, emit, mounts, oriented, outcomes, record, recorded,
};

const PEOPLE: u64 = 6;
/// How long the activity goes on before the table looks, and before and after a strap slips, s.
const LONG_S: f64 = 60.0;
const BEFORE_S: f64 = 20.0;
const AFTER_S: f64 = 30.0;
/// A joint that is wrong by less has been put right, degrees.
const RIGHT_DEG: f64 = 6.0;
/// A joint that is wrong by no more standard deviations than this of the mounting is said to be so.
const SAID: f64 = 2.0;
const ACTIVITIES: [Activity; 5] =
    [Activity::Walking, Activity::Strolling, Activity::Reaching, Activity::Curls, Activity::Squats];
/// In the order of the table's columns.
const LIMBS: [[BodySegment; 2]; 4] = [
    [BodySegment::UpperArmR, BodySegment::UpperArmL],
    [BodySegment::ForearmR, BodySegment::ForearmL],
    [BodySegment::ThighR, BodySegment::ThighL],
    [BodySegment::ShankR, BodySegment::ShankL],
];

/// How far a person's thighs and upper arms are from the proportions that the stage file's height gives.
const LONGER: f64 = 1.04;

fn case(activity: Activity, mounting: Mounting, seed: u64) -> Case {
    Case { clumsiness_rad: 0.03, activity_s: LONG_S, seed, longer: LONGER, ..Case::new(activity, mounting) }
}

/// A filter that knows of the sensors what the case does.
fn filter(case: &Case, run: &Run) -> Result<BodyFilter, String> {
    let skeleton = Skeleton::from_height(HEIGHT_M);
    Ok(BodyFilter::new(&skeleton, &mounts(case, run, &skeleton)?, &BodyParams::default()))
}

/// How wrong a mounting is, degrees.
fn off_deg(filter: &BodyFilter, run: &Run, segment: BodySegment) -> f64 {
    let (truth, _) = run.wearer.mounting(segment.index());
    filter.mounts()[segment.index()].map_or(f64::NAN, |m| m.q_segment_sensor.angle_to(&truth).to_degrees())
}

/// `cargo bench --bench body learnt`
pub(super) fn learnt() {
    emit(
        "\n| calibrated by | activity | upper arm | forearm | thigh | shank | thigh's length, % | upper arm's |",
    );
    emit("|---|---|---|---|---|---|---|---|");
    for (name, mounting) in [
        ("two poses", Mounting::Posed),
        ("all of the guide", Mounting::Calibrated),
        ("a walk", Mounting::Walked),
    ] {
        let walks = |activity: &Activity| matches!(activity, Activity::Walking | Activity::Strolling);
        for activity in
            ACTIVITIES.into_iter().filter(|activity| mounting != Mounting::Walked || walks(activity))
        {
            let mut squares = [[0.0; 3]; 4];
            let mut lengths = [[0.0; 2]; 2];
            let mut count = 0.0;
            for seed in 1..=PEOPLE {
                let case = case(activity, mounting, seed);
                let run = record(&case);
                let Ok(mut filter) = filter(&case, &run) else { continue };
                let before = LIMBS.map(|sides| sides.map(|segment| off_deg(&filter, &run, segment)));
                for (_, samples) in &run.recording {
                    filter.push(samples, 1.0 / RATE_HZ);
                }
                let learnt = filter.learnt();
                for (k, sides) in LIMBS.into_iter().enumerate() {
                    for (side, segment) in sides.into_iter().enumerate() {
                        let said =
                            learnt[segment.index()].map_or(f64::NAN, |learnt| learnt.mounting_sigma_rad);
                        let each = [
                            before[k][side],
                            off_deg(&filter, &run, segment),
                            said.to_degrees() * 3_f64.sqrt(),
                        ];
                        for (sum, value) in squares[k].iter_mut().zip(each) {
                            *sum += value * value;
                        }
                    }
                }
                let [upper_arms, _, thighs, _] = LIMBS;
                let lengths_m = [(thighs, run.build.thigh_m), (upper_arms, run.build.upper_arm_m)];
                for (k, (sides, truth_m)) in lengths_m.into_iter().enumerate() {
                    for segment in sides {
                        let Some(Learnt { length_m: Some([length_m, sigma_m]), .. }) =
                            learnt[segment.index()]
                        else {
                            continue;
                        };
                        lengths[k][0] += (100.0 * (length_m / truth_m - 1.0)).powi(2);
                        lengths[k][1] += (100.0 * sigma_m / truth_m).powi(2);
                    }
                }
                count += 2.0;
            }
            let rms = |sum: f64| (sum / count).sqrt();
            let limbs = squares.map(|[before, after, said]| {
                format!("{:.1}, {:.1} ({:.1})", rms(before), rms(after), rms(said))
            });
            let lengths = lengths.map(|[off, said]| format!("{:.1} ({:.1})", rms(off), rms(said)));
            emit(&format!("| {name} | {activity:?} | {} | {} |", limbs.join(" | "), lengths.join(" | ")));
        }
    }
}

/// `cargo bench --bench body slips`
pub(super) fn slips() {
    emit("\n| activity | upper arm | forearm, across | forearm, about itself | thigh | shank |");
    emit("|---|---|---|---|---|---|");
    // Mostly about the segment, as straps slip.
    let turned = Vector3::new(0.15, 0.5, -0.1);
    let across = Vector3::new(0.4, 0.0, 0.2);
    let slips = [
        (BodySegment::UpperArmR, turned),
        (BodySegment::ForearmR, across),
        (BodySegment::ForearmR, Vector3::y() * 0.6),
        (BodySegment::ThighR, turned),
        (BodySegment::ShankR, turned),
    ];
    for activity in ACTIVITIES {
        let cells = slips.map(|(segment, turned)| {
            let mut counts = [0; 3];
            let mut worst_deg: f64 = 0.0;
            for seed in 1..=PEOPLE {
                match slip(activity, seed, segment, turned) {
                    Some(Slip::Right) => counts[0] += 1,
                    Some(Slip::Named) => counts[1] += 1,
                    Some(Slip::Wrong(deg)) => {
                        counts[2] += 1;
                        worst_deg = worst_deg.max(deg);
                    }
                    None => {}
                }
            }
            let [right, named, wrong] = counts;
            let counts = [(right, "right"), (named, "named"), (wrong, "wrong")];
            outcomes(&counts, (wrong > 0).then_some(worst_deg))
        });
        emit(&format!("| {activity:?} | {} |", cells.join(" | ")));
    }
}

/// What became of a strap that slipped.
enum Slip {
    /// The joint is right again.
    Right,
    /// It does not fit, or how it sits is said not to be known.
    Named,
    /// By so much, and nothing is said, degrees.
    Wrong(f64),
}

fn slip(activity: Activity, seed: u64, segment: BodySegment, turned: Vector3<f64>) -> Option<Slip> {
    let case = Case { activity_s: BEFORE_S, ..case(activity, Mounting::Calibrated, seed) };
    let mut run = record(&case);
    let mut filter = filter(&case, &run).ok()?;
    for (_, samples) in &run.recording {
        filter.push(samples, 1.0 / RATE_HZ);
    }
    run.wearer.slip(segment.index(), turned);
    let parent = segment.parent()?;
    let last = ((AFTER_S - 5.0) * RATE_HZ) as usize;
    let (mut square, mut misfits) = (0.0, 0);
    for frame in 0..(AFTER_S * RATE_HZ) as usize {
        let (samples, at) = run.wearer.step();
        let estimate = filter.push(&recorded(&samples, Sensors::Ten), 1.0 / RATE_HZ);
        if frame < last {
            continue;
        }
        misfits += usize::from(estimate.faults.iter().any(Option::is_some));
        let truth = oriented(&at.body, UnitQuaternion::identity());
        let found =
            estimate.orientations[parent.index()]?.inverse() * estimate.orientations[segment.index()]?;
        let expected = truth[parent.index()].inverse() * truth[segment.index()];
        square += found.angle_to(&expected).to_degrees().powi(2) / (5.0 * RATE_HZ);
    }
    // All three axes.
    let said_deg = filter.learnt()[segment.index()]?.mounting_sigma_rad.to_degrees() * 3_f64.sqrt();
    Some(match square.sqrt() {
        off_deg if off_deg < RIGHT_DEG => Slip::Right,
        off_deg if misfits > 0 || off_deg < SAID * said_deg => Slip::Named,
        off_deg => Slip::Wrong(off_deg),
    })
}
