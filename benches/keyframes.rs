//! Cost of the key poses: per frame of each statistic, and per series of 1000 frames.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use posed_motion::keyframes::{
    Detector, Hinge, HingeSettings, MeanDifference, MeanDifferenceSettings, Statistic,
};
use posed_simulator::gesture::{Gesture, NOISE};

fn series(criterion: &mut Criterion) {
    let published = MeanDifferenceSettings::default();
    let plain = MeanDifferenceSettings { smooth: false, ..published };
    one(criterion, "paper, statistic alone", MeanDifference::new(plain));
    one(criterion, "paper", MeanDifference::new(published));
    one(criterion, "hinge", Hinge::new(HingeSettings::default()));
}

fn one(criterion: &mut Criterion, name: &str, statistic: impl Statistic + Clone) {
    let poses = Gesture::of_the_table(1).noisy(NOISE[2]);
    let detector = Detector::new(statistic);
    let mut group = criterion.benchmark_group("keyframes");
    group.throughput(Throughput::Elements(poses.len() as u64));
    group.bench_function(name, |bencher| bencher.iter(|| detector.clone().run(&poses)));
    group.finish();
}

criterion_group!(benches, series);
criterion_main!(benches);
