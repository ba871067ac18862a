//! The open format: worked examples, round trips, and the session against pretended devices on all carriers.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::Duration;

use posed_drivers::datagram::{Datagram, datagrams};
use posed_drivers::open_imu::wire::json::{self, Item};
use posed_drivers::open_imu::wire::osc::{Value, Writer};
use posed_drivers::open_imu::wire::{Battery, Count, Hello, Message, Motion, Refused, Time, Unit, csv, osc};
use posed_drivers::open_imu::{Carrier, OpenImuSession, Settings};
use posed_drivers::{DeviceTime, LineEvent, Measurement, Output, Session, State, Timestamp};
use proptest::prelude::*;

use crate::hex;
use crate::matrix::Noise;
use crate::rig::{Device, Rig};

const ID: &str = "esp-7f3a";

fn items(text: &str) -> Vec<Item> {
    let mut found = Vec::new();
    json::items(text.as_bytes(), &mut |item| found.push(item)).unwrap();
    found
}

fn osc_messages(datagram: &[u8]) -> Vec<Result<(String, Message), Refused>> {
    let mut found = Vec::new();
    osc::messages(datagram, &mut |message| found.push(message.map(|(id, message)| (id.to_owned(), message))));
    found
}

fn csv_message(line: &str) -> Message {
    let (id, message) = csv::parse(line.as_bytes(), false).unwrap().unwrap();
    assert_eq!(id, ID);
    message
}

fn motion(number: u32, ticks: i64, gyro: [f32; 3], acc: [f32; 3]) -> Motion {
    Motion::checked(Some(number), Some(Time::Ticks(ticks)), [Some(gyro), Some(acc), None], None).unwrap()
}

fn message(count: Count, motion: Motion) -> Message {
    Message::Motion { sensor: 0, count, motion: Ok(motion) }
}

#[test]
fn worked_examples_of_json() {
    let hello = r#"{"imu":1,"id":"esp-7f3a","name":"Left thigh","rate":100,"unit":"us","bits":32}"#;
    let [Item::Hello { id, hello }] = &items(hello)[..] else { panic!() };
    assert_eq!((id.as_str(), hello.name.as_deref(), hello.rate_hz), (ID, Some("Left thigh"), Some(100.0)));
    assert_eq!((hello.unit, hello.bits), (Some(Unit::Microseconds), Some(32)));
    let sample = items(r#"{"n":41,"t":1234567,"g":[0.1,-0.05,0],"a":[0,0,9.80665]}"#);
    let truth = motion(41, 1_234_567, [0.1, -0.05, 0.0], [0.0, 0.0, 9.80665]);
    assert_eq!(sample, [Item::Message(message(Count::Motion, truth))]);
    let block = items(r#"{"b":[[42,1244567,0.1,-0.05,0,0,0,9.81],[43,1254567,0.1,-0.05,0,0,0,9.81]]}"#);
    let row = |number, ticks| {
        Item::Message(message(Count::Motion, motion(number, ticks, [0.1, -0.05, 0.0], [0.0, 0.0, 9.81])))
    };
    assert_eq!(block, [row(42, 1_244_567), row(43, 1_254_567)]);
}

#[test]
fn worked_examples_of_osc() {
    let o1 = hex(
        "2F 69 6D 75 2F 31 2F 65 73 70 2D 37 66 33 61 2F 30 00 00 00 2C 69 68 66 66 66 66 66 66 00 00 00 00 00 00 29 00 00 00 00
         00 12 D6 87 3D CC CC CD BD 4C CC CD 00 00 00 00 00 00 00 00 00 00 00 00 41 1C E8 0A",
    );
    let truth = motion(41, 1_234_567, [0.1, -0.05, 0.0], [0.0, 0.0, 9.80665]);
    assert_eq!(osc_messages(&o1), [Ok((ID.to_owned(), message(Count::Motion, truth)))]);
    let floats = |values: &[f32]| values.iter().map(|&value| Value::Float(value)).collect::<Vec<_>>();
    let numbered = |values: &[f32]| [vec![Value::Int(41), Value::Long(1_234_567)], floats(values)].concat();
    assert_eq!(Writer::message(ID, "0", &numbered(&[0.1, -0.05, 0.0, 0.0, 0.0, 9.80665])), o1);

    let o2 = hex(
        "2F 69 6D 75 2F 31 2F 65 73 70 2D 37 66 33 61 2F 30 2F 71 00 2C 69 68 66 66 66 66 00 00 00 00 29 00 00 00 00 00 12 D6 87
         3F 80 00 00 00 00 00 00 00 00 00 00 00 00 00 00",
    );
    let [Ok((_, Message::Motion { count: Count::Orientation, motion: Ok(found), .. }))] =
        &osc_messages(&o2)[..]
    else {
        panic!()
    };
    assert_eq!(found.orientation_wxyz, Some([1.0, 0.0, 0.0, 0.0]));
    assert_eq!(Writer::message(ID, "0/q", &numbered(&[1.0, 0.0, 0.0, 0.0])), o2);

    let name = [Value::Text("Left thigh"), Value::Text("wrist-band 0.3"), Value::Int(100)];
    let o3 = Writer::message(ID, "hello", &name);
    assert_eq!(o3.len(), 64);
    let [Ok((_, Message::Hello(hello)))] = &osc_messages(&o3)[..] else { panic!() };
    assert_eq!((hello.software.as_deref(), hello.rate_hz), (Some("wrist-band 0.3"), Some(100.0)));

    let bundle = Writer::bundle(&[o3, Writer::bundle(&[o1]), o2]);
    assert_eq!(osc_messages(&bundle).len(), 3);
}

#[test]
fn worked_examples_of_lines() {
    let c1 = "$I,esp-7f3a,0,41,1234567,0.1000,-0.0500,0.0000,0.0000,0.0000,9.8067*2D";
    let truth = motion(41, 1_234_567, [0.1, -0.05, 0.0], [0.0, 0.0, 9.8067]);
    assert_eq!(csv_message(c1), message(Count::Motion, truth));
    assert_eq!(csv::line(&c1[1..c1.len() - 3]), format!("{c1}\n").as_bytes());
    let c2 = "$I,esp-7f3a,0,42,1244567,0.1000,-0.0500,0.0000,0.0000,0.0000,9.8067,22.1,-3.0,41.5*04";
    let Message::Motion { motion: Ok(found), .. } = csv_message(c2) else { panic!() };
    assert_eq!(found.mag_ut, Some([22.1_f32, -3.0, 41.5].map(f64::from)));
    let c3 = "$Q,esp-7f3a,0,43,1254567,1.00000,0.00000,0.00000,0.00000*19";
    let Message::Motion { count: Count::Orientation, motion: Ok(found), .. } = csv_message(c3) else {
        panic!()
    };
    assert_eq!(found.orientation_wxyz, Some([1.0, 0.0, 0.0, 0.0]));
    let battery = Battery { level: Some(0.87), volts: Some(3.95), charging: Some(false) };
    assert_eq!(csv_message("$B,esp-7f3a,87,3.95,0*24"), Message::Battery(battery));
    let Message::Hello(hello) = csv_message("$H,esp-7f3a,1,Left thigh,wrist-band 0.3,100,us,32*08") else {
        panic!()
    };
    assert_eq!((hello.version, hello.name.as_deref(), hello.bits), (1, Some("Left thigh"), Some(32)));
    assert_eq!(csv::parse(b"$I,esp-7f3a,0,1,2,0,0,0,0,0,9.81", false), Err(Refused));
    assert!(csv::parse(b"$I,esp-7f3a,0,1,2,0,0,0,0,0,9.81", true).unwrap().is_some());
    assert_eq!(csv::parse(csv::line("Z,esp-7f3a,new").trim_ascii_end(), false), Ok(None));
}

#[test]
fn what_no_sensor_measures_is_refused() {
    let refused = |text: &str| {
        let [Item::Message(Message::Motion { motion, .. })] = items(text)[..] else { panic!() };
        motion.is_err()
    };
    assert!(refused(r#"{"n":1,"g":[71,0,0],"a":[0,0,9.8]}"#));
    assert!(refused(r#"{"n":1,"g":[1,0,0],"a":[0,0,401]}"#));
    assert!(refused(r#"{"n":1,"g":[1,0,0],"a":[0,0,9.8],"m":[10001,0,0]}"#));
    assert!(refused(r#"{"n":1,"q":[0.5,0.5,0.5,0]}"#));
    let [Item::Message(Message::Motion { motion: Ok(kept), .. })] =
        items(r#"{"n":1,"g":[1,0,0],"q":[0.5,0.5,0.5,0.9],"later":{"x":[1]}}"#)[..]
    else {
        panic!()
    };
    assert_eq!(kept.orientation_wxyz, None);
    for bad in [
        "",
        "[]",
        "{}",
        r#"{"n":1}"#,
        r#"{"n":-1,"g":[0,0,0]}"#,
        r#"{"g":[0,0]}"#,
        r#"{"b":[]}"#,
        r#"{"imu":1,"id":"a b"}"#,
    ] {
        assert_eq!(json::items(bad.as_bytes(), &mut drop), Err(Refused), "{bad}");
    }
    let rows = format!(r#"{{"b":[{}]}}"#, ["[1,2,0,0,0,0,0,9]"; 65].join(","));
    assert_eq!(json::items(rows.as_bytes(), &mut drop), Err(Refused));
}

proptest! {
    #[test]
    fn osc_reads_what_rosc_writes(n: i32, t: i64, values in proptest::array::uniform9(-60.0_f32..60.0)) {
        let mut args = vec![rosc::OscType::Int(n), rosc::OscType::Long(t)];
        args.extend(values.map(rosc::OscType::Float));
        let packet = rosc::OscMessage { addr: format!("/imu/1/{ID}/3"), args };
        let bytes = rosc::encoder::encode(&rosc::OscPacket::Message(packet.clone())).unwrap();
        let three = |at: usize| Some([values[at], values[at + 1], values[at + 2]]);
        let motion = Motion::checked(Some(n as u32), Some(Time::Ticks(t)), [three(0), three(3), three(6)], None);
        let truth = Message::Motion { sensor: 3, count: Count::Motion, motion };
        prop_assert_eq!(osc_messages(&bytes), vec![Ok((ID.to_owned(), truth.clone()))]);
        let timetag = rosc::OscTime { seconds: 1, fractional: 0 };
        let content = vec![rosc::OscPacket::Message(packet)];
        let bundle = rosc::encoder::encode(&rosc::OscPacket::Bundle(rosc::OscBundle { timetag, content })).unwrap();
        prop_assert_eq!(osc_messages(&bundle), vec![Ok((ID.to_owned(), truth))]);
    }

    #[test]
    fn all_carriers_give_the_same_sample(
        n: u32,
        t in 0..i64::from(u32::MAX),
        values in proptest::array::uniform6(-60.0_f32..60.0),
    ) {
        let list = |at: usize| format!("{:?}", &values[at..at + 3]);
        let text = format!(r#"{{"n":{n},"t":{t},"g":{},"a":{}}}"#, list(0), list(3));
        let fields: Vec<String> = values.iter().map(f32::to_string).collect();
        let line = csv::line(&format!("I,{ID},0,{n},{t},{}", fields.join(",")));
        let mut arguments = vec![Value::Int(n as i32), Value::Long(t)];
        arguments.extend(values.map(Value::Float));
        let datagram = Writer::message(ID, "0", &arguments);
        let sample = |carrier: &str| {
            let mut rig = Talk::new(Carrier::Envelopes { port: 9301, websocket: 0 }, &[ID], &[1]);
            match carrier {
                "json" => {
                    rig.text(PEER, &format!(r#"{{"imu":1,"id":"{ID}"}}"#));
                    rig.text(PEER, &text);
                }
                "osc" => rig.datagram(PEER, &datagram),
                _ => rig.datagram(PEER, &line),
            }
            rig.samples.iter().map(|sample| (sample.address, sample.t_device, sample.measurement)).collect::<Vec<_>>()
        };
        let json = sample("json");
        prop_assert_eq!(json.len(), 1);
        prop_assert_eq!(&json, &sample("osc"));
        prop_assert_eq!(&json, &sample("csv"));
    }
}

const PEER: SocketAddr =
    SocketAddr::V4(std::net::SocketAddrV4::new(std::net::Ipv4Addr::new(192, 0, 2, 7), 5000));
const OTHER: SocketAddr =
    SocketAddr::V4(std::net::SocketAddrV4::new(std::net::Ipv4Addr::new(192, 0, 2, 8), 5000));

/// A session to which a test speaks.
struct Talk {
    session: OpenImuSession,
    now: Timestamp,
    samples: Vec<posed_drivers::Sample>,
    warnings: Vec<String>,
    /// What it answered, and to whom; nothing closes a connection.
    answers: Vec<(SocketAddr, String)>,
    presses: usize,
}

impl Talk {
    fn new(carrier: Carrier, devices: &[&str], wanted: &[u16]) -> Self {
        let devices = devices.iter().map(|&id| id.to_owned()).collect();
        let settings = Settings { devices, ..Settings::default() };
        let session = OpenImuSession::new(settings, carrier, wanted).unwrap();
        let now = Timestamp::from_secs_f64(1.0);
        let mut talk = Self { session, now, samples: vec![], warnings: vec![], answers: vec![], presses: 0 };
        talk.session.handle_line(now, &LineEvent::Opened { modem_lines: false });
        talk.drain();
        talk
    }

    fn drain(&mut self) {
        while let Some(output) = self.session.poll_output() {
            match output {
                Output::Transmit(bytes) => {
                    for Datagram { peer, data } in datagrams(&bytes).flatten() {
                        self.answers.push((peer, String::from_utf8(data.to_vec()).unwrap()));
                    }
                }
                Output::Sample(sample) => self.samples.push(sample),
                Output::Warning(warning) => self.warnings.push(warning),
                Output::Pressed { .. } => self.presses += 1,
                _ => {}
            }
        }
    }

    fn datagram(&mut self, peer: SocketAddr, data: &[u8]) {
        self.session.handle_bytes(self.now, &Datagram { peer, data }.encode());
        self.drain();
    }

    fn text(&mut self, peer: SocketAddr, text: &str) {
        self.datagram(peer, text.as_bytes());
    }

    fn line(&mut self, fields: &str) {
        self.session.handle_bytes(self.now, &csv::line(fields));
        self.drain();
    }

    fn pass_ms(&mut self, ms: u64) {
        self.now = self.now + Duration::from_millis(ms);
        while self.session.poll_timeout().is_some_and(|at| at <= self.now) {
            self.session.handle_timeout(self.now);
            self.drain();
        }
    }

    fn answered(&mut self) -> Vec<(SocketAddr, String)> {
        std::mem::take(&mut self.answers)
    }
}

fn sample_text(n: u32, t_us: i64) -> String {
    format!(r#"{{"n":{n},"t":{t_us},"g":[0.1,-0.05,0],"a":[0,0,9.80665]}}"#)
}

#[test]
fn a_phone_says_hello_and_sends() {
    let mut talk = Talk::new(Carrier::Envelopes { port: 0, websocket: 0 }, &[ID], &[1]);
    talk.text(PEER, &sample_text(1, 0));
    assert!(talk.answered()[0].1.starts_with(r#"{"err":"no_hello""#));
    talk.text(PEER, r#"{"imu":1,"id":"esp-7f3a","name":"Left thigh","rate":100,"unit":"us","bits":32}"#);
    assert_eq!(talk.answered(), [(PEER, r#"{"ok":1,"id":"esp-7f3a","epoch":1}"#.to_owned())]);
    talk.text(PEER, r#"{"ping":17}"#);
    assert_eq!(talk.answered(), [(PEER, r#"{"pong":17,"t":1000000}"#.to_owned())]);
    for n in 41..45 {
        talk.text(PEER, &sample_text(n, 10_000 * i64::from(n)));
        talk.pass_ms(10);
    }
    assert_eq!((talk.samples.len(), talk.session.state()), (4, &State::Streaming));
    assert_eq!(talk.samples[0].t_device, DeviceTime::Counter { ticks: 410_000, tick_s: 1e-6 });
    assert_eq!(talk.session.sensors()[0].serial.as_deref(), Some(ID));
    assert_eq!(talk.session.rate_hz(), Some(100.0));
    talk.text(PEER, r#"{"btn":1,"ev":"button"}"#);
    talk.text(PEER, r#"{"btn":1}"#);
    talk.text(PEER, r#"{"bat":0.05}"#);
    talk.text(PEER, r#"{"volt":3.5}"#);
    assert_eq!(talk.presses, 1);
    let condition = talk.session.conditions()[0];
    assert_eq!((condition.battery, condition.battery_v), (Some(0.05), Some(3.5)));
    talk.text(PEER, r#"{"bye":"page hidden"}"#);
    assert!(matches!(talk.session.state(), State::Silent { .. }), "{:?}", talk.session.state());
    assert!(talk.warnings.iter().any(|warning| warning.contains("page hidden")), "{:?}", talk.warnings);
    assert_eq!(talk.session.conditions()[0].battery, None);
}

#[test]
fn a_second_connection_takes_the_place_of_the_first() {
    let mut talk = Talk::new(Carrier::Envelopes { port: 0, websocket: 0 }, &[ID], &[1]);
    let hello = format!(r#"{{"imu":1,"id":"{ID}"}}"#);
    talk.text(PEER, &hello);
    talk.text(PEER, &sample_text(7, 0));
    talk.answered();
    talk.text(OTHER, &hello);
    let answers = talk.answered();
    assert_eq!((answers[0].0, answers[1].clone()), (PEER, (PEER, String::new())));
    assert!(answers[0].1.contains("dup_id"));
    assert_eq!(answers[2].1, r#"{"ok":1,"id":"esp-7f3a","epoch":2}"#);
    // Its numbers and times begin anew, and nothing of that is lost or late.
    talk.text(OTHER, &sample_text(1, 0));
    assert_eq!((talk.samples.len(), talk.session.losses()[0].lost), (2, 0));
    // The daemon says that the new one is gone.
    talk.datagram(OTHER, b"");
    assert!(matches!(talk.session.state(), State::Silent { .. }));
}

#[test]
fn whoever_sends_nonsense_is_closed() {
    let mut talk = Talk::new(Carrier::Envelopes { port: 0, websocket: 0 }, &[ID], &[1]);
    talk.text(PEER, &format!(r#"{{"imu":1,"id":"{ID}"}}"#));
    talk.answered();
    talk.text(PEER, "{nonsense");
    talk.datagram(PEER, &[0xFF, 1]);
    talk.text(PEER, &format!(r#"{{"x":"{}"}}"#, "y".repeat(17_000)));
    let answers = talk.answered();
    let codes: Vec<&str> = answers.iter().map(|(_, text)| text.split('"').nth(3).unwrap_or("")).collect();
    assert_eq!(codes, ["bad_json", "bad_type", "too_big", ""]);
    // Once in a while is forgiven.
    talk.text(PEER, &format!(r#"{{"imu":1,"id":"{ID}"}}"#));
    for _ in 0..10 {
        talk.text(PEER, "{nonsense");
        talk.pass_ms(600);
    }
    assert!(talk.answered().iter().all(|(_, text)| !text.is_empty()));
    // A flood of samples is refused sample by sample: it costs no memory.
    for n in 0..5000 {
        talk.text(PEER, &sample_text(n, i64::from(n)));
    }
    assert_eq!(talk.samples.len(), 1100);
    assert!(talk.warnings.iter().any(|warning| warning.contains("more than 1000 samples")));
}

#[test]
fn what_the_settings_do_not_name_is_found_and_feeds_nothing() {
    let mut talk = Talk::new(Carrier::Envelopes { port: 9301, websocket: 0 }, &[ID], &[1]);
    talk.datagram(OTHER, &csv::line("H,new-one,1,Ankle,0.1,50,ms,32"));
    talk.datagram(OTHER, &csv::line("I,new-one,2,1,10,0,0,0,0,0,9.81"));
    talk.datagram(PEER, &csv::line("I,esp-7f3a,1,1,10,0,0,0,0,0,9.81"));
    assert!(talk.samples.is_empty() && talk.session.state() != &State::Streaming);
    let found: Vec<_> = talk.session.found().iter().map(|found| (found.id.as_str(), found.sensor)).collect();
    assert_eq!(found, [("new-one", 2), (ID, 1)]);
    assert_eq!(talk.session.found()[0].rate_hz, Some(50.0));
    // 64 devices, and not one more, until some are gone.
    for k in 0..100 {
        talk.datagram(OTHER, &csv::line(&format!("I,more-{k},0,1,10,0,0,0,0,0,9.81")));
    }
    assert_eq!(talk.session.found().len(), 64);
    talk.pass_ms(11_000);
    talk.datagram(OTHER, &csv::line("I,later,0,1,10,0,0,0,0,0,9.81"));
    assert!(talk.session.found().iter().any(|found| found.id == "later"));
    assert!(talk.session.found().len() <= 64);
}

#[test]
fn two_devices_of_one_name_do_not_mix() {
    let mut talk = Talk::new(Carrier::Envelopes { port: 9301, websocket: 0 }, &[ID], &[1]);
    for n in 0..50 {
        talk.datagram(PEER, &csv::line(&format!("I,{ID},0,{n},{},0,0,0,0,0,9.81", 10_000 * n)));
        talk.datagram(OTHER, &csv::line(&format!("I,{ID},0,{},{},0,0,0,0,0,1.0", 700 + n, 10_000 * n)));
        talk.pass_ms(10);
    }
    assert_eq!(talk.samples.len(), 50);
    assert!(talk.warnings.iter().any(|warning| warning.contains("two devices call themselves esp-7f3a")));
    // The first falls silent, the second may be it under another address.
    talk.pass_ms(3000);
    talk.datagram(OTHER, &csv::line(&format!("I,{ID},0,900,9000000,0,0,0,0,0,9.81")));
    assert_eq!(talk.samples.len(), 51);
}

#[test]
fn who_looks_for_a_server_is_answered() {
    let mut talk = Talk::new(Carrier::Envelopes { port: 9302, websocket: 8787 }, &[], &[]);
    talk.datagram(PEER, b"IMU?1");
    assert_eq!(talk.answered(), [(PEER, "IMU!1 posed 8787 9302 9302".to_owned())]);
}

#[test]
fn losses_are_counted_exactly_and_late_samples_refused() {
    let mut talk = Talk::new(Carrier::Envelopes { port: 9301, websocket: 0 }, &[ID], &[1]);
    let mut noise = Noise::new(3);
    let (mut lost, mut held) = (0_u64, None);
    for n in 0..60_000_u32 {
        let line = csv::line(&format!(
            "I,{ID},0,{},{},0,0,0,0,0,9.81",
            n.wrapping_add(u32::MAX - 100),
            u64::from(n) * 10_000 % (1 << 32)
        ));
        talk.pass_ms(10);
        // The last one arrives: what is missing behind it nobody can know.
        if n + 1 < 60_000 && noise.below(100) == 0 {
            lost += 1;
            // Some of them come too late.
            held = (noise.below(4) == 0).then_some(line);
            continue;
        }
        talk.datagram(PEER, &line);
        if let Some(late) = held.take() {
            talk.datagram(PEER, &late);
        }
        if noise.below(200) == 0 {
            talk.datagram(PEER, &line);
        }
    }
    assert_eq!((talk.session.losses()[0].lost, talk.session.losses()[0].estimated), (lost, false));
    assert_eq!(talk.samples.len() as u64, 60_000 - lost);
    let ticks: Vec<u64> = talk
        .samples
        .iter()
        .map(|sample| match sample.t_device {
            DeviceTime::Counter { ticks, .. } | DeviceTime::Cycle(ticks) => ticks,
        })
        .collect();
    assert!(ticks.windows(2).all(|pair| pair[0] < pair[1]));
}

/// A board on a serial line at 100 Hz.
struct Board {
    queue: VecDeque<Vec<u8>>,
    next: Timestamp,
    n: u32,
    epoch: Timestamp,
    on: bool,
    asked: usize,
}

impl Device for Board {
    fn receive(&mut self, _: Timestamp, bytes: &[u8]) {
        self.asked += usize::from(bytes == csv::WHO);
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        if self.on && self.next <= now {
            self.next = now + Duration::from_millis(10);
            let t_us = (now.seconds_since(self.epoch) * 1e6) as u64;
            if self.n.is_multiple_of(500) {
                self.queue.push_back(b"boot ok\r\n".to_vec());
                self.queue.push_back(csv::line(&format!("H,{ID},1,Left thigh,x,100,us,32")));
            }
            self.queue.push_back(csv::line(&format!("I,{ID},0,{},{t_us},0.1,0,0,0,0,9.81", self.n)));
            self.n += 1;
        }
        self.queue.pop_front()
    }
}

fn board() -> Rig<OpenImuSession, Board> {
    let settings = Settings { devices: vec![ID.to_owned()], ..Settings::default() };
    let session = OpenImuSession::new(settings, Carrier::Line, &[1]).unwrap();
    let epoch = Timestamp::ZERO;
    Rig::open(session, Board { queue: VecDeque::new(), next: epoch, n: 0, epoch, on: true, asked: 0 })
}

#[test]
fn a_board_on_a_line_streams_falls_silent_and_begins_anew() {
    let mut rig = board();
    rig.run_stored_ms(1000);
    assert_eq!(rig.device.asked, 1);
    assert!(rig.is_streaming() && (99..=101).contains(&rig.samples.len()), "{}", rig.samples.len());
    assert!(rig.warnings.iter().any(|warning| warning.contains("boot ok")), "{:?}", rig.warnings);
    rig.device.on = false;
    rig.run_ms(3000);
    assert!(rig.reason().contains("no device sends"), "{}", rig.reason());
    rig.device.on = true;
    (rig.device.n, rig.device.epoch) = (0, rig.now);
    let before = rig.samples.len();
    rig.run_ms(1000);
    assert!(rig.is_streaming() && rig.samples.len() >= before + 98, "{}", rig.samples.len() - before);
    assert_eq!(rig.session.losses()[0].lost, 0);
    assert!(rig.warnings.iter().any(|warning| warning.contains("is back")), "{:?}", rig.warnings);
}

#[test]
fn a_damaged_line_gives_nothing_false() {
    let truth = |measurement: &Measurement| {
        *measurement
            == Measurement::Imu {
                angular_velocity_rad_s: Some([f64::from(0.1_f32), 0.0, 0.0]),
                specific_force_m_s2: Some([0.0, 0.0, f64::from(9.81_f32)]),
                linear_acceleration_m_s2: None,
                magnetic_field: None,
                orientation_wxyz: None,
            }
    };
    for seed in 0..20 {
        let mut noise = Noise::new(seed);
        let mut rig = board();
        for _ in 0..400 {
            rig.run_ms(10);
            match noise.below(8) {
                0 => rig.device.queue.push_back(noise.bytes(noise_len(seed))),
                1 => rig.device.queue.push_back(csv::line(&format!("I,{ID},0,99,1,0,0,0"))[..20].to_vec()),
                2 => {
                    let mut line = csv::line(&format!("I,{ID},0,{},77,0.1,0,0,0,0,9.81", rig.device.n));
                    let at = noise.below(line.len());
                    line[at] ^= 1 << noise.below(8);
                    rig.device.queue.push_back(line);
                }
                _ => {}
            }
        }
        assert!(rig.samples.iter().all(|sample| truth(&sample.measurement)), "{seed}");
        assert!(rig.samples.len() > 250, "{seed}: {}", rig.samples.len());
        let times: Vec<u64> = rig
            .samples
            .iter()
            .map(|sample| match sample.t_device {
                DeviceTime::Counter { ticks, .. } | DeviceTime::Cycle(ticks) => ticks,
            })
            .collect();
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{seed}");
    }
}

fn noise_len(seed: u64) -> usize {
    5 + seed as usize % 40
}

#[test]
fn a_long_line_is_passed_over() {
    let mut talk = Talk::new(Carrier::Line, &[ID], &[1]);
    talk.session.handle_bytes(talk.now, &vec![b'$'; 10_000]);
    talk.session.handle_bytes(talk.now, b"\n");
    talk.line(&format!("I,{ID},0,1,2,0,0,0,0,0,9.81"));
    assert_eq!(talk.samples.len(), 1);
}

#[test]
fn sixteen_sensors_at_1000_hz_are_served() {
    let wanted: Vec<u16> = (0..16).map(|sensor| sensor << 8 | 1).collect();
    let mut talk = Talk::new(Carrier::Envelopes { port: 9301, websocket: 0 }, &[ID], &wanted);
    for n in 0..2000_i32 {
        let messages: Vec<Vec<u8>> = (0..16)
            .map(|sensor| {
                let mut arguments = vec![Value::Int(n), Value::Long(1000 * i64::from(n))];
                arguments.extend([0.1, 0.0, 0.0, 0.0, 0.0, 9.81].map(Value::Float));
                Writer::message(ID, &sensor.to_string(), &arguments)
            })
            .collect();
        talk.datagram(PEER, &Writer::bundle(&messages));
        talk.pass_ms(1);
    }
    assert_eq!(talk.samples.len(), 32_000);
    assert!(talk.session.losses().iter().all(|loss| loss.lost == 0));
    // One more sensor than a device may have.
    let seventeenth = csv::line(&format!("I,{ID},17,1,2,0,0,0,0,0,9.81"));
    talk.datagram(PEER, &seventeenth);
    assert!(talk.warnings.iter().any(|warning| warning.contains("more than 16 sensors")));
}

#[test]
fn settings_are_checked() {
    let new = |devices: &[&str], wanted: &[u16]| {
        let devices = devices.iter().map(|&id| id.to_owned()).collect();
        OpenImuSession::new(Settings { devices, ..Settings::default() }, Carrier::Line, wanted).map(drop)
    };
    assert_eq!(new(&["a", "b"], &[1, 2, 0x102]), Ok(()));
    assert_eq!(new(&[], &[]), Ok(()));
    assert_eq!(new(&["a", "a"], &[1]).unwrap_err().key, "devices");
    assert_eq!(new(&["a b"], &[1]).unwrap_err().key, "devices");
    assert_eq!(new(&["a"], &[2]).unwrap_err().key, "address");
    assert_eq!(new(&["a"], &[0]).unwrap_err().key, "address");
    let settings = Settings { rate_hz: Some(2000.0), ..Settings::default() };
    assert_eq!(OpenImuSession::new(settings, Carrier::Line, &[]).unwrap_err().key, "rate_hz");
    assert_eq!(Hello::default().bits, None);
}
