//! What a recording costs: entries and messages into memory, and out again.
//!
//! One element is a chunk of 78 bytes and the message of eight sensors that follows from it; of the log alone it is the chunk. What is read of a
//! log is what a seek reads.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use posed_drivers::Timestamp;
use posed_recording::{Header, Reader, Writer};
use posed_stage::RecordingContent;
use posed_stage::input::{Entry, Input};

/// Ten seconds at 100 Hz.
const FRAMES: usize = 1000;

fn header(content: RecordingContent) -> Header {
    Header {
        version: "bench".to_owned(),
        epoch_utc_ns: 1_700_000_000_000_000_000,
        begun: Timestamp::ZERO,
        stage: "bench".to_owned(),
        stage_toml: "name = \"bench\"".to_owned(),
        devices: vec!["flock".to_owned()],
        sensors: Vec::new(),
        models: Default::default(),
        snapshot: None,
        content,
    }
}

/// Bytes and messages with about as much noise as real ones.
fn frames() -> Vec<(Entry, String)> {
    let mut state = 1_u64;
    let mut next = move || {
        state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
        state >> 40
    };
    let mut frame = |n: usize| {
        let bytes = (0..78).map(|_| next() as u8).collect();
        let sensors: Vec<_> = (0..8)
            .map(|sensor| {
                let mut number = || next() as f64 / 1e7;
                format!(
                    r#"{{"name":"sensor-{sensor}","device":"flock","state":"ok","position_m":[{:.5},{:.5},{:.5}],"orientation_wxyz":[{:.6},{:.6},{:.6},{:.6}]}}"#,
                    number(), number(), number(), number(), number(), number(), number()
                )
            })
            .collect();
        let message = format!(
            r#"{{"type":"sensors","seq":{n},"dropped":0,"t_s":{},"sensors":[{}]}}"#,
            n as f64 * 0.01,
            sensors.join(",")
        );
        let t = Timestamp::from_nanos(n as i64 * 10_000_000);
        (Entry { t, input: Input::Bytes { device: 0, bytes } }, message)
    };
    (0..FRAMES).map(&mut frame).collect()
}

fn record(frames: &[(Entry, String)], content: RecordingContent) -> Vec<u8> {
    let write = || {
        let mut writer = Writer::new(Vec::new(), header(content))?;
        for (entry, message) in frames {
            writer.entry(entry)?;
            if content == RecordingContent::Full {
                writer.message("sensors", entry.t, message.as_bytes())?;
            }
        }
        writer.finish("bench")
    };
    write().unwrap_or_else(|error| panic!("memory does not fail: {error}"))
}

fn recording(criterion: &mut Criterion) {
    let frames = frames();
    let mut group = criterion.benchmark_group("recording");
    group.throughput(Throughput::Elements(FRAMES as u64));
    for (content, suffix) in [(RecordingContent::Full, ""), (RecordingContent::Log, " log")] {
        let file = record(&frames, content);
        group.bench_function(format!("write{suffix}"), |bencher| {
            bencher.iter(|| record(black_box(&frames), content).len());
        });
        group.bench_function(format!("read{suffix}"), |bencher| {
            bencher.iter(|| {
                let reader = Reader::new(black_box(file.as_slice()), file.len() as u64);
                reader.map(|reader| reader.filter(|item| item.is_ok()).count()).ok()
            });
        });
    }
    group.finish();
}

criterion_group!(benches, recording);
criterion_main!(benches);
