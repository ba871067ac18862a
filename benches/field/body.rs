//! The body in place of the pole: five people, a minute each; judged on the half minute after it. Each is solved by the readings alone, and with what
//! three seconds of standing before them tell.

#[path = "../../src/commands/field/posture.rs"]
mod posture;

use nalgebra::Vector3;
use posed_field::{Limbs, PoleRun, solve_limbs};
use posed_fusion::body::{BodySegment, Skeleton};

use super::session::{BODY_SENSORS, Reading, Session};

const STANDING_S: f64 = 3.0;
const FITTED: usize = 1890;
const ALL: usize = 2790;

#[expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "the table is the answer, and time a column"
)]
pub(crate) fn run() {
    println!(
        "| person | known | bones, raw, mm | solved | positions, raw, aligned, mm | solved | s | model |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (seed, with_posture) in (1..=5).flat_map(|seed| [(seed, false), (seed, true)]) {
        let session = Session::new(seed, ALL as f64 / 30.0, STANDING_S);
        let (run, mut limbs) = (session.run(FITTED), session.limbs());
        if with_posture {
            add_posture(&mut limbs, &run, session.height_m);
        }
        let known = if with_posture { "posture, limits" } else { "nothing" };
        let begun = std::time::Instant::now();
        let solution = solve_limbs(run, &limbs, &mut |_| {});
        let seconds = begun.elapsed().as_secs_f64();
        let Some(map) = solution.map else {
            println!("| {seed} | {known} | {:?} |", solution.report.reasons);
            continue;
        };
        let corrector = map.corrector();
        let raw = |reading: &Reading| (reading.z, reading.q);
        let solved = |reading: &Reading| {
            (corrector.position(&reading.z), corrector.orientation(&reading.z, &reading.q))
        };
        println!(
            "| {seed} | {known} | {:.1} | {:.1} | {:.1} | {:.1} | {seconds:.1} | {}{} |",
            1e3 * session.bones_m(FITTED..ALL, raw),
            1e3 * session.bones_m(FITTED..ALL, solved),
            1e3 * session.aligned_m(FITTED..ALL, |reading| reading.z),
            1e3 * session.aligned_m(FITTED..ALL, |reading| corrector.position(&reading.z)),
            map.report.model,
            if map.report.accepted { "" } else { ", refused" },
        );
    }
}

fn add_posture(limbs: &mut Limbs, run: &PoleRun, height_m: f64) {
    let worn: Vec<posture::Worn> = BODY_SENSORS
        .iter()
        .filter_map(|(name, _)| Some(posture::Worn { segment: BodySegment::named(name)?, offset_m: None }))
        .collect();
    let skeleton = Skeleton::from_height(height_m);
    posture::add_priors(limbs, run, [0.0, STANDING_S], &worn, &skeleton, &Vector3::z()).expect("a posture");
}
