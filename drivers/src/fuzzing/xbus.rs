//! Xsens: single devices and chains.

use super::head::Head;
use super::script::{cut_both_ways, pieces, probe, session};
use crate::sample::Timestamp;
use crate::xbus::frame::Framer;
use crate::xbus::message::{self, Configuration, Tracker};
use crate::xbus::mtdata::Layout;
use crate::xbus::{Settings, XbusSession, capture, probe::inquiry};

/// Messages, captures, the probe and a session.
///
/// # Panics
/// Where a byte is unaccounted for, or a message changes when written; and as all others of this module.
pub fn xbus(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    let default = Settings::default();
    let settings = Settings {
        sampling: default.sampling,
        rate_hz: head.number(5.0, 2000.0).unwrap_or(default.rate_hz),
        orientation: head.flag(default.orientation),
    };
    let baud = head.pick([460_800, 0, 1, 9600, 115_200, u32::MAX]);
    let lead = match head.byte() % 3 {
        0 => vec![],
        1 => chain(),
        _ => alone(),
    };
    let modem_lines = head.flag(false);
    let wanted = head.addresses(&[1]);
    let bytes = pieces(script);
    cut_both_ways(&bytes, messages);
    cut_both_ways(&bytes, |pieces| {
        let mut decoder = capture::Decoder::new();
        // By its text: NaN, which an item may hold, is not equal to itself.
        let mut records = Vec::new();
        pieces.iter().for_each(|piece| decoder.push(piece, |record| records.push(format!("{record:?}"))));
        (records, decoder.finish())
    });
    probe(inquiry(Timestamp::ZERO), script);
    let Ok(mut live) = XbusSession::new(settings, baud, &wanted) else { return 0 };
    session(&mut live, modem_lines, &lead, script, 0.0)
}

fn messages(pieces: &[&[u8]]) -> (Vec<(u64, Vec<u8>)>, u64) {
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
    let bytes: usize = pieces.iter().map(|piece| piece.len()).sum();
    assert_eq!(inside as u64 + framer.bytes_skipped(), bytes as u64, "a byte is unaccounted for");
    (out, framer.bad_checksums())
}

fn reply(mid: u8, data: &[u8]) -> Vec<u8> {
    message::request(message::MASTER, mid + 1, data)
}

/// What a master with two trackers answers to its set-up.
fn chain() -> Vec<Vec<u8>> {
    let layout = Layout { mode: 6, settings: 0 };
    let tracker = |device_id| Tracker { device_id, data_len: 52, layout };
    let chain = Configuration {
        master_id: 0x0010_0021,
        period_ticks: 1152,
        skip_factor: 0,
        trackers: vec![tracker(0x0032_03E9), tracker(0x0032_03EA)],
    };
    vec![
        reply(message::GOTO_CONFIG, &[]),
        reply(message::REQ_DEVICE_ID, &[0, 0x10, 0, 0x21]),
        reply(message::INIT_BUS, &[0, 0x32, 3, 0xE9, 0, 0x32, 3, 0xEA]),
        reply(message::REQ_CONFIGURATION, &chain.encode()),
        reply(message::REQ_CONFIGURATION, &chain.encode()),
        reply(message::GOTO_MEASUREMENT, &[]),
    ]
}

/// What a single device answers.
fn alone() -> Vec<Vec<u8>> {
    let outputs: Vec<u8> =
        [0x1020, 0xFFFF, 0x4020, 100, 0x8020, 100_u16].into_iter().flat_map(u16::to_be_bytes).collect();
    vec![
        reply(message::GOTO_CONFIG, &[]),
        reply(message::REQ_DEVICE_ID, &[0, 0x70, 0, 1]),
        message::request(message::MASTER, message::ERROR, &[4]),
        reply(message::OUTPUT_CONFIGURATION, &outputs),
        reply(message::OUTPUT_CONFIGURATION, &outputs),
        reply(message::GOTO_MEASUREMENT, &[]),
    ]
}
