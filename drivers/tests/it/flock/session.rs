//! Whole sessions against the stand-in of [`super::bench`].

use std::time::Duration;

use posed_drivers::flock::examine::Failure;
use posed_drivers::flock::wire::{Addressing, Command, Format};
use posed_drivers::flock::{FlockSession, Mode, Probe, Settings};
use posed_drivers::{LineEvent, Measurement, Output, Session, State, Timestamp};

use super::bench::{Bench, Unit};

fn seconds(bench: &Bench, address: u16) -> usize {
    bench.samples.iter().filter(|(_, sample)| sample.address == address).count()
}

#[test]
fn a_flock_of_two_is_set_up_and_streams() {
    let mut bench = Bench::new(Settings::default(), &[1, 2], Unit::flock(2));
    bench.open(false);
    bench.run(5.0);
    assert_eq!(bench.session.state(), &State::Streaming);
    assert_eq!(bench.warnings, Vec::<String>::new());
    let first = bench.first_sample_after(Timestamp::ZERO);
    println!("full set-up: first pose after {first:.3} s");
    // 0.3 s of questions, 0.6 s quiet around auto-configuration, 0.1 s of settings, 0.5 s to settle.
    assert!((1.2..1.7).contains(&first), "{first}");
    assert_eq!(seconds(&bench, 1), seconds(&bench, 2));
    let counters = bench.session.counters();
    assert_eq!((counters.rejected, counters.bytes_skipped), (0, 0));
    assert_eq!(bench.session.sensors().len(), 2);
    assert!(bench.session.records_settling() > 0);
    assert!((bench.session.rate_hz().unwrap() - 103.3).abs() < 0.01);
    assert!(bench.unit.commands_seen.contains(&Command::Change { parameter: 0x32, data: vec![2] }));
}

#[test]
fn a_first_record_that_is_late_is_no_silence_but_one_that_never_comes_is() {
    for (late, is_silent) in [(Duration::from_millis(800), false), (Duration::from_secs(5), true)] {
        let mut bench = Bench::new(Settings::default(), &[1], Unit { late, ..Unit::flock(1) });
        bench.open(false);
        bench.run(4.0);
        let silent = bench.states.iter().find_map(|(_, state)| match state {
            State::Silent { reason } => Some(reason.as_str()),
            _ => None,
        });
        let expected =
            is_silent.then_some("no record for 1000 ms; check the unit's power, FLY switch and cable");
        assert_eq!(silent, expected, "{late:?}");
    }
}

#[test]
fn sensors_have_the_serial_numbers_that_newer_firmware_tells() {
    for (unit, wanted) in [(Unit::flock(2), &[1, 2][..]), (Unit::alone(), &[0])] {
        let mut bench = Bench::new(Settings::default(), wanted, Unit { revision: [3, 71], ..unit });
        bench.open(false);
        bench.run(3.0);
        assert_eq!(bench.session.state(), &State::Streaming);
        let serials: Vec<_> = bench.session.sensors().iter().map(|sensor| sensor.serial.as_deref()).collect();
        assert_eq!(serials, vec![Some("5207"); wanted.len()]);
    }
}

#[test]
fn a_unit_alone_streams_and_answers_polls() {
    for (mode, format) in [(Mode::Stream, Format::PositionMatrix), (Mode::Point, Format::PositionQuaternion)]
    {
        let mut bench = Bench::new(Settings { mode, format, ..Settings::default() }, &[0], Unit::alone());
        bench.open(false);
        bench.run(3.0);
        assert_eq!(bench.session.state(), &State::Streaming);
        assert!(seconds(&bench, 0) > 100, "{mode:?}: {}", seconds(&bench, 0));
        assert_eq!(bench.session.counters().rejected, 0);
        assert!(
            !bench.unit.commands_seen.iter().any(|c| matches!(c, Command::Change { parameter: 0x32, .. }))
        );
    }
}

#[test]
fn poses_are_back_soon_after_the_cable() {
    let mut bench = Bench::new(Settings::default(), &[1, 2], Unit::flock(2));
    bench.open(false);
    bench.run(4.0);
    bench.close();
    bench.run(2.0);
    let back = bench.now;
    bench.open(false);
    bench.run(2.0);
    let after = bench.first_sample_after(back);
    println!("cable back: first pose after {after:.3} s");
    assert!(after < 0.9, "{after}");
    let configured =
        bench.unit.commands_seen.iter().filter(|c| matches!(c, Command::Change { parameter: 0x32, .. }));
    assert_eq!(configured.count(), 1);
}

#[test]
fn a_unit_that_was_switched_off_and_on_is_set_up_again() {
    let mut bench = Bench::new(Settings::default(), &[1, 2], Unit::flock(2));
    bench.open(false);
    bench.run(4.0);
    let cut = bench.now;
    bench.unit.power_cycle(cut);
    bench.run(8.0);
    assert_eq!(bench.session.state(), &State::Streaming);
    assert!(bench.states.iter().any(|(_, state)| matches!(state, State::Silent { .. })));
    let after = bench.first_sample_after(cut + Duration::from_secs(2));
    println!("unit restarted: first pose {after:.3} s after it was ready");
    assert!(after < 2.0, "{after}");
}

#[test]
fn a_unit_that_is_switched_off_and_on_while_it_is_set_up_is_set_up_whole() {
    let mut bench = Bench::new(Settings::default(), &[1, 2], Unit::flock(2));
    bench.open(false);
    let configuring = |bench: &Bench| bench.unit.unresponsive_until > bench.now;
    while !configuring(&bench) {
        bench.run(0.01);
    }
    let now = bench.now;
    bench.unit.power_cycle(now);
    bench.unit.unresponsive_until = now + Duration::from_millis(200);
    bench.run(8.0);
    assert_eq!(bench.session.state(), &State::Streaming);
    assert!(seconds(&bench, 1) > 100, "{:?}", bench.warnings);
    assert_eq!(seconds(&bench, 1), seconds(&bench, 2));
}

#[test]
fn a_bird_that_comes_back_at_any_moment_of_a_set_up_is_set_up_too() {
    for back_ms in (0..9000).step_by(50) {
        let mut bench = Bench::new(Settings::default(), &[1, 2, 3, 4], Unit::flock(4));
        bench.open(false);
        bench.run(4.0);
        bench.unit.dead = vec![2];
        bench.run(0.5);
        let now = bench.now;
        bench.unit.power_cycle(now);
        bench.unit.dead = vec![2];
        bench.run(f64::from(back_ms) * 1e-3);
        bench.unit.dead.clear();
        bench.run(9.0);
        let before: Vec<usize> = (1..=4).map(|address| seconds(&bench, address)).collect();
        bench.run(1.0);
        assert_eq!(bench.session.state(), &State::Streaming, "back after {back_ms} ms");
        for (address, before) in (1..).zip(before) {
            let came = seconds(&bench, address) - before;
            assert!(came > 100, "bird {address}, back after {back_ms} ms: {came}, {:?}", bench.warnings);
        }
    }
}

#[test]
fn a_bird_that_restarts_by_itself_is_set_up_again() {
    // Every bird has a power supply of its own; one that is away for a moment has not left.
    for away_s in [0.005, 0.5] {
        let mut bench = Bench::new(Settings::default(), &[1, 2, 3], Unit::flock(3));
        bench.open(false);
        bench.run(4.0);
        bench.unit.dead = vec![2];
        bench.run(away_s);
        bench.unit.dead.clear();
        bench.unit.formats[1] = Format::PositionAngles;
        bench.run(4.0);
        let before: Vec<usize> = (1..=3).map(|address| seconds(&bench, address)).collect();
        bench.run(1.0);
        for (address, before) in (1..).zip(before) {
            assert!(seconds(&bench, address) - before > 100, "bird {address}: {:?}", bench.warnings);
        }
        assert!(
            bench.warnings.iter().any(|text| text.contains("bird 2 has restarted")),
            "{:?}",
            bench.warnings
        );
    }
}

#[test]
fn a_bird_that_keeps_another_format_costs_the_others_one_set_up() {
    let mut bench = Bench::new(Settings::default(), &[1, 2, 3], Unit::flock(3));
    bench.open(false);
    bench.run(4.0);
    bench.unit.deaf = vec![2];
    bench.unit.formats[1] = Format::PositionAngles;
    bench.run(4.0);
    let before = [seconds(&bench, 1), seconds(&bench, 3)];
    bench.run(10.0);
    let restarts = bench.warnings.iter().filter(|text| text.contains("has restarted")).count();
    assert_eq!(restarts, 1, "{:?}", bench.warnings);
    for (address, before) in [1, 3].into_iter().zip(before) {
        assert!(seconds(&bench, address) - before > 1000, "bird {address}: {:?}", bench.warnings);
    }
}

#[test]
fn a_damaged_answer_does_not_choose_the_scale_of_positions() {
    let extended = 0x10;
    // The first answer, that of a later set-up, and the one by which auto-configured birds report that they run.
    for flips in [vec![extended], vec![0, 0, extended], vec![0, 0, 0, extended]] {
        let mut bench = Bench::new(Settings::default(), &[1, 2], Unit { flips, ..Unit::flock(2) });
        bench.open(false);
        bench.run(4.0);
        bench.close();
        bench.open(false);
        bench.run(4.0);
        assert!(seconds(&bench, 1) > 200);
        for (_, sample) in &bench.samples {
            let Measurement::Pose { position_m: Some([x, ..]), .. } = sample.measurement else { panic!() };
            assert!((0.29..0.32).contains(&x), "{x}");
        }
    }
}

#[test]
fn answers_that_are_out_of_step_do_not_choose_the_scale_of_positions() {
    // The end of an answer about the model and a record, after any number of right answers.
    let strays = vec![b"6DFOB  \xf1\x90".to_vec(), b"\xf1\x21\x5a\x0c\x26\x75".to_vec()];
    for right in 0..6 {
        let strays = (right, strays.clone());
        let mut bench = Bench::new(Settings::default(), &[1], Unit { strays, ..Unit::flock(1) });
        for _ in 0..3 {
            bench.open(false);
            bench.run(4.0);
            bench.close();
        }
        assert!(seconds(&bench, 1) > 200, "{right}");
        for (_, sample) in &bench.samples {
            let Measurement::Pose { position_m: Some([x, ..]), .. } = sample.measurement else { panic!() };
            assert!((0.29..0.32).contains(&x), "{right}: {x}");
        }
    }
}

#[test]
fn modem_lines_reset_the_unit_and_pseudo_terminals_do_not() {
    let mut bench = Bench::new(Settings::default(), &[0], Unit::alone());
    bench.open(true);
    bench.run(6.0);
    let times: Vec<_> = bench.rts.iter().map(|(at, asserted)| (at.as_secs_f64(), *asserted)).collect();
    assert_eq!(times, [(0.0, true), (1.0, false)]);
    assert_eq!(bench.session.state(), &State::Streaming);
    assert!(bench.first_sample_after(Timestamp::ZERO) > 3.0);
}

#[test]
fn a_dead_bird_does_not_stop_the_other() {
    let mut bench = Bench::new(Settings::default(), &[1, 2], Unit::flock(2));
    bench.open(false);
    bench.run(4.0);
    bench.unit.dead = vec![2];
    let (one, two) = (seconds(&bench, 1), seconds(&bench, 2));
    bench.run(2.0);
    assert!(seconds(&bench, 1) - one >= 200, "{}", seconds(&bench, 1) - one);
    assert_eq!(seconds(&bench, 2), two);
    assert!(bench.warnings.iter().any(|text| text.contains("bird 2")), "{:?}", bench.warnings);
    bench.unit.dead.clear();
    bench.run(1.5);
    // Half a second of its poses is not believed.
    assert!(seconds(&bench, 2) > two + 90);
}

#[test]
fn what_does_not_fit_is_said_in_words() {
    let mut silent = Bench::new(Settings::default(), &[1], Unit::flock(1));
    silent.cable = false;
    silent.session.handle_line(Timestamp::ZERO, &LineEvent::Opened { modem_lines: false });
    silent.run(2.9);
    // A unit that was just switched on is given time to start.
    assert!(silent.states.iter().all(|(_, state)| matches!(state, State::Connecting { .. })));
    silent.run(2.0);
    let State::Silent { reason } = silent.session.state() else { panic!("{:?}", silent.session.state()) };
    assert!(reason.contains("115200"), "{reason}");

    for (wanted, unit, words) in [
        (vec![1u16], Unit::alone(), "stand-alone"),
        (vec![0], Unit::flock(2), "1, 2"),
        (vec![5], Unit::flock(2), "none of the wanted birds (5)"),
    ] {
        let mut bench = Bench::new(Settings::default(), &wanted, unit);
        bench.open(false);
        bench.run(2.0);
        let State::Failed { reason } = bench.session.state() else { panic!("{:?}", bench.session.state()) };
        assert!(reason.contains(words), "{reason}");
    }

    let mut bench = Bench::new(Settings::default(), &[1, 5], Unit::flock(2));
    bench.open(false);
    bench.run(4.0);
    assert_eq!(bench.session.state(), &State::Streaming);
    assert!(bench.warnings.iter().any(|text| text.contains("bird 5")), "{:?}", bench.warnings);
    assert!(bench.samples.iter().all(|(_, sample)| sample.address == 1));
}

#[test]
fn a_slow_line_is_reported_and_its_rate_known() {
    let mut bench = Bench::new(
        Settings { format: Format::PositionMatrix, ..Settings::default() },
        &[1, 2],
        Unit::flock(2),
    );
    bench.session = FlockSession::new(
        Settings { format: Format::PositionMatrix, ..Settings::default() },
        19_200,
        &[1, 2],
    )
    .unwrap();
    bench.open(false);
    bench.run(3.0);
    assert!(bench.warnings.iter().any(|text| text.contains("19200")), "{:?}", bench.warnings);
    // 50 bytes take 26 ms, three cycles.
    assert!((bench.session.rate_hz().unwrap() - 103.3 / 3.0).abs() < 0.01);
}

#[test]
fn a_rate_that_cannot_be_is_not_believed() {
    let honest = [0x4D, 0x67];
    for damaged in [[0, 0], [1, 0], [0xFF, 0xFF], [0, 9]] {
        for (asked, rates, expected_hz) in [
            (None, vec![damaged], 103.3),
            (Some(86.0), vec![damaged], 86.0),
            (Some(86.0), vec![honest, damaged], 86.0),
        ] {
            for mode in [Mode::Stream, Mode::Point] {
                let settings = Settings { measurement_rate_hz: asked, mode, ..Settings::default() };
                let mut bench =
                    Bench::new(settings, &[1, 2], Unit { rates: rates.clone(), ..Unit::flock(2) });
                bench.open(false);
                bench.run(3.0);
                assert_eq!(bench.session.state(), &State::Streaming, "{damaged:?}");
                assert!(
                    (bench.session.rate_hz().unwrap() - expected_hz).abs() < 0.01,
                    "{damaged:?} {asked:?}"
                );
                assert!(bench.warnings.iter().any(|text| text.contains("cannot be")), "{:?}", bench.warnings);
            }
        }
    }
}

#[test]
fn a_line_without_a_rate_limits_nothing() {
    for mode in [Mode::Stream, Mode::Point, Mode::Listen] {
        let mut bench = Bench::new(Settings::default(), &[1, 2], Unit::flock(2));
        let settings = Settings { mode, ..Settings::default() };
        bench.session = FlockSession::new(settings, 0, &[1, 2]).unwrap();
        bench.open(false);
        bench.run(3.0);
        if mode != Mode::Listen {
            assert_eq!(bench.session.state(), &State::Streaming);
            assert!((bench.session.rate_hz().unwrap() - 103.3).abs() < 0.01);
        }
        assert!(bench.warnings.is_empty(), "{:?}", bench.warnings);
    }
}

#[test]
fn a_transmitter_beyond_the_commands_reach_is_named() {
    // Unit 18 has the transmitter; cut to four bits the command would choose that of unit 2.
    let mut unit = Unit::flock(18);
    unit.units.iter_mut().for_each(|status| *status &= !0x0F);
    unit.units[17] |= 1;
    let settings = Settings { addressing: Some(Addressing::Expanded), ..Settings::default() };
    let mut bench = Bench::new(settings, &[1, 2], unit);
    bench.open(false);
    bench.run(5.0);
    let chosen = |command: &Command| matches!(command, Command::NextTransmitter { .. });
    assert!(!bench.unit.commands_seen.iter().any(chosen), "{:?}", bench.unit.commands_seen);
    assert!(bench.warnings.iter().any(|text| text.contains("unit 18")), "{:?}", bench.warnings);
    assert_eq!(Command::next_transmitter(16, 0), None);
}

#[test]
fn settings_are_checked() {
    let new = |settings, wanted: &[u16]| FlockSession::new(settings, 115_200, wanted).map(|_| ());
    assert!(new(Settings::default(), &[1, 1]).is_err());
    assert!(new(Settings::default(), &[0, 1]).is_err());
    assert!(new(Settings::default(), &[127]).is_err());
    assert!(new(Settings::default(), &[]).is_err());
    let fast = Settings { measurement_rate_hz: Some(200.0), ..Settings::default() };
    assert_eq!(new(fast, &[0]).unwrap_err().to_string(), "measurement_rate_hz must be 14 to 144");
}

#[test]
fn a_session_can_be_put_away_at_any_moment() {
    let mut bench = Bench::new(Settings::default(), &[1, 2], Unit::flock(2));
    bench.open(false);
    let mut whole = Bench::new(Settings::default(), &[1, 2], Unit::flock(2));
    whole.open(false);
    for _ in 0..400 {
        bench.run(0.01);
        whole.run(0.01);
        let bytes = posed_state::snapshot(&bench.session);
        bench.session = FlockSession::new(Settings::default(), 115_200, &[1, 2]).unwrap();
        posed_state::restore(&mut bench.session, &bytes).unwrap();
        assert_eq!(posed_state::snapshot(&bench.session), bytes);
    }
    assert!(!bench.samples.is_empty());
    assert_eq!(bench.samples, whole.samples);
}

#[test]
fn a_probe_reports_what_is_there() {
    let mut unit = Unit::flock(2);
    let mut probe = Probe::new(Timestamp::ZERO, false);
    let mut now = Timestamp::ZERO;
    while probe.result().is_none() {
        while let Some(output) = probe.poll_output() {
            if let Output::Transmit(bytes) = output {
                unit.take(now, &bytes);
            }
        }
        let (unit_at, probe_at) = (unit.next(), probe.poll_timeout().unwrap());
        if let Some(at) = unit_at.filter(|&at| at <= probe_at) {
            now = now.max(at);
            probe.handle_bytes(now, &unit.give(now));
        } else {
            now = now.max(probe_at);
            probe.handle_timeout(now);
        }
    }
    let findings = probe.result().unwrap().unwrap();
    assert_eq!((findings.revision, findings.model.as_str()), ((3, 67), "6DFOB"));
    assert_eq!(findings.sensors(), [1, 2]);
    assert_eq!(findings.addressing, Addressing::Normal);
    assert!((findings.rate_hz - 103.3).abs() < 0.01);
    assert!(now.as_secs_f64() < 0.4, "{now:?}");

    let mut probe = Probe::new(Timestamp::ZERO, false);
    while let Some(at) = probe.poll_timeout() {
        now = at;
        probe.handle_timeout(now);
    }
    assert_eq!(probe.result(), Some(Err(Failure::Silent)));
    assert!(Failure::Silent.advice(38_400).contains("38400"));
}
