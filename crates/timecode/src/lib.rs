//! SMPTE time code: what cameras and recorders write beside their pictures, and where it lies on the host's clock.
//!
//! What comes in: sound samples ([`ltc::Decoder`]) or MIDI bytes ([`mtc::Decoder`]), in any pieces. What goes out: a [`Reading`] per
//! frame that was read, and from readings and the host times of their reads the [`Relation`] of time code to host time
//! ([`Follower`]). What it never does: ask a clock, believe a single frame that speaks against all others, or go on stating a time
//! code that it cannot know to half a frame.
//!
//! ```
//! use posed_geometry::Timestamp;
//! use posed_timecode::{Counting, Follower, Frame, ltc};
//!
//! // One second of LTC, 25 frames, as a sound card reads it: 480 samples at a time.
//! let counting = Counting { frames_per_s: 25, drop: false };
//! let mut encoder = ltc::Encoder::new(48_000.0, 25.0, counting, Frame::new(10, 0, 0, 0));
//! let (mut decoder, mut follower) = (ltc::Decoder::new(48_000.0), Follower::new(0.0, 1));
//! for read in 1..=100 {
//!     let samples: Vec<f32> = (0..480).map(|_| encoder.sample()).collect();
//!     let t_read = Timestamp::from_nanos(read * 10_000_000);
//!     decoder.push(&samples, 0, |reading| _ = follower.push(t_read, &reading));
//! }
//! let relation = follower.relation().unwrap();
//! let label = relation.label(Timestamp::from_secs_f64(0.5022)).unwrap();
//! assert_eq!(label.to_string(), "10:00:00:12.55");
//! ```

mod code;
mod envelope;
mod follow;
pub mod ltc;
pub mod mtc;
mod relation;
#[cfg(test)]
mod tests;

pub use code::{Counting, Frame, Label, Rate};
pub use follow::Follower;
pub use relation::{Relation, State};

use posed_state::Plain;
use serde::{Deserialize, Serialize};

/// One frame of time code that was read from its signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Reading {
    /// What it says.
    pub frame: Frame,
    /// Whether it leaves out numbers so as to keep up with the clock on the wall.
    pub drop: bool,
    /// Frames that are counted in a second, where the signal says so: MIDI does, LTC does not.
    pub frames_per_s: Option<u8>,
    /// The eight digits that are anybody's to use, the first in the lowest four bits; 0 where the signal has none.
    pub user_bits: u32,
    /// Which stream it was read from: another number is another count of samples.
    pub stream: u32,
    /// Where the frame begins, s on the sound card's clock since the stream's first sample; none for MIDI.
    pub position_s: Option<f64>,
    /// How long before the end of the read that brought it the frame began, s, as far as the signal itself tells.
    pub behind_s: f64,
    /// Whether the code runs backwards.
    pub reversed: bool,
}
