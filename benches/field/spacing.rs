//! Whether a spacing that is a millimetre in 300 off is identified by three anchors, and a right one is not.

use posed_field::{Code, solve};

use super::scenes::{SPACING_M, scenes};
use super::survey::{anchors, pole};

#[expect(clippy::print_stdout, reason = "the table is the answer")]
pub(crate) fn run(seeds: u64, only: Option<&str>) {
    println!(
        "| scene | right, flagged | 1 mm more, flagged | 1 mm less, flagged | of |\n|---|---|---|---|---|"
    );
    for scene in scenes().iter().filter(|scene| only.is_none_or(|only| scene.name.contains(only))) {
        let reported = [0.0, 0.001, -0.001].map(|wrong_m| {
            let reported = (1..=seeds).filter(|seed| {
                let run = scene.run(*seed);
                let mut recording = pole(&run, SPACING_M + wrong_m);
                let anchors = anchors(scene, &run, &mut recording, *seed);
                let report = solve(recording, &anchors, &mut |_| {}).report;
                report.reasons.iter().any(|reason| reason.code == Code::Spacing)
            });
            reported.count()
        });
        println!("| {} | {} | {} | {} | {seeds} |", scene.name, reported[0], reported[1], reported[2]);
    }
}
