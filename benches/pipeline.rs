//! One second of bytes through the warm pipeline: session, clock, frames, faults, filter; and a snapshot of its state.

use std::hint::black_box;

use criterion::{BatchSize, Criterion, Throughput};
use posed_pipeline::Pipeline;
use posed_rig::{Rig, people, stage};
use posed_simulator::body::Activity;
use posed_simulator::scenario::{DeviceScenario, Scenario};
use posed_stage::Stage;

fn birds(criterion: &mut Criterion, name: &str, birds: &[u16], rate_hz: f64) {
    let device = |index| DeviceScenario { name: format!("d{index}"), rate_hz, ..DeviceScenario::default() };
    let scenario = Scenario { devices: (0..birds.len()).map(device).collect(), ..Scenario::default() };
    second(criterion, name, &stage(birds), &scenario);
}

/// Each with fifteen IMUs at 100 Hz: the frames of a second, with all that is made of them.
fn crowd(criterion: &mut Criterion, count: usize) {
    const NAMES: [&str; 5] = ["anna", "bert", "clara", "david", "eva"];
    let cast: Vec<_> = NAMES[..count].iter().map(|name| (*name, 1.7, Activity::Squats)).collect();
    let (stage, scenario) = people(&cast);
    second(criterion, &format!("{count} people"), &stage, &scenario);
}

fn second(criterion: &mut Criterion, name: &str, stage: &Stage, scenario: &Scenario) {
    let mut rig = Rig::new(stage, scenario);
    rig.run_until(9.0);
    let from = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 8.0);
    let mut warm = Pipeline::new(stage).expect("the stage is right");
    for entry in &rig.log[..from] {
        warm.push(entry, &mut |_| {});
    }
    let mut frames = 0;
    let mut count = warm.clone();
    for entry in &rig.log[from..] {
        count.push(entry, &mut |output| {
            frames += u64::from(matches!(output, posed_stage::output::Output::Estimate(_)))
        });
    }
    let mut group = criterion.benchmark_group("pipeline");
    // Time per element is time per frame.
    group.throughput(Throughput::Elements(frames));
    group.bench_function(name, |bencher| {
        let run = |pipeline: &mut Pipeline| {
            for entry in &rig.log[from..] {
                pipeline.push(entry, &mut |output| {
                    black_box(output);
                });
            }
        };
        bencher.iter_batched_ref(|| warm.clone(), run, BatchSize::LargeInput);
    });
    group.finish();
}

/// A snapshot of the demo's stage after 20 s, and a pipeline restored from it.
fn snapshot(criterion: &mut Criterion) {
    let (stage, mut rig) = posed_rig::demo();
    rig.run_until(20.0);
    let bytes = rig.pipeline.snapshot();
    let mut group = criterion.benchmark_group("snapshot");
    group.throughput(Throughput::Bytes(bytes.len() as u64));
    group.bench_function("take", |bencher| bencher.iter(|| black_box(rig.pipeline.snapshot())));
    group.bench_function("restore", |bencher| {
        bencher.iter(|| Pipeline::restore(&stage, rig.pipeline.models(), &bytes).expect("its own stage"));
    });
    group.finish();
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    birds(&mut criterion, "8 birds of one flock", &[8], 90.0);
    birds(&mut criterion, "100 birds of 50 flocks", &[2; 50], 100.0);
    crowd(&mut criterion, 1);
    crowd(&mut criterion, 5);
    snapshot(&mut criterion);
    criterion.final_summary();
}
