//! Fastrak.

use super::head::Head;
use super::script::{cut_both_ways, messages, pieces, probe, session};
use crate::fastrak::wire::{Piece, Record, Shape, Splitter};
use crate::fastrak::{FastrakSession, Settings, probe::inquiry};
use crate::sample::Timestamp;

/// Farthest that it can measure along an axis, m.
const REACH_M: f64 = 10.0;

/// Records, the probe and a session.
///
/// # Panics
/// Where a record is none when it is written again; and as all others of this module.
pub fn fastrak(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    let default = Settings::default();
    let settings = Settings {
        text: head.flag(default.text),
        button: head.flag(default.button),
        hemisphere: default.hemisphere.map(|value| head.number(-1.0, 1.0).unwrap_or(value)),
    };
    let answers = head.flag(false);
    let modem_lines = head.flag(false);
    let wanted = head.addresses(&[1, 3]);
    let shape = Shape { text: settings.text, button: settings.button };
    cut_both_ways(&pieces(script), |pieces| records(pieces, shape));
    probe(inquiry(Timestamp::ZERO), script);
    let Ok(mut live) = FastrakSession::new(settings, &wanted) else { return 0 };
    let status = format!("21S{:<50}\r\n", "000000").into_bytes();
    let lead = if answers { vec![vec![], status] } else { vec![] };
    session(&mut live, modem_lines, &lead, script, REACH_M)
}

fn records(pieces: &[&[u8]], shape: Shape) -> (Vec<Piece>, u64, u64) {
    messages(Splitter::new(shape), pieces, |piece| {
        if let Piece::Record { record, .. } = piece {
            let mut again = Vec::new();
            record.encode(shape, &mut again);
            let parse = if shape.text { Record::parse_text } else { Record::parse_binary };
            assert!(parse(&again, shape).is_some(), "a record is none when written again");
        }
    })
}
