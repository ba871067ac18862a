//! What devices do wrong: birds that flip, freeze, die and start badly, ports that vanish, units that restart.
//!
//! What is published as good is right from the first frame to the last; what is left of the device goes on.

use posed_drivers::State;
use posed_drivers::flock::wire::Format;
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::scenario::DeviceScenario;
use posed_simulator::truth::Class;
use posed_stage::output::SensorState;
use posed_stage::{Driver, Stage};

use super::judge::{Judgement, class_at, counted, cycles, judge, lost, within};
use super::{QUIET, device, pair, scene};
use posed_rig::{Rig, Said, stage};

/// A pair with these faults, run until then; nothing published as good may be wrong.
fn run(faults: Vec<Fault>, until_s: f64) -> Rig {
    let mut rig = pair(3, QUIET, device(0, faults));
    rig.run_until(until_s);
    never_wrong(&rig, 0, until_s);
    rig
}

fn never_wrong(rig: &Rig, device: usize, until_s: f64) -> Judgement {
    let judgement = judge(rig, device, 0.0, until_s, QUIET);
    assert!(judgement.good > 200, "{judgement:?}");
    assert_eq!(judgement.wrong(), 0, "{:#?}", judgement.examples);
    judgement
}

/// When a sensor is first published as `ok` after `t_s`, in seconds after it, on the host's clock.
fn back_after(rig: &Rig, sensor: usize, t_s: f64) -> f64 {
    let ok =
        |emitted: &Said| matches!(emitted, Said::Estimate(e) if e.sensors[sensor].state == SensorState::Ok);
    let mut emitted = rig.emitted.iter().zip(&rig.said_at);
    let found = emitted.find(|(emitted, at)| at.as_secs_f64() > t_s && ok(emitted));
    found.expect("it does not come back").1.as_secs_f64() - t_s
}

/// Frames of a span in which a sensor is in one of these states, and all frames of it.
fn count(rig: &Rig, sensor: usize, span: (f64, f64), states: &[SensorState]) -> (usize, usize) {
    let frames = || within(rig, span.0, span.1);
    (frames().filter(|e| states.contains(&e.sensors[sensor].state)).count(), frames().count())
}

fn warned(rig: &Rig, words: &str) -> bool {
    rig.emitted.iter().any(|emitted| matches!(emitted, Said::Warning(_, text) if text.contains(words)))
}

#[test]
fn the_bad_first_half_second_is_not_published() {
    let rig = run(Vec::new(), 6.0);
    let cycles = cycles(&rig, 0);
    let disturbed = cycles.iter().filter(|cycle| cycle.sensors[0].class == Class::Disturbed).count();
    assert!(disturbed > 40, "the simulated birds start badly: {disturbed}");
    let counters = rig.pipeline.status().devices[0].counters;
    assert_eq!((counters.rejected, counters.bytes_skipped), (0, 0), "a bad start is no fault of the line");
    let first_s = back_after(&rig, 0, 0.0);
    println!("from the opening of the port to the first pose: {first_s:.2} s (the unit boots for 1 s)");
}

#[test]
fn a_flipped_bird_is_turned_back_or_marked() {
    let rig = run(vec![Fault::HemisphereFlip { address: 2, at_s: 6.0, duration_s: 2.0 }], 10.0);
    let (good, frames) = count(&rig, 1, (6.02, 7.98), &[SensorState::Repaired]);
    println!("one bird flipped: {good} of {frames} frames repaired");
    assert_eq!(good, frames);
    assert_eq!(count(&rig, 0, (5.0, 10.0), &[SensorState::Ok]).0, within(&rig, 5.0, 10.0).count());
    assert_eq!(count(&rig, 1, (8.02, 10.0), &[SensorState::Ok]).0, within(&rig, 8.02, 10.0).count());
}

#[test]
fn all_birds_flipped_at_once_are_turned_back() {
    let flip = |address| Fault::HemisphereFlip { address, at_s: 6.0, duration_s: 2.0 };
    let rig = run(vec![flip(1), flip(2)], 10.0);
    for sensor in 0..2 {
        let (good, frames) = count(&rig, sensor, (6.02, 7.98), &[SensorState::Repaired]);
        assert_eq!(good, frames, "sensor {sensor}");
    }
}

#[test]
fn a_bird_out_of_range_is_not_good_and_its_jump_neither() {
    let rig = run(vec![Fault::OutOfRange { address: 2, at_s: 6.0, duration_s: 2.0 }], 10.0);
    let (stuck, frames) = count(&rig, 1, (6.06, 7.98), &[SensorState::Stuck]);
    println!(
        "out of range: {stuck} of {frames} frames stuck, ok again {:.3} s after",
        back_after(&rig, 1, 8.0)
    );
    assert_eq!(stuck, frames);
    assert_eq!(count(&rig, 0, (5.0, 10.0), &[SensorState::Ok]).0, within(&rig, 5.0, 10.0).count());
    let cycles = cycles(&rig, 0);
    assert!(within(&rig, 8.0, 8.1).any(|e| class_at(&cycles, e.t_valid.as_secs_f64(), 1) == Class::Jump));
}

#[test]
fn a_dying_bird_costs_the_other_nothing_and_returns() {
    let dies = Fault::BirdDies { address: 2, at_s: 6.0, duration_s: Some(2.0) };
    let mut rig = pair(3, QUIET, device(0, vec![dies]));
    rig.run_until(5.0);
    let (from_s, before) = counted(&rig, 0);
    rig.run_until(12.0);
    never_wrong(&rig, 0, 12.0);
    let status = rig.pipeline.status();
    let not_ok = within(&rig, 5.0, 12.0).filter(|e| e.sensors[0].state != SensorState::Ok);
    let not_ok: Vec<_> = not_ok.map(|e| (e.t_valid.as_secs_f64(), e.sensors[0].state)).collect();
    assert_eq!(status.sensors[0].lost, before[0], "bird 1: {not_ok:?}");
    assert_eq!(status.sensors[1].lost - before[1], lost(&rig, 0, 1, from_s), "bird 2");
    assert_eq!(count(&rig, 1, (6.02, 7.98), &[SensorState::Missing]).0, within(&rig, 6.02, 7.98).count());
    let back_s = back_after(&rig, 1, 8.0);
    println!("a bird that had died: ok {back_s:.2} s after it is there again");
    assert!(back_s < 1.0, "{back_s}");
    assert!(warned(&rig, "bird 2"));
}

#[test]
fn a_bird_that_is_not_there_at_set_up_joins_when_it_appears() {
    let absent = Fault::BirdDies { address: 2, at_s: 0.0, duration_s: Some(6.0) };
    let mut rig = pair(3, QUIET, device(0, vec![absent]));
    rig.run_until(20.0);
    never_wrong(&rig, 0, 20.0);
    assert!(count(&rig, 0, (4.0, 6.0), &[SensorState::Ok]).0 > 150, "the other streams meanwhile");
    let back_s = back_after(&rig, 1, 6.0);
    println!("a bird absent at set-up: ok {back_s:.2} s after it appears");
    let (ok, frames) = count(&rig, 0, (15.0, 20.0), &[SensorState::Ok]);
    assert_eq!((ok, count(&rig, 1, (15.0, 20.0), &[SensorState::Ok]).0), (frames, frames));
}

/// Two flocks; a fault of the first.
fn two(fault: Fault, until_s: f64) -> Rig {
    let devices = vec![device(0, vec![fault]), DeviceScenario { rate_hz: 90.0, ..device(1, Vec::new()) }];
    let scenario = scene(3, QUIET, &["s0-0", "s0-1", "s1-0", "s1-1"], devices);
    let mut rig = Rig::new(&stage(&[2, 2]), &scenario);
    rig.run_until(5.0);
    let (_, before) = counted(&rig, 1);
    rig.run_until(until_s);
    never_wrong(&rig, 0, until_s);
    let status = rig.pipeline.status();
    // Frames that hold no sample of the slower device are none that it has lost.
    for (sensor, before) in before.iter().enumerate().skip(2) {
        assert_eq!(status.sensors[sensor].lost, *before, "the second device's sensor {sensor}");
    }
    let span = (5.0, until_s - 0.1);
    let held = within(&rig, span.0, span.1).filter(|e| e.sensors[2].state == SensorState::Ok).count();
    let measured = cycles(&rig, 1).iter().filter(|c| (span.0..span.1).contains(&c.t.as_secs_f64())).count();
    assert!(held.abs_diff(measured) <= 1, "the second device: {held} of {measured} published");
    rig
}

#[test]
fn a_port_that_was_away_is_back_within_a_second_and_costs_others_nothing() {
    let rig = two(Fault::Unplug { at_s: 6.0, duration_s: Some(2.0), power: false }, 14.0);
    let back_s = back_after(&rig, 0, 8.0);
    println!("port away for 2 s: poses {back_s:.3} s after it is back");
    assert!(back_s < 1.0, "{back_s}");
}

#[test]
fn a_unit_switched_off_and_on_is_back_within_a_second_of_its_own_reset() {
    let boot_s = DeviceScenario::default().boot_ms * 1e-3;
    for (what, fault, on_s) in [
        ("power cycle", Fault::PowerCycle { at_s: 6.0 }, 6.0),
        ("unplugged with its power", Fault::Unplug { at_s: 4.0, duration_s: Some(2.0), power: true }, 6.0),
    ] {
        let rig = run(vec![fault], 14.0);
        let back_s = back_after(&rig, 0, on_s + 0.05) + 0.05 - boot_s;
        println!("{what}: poses {back_s:.3} s after the unit is ready");
        assert!(back_s < 1.9, "{what}: {back_s}");
    }
}

#[test]
fn a_stalled_unit_goes_on_and_all_that_it_did_not_send_is_counted() {
    let mut rig = pair(3, QUIET, device(0, vec![Fault::Stall { at_s: 6.0, duration_s: 2.0 }]));
    rig.run_until(5.0);
    let (from_s, before) = counted(&rig, 0);
    rig.run_until(14.0);
    never_wrong(&rig, 0, 14.0);
    println!("stalled for 2 s: poses {:.3} s after", back_after(&rig, 0, 8.0));
    let status = rig.pipeline.status().sensors[0];
    let reported = status.lost - before[0];
    let truth = lost(&rig, 0, 0, from_s);
    println!("stalled for 2 s: {reported} counted as lost, {truth} in truth");
    assert!(status.estimated && reported.abs_diff(truth) <= 2, "{reported} of {truth}");
}

#[test]
fn a_slow_line_skips_cycles_and_keeps_its_times() {
    let mut stage: Stage = stage(&[2]);
    stage.devices[0].baud = 19_200;
    if let Driver::FlockOfBirds(settings) = &mut stage.devices[0].driver {
        settings.format = Format::PositionMatrix;
    }
    let mut rig = Rig::new(&stage, &scene(3, QUIET, &["s0-0", "s0-1"], vec![device(0, Vec::new())]));
    rig.run_until(14.0);
    never_wrong(&rig, 0, 14.0);
    assert!(warned(&rig, "19200"));
    let frames = within(&rig, 4.0, 13.0).count();
    assert!(frames.abs_diff(300) <= 1, "50 bytes take three cycles of 10 ms: {frames} frames in 9 s");
    assert!(within(&rig, 4.0, 13.0).all(|e| e.sensors.iter().all(|s| s.state == SensorState::Ok)));
    assert_eq!(rig.pipeline.status().devices[0].state, State::Streaming);
}

#[test]
fn matrices_that_are_no_rotation_and_cut_frames_are_dropped() {
    let faults = vec![
        Fault::BadMatrix { address: 1, at_s: 6.0, duration_s: 0.5 },
        Fault::PhaseCut { at_s: 7.0 },
        Fault::PhaseCut { at_s: 7.5 },
    ];
    let rig = run(faults, 10.0);
    assert_eq!(count(&rig, 0, (6.01, 6.49), &[SensorState::Missing]).0, within(&rig, 6.01, 6.49).count());
    let (ok, frames) = count(&rig, 1, (5.0, 10.0), &[SensorState::Ok]);
    assert!(frames - ok <= 4, "two cut frames cost the other bird {}", frames - ok);
    assert_eq!(count(&rig, 0, (8.0, 10.0), &[SensorState::Ok]).0, within(&rig, 8.0, 10.0).count());
}

#[test]
fn errors_of_a_unit_are_reported_in_words_and_fatal_ones_end_the_stream() {
    let error = |code, detail| Fault::Error { address: 1, at_s: 6.0, code, detail };
    let noted = run(vec![error(32, 0)], 8.0);
    assert_eq!(count(&noted, 0, (5.0, 8.0), &[SensorState::Ok]).0, within(&noted, 5.0, 8.0).count());

    // A RAM failure stops the unit, and the reason is reported. The session tries again; this one lets itself be run.
    let rig = run(vec![error(1, 0)], 9.0);
    assert_eq!(count(&rig, 0, (6.02, 7.0), &[SensorState::Ok]).0, 0);
    let reported = rig.emitted.iter().any(
        |emitted| matches!(emitted, Said::State(_, State::Failed { reason }) if reason.contains("error 1")),
    );
    assert!(reported, "{:?}", rig.pipeline.status().devices[0].state);
}

#[test]
fn a_range_that_the_unit_does_not_have_is_refused_and_no_pose_is_four_times_too_far() {
    let mut stage = stage(&[2]);
    if let Driver::FlockOfBirds(settings) = &mut stage.devices[0].driver {
        settings.range_in = Some(posed_drivers::flock::wire::Range::In144);
    }
    let mut rig = Rig::new(&stage, &scene(3, QUIET, &["s0-0", "s0-1"], vec![device(0, Vec::new())]));
    rig.run_until(6.0);
    assert_eq!(rig.estimates().count(), 0);
    let failed = |emitted: &Said| matches!(emitted, Said::State(_, State::Failed { reason }) if reason.contains("36 or 72 inches"));
    assert!(rig.emitted.iter().any(failed), "{:?}", rig.emitted);
}

/// A Liberty with two sensors like hands, and this fault.
fn liberty(fault: Fault, seed: u64) -> Rig {
    let mut text =
        "name = \"test\"\n[[device]]\nname = \"d0\"\ndriver = \"polhemus\"\nport = \"auto\"\nbaud = 460800\n"
            .to_owned();
    for address in 1..=2 {
        text += &format!("[[sensor]]\nname = \"s{address}\"\ndevice = \"d0\"\naddress = {address}\n");
    }
    let stage = Stage::parse(&text).unwrap();
    Rig::new(&stage, &scene(seed, QUIET, &["s1", "s2"], vec![device(0, vec![fault])]))
}

#[test]
fn damage_to_the_line_of_a_liberty_is_never_wrong_beyond_20_mm_or_5_degrees() {
    let bytes = Bytes { count: 60, start_s: 8.0, end_s: 20.0 };
    let mut poses = 0;
    for seed in 0..2 {
        for fault in [
            Fault::LostBytes(bytes),
            Fault::InsertedBytes(bytes),
            Fault::Bit7Flips(bytes),
            Fault::DataBitFlips(bytes),
        ] {
            let mut rig = liberty(fault.clone(), seed);
            rig.run_until(22.0);
            let judgement = super::judge::judge(&rig, 0, 7.0, 22.0, QUIET);
            println!(
                "{} seed {seed}: {} wrong, {} coarse",
                fault.name(),
                judgement.wrong(),
                judgement.wrong_coarse
            );
            assert_eq!(judgement.wrong_coarse, 0, "{fault:?}: {:?}", judgement.examples);
            let is_framing = matches!(fault, Fault::LostBytes(_) | Fault::InsertedBytes(_));
            assert!(!is_framing || judgement.wrong() == 0, "{fault:?}: {:?}", judgement.examples);
            poses += judgement.frames;
        }
    }
    assert!(poses > 8 * 3000, "{poses}");
}

#[test]
fn stations_of_a_fastrak_which_it_measures_in_turn_have_times_of_their_own() {
    let mut text =
        "name = \"test\"\n[[device]]\nname = \"d0\"\ndriver = \"fastrak\"\nport = \"auto\"\n".to_owned();
    for address in 1..=4 {
        text += &format!("[[sensor]]\nname = \"s{address}\"\ndevice = \"d0\"\naddress = {address}\n");
    }
    let stage = Stage::parse(&text).unwrap();
    let mut rig = Rig::new(&stage, &scene(3, QUIET, &["s1", "s2", "s3", "s4"], vec![device(0, Vec::new())]));
    rig.run_until(12.0);
    for sensor in 0..4 {
        let measured =
            rig.host.truth.iter().filter(|cycle| cycle.sensors.iter().any(|row| row.sensor == sensor));
        let times: Vec<f64> = measured.map(|cycle| cycle.t.as_secs_f64()).collect();
        let records = rig.estimates().filter_map(|estimate| estimate.sensors[sensor].measured);
        let late = records.map(|measured| measured.t_valid.as_secs_f64()).filter(|t_s| *t_s > 6.0);
        let errors: Vec<f64> = late
            .map(|t_s| times.iter().map(|time| (time - t_s).abs()).fold(f64::INFINITY, f64::min))
            .collect();
        let worst_s = errors.iter().copied().fold(0.0, f64::max);
        println!("station {}: {:.2} ms off at most", sensor + 1, worst_s * 1e3);
        // One turn of the four takes 33 ms.
        assert!(errors.len() > 150 && worst_s < 2e-3, "station {}: {worst_s}", sensor + 1);
    }
}
