//! Every fault hits what it says, and nothing else.

use posed_drivers::Timestamp;
use posed_drivers::flock::wire::record::{Tolerance, decode};
use posed_drivers::flock::wire::{Format, Scale, Shape};

use super::*;
use crate::scenario::DeviceScenario;
use crate::testing::Host;
use crate::truth::Class;

/// Bytes of a record of the stream below.
const RECORD: usize = 15;

fn seconds(s: f64) -> Timestamp {
    Timestamp::from_secs_f64(s)
}

/// Two birds that stream position and quaternion from 1.9 s on, with this script.
fn streaming(faults: Vec<Fault>) -> Host {
    let device = DeviceScenario { rate_hz: 100.0, faults, ..DeviceScenario::default() };
    let mut host = Host::new(&[1, 2], 115_200, device);
    host.stream_group(2, b']');
    host
}

fn run(faults: Vec<Fault>, until_s: f64) -> Host {
    let mut host = streaming(faults);
    host.wait_until(seconds(until_s));
    host
}

/// What was read between two times.
fn bytes_between(host: &Host, from_s: f64, to_s: f64) -> Vec<u8> {
    let inside = |t: Timestamp| seconds(from_s) <= t && t < seconds(to_s);
    host.chunks.iter().filter(|&&(t, _)| inside(t)).flat_map(|(_, bytes)| bytes.clone()).collect()
}

/// Where a hit byte stands in the undamaged stream.
fn place(hit: &FaultHit, first_cycle: u64) -> usize {
    let frame = (hit.cycle.unwrap() - first_cycle) as usize;
    (2 * frame + usize::from(hit.address.unwrap()) - 1) * RECORD + usize::from(hit.byte.unwrap())
}

fn damaged(fault: fn(Bytes) -> Fault) -> (Vec<u8>, Vec<u8>, Vec<usize>) {
    let clean = run(vec![], 14.0);
    let host = run(vec![fault(Bytes { count: 50, start_s: 3.0, end_s: 13.0 })], 14.0);
    assert_eq!(host.hits.len(), 50);
    assert!(host.hits.iter().all(|hit| seconds(3.0) <= hit.t && hit.t < seconds(13.1)));
    // The first streamed cycle: the first one whose delayed frame leaves after the command.
    let sent = clean.chunks[0].0;
    let first_cycle =
        clean.truth.iter().filter(|cycle| cycle.t < sent).map(|cycle| cycle.cycle).max().unwrap();
    let places = host.hits.iter().map(|hit| place(hit, first_cycle)).collect();
    (clean.read(), host.read(), places)
}

#[test]
fn lost_bytes_are_those_of_the_log() {
    let (mut clean, got, mut places) = damaged(Fault::LostBytes);
    let middles = places.iter().filter(|&&place| place % RECORD > 0 && place % RECORD < RECORD - 1).count();
    assert!((35..50).contains(&middles), "anywhere in the records: {middles}");
    places.sort_unstable();
    for place in places.into_iter().rev() {
        clean.remove(place);
    }
    assert_eq!(clean, got);
}

#[test]
fn inserted_bytes_are_those_of_the_log() {
    let (clean, mut got, mut places) = damaged(Fault::InsertedBytes);
    places.sort_unstable();
    for place in places {
        got.remove(place);
    }
    assert_eq!(clean, got);
}

#[test]
fn flipped_bits_are_those_of_the_log() {
    for (fault, bits) in [(Fault::Bit7Flips as fn(Bytes) -> Fault, 0x80), (Fault::DataBitFlips, 0x7F)] {
        let (clean, got, mut places) = damaged(fault);
        assert_eq!(clean.len(), got.len());
        let differ: Vec<usize> = (0..clean.len()).filter(|&i| clean[i] != got[i]).collect();
        for &i in &differ {
            let flipped = clean[i] ^ got[i];
            assert!(flipped.count_ones() == 1 && flipped & bits != 0, "{flipped:02x}");
        }
        places.sort_unstable();
        assert_eq!(differ, places);
    }
}

#[test]
fn bursts_hold_bytes_back_and_lose_none() {
    let clean = run(vec![], 5.0);
    let host = run(vec![Fault::Bursts { start_s: 3.0, end_s: 4.0, burst_ms: 16.0 }], 5.0);
    assert_eq!(host.read(), clean.read());
    let bursts: Vec<_> =
        host.chunks.iter().filter(|&&(t, _)| seconds(3.02) < t && t < seconds(3.99)).collect();
    assert!(bursts.len() > 50);
    assert!(bursts.iter().all(|(t, _)| t.as_nanos() % 16_000_000 == 0));
}

#[test]
fn an_unplugged_port_says_nothing_and_comes_back() {
    let host = run(vec![Fault::Unplug { at_s: 3.0, duration_s: Some(2.0), power: false }], 6.0);
    assert_eq!(host.plugging, [(seconds(3.0), false), (seconds(5.0), true)]);
    assert_eq!(bytes_between(&host, 3.0, 5.0), b"");
    assert!(bytes_between(&host, 5.0, 6.0).len() > 95 * 2 * RECORD, "the units went on");
    let mut host = run(vec![Fault::Unplug { at_s: 3.0, duration_s: Some(2.0), power: true }], 5.9);
    assert_eq!(bytes_between(&host, 5.0, 6.0), b"", "the units start anew");
    host.wait_until(seconds(6.1));
    assert_eq!(host.ask(b"O\x00", 50.0), [0x08, 0x81]);
}

#[test]
fn a_phase_cut_begins_in_the_middle_of_a_record() {
    let clean = run(vec![], 4.0).read();
    let host = run(vec![Fault::PhaseCut { at_s: 3.0 }], 4.0);
    let got = host.read();
    let missing = clean.len() - got.len();
    assert!((1..13).contains(&missing), "{missing}");
    let (cut, _) = clean.iter().zip(&got).enumerate().find(|(_, (a, b))| a != b).unwrap();
    let cut = cut - cut % RECORD;
    assert_eq!(got[cut..], clean[cut + missing..]);
}

#[test]
fn a_stalled_unit_answers_later() {
    let mut host = run(vec![Fault::Stall { at_s: 3.0, duration_s: 2.0 }], 3.5);
    host.report(b"?O\x01");
    host.wait_until(seconds(4.999));
    assert_eq!(bytes_between(&host, 3.01, 5.0), b"");
    host.wait_until(seconds(5.2));
    assert_eq!(bytes_between(&host, 5.0, 6.0), [3, 67]);
}

#[test]
fn a_power_cycle_forgets_everything() {
    let mut host = run(vec![Fault::PowerCycle { at_s: 3.0 }], 4.1);
    assert_eq!(bytes_between(&host, 3.001, 4.1), b"");
    assert_eq!(host.ask(b"O\x23", 50.0), [0], "group mode is off");
}

/// Addresses of the records between two times.
fn addresses(host: &Host, from_s: f64, to_s: f64) -> Vec<u8> {
    let bytes = bytes_between(host, from_s, to_s);
    let starts: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i] & 0x80 != 0).collect();
    starts[1..].iter().map(|&start| bytes[start - 1]).collect()
}

#[test]
fn a_dead_bird_is_missing_until_it_returns() {
    let mut host = run(vec![Fault::BirdDies { address: 2, at_s: 3.0, duration_s: Some(1.0) }], 3.5);
    assert!(addresses(&host, 2.5, 3.0).contains(&2));
    assert!(addresses(&host, 3.02, 3.5).iter().all(|&address| address == 1));
    host.ask(b"?", 50.0);
    assert_eq!(host.ask(b"O\x10", 50.0), [13, 2]);
    assert_eq!(host.ask(b"O\x24", 100.0)[..2], [0xE1, 0]);
    host.report(b"@");
    host.truth.clear();
    host.wait_until(seconds(4.7));
    assert!(addresses(&host, 4.02, 4.7).contains(&2));
    let class = |t: f64| host.truth.iter().find(|cycle| cycle.t > seconds(t)).unwrap().sensors[1].class;
    assert_eq!((class(4.1), class(4.6)), (Class::Disturbed, Class::Clean), "it settles after its return");
}

/// Records of bird 2 whose cycles lie between two times, decoded, with the class of each.
fn second_bird(host: &Host, from_s: f64, to_s: f64) -> Vec<(Option<[f64; 3]>, Class, [f64; 3])> {
    let shape = Shape { format: Format::PositionQuaternion, button: false, group: true };
    let sent = host.chunks[0].0;
    let first = host.truth.iter().rposition(|cycle| cycle.t < sent).unwrap();
    let bytes = host.read();
    let frames = bytes.chunks_exact(2 * RECORD).zip(&host.truth[first..]);
    frames
        .filter(|(_, cycle)| seconds(from_s) < cycle.t && cycle.t < seconds(to_s))
        .map(|(frame, cycle)| {
            let record = decode(&frame[RECORD..], shape, Scale::default(), Tolerance::CAPTURE);
            let transmitter = nalgebra::Isometry3::from_parts(
                [0.2, 0.1, 1.0].into(),
                crate::motion::quaternion([0.0, 1.0, 0.0, 0.0]),
            );
            let row = cycle.sensors[1];
            let truth = (transmitter.inverse() * row.pose).translation.vector;
            (record.ok().and_then(|record| record.position_m), row.class, truth.into())
        })
        .collect()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (nalgebra::Vector3::from(a) - nalgebra::Vector3::from(b)).norm()
}

#[test]
fn a_flipped_hemisphere_mirrors_the_position() {
    let host = run(vec![Fault::HemisphereFlip { address: 2, at_s: 3.0, duration_s: 0.5 }], 4.0);
    for (record, class, truth) in second_bird(&host, 3.0, 3.5) {
        assert_eq!(class, Class::Inverted);
        assert!(distance(record.unwrap(), truth.map(|x| -x)) < 2e-3);
    }
    for (record, class, truth) in second_bird(&host, 3.5, 3.9) {
        assert_eq!(class, Class::Clean);
        assert!(distance(record.unwrap(), truth) < 2e-3);
    }
    assert!((49..=51).contains(&host.hits.len()), "each record that was hit is in the log");
}

#[test]
fn out_of_range_freezes_and_jumps() {
    let host = run(vec![Fault::OutOfRange { address: 2, at_s: 3.0, duration_s: 0.5 }], 4.0);
    let frozen = second_bird(&host, 3.0, 3.5);
    assert!(frozen.len() >= 49);
    assert!(frozen.iter().all(|&(record, class, _)| class == Class::Stuck && record == frozen[0].0));
    let after = second_bird(&host, 3.5, 3.9);
    assert_eq!(after[0].1, Class::Jump);
    assert!(distance(after[0].0.unwrap(), frozen[0].0.unwrap()) > 0.01);
    assert!(
        after[1..].iter().all(|&(record, class, truth)| {
            class == Class::Clean && distance(record.unwrap(), truth) < 2e-3
        })
    );
}

#[test]
fn a_bad_matrix_is_no_rotation() {
    let host = run(vec![Fault::BadMatrix { address: 2, at_s: 3.0, duration_s: 0.2 }], 4.0);
    let hit = second_bird(&host, 3.0, 3.2);
    assert!(hit.len() >= 19 && hit.iter().all(|&(record, ..)| record.is_none()));
    assert!(second_bird(&host, 3.2, 3.9).iter().all(|&(record, ..)| record.is_some()));
}

#[test]
fn error_codes_wait_to_be_read_and_fatal_ones_stop_the_unit() {
    let mut host = run(vec![Fault::Error { address: 1, at_s: 3.0, code: 32, detail: 0 }], 3.5);
    assert!(bytes_between(&host, 3.2, 3.5).len() > 20 * 2 * RECORD, "a warning stops nothing");
    host.ask(b"?", 50.0);
    assert_eq!(host.ask(b"O\x00", 50.0)[1] & 0x20, 0x20);
    assert_eq!(host.ask(b"O\x0A", 50.0), [32]);
    let host = run(vec![Fault::Error { address: 1, at_s: 3.0, code: 1, detail: 0 }], 3.5);
    assert_eq!(bytes_between(&host, 3.05, 3.5), b"");
}

#[test]
fn another_baud_rate_is_garbage_both_ways() {
    let mut host = streaming(vec![]);
    host.stage.device_mut(0).set_host_baud(9600);
    let garbage = host.ask(b"?", 1000.0);
    assert!(!garbage.is_empty(), "the command was not understood, the stream goes on");
    assert!(garbage.len() < 100 * 2 * RECORD / 4);
    host.stage.device_mut(0).set_host_baud(115_200);
    host.ask(b"?", 100.0);
    assert_eq!(host.ask(b"O\x01", 50.0), [3, 67]);
}
