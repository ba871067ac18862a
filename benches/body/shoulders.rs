//! Shoulders that rise and come forward with the arms, seen by sensors of their own or not: a table of `docs/body.md`.

use nalgebra::Vector3;
use posed_fusion::body::{BodyFilter, BodyParams, BodySegment, Skeleton};
use posed_simulator::body::Activity;

use super::{Case, HEIGHT_M, Mounting, RATE_HZ, SETTLE_S, Sensors, emit, mounts, record};

const ACTIVITIES: [Activity; 4] = [Activity::Walking, Activity::Reaching, Activity::Curls, Activity::Squats];
/// Each arm with the shoulder that it hangs on.
const ARMS: [[BodySegment; 2]; 2] =
    [[BodySegment::ShoulderR, BodySegment::UpperArmR], [BodySegment::ShoulderL, BodySegment::UpperArmL]];

/// Root mean squares over both sides: of the collar bone and of the upper arm against the torso, the whole rotation, degrees; of the arm's joint against the torso, mm.
fn solve(case: &Case) -> Result<[f64; 3], String> {
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let run = record(case);
    let mounts = mounts(case, &run, &skeleton)?;
    let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
    let torso = BodySegment::Torso.index();
    let begin_s = run.script.activity_s() + SETTLE_S;
    let (mut squares, mut count) = ([0.0; 3], 0.0);
    for (((t_s, samples), truth), origins_m) in run.recording.iter().zip(&run.truth).zip(&run.origins_m) {
        let posture = filter.push(samples, 1.0 / RATE_HZ).posture;
        if *t_s < begin_s {
            continue;
        }
        let found_m = skeleton.origins_m(&posture, Vector3::zeros());
        for [shoulder, arm] in ARMS.map(|pair| pair.map(BodySegment::index)) {
            let turned_deg = |k: usize| {
                let (found, expected) =
                    (posture[torso].inverse() * posture[k], truth[torso].inverse() * truth[k]);
                found.angle_to(&expected).to_degrees()
            };
            let found_m = posture[torso].inverse() * (found_m[arm] - found_m[torso]);
            let expected_m = truth[torso].inverse() * (origins_m[arm] - origins_m[torso]);
            squares[0] += turned_deg(shoulder).powi(2);
            squares[1] += turned_deg(arm).powi(2);
            squares[2] += (found_m - expected_m).norm_squared() * 1e6;
            count += 1.0;
        }
    }
    Ok(squares.map(|sum| (sum / count).sqrt()))
}

/// `cargo bench --bench body shoulders`
pub(super) fn table() {
    emit("\n| sensors | case | activity | sternoclavicular | shoulder | place of the arm's joint, mm |");
    emit("|---|---|---|---|---|---|");
    for activity in ACTIVITIES {
        let cases = [
            ("perfect mounting", Case::new(activity, Mounting::Perfect)),
            (
                "calibrated, clumsy",
                Case { clumsiness_rad: 0.03, ..Case::new(activity, Mounting::Calibrated) },
            ),
            ("no field", Case { magnetometer: false, ..Case::new(activity, Mounting::Perfect) }),
        ];
        for (name, case) in cases {
            for (count, sensors) in [(15, Sensors::Fifteen), (17, Sensors::Seventeen)] {
                match solve(&Case { sensors, girdle: true, ..case.clone() }) {
                    Ok([collar_bone, arm, joint_mm]) => emit(&format!(
                        "| {count} | {name} | {activity:?} | {collar_bone:.1} | {arm:.1} | {joint_mm:.0} |"
                    )),
                    Err(error) => emit(&format!("| {count} | {name} | {activity:?} | {error} |")),
                }
            }
        }
    }
}
