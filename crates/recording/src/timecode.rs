//! The time code of a recording.

use posed_drivers::Timestamp;
use serde::Serialize;

use posed_stage::Stage;
use posed_stage::input::{Entry, Input};
use posed_timecode::{Follower, Relation};

use super::header::Header;

/// What time code a recording has.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TimecodeInfo {
    /// Time code of its beginning, `HH:MM:SS:FF.hh`.
    pub from: String,
    /// Time code of its end.
    pub to: String,
    /// Rate of the pictures; null where too little was read to tell.
    pub rate: Option<&'static str>,
    /// Frames of the code that were read.
    pub frames: u64,
    /// How often the code has gone on somewhere else.
    pub jumps: u64,
}

/// Follows the time code in a recording's log.
pub struct TimecodeTrack {
    follower: Option<Follower>,
    begun: Timestamp,
    frames: u64,
    first: Option<Relation>,
}

impl TimecodeTrack {
    /// Of a recording with this front part, as its stage file has it.
    pub fn new(header: &Header) -> Self {
        let settings = Stage::parse(&header.stage_toml).ok().and_then(|stage| stage.timecode);
        let follower = settings.map(|settings| settings.follower());
        Self { follower, begun: header.begun, frames: 0, first: None }
    }

    /// Takes an entry of the log, each in its turn.
    pub fn entry(&mut self, entry: &Entry) {
        if let (Input::Timecode(reading), Some(follower)) = (&entry.input, &mut self.follower) {
            self.frames += 1;
            follower.push(entry.t, reading);
            self.first = self.first.or(follower.relation().copied());
        }
    }

    /// Where the code lies by the latest entry.
    pub fn relation(&self) -> Option<&Relation> {
        self.follower.as_ref()?.relation()
    }

    /// What there was until `end`; `None` where no code was read.
    pub fn info(&self, end: Timestamp) -> Option<TimecodeInfo> {
        let (first, last) = (self.first?, self.relation()?);
        Some(TimecodeInfo {
            from: first.label(self.begun)?.to_string(),
            to: last.label(end)?.to_string(),
            rate: last.rate().map(posed_timecode::Rate::name),
            frames: self.frames,
            jumps: self.follower.as_ref()?.jumps(),
        })
    }
}
