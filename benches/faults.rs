//! Cost of the two-layer map: training by the paper's rule, and a frame of a live stream.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use posed_baselines::fault_map;
use posed_motion::fault_map::Frames;
use posed_motion::fault_map::Training;
use posed_motion::fault_map::{FaultMap, Size};
use posed_simulator::figure::{Figure, Poses, SENSORS};

/// Sensors that sway about places of their own.
fn frames(sensors: usize, count: usize) -> Frames {
    let coordinate = |k: usize, sensor: usize, axis: usize| {
        let (t, s) = (k as f64 / 30.0, sensor as f64);
        0.4 * libm::sin(0.7 * t + s + axis as f64)
            + 0.2 * libm::cos(2.3 * t + 0.3 * s * axis as f64)
            + 0.1 * s
    };
    Frames {
        sensors: (0..sensors).map(|sensor| format!("s{sensor}")).collect(),
        t_s: (0..count).map(|k| k as f64 / 30.0).collect(),
        positions_m: (0..count)
            .flat_map(|k| (0..sensors).flat_map(move |s| (0..3).map(move |axis| coordinate(k, s, axis))))
            .collect(),
        ..Frames::default()
    }
}

fn train(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("faults");
    group.sample_size(10);
    for count in [407, 2823] {
        let frames = frames(16, count);
        group.bench_function(format!("train 16 sensors x {count} frames x 100 epochs"), |bencher| {
            bencher.iter(|| fault_map::train(&frames, Size::default(), &fault_map::published()));
        });
    }
    let mut stream = |name: &str, frames: &Frames| {
        let Ok((fault_map, _)) = FaultMap::train(frames, Size::default(), &Training::default()) else {
            return;
        };
        let mut watch = fault_map.watch();
        let mut k = 0;
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                k = (k + 1) % frames.len();
                black_box(watch.push(&fault_map, frames.frame(k)).label.class)
            });
        });
    };
    stream("a frame of 20 sensors", &frames(20, 1000));
    let figure = Figure { seed: 1, height_m: 1.75, rate_hz: 60.0, frames: 3600 };
    let Poses { positions_m, orientations_wxyz } = figure.poses();
    for count in [10, SENSORS.len()] {
        let first = |values: &[f64], numbers: usize| {
            let rows = values.chunks_exact(numbers * SENSORS.len());
            rows.flat_map(|row| row[..numbers * count].to_vec()).collect()
        };
        let worn = Frames {
            sensors: SENSORS[..count].iter().map(|name| (*name).to_owned()).collect(),
            t_s: (0..figure.frames).map(|k| k as f64 / figure.rate_hz).collect(),
            positions_m: first(&positions_m, 3),
            orientations_wxyz: first(&orientations_wxyz, 4),
        };
        stream(&format!("a frame of {count} sensors with joints"), &worn);
    }
    group.finish();
}

criterion_group!(benches, train);
criterion_main!(benches);
