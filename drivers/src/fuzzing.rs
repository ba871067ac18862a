//! What the fuzz targets run; an ordinary test runs the same over the committed corpus and seeded bytes.
//!
//! Each takes any bytes, must not panic, and checks what holds for every input: what comes out does not depend
//! on how the bytes were cut, messages survive being written again, and samples are numbers.

use std::fmt::Debug;
use std::time::Duration;

use crate::datagram::datagrams;
use crate::fastrak::wire::{Piece, Shape as FastrakShape, Splitter};
use crate::fastrak::{self, FastrakSession};
use crate::flock::wire::QuaternionSense;
use crate::motionstar::wire::{self as birdnet, Packets};
use crate::motionstar::{self, MotionStarSession};
use crate::sample::{Measurement, Timestamp};
use crate::session::{LineEvent, Output, Session};
use crate::slimevr::{self, SlimeVrSession};
use crate::x_imu3::wire::Lines;
use crate::x_imu3::{self, XImu3Session};
use crate::xbus::frame::Framer;
use crate::xbus::message::{self, Configuration, Tracker};
use crate::xbus::mtdata::Layout;
use crate::xbus::{self, XbusSession, capture};

/// Decodes `bytes` in one piece and in pieces of `step` bytes, and holds the results against each other.
fn cut_both_ways<T: PartialEq + Debug>(
    bytes: &[u8],
    step: usize,
    decode: impl Fn(&mut dyn Iterator<Item = &[u8]>) -> T,
) {
    let whole = decode(&mut std::iter::once(bytes));
    let pieces = decode(&mut bytes.chunks(step));
    assert_eq!(whole, pieces, "pieces of {step} bytes make a difference");
}

/// Xbus messages and captures. The first byte of `data` is the size of the pieces less one, the others are the stream.
///
/// # Panics
/// Where what comes out depends on the pieces, a byte is unaccounted for, or a message changes when written.
pub fn xbus_wire(data: &[u8]) {
    let Some((&step, bytes)) = data.split_first() else { return };
    cut_both_ways(bytes, usize::from(step) + 1, |pieces| {
        let mut framer = Framer::default();
        let (mut out, mut inside) = (Vec::new(), 0);
        for piece in pieces {
            framer.push(piece);
            while let Some(found) = framer.find() {
                let frame = framer.frame(found);
                let again = frame.encode();
                assert_eq!(again.len(), found.len, "a message changed its length");
                inside += found.len;
                out.push((found.offset, again));
            }
        }
        framer.interrupt();
        assert_eq!(inside as u64 + framer.bytes_skipped(), bytes.len() as u64, "a byte is unaccounted for");
        (out, framer.bad_checksums())
    });
    cut_both_ways(bytes, usize::from(step) + 1, |pieces| {
        let mut decoder = capture::Decoder::new();
        // By its text: NaN, which an item may hold, is not equal to itself.
        let mut records = Vec::new();
        for piece in pieces {
            decoder.push(piece, |record| records.push(format!("{record:?}")));
        }
        (records, decoder.finish())
    });
}

/// x-IMU3 lines and data; `data` as for [`xbus_wire`].
///
/// # Panics
/// Where what comes out depends on the pieces.
pub fn x_imu3_wire(data: &[u8]) {
    let Some((&step, bytes)) = data.split_first() else { return };
    cut_both_ways(bytes, usize::from(step) + 1, |pieces| {
        let mut lines = Lines::default();
        let mut scratch = Vec::new();
        let mut out = Vec::new();
        for piece in pieces {
            lines.push(piece);
            while let Some(found) = lines.find() {
                let line = lines.line(found);
                let emitted = x_imu3::wire::parse(line, &mut scratch).map(|message| {
                    let stamped = x_imu3::data::decode(&message.body);
                    let measured = stamped.map(|stamped| stamped.data.measurement());
                    format!("{message:?} {stamped:?} {measured:?}")
                });
                out.push((found.offset, emitted));
            }
        }
        (out, lines.bytes_skipped())
    });
}

/// Fastrak records. The first byte of `data` chooses: bit 7 text, bit 6 button, bits 5 to 0 the size of the pieces less one.
///
/// # Panics
/// Where what comes out depends on the pieces, or no longer reads the same when it was written.
pub fn fastrak_wire(data: &[u8]) {
    let Some((&choice, bytes)) = data.split_first() else { return };
    let shape = FastrakShape { text: choice & 0x80 != 0, button: choice & 0x40 != 0 };
    cut_both_ways(bytes, usize::from(choice & 0x3F) + 1, |pieces| {
        let mut splitter = Splitter::new(shape);
        let mut out = Vec::new();
        for piece in pieces {
            splitter.push(piece);
            while let Some(piece) = splitter.find() {
                if let Piece::Record { record, .. } = piece {
                    let mut again = Vec::new();
                    record.encode(shape, &mut again);
                    let parse = if shape.text {
                        fastrak::wire::Record::parse_text
                    } else {
                        fastrak::wire::Record::parse_binary
                    };
                    assert!(parse(&again, shape).is_some(), "a record is none when written again");
                }
                out.push(piece);
            }
        }
        (out, splitter.rejected(), splitter.bytes_skipped())
    });
}

/// MotionStar packets and records; `data` as for [`xbus_wire`].
///
/// # Panics
/// Where what comes out depends on the pieces, or a packet changes when written.
pub fn motionstar_wire(data: &[u8]) {
    let Some((&step, bytes)) = data.split_first() else { return };
    cut_both_ways(bytes, usize::from(step) + 1, |pieces| {
        let mut packets = Packets::default();
        let mut out = Vec::new();
        for piece in pieces {
            packets.push(piece);
            while let Some(found) = packets.find() {
                let body = packets.body(found);
                let mut again = Vec::new();
                found.header.encode(body, &mut again);
                assert_eq!(again, bytes[found.offset as usize..][..again.len()], "a packet changed");
                let poses = birdnet::records(body).map(|records| {
                    records.map(|record| record.pose(0.9144, QuaternionSense::Vendor)).collect::<Vec<_>>()
                });
                out.push((found.offset, poses));
            }
        }
        (out, packets.bytes_skipped())
    });
}

/// SlimeVR datagrams, in their envelopes.
///
/// # Panics
/// Where an envelope changes when written.
pub fn slimevr_wire(data: &[u8]) {
    for datagram in datagrams(data).flatten() {
        assert_eq!(datagrams(&datagram.encode()).next(), Some(Ok(datagram)), "an envelope changed");
        if let Some(packet) = slimevr::wire::parse(datagram.data) {
            packet.items(drop);
        }
    }
}

/// An Xbus session that hears anything, at any time; returns how many samples it published. The first byte of `data` chooses
/// trackers and answers to the set-up, the others are the script of [`session`].
///
/// # Panics
/// See [`session`].
pub fn xbus_session(data: &[u8]) -> usize {
    let Some((&choice, script)) = data.split_first() else { return 0 };
    let wanted: &[u16] = if choice & 1 != 0 { &[1, 2] } else { &[1] };
    let Ok(mut session_) = XbusSession::new(xbus::Settings::default(), 460_800, wanted) else { return 0 };
    let reply = |mid: u8, data: &[u8]| message::request(message::MASTER, mid + 1, data);
    let layout = Layout { mode: 6, settings: 0 };
    let tracker = |device_id| Tracker { device_id, data_len: 52, layout };
    let chain = Configuration {
        master_id: 0x0010_0021,
        period_ticks: 1152,
        skip_factor: 0,
        trackers: vec![tracker(0x0032_03E9), tracker(0x0032_03EA)],
    };
    let outputs: Vec<u8> =
        [0x1020, 0xFFFF, 0x4020, 100, 0x8020, 100_u16].into_iter().flat_map(u16::to_be_bytes).collect();
    let lead = match choice & 6 {
        0 => vec![],
        2 => vec![
            reply(message::GOTO_CONFIG, &[]),
            reply(message::REQ_DEVICE_ID, &[0, 0x10, 0, 0x21]),
            reply(message::INIT_BUS, &[0, 0x32, 3, 0xE9, 0, 0x32, 3, 0xEA]),
            reply(message::REQ_CONFIGURATION, &chain.encode()),
            reply(message::REQ_CONFIGURATION, &chain.encode()),
            reply(message::GOTO_MEASUREMENT, &[]),
        ],
        _ => vec![
            reply(message::GOTO_CONFIG, &[]),
            reply(message::REQ_DEVICE_ID, &[0, 0x70, 0, 1]),
            message::request(message::MASTER, message::ERROR, &[4]),
            reply(message::OUTPUT_CONFIGURATION, &outputs),
            reply(message::OUTPUT_CONFIGURATION, &outputs),
            reply(message::GOTO_MEASUREMENT, &[]),
        ],
    };
    session(&mut session_, &lead, script)
}

/// An x-IMU3 session, in the same manner.
///
/// # Panics
/// See [`session`].
pub fn x_imu3_session(data: &[u8]) -> usize {
    let Some((&choice, script)) = data.split_first() else { return 0 };
    let wanted: &[u16] = if choice & 1 != 0 { &[2, 3] } else { &[0] };
    let Ok(mut session_) = XImu3Session::new(x_imu3::Settings::default(), wanted) else { return 0 };
    let mut lead = Vec::new();
    if choice & 2 != 0 {
        for key in [
            "ping",
            "binary_mode_enabled",
            "ahrs_message_type",
            "ahrs_axes_convention",
            "inertial_message_rate_divisor",
            "magnetometer_message_rate_divisor",
            "ahrs_message_rate_divisor",
            "high_g_accelerometer_message_rate_divisor",
            "apply",
        ] {
            for &address in wanted {
                lead.push(x_imu3::wire::command(address, key, &serde_json::Value::Null));
            }
        }
    }
    session(&mut session_, &lead, script)
}

/// A Fastrak session, in the same manner.
///
/// # Panics
/// See [`session`].
pub fn fastrak_session(data: &[u8]) -> usize {
    let Some((&choice, script)) = data.split_first() else { return 0 };
    let settings = fastrak::Settings { text: choice & 1 != 0, button: choice & 2 != 0, ..Default::default() };
    let Ok(mut session_) = FastrakSession::new(settings, &[1, 3]) else { return 0 };
    let status = format!("21S{:<50}\r\n", "000000").into_bytes();
    // An empty chunk lets the time go on to the question.
    let lead = if choice & 4 != 0 { vec![vec![], status] } else { vec![] };
    session(&mut session_, &lead, script)
}

/// A MotionStar session, in the same manner.
///
/// # Panics
/// See [`session`].
pub fn motionstar_session(data: &[u8]) -> usize {
    let Some((&choice, script)) = data.split_first() else { return 0 };
    let Ok(mut session_) = MotionStarSession::new(motionstar::Settings::default(), &[2]) else { return 0 };
    let reply = |kind: u8, unit: u8, body: &[u8]| {
        let mut packet = Vec::new();
        birdnet::Header { kind, unit, ..Default::default() }.encode(body, &mut packet);
        packet
    };
    let mut bird = [0; birdnet::BIRD_STATUS];
    (bird[0], bird[9], bird[11]) = (0x44, 144, 2);
    let lead = if choice & 1 != 0 {
        vec![
            reply(birdnet::kind::RSP_STOP_DATA, 0, &[]),
            reply(birdnet::kind::RSP_WAKE_UP, 0, &[]),
            reply(
                birdnet::kind::RSP_GET_STATUS,
                0,
                b"\x84\x00\x02\x01\x10100000\x01\x02\x01\x01\x02\xD1\xE0",
            ),
            reply(birdnet::kind::RSP_GET_STATUS, 2, &bird),
            reply(birdnet::kind::RSP_SEND_SETUP, 2, &[]),
            reply(birdnet::kind::RSP_RUN_CONTINUOUS, 0, &[]),
        ]
    } else {
        vec![]
    };
    session(&mut session_, &lead, script)
}

/// A SlimeVR session, in the same manner.
///
/// # Panics
/// See [`session`].
pub fn slimevr_session(data: &[u8]) -> usize {
    let Ok(mut session_) = SlimeVrSession::new(slimevr::Settings::default(), &[1, 2, 257]) else { return 0 };
    session(&mut session_, &[], data)
}

/// Opens a line, answers with `lead`, then lets the script talk; returns how many samples came out.
///
/// A byte of the script up to 0x3F lets the next deadline pass; 0x3F + n, up to 0x5F, lets n half milliseconds pass; 0x60 closes
/// the line, 0x61 opens it, 0x62 drops bytes; 0x62 + n gives the n bytes behind it to the session.
///
/// # Panics
/// Where a sample is no measurement, or the session wants to be woken at one time for ever.
pub fn session(session: &mut impl Session, lead: &[Vec<u8>], script: &[u8]) -> usize {
    let mut now = Timestamp::ZERO;
    let mut samples = 0;
    session.handle_line(now, &LineEvent::Opened { modem_lines: false });
    for reply in lead {
        drain(session, &mut samples);
        if reply.is_empty() {
            wake(session, &mut now);
        } else {
            session.handle_bytes(now, reply);
        }
    }
    let mut rest = script;
    while let Some((&step, after)) = rest.split_first() {
        rest = after;
        match step {
            0..=0x3F => wake(session, &mut now),
            0x40..=0x5F => now = now + Duration::from_micros(u64::from(step - 0x3F) * 500),
            0x60 => session.handle_line(now, &LineEvent::Closed { reason: "unplugged".into() }),
            0x61 => session.handle_line(now, &LineEvent::Opened { modem_lines: true }),
            0x62 => session.handle_line(now, &LineEvent::Dropped { bytes: 17 }),
            _ => {
                let (bytes, later) = rest.split_at(usize::from(step - 0x62).min(rest.len()));
                session.handle_bytes(now, bytes);
                rest = later;
            }
        }
        drain(session, &mut samples);
    }
    samples
}

/// Lets the time go on to the next deadline.
fn wake(session: &mut impl Session, now: &mut Timestamp) {
    let Some(at) = session.poll_timeout() else { return };
    *now = (*now).max(at);
    for _ in 0..50 {
        if session.poll_timeout().is_none_or(|at| at > *now) {
            return;
        }
        session.handle_timeout(*now);
    }
    panic!("it wants to be woken for ever");
}

fn drain(session: &mut impl Session, samples: &mut usize) {
    let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
    let unit = |q: [f64; 4]| (q.iter().map(|value| value * value).sum::<f64>().sqrt() - 1.0).abs() < 1e-9;
    while let Some(output) = session.poll_output() {
        let Output::Sample(sample) = output else { continue };
        *samples += 1;
        let (triples, orientation) = match sample.measurement {
            Measurement::Pose { position_m, orientation_wxyz, .. } => {
                ([position_m, None, None, None], orientation_wxyz)
            }
            Measurement::Imu {
                angular_velocity_rad_s,
                specific_force_m_s2,
                linear_acceleration_m_s2,
                magnetic_field,
                orientation_wxyz,
            } => (
                [angular_velocity_rad_s, specific_force_m_s2, linear_acceleration_m_s2, magnetic_field],
                orientation_wxyz,
            ),
        };
        assert!(triples.iter().flatten().all(|values| finite(values)), "not a number: {sample:?}");
        assert!(orientation.is_none_or(unit), "no rotation: {sample:?}");
    }
}
