//! How far the body is from where it walked to: `cargo bench --bench body travel`

use nalgebra::Vector3;
use posed_fusion::body::{BodyFilter, BodyParams, BodySegment, Skeleton};
use posed_simulator::body::{Activity, SensorErrors};

use super::{Case, HEIGHT_M, Mounting, RATE_HZ, Sensors, emit, mounts, record};

const SHANKS: [BodySegment; 2] = [BodySegment::ShankR, BodySegment::ShankL];
/// A way goes straight on for so long: shorter, and what a step shakes counts as way.
const WAY_EPOCHS: usize = 50;
/// People in a row of the table.
const PEOPLE: u64 = 5;

/// What one person's way says.
#[derive(Clone, Copy, Debug, Default)]
struct Figures {
    /// Length of the hips' way that was walked, m, and by how much the estimate's differs, fraction.
    way_m: f64,
    way_error: f64,
    /// How far the hips are from the truth at the end, and how far too high, m.
    end_m: f64,
    end_height_m: f64,
    /// How far an ankle moves whose foot is said to stand and lies flat, m: mean over footholds, and the worst.
    slide_m: [f64; 2],
    /// Of the epochs in which a flat foot stands those that say so; and of those in which a foot is in the air.
    recall: f64,
    false_contacts: f64,
}

/// Where a foot began to stand, truth and estimate, m.
#[derive(Clone, Copy)]
struct Foothold {
    truth_m: Vector3<f64>,
    found_m: Vector3<f64>,
    slid_m: f64,
}

fn solve(case: &Case) -> Result<Figures, String> {
    let mut skeleton = Skeleton::from_height(HEIGHT_M);
    let run = record(case);
    let mounts = mounts(case, &run, &skeleton)?;
    let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
    let mut figures = Figures::default();
    let mut ways = [0.0; 2];
    let mut last: Option<[Vector3<f64>; 2]> = None;
    let mut footholds: [Option<Foothold>; 2] = [None; 2];
    let mut slides = Vec::new();
    let mut counts = [[0.0; 2]; 2];
    let mut began_m = None;
    let begin_s = run.script.activity_s();
    let epochs = run.recording.iter().zip(&run.truth).zip(&run.origins_m);
    for (epoch, (((t_s, samples), truth), origins_m)) in epochs.enumerate() {
        filter.push(samples, 1.0 / RATE_HZ);
        skeleton = *filter.skeleton();
        let estimate = filter.estimate();
        if *t_s < begin_s {
            continue;
        }
        let travel = estimate.travel.ok_or("the feet say nothing")?;
        let said = travel.contacts.ok_or("the feet are not seen")?;
        let hips_m = [origins_m[BodySegment::Pelvis.index()], travel.pelvis_m];
        if epoch % WAY_EPOCHS == 0
            && let Some(last) = last.replace(hips_m)
        {
            for (way, (now, before)) in ways.iter_mut().zip(hips_m.iter().zip(&last)) {
                *way += (now - before).xy().norm();
            }
        }
        let offset_m = hips_m[1] - hips_m[0];
        let offset_m = offset_m - *began_m.get_or_insert(offset_m);
        (figures.end_m, figures.end_height_m) = (offset_m.xy().norm(), offset_m.z);
        let ankles_m = skeleton.ankles_m(&estimate.posture, travel.pelvis_m);
        let contacts = run.script.contacts(*t_s);
        for (side, shank) in SHANKS.into_iter().enumerate() {
            let index = shank.index();
            let truth_m = origins_m[index] + truth[index] * Vector3::new(0.0, -run.build.shank_m, 0.0);
            let found_m = ankles_m[side];
            let flat = footholds[side].is_some_and(|foothold| (truth_m - foothold.truth_m).norm() < 1e-3);
            let stands = said[side].foot > 0.5;
            let on_floor = contacts.is_none_or(|contacts| contacts[side]);
            if flat {
                counts[0][0] += 1.0;
                counts[0][1] += f64::from(u8::from(stands));
            } else if !on_floor {
                counts[1][0] += 1.0;
                counts[1][1] += f64::from(u8::from(stands));
            }
            footholds[side] = match footholds[side] {
                Some(foothold) if flat && stands => {
                    let slid_m = foothold.slid_m.max((found_m - foothold.found_m).norm());
                    Some(Foothold { slid_m, ..foothold })
                }
                Some(foothold) if flat && foothold.slid_m == 0.0 => Some(Foothold { found_m, ..foothold }),
                before => {
                    slides.extend(before.map(|foothold| foothold.slid_m).filter(|slid_m| *slid_m > 0.0));
                    Some(Foothold { truth_m, found_m, slid_m: 0.0 })
                }
            };
        }
    }
    figures.way_m = ways[0];
    figures.way_error = ways[1] / ways[0] - 1.0;
    figures.slide_m =
        [slides.iter().sum::<f64>() / slides.len().max(1) as f64, slides.iter().fold(0.0, |a, b| b.max(a))];
    figures.recall = counts[0][1] / counts[0][0];
    figures.false_contacts = counts[1][1] / counts[1][0];
    Ok(figures)
}

/// The table of `docs/body.md`.
pub(super) fn table() {
    emit(
        "\n| case | activity | way, m | its error, % | hips at the end, m | too high, m | ankle moves while it stands, mm: mean, most | stands and is said to, % | is in the air and said to stand, % |",
    );
    emit("|---|---|---|---|---|---|---|---|---|");
    let skin = SensorErrors { skin_m: 5e-4, skin_rad_m: 2.0, ..SensorErrors::calibrated() };
    for activity in [Activity::Strolling, Activity::Climbing, Activity::Squats] {
        let case = |mounting| Case { activity_s: 120.0, ..Case::new(activity, mounting) };
        for (name, case) in [
            ("no errors", Case { errors: SensorErrors::NONE, ..case(Mounting::Perfect) }),
            ("perfect mounting", case(Mounting::Perfect)),
            ("calibrated", case(Mounting::Calibrated)),
            ("skin", Case { errors: skin, ..case(Mounting::Calibrated) }),
            ("3 degrees wrong", case(Mounting::Wrong(3.0))),
            ("no field, calibrated", Case { magnetometer: false, ..case(Mounting::Calibrated) }),
            ("sensors on the feet", Case { sensors: Sensors::Fifteen, ..case(Mounting::Calibrated) }),
            (
                "sensors on the feet, no field, perfect",
                Case { sensors: Sensors::Fifteen, magnetometer: false, ..case(Mounting::Perfect) },
            ),
            ("legs 4 % longer", Case { longer: 1.04, longer_shanks: 1.04, ..case(Mounting::Calibrated) }),
            (
                "legs 4 % longer, sensors on the feet",
                Case {
                    longer: 1.04,
                    longer_shanks: 1.04,
                    sensors: Sensors::Fifteen,
                    ..case(Mounting::Calibrated)
                },
            ),
        ] {
            let found: Result<Vec<Figures>, String> =
                (1..=PEOPLE).map(|seed| solve(&Case { seed, disturbances: Vec::new(), ..case })).collect();
            match found {
                Ok(found) => emit(&row(name, activity, &found)),
                Err(error) => emit(&format!("| {name} | {activity:?} | {error} |")),
            }
        }
    }
}

/// Root mean squares over people; the most of the slides.
fn row(name: &str, activity: Activity, found: &[Figures]) -> String {
    let rms = |of: fn(&Figures) -> f64| {
        (found.iter().map(|figures| of(figures).powi(2)).sum::<f64>() / found.len() as f64).sqrt()
    };
    let most = found.iter().map(|figures| figures.slide_m[1]).fold(0.0, f64::max);
    format!(
        "| {name} | {activity:?} | {:.0} | {:.2} | {:.2} | {:.3} | {:.1}, {:.0} | {:.1} | {:.1} |",
        rms(|f| f.way_m),
        rms(|f| 100.0 * f.way_error),
        rms(|f| f.end_m),
        rms(|f| f.end_height_m),
        1e3 * rms(|f| f.slide_m[0]),
        1e3 * most,
        rms(|f| 100.0 * f.recall),
        rms(|f| 100.0 * f.false_contacts),
    )
}
