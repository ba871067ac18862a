//! Where time code lies on the host's clock.

use posed_geometry::Timestamp;
use posed_state::Plain;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Counting, Label, Rate};

/// Time without a frame after which the code is held, s: more than a read that came late.
const HOLDS_AFTER_S: f64 = 0.5;
/// What the pace must be known to before it tells rates apart that differ by 0.1 %.
const TELLS_PACE: f64 = 2.5e-4;

/// How the time code of a moment is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Plain)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "TimecodeState")]
pub enum State {
    /// It is read.
    Locked,
    /// It was read, and is carried on by the host's clock.
    Holding,
    /// It is not known.
    #[default]
    None,
}

/// Time code as a straight line of the host's time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Relation {
    /// The moment at which the newest frame began.
    pub at: Timestamp,
    /// Number of that frame of the code since midnight.
    pub number: f64,
    /// Frames of the code that pass in a second of the host.
    pub frames_per_s: f64,
    /// Standard deviation of that pace, as a share.
    pub pace_sigma: f64,
    /// How the code names its frames.
    pub counting: Counting,
    /// Pictures that a frame of the code stands for.
    pub pictures: u8,
    /// Standard deviation of `at`, s.
    pub sigma_s: f64,
}

impl Relation {
    /// Number of the frame at a moment, with the part of it that has passed; of no day in particular.
    pub fn number_at(&self, t: Timestamp) -> f64 {
        self.number + t.seconds_since(self.at) * self.frames_per_s
    }

    /// When the code is at that number, on the day next to `at`; the number may have a part of a frame.
    pub fn time_of(&self, number: f64) -> Timestamp {
        let day = f64::from(self.counting.day());
        let off = number - self.number;
        let since_s = (off - day * (off / day).round()) / self.frames_per_s;
        Timestamp::from_nanos(self.at.as_nanos().saturating_add((since_s * 1e9).round() as i64))
    }

    /// When a frame began, s after `at`.
    pub(crate) fn since_at_s(&self, number: f64) -> f64 {
        (number - self.number) / self.frames_per_s
    }

    /// Standard deviation of the code at a moment, s.
    pub fn sigma_s(&self, t: Timestamp) -> f64 {
        libm::hypot(self.sigma_s, self.pace_sigma * t.seconds_since(self.at))
    }

    /// How it is known at a moment.
    pub fn state(&self, t: Timestamp) -> State {
        let half_picture_s = 0.5 / (self.frames_per_s * f64::from(self.pictures));
        if self.sigma_s(t) > half_picture_s {
            State::None
        } else if t.seconds_since(self.at) > HOLDS_AFTER_S {
            State::Holding
        } else {
            State::Locked
        }
    }

    /// The time code of a moment, in pictures; `None` where it is not known to half of one.
    pub fn label(&self, t: Timestamp) -> Option<Label> {
        if self.state(t) == State::None {
            return None;
        }
        let Counting { frames_per_s, drop } = self.counting;
        let counting = Counting { frames_per_s: frames_per_s * self.pictures, drop };
        let hundredths = libm::floor(self.number_at(t) * f64::from(self.pictures) * 100.0);
        let hundredths = hundredths.rem_euclid(f64::from(counting.day()) * 100.0) as u64;
        let frame = counting.frame((hundredths / 100) as u32);
        Some(Label { frame, hundredths: (hundredths % 100) as u8, drop })
    }

    /// The rate of the code itself; `None` while its pace does not tell yet.
    pub fn code_rate(&self) -> Option<Rate> {
        let tells = self.counting.drop || self.counting.frames_per_s == 25 || self.pace_sigma < TELLS_PACE;
        tells.then(|| Rate::nearest(self.counting, self.frames_per_s)).flatten()
    }

    /// The rate of the pictures; `None` while the code's pace does not tell yet.
    pub fn rate(&self) -> Option<Rate> {
        let Counting { frames_per_s, drop } = self.counting;
        let counting = Counting { frames_per_s: frames_per_s * self.pictures, drop };
        self.code_rate()?;
        Rate::nearest(counting, self.frames_per_s * f64::from(self.pictures))
    }

    /// How much faster than its rate the code runs on the host's clock, ppm.
    pub fn drift_ppm(&self) -> Option<f64> {
        Some((self.frames_per_s / self.code_rate()?.hz() - 1.0) * 1e6)
    }
}
