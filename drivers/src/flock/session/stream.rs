//! The stream: records to samples, silence, polls, birds that come and go.
//!
//! What comes in: bytes and timeouts while the unit streams or is polled. What goes out: samples, warnings, and the
//! way back to an examination when the stream has stopped. What it never does: publish what a bird that has just
//! begun to measure says.

use std::time::Duration;

use posed_state::Plain;

use super::configure::Configuring;
use super::{FIRST_PAUSE, FlockSession, Phase};
use crate::flock::parser::{Event, Splitter};
use crate::flock::plan;
use crate::flock::settings::Mode;
use crate::flock::wire::{Addressing, Command, Shape, Tolerance};
use crate::rate::too_seldom;
use crate::sample::Timestamp;
use crate::session::{Output, SensorInfo, State};

/// How long after the start of a stream its poses are not believed: birds that have just begun to measure
/// are off by centimetres, and nothing they say tells whether they have.
const SETTLE: Duration = Duration::from_millis(500);
/// Records of missing birds after which the flock is set up again with them: one may be damage.
const STRANGERS_TO_SET_UP: u8 = 4;
pub(super) const NEWCOMER: &str = "a bird that was missing has appeared; the flock is set up again with it";
/// Shortest silence that counts as one.
const MIN_SILENCE: Duration = Duration::from_millis(250);
/// And before the first record: a busy computer may be late with what it sends to set a unit up.
const START: Duration = Duration::from_secs(1);
/// A reply to POINT that has not come by then was lost.
pub(super) const POINT_LIMIT: Duration = Duration::from_millis(100);

#[derive(Clone, Debug, Plain)]
pub(super) struct Streaming {
    pub(super) splitter: Splitter,
    /// Silence that counts as one between two records.
    pub(super) silence: Duration,
    pub(super) heard_at: Timestamp,
    pub(super) silent_at: Timestamp,
    pub(super) settled_at: Timestamp,
    /// Birds that came back into the stream, and until when their poses are not believed.
    pub(super) returned: Vec<(u16, Timestamp)>,
    /// Records of wanted birds that were not there at set-up.
    pub(super) strangers: u8,
    /// In point mode: when the next question is due, and whether its reply is still awaited.
    pub(super) poll: Option<Poll>,
}

#[derive(Clone, Debug, Plain)]
pub(super) struct Poll {
    pub(super) at: Timestamp,
    pub(super) period: Duration,
    pub(super) sent_at: Timestamp,
    pub(super) awaiting: bool,
}

impl FlockSession {
    pub(super) fn start(&mut self, now: Timestamp, configuring: Configuring) {
        self.set_up_in_part = 0;
        let group = self.wanted != [0];
        let shape = self.settings.shape(group);
        let birds: Vec<(u8, Shape)> = if group {
            configuring
                .findings
                .units
                .iter()
                .filter(|unit| unit.streams())
                .map(|unit| (unit.address, shape))
                .collect()
        } else {
            vec![(0, shape)]
        };
        if birds.is_empty() {
            let reason = "no bird runs; check the FLY switches and the sensor plugs".into();
            return self.pause_and_retry(now, State::Failed { reason });
        }
        let (rate_hz, warning) =
            plan::record_rate_hz(&self.settings, configuring.findings.rate_hz, &birds, self.baud);
        for warning in warning.into_iter().chain(too_seldom(rate_hz)) {
            self.warn(warning);
        }
        self.rate_hz = Some(rate_hz);
        self.sensors = birds
            .iter()
            .map(|&(address, _)| SensorInfo { address: u16::from(address), serial: self.serial(address) })
            .collect();
        let scale = plan::scale(&self.settings, &configuring.findings);
        let mut splitter = Splitter::new(&birds, scale, Tolerance::LIVE, self.baud);
        splitter.start_at_cycle(self.next_cycle);
        let silence = MIN_SILENCE.max(Duration::from_secs_f64(10.0 / rate_hz));
        let poll = match self.settings.mode {
            Mode::Stream => {
                self.transmit(Command::Stream.to_bytes(None, Addressing::Normal));
                None
            }
            Mode::Point => {
                self.transmit(Command::Point.to_bytes(None, Addressing::Normal));
                let period = Duration::from_secs_f64(1.0 / rate_hz);
                Some(Poll { at: now + period, period, sent_at: now, awaiting: true })
            }
            Mode::Listen => None,
        };
        self.phase = Phase::Streaming(Box::new(Streaming {
            splitter,
            silence,
            heard_at: now,
            silent_at: now + silence.max(START),
            settled_at: now + SETTLE,
            returned: Vec::new(),
            strangers: 0,
            poll,
        }));
    }

    pub(super) fn take_counters(&mut self, streaming: &mut Streaming) {
        let counted = streaming.splitter.take_counters();
        self.counters.records += counted.records;
        self.counters.rejected += counted.rejected;
        self.counters.bytes_skipped += counted.bytes_skipped;
    }

    /// Ends the stream, if there is one, and counts what it left open.
    pub(super) fn leave_stream(&mut self) {
        if let Phase::Streaming(mut streaming) = std::mem::replace(&mut self.phase, Phase::Closed) {
            streaming.splitter.finish();
            self.next_cycle = streaming.splitter.cycle() + 1;
            self.take_counters(&mut streaming);
        }
    }

    /// Runs one input of the splitter and passes on what comes out.
    pub(super) fn stream(
        &mut self,
        now: Timestamp,
        mut streaming: Box<Streaming>,
        input: impl FnOnce(&mut Splitter, &mut dyn FnMut(Event)),
    ) {
        let Self { outputs, state, settling, wanted, set_up_for, .. } = self;
        let mut received = false;
        // A wanted bird that has restarted by itself.
        let mut reshaped = None;
        let Streaming { splitter, settled_at, returned, strangers, .. } = &mut *streaming;
        let settled = now >= *settled_at;
        returned.retain(|&(_, until)| now < until);
        input(splitter, &mut |event| {
            match event {
            Event::Sample(sample) => {
                received = true;
                set_up_for.retain(|&address| u16::from(address) != sample.address);
                if !settled || returned.iter().any(|&(address, _)| address == sample.address) {
                    *settling += 1;
                } else if wanted.iter().any(|&address| u16::from(address) == sample.address) {
                    if *state != State::Streaming {
                        // Before its first sample: who times the records begins with a new line.
                        *state = State::Streaming;
                        outputs.push_back(Output::StateChanged);
                    }
                    outputs.push_back(Output::Sample(sample));
                }
            }
            Event::Left(address) => outputs.push_back(Output::Warning(format!(
                "bird {address} has left the stream; the others go on. Check its power, FLY switch and bus cable"
            ))),
            Event::Returned(address) => {
                returned.push((u16::from(address), now + SETTLE));
                outputs.push_back(Output::Warning(format!("bird {address} is back in the stream")));
            }
            Event::Stranger(address) => {
                *strangers = strangers.saturating_add(u8::from(wanted.contains(&address)));
            }
            Event::Reshaped(address) if wanted.contains(&address) && !set_up_for.contains(&address) => {
                set_up_for.push(address);
                reshaped = Some(address);
            }
            Event::Reshaped(_) => {}
        }
        });
        if settled {
            self.take_counters(&mut streaming);
        } else {
            // Birds that have just begun say what no sensor can: that is no fault of the line.
            let counted = streaming.splitter.take_counters();
            self.counters.records += counted.records;
            self.settling += counted.rejected;
        }
        let why = match reshaped {
            Some(address) => {
                Some(format!("bird {address} has restarted by itself; the flock is set up again"))
            }
            None => (streaming.strangers >= STRANGERS_TO_SET_UP).then(|| NEWCOMER.into()),
        };
        if let Some(why) = why.filter(|_| self.settings.mode != Mode::Listen) {
            self.phase = Phase::Streaming(streaming);
            self.leave_stream();
            self.warn(why);
            return self.examine(now);
        }
        if received {
            streaming.heard_at = now;
            streaming.silent_at = now + streaming.silence;
            self.pause = FIRST_PAUSE;
            if let Some(poll) = &mut streaming.poll
                && streaming.splitter.at_cycle_start()
            {
                poll.awaiting = false;
            }
        }
        self.phase = Phase::Streaming(streaming);
    }

    pub(super) fn stream_timeout(&mut self, now: Timestamp, mut streaming: Box<Streaming>) {
        if now >= streaming.silent_at {
            if self.settings.mode == Mode::Listen {
                return self.received_nothing(now, streaming);
            }
            let silence_ms = 1e3 * streaming.silent_at.seconds_since(streaming.heard_at);
            self.phase = Phase::Streaming(streaming);
            self.leave_stream();
            self.set_state(State::Silent {
                reason: format!(
                    "no record for {silence_ms:.0} ms; check the unit's power, FLY switch and cable"
                ),
            });
            return self.examine(now);
        }
        if let Some(poll) = &mut streaming.poll {
            let lost = poll.awaiting && now >= poll.sent_at + POINT_LIMIT;
            if lost || (!poll.awaiting && now >= poll.at) {
                // Never two questions open, and never faster than the unit measures.
                poll.at = now + poll.period;
                poll.sent_at = now;
                poll.awaiting = true;
                self.outputs.push_back(Output::Transmit(Command::Point.to_bytes(None, Addressing::Normal)));
            }
        }
        self.stream(now, streaming, |splitter, emit| splitter.handle_timeout(now, &mut |event| emit(event)));
    }
}
