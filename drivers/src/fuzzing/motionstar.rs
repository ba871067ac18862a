//! MotionStar.

use super::flock::{FORMATS, HEMISPHERES};
use super::head::Head;
use super::script::{cut_both_ways, pieces, probe, session};
use crate::flock::wire::QuaternionSense;
use crate::motionstar::probe::inquiry;
use crate::motionstar::wire::{self, Packets, kind};
use crate::motionstar::{MotionStarSession, Settings};
use crate::sample::Timestamp;

/// Farthest that it can measure along an axis, m.
const REACH_M: f64 = 104.1;

/// Packets, records, the probe and a session.
///
/// # Panics
/// Where a packet changes when written; and as all others of this module.
pub fn motionstar(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    let settings = Settings {
        format: head.pick(FORMATS),
        measurement_rate_hz: head.number(20.0, 144.0),
        report_every_cycles: head.optional_byte().unwrap_or(1),
        hemisphere: head.pick(HEMISPHERES),
        quaternion_sense: head.pick([QuaternionSense::Vendor, QuaternionSense::Direct]),
        button: head.flag(false),
    };
    let lead = if head.flag(false) { answers() } else { vec![] };
    let modem_lines = head.flag(false);
    let wanted = head.addresses(&[2]);
    let bytes = pieces(script);
    let all = bytes.concat();
    cut_both_ways(&bytes, |pieces| {
        let mut packets = Packets::default();
        let mut out = Vec::new();
        for piece in pieces {
            packets.push(piece);
            while let Some(found) = packets.find() {
                let body = packets.body(found);
                let mut again = Vec::new();
                found.header.encode(body, &mut again);
                assert_eq!(again, all[found.offset as usize..][..again.len()], "a packet changed");
                let poses = wire::records(body).map(|records| {
                    records.map(|record| record.pose(0.9144, settings.quaternion_sense)).collect::<Vec<_>>()
                });
                out.push((found.offset, poses));
            }
        }
        (out, packets.bytes_skipped())
    });
    probe(inquiry(Timestamp::ZERO), script);
    let Ok(mut live) = MotionStarSession::new(settings, &wanted) else { return 0 };
    session(&mut live, modem_lines, &lead, script, REACH_M)
}

/// What a system with one bird at address 2 answers to its set-up.
fn answers() -> Vec<Vec<u8>> {
    let reply = |kind: u8, unit: u8, body: &[u8]| {
        let mut packet = Vec::new();
        wire::Header { kind, unit, ..Default::default() }.encode(body, &mut packet);
        packet
    };
    let mut bird = [0; wire::BIRD_STATUS];
    (bird[0], bird[9], bird[11]) = (0x44, 144, 2);
    let system = b"\x84\x00\x02\x01\x10100000\x01\x02\x01\x01\x02\xD1\xE0";
    vec![
        reply(kind::RSP_STOP_DATA, 0, &[]),
        reply(kind::RSP_WAKE_UP, 0, &[]),
        reply(kind::RSP_GET_STATUS, 0, system),
        reply(kind::RSP_GET_STATUS, 2, &bird),
        reply(kind::RSP_SEND_SETUP, 2, &[]),
        reply(kind::RSP_RUN_CONTINUOUS, 0, &[]),
    ]
}
