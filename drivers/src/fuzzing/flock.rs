//! Flock of Birds.

use super::head::Head;
use super::script::{pieces, probe, session};
use crate::flock::capture::{self, Options};
use crate::flock::parser::{Event, Splitter};
use crate::flock::settings::{Filters, Mode, Settings};
use crate::flock::wire::{
    Addressing, CommandParser, Format, Hemisphere, QuaternionSense, Range, ReportRate, Scale, Shape,
    Tolerance, record, rotation,
};
use crate::flock::{self, Family, FlockSession};
use crate::sample::Timestamp;

/// Full scale of the largest range, and a little.
const REACH_M: f64 = 3.7;

pub(super) const FORMATS: [Format; 7] = [
    Format::PositionQuaternion,
    Format::Position,
    Format::Angles,
    Format::Matrix,
    Format::Quaternion,
    Format::PositionAngles,
    Format::PositionMatrix,
];

pub(super) const HEMISPHERES: [Hemisphere; 6] = [
    Hemisphere::Forward,
    Hemisphere::Aft,
    Hemisphere::Right,
    Hemisphere::Left,
    Hemisphere::Lower,
    Hemisphere::Upper,
];

/// Records, commands, captures, the probe and a session.
///
/// # Panics
/// Where something that was read does not come back when it is written and read again, a byte is unaccounted for; and as all
/// others of this module.
pub fn flock(data: &[u8]) -> usize {
    let (mut head, script) = Head::of(data);
    let mut settings = Settings {
        family: Family::Flock,
        format: head.pick(FORMATS),
        mode: head.pick([Mode::Stream, Mode::Listen, Mode::Point]),
        button: head.flag(false),
        range_in: head.pick([None, Some(Range::In36), Some(Range::In72), Some(Range::In144)]),
        hemisphere: head.pick(HEMISPHERES),
        report_every_cycles: head.pick([
            ReportRate::Every,
            ReportRate::Every2,
            ReportRate::Every8,
            ReportRate::Every32,
        ]),
        measurement_rate_hz: head.number(14.0, 144.0),
        quaternion_sense: head.pick([QuaternionSense::Vendor, QuaternionSense::Direct]),
        filters: head.pick([
            None,
            Some(Filters { dc: true, ac_wide_notch: false, ac_narrow_notch: true }),
            Some(Filters { dc: false, ac_wide_notch: true, ac_narrow_notch: false }),
        ]),
        transmitter_address: head.optional_byte(),
        transmitter_number: head.byte(),
        units: head.optional_byte(),
        addressing: head.pick([
            None,
            Some(Addressing::Normal),
            Some(Addressing::Expanded),
            Some(Addressing::SuperExpanded),
        ]),
        reset_on_open: head.flag(true),
    };
    let baud = head.pick([115_200, 0, 1, 2400, 9600, u32::MAX]);
    let modem_lines = head.flag(false);
    let wanted = head.addresses(&[0]);
    settings.family = head.pick([Family::Flock, Family::Guidance]);
    let options = Options {
        format: head.pick([None, Some(settings.format)]),
        range: settings.range_in,
        quaternion_sense: settings.quaternion_sense,
    };
    let bytes = pieces(script);
    let shape = Shape { format: settings.format, button: settings.button, group: wanted != [0] };
    records(&bytes.concat(), shape);
    commands(&bytes.concat(), settings.addressing.unwrap_or_default());
    let _ = capture::decode(&bytes.concat(), options);
    splitter(&bytes, shape);
    probe(flock::Probe::new(Timestamp::ZERO, modem_lines), script);
    let Ok(mut live) = FlockSession::new(settings, baud, &wanted) else { return 0 };
    session(&mut live, modem_lines, &[], script, REACH_M)
}

fn records(bytes: &[u8], shape: Shape) {
    if let Ok(words) = record::words(bytes, shape) {
        let tail = |back: usize| bytes[bytes.len() - back];
        let button = if shape.button { tail(1 + usize::from(shape.group)) } else { 0 };
        let mut again = Vec::new();
        record::encode_words(&words, button, tail(1), shape, &mut again);
        assert_eq!(again, bytes, "a record changed");
    }
    if let Ok(decoded) = record::decode(bytes, shape, Scale::default(), Tolerance::LIVE)
        && let Some(q) = decoded.orientation_wxyz
    {
        assert!((rotation::norm(q) - 1.0).abs() < 1e-9, "not a unit quaternion");
    }
}

fn commands(bytes: &[u8], addressing: Addressing) {
    let mut parser = CommandParser::new(addressing);
    for &byte in bytes {
        if let Some(Ok(addressed)) = parser.push(byte) {
            let mut again = CommandParser::new(addressing);
            let written = addressed.command.to_bytes(addressed.to, addressing);
            let mut parsed: Vec<_> = written.into_iter().filter_map(|byte| again.push(byte)).collect();
            assert_eq!(parsed.pop(), Some(Ok(addressed)), "a command changed");
        }
    }
}

fn splitter(pieces: &[&[u8]], shape: Shape) {
    let birds = [(1, shape), (2, Shape { format: Format::PositionAngles, ..shape })];
    let birds = if shape.group { &birds[..] } else { &birds[..1] };
    let mut splitter = Splitter::new(birds, Scale::default(), Tolerance::LIVE, 115_200);
    let mut published = 0;
    let mut emit = |event| {
        if let Event::Sample(sample) = event {
            published += birds
                .iter()
                .find(|bird| !shape.group || u16::from(bird.0) == sample.address)
                .map_or(0, |bird| bird.1.len());
        }
    };
    for (i, chunk) in (0..).zip(pieces) {
        splitter.handle_bytes(Timestamp::from_nanos(i * 1_000_000), chunk, &mut emit);
        splitter.handle_timeout(Timestamp::from_nanos(i * 1_000_000 + 500_000), &mut emit);
    }
    splitter.finish();
    let skipped = splitter.take_counters().bytes_skipped as usize;
    assert_eq!(published + skipped, pieces.concat().len(), "a byte is unaccounted for");
}
