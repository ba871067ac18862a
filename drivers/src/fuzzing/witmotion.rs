//! WitMotion sensors.

use super::head::Head;
use super::script::{cut_both_ways, pieces, probe, session};
use crate::sample::Timestamp;
use crate::witmotion::wire::{self, Piece, Splitter, kind};
use crate::witmotion::{Settings, WitMotionSession, probe::inquiry};

/// Groups, the probe and a session.
///
/// # Panics
/// Where a group is none when it is written again; and as all others of this module.
pub fn witmotion(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    let default = Settings::default();
    let settings = Settings { rate_hz: head.number(10.0, 200.0).unwrap_or(default.rate_hz) };
    let answers = head.flag(false);
    let modem_lines = head.flag(false);
    let line_baud = head.pick([115_200, 0, 9_600]);
    let wanted = head.addresses(&[0]);
    cut_both_ways(&pieces(script), groups);
    probe(inquiry(Timestamp::ZERO), script);
    let Ok(mut live) = WitMotionSession::new(settings, line_baud, &wanted) else { return 0 };
    let mut registers = Vec::new();
    wire::frame(kind::REGISTERS, [wire::OUTPUT as i16, 9, 6, 0], &mut registers);
    // Four pauses of the set-up.
    let lead = if answers { vec![vec![], vec![], vec![], vec![], registers] } else { vec![] };
    session(&mut live, modem_lines, &lead, script, f64::MAX)
}

fn groups(pieces: &[&[u8]]) -> (Vec<Piece>, u64, u64) {
    let mut splitter = Splitter::new();
    let mut out = Vec::new();
    for piece in pieces {
        splitter.push(piece);
        while let Some(piece) = splitter.find() {
            if let Piece::Group { group, .. } = piece {
                let mut again = Vec::new();
                group.encode(&mut again);
                let mut splitter = Splitter::new();
                splitter.push(&again);
                assert!(splitter.find().is_some(), "a group is none when written again");
            }
            out.push(piece);
        }
    }
    (out, splitter.rejected(), splitter.bytes_skipped())
}
