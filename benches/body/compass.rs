//! How headings hold for ten minutes without a magnetometer: `cargo bench --bench body compass [Activity]`

use nalgebra::UnitQuaternion;
use posed_fusion::body::{BodyFilter, BodyParams, BodySegment, SEGMENTS, Skeleton};
use posed_geometry::wrapped_rad;
use posed_simulator::body::Activity;

use super::{Case, HEIGHT_M, Mounting, RATE_HZ, SETTLE_S, Sensors, emit, mounts, record};

const ACTIVITIES: [Activity; 6] = [
    Activity::Walking,
    Activity::Strolling,
    Activity::Reaching,
    Activity::Curls,
    Activity::Squats,
    Activity::Workout,
];
/// People in a row of the table, each for so long, s.
const PEOPLE: u64 = 4;
const ACTIVITY_S: f64 = 600.0;
/// Joints of a column, by the segment below.
const JOINTS: [(&str, &[BodySegment]); 6] = [
    ("spine", &[BodySegment::Torso]),
    ("neck", &[BodySegment::Head]),
    ("shoulders", &[BodySegment::UpperArmR, BodySegment::UpperArmL]),
    ("hips", &[BodySegment::ThighR, BodySegment::ThighL]),
    ("wrists", &[BodySegment::HandR, BodySegment::HandL]),
    ("ankles", &[BodySegment::FootR, BodySegment::FootL]),
];

/// Of one person: root mean square errors of the headings between the segments of each kind of joint, degrees; of the body's heading the error
/// after all, degrees, and its root mean square over what is stated.
struct Figures {
    joints_deg: [f64; JOINTS.len()],
    body_deg: f64,
    over_sigma: f64,
    sigma_deg: f64,
}

/// By how much each segment is turned too far about the vertical, rad.
fn errors(
    found: &[Option<UnitQuaternion<f64>>; SEGMENTS],
    truth: &[UnitQuaternion<f64>; SEGMENTS],
) -> [f64; SEGMENTS] {
    BodySegment::ALL.map(|segment| {
        let Some(found) = found[segment.index()] else { return f64::NAN };
        let off = found * truth[segment.index()].inverse();
        2.0 * libm::atan2(off.k, off.w)
    })
}

fn solve(case: &Case) -> Result<Figures, String> {
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let run = record(case);
    let mounts = mounts(case, &run, &skeleton)?;
    let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
    let mut squares = [0.0; JOINTS.len()];
    let (mut ratios, mut count) = (0.0, 0.0);
    let (mut body_deg, mut sigma_deg) = (0.0, 0.0);
    let begin_s = run.script.activity_s() + SETTLE_S;
    for ((t_s, samples), truth) in run.recording.iter().zip(&run.truth) {
        let estimate = filter.push(samples, 1.0 / RATE_HZ);
        if *t_s < begin_s {
            continue;
        }
        let off = errors(&estimate.orientations, truth);
        for (sum, (_, joints)) in squares.iter_mut().zip(&JOINTS) {
            for segment in *joints {
                let parent = segment.parent().ok_or("no parent")?;
                let between = wrapped_rad(off[segment.index()] - off[parent.index()]);
                *sum += between.to_degrees().powi(2) / joints.len() as f64;
            }
        }
        let body_rad = wrapped_rad(off[BodySegment::Torso.index()]);
        ratios += (body_rad / estimate.heading_sigma_rad).powi(2);
        body_deg = body_rad.to_degrees();
        sigma_deg = estimate.heading_sigma_rad.to_degrees();
        count += 1.0;
    }
    let joints_deg = squares.map(|sum| (sum / count).sqrt());
    Ok(Figures { joints_deg, body_deg, over_sigma: (ratios / count).sqrt(), sigma_deg })
}

/// Fifteen IMUs; `only` an activity, if one is given.
pub(super) fn table(only: Option<&str>) {
    let names: Vec<&str> = JOINTS.iter().map(|(name, _)| *name).collect();
    emit(&format!("\n| activity | {} | body's heading at the end | over its sigma |", names.join(" | ")));
    emit(&format!("|---|{}---|---|", "---|".repeat(JOINTS.len())));
    for activity in ACTIVITIES.into_iter().filter(|a| only.is_none_or(|only| format!("{a:?}") == only)) {
        let case = |seed| Case {
            magnetometer: false,
            sensors: Sensors::Fifteen,
            activity_s: ACTIVITY_S,
            seed,
            ..Case::new(activity, Mounting::Perfect)
        };
        let found: Result<Vec<Figures>, String> = (1..=PEOPLE).map(|seed| solve(&case(seed))).collect();
        match found {
            Ok(found) => emit(&row(activity, &found)),
            Err(error) => emit(&format!("| {activity:?} | {error} |")),
        }
    }
}

/// Root mean squares over people.
fn row(activity: Activity, found: &[Figures]) -> String {
    let rms = |of: &dyn Fn(&Figures) -> f64| {
        (found.iter().map(|figures| of(figures).powi(2)).sum::<f64>() / found.len() as f64).sqrt()
    };
    let joints = (0..JOINTS.len()).map(|k| format!("{:.2}", rms(&|f| f.joints_deg[k])));
    format!(
        "| {activity:?} | {} | {:.2} (stated {:.1}) | {:.2} |",
        joints.collect::<Vec<_>>().join(" | "),
        rms(&|f| f.body_deg),
        rms(&|f| f.sigma_deg),
        rms(&|f| f.over_sigma),
    )
}
