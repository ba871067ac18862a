//! Whether a spacing that is a millimetre in 300 off is told by three anchors, and a right one is not.

use posed::field::{Code, solve};

use super::scenes::{SPACING_M, scenes};
use super::survey::{anchors, pole};

#[expect(clippy::print_stdout, reason = "the table is the answer")]
pub(crate) fn run(seeds: u64, only: Option<&str>) {
    println!("| scene | right, told | 1 mm more, told | 1 mm less, told | of |\n|---|---|---|---|---|");
    for scene in scenes().iter().filter(|scene| only.is_none_or(|only| scene.name.contains(only))) {
        let told = [0.0, 0.001, -0.001].map(|wrong_m| {
            let told = (1..=seeds).filter(|seed| {
                let run = scene.run(*seed);
                let mut recording = pole(&run, SPACING_M + wrong_m);
                let anchors = anchors(scene, &run, &mut recording, *seed);
                let report = solve(recording, &anchors, &mut |_| {}).report;
                report.reasons.iter().any(|reason| reason.code == Code::Spacing)
            });
            told.count()
        });
        println!("| {} | {} | {} | {} | {seeds} |", scene.name, told[0], told[1], told[2]);
    }
}
