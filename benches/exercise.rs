//! What counting and teaching cost: `cargo bench --bench exercise`.
//!
//! The decoder alone per frame (40 states; 4 channels are scored with it), and teaching from 30 s at 100 Hz.

use std::f64::consts::TAU;
use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use posed_motion::exercise::{Counter, Exercise, Options, ShortTimeViterbi, Stream, Topology, teach};

const CHANNELS: usize = 4;

/// Repetitions of `period_s` for `seconds` at 100 Hz, after two seconds of rest.
fn recording(seconds: f64, period_s: f64) -> (Vec<String>, Vec<f64>, Vec<Option<f64>>) {
    let columns = (0..CHANNELS).map(|channel| format!("joint_{channel}_deg")).collect();
    let t_s: Vec<f64> = (0..(100.0 * seconds) as usize).map(|row| row as f64 * 0.01).collect();
    let mut noise = 1_u64;
    let values = t_s
        .iter()
        .flat_map(|t_s| {
            let moving = *t_s > 2.0 && *t_s < seconds - 2.0;
            let lift = if moving { 0.5 - 0.5 * libm::cos(TAU * (t_s - 2.0) / period_s) } else { 0.0 };
            (0..CHANNELS).map(move |channel| (channel, lift)).collect::<Vec<_>>()
        })
        .map(|(channel, lift)| {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let jitter = (noise >> 40) as f64 / (1_u64 << 24) as f64 - 0.5;
            Some((20.0 + 15.0 * channel as f64) * lift.powi(1 + channel as i32) + jitter)
        })
        .collect();
    (columns, t_s, values)
}

fn taught(seconds: f64, period_s: f64) -> Exercise {
    let (columns, t_s, values) = recording(seconds, period_s);
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let repetitions = ((seconds - 4.0) / period_s).round() as usize;
    let options = Options {
        name: "bench".to_owned(),
        repetitions,
        channels: Some(columns.clone()),
        ..Options::default()
    };
    teach(&stream, &options).expect("the demonstration is a good one").exercise
}

/// Short-time Viterbi of a left-right model of 40 states with its Gaussians on 4 channels, per sample.
fn decoder(criterion: &mut Criterion) {
    const STATES: usize = 40;
    let mut transitions = Vec::new();
    for state in 0..STATES {
        for (step, probability) in [0.5_f64, 0.4, 0.1].into_iter().enumerate() {
            transitions.push((state, (state + step) % STATES, libm::log(probability)));
        }
    }
    let mut initial = vec![f64::NEG_INFINITY; STATES];
    initial[0] = 0.0;
    let mean: Vec<f64> = (0..CHANNELS * STATES).map(|i| libm::sin(i as f64 * 0.37)).collect();
    let samples: Vec<[f64; CHANNELS]> = (0..4000)
        .map(|frame| std::array::from_fn(|c| mean[c * STATES + (frame / 2) % STATES] + 0.01 * c as f64))
        .collect();
    let mut group = criterion.benchmark_group("short-time viterbi, 40 states, 4 channels");
    group.throughput(Throughput::Elements(samples.len() as u64));
    for bound in [None, Some(20)] {
        let mut viterbi = ShortTimeViterbi::new(Topology::new(initial.clone(), &transitions), bound);
        let mut log_density = [0.0; STATES];
        let name = bound.map_or("exact".to_owned(), |bound| format!("bound {bound}"));
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let mut sum = 0;
                for sample in &samples {
                    log_density.fill(0.0);
                    for (value, mean) in sample.iter().zip(mean.chunks_exact(STATES)) {
                        for (out, mean) in log_density.iter_mut().zip(mean) {
                            let off = value - mean;
                            *out -= off * off * 10.0;
                        }
                    }
                    viterbi.push(&log_density, &mut |_, state| sum += state);
                }
                black_box(sum)
            });
        });
    }
}

/// The whole counter per sample of a 100 Hz stream: 3.2 s repetitions, 40 states, 4 channels and their velocities.
fn counter(criterion: &mut Criterion) {
    let exercise = taught(20.0, 3.2);
    let (columns, t_s, values) = recording(60.0, 3.2);
    let mut group = criterion.benchmark_group("counter");
    group.throughput(Throughput::Elements(t_s.len() as u64));
    group.bench_function("sample at 100 Hz", |bencher| {
        bencher.iter(|| {
            let mut counter = Counter::new(vec![exercise.clone()], &columns).expect("its own columns");
            for (row, t_s) in values.chunks_exact(CHANNELS).zip(&t_s) {
                counter.push(*t_s, row, &mut |event| {
                    black_box(event);
                });
            }
            counter.count(0)
        });
    });
}

fn teaching(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("teach");
    group.sample_size(10);
    group.bench_function("30 s, 100 Hz, 4 channels", |bencher| bencher.iter(|| taught(30.0, 2.6)));
}

criterion_group!(benches, decoder, counter, teaching);
criterion_main!(benches);
