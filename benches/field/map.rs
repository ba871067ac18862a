//! The map alone: all are given the same readings and true places. 15,000 to fit, 5,000 held out.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use nalgebra::Vector3;
use posed_field::{FieldNoise, fit_known};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{cpu, scenes::scenes};

#[expect(clippy::print_stdout, clippy::disallowed_methods, reason = "figures are the answer")]
pub(crate) fn run(export: Option<&Path>, only: Option<&str>) {
    println!(
        "| scene | fit, s | on one core, s | evaluate, ns | median, mm | 95 %, mm | model |\n|---|---|---|---|---|---|---|"
    );
    let scenes = scenes();
    let requested =
        scenes.iter().enumerate().filter(|(_, scene)| only.is_none_or(|only| scene.name.contains(only)));
    for (index, scene) in requested {
        let mut random = ChaCha8Rng::seed_from_u64(index as u64 + 1);
        let mut draw = |count: usize, noisy: bool| {
            let mut pairs: Vec<(Vector3<f64>, Vector3<f64>)> = Vec::new();
            while pairs.len() < count {
                let p = Vector3::new(
                    random.random_range(0.7..2.3),
                    random.random_range(-1.1..1.1),
                    random.random_range(0.2..1.5),
                );
                if let Some(z) = scene.position(&p, noisy.then_some(&mut random)) {
                    pairs.push((z, p));
                }
            }
            pairs
        };
        let fitting = draw(15_000, true);
        let held_out = draw(5_000, false);
        if let Some(folder) = export {
            write(&folder.join(format!("scene-{index}-fit.csv")), &fitting);
            write(&folder.join(format!("scene-{index}-held-out.csv")), &held_out);
        }
        let (begun, busy_s) = (Instant::now(), cpu::process_s());
        let noise = FieldNoise { sigma_signal: scene.sigma_signal, floor_m: 3e-4 };
        let Some(map) = fit_known(&fitting, noise) else { continue };
        let (fit_s, busy_s) = (begun.elapsed().as_secs_f64(), cpu::process_s() - busy_s);
        let corrector = map.corrector();
        let readings: Vec<Vector3<f64>> = held_out.iter().map(|(z, _)| *z).collect();
        let mut corrected = Vec::new();
        corrector.positions(&readings, &mut corrected);
        let begun_ns = cpu::thread_ns();
        for _ in 0..200 {
            corrector.positions(std::hint::black_box(&readings), &mut corrected);
        }
        let evaluate_ns = (cpu::thread_ns() - begun_ns) / (200.0 * readings.len() as f64);
        let mut errors: Vec<f64> =
            corrected.iter().zip(&held_out).map(|(corrected, (_, p))| 1e3 * (corrected - p).norm()).collect();
        errors.sort_by(f64::total_cmp);
        println!(
            "| {} | {fit_s:.2} | {busy_s:.2} | {evaluate_ns:.0} | {:.3} | {:.3} | {} |",
            scene.name,
            errors[errors.len() / 2],
            errors[errors.len() * 95 / 100],
            map.report.model
        );
    }
}

fn write(path: &Path, pairs: &[(Vector3<f64>, Vector3<f64>)]) {
    let mut file =
        std::io::BufWriter::new(std::fs::File::create(path).expect("the folder can be written to"));
    writeln!(file, "zx,zy,zz,x,y,z").expect("written");
    for (z, p) in pairs {
        writeln!(file, "{},{},{},{},{},{}", z.x, z.y, z.z, p.x, p.y, p.z).expect("written");
    }
}
