//! Cost of the key poses: per frame of each statistic, and per series of 1000 frames.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use posed::motion::keyframes::{Detector, HingeSettings, Method, PaperSettings};
use posed_simulator::gesture::{Gesture, NOISE};

fn series(criterion: &mut Criterion) {
    let poses = Gesture::of_the_table(1).noisy(NOISE[2]);
    let mut group = criterion.benchmark_group("keyframes");
    group.throughput(Throughput::Elements(poses.len() as u64));
    let plain = PaperSettings { smooth: false, ..PaperSettings::default() };
    for (name, method) in [
        ("paper, statistic alone", Method::Paper(plain)),
        ("paper", Method::Paper(PaperSettings::default())),
        ("hinge", Method::Hinge(HingeSettings::default())),
    ] {
        let detector = Detector::new(method);
        group.bench_function(name, |bencher| bencher.iter(|| detector.clone().run(&poses)));
    }
    group.finish();
}

criterion_group!(benches, series);
criterion_main!(benches);
