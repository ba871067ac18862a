//! One matrix of tests that every decoder passes: nothing, byte by byte, at once, two at once, split
//! anywhere, damaged, garbage, truncated.
//!
//! To join: write a message, and a function that decodes pieces of bytes to the text of its records, and add
//! a line to [`decoders`].

use std::net::SocketAddr;

use posed_drivers::Timestamp;
use posed_drivers::datagram::{Datagram, datagrams};
use posed_drivers::fastrak::wire as fastrak;
use posed_drivers::flock::parser;
use posed_drivers::flock::wire as flock;
use posed_drivers::motionstar::wire as birdnet;
use posed_drivers::open_imu::wire::{self as open_imu, csv, json, osc};
use posed_drivers::polhemus::wire as polhemus;
use posed_drivers::slimevr::hid;
use posed_drivers::slimevr::wire as slime;
use posed_drivers::vrpn::reader::{Piece, Reader};
use posed_drivers::vrpn::wire as vrpn_wire;
use posed_drivers::witmotion::wire as witmotion;
use posed_drivers::x_imu3;
use posed_drivers::xbus::message::{self, Configuration, Tracker};
use posed_drivers::xbus::mtdata::{Block, Layout, Orientation};
use posed_drivers::xbus::{capture, mtdata2};

/// Repeatable noise (SplitMix64).
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub(crate) fn next(&mut self) -> u8 {
        self.word() as u8
    }

    pub(crate) fn below(&mut self, end: usize) -> usize {
        (self.word() % end as u64) as usize
    }

    pub(crate) fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.next()).collect()
    }
}

/// A decoder of the matrix.
struct Decoder {
    name: &'static str,
    /// One whole message, the same each time.
    message: Vec<u8>,
    /// Records of that message.
    records: usize,
    /// What must come before the first message.
    preamble: Vec<u8>,
    decode: fn(&[&[u8]]) -> Vec<String>,
    /// Whether a damaged message is always known as such.
    has_checksum: bool,
    /// Whether pieces of a message may come apart; datagrams may not.
    is_stream: bool,
    /// Messages after a damaged place that may be lost with it.
    lost_after: usize,
}

impl Decoder {
    fn run(&self, pieces: &[&[u8]]) -> Vec<String> {
        let mut all: Vec<&[u8]> = vec![&self.preamble];
        all.extend(pieces);
        (self.decode)(&all)
    }

    fn truth(&self) -> Vec<String> {
        self.run(&[&self.message])
    }
}

pub(crate) fn xbus_items() -> Vec<u8> {
    let mut data = Vec::new();
    mtdata2::encode_bytes(mtdata2::id::PACKET_COUNTER, &[0x12, 0xFA], &mut data);
    mtdata2::encode_numbers(mtdata2::id::ACCELERATION, &[0.25, -0.5, 9.8125], &mut data);
    mtdata2::encode_numbers(mtdata2::id::RATE_OF_TURN | 2, &[0.25, -0.5, 1.0], &mut data);
    message::request(0xFF, message::MTDATA2, &data)
}

const CHAIN: Layout = Layout { mode: 6, settings: 0 };

fn xbus_configuration() -> Vec<u8> {
    let tracker = |device_id| Tracker { device_id, data_len: 52, layout: CHAIN };
    let configuration = Configuration {
        master_id: 0x0010_0021,
        period_ticks: 1152,
        skip_factor: 0,
        trackers: vec![tracker(1), tracker(2)],
    };
    message::request(0xFF, message::CONFIGURATION, &configuration.encode())
}

pub(crate) fn xbus_chain() -> Vec<u8> {
    let mut data = vec![0x12, 0xFA];
    for k in [1.0, 2.0] {
        let block = Block {
            acceleration: Some([0.25 * k, -0.5, 9.75]),
            rate_of_turn: Some([0.25, -0.5, 1.0]),
            magnetic_field: Some([0.5, 0.0, -0.5]),
            orientation: Some(Orientation::Quaternion([0.5, 0.5, -0.5, 0.5])),
            ..Block::default()
        };
        CHAIN.encode(&block, &mut data);
    }
    message::request(0xFF, message::MTDATA, &data)
}

pub(crate) fn x_imu3_binary() -> Vec<u8> {
    let mut bytes = Vec::new();
    x_imu3::wire::binary(
        0,
        b'I',
        &x_imu3::data::encode(0x0A_DB0A, &[10.0, -20.0, 30.0, 0.25, -0.5, 1.0]),
        &mut bytes,
    );
    bytes
}

pub(crate) fn fastrak_binary() -> Vec<u8> {
    fastrak_message(FASTRAK)
}

pub(crate) fn motionstar() -> Vec<u8> {
    let mut body = Vec::new();
    let pose =
        birdnet::Pose { position_m: Some([0.5, -0.25, 1.0]), orientation_wxyz: Some([0.5, 0.5, -0.5, 0.5]) };
    let sense = flock::QuaternionSense::Vendor;
    birdnet::encode_record(2, flock::Format::PositionQuaternion, pose, 3.6576, sense, None, &mut body);
    let mut bytes = Vec::new();
    birdnet::Header { sequence: 7, kind: birdnet::kind::DATA_PACKET, ..Default::default() }
        .encode(&body, &mut bytes);
    bytes
}

const FASTRAK: fastrak::Shape = fastrak::Shape { text: false, button: false };
const FASTRAK_TEXT: fastrak::Shape = fastrak::Shape { text: true, button: true };

fn fastrak_message(shape: fastrak::Shape) -> Vec<u8> {
    let mut bytes = Vec::new();
    fastrak::Record {
        station: 1,
        status: b' ',
        position_m: [0.5, -0.25, 1.0],
        orientation_wxyz: [0.5, 0.5, -0.5, 0.5],
        button: Some(true),
    }
    .encode(shape, &mut bytes);
    bytes
}

const POLHEMUS: polhemus::Shape = polhemus::Shape { text: false, button: false };
const POLHEMUS_TEXT: polhemus::Shape = polhemus::Shape { text: true, button: true };

fn polhemus_message(shape: polhemus::Shape) -> Vec<u8> {
    let mut bytes = Vec::new();
    polhemus::Record {
        model: Some(polhemus::Model::Liberty),
        station: 1,
        status: b' ',
        time_ms: 4000,
        frame: 960,
        position_m: [0.5, -0.25, 1.0],
        orientation_wxyz: [0.5, 0.5, -0.5, 0.5],
        button: Some(true),
    }
    .encode(shape, &mut bytes);
    bytes
}

pub(crate) fn polhemus_binary() -> Vec<u8> {
    polhemus_message(POLHEMUS)
}

fn decode_polhemus(shape: polhemus::Shape, pieces: &[&[u8]]) -> Vec<String> {
    let mut splitter = polhemus::Splitter::new(shape);
    let mut out = Vec::new();
    for piece in pieces {
        splitter.push(piece);
        while let Some(piece) = splitter.find() {
            if let polhemus::Piece::Record { record, .. } = piece {
                out.push(format!("{record:?}"));
            }
        }
    }
    out
}

pub(crate) fn witmotion() -> Vec<u8> {
    let mut bytes = Vec::new();
    witmotion::Group {
        specific_force_m_s2: [0.25, -0.5, 9.75],
        angular_velocity_rad_s: [0.25, -0.5, 1.0],
        angles_rad: [0.0, 0.0, 1.0],
        quaternion: [0.877_58, 0.0, 0.0, 0.479_43],
    }
    .encode(&mut bytes);
    bytes
}

fn decode_witmotion(pieces: &[&[u8]]) -> Vec<String> {
    let mut splitter = witmotion::Splitter::new();
    let mut out = Vec::new();
    for piece in pieces {
        splitter.push(piece);
        while let Some(piece) = splitter.find() {
            if let witmotion::Piece::Group { group, .. } = piece {
                out.push(format!("{group:?}"));
            }
        }
    }
    out
}

pub(crate) fn vrpn() -> Vec<u8> {
    let mut bytes = Vec::new();
    let from = vrpn_wire::From { sender: 1, kind: 4, utc_ns: 1_700_000_000_250_000_000 };
    vrpn_wire::pose(from, 0, [0.5, -0.25, 1.0], [0.5, 0.5, -0.5, 0.5], &mut bytes);
    bytes
}

/// What a server begins with whose tracker 1 is `Head`.
pub(crate) fn vrpn_greeting() -> Vec<u8> {
    let mut bytes = vrpn_wire::GREETING.to_vec();
    vrpn_wire::description(vrpn_wire::system::SENDER, 1, "Head", 0, &mut bytes);
    vrpn_wire::description(vrpn_wire::system::TYPE, 4, vrpn_wire::types::POSE, 0, &mut bytes);
    bytes
}

fn decode_vrpn(pieces: &[&[u8]]) -> Vec<String> {
    let mut reader = Reader::default();
    let mut out = Vec::new();
    for piece in pieces {
        reader.push(piece);
        while let Some(piece) = reader.find() {
            if let Piece::Pose(message) = piece
                && let Ok(pose) = vrpn_wire::Pose::parse(message.payload)
            {
                out.push(format!("{} {} {pose:?}", message.sender, message.utc_us));
            }
        }
    }
    out
}

fn decode_xbus(pieces: &[&[u8]]) -> Vec<String> {
    let mut decoder = capture::Decoder::new();
    let mut out = Vec::new();
    for piece in pieces {
        decoder.push(piece, |record| {
            if matches!(record.mid, message::MTDATA | message::MTDATA2) {
                out.push(format!("{:?}", record));
            }
        });
    }
    out
}

fn decode_x_imu3(pieces: &[&[u8]]) -> Vec<String> {
    let mut lines = x_imu3::wire::Lines::default();
    let (mut out, mut scratch) = (Vec::new(), Vec::new());
    for piece in pieces {
        lines.push(piece);
        while let Some(line) = lines.find() {
            let Some(message) = x_imu3::wire::parse(lines.line(line), &mut scratch) else { continue };
            let Some(stamped) = x_imu3::data::decode(&message.body) else { continue };
            if let Ok(Some(measurement)) = stamped.data.measurement() {
                out.push(format!("{} {} {measurement:?}", message.address, stamped.time_us));
            }
        }
    }
    out
}

fn decode_fastrak(shape: fastrak::Shape, pieces: &[&[u8]]) -> Vec<String> {
    let mut splitter = fastrak::Splitter::new(shape);
    let mut out = Vec::new();
    for piece in pieces {
        splitter.push(piece);
        while let Some(piece) = splitter.find() {
            if let fastrak::Piece::Record { record, .. } = piece {
                out.push(format!("{record:?}"));
            }
        }
    }
    out
}

fn decode_motionstar(pieces: &[&[u8]]) -> Vec<String> {
    let mut packets = birdnet::Packets::default();
    let mut out = Vec::new();
    for piece in pieces {
        packets.push(piece);
        while let Some(found) = packets.find() {
            for record in birdnet::records(packets.body(found)).into_iter().flatten() {
                if let Ok(Some(pose)) = record.pose(3.6576, flock::QuaternionSense::Vendor) {
                    out.push(format!("{} {pose:?}", record.address));
                }
            }
        }
    }
    out
}

fn decode_slimevr(pieces: &[&[u8]]) -> Vec<String> {
    let mut out = Vec::new();
    for datagram in pieces.iter().flat_map(|piece| datagrams(piece)).flatten() {
        if let Some(packet) = slime::parse(datagram.data) {
            packet.items(|item| {
                if let Ok(item @ (slime::Item::Motion { .. } | slime::Item::Rotation { .. })) = item {
                    out.push(format!("{item:?}"));
                }
            });
        }
    }
    out
}

/// A sample of the open format, as a line.
pub(crate) fn open_imu_line() -> Vec<u8> {
    csv::line("I,esp-7f3a,0,41,1234567,0.1000,-0.0500,0.0000,0.0000,0.0000,9.8067")
}

fn open_imu_osc() -> Vec<u8> {
    let mut arguments = vec![osc::Value::Int(41), osc::Value::Long(1_234_567)];
    arguments.extend([0.1, -0.05, 0.0, 0.0, 0.0, 9.8067].map(osc::Value::Float));
    osc::Writer::bundle(&[osc::Writer::message("esp-7f3a", "0", &arguments)])
}

fn decode_open_imu_lines(pieces: &[&[u8]]) -> Vec<String> {
    let mut lines = x_imu3::wire::Lines::default();
    let mut out = Vec::new();
    for piece in pieces {
        lines.push(piece);
        while let Some(line) = lines.find() {
            if let Some((_, Some((id, open_imu::Message::Motion { motion: Ok(motion), .. })))) =
                csv::find(lines.line(line), false)
            {
                out.push(format!("{id} {motion:?}"));
            }
        }
    }
    out
}

/// A report of a receiver, in its envelope.
pub(crate) fn slimevr_report() -> Vec<u8> {
    let registration = hid::registration(0, [0xC0, 0xFF, 0xEE, 0x12, 0x34, 0x56]);
    let motion = hid::full(0, [0.5, 0.5, -0.5, 0.5], [1.0, -2.5, 0.5]);
    Datagram { peer: hid::RECEIVER, data: &[registration, motion].concat() }.encode()
}

fn decode_slimevr_report(pieces: &[&[u8]]) -> Vec<String> {
    let mut out = Vec::new();
    for datagram in pieces.iter().flat_map(|piece| datagrams(piece)).flatten() {
        for packet in hid::packets(datagram.data).into_iter().flatten().flatten() {
            if let hid::Contents::Motion { .. } = packet.contents {
                out.push(format!("{packet:?}"));
            }
        }
    }
    out
}

fn decode_open_imu_datagrams(pieces: &[&[u8]]) -> Vec<String> {
    let mut out = Vec::new();
    for datagram in pieces.iter().flat_map(|piece| datagrams(piece)).flatten() {
        if open_imu::Kind::of(datagram.data) == open_imu::Kind::Osc {
            osc::messages(datagram.data, &mut |message| {
                if let Ok((id, open_imu::Message::Motion { motion: Ok(motion), .. })) = message {
                    out.push(format!("{id} {motion:?}"));
                }
            });
        } else {
            let _ = json::items(datagram.data, &mut |item| {
                if let json::Item::Message(open_imu::Message::Motion { motion: Ok(motion), .. }) = item {
                    out.push(format!("{motion:?}"));
                }
            });
        }
    }
    out
}

const FLOCK: flock::Shape =
    flock::Shape { format: flock::Format::PositionQuaternion, button: false, group: true };

fn decode_flock(pieces: &[&[u8]]) -> Vec<String> {
    let scale = flock::Scale::default();
    let mut splitter = parser::Splitter::new(&[(1, FLOCK)], scale, flock::Tolerance::LIVE, 0);
    let mut out = Vec::new();
    let mut emit = |event| {
        if let parser::Event::Sample(sample) = event {
            out.push(format!("{} {:?}", sample.address, sample.measurement));
        }
    };
    for (k, piece) in (0..).zip(pieces) {
        splitter.handle_bytes(Timestamp::from_nanos(k * 10_000), piece, &mut emit);
    }
    while let Some(at) = splitter.poll_timeout() {
        splitter.handle_timeout(at, &mut emit);
    }
    out
}

fn decoders() -> Vec<Decoder> {
    let stream = |name, message, decode| Decoder {
        name,
        message,
        records: 1,
        preamble: vec![],
        decode,
        has_checksum: false,
        is_stream: true,
        lost_after: 1,
    };
    let mut flock_message = Vec::new();
    let q = [0.5, 0.5, -0.5, 0.5];
    flock::record::encode([0.25, -0.125, 0.5], q, (0, 1), FLOCK, flock::Scale::default(), &mut flock_message);
    let text = x_imu3::data::encode_text(b'I', 1_000_000, &[10.0, -20.0, 30.0, 0.25, -0.5, 1.0]);
    let motion = slime::encode(7, 23, &slime::motion_body(0, q, [1.0, -2.5, 0.5]));
    let peer = SocketAddr::from(([192, 0, 2, 1], 6969));
    let text_message = br#"{"n":41,"t":1234567,"g":[0.1,-0.05,0],"a":[0,0,9.80665]}"#;
    vec![
        Decoder { has_checksum: true, lost_after: 0, ..stream("xbus mtdata2", xbus_items(), decode_xbus) },
        Decoder {
            has_checksum: true,
            lost_after: 0,
            records: 2,
            preamble: xbus_configuration(),
            ..stream("xbus chain", xbus_chain(), decode_xbus)
        },
        stream("x-imu3 binary", x_imu3_binary(), decode_x_imu3),
        stream("x-imu3 text", text, decode_x_imu3),
        stream("fastrak binary", fastrak_binary(), |pieces| decode_fastrak(FASTRAK, pieces)),
        stream("fastrak text", fastrak_message(FASTRAK_TEXT), |pieces| decode_fastrak(FASTRAK_TEXT, pieces)),
        stream("motionstar", motionstar(), decode_motionstar),
        stream("flock", flock_message, decode_flock),
        stream("polhemus binary", polhemus_binary(), |pieces| decode_polhemus(POLHEMUS, pieces)),
        stream("polhemus text", polhemus_message(POLHEMUS_TEXT), |pieces| {
            decode_polhemus(POLHEMUS_TEXT, pieces)
        }),
        Decoder { has_checksum: true, lost_after: 0, ..stream("witmotion", witmotion(), decode_witmotion) },
        Decoder { preamble: vrpn_greeting(), ..stream("vrpn", vrpn(), decode_vrpn) },
        Decoder { is_stream: false, ..stream("slimevr receiver", slimevr_report(), decode_slimevr_report) },
        Decoder {
            is_stream: false,
            ..stream("slimevr", Datagram { peer, data: &motion }.encode(), decode_slimevr)
        },
        Decoder {
            has_checksum: true,
            lost_after: 0,
            ..stream("open-imu lines", open_imu_line(), decode_open_imu_lines)
        },
        Decoder {
            is_stream: false,
            ..stream(
                "open-imu osc",
                Datagram { peer, data: &open_imu_osc() }.encode(),
                decode_open_imu_datagrams,
            )
        },
        Decoder {
            is_stream: false,
            ..stream(
                "open-imu json",
                Datagram { peer, data: text_message }.encode(),
                decode_open_imu_datagrams,
            )
        },
    ]
}

#[test]
fn nothing_comes_of_nothing() {
    for decoder in decoders() {
        assert_eq!(decoder.run(&[]), [""; 0], "{}", decoder.name);
        assert_eq!(decoder.run(&[&[], &[]]), [""; 0], "{}", decoder.name);
    }
}

#[test]
fn at_once_two_at_once_and_byte_by_byte() {
    for decoder in decoders() {
        let one = decoder.truth();
        assert_eq!(one.len(), decoder.records, "{}", decoder.name);
        let two = decoder.message.repeat(2);
        assert_eq!(decoder.run(&[&two]).len(), 2 * decoder.records, "{}", decoder.name);
        if decoder.is_stream {
            let bytes: Vec<&[u8]> = decoder.message.chunks(1).collect();
            assert_eq!(decoder.run(&bytes), one, "{}", decoder.name);
        }
    }
}

#[test]
fn split_anywhere() {
    for decoder in decoders().into_iter().filter(|decoder| decoder.is_stream) {
        let two = decoder.message.repeat(2);
        let whole = decoder.run(&[&two]);
        for at in 0..=two.len() {
            let (front, back) = two.split_at(at);
            assert_eq!(decoder.run(&[front, back]), whole, "{} at {at}", decoder.name);
        }
    }
}

#[test]
fn truncated_messages_give_nothing_and_cost_little() {
    for decoder in decoders() {
        let truth = &decoder.truth()[0];
        for len in 1..decoder.message.len() {
            let cut = &decoder.message[..len];
            assert_eq!(decoder.run(&[cut]), [""; 0], "{} of {len}", decoder.name);
            let many = decoder.message.repeat(12);
            let after = decoder.run(&[cut, &many]);
            assert!(after.len() >= (12 - decoder.lost_after) * decoder.records, "{} of {len}", decoder.name);
            if decoder.has_checksum {
                assert!(after.contains(truth), "{} of {len}", decoder.name);
            }
        }
    }
}

#[test]
fn damaged_messages_give_nothing_false() {
    for decoder in decoders() {
        let truth = decoder.truth();
        let many = decoder.message.repeat(12);
        for bit in 0..8 * decoder.message.len() {
            let mut bytes = many.clone();
            bytes[decoder.message.len() + bit / 8] ^= 1 << (bit % 8);
            let found = decoder.run(&[&bytes]);
            assert!(found.len() <= 12 * decoder.records, "{}: bit {bit} has made records", decoder.name);
            if !decoder.is_stream {
                continue; // One piece holds all datagrams here; a damaged length ends it.
            }
            let least = if decoder.has_checksum { 11 } else { 11 - decoder.lost_after };
            assert!(
                found.len() >= least * decoder.records,
                "{}: bit {bit} left {}",
                decoder.name,
                found.len()
            );
            let t_s = |text: &str| text.split("t_s").next().unwrap().to_owned();
            let false_ones =
                found.iter().filter(|record| !truth.iter().any(|true_one| t_s(true_one) == t_s(record)));
            // Without a checksum the damaged record itself may look right; no other may change.
            let allowed = if decoder.has_checksum { 0 } else { decoder.records };
            assert!(false_ones.count() <= allowed, "{}: bit {bit} is false", decoder.name);
        }
    }
}

#[test]
fn garbage_gives_nothing_and_ends() {
    for decoder in decoders() {
        let truth = decoder.truth();
        for seed in 0..50 {
            let garbage = Noise::new(seed).bytes(300);
            let alone = decoder.run(&[&garbage]);
            assert_eq!(alone, [""; 0], "{} of seed {seed}", decoder.name);
            if !decoder.is_stream {
                continue;
            }
            let many = decoder.message.repeat(12);
            let found = decoder.run(&[&many, &garbage, &many]);
            assert!(
                found.len() >= (24 - decoder.lost_after) * decoder.records,
                "{} of seed {seed}",
                decoder.name
            );
            let t_s = |text: &str| text.split("t_s").next().unwrap().to_owned();
            assert!(
                found.iter().all(|record| truth.iter().any(|true_one| t_s(true_one) == t_s(record))),
                "{} of seed {seed}",
                decoder.name
            );
        }
    }
}
