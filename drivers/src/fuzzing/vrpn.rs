//! VRPN.

use super::head::Head;
use super::script::{cut_both_ways, pieces, probe, session};
use crate::sample::Timestamp;
use crate::vrpn::probe::inquiry;
use crate::vrpn::reader::{Piece, Reader};
use crate::vrpn::wire::{self, From, Pose, REACH_M};
use crate::vrpn::{Settings, VrpnSession};

/// Messages, poses, the probe and a session.
///
/// # Panics
/// Where a pose is none when written again; and as all others of this module.
pub fn vrpn(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    let lead = if head.flag(false) { vec![greeting()] } else { vec![] };
    // One, none, twice the same, an empty name, one that is too long, and more than there can be.
    let trackers = match head.byte() {
        0 => vec!["Head".to_owned()],
        1 => vec![],
        2 => vec!["Head".to_owned(); 2],
        3 => vec![String::new()],
        4 => vec!["x".repeat(wire::MAX_NAME + 1)],
        count => (0..count).map(|k| if k == 0 { "Head".to_owned() } else { format!("Wand {k}") }).collect(),
    };
    let modem_lines = head.flag(false);
    let wanted = head.addresses(&[1]);
    let decode = |lead: &[u8], pieces: &[&[u8]]| {
        let mut reader = Reader::default();
        let mut out = Vec::new();
        for piece in [lead].iter().chain(pieces) {
            reader.push(piece);
            while let Some(piece) = reader.find() {
                match piece {
                    Piece::Pose(message) => out.push((message.offset, poses(message.payload))),
                    Piece::Other(message) => out.push((message.offset, message.description().is_ok())),
                    Piece::Greeting(_) => {}
                }
            }
        }
        (out, reader.rejected(), reader.bytes_skipped())
    };
    cut_both_ways(&pieces(script), |pieces| decode(&[], pieces));
    cut_both_ways(&pieces(script), |pieces| decode(&greeting(), pieces));
    probe(inquiry(Timestamp::ZERO), script);
    let Ok(mut live) = VrpnSession::new(Settings { trackers }, &wanted) else { return 0 };
    session(&mut live, modem_lines, &lead, script, REACH_M)
}

/// Whether it is a pose, which it must still be when it is written again.
fn poses(payload: &[u8]) -> bool {
    let Ok(Pose { sensor, position_m, orientation_wxyz }) = Pose::parse(payload) else { return false };
    let mut again = Vec::new();
    wire::pose(From { sender: 0, kind: 0, utc_ns: 0 }, sensor, position_m, orientation_wxyz, &mut again);
    assert!(Pose::parse(&again[wire::HEADER..]).is_ok(), "a pose is none when written again");
    true
}

/// What a server begins with whose tracker 1 is `Head`.
fn greeting() -> Vec<u8> {
    let mut bytes = wire::GREETING.to_vec();
    wire::description(wire::system::SENDER, 1, "Head", 0, &mut bytes);
    wire::description(wire::system::TYPE, 4, wire::types::POSE, 0, &mut bytes);
    bytes
}
