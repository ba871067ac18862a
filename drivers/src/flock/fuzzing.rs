//! What the fuzz targets run; an ordinary test runs the same over the committed corpus.
//!
//! Each takes any bytes, must not panic, and checks what holds for every input.

use super::capture::{self, Options};
use super::settings::{Mode, Settings};
use super::wire::{Addressing, CommandParser, Format, Scale, Shape, Tolerance, record, rotation};
use super::{FlockSession, parser::Event, parser::Splitter};
use crate::sample::{Measurement, Timestamp};
use crate::session::{LineEvent, Output, Session};

/// Records, commands and captures.
///
/// # Panics
/// Where something that was read does not come back when it is written and read again.
pub fn wire(data: &[u8]) {
    let Some((&choice, bytes)) = data.split_first() else { return };
    let format = Format::ALL[usize::from(choice) % 7];
    let shape = Shape { format, button: choice & 0x40 != 0, group: choice & 0x80 != 0 };
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
    let addressing =
        [Addressing::Normal, Addressing::Expanded, Addressing::SuperExpanded][usize::from(choice) % 3];
    let mut parser = CommandParser::new(addressing);
    for &byte in bytes {
        if let Some(Ok(addressed)) = parser.push(byte) {
            let mut again = CommandParser::new(addressing);
            let written = addressed.command.to_bytes(addressed.to, addressing);
            let mut parsed: Vec<_> = written.into_iter().filter_map(|byte| again.push(byte)).collect();
            assert_eq!(parsed.pop(), Some(Ok(addressed)), "a command changed");
        }
    }
    let _ = capture::decode(bytes, Options::default());
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
    for (i, chunk) in (0..).zip(bytes.chunks(usize::from(choice % 40) + 1)) {
        splitter.handle_bytes(Timestamp::from_nanos(i * 1_000_000), chunk, &mut emit);
        splitter.handle_timeout(Timestamp::from_nanos(i * 1_000_000 + 500_000), &mut emit);
    }
    splitter.finish();
    let skipped = splitter.take_counters().bytes_skipped as usize;
    assert_eq!(published + skipped, bytes.len(), "a byte is unaccounted for");
}

/// A session that hears anything, at any time; returns how many samples it published.
///
/// # Panics
/// Where a pose is no pose, or the session wants to be woken at one time for ever.
pub fn session(data: &[u8]) -> usize {
    let Some((&choice, mut rest)) = data.split_first() else { return 0 };
    let settings = Settings {
        format: Format::ALL[usize::from(choice) % 7],
        mode: match choice & 0x48 {
            0 => Mode::Stream,
            0x08 => Mode::Listen,
            _ => Mode::Point,
        },
        button: choice & 0x20 != 0,
        ..Settings::default()
    };
    let wanted: &[u16] = if choice & 0x80 != 0 { &[1, 2] } else { &[0] };
    let Ok(mut session) = FlockSession::new(settings, 115_200, wanted) else { return 0 };
    let mut now = Timestamp::ZERO;
    session.handle_line(now, &LineEvent::Opened { modem_lines: choice & 0x10 != 0 });
    let mut samples = 0;
    while let Some((&step, after)) = rest.split_first() {
        rest = after;
        match step {
            // The time goes on: to the next deadline, or by a bit.
            0..=0x3F => {
                if let Some(at) = session.poll_timeout() {
                    now = now.max(at);
                    let mut calls = 0;
                    while session.poll_timeout().is_some_and(|at| at <= now) {
                        session.handle_timeout(now);
                        calls += 1;
                        assert!(calls < 50, "it wants to be woken for ever");
                    }
                }
            }
            0x40..=0x5F => now = now + std::time::Duration::from_micros(u64::from(step - 0x3F) * 200),
            0x60 => session.handle_line(now, &LineEvent::Closed { reason: "unplugged".into() }),
            0x61 => session.handle_line(now, &LineEvent::Opened { modem_lines: false }),
            0x62 => session.handle_line(now, &LineEvent::Dropped { bytes: 17 }),
            _ => {
                let (bytes, later) = rest.split_at(usize::from(step - 0x62).min(rest.len()));
                session.handle_bytes(now, bytes);
                rest = later;
            }
        }
        while let Some(output) = session.poll_output() {
            if let Output::Sample(sample) = output {
                samples += 1;
                let Measurement::Pose { position_m, orientation_wxyz, .. } = sample.measurement else {
                    panic!("a Flock measures poses")
                };
                assert!(position_m.is_none_or(|p| p.iter().all(|c| c.abs() <= 3.7)), "beyond full scale");
                assert!(
                    orientation_wxyz.is_none_or(|q| (rotation::norm(q) - 1.0).abs() < 1e-9),
                    "no rotation"
                );
            }
        }
    }
    samples
}
