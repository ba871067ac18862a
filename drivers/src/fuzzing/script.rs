//! What happens on a line, out of the other bytes of an input, and what must hold while it does.

use std::fmt::Debug;
use std::time::Duration;

use crate::cut::{Cutter, Grammar};
use crate::flock;
use crate::probe::Inquiry;
use crate::sample::{Measurement, Timestamp};
use crate::session::{LineEvent, Output, Session};

/// Longest step of the script, in this unit.
const TICK: Duration = Duration::from_micros(500);

/// One thing that happens.
enum Step<'a> {
    /// The next deadline passes.
    Wait,
    Pass(Duration),
    Line(LineEvent),
    Bytes(&'a [u8]),
}

/// A byte up to 0x3F lets the next deadline pass; 0x3F + n, up to 0x5F, lets n half milliseconds pass; 0x60 closes the line, 0x61
/// opens it, 0x62 drops bytes; 0x62 + n gives the n bytes behind it to who listens.
fn steps(mut script: &[u8]) -> impl Iterator<Item = Step<'_>> {
    std::iter::from_fn(move || {
        let (&step, rest) = script.split_first()?;
        script = rest;
        Some(match step {
            0..=0x3F => Step::Wait,
            0x40..=0x5F => Step::Pass(TICK * u32::from(step - 0x3F)),
            0x60 => Step::Line(LineEvent::Closed { reason: "unplugged".into() }),
            0x61 => Step::Line(LineEvent::Opened { modem_lines: true }),
            0x62 => Step::Line(LineEvent::Dropped { bytes: 17 }),
            _ => {
                let (bytes, later) = rest.split_at(usize::from(step - 0x62).min(rest.len()));
                script = later;
                Step::Bytes(bytes)
            }
        })
    })
}

/// All bytes of the script, as the line cuts them.
pub(super) fn pieces(script: &[u8]) -> Vec<&[u8]> {
    steps(script).filter_map(|step| if let Step::Bytes(bytes) = step { Some(bytes) } else { None }).collect()
}

/// Decodes the pieces in one and one by one, and holds the results against each other.
pub(super) fn cut_both_ways<T: PartialEq + Debug>(pieces: &[&[u8]], decode: impl Fn(&[&[u8]]) -> T) {
    let whole = decode(&[&pieces.concat()]);
    assert_eq!(whole, decode(pieces), "pieces make a difference");
}

/// All messages of the pieces, times that sync was lost, and bytes of no message; `each` sees every message.
pub(super) fn messages<G: Grammar>(
    mut cutter: Cutter<G>,
    pieces: &[&[u8]],
    each: impl Fn(&G::Message),
) -> (Vec<G::Message>, u64, u64) {
    let mut out = Vec::new();
    for piece in pieces {
        cutter.push(piece);
        while let Some(message) = cutter.find() {
            each(&message);
            out.push(message);
        }
    }
    (out, cutter.rejected(), cutter.bytes_skipped())
}

/// Whether bytes are one message and nothing is in front of it.
pub(super) fn is_message<G: Grammar>(mut cutter: Cutter<G>, bytes: &[u8]) -> bool {
    cutter.push(bytes);
    cutter.find().is_some()
}

/// Opens a line, answers with `lead`, then lets the script talk; returns how many samples came out.
///
/// # Panics
/// Where a sample is no measurement or farther than `reach_m`, or the session wants to be woken at one time for ever.
pub(super) fn session(
    session: &mut impl Session,
    modem_lines: bool,
    lead: &[Vec<u8>],
    script: &[u8],
    reach_m: f64,
) -> usize {
    let mut now = Timestamp::ZERO;
    let mut samples = 0;
    session.handle_line(now, &LineEvent::Opened { modem_lines });
    for reply in lead {
        drain(session, reach_m, &mut samples);
        // An empty one lets the time go on to the question.
        if reply.is_empty() {
            wake(session, &mut now);
        } else {
            session.handle_bytes(now, reply);
        }
    }
    for step in steps(script) {
        match step {
            Step::Wait => wake(session, &mut now),
            Step::Pass(duration) => now = now + duration,
            Step::Line(event) => session.handle_line(now, &event),
            Step::Bytes(bytes) => session.handle_bytes(now, bytes),
        }
        drain(session, reach_m, &mut samples);
    }
    samples
}

/// Lets the time go on to the next deadline.
fn wake(session: &mut impl Session, now: &mut Timestamp) {
    let Some(at) = session.poll_timeout() else { return };
    *now = (*now).max(at);
    for _ in 0..50 {
        if session.poll_timeout().is_none_or(|at| at > *now) {
            return;
        }
        session.handle_timeout(*now);
    }
    panic!("it wants to be woken for ever");
}

fn drain(session: &mut impl Session, reach_m: f64, samples: &mut usize) {
    let within =
        |values: [f64; 3], most: f64| values.iter().all(|value| value.is_finite() && value.abs() <= most);
    let unit = |q: [f64; 4]| (q.iter().map(|value| value * value).sum::<f64>().sqrt() - 1.0).abs() < 1e-9;
    while let Some(output) = session.poll_output() {
        let Output::Sample(sample) = output else { continue };
        *samples += 1;
        let (triples, orientation) = match sample.measurement {
            Measurement::Pose { position_m, orientation_wxyz, .. } => {
                assert!(position_m.is_none_or(|p| within(p, reach_m)), "out of reach: {sample:?}");
                ([None; 4], orientation_wxyz)
            }
            Measurement::Imu {
                angular_velocity_rad_s,
                specific_force_m_s2,
                linear_acceleration_m_s2,
                magnetic_field,
                orientation_wxyz,
            } => (
                [angular_velocity_rad_s, specific_force_m_s2, linear_acceleration_m_s2, magnetic_field],
                orientation_wxyz,
            ),
        };
        assert!(
            triples.into_iter().flatten().all(|values| within(values, f64::MAX)),
            "not a number: {sample:?}"
        );
        assert!(orientation.is_none_or(unit), "no rotation: {sample:?}");
    }
}

/// What looks for a device.
pub(super) trait Probe {
    fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]);
    fn handle_timeout(&mut self, now: Timestamp);
    fn poll_timeout(&self) -> Option<Timestamp>;
    fn drain(&mut self);
    fn is_done(&self) -> bool;
}

/// Both kinds have the same methods of their own, but for the name of what they send.
macro_rules! impl_probe {
    ($probe:ty, $poll:ident) => {
        impl Probe for $probe {
            fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8]) {
                self.handle_bytes(now, bytes);
            }

            fn handle_timeout(&mut self, now: Timestamp) {
                self.handle_timeout(now);
            }

            fn poll_timeout(&self) -> Option<Timestamp> {
                self.poll_timeout()
            }

            fn drain(&mut self) {
                while self.$poll().is_some() {}
            }

            fn is_done(&self) -> bool {
                self.result().is_some()
            }
        }
    };
}

impl_probe!(Inquiry, poll_transmit);
impl_probe!(flock::Probe, poll_output);

/// Lets the script answer what looks for a device; line events are nothing to it.
///
/// # Panics
/// Where it comes to no end by its own time-outs.
pub(super) fn probe(mut probe: impl Probe, script: &[u8]) {
    let mut now = Timestamp::ZERO;
    // Silence behind the script.
    for step in steps(script).chain(std::iter::repeat_with(|| Step::Wait).take(10_000)) {
        probe.drain();
        if probe.is_done() {
            return;
        }
        match step {
            Step::Wait => {
                now = probe.poll_timeout().map_or(now, |at| now.max(at));
                probe.handle_timeout(now);
            }
            Step::Pass(duration) => now = now + duration,
            Step::Line(_) => {}
            Step::Bytes(bytes) => probe.handle_bytes(now, bytes),
        }
    }
    panic!("it asks for ever");
}
