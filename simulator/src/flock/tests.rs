//! The virtual Flock against what real ones were seen to do.

use posed_drivers::Timestamp;
use posed_drivers::flock::wire::record::{Tolerance, decode};
use posed_drivers::flock::wire::{Format, Range, Scale, Shape};

use crate::scenario::DeviceScenario;
use crate::testing::{Host, scenario, stage};
use crate::truth::Class;

fn alone(baud: u32) -> Host {
    Host::new(&[0], baud, DeviceScenario { revision: [3, 60], ..DeviceScenario::default() })
}

fn pair(baud: u32) -> Host {
    Host::new(&[1, 2], baud, DeviceScenario::default())
}

/// Milliseconds from the question to the first and to the last chunk of the answer.
fn latency_ms(host: &mut Host, question: &[u8]) -> (f64, f64) {
    let start = host.now;
    host.ask(question, 100.0);
    let ms = |t: Timestamp| t.seconds_since(start) * 1e3;
    (ms(host.chunks[0].0), ms(host.chunks.last().unwrap().0))
}

#[test]
fn a_stand_alone_unit_answers_as_recorded() {
    let mut host = alone(19200);
    assert_eq!(host.ask(b"O\x01", 100.0), [0x03, 0x3C]);
    assert_eq!(host.ask(b"O\x03", 100.0), [0, 0]);
    assert_eq!(host.ask(b"O\x00", 100.0), [0x08, 0xD1]);
    assert_eq!(host.ask(b"O\x24", 100.0), [0; 14]);
    assert_eq!(host.ask(b"O\x0F", 100.0), b"6DFOB     ");
    let (_, last) = latency_ms(&mut host, b"O\x01");
    assert!((4.3..5.3).contains(&last), "{last}");
    let (_, last) = latency_ms(&mut host, b"O\x0F");
    assert!((8.4..9.4).contains(&last), "{last}");
    let (_, last) = latency_ms(&mut host, b"\x5DB");
    assert!((10.1..10.6).contains(&last), "a polled record of 14 bytes: {last}");
}

#[test]
fn a_pair_answers_as_recorded() {
    let mut host = pair(19200);
    assert_eq!(host.ask(b"O\x01", 100.0), [0x03, 0x43]);
    assert_eq!(host.ask(b"O\x00", 100.0), [0x08, 0x81]);
    let status = host.ask(b"O\x24", 100.0);
    assert_eq!(status, [&[0xA1, 0xE0][..], &[0; 12]].concat());
    let (first, _) = latency_ms(&mut host, b"O\x24");
    assert!((42.0..52.0).contains(&first), "{first}");
    let (first, _) = latency_ms(&mut host, b"O\x01");
    assert!((7.0..11.0).contains(&first), "{first}");
    let (first, _) = latency_ms(&mut host, b"\xF2O\x19");
    assert!((8.0..11.0).contains(&first), "{first}");
    let (_, last) = latency_ms(&mut host, b"O\x0F");
    assert!((13.0..16.0).contains(&last), "{last}");
    // Reset, then configuration 27 ms later; a question meanwhile waits and is answered.
    host.ask(b"/", 27.0);
    let start = host.now;
    host.ask(b"P\x32\x02", 50.0);
    host.chunks.clear();
    host.report(b"O\x16");
    host.wait_ms(400.0);
    assert_eq!(host.read(), [0, 0]);
    let answered_ms = host.chunks[0].0.seconds_since(start) * 1e3;
    assert!((270.0..290.0).contains(&answered_ms), "{answered_ms}");
    assert_eq!(host.ask(b"P\x16\x00\x01O\x16", 100.0), [0, 1]);
    assert_eq!(host.ask(b"O\x00", 100.0), [0x08, 0xD1]);
    assert_eq!(host.ask(b"O\x24", 100.0)[..2], [0xE1, 0xE0]);
    assert_eq!(host.ask(b"\xF2O\x15", 100.0), [2]);
    assert_eq!(host.ask(b"O\x32", 100.0), [1, 0b110, 0, 0b110, 0]);
}

/// Lengths of the records that arrive in the next while, by address.
fn records(host: &mut Host, ms: f64) -> Vec<(u8, usize)> {
    let bytes = host.ask(b"", ms);
    let starts: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i] & 0x80 != 0).collect();
    starts.windows(2).map(|pair| (bytes[pair[1] - 1], pair[1] - pair[0])).collect()
}

/// What the host writes, and how long it waits then, ms.
type Step<'a> = (&'a [u8], f64);

#[test]
fn the_start_up_sequences_in_use_lead_to_a_stream() {
    let steps: [(&str, &[Step]); 6] = [
        (
            "VRPN",
            &[
                (b"B", 5000.0),
                (b"P\x32\x02", 10000.0),
                (b"O\x24", 800.0),
                (b"P\x23\x01", 100.0),
                (b"\xF1]\xF1L\x00\x00\xF2]\xF2L\x00\x00", 100.0),
                (b"@", 50.0),
            ],
        ),
        (
            "VR Juggler",
            &[
                (b"P\x23\x01", 100.0),
                (b"O\x01", 250.0),
                (b"O\x13", 250.0),
                (b"O\x15", 250.0),
                (b"O\x24", 250.0),
                (b"\xF1L\x00\x00\xF1]\xF2L\x00\x00\xF2]", 100.0),
                (b"0\x10", 1000.0),
                (b"P\x32\x02", 1500.0),
                (b"Q", 30.0),
                (b"@", 50.0),
            ],
        ),
        (
            "Vrui",
            &[
                (b"\xF1O\x00", 100.0),
                (b"\xF2O\x00", 450.0),
                (b"P\x32\x02", 600.0),
                (b"P\x23\x01", 100.0),
                (b"\xF1Y\xF1L\x00\x00\xF1P\x03\x01\x00", 50.0),
                (b"\xF2Y\xF2L\x00\x00\xF2P\x03\x01\x00", 50.0),
                (b"0\x10", 100.0),
                (b"F", 200.0),
                (b"@", 50.0),
            ],
        ),
        (
            "FreeVR",
            &[
                (b"B", 100.0),
                (b"P\x23\x00", 50.0),
                (b"G", 300.0),
                (b"O\x0A", 50.0),
                (b"O\x0A", 50.0),
                (b"O\x13", 50.0),
                (b"O\x32", 50.0),
                (b"O\x24", 250.0),
                (b"\xF2O\x01", 50.0),
                (b"0\x10", 300.0),
                (b"P\x32\x02", 400.0),
                (b"P\x23\x01", 50.0),
                (b"\xF1Y\xF1L\x00\x00\xF1M\x00\xF2Y\xF2L\x00\x00\xF2M\x00", 50.0),
                (b"F", 200.0),
                (b"R@", 50.0),
            ],
        ),
        (
            "VESS",
            &[
                (b"B", 500.0),
                (b"O\x00", 100.0),
                (b"O\x24", 250.0),
                (b"O\x0F", 100.0),
                (b"P\x23\x01", 1000.0),
                (b"P\x32\x02", 2000.0),
                (b"B", 100.0),
                (b"@", 50.0),
            ],
        ),
        (
            "the recording",
            &[
                (b"O\x01", 50.0),
                (b"O\x03", 50.0),
                (b"O\x00", 50.0),
                (b"O\x24", 100.0),
                (b"/", 27.0),
                (b"P\x32\x02", 300.0),
                (b"P\x23\x01", 50.0),
                (b"\xF1O\x01\xF1O\x0F\xF1O\x19", 100.0),
                (b"\xF1L\x00\x00\xF1Z\xF1M\x01\xF2L\x00\x00\xF2Z\xF2M\x01", 50.0),
                (b"@", 50.0),
            ],
        ),
    ];
    for (name, steps) in steps {
        let mut host = pair(115_200);
        for (bytes, wait_ms) in steps {
            host.ask(bytes, *wait_ms);
        }
        let len = match name {
            "VRPN" | "VR Juggler" => 15,
            "the recording" => 26,
            _ => 13,
        };
        let records = records(&mut host, 200.0);
        assert!(records.len() > 15, "{name}: {records:?}");
        for pair in records.windows(2) {
            assert_eq!(pair[0].1, len, "{name}");
            assert_eq!(pair[0].0 + pair[1].0, 3, "{name}: birds 1 and 2 take turns");
        }
        host.ask(b"?", 50.0);
        assert_eq!(host.ask(b"O\x0A", 100.0), [0], "{name} leaves no error behind");
    }
}

#[test]
fn a_slow_line_skips_whole_frames() {
    let mut host = pair(19200);
    host.stream_group(2, b'Y');
    host.report(b"\xF1M\x01\xF2M\x01");
    host.wait_ms(100.0);
    let bytes = host.ask(b"", 1000.0);
    // 2 x 14 bytes take 14.6 ms, a cycle 9.7 ms: every second cycle.
    let frames = bytes.iter().filter(|&&byte| byte & 0x80 != 0).count() / 2;
    assert!((51..=52).contains(&frames), "{frames}");
    assert!(host.losses.len() > 50);
}

#[test]
fn as_many_birds_fit_as_the_sheet_says() {
    for (baud, fits) in
        [(19200, [2, 1, 1, 0]), (38400, [5, 2, 2, 1]), (57600, [7, 4, 3, 2]), (115_200, [14, 8, 7, 4])]
    {
        for (format, fits) in b"VY]Z".iter().zip(fits) {
            for (birds, full_rate) in [(fits, true), (fits + 1, false)] {
                // 15 birds fit in position format, but normal addressing ends at 14.
                if birds == 0 || birds > 14 {
                    continue;
                }
                let addresses: Vec<u16> = (1..=birds).collect();
                let mut host = Host::new(&addresses, baud, DeviceScenario::default());
                host.stream_group(birds as u8, *format);
                host.wait_ms(600.0);
                assert_eq!(host.losses.is_empty(), full_rate, "{birds} birds, {} at {baud}", *format as char);
            }
        }
    }
}

#[test]
fn errors_are_noted_and_read_once() {
    let mut host = pair(115_200);
    assert_eq!(host.ask(b"!", 50.0), b"");
    assert_eq!(host.ask(b"O\x00", 50.0), [0x08, 0xA1], "bit 13");
    assert_eq!(host.ask(b"O\x0A", 50.0), [6]);
    assert_eq!(host.ask(b"O\x0A", 50.0), [0]);
    assert_eq!(host.ask(b"O\x77", 50.0), b"", "an unknown parameter");
    assert_eq!(host.ask(b"O\x10", 50.0), [6, 0]);
    assert_eq!(host.ask(b"O\x1A", 50.0), b"", "this revision does not know it");
    assert_eq!(host.ask(b"O\x0A", 50.0), [6]);
    assert_eq!(host.ask(b"\xF7O\x00", 50.0), b"", "there is no unit 7");
    assert_eq!(host.ask(b"O\x10", 50.0), [13, 7]);
    host.ask(b"P\x32\x05", 400.0);
    assert_eq!(host.ask(b"O\x10", 50.0), [13, 3], "unit 3 is the first one missing");
}

#[test]
fn stand_alone_streams_every_cycle_and_stops_with_one_more_record() {
    let mut host = alone(19200);
    host.ask(b"Y", 20.0);
    host.report(b"@");
    let bytes = host.ask(b"", 1000.0);
    assert!((12 * 103..=12 * 104).contains(&bytes.len()), "{}", bytes.len());
    host.wait_until(Timestamp::from_secs_f64(4.0));
    let rest = host.ask(b"B", 100.0);
    assert!((12..=24).contains(&rest.len()), "what was on its way and one more record: {}", rest.len());
    assert_eq!(host.ask(b"", 100.0), b"");
}

#[test]
fn report_rates_sleep_and_flow_control() {
    let mut host = alone(115_200);
    host.ask(b"VR@", 50.0);
    let count = |bytes: Vec<u8>| bytes.len() / 6;
    assert!((51..=52).contains(&count(host.ask(b"", 1000.0))));
    host.ask(b"T", 400.0);
    assert!((3..=4).contains(&count(host.ask(b"", 1000.0))));
    host.ask(b"Q", 400.0);
    host.report(b"\x13");
    host.wait_ms(20.0);
    assert_eq!(host.ask(b"O\x01", 100.0), b"");
    let bytes = host.ask(b"\x11", 15.0);
    assert_eq!(bytes[..2], [3, 60], "the answer that was held back");
    host.ask(b"G", 50.0);
    assert_eq!(host.ask(b"O\x00", 50.0), [0x22, 0xC1], "asleep, not running, position");
    assert_eq!(host.ask(b"", 100.0), b"");
    assert_eq!(host.ask(b"FB", 50.0).len(), 6);
}

#[test]
fn all_addressing_modes_reach_their_units() {
    let mut host = Host::new(&[1, 2, 20], 115_200, DeviceScenario::default());
    assert_eq!(host.ask(b"O\x13", 50.0), [1]);
    assert_eq!(host.ask(b"\xE4O\x15", 50.0), [20]);
    assert_eq!(host.ask(b"O\x24", 100.0).len(), 30);
    let mut host = Host::new(&[1, 100], 115_200, DeviceScenario::default());
    assert_eq!(host.ask(b"O\x13", 50.0), [3]);
    assert_eq!(host.ask(b"\xA0\x64O\x15", 50.0), [100]);
    assert_eq!(host.ask(b"O\x24", 200.0).len(), 126);
    let mut host = Host::new(&[2, 3], 115_200, DeviceScenario::default());
    assert_eq!(host.ask(b"O\x0F", 50.0), b"6DERC     ");
    host.ask(b"P\x32\x03", 400.0);
    assert_eq!(host.ask(b"O\x24", 100.0)[..3], [0xD1, 0xE0, 0xE0]);
    host.ask(b"P\x23\x01@", 10.0);
    assert!(records(&mut host, 100.0).iter().all(|&(address, _)| address == 2 || address == 3));
}

#[test]
fn the_reset_line_starts_the_unit_anew() {
    let mut host = pair(115_200);
    host.stream_group(2, b'Y');
    host.wait_ms(100.0);
    let now = host.now;
    host.stage.device_mut(0).handle_rts(now, true);
    assert_eq!(host.ask(b"O\x01", 100.0), b"", "held in reset");
    let now = host.now;
    host.stage.device_mut(0).handle_rts(now, false);
    assert_eq!(host.ask(b"O\x01", 500.0), b"", "still starting");
    host.wait_ms(600.0);
    assert_eq!(host.ask(b"O\x00", 100.0), [0x08, 0x81]);
}

#[test]
fn records_in_every_format_agree_with_the_truth() {
    for format in Format::ALL {
        let mut spec = stage(&[1, 2], 115_200);
        spec.sensors.reverse();
        let mut host =
            Host::with(&spec, &scenario(DeviceScenario { rate_hz: 100.0, ..DeviceScenario::default() }));
        host.stream_group(2, format.command());
        host.wait_ms(1200.0);
        let bytes = host.read();
        let shape = Shape { format, button: false, group: true };
        let mut frames = 0;
        for frame in bytes.chunks_exact(2 * shape.len()).skip(60) {
            // The frame's truth is that of the cycle whose capture time fits: 2 ms before the first bit.
            frames += 1;
            let nearest = host.truth.iter().map(|cycle| {
                cycle
                    .sensors
                    .iter()
                    .zip(frame.chunks_exact(shape.len()))
                    .map(|(row, record)| {
                        let record = decode(
                            record,
                            shape,
                            Scale { range: Range::In36, ..Scale::default() },
                            Tolerance::LIVE,
                        )
                        .unwrap();
                        assert_eq!(record.address, Some(2 - row.sensor as u8));
                        let transmitter = nalgebra::Isometry3::from_parts(
                            [0.2, 0.1, 1.0].into(),
                            crate::motion::quaternion([0.0, 1.0, 0.0, 0.0]),
                        );
                        let truth = transmitter.inverse() * row.pose;
                        let metres = record
                            .position_m
                            .map_or(0.0, |p| (nalgebra::Vector3::from(p) - truth.translation.vector).norm());
                        let radians = record
                            .orientation_wxyz
                            .map_or(0.0, |q| crate::motion::quaternion(q).angle_to(&truth.rotation));
                        metres.max(radians)
                    })
                    .fold(0.0, f64::max)
            });
            let best = nearest.fold(f64::INFINITY, f64::min);
            assert!(best < 2e-3, "{format}: {best}");
        }
        assert!(frames > 45, "{format}: {frames}");
    }
}

#[test]
fn capture_times_precede_the_first_bit_by_the_stated_delay_and_drift_with_the_clock() {
    let device =
        DeviceScenario { drift_ppm: 50.0, rate_hz: 100.0, fifo_bytes: 1, ..DeviceScenario::default() };
    let mut host = Host::new(&[0], 115_200, device);
    host.report(b"Y@");
    host.wait_until(Timestamp::from_secs_f64(20.0));
    let truth: Vec<Timestamp> = host.truth.iter().map(|cycle| cycle.t).collect();
    let period_s = truth[1900].seconds_since(truth[900]) / 1000.0;
    assert!((period_s - 0.01 * 1.000_05).abs() < 1e-9, "{period_s}");
    let first_byte = 10.0 / 115_200.0;
    let firsts: Vec<Timestamp> =
        host.chunks.iter().filter(|(_, bytes)| bytes[0] & 0x80 != 0).map(|&(t, _)| t).collect();
    assert!(firsts.len() > 1800);
    for t in firsts {
        let delays = truth.iter().map(|capture| (t.seconds_since(*capture) - 2e-3 - first_byte).abs());
        assert!(delays.fold(f64::INFINITY, f64::min) < 1e-7);
    }
}

#[test]
fn the_first_half_second_is_bad_and_said_to_be() {
    let mut host = pair(115_200);
    host.stream_group(2, b'Z');
    host.wait_ms(600.0);
    let classes: Vec<Class> = host.truth.iter().map(|cycle| cycle.sensors[0].class).collect();
    assert!(classes[..50].iter().all(|&class| class == Class::Disturbed));
    assert!(classes[53..].iter().all(|&class| class == Class::Clean), "{classes:?}");
    assert!(host.truth[0].sensors[1].distortion_m.norm() > 0.1);
}

#[test]
fn same_seed_same_bytes() {
    let run = |seed| {
        let mut scenario = scenario(DeviceScenario::default());
        scenario.seed = seed;
        let mut host = Host::with(&stage(&[1, 2], 115_200), &scenario);
        host.stream_group(2, b']');
        host.wait_ms(1000.0);
        (host.chunks, host.truth)
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3).0, run(4).0);
}

#[test]
fn steps_of_any_length_give_the_same_bytes() {
    let run = |step_ms: f64| {
        let mut host = pair(115_200);
        host.stream_group(2, b']');
        while host.now < Timestamp::from_secs_f64(3.0) {
            host.wait_ms(step_ms);
        }
        host.wait_until(Timestamp::from_secs_f64(3.5));
        host.chunks
    };
    assert_eq!(run(0.37), run(500.0));
}
