//! VRPN: the session against a pretended server.

use std::collections::VecDeque;

use posed_drivers::vrpn::wire::{self, From, GREETING, Messages, system, types};
use posed_drivers::vrpn::{Settings, VrpnSession};
use posed_drivers::{DeviceTime, LineEvent, Measurement, Session, State, Timestamp};

use crate::rig::{Device, Rig};

const TYPE: i32 = 7;
const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// A server with trackers that move along x by 1 mm in every period of 10 ms.
struct Server {
    names: Vec<&'static str>,
    greeting: [u8; 24],
    /// Whether it was greeted, and whether it says anything.
    greeted: bool,
    deaf: bool,
    answers: VecDeque<Vec<u8>>,
    heard: Messages,
    pings: usize,
    greetings: usize,
    next: u64,
    /// Whether trackers report.
    reports: bool,
    /// What else comes in each period.
    besides: fn(u64) -> Vec<u8>,
}

impl Server {
    fn new(names: &[&'static str]) -> Self {
        Self {
            names: names.to_vec(),
            greeting: GREETING,
            greeted: false,
            deaf: false,
            answers: VecDeque::new(),
            heard: Messages::default(),
            pings: 0,
            greetings: 0,
            next: 0,
            reports: true,
            besides: |_| vec![],
        }
    }
}

fn from(sender: i32, kind: i32, ms: u64) -> From {
    From { sender, kind, utc_ns: 1_700_000_000_000_000_000 + 1_000_000 * ms as i64 }
}

impl Device for Server {
    fn receive(&mut self, _: Timestamp, bytes: &[u8]) {
        if bytes.starts_with(b"vrpn") {
            assert_eq!(bytes, GREETING);
            self.greetings += 1;
            self.heard.skip(usize::MAX);
            if self.deaf {
                return;
            }
            self.greeted = true;
            let mut answer = self.greeting.to_vec();
            for (number, name) in (0..).zip(&self.names) {
                wire::description(system::SENDER, 10 + number, name, 0, &mut answer);
            }
            wire::description(system::TYPE, TYPE, types::POSE, 0, &mut answer);
            wire::description(system::TYPE, TYPE + 1, types::PONG, 0, &mut answer);
            wire::description(system::TYPE, TYPE + 2, types::VELOCITY, 0, &mut answer);
            return self.answers.push_back(answer);
        }
        self.heard.push(bytes);
        while let Some(message) = self.heard.find().unwrap() {
            if message.kind == 0 {
                self.pings += 1;
                if !self.deaf {
                    let mut pong = Vec::new();
                    wire::message(from(10, TYPE + 1, 0), &[], &mut pong);
                    self.answers.push_back(pong);
                }
            }
        }
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        if let Some(answer) = self.answers.pop_front() {
            return Some(answer);
        }
        let ms = now.as_nanos() as u64 / 1_000_000;
        if ms < self.next {
            return None;
        }
        self.next = (ms / 10 + 1) * 10;
        if !self.greeted || self.deaf || !self.reports {
            return None;
        }
        let mut bytes = (self.besides)(ms);
        for (number, _) in (0..).zip(&self.names) {
            wire::motion(from(10 + number, TYPE + 2, ms), [0.0; 3], UPRIGHT, 0.01, &mut bytes);
            let at = [1e-4 * ms as f64, f64::from(number), 1.7];
            wire::pose(from(10 + number, TYPE, ms), 0, at, UPRIGHT, &mut bytes);
        }
        Some(bytes)
    }
}

fn session(trackers: &[&str], wanted: &[u16]) -> VrpnSession {
    let trackers = trackers.iter().map(|name| (*name).to_owned()).collect();
    VrpnSession::new(Settings { trackers }, wanted).unwrap()
}

fn rig(server: Server) -> Rig<VrpnSession, Server> {
    Rig::open(session(&["Head", "Wand"], &[1, 2]), server)
}

/// Every sample is where its server had it at its time.
fn all_true(rig: &Rig<VrpnSession, Server>) {
    for sample in &rig.samples {
        let DeviceTime::Counter { ticks, tick_s } = sample.t_device else { panic!("{sample:?}") };
        let ms = ticks / 1000 - 1_700_000_000_000;
        assert_eq!(tick_s, 1e-6);
        let Measurement::Pose { position_m, orientation_wxyz, .. } = sample.measurement else { panic!() };
        // The server has the wand first.
        let place = if sample.address == 1 { 1.0 } else { 0.0 };
        assert_eq!(position_m, Some([1e-4 * ms as f64, place, 1.7]), "{sample:?}");
        assert_eq!(orientation_wxyz, Some(UPRIGHT));
    }
}

#[test]
fn trackers_are_found_by_their_names_whatever_their_numbers() {
    let mut rig = rig(Server::new(&["Wand", "Head"]));
    rig.run_stored_ms(500);
    assert!(rig.is_streaming(), "{}", rig.reason());
    assert_eq!(rig.samples.iter().filter(|sample| sample.address == 1).count(), rig.samples.len() / 2);
    assert!(rig.samples.len() > 90, "{}", rig.samples.len());
    all_true(&rig);
    let counters = rig.session.counters();
    assert_eq!((counters.rejected, counters.bytes_skipped), (0, 0));
    assert_eq!((rig.device.pings, rig.warnings.len()), (0, 0), "it asks for nothing");
}

#[test]
fn what_nobody_asked_for_floods_nobody() {
    let mut server = Server::new(&["Wand", "Head"]);
    server.besides = |ms| {
        let mut bytes = Vec::new();
        wire::description(system::TYPE, TYPE + 3, types::BUTTON, 0, &mut bytes);
        wire::description(system::TYPE, 100, "vrpn_Analog Channel", 0, &mut bytes);
        for number in 0..200 {
            wire::button(from(11, TYPE + 3, ms), number, true, &mut bytes);
            wire::message(from(11, 100, ms), &[0; 1032], &mut bytes);
        }
        // Another sensor of a tracker, and another tracker.
        wire::pose(from(11, TYPE, ms), 3, [1.0; 3], UPRIGHT, &mut bytes);
        wire::pose(from(11, TYPE, ms), u32::MAX / 2, [1.0; 3], UPRIGHT, &mut bytes);
        wire::pose(from(15, TYPE, ms), 0, [1.0; 3], UPRIGHT, &mut bytes);
        bytes
    };
    let mut rig = rig(server);
    rig.run_ms(300);
    assert!(rig.samples.len() > 50);
    all_true(&rig);
    assert_eq!(rig.session.counters().rejected, 0);
}

#[test]
fn no_pose_that_is_none_comes_out_and_each_is_counted() {
    let mut server = Server::new(&["Wand", "Head"]);
    server.besides = |ms| {
        let mut bytes = Vec::new();
        for (at, q) in [
            ([f64::NAN, 0.0, 0.0], UPRIGHT),
            ([1.0; 3], [0.0; 4]),
            ([1.0; 3], [f64::NAN; 4]),
            ([1.0; 3], [2.0, 0.0, 0.0, 0.0]),
            ([0.0; 3], UPRIGHT),
            ([0.0, 0.0, 1700.0], UPRIGHT),
        ] {
            wire::pose(from(10, TYPE, ms), 0, at, q, &mut bytes);
        }
        // Of a type that nobody has described.
        wire::message(from(10, 55, ms), &[1; 5], &mut bytes);
        bytes
    };
    let mut rig = rig(server);
    rig.run_ms(205);
    let periods = rig.samples.len() as u64 / 2;
    assert!(periods >= 18);
    all_true(&rig);
    assert_eq!(rig.session.counters().rejected, 7 * periods);
    assert!(rig.warnings.iter().any(|text| text.contains("mm")), "{:?}", rig.warnings);
    assert!(rig.warnings.len() <= 4, "{:?}", rig.warnings);
}

#[test]
fn a_clock_that_stands_still_gives_no_poses() {
    let mut server = Server::new(&["Head"]);
    server.besides = |ms| {
        let mut bytes = Vec::new();
        wire::pose(from(10, TYPE, 5), 0, [1.0, ms as f64 * 1e-3, 1.0], UPRIGHT, &mut bytes);
        wire::pose(from(10, TYPE, 5), 0, [1.0, ms as f64 * 1e-3, 1.0], UPRIGHT, &mut bytes);
        bytes
    };
    let mut rig = Rig::open(session(&["Head"], &[1]), server);
    rig.run_ms(100);
    let again = rig.session.counters().rejected;
    assert!(again >= 9, "{again}");
    assert!(rig.warnings.iter().any(|text| text.contains("clock")), "{:?}", rig.warnings);
}

#[test]
fn servers_of_another_version_and_no_servers_are_named() {
    let mut server = Server::new(&["Wand", "Head"]);
    server.greeting[12] = b'8';
    let mut rig = rig(server);
    rig.run_ms(1000);
    assert!(matches!(rig.session.state(), State::Failed { .. }), "{:?}", rig.session.state());
    assert!(rig.reason().contains("08.38"), "{}", rig.reason());
    assert_eq!(rig.samples.len(), 0);
    // Another one has been started in its place.
    rig.device.greeting = GREETING;
    rig.run_ms(6000);
    assert!(rig.is_streaming(), "{}", rig.reason());

    let mut server = Server::new(&["Wand", "Head"]);
    server.deaf = true;
    let mut rig = self::rig(server);
    rig.run_stored_ms(4000);
    assert!(matches!(rig.session.state(), State::Silent { .. }), "{}", rig.reason());
    assert_eq!(rig.device.greetings, 2);
    rig.session.handle_bytes(rig.now, b"HTTP/1.1 400 Bad Request\r\n\r\n");
    rig.run_ms(100);
    assert!(rig.session.counters().bytes_skipped > 20);
    rig.device.deaf = false;
    rig.run_ms(4000);
    assert!(rig.is_streaming(), "{}", rig.reason());
}

#[test]
fn silent_trackers_are_asked_for_and_a_server_without_a_sign_of_life_is_greeted_anew() {
    let mut rig = rig(Server::new(&["Wand", "Head"]));
    rig.run_ms(300);
    rig.device.reports = false;
    rig.run_stored_ms(20_000);
    assert!(matches!(rig.session.state(), State::Silent { .. }));
    assert!(rig.reason().contains("in sight"), "{}", rig.reason());
    assert_eq!(rig.device.greetings, 1, "it answers, and nothing begins anew");
    rig.device.reports = true;
    rig.run_ms(100);
    assert!(rig.is_streaming());
    rig.device.deaf = true;
    rig.run_ms(10_000);
    assert!(rig.device.greetings > 1);
    rig.device.deaf = false;
    rig.samples.clear();
    rig.run_ms(4000);
    assert!(rig.is_streaming(), "{}", rig.reason());
    all_true(&rig);
    // A connection that is lost.
    let now = rig.now;
    rig.session.handle_line(now, &LineEvent::Closed { reason: "gone".into() });
    rig.session.handle_line(now, &LineEvent::Opened { modem_lines: false });
    rig.samples.clear();
    rig.run_ms(100);
    assert!(rig.is_streaming() && rig.samples.len() > 10, "{}", rig.reason());
    all_true(&rig);
}

#[test]
fn a_tracker_that_the_server_does_not_have_is_named_with_those_it_has() {
    let mut rig = rig(Server::new(&["wand", "Head"]));
    rig.run_ms(200);
    assert!(rig.is_streaming());
    let warning = &rig.warnings[0];
    assert!(warning.contains("\"Wand\"") && warning.contains("\"wand\""), "{warning}");
    assert!(rig.samples.iter().all(|sample| sample.address == 1));
}

#[test]
fn behind_dropped_and_damaged_bytes_it_finds_the_next_pose() {
    let mut rig = rig(Server::new(&["Wand", "Head"]));
    rig.run_ms(205);
    let before = rig.samples.len();
    let mut bytes = Vec::new();
    wire::pose(from(10, TYPE, 9999), 0, [1.0, 0.0, 0.5], UPRIGHT, &mut bytes);
    rig.session.handle_line(rig.now, &LineEvent::Dropped { bytes: 1000 });
    rig.session.handle_bytes(rig.now, &bytes[13..]);
    rig.run_ms(100);
    assert!(rig.samples.len() >= before + 18, "{} {before}", rig.samples.len());
    all_true(&rig);
    // A length that no message has.
    let before = (rig.samples.len(), rig.session.counters().rejected);
    bytes[..4].copy_from_slice(&[0x7F, 0xFF, 0xFF, 0xFF]);
    rig.session.handle_bytes(rig.now, &bytes);
    rig.run_ms(100);
    assert!(rig.samples.len() >= before.0 + 18);
    assert_eq!(rig.session.counters().rejected, before.1 + 1);
    all_true(&rig);
}

#[test]
fn settings_that_cannot_be_are_refused() {
    let of = |trackers: &[&str], wanted: &[u16]| {
        let trackers = trackers.iter().map(|name| (*name).to_owned()).collect();
        VrpnSession::new(Settings { trackers }, wanted).map(drop).map_err(|error| error.key)
    };
    assert_eq!(of(&["Head", "Wand"], &[1, 2, 256 + 2]), Ok(()));
    for trackers in [&[][..], &[""], &["Head", "Head"], &["a\0b"]] {
        assert_eq!(of(trackers, &[1]), Err("trackers"), "{trackers:?}");
    }
    for wanted in [&[][..], &[0], &[3], &[1, 1], &[256]] {
        assert_eq!(of(&["Head", "Wand"], wanted), Err("address"), "{wanted:?}");
    }
}
