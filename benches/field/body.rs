//! The body in place of the pole: five people, a minute each; judged on the half minute after it.

use posed_field::solve_limbs;

use super::session::{Reading, Session};

const FITTED: usize = 1800;
const ALL: usize = 2700;

#[expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "the table is the answer, and time a column"
)]
pub(crate) fn run() {
    println!("| person | bones, raw, mm | solved | positions, raw, aligned, mm | solved | s | model |");
    println!("|---|---|---|---|---|---|---|");
    for seed in 1..=5 {
        let session = Session::new(seed, ALL as f64 / 30.0);
        let begun = std::time::Instant::now();
        let solution = solve_limbs(session.run(FITTED), &session.limbs(), &mut |_| {});
        let seconds = begun.elapsed().as_secs_f64();
        let Some(map) = solution.map else {
            println!("| {seed} | {:?} |", solution.report.reasons);
            continue;
        };
        let corrector = map.corrector();
        let raw = |reading: &Reading| (reading.z, reading.q);
        let solved = |reading: &Reading| {
            (corrector.position(&reading.z), corrector.orientation(&reading.z, &reading.q))
        };
        println!(
            "| {seed} | {:.1} | {:.1} | {:.1} | {:.1} | {seconds:.1} | {}{} |",
            1e3 * session.bones_m(FITTED..ALL, raw),
            1e3 * session.bones_m(FITTED..ALL, solved),
            1e3 * session.aligned_m(FITTED..ALL, |reading| reading.z),
            1e3 * session.aligned_m(FITTED..ALL, |reading| corrector.position(&reading.z)),
            map.report.model,
            if map.report.accepted { "" } else { ", refused" },
        );
    }
}
