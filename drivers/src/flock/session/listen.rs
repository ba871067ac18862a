//! A unit that somebody else has set up: the session sends nothing and takes what comes.
//!
//! What comes in and goes out is as in [`super`], but for what is transmitted: nothing is. What it never does: take a
//! silent line for a failure that it could fix.

use std::time::Duration;

use crate::flock::parser::Splitter;
use crate::flock::wire::{Scale, Shape, Tolerance};
use crate::sample::Timestamp;
use crate::session::{Output, SensorInfo, State};

use super::stream::Streaming;
use super::{FlockSession, Phase};

/// Longest silence without a word: the other program may ask the unit as seldom as it likes.
const SILENCE: Duration = Duration::from_secs(2);

impl FlockSession {
    /// The port is open: all wanted birds are expected to speak as the settings say.
    pub(super) fn listen(&mut self, now: Timestamp) {
        if self.modem_lines {
            // Opening has raised RTS, which holds the unit in reset.
            self.outputs.push_back(Output::SetRts(false));
        }
        let shape = self.settings.shape(self.wanted != [0]);
        let birds: Vec<(u8, Shape)> = self.wanted.iter().map(|&address| (address, shape)).collect();
        let address = |&address: &u8| SensorInfo { address: u16::from(address), serial: None };
        self.sensors = self.wanted.iter().map(address).collect();
        let range = self.settings.range_in.unwrap_or_default();
        let scale = Scale { range, quaternion_sense: self.settings.quaternion_sense };
        let mut splitter = Splitter::new(&birds, scale, Tolerance::LIVE, self.baud);
        splitter.start_at_cycle(self.next_cycle);
        // Nobody has reported the rate; the samples show it.
        self.rate_hz = None;
        self.phase = Phase::Streaming(Box::new(Streaming {
            splitter,
            silence: SILENCE,
            heard_at: now,
            silent_at: now + SILENCE,
            settled_at: now,
            poll: None,
            returned: Vec::new(),
            strangers: 0,
        }));
    }

    /// Nothing has come for a while: that is said, and the session goes on listening.
    pub(super) fn received_nothing(&mut self, now: Timestamp, mut streaming: Box<Streaming>) {
        let silence_s = streaming.silence.as_secs();
        streaming.silent_at = now + streaming.silence;
        self.phase = Phase::Streaming(streaming);
        self.set_state(State::Silent {
            reason: format!(
                "no record for {silence_s} s; `mode = \"listen\"` sends nothing, so another program must have started \
                 the unit's stream"
            ),
        });
    }
}
