//! The open format.

use super::head::Head;
use super::script::{cut_both_ways, pieces, session};
use crate::datagram::datagrams;
use crate::open_imu::wire::{Kind, csv, json, osc};
use crate::open_imu::{Carrier, OpenImuSession, Settings, probe};
use crate::x_imu3::wire::Lines;

/// Lines, datagrams and text messages, the probe, and a session on a line or behind envelopes.
///
/// # Panics
/// Where what comes out of a line depends on how it was cut; and as all others of this module.
pub fn open_imu(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    // Nobody, some, one twice, more than there can be, and what is no identifier.
    let devices = match head.byte() {
        0 => vec!["esp-7f3a".to_owned(), "b".to_owned()],
        255 => vec!["a b".to_owned()],
        count => (1..count).map(|k| format!("d{}", k % 70)).collect(),
    };
    let carrier = head.pick([
        Carrier::Line,
        Carrier::Envelopes { port: 9301, websocket: 0 },
        Carrier::Envelopes { port: 0, websocket: 0 },
    ]);
    let settings = Settings { devices, rate_hz: head.number(1.0, 1000.0), unchecked_lines: head.flag(false) };
    let modem_lines = head.flag(false);
    let wanted = head.addresses(&[1, 2, 0x101]);
    let pieces = pieces(script);
    let unchecked = settings.unchecked_lines;
    cut_both_ways(&pieces, |pieces| {
        let mut lines = Lines::default();
        let mut found = Vec::new();
        for piece in pieces {
            lines.push(piece);
            while let Some(line) = lines.find() {
                found.push(
                    csv::find(lines.line(line), unchecked).map(|(at, message)| format!("{at} {message:?}")),
                );
            }
        }
        found
    });
    let mut heard = probe::Heard::default();
    for bytes in pieces {
        for data in datagrams(bytes).flatten().map(|datagram| datagram.data).chain([bytes]) {
            let _ = Kind::of(data);
            let _ = json::items(data, &mut drop);
            osc::messages(data, &mut |message| drop(message));
            heard.datagram(data);
        }
    }
    heard.identity();
    let Ok(mut live) = OpenImuSession::new(settings, carrier, &wanted) else { return 0 };
    session(&mut live, modem_lines, &[], script, 0.0)
}
