//! The real driver on the virtual Flock, in simulated time: set-up, streams, faults, return.

use posed_drivers::flock::{Family, FlockSession, Probe, Settings, wire::Format, wire::Range};
use posed_drivers::session::Output as Said;
use posed_drivers::{LineEvent, Measurement, Sample, Session, State, Timestamp};
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::scenario::{DeviceScenario, DeviceSpec, Scenario, SensorSpec, StageSpec};
use posed_simulator::stage::{Output, VirtualStage};
use posed_simulator::truth::{Class, TruthCycle};

fn seconds(s: f64) -> Timestamp {
    Timestamp::from_secs_f64(s)
}

/// A driver and a device, joined.
struct Pair {
    stage: VirtualStage,
    session: FlockSession,
    plugged: bool,
    samples: Vec<(Timestamp, Sample)>,
    truth: Vec<TruthCycle>,
    warnings: Vec<String>,
}

impl Pair {
    fn new(addresses: &[u16], format: Format, device: DeviceScenario) -> Self {
        Self::with(addresses, Family::Flock, Settings { format, ..Settings::default() }, device)
    }

    /// What is there, and what the driver is set to.
    fn with(addresses: &[u16], family: Family, settings: Settings, device: DeviceScenario) -> Self {
        let sensor =
            |&address: &u16| SensorSpec { name: format!("s{address}"), device: "flock".into(), address };
        let spec = StageSpec {
            transmitter_in_room: None,
            devices: vec![DeviceSpec {
                name: "flock".into(),
                driver: "flock-of-birds".into(),
                baud: 115_200,
                family,
                measurement_delay_ms: 1.0,
                ..DeviceSpec::default()
            }],
            sensors: addresses.iter().map(sensor).collect(),
        };
        let device = DeviceScenario { name: "flock".into(), ..device };
        let scenario = Scenario { devices: vec![device], ..Scenario::default() };
        let mut pair = Self {
            stage: VirtualStage::new(&spec, &scenario, ".".as_ref()).expect("a scenario"),
            session: FlockSession::new(settings, 115_200, addresses).expect("settings"),
            plugged: true,
            samples: Vec::new(),
            truth: Vec::new(),
            warnings: Vec::new(),
        };
        pair.session.handle_line(Timestamp::ZERO, &LineEvent::Opened { modem_lines: false });
        pair.listen(Timestamp::ZERO);
        pair
    }

    /// Lets both run until `end`.
    fn run_until(&mut self, end: Timestamp) {
        loop {
            let timeout = self.session.poll_timeout();
            let next =
                [timeout, self.stage.poll_timeout(), Some(end)].into_iter().flatten().min().unwrap_or(end);
            self.stage.step(next);
            while let Some(event) = self.stage.poll_event() {
                match event.output {
                    Output::Data(bytes) => self.session.handle_bytes(event.t, &bytes),
                    Output::Truth(cycle) => self.truth.push(cycle),
                    Output::Unplugged => {
                        self.plugged = false;
                        let reason = "the port is gone".to_owned();
                        self.session.handle_line(event.t, &LineEvent::Closed { reason });
                    }
                    Output::Replugged => {
                        self.plugged = true;
                        self.session.handle_line(event.t, &LineEvent::Opened { modem_lines: false });
                    }
                    Output::Fault(_) | Output::Lost(_) => {}
                }
                self.listen(event.t);
            }
            if self.session.poll_timeout().is_some_and(|due| due <= next) {
                self.session.handle_timeout(next);
                self.listen(next);
            }
            if next >= end {
                return;
            }
        }
    }

    fn listen(&mut self, now: Timestamp) {
        while let Some(emitted) = self.session.poll_output() {
            match emitted {
                Said::Transmit(bytes) if self.plugged => self.stage.write(0, now, &bytes),
                Said::Sample(sample) => self.samples.push((now, sample)),
                Said::Warning(warning) => self.warnings.push(warning),
                _ => {}
            }
        }
    }

    /// Samples that are further from every truth of their bird nearby in time than these limits.
    fn wrong(&self, limit_m: f64, limit_rad: f64) -> usize {
        let is_wrong = |(t, sample): &&(Timestamp, Sample)| {
            #[allow(irrefutable_let_patterns, reason = "other devices measure other things")]
            let Measurement::Pose { position_m, orientation_wxyz, .. } = sample.measurement else {
                return true;
            };
            let near = |cycle: &&TruthCycle| {
                let age = t.seconds_since(cycle.t);
                (-0.001..0.030).contains(&age)
            };
            !self.truth.iter().filter(near).any(|cycle| {
                let row = cycle.sensors[usize::from(sample.address).saturating_sub(1)];
                let p = position_m
                    .map_or(0.0, |p| (row.pose.translation.vector - nalgebra::Vector3::from(p)).norm());
                let q = orientation_wxyz.map_or(0.0, |[w, x, y, z]| {
                    let q = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
                    q.angle_to(&row.pose.rotation)
                });
                (p < limit_m && q < limit_rad) || row.class != Class::Clean
            })
        };
        self.samples.iter().filter(is_wrong).count()
    }
}

fn at_100_hz(faults: Vec<Fault>) -> DeviceScenario {
    DeviceScenario { rate_hz: 100.0, faults, ..DeviceScenario::default() }
}

#[test]
fn a_pair_streams_within_seconds_and_reports_the_truth() {
    let mut pair = Pair::new(&[1, 2], Format::PositionQuaternion, at_100_hz(vec![]));
    pair.run_until(seconds(5.0));
    assert!(pair.session.records_settling() > 0, "the first half second is bad");
    pair.run_until(seconds(10.0));
    assert_eq!(pair.session.state(), &State::Streaming);
    let first_s = pair.samples[0].0.as_secs_f64();
    assert!(first_s < 5.0, "first pose after {first_s} s");
    let expected = 2.0 * 100.0 * (10.0 - first_s);
    assert!((pair.samples.len() as f64 - expected).abs() < 4.0, "{} of {expected}", pair.samples.len());
    assert_eq!(pair.wrong(3e-3, 0.01), 0);
    assert_eq!(pair.session.counters().rejected, 0, "a bad start is no fault of the line");
}

#[test]
fn every_format_and_a_stand_alone_unit_stream() {
    for format in Format::ALL {
        for addresses in [&[0][..], &[1, 2]] {
            let mut pair = Pair::new(addresses, format, at_100_hz(vec![]));
            pair.run_until(seconds(5.0));
            assert_eq!(pair.session.state(), &State::Streaming, "{format} {addresses:?}");
            assert!(pair.samples.len() > 50, "{format} {addresses:?}: {}", pair.samples.len());
            assert_eq!(pair.wrong(3e-3, 0.01), 0, "{format} {addresses:?}");
        }
    }
}

#[test]
fn damaged_bytes_make_no_wrong_pose_and_cost_at_most_two_frames_each() {
    let span = Bytes { count: 50, start_s: 5.0, end_s: 15.0 };
    for fault in [Fault::LostBytes(span), Fault::InsertedBytes(span), Fault::Bit7Flips(span)] {
        let mut clean = Pair::new(&[1, 2], Format::PositionQuaternion, at_100_hz(vec![]));
        clean.run_until(seconds(16.0));
        let name = fault.name();
        let mut pair = Pair::new(&[1, 2], Format::PositionQuaternion, at_100_hz(vec![fault]));
        pair.run_until(seconds(16.0));
        assert_eq!(pair.wrong(3e-3, 0.01), 0, "{name}");
        let lost = clean.samples.len() - pair.samples.len();
        assert!((20..=200).contains(&lost), "{name}: {lost} samples lost");
    }
}

#[test]
fn after_two_seconds_without_a_port_poses_return() {
    let unplug = Fault::Unplug { at_s: 6.0, duration_s: Some(2.0), power: false };
    let mut pair = Pair::new(&[1, 2], Format::PositionQuaternion, at_100_hz(vec![unplug]));
    pair.run_until(seconds(12.0));
    let back = pair.samples.iter().find(|(t, _)| *t > seconds(8.0)).unwrap().0;
    assert!(back < seconds(9.0), "{back:?}");
    assert!(!pair.samples.iter().any(|(t, _)| *t > seconds(6.01) && *t < seconds(8.0)));
    assert_eq!(pair.wrong(3e-3, 0.01), 0);
}

#[test]
fn a_power_cycle_is_recovered() {
    let mut pair =
        Pair::new(&[1, 2], Format::PositionQuaternion, at_100_hz(vec![Fault::PowerCycle { at_s: 6.0 }]));
    pair.run_until(seconds(20.0));
    assert!(pair.samples.iter().filter(|(t, _)| *t > seconds(18.0)).count() > 390);
    assert_eq!(pair.wrong(3e-3, 0.01), 0);
}

#[test]
fn a_dead_bird_does_not_stop_the_other() {
    let dies = Fault::BirdDies { address: 2, at_s: 6.0, duration_s: Some(2.0) };
    let mut pair = Pair::new(&[1, 2], Format::PositionQuaternion, at_100_hz(vec![dies]));
    pair.run_until(seconds(14.0));
    let count = |address: u16, from: f64, to: f64| {
        pair.samples
            .iter()
            .filter(|(t, sample)| sample.address == address && *t > seconds(from) && *t < seconds(to))
            .count()
    };
    assert!(count(1, 6.0, 8.0) > 150, "{}", count(1, 6.0, 8.0));
    assert_eq!(count(2, 6.02, 8.0), 0);
    assert!(count(2, 12.0, 14.0) > 190, "{}", count(2, 12.0, 14.0));
}

/// A 3D Guidance unit with sensors at some of its inputs, and a driver for those that are `wanted`.
fn guidance(plugged: &[u16], wanted: &[u16], settings: Settings, faults: Vec<Fault>) -> Pair {
    let settings = Settings { family: Family::Guidance, ..settings };
    let mut pair = Pair::with(plugged, Family::Guidance, settings.clone(), at_100_hz(faults));
    pair.session = FlockSession::new(settings, 115_200, wanted).expect("settings");
    pair.session.handle_line(Timestamp::ZERO, &LineEvent::Opened { modem_lines: true });
    pair.listen(Timestamp::ZERO);
    pair
}

#[test]
fn a_3d_guidance_unit_streams_in_every_format_that_it_is_known_to_have() {
    for format in [Format::PositionAngles, Format::PositionMatrix, Format::PositionQuaternion] {
        for mode in [posed_drivers::flock::Mode::Stream, posed_drivers::flock::Mode::Point] {
            let settings = Settings { format, mode, range_in: Some(Range::In72), ..Settings::default() };
            let mut pair = guidance(&[1, 3], &[1, 3], settings, Vec::new());
            // The order of its sensors in the truth is that of the stage.
            pair.run_until(seconds(6.0));
            assert_eq!(pair.session.state(), &State::Streaming, "{format} {mode:?} {:?}", pair.warnings);
            let serials: Vec<_> =
                pair.session.sensors().iter().map(|s| (s.address, s.serial.clone())).collect();
            assert_eq!(serials, [(1, Some("6001".to_owned())), (3, Some("6003".to_owned()))]);
            pair.samples.iter_mut().for_each(|(_, sample)| sample.address = sample.address.div_ceil(2));
            assert!(pair.samples.len() > 200, "{format} {mode:?}: {}", pair.samples.len());
            assert_eq!(pair.wrong(6e-3, 0.01), 0, "{format} {mode:?}");
            assert_eq!(pair.warnings, [""; 0]);
        }
    }
}

#[test]
fn a_sensor_pulled_from_a_3d_guidance_unit_repeats_and_its_neighbour_goes_on() {
    let pulled = Fault::BirdDies { address: 2, at_s: 6.0, duration_s: Some(2.0) };
    let mut pair = guidance(&[1, 2], &[1, 2, 4], Settings::default(), vec![pulled]);
    pair.run_until(seconds(10.0));
    assert!(
        pair.warnings[0].starts_with("bird 4 is not on the bus, or has no sensor"),
        "{:?}",
        pair.warnings
    );
    let between = |address: u16, from_s: f64, to_s: f64| {
        let within = |t: &Timestamp| (seconds(from_s)..seconds(to_s)).contains(t);
        let records = pair.samples.iter().filter(move |(t, sample)| sample.address == address && within(t));
        records.map(|(_, sample)| sample.measurement).collect::<Vec<_>>()
    };
    let repeats = |records: &[Measurement]| records.windows(2).filter(|two| two[0] == two[1]).count();
    let (first, second) = (between(1, 6.1, 7.9), between(2, 6.1, 7.9));
    assert!(first.len() > 170 && repeats(&first) < 10, "{} of {}", repeats(&first), first.len());
    assert_eq!(repeats(&second), second.len() - 1);
    assert!(repeats(&between(2, 8.1, 10.0)) < 10);
}

#[test]
fn damage_makes_no_wrong_pose_of_a_3d_guidance_unit() {
    let span = Bytes { count: 50, start_s: 5.0, end_s: 15.0 };
    for fault in [Fault::LostBytes(span), Fault::InsertedBytes(span), Fault::Bit7Flips(span)] {
        let mut pair = guidance(&[1, 2], &[1, 2], Settings::default(), vec![fault.clone()]);
        pair.run_until(seconds(16.0));
        assert!(pair.samples.len() > 1900, "{}: {}", fault.name(), pair.samples.len());
        assert_eq!(pair.wrong(3e-3, 0.01), 0, "{}", fault.name());
    }
}

#[test]
fn the_family_that_is_not_there_is_named() {
    let settings = Settings { family: Family::Guidance, ..Settings::default() };
    for (there, settings, advice) in [
        (Family::Guidance, Settings::default(), "of a trakSTAR or driveBAY set family = \"3d-guidance\""),
        (Family::Flock, settings, "the unit calls itself 6DFOB: a Flock"),
    ] {
        let mut pair = Pair::with(&[1, 2], there, settings, at_100_hz(Vec::new()));
        pair.run_until(seconds(6.0));
        let State::Failed { reason } = pair.session.state() else { panic!("{:?}", pair.session.state()) };
        assert!(reason.contains(advice), "{reason}");
    }
}

#[test]
fn a_probe_tells_a_3d_guidance_unit_from_a_flock() {
    for (family, sensors) in [(Family::Guidance, vec![1, 2]), (Family::Flock, vec![1, 2])] {
        let settings = Settings { family, ..Settings::default() };
        let mut pair = Pair::with(&[1, 2], family, settings, at_100_hz(Vec::new()));
        pair.session.handle_line(Timestamp::ZERO, &LineEvent::Closed { reason: String::new() });
        pair.run_until(seconds(2.0));
        let mut now = seconds(2.0);
        let mut probe = Probe::without_reset(now);
        while probe.result().is_none() {
            while let Some(Said::Transmit(bytes)) = probe.poll_output() {
                pair.stage.write(0, now, &bytes);
            }
            now = probe.poll_timeout().into_iter().chain(pair.stage.poll_timeout()).min().expect("not done");
            pair.stage.step(now);
            while let Some(event) = pair.stage.poll_event() {
                if let Output::Data(bytes) = event.output {
                    probe.handle_bytes(event.t, &bytes);
                }
            }
            probe.handle_timeout(now);
        }
        let findings = probe.result().expect("done").expect("a unit");
        assert_eq!((findings.family, findings.sensors()), (family, sensors));
        assert!(now < seconds(4.0), "{now:?}");
    }
}
