//! SlimeVR by radio: the worked examples of a receiver's reports, and the session with them.

use std::f64::consts::FRAC_1_SQRT_2;
use std::time::Duration;

use posed_drivers::datagram::Datagram;
use posed_drivers::slimevr::hid::{self, Contents, PACKET, Packet, RECEIVER};
use posed_drivers::slimevr::wire as udp;
use posed_drivers::slimevr::{Settings, SlimeVrSession};
use posed_drivers::{LineEvent, Measurement, Output, Sample, Session, State, Timestamp};
use proptest::prelude::*;

use crate::damage::{FRAMING, damaged};
use crate::hex;
use crate::matrix::Noise;

fn packet(text: &str) -> Packet {
    let bytes = hex(text);
    hid::packets(&bytes).unwrap().next().unwrap().unwrap()
}

fn near(q: [f64; 4], expected: [f64; 4], most: f64) -> bool {
    q.iter().zip(expected).all(|(a, b)| (a - b).abs() < most)
}

const H1: &str = "FF 00 56 34 12 EE FF C0 00 00 00 00 00 00 00 00";
const H2: &str = "00 00 D7 AA 80 18 09 00 10 02 8C 0C 00 07 03 34";
const H3: &str = "01 00 00 40 00 C0 00 40 00 40 80 00 C0 FE 00 00";
const MAC: [u8; 6] = [0xC0, 0xFF, 0xEE, 0x12, 0x34, 0x56];

#[test]
fn worked_examples() {
    assert_eq!(packet(H1), Packet { id: 0, contents: Contents::Registration(MAC) });
    let Contents::Info { battery, firmware, signal_dbm } = packet(H2).contents else { panic!() };
    assert_eq!(
        (battery.level, battery.volts, firmware, signal_dbm),
        (Some(0.87), Some(4.15), [0, 7, 3], -52.0)
    );
    let Contents::Motion { orientation_wxyz, acceleration_m_s2, .. } = packet(H3).contents else { panic!() };
    assert_eq!((orientation_wxyz, acceleration_m_s2), ([0.5, 0.5, -0.5, 0.5], Some([1.0, -2.5, 0.0])));
    let h4 = packet("02 00 D7 AA 80 C5 D6 49 B1 20 00 00 00 19 FB 3C");
    let Contents::Motion { orientation_wxyz, acceleration_m_s2, battery, signal_dbm, .. } = h4.contents
    else {
        panic!()
    };
    assert!(near(orientation_wxyz, [0.5, 0.5, -0.5, 0.5], 2e-3), "{orientation_wxyz:?}");
    assert_eq!(acceleration_m_s2, Some([0.25, 0.0, -9.804_687_5]));
    assert_eq!((battery.unwrap().level, signal_dbm), (Some(0.87), Some(-60.0)));
    let status = |text| match packet(text).contents {
        Contents::Status { code, signal_dbm } => (code, signal_dbm),
        other => panic!("{other:?}"),
    };
    assert_eq!(status("03 00 01 00 00 00 00 00 00 00 00 00 00 00 00 3C"), (1, -60.0));
    assert_eq!(status("03 01 03 04 00 00 00 00 00 00 00 00 00 00 00 47"), (3, -71.0));
    let h6 = packet("04 00 00 00 00 00 00 00 FF 7F 00 01 80 FF 00 02");
    let Contents::Motion { orientation_wxyz, acceleration_m_s2: None, .. } = h6.contents else { panic!() };
    assert!(near(orientation_wxyz, [1.0, 0.0, 0.0, 0.0], 1e-9));
    assert_eq!(packet("05 00 00 D8 75 07 05 00 00 00 00 00 00 00 00 34").contents, Contents::Other(5));
    let button = |text| match packet(text).contents {
        Contents::Button(button) => (button.presses, button.switches_off),
        other => panic!("{other:?}"),
    };
    assert_eq!(button("06 00 01 FF FF 00 00 00 00 00 00 00 00 00 00 34"), (1, false));
    assert_eq!(button("06 00 00 01 00 00 00 00 00 00 00 00 00 00 00 34"), (0, true));
    let h9 = packet("07 00 00 30 75 FF 02 10 80 00 00 00 00 00 00 34");
    let Contents::Motion { orientation_wxyz, button: Some(button), .. } = h9.contents else { panic!() };
    assert!(near(orientation_wxyz, [FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0], 2.5e-3) && !button.switches_off);
}

#[test]
fn a_report_is_whole_packets_and_copies_count_once() {
    let h10 = hex(&[H3, H2, H1, "FF 01 F6 E5 D4 C3 B2 A1 00 00 00 00 00 00 00 00"].concat());
    let ids: Vec<u8> = hid::packets(&h10).unwrap().map(|packet| packet.unwrap().id).collect();
    assert_eq!(ids, [0, 0, 0, 1]);
    assert_eq!(hid::packets(&h10[..48]).unwrap().count(), 3);
    for len in [0, 8, 40, 63] {
        assert!(hid::packets(&h10[..len]).is_none(), "{len}");
    }
    let copies = hex(H3).repeat(4);
    assert_eq!(hid::packets(&copies).unwrap().count(), 1);
    let none = hex("01 00 00 00 00 00 00 00 00 00 80 00 C0 FE 00 00");
    assert_eq!(hid::packets(&none).unwrap().next(), Some(Err(hid::Impossible)));
}

proptest! {
    #[test]
    fn reduced_rotations_are_within_half_a_degree(
        q in proptest::array::uniform4(-1.0_f64..1.0).prop_filter("long", |q| q.iter().map(|v| v * v).sum::<f64>() > 0.1),
    ) {
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let q = q.map(|v| v / norm);
        let angle_deg = |packet: [u8; PACKET]| {
            let Contents::Motion { orientation_wxyz, .. } = hid::packets(&packet).unwrap().next().unwrap().unwrap().contents else {
                panic!()
            };
            let dot: f64 = q.iter().zip(orientation_wxyz).map(|(a, b)| a * b).sum();
            (2.0 * libm::acos(dot.abs().min(1.0))).to_degrees()
        };
        prop_assert!(angle_deg(hid::reduced(1, q, [0.0; 3], [0, 0], 50)) < 0.43);
        prop_assert!(angle_deg(hid::full(1, q, [0.0; 3])) < 0.01);
    }
}

/// A session, and what it gave.
struct Radio {
    session: SlimeVrSession,
    now: Timestamp,
    samples: Vec<Sample>,
    warnings: Vec<String>,
    pressed: Vec<u16>,
}

impl Radio {
    fn open(trackers: &[&str], wanted: &[u16]) -> Self {
        let settings = Settings { trackers: trackers.iter().map(|&mac| mac.to_owned()).collect() };
        let session = SlimeVrSession::new(settings, wanted).unwrap();
        let now = Timestamp::from_secs_f64(1.0);
        let mut radio = Self { session, now, samples: vec![], warnings: vec![], pressed: vec![] };
        radio.session.handle_line(now, &LineEvent::Opened { modem_lines: false });
        radio
    }

    fn datagram(&mut self, data: &[u8], peer: std::net::SocketAddr) {
        self.session.handle_bytes(self.now, &Datagram { peer, data }.encode());
        self.drain();
    }

    fn report(&mut self, packets: &[[u8; PACKET]]) {
        self.datagram(&packets.concat(), RECEIVER);
    }

    fn drain(&mut self) {
        while let Some(output) = self.session.poll_output() {
            match output {
                Output::Sample(sample) => self.samples.push(sample),
                Output::Warning(text) => self.warnings.push(text),
                Output::Pressed { address } => self.pressed.push(address),
                Output::Transmit(bytes) => {
                    let sent = posed_drivers::datagram::datagrams(&bytes).next().unwrap().unwrap();
                    assert_ne!(sent.peer, RECEIVER, "a receiver hears nothing");
                }
                _ => {}
            }
        }
    }

    fn pass_ms(&mut self, ms: u64) {
        let end = self.now + Duration::from_millis(ms);
        while let Some(due) = self.session.poll_timeout().filter(|&due| due <= end) {
            self.now = self.now.max(due);
            self.session.handle_timeout(self.now);
            self.drain();
        }
        self.now = end;
    }
}

const Q: [f64; 4] = [0.5, 0.5, -0.5, 0.5];

#[test]
fn a_tracker_is_known_by_its_address_whatever_its_number_and_its_way() {
    let mut radio = Radio::open(&["A1:B2:C3:D4:E5:F6", "C0:FF:EE:12:34:56"], &[1, 2]);
    // Before its registration nobody knows whose it is.
    radio.report(&[hid::full(3, Q, [0.0; 3])]);
    assert!(radio.samples.is_empty());
    radio.report(&[hid::registration(3, MAC), hid::full(3, Q, [1.0, 2.0, 3.0])]);
    assert_eq!((radio.samples.len(), radio.samples[0].address), (1, 2));
    assert_eq!(radio.session.sensors()[1].serial.as_deref(), Some("C0:FF:EE:12:34:56"));
    let Measurement::Imu { linear_acceleration_m_s2, .. } = radio.samples[0].measurement else { panic!() };
    assert_eq!(linear_acceleration_m_s2, Some([1.0, 2.0, 3.0]));
    // The number is another tracker's now, and the first one is at another receiver's number.
    radio.report(&[hid::registration(3, [0xA1, 0xB2, 0xC3, 0xD4, 0xE5, 0xF6]), hid::full(3, Q, [0.0; 3])]);
    radio.report(&[hid::registration(9, MAC), hid::full(9, Q, [0.0; 3])]);
    let addresses: Vec<u16> = radio.samples.iter().map(|sample| sample.address).collect();
    assert_eq!(addresses, [2, 1, 2]);
    // It comes over Wi-Fi, and is the same.
    let peer = "192.0.2.9:40001".parse().unwrap();
    radio.datagram(&udp::encode(0, 3, &udp::handshake_body(MAC, 22, "x")), peer);
    radio.datagram(&udp::encode(1, 23, &udp::motion_body(0, Q, [0.0; 3])), peer);
    assert_eq!(radio.samples.last().unwrap().address, 2);
    radio.report(&[hid::full(9, Q, [0.0; 3])]);
    assert_eq!(radio.samples.last().unwrap().address, 2);
    assert_eq!(*radio.session.state(), State::Streaming);
}

#[test]
fn a_tracker_that_the_receiver_does_not_know_is_reported_once_it_would_have_been_named() {
    let mut radio = Radio::open(&["C0:FF:EE:12:34:56", "A1:B2:C3:D4:E5:F6"], &[1, 2]);
    let registered = |radio: &Radio| -> Vec<Option<bool>> {
        radio.session.conditions().iter().map(|condition| condition.registered).collect()
    };
    radio.report(&[hid::registration(0, MAC)]);
    assert_eq!(registered(&radio), [Some(true), None]);
    for _ in 0..11 {
        radio.pass_ms(1000);
        radio.report(&[hid::registration(0, MAC)]);
    }
    assert_eq!(registered(&radio), [Some(true), Some(false)]);
    let of_it = radio.warnings.iter().filter(|text| text.contains("does not know tracker 2 (A1:B2")).count();
    assert_eq!(of_it, 1, "{:?}", radio.warnings);
    // It is paired.
    radio.report(&[hid::registration(1, [0xA1, 0xB2, 0xC3, 0xD4, 0xE5, 0xF6])]);
    assert_eq!(registered(&radio), [Some(true), Some(true)]);
    // Over Wi-Fi it says its version in words.
    let peer = "192.0.2.9:40001".parse().unwrap();
    radio.datagram(&udp::encode(0, 3, &udp::handshake_body(MAC, 22, "0.6.1")), peer);
    assert_eq!(radio.session.conditions()[0].firmware, Some([0, 6, 1]));
}

#[test]
fn battery_and_signal_are_told_and_forgotten_when_it_is_gone() {
    let mut radio = Radio::open(&[], &[1]);
    radio.report(&[
        hid::registration(0, MAC),
        hid::info(0, [0x80 | 87, 170], [0, 7, 3], 52),
        hid::full(0, Q, [0.0; 3]),
        hid::status(0, 1, 60),
    ]);
    let condition = radio.session.conditions()[0];
    assert_eq!(
        (condition.battery, condition.battery_v, condition.signal_dbm),
        (Some(0.87), Some(4.15), Some(-60.0))
    );
    assert_eq!((condition.firmware, condition.registered), (Some([0, 7, 3]), Some(true)));
    // At rest no rotation comes; other packets show that it is there.
    for _ in 0..20 {
        radio.pass_ms(300);
        radio.report(&[hid::status(0, 1, 60), hid::registration(0, MAC)]);
    }
    assert!(!radio.warnings.iter().any(|text| text.contains("silent")), "{:?}", radio.warnings);
    // The receiver names it all the same when it is off.
    for _ in 0..20 {
        radio.pass_ms(300);
        radio.report(&[hid::registration(0, MAC)]);
    }
    assert!(radio.warnings.iter().any(|text| text.contains("gone")), "{:?}", radio.warnings);
    assert_eq!(radio.session.conditions()[0].battery, None);
    assert!(matches!(radio.session.state(), State::Silent { .. }));
    radio.report(&[hid::full(0, Q, [0.0; 3])]);
    assert_eq!((radio.samples.len(), radio.samples[1].address), (2, 1), "its place was kept");
}

#[test]
fn a_press_counts_once_and_switching_off_and_errors_are_told() {
    let mut radio = Radio::open(&[], &[1]);
    radio.report(&[hid::registration(0, MAC)]);
    for presses in [0, 1, 1, 1, 0, 2, 2, 0] {
        radio.report(&[hid::button(0, presses, 65_535)]);
    }
    assert_eq!(radio.pressed, [1, 1]);
    radio.report(&[hid::status(0, 3, 70), hid::button(0, 0, 1)]);
    for words in ["reports an error", "switches itself off"] {
        assert!(radio.warnings.iter().any(|text| text.contains(words)), "{words}: {:?}", radio.warnings);
    }
}

#[test]
fn damaged_reports_make_no_wrong_pose() {
    let (mut samples, mut wrong) = (0, 0);
    for seed in 0..500 {
        let mut radio = Radio::open(&["C0:FF:EE:12:34:56", "A1:B2:C3:D4:E5:F6"], &[1, 2]);
        let macs = [MAC, [0xA1, 0xB2, 0xC3, 0xD4, 0xE5, 0xF6]];
        let report = |n: i16| {
            let angle = 0.01 * f64::from(n);
            let q = |k: f64| [libm::cos(angle + k), libm::sin(angle + k), 0.0, 0.0];
            let registration = hid::registration((n % 2) as u8, macs[usize::from(n % 2 == 1)]);
            [
                registration,
                hid::full(0, q(0.0), [0.0; 3]),
                hid::full(1, q(1.0), [0.0; 3]),
                hid::status(0, 1, 40),
            ]
            .concat()
        };
        let reports: Vec<Vec<u8>> = (0..150).map(report).collect();
        let mut noise = Noise::new(seed);
        for bytes in damaged(&reports, &FRAMING, &mut noise) {
            radio.now = radio.now + Duration::from_millis(10);
            radio.datagram(&bytes, RECEIVER);
        }
        samples += radio.samples.len();
        let is_true = |sample: &&Sample| {
            let Measurement::Imu { orientation_wxyz: Some(q), .. } = sample.measurement else { return false };
            (0..150).any(|n| {
                let angle = 0.01 * f64::from(n) + f64::from(sample.address - 1);
                near(q, [libm::cos(angle), libm::sin(angle), 0.0, 0.0], 1e-3)
            })
        };
        wrong += radio.samples.iter().filter(|sample| !is_true(sample)).count();
    }
    assert!(samples > 500 * 200, "{samples}");
    assert_eq!(wrong, 0);
}
