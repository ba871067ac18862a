//! What is inferred between few sensors: a table of `docs/body.md`.

use posed_fusion::body::{BodyFilter, BodyParams, BodySegment, SEGMENTS, Skeleton};
use posed_simulator::body::Activity;

use super::{Case, HEIGHT_M, Mounting, RATE_HZ, SETTLE_S, Sensors, emit, mounts, record};

use BodySegment as B;

const ACTIVITIES: [Activity; 5] =
    [Activity::Walking, Activity::Strolling, Activity::Reaching, Activity::Curls, Activity::Squats];
const SHOWN_S: f64 = 30.0;
/// Who wears which sensors.
const SUBSETS: [(&str, &[BodySegment]); 9] = [
    ("hips and shanks", &[B::Pelvis, B::ShankR, B::ShankL]),
    ("hips and thighs", &[B::Pelvis, B::ThighR, B::ThighL]),
    ("chest and wrists", &[B::Torso, B::ForearmR, B::ForearmL]),
    ("chest and upper arms", &[B::Torso, B::UpperArmR, B::UpperArmL]),
    ("chest and head", &[B::Torso, B::Head]),
    ("five: no hips", &[B::Torso, B::ThighR, B::ThighL, B::ShankR, B::ShankL]),
    ("six", &[B::Torso, B::Pelvis, B::ThighR, B::ThighL, B::ShankR, B::ShankL]),
    ("hips, head, wrists and shanks", &[B::Pelvis, B::Head, B::ForearmR, B::ForearmL, B::ShankR, B::ShankL]),
    (
        "ten, no chest",
        &[
            B::Pelvis,
            B::Head,
            B::UpperArmR,
            B::ForearmR,
            B::ThighR,
            B::ShankR,
            B::UpperArmL,
            B::ForearmL,
            B::ThighL,
            B::ShankL,
        ],
    ),
];

/// Sums over time of a segment's squared error, of the squared sigma that is stated, and of the errors within two of it.
#[derive(Clone, Copy, Default)]
struct Sums {
    square: f64,
    said: f64,
    within: f64,
    count: f64,
}

/// `cargo bench --bench body few`
pub(super) fn few() {
    emit("\n| sensors | activity | worn | trunk | thighs | shanks | upper arms | forearms |");
    emit("|---|---|---|---|---|---|---|---|");
    let skeleton = Skeleton::from_height(HEIGHT_M);
    for activity in ACTIVITIES {
        let case =
            Case { activity_s: SHOWN_S, sensors: Sensors::Fifteen, ..Case::new(activity, Mounting::Perfect) };
        let run = record(&case);
        let Ok(all) = mounts(&case, &run, &skeleton) else { continue };
        let begin_s = run.script.activity_s() + SETTLE_S;
        for (name, worn) in SUBSETS {
            let mounts = BodySegment::ALL.map(|s| all[s.index()].filter(|_| worn.contains(&s)));
            let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
            let mut sums = [Sums::default(); SEGMENTS];
            for ((t_s, samples), truth) in run.recording.iter().zip(&run.truth) {
                let estimate = filter.push(samples, 1.0 / RATE_HZ);
                if *t_s < begin_s {
                    continue;
                }
                for (k, sums) in sums.iter_mut().enumerate() {
                    let off = estimate.posture[k].angle_to(&truth[k]);
                    // Sigma is about one of three axes.
                    let said = estimate.sigma_rad[k] * 3_f64.sqrt();
                    sums.square += off.powi(2);
                    sums.said += said.powi(2);
                    sums.within += f64::from(off < 2.0 * said);
                    sums.count += 1.0;
                }
            }
            let limb = |of: [B; 2]| {
                of.iter().any(|of| {
                    let same = |limb: [B; 6]| limb.contains(of) && worn.iter().any(|w| limb.contains(w));
                    same(B::ARMS) || same(B::LEGS)
                })
            };
            let cell = |of: &[B], shown: bool| {
                let of: Vec<Sums> =
                    of.iter().filter(|of| !worn.contains(of)).map(|of| sums[of.index()]).collect();
                if of.is_empty() || !shown {
                    return "".to_owned();
                }
                let sum = |get: fn(&Sums) -> f64| {
                    of.iter().map(get).sum::<f64>() / of.iter().map(|sums| sums.count).sum::<f64>()
                };
                format!(
                    "{:.0} ({:.0}, {:.0} %)",
                    sum(|t| t.square).sqrt().to_degrees(),
                    sum(|t| t.said).sqrt().to_degrees(),
                    100.0 * sum(|t| t.within)
                )
            };
            let known: f64 = worn.iter().map(|w| sums[w.index()].square / sums[w.index()].count).sum::<f64>()
                / worn.len() as f64;
            let cells = [
                cell(&[B::Torso, B::Pelvis], true),
                cell(&[B::ThighR, B::ThighL], limb([B::ThighR, B::ThighL])),
                cell(&[B::ShankR, B::ShankL], limb([B::ShankR, B::ShankL])),
                cell(&[B::UpperArmR, B::UpperArmL], limb([B::UpperArmR, B::UpperArmL])),
                cell(&[B::ForearmR, B::ForearmL], limb([B::ForearmR, B::ForearmL])),
            ];
            emit(&format!(
                "| {name} | {activity:?} | {:.2} | {} |",
                known.sqrt().to_degrees(),
                cells.join(" | ")
            ));
        }
    }
}
