//! WitMotion sensors.

use super::head::Head;
use super::script::{cut_both_ways, is_message, messages, pieces, probe, session};
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
    messages(Splitter::new(), pieces, |piece| {
        if let Piece::Group { group, .. } = piece {
            let mut again = Vec::new();
            group.encode(&mut again);
            assert!(is_message(Splitter::new(), &again), "a group is none when written again");
        }
    })
}
