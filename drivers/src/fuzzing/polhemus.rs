//! Polhemus Liberty and Patriot.

use super::head::Head;
use super::script::{cut_both_ways, is_message, messages, pieces, probe, session};
use crate::polhemus::wire::{ACTIVE_STATIONS, Header, Model, Piece, Shape, Splitter};
use crate::polhemus::{PolhemusSession, Settings, probe::inquiry};
use crate::sample::Timestamp;

/// Farthest that it can measure along an axis, m.
const REACH_M: f64 = 10.0;

/// Records, the probe and a session.
///
/// # Panics
/// Where a record is none when it is written again; and as all others of this module.
pub fn polhemus(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    let default = Settings::default();
    let settings = Settings {
        text: head.flag(default.text),
        button: head.flag(default.button),
        hemisphere: default.hemisphere.map(|value| head.number(-1.0, 1.0).unwrap_or(value)),
    };
    let answers = head.flag(false);
    let modem_lines = head.flag(false);
    let line_baud = head.pick([115_200, 0, 9_600]);
    let wanted = head.addresses(&[1, 3]);
    let shape = Shape { text: settings.text, button: settings.button };
    cut_both_ways(&pieces(script), |pieces| records(pieces, shape));
    probe(inquiry(Timestamp::ZERO), script);
    let Ok(mut live) = PolhemusSession::new(settings, line_baud, &wanted) else { return 0 };
    let mut active = Vec::new();
    Header { model: Model::Liberty, station: 0, command: ACTIVE_STATIONS, error: b' ', size: 4 }
        .encode(&mut active);
    active.extend([0x05, 0, 0x05, 0]);
    let lead = if answers { vec![vec![], active] } else { vec![] };
    session(&mut live, modem_lines, &lead, script, REACH_M)
}

fn records(pieces: &[&[u8]], shape: Shape) -> (Vec<Piece>, u64, u64) {
    messages(Splitter::new(shape), pieces, |piece| {
        if let Piece::Record { record, .. } = piece {
            let mut again = Vec::new();
            record.encode(shape, &mut again);
            assert!(is_message(Splitter::new(shape), &again), "a record is none when written again");
        }
    })
}
