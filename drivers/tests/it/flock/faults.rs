//! Damage on the line: what the splitter publishes, loses and counts.

use std::time::Duration;

use posed_drivers::flock::parser::{Event, Splitter};
use posed_drivers::flock::wire::{Format, Scale, Shape, Tolerance, record, rotation};
use posed_drivers::{DeviceTime, Measurement, Sample, Timestamp};
use proptest::prelude::*;

const BAUD: u32 = 115_200;

/// A small seeded generator (splitmix64).
struct Rng(u64);

impl Rng {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
}

fn shape(format: Format, group: bool) -> Shape {
    Shape { format, button: false, group }
}

/// Pose of a bird in a cycle: brisk motion, 1 m/s and 200 degrees/s at 100 Hz.
fn truth(address: u8, cycle: usize) -> ([f64; 3], [f64; 4]) {
    let t = cycle as f64 * 0.01;
    let a = f64::from(address);
    let p = [
        0.4 + 0.2 * libm::sin(5.0 * t + a),
        0.2 * libm::cos(4.0 * t) - 0.1 * a,
        -0.3 + 0.05 * libm::sin(3.0 * t * a),
    ];
    (p, rotation::from_angles([3.0 * libm::sin(1.1 * t + a), 0.9 * libm::sin(1.7 * t), 1.0 + a + 3.5 * t]))
}

fn record_of(address: u8, cycle: usize, shape: Shape) -> Vec<u8> {
    let (p, q) = truth(address, cycle);
    let mut bytes = Vec::new();
    record::encode(p, q, (0, address), shape, Scale::default(), &mut bytes);
    bytes
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    Lost,
    Inserted,
    Phase,
}

/// How the damaged stream is read.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Reads {
    /// One record a read.
    Records,
    /// One byte a read, at the pace of the line.
    Bytes,
    /// All that came in 16 ms.
    Bursts,
}

struct Outcome {
    samples: Vec<Sample>,
    splitter: Splitter,
}

/// Sends bytes with their times through a splitter, in reads of this kind, with its timeouts.
fn receive(stream: &[(f64, u8)], reads: Reads, birds: &[(u8, Shape)]) -> Outcome {
    let mut splitter = Splitter::new(birds, Scale::default(), Tolerance::LIVE, BAUD);
    let mut samples = Vec::new();
    let mut i = 0;
    while i < stream.len() {
        let mut end = i + 1;
        match reads {
            Reads::Bytes => {}
            Reads::Records => {
                while end < stream.len() && stream[end].0 - stream[end - 1].0 < 2e-4 {
                    end += 1
                }
            }
            Reads::Bursts => {
                while end < stream.len() && (stream[end].0 / 0.016).floor() == (stream[i].0 / 0.016).floor() {
                    end += 1
                }
            }
        }
        let now = Timestamp::from_secs_f64(stream[end - 1].0);
        let mut emit = |event| {
            if let Event::Sample(sample) = event {
                samples.push(sample)
            }
        };
        if splitter.poll_timeout().is_some_and(|at| at <= now) {
            splitter.handle_timeout(now, &mut emit);
        }
        let bytes: Vec<u8> = stream[i..end].iter().map(|&(_, byte)| byte).collect();
        splitter.handle_bytes(now, &bytes, &mut emit);
        i = end;
    }
    let now = Timestamp::from_secs_f64(stream.last().unwrap().0) + Duration::from_secs(1);
    splitter.handle_timeout(now, &mut |event| {
        if let Event::Sample(sample) = event {
            samples.push(sample)
        }
    });
    splitter.finish();
    Outcome { samples, splitter }
}

/// Ten seconds of birds at 100 Hz with 50 faults; returns the stream and the cycles that were hit.
fn damaged(birds: &[(u8, Shape)], fault: Fault, seed: u64) -> Vec<(f64, u8)> {
    let byte_s = 10.0 / f64::from(BAUD);
    let mut stream = Vec::new();
    for cycle in 0..1000 {
        let mut t = cycle as f64 * 0.01;
        for &(address, shape) in birds {
            for byte in record_of(address, cycle, shape) {
                t += byte_s;
                stream.push((t, byte));
            }
            t += 3.0 * byte_s;
        }
    }
    let mut rng = Rng(seed);
    for _ in 0..50 {
        // The very first cycle is left whole: an order must be known before it can be broken.
        let at = 64 + rng.below(stream.len() - 64);
        match fault {
            Fault::Lost => drop(stream.remove(at)),
            Fault::Inserted => {
                let t = stream[at].0 - byte_s / 2.0;
                stream.insert(at, (t, rng.next() as u8));
            }
            Fault::Phase => stream[at].1 ^= 0x80,
        }
    }
    stream
}

/// Largest distance of any sample from what was sent, m and rad; the cycle is the one that the sample claims.
fn worst(samples: &[Sample]) -> (f64, f64) {
    let mut worst = (0.0f64, 0.0f64);
    for sample in samples {
        let DeviceTime::Cycle(cycle) = sample.t_device else { panic!("{sample:?}") };
        let (p, q) = truth(sample.address as u8, cycle as usize);
        let Measurement::Pose { position_m, orientation_wxyz, .. } = sample.measurement else {
            panic!("a Flock measures poses")
        };
        if let Some(got) = position_m {
            worst.0 = (0..3).map(|i| (got[i] - p[i]).abs()).fold(worst.0, f64::max);
        }
        if let Some(got) = orientation_wxyz {
            let dot: f64 = (0..4).map(|i| got[i] * q[i]).sum();
            worst.1 = worst.1.max(2.0 * libm::acos(dot.abs().min(1.0)));
        }
    }
    worst
}

#[test]
fn fifty_faults_give_no_wrong_pose_and_cost_two_frames_each_at_most() {
    for format in [Format::PositionQuaternion, Format::PositionAngles, Format::PositionMatrix] {
        let birds = [(1, shape(format, true)), (2, shape(format, true))];
        for fault in [Fault::Lost, Fault::Inserted, Fault::Phase] {
            for reads in [Reads::Records, Reads::Bytes, Reads::Bursts] {
                for seed in 0..10 {
                    let outcome = receive(&damaged(&birds, fault, seed), reads, &birds);
                    let (position_m, rotation_rad) = worst(&outcome.samples);
                    let what = format!("{format} {fault:?} {reads:?} seed {seed}");
                    // One count of position is 0.11 mm; the cycle numbers must be right for this to hold.
                    assert!(
                        position_m < 2.5e-4 && rotation_rad < 2e-3,
                        "{what}: {position_m} m, {rotation_rad} rad"
                    );
                    let mut whole = vec![0; 1000];
                    for sample in &outcome.samples {
                        let DeviceTime::Cycle(cycle) = sample.t_device else { panic!() };
                        whole[cycle as usize] += 1;
                    }
                    let lost = whole.iter().filter(|&&birds| birds != 2).count();
                    assert!(lost <= 100, "{what}: {lost} frames lost");
                    assert!(whole.iter().all(|&birds| birds <= 2), "{what}: a record twice");
                }
            }
        }
    }
}

#[test]
fn a_unit_alone_survives_the_same_faults() {
    let birds = [(0, shape(Format::PositionQuaternion, false))];
    for fault in [Fault::Lost, Fault::Inserted, Fault::Phase] {
        for reads in [Reads::Records, Reads::Bytes, Reads::Bursts] {
            for seed in 0..10 {
                let outcome = receive(&damaged(&birds, fault, seed), reads, &birds);
                let (position_m, rotation_rad) = worst(&outcome.samples);
                let what = format!("{fault:?} {reads:?} seed {seed}");
                assert!(
                    position_m < 2.5e-4 && rotation_rad < 2e-3,
                    "{what}: {position_m} m, {rotation_rad} rad"
                );
                assert!(outcome.samples.len() >= 900, "{what}: {}", outcome.samples.len());
            }
        }
    }
}

#[test]
fn example_9_of_the_sheet_a_lost_byte() {
    let bytes: Vec<u8> = "AA 15 63 79 00 24 55 0A 55 7A 00 20 02 C1 15 63 79 24 55 0A 55 7A 00 20 03 AA 15 7A 79 74 23 02 0B 55 7A 00 20 02"
        .split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect();
    let group = shape(Format::PositionAngles, true);
    let birds = [(2, group), (3, group)];
    let stream: Vec<(f64, u8)> = bytes.iter().map(|&byte| (0.0, byte)).collect();
    let mut outcome = receive(&stream, Reads::Records, &birds);
    assert_eq!(
        outcome.samples.iter().map(|s| (s.address, s.t_device)).collect::<Vec<_>>(),
        [(2, DeviceTime::Cycle(0)), (2, DeviceTime::Cycle(1)),]
    );
    let counters = outcome.splitter.take_counters();
    assert_eq!((counters.records, counters.rejected, counters.bytes_skipped), (2, 1, 12));
}

#[test]
fn what_is_left_of_several_records_leaves_doubt_even_where_its_bytes_are_whole_ones() {
    let shape = shape(Format::PositionQuaternion, true);
    let len = shape.len();
    for (damaged, doubt) in [(1, false), (2, true), (5, true)] {
        let mut splitter = Splitter::new(&[(1, shape)], Scale::default(), Tolerance::LIVE, BAUD);
        let mut stream: Vec<u8> = (0..40).flat_map(|cycle| record_of(1, cycle, shape)).collect();
        // The address of each is another bird's.
        (20..20 + damaged).for_each(|record| stream[(record + 1) * len - 1] = 9);
        let mut after_loss = Vec::new();
        let now = Timestamp::from_secs_f64(1.0);
        splitter.handle_bytes(now, &stream, &mut |event| {
            if let Event::Sample(sample) = event {
                after_loss.push(sample.arrival.after_loss);
            }
        });
        assert_eq!(after_loss.len(), 39 - damaged);
        assert_eq!(after_loss.contains(&true), doubt, "{damaged} records");
    }
}

#[test]
fn a_dead_bird_does_not_stop_the_others_and_may_come_back() {
    let group = shape(Format::PositionQuaternion, true);
    let birds = [(1, group), (2, group), (3, group)];
    for dead in 1..=3_u8 {
        let mut splitter = Splitter::new(&birds, Scale::default(), Tolerance::LIVE, BAUD);
        let mut seen = Vec::new();
        for cycle in 0..60 {
            let now = Timestamp::from_secs_f64(cycle as f64 * 0.01);
            for address in [1, 2, 3] {
                if address == dead && (20..40).contains(&cycle) {
                    continue;
                }
                let record = record_of(address, cycle, group);
                splitter.handle_bytes(now, &record, &mut |event| seen.push((cycle, event)));
                let later = now + Duration::from_millis(1);
                splitter.handle_timeout(later, &mut |event| seen.push((cycle, event)));
            }
        }
        let when = |event: Event| -> Vec<usize> {
            seen.iter().filter(|(_, seen)| *seen == event).map(|(cycle, _)| *cycle).collect()
        };
        // The last of a cycle is missed when the next one begins.
        let missed = if dead == 3 { 23 } else { 22 };
        assert_eq!((when(Event::Left(dead)), when(Event::Returned(dead))), (vec![missed], vec![41]));
        let samples = |address: u16| {
            seen.iter().filter_map(move |(cycle, event)| match event {
                Event::Sample(sample) if sample.address == address => Some((*cycle as u64, sample)),
                _ => None,
            })
        };
        for address in 1..=3 {
            let least = if address == u16::from(dead) { 37 } else { 57 };
            let count = samples(address).count();
            assert!(count >= least, "bird {address} without {dead}: {count}");
            for (cycle, sample) in samples(address) {
                assert_eq!(sample.t_device, DeviceTime::Cycle(cycle), "bird {address} without {dead}");
            }
        }
    }
}

#[test]
fn dropped_bytes_keep_the_count_of_cycles() {
    let group = shape(Format::PositionQuaternion, true);
    let birds = [(1, group), (2, group)];
    let mut splitter = Splitter::new(&birds, Scale::default(), Tolerance::LIVE, BAUD);
    let bytes: Vec<u8> = (0..100)
        .flat_map(|cycle| [record_of(1, cycle, group), record_of(2, cycle, group)].concat())
        .collect();
    let mut samples = Vec::new();
    let mut emit = |event| {
        if let Event::Sample(sample) = event {
            samples.push(sample)
        }
    };
    splitter.handle_bytes(Timestamp::ZERO, &bytes[..1000], &mut emit);
    splitter.handle_dropped(777);
    splitter.handle_bytes(Timestamp::ZERO, &bytes[1777..], &mut emit);
    assert!(worst(&samples).0 < 2.5e-4);
    let counters = splitter.take_counters();
    assert_eq!(counters.records + counters.rejected, 199, "the last one still waits for a stray byte");
}

proptest! {
    /// However the stream is cut into reads, the same records come out.
    #[test]
    fn reads_may_end_anywhere(cuts in prop::collection::vec(1usize..60, 1..80), format in 0usize..7) {
        let group = shape(Format::ALL[format], true);
        let birds = [(1, group), (2, group)];
        let bytes: Vec<u8> =
            (0..20).flat_map(|cycle| [record_of(1, cycle, group), record_of(2, cycle, group)].concat()).collect();
        let run = |cuts: &[usize]| {
            let mut splitter = Splitter::new(&birds, Scale::default(), Tolerance::LIVE, BAUD);
            let mut samples = Vec::new();
            let mut emit = |event| if let Event::Sample(sample) = event { samples.push(sample) };
            let mut rest = &bytes[..];
            for cut in cuts.iter().copied().chain([bytes.len()]) {
                let (now, later) = rest.split_at(cut.min(rest.len()));
                splitter.handle_bytes(Timestamp::ZERO, now, &mut emit);
                rest = later;
            }
            splitter.handle_timeout(Timestamp::from_secs_f64(1.0), &mut emit);
            (samples.iter().map(|s| (s.address, s.t_device, s.measurement)).collect::<Vec<_>>(), splitter.take_counters())
        };
        let (all, counters) = run(&[]);
        prop_assert_eq!(all.len(), 40);
        prop_assert_eq!(counters.bytes_skipped, 0);
        prop_assert_eq!(run(&cuts), (all.clone(), counters));
        let byte_by_byte = vec![1; bytes.len()];
        prop_assert_eq!(run(&byte_by_byte).0, all);
    }

    #[test]
    fn garbage_gives_no_panic_and_every_byte_is_accounted_for(
        chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..40),
        format in 0usize..7,
    ) {
        let group = shape(Format::ALL[format], true);
        let birds = [(1, group), (2, shape(Format::PositionAngles, true)), (7, group)];
        let mut splitter = Splitter::new(&birds, Scale::default(), Tolerance::LIVE, BAUD);
        let mut published = 0;
        let lens: Vec<usize> = birds.iter().map(|(_, shape)| shape.len()).collect();
        let mut emit = |event: Event| if let Event::Sample(sample) = event {
            published += lens[birds.iter().position(|&(address, _)| u16::from(address) == sample.address).unwrap()];
        };
        for (i, chunk) in chunks.iter().enumerate() {
            splitter.handle_bytes(Timestamp::from_nanos(i as i64 * 100_000), chunk, &mut emit);
            splitter.handle_timeout(Timestamp::from_nanos(i as i64 * 100_000 + 50_000), &mut emit);
        }
        splitter.finish();
        let total: usize = chunks.iter().map(Vec::len).sum();
        prop_assert_eq!(published + splitter.take_counters().bytes_skipped as usize, total);
    }
}
