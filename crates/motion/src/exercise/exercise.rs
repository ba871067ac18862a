//! A taught exercise, as it is kept in a file.
//!
//! What comes in: what teaching found. What goes out: JSON that any computer reads, and the same back. What it never
//! does: load a file of another format or version, or one whose parts do not fit together.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::hmm::{Gaussians, Movement};
use super::still::{self, Still};
use super::turns::Turn;

/// First field of the file.
const FORMAT: &str = "posed-exercise";
/// Version of the file that this program writes and reads.
const VERSION: u32 = 1;

/// Repetitions nearer than this share of the shortest taught one are one.
const REFRACTORY: f64 = 0.4;
/// So are those that follow each other in less than this share of the taught interval: a little more than half, for
/// what happens twice in the rhythm of a movement is a part of it.
pub(super) const RHYTHM: f64 = 0.55;

/// A taught exercise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Exercise {
    /// `posed-exercise`.
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Name, as in events.
    pub name: String,
    /// Counts how often an exercise of this name was taught, from 1.
    #[serde(default = "first")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub revision: u32,
    /// Frames per second of the model.
    pub rate_hz: f64,
    /// The channels it looks at, as `channels` names them.
    pub channels: Vec<String>,
    /// Values and velocities of the channels, in this order.
    pub movement: Movement,
    /// Sizes in which the movement was taught, falling from 1: the first and the last step of a walk are smaller.
    #[serde(default = "taught_size")]
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 8)))]
    pub sizes: Vec<f64>,
    /// Tempi in which it is counted, the taught one, 1, first: how fast joints go against the lesson. Other people go about it in their
    /// own.
    #[serde(default = "taught_tempo")]
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 8)))]
    pub tempi: Vec<f64>,
    /// Where each channel was while all joints of the lesson rested, in the order of `channels`; empty: not known.
    #[serde(default)]
    pub rest: Vec<f64>,
    /// Turning point of each channel, in the order of `channels`; empty: those of the states' means, whose spread is not known.
    #[serde(default)]
    pub turns: Vec<Turn>,
    /// Joints that keep still in it; empty: nothing is known of them.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(length(max = 64)))]
    pub still: Vec<Still>,
    /// Durations of the taught repetitions.
    pub durations: Durations,
    /// Log dimensionless jerk of the taught repetitions.
    pub log_jerk: f64,
    /// What a repetition must be like to count.
    pub gate: Gate,
}

fn first() -> u32 {
    1
}

fn taught_size() -> Vec<f64> {
    vec![1.0]
}

fn taught_tempo() -> Vec<f64> {
    vec![1.0]
}

/// How an exercise is looked for, the way it was taught being 1: each manner is a chain of states of its own.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Manner {
    /// How far the joints go.
    pub(super) size: f64,
    /// How fast.
    pub(super) tempo: f64,
}

/// Durations of repetitions, s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Durations {
    /// Shortest.
    pub shortest_s: f64,
    /// Median.
    pub median_s: f64,
    /// Longest.
    pub longest_s: f64,
    /// Median from the end of one to the end of the next; 0: not known.
    #[serde(default)]
    pub interval_s: f64,
}

/// What a repetition must be like to count; see `judge`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Gate {
    /// Least mean log ratio of exercise and background, per frame.
    pub mean_log_ratio: f64,
    /// Least mean log ratio in the worst fifth.
    pub fifth_log_ratio: f64,
    /// Least and greatest size of the movement, the taught one being 1.
    pub gain: [f64; 2],
    /// Least correlation with the taught movement.
    pub similarity: f64,
    /// Least and greatest duration, the taught one being 1.
    pub duration: [f64; 2],
    /// Least share of the states visited.
    pub visited: f64,
}

/// Why an exercise file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ExerciseError {
    /// Not JSON, or not of this shape.
    #[error("this is no exercise file: {0}")]
    Shape(#[from] serde_json::Error),
    /// Of another program or version.
    #[error(
        "this file is `{format}` version {version}; this program reads `{FORMAT}` version {VERSION}: teach it again"
    )]
    Version {
        /// What the file says it is.
        format: String,
        /// Its version.
        version: u32,
    },
    /// The numbers do not fit together.
    #[error("this exercise file is damaged: {0}")]
    Damaged(&'static str),
}

impl Exercise {
    pub(super) fn new(
        name: String,
        rate_hz: f64,
        channels: Vec<String>,
        movement: Movement,
        durations: Durations,
        gate: Gate,
    ) -> Self {
        let (format, version) = (FORMAT.to_owned(), VERSION);
        let (sizes, tempi) = (taught_size(), taught_tempo());
        Self {
            format,
            version,
            name,
            revision: first(),
            rate_hz,
            channels,
            movement,
            sizes,
            tempi,
            rest: Vec::new(),
            turns: Vec::new(),
            still: Vec::new(),
            durations,
            log_jerk: 0.0,
            gate,
        }
    }

    /// Reads a file's text.
    ///
    /// # Errors
    /// It is not JSON of this shape, of another version, or its parts do not fit together.
    pub fn from_json(text: &str) -> Result<Self, ExerciseError> {
        #[derive(Deserialize)]
        struct Head {
            format: String,
            version: u32,
        }
        let Head { format, version } = serde_json::from_str(text)?;
        if format != FORMAT || version != VERSION {
            return Err(ExerciseError::Version { format, version });
        }
        let exercise: Self = serde_json::from_str(text)?;
        exercise.check()?;
        Ok(exercise)
    }

    /// The file's text.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn to_json(&self) -> Result<String, ExerciseError> {
        let mut text = serde_json::to_string_pretty(self)?;
        text.push('\n');
        Ok(text)
    }

    /// Takes the turning points of the states' means where a file has none.
    pub(super) fn take_turns_of_means(&mut self) {
        if self.turns.is_empty() {
            let turn = |channel| Turn::of_means(&self.movement, channel);
            self.turns = (0..self.channels.len()).map(turn).collect();
        }
    }

    /// The channel that a number of [`Feedback`](super::Feedback) means: one of `channels`, or behind them a joint that keeps still.
    pub fn channel(&self, number: usize) -> Option<&str> {
        let still = || self.still.get(number.checked_sub(self.channels.len())?).map(|still| &still.channel);
        self.channels.get(number).or_else(still).map(String::as_str)
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.movement.states.mean.first().map_or(0, Vec::len)
    }

    /// Two ends nearer than this are those of one repetition, s. Who goes about it in a faster tempo has a faster rhythm, too.
    pub(super) fn refractory_s(&self) -> f64 {
        let Durations { shortest_s, interval_s, .. } = self.durations;
        let fastest = self.tempi.iter().copied().fold(1.0, f64::max);
        (REFRACTORY * shortest_s).max(RHYTHM * interval_s) / fastest
    }

    /// The manners in which it is looked for: each size in the taught tempo, and the full size in each other one.
    pub(super) fn manners(&self) -> impl Iterator<Item = Manner> + '_ {
        let sizes = self.sizes.iter().map(|size| Manner { size: *size, tempo: 1.0 });
        sizes.chain(self.tempi.iter().skip(1).map(|tempo| Manner { size: 1.0, tempo: *tempo }))
    }

    /// Number of its manners.
    pub(super) fn chains(&self) -> usize {
        self.manners().count()
    }

    /// Whether its parts fit together.
    ///
    /// # Errors
    /// The first one that does not.
    pub fn check(&self) -> Result<(), ExerciseError> {
        if self.format != FORMAT || self.version != VERSION {
            return Err(ExerciseError::Version { format: self.format.clone(), version: self.version });
        }
        let width = 2 * self.channels.len();
        let fits = |gaussians: &Gaussians, states: usize| {
            [&gaussians.mean, &gaussians.sd]
                .iter()
                .all(|rows| rows.len() == width && rows.iter().all(|row| row.len() == states))
        };
        let finite = |gaussians: &Gaussians| {
            gaussians.mean.iter().flatten().all(|mean| mean.is_finite())
                && gaussians.sd.iter().flatten().all(|sd| sd.is_finite() && *sd > 0.0)
        };
        let Movement { states, background, amplitude } = &self.movement;
        let Durations { shortest_s, median_s, longest_s, interval_s } = self.durations;
        let [fast, slow] = self.gate.duration;
        if self.name.is_empty() {
            Err(ExerciseError::Damaged("it has no name"))
        } else if self.channels.is_empty() || amplitude.len() != width {
            Err(ExerciseError::Damaged("channels and amplitudes do not match"))
        } else if !(6..=4096).contains(&self.states()) {
            Err(ExerciseError::Damaged("it needs 6 to 4096 states"))
        } else if !fits(states, self.states()) || !fits(background, 2) {
            Err(ExerciseError::Damaged("the states' rows differ in length"))
        } else if !finite(states)
            || !finite(background)
            || amplitude.iter().any(|value| value.is_nan() || *value <= 0.0)
        {
            Err(ExerciseError::Damaged("a standard deviation or an amplitude is not above 0"))
        } else if !sizes_fit(&self.sizes) {
            Err(ExerciseError::Damaged("the sizes do not fall from 1"))
        } else if !tempi_fit(&self.tempi) {
            Err(ExerciseError::Damaged("the tempi do not begin with 1, or one is not between 0.25 and 4"))
        } else if !self.rest.is_empty()
            && (self.rest.len() != self.channels.len() || self.rest.iter().any(|rest| !rest.is_finite()))
        {
            Err(ExerciseError::Damaged("the posture at rest does not match the channels"))
        } else if !turns_fit(&self.turns, self.channels.len(), self.states()) {
            Err(ExerciseError::Damaged("the turning points do not match the channels"))
        } else if self.still.len() > still::MOST || !self.still.iter().all(Still::is_right) {
            Err(ExerciseError::Damaged("a joint that keeps still has no range"))
        } else if !(fast >= 0.0 && fast <= slow && slow <= 10.0) {
            Err(ExerciseError::Damaged("the gate's durations are not in order"))
        } else if !(1.0..=1000.0).contains(&self.rate_hz) {
            Err(ExerciseError::Damaged("the frame rate is not between 1 and 1000 Hz"))
        } else if !(shortest_s > 0.0 && shortest_s <= median_s && median_s <= longest_s && longest_s < 600.0)
        {
            Err(ExerciseError::Damaged("the durations are not in order"))
        } else if !(0.0..600.0).contains(&interval_s) {
            Err(ExerciseError::Damaged("the interval is not between 0 and 600 s"))
        } else {
            Ok(())
        }
    }
}

/// Whether turning points are those of so many channels, each in one of so many states.
fn turns_fit(turns: &[Turn], channels: usize, states: usize) -> bool {
    let fits = |turn: &Turn| {
        (turn.state as usize) < states && turn.way.is_finite() && turn.sd >= 0.0 && turn.sd.is_finite()
    };
    turns.is_empty() || (turns.len() == channels && turns.iter().all(fits))
}

/// Whether tempi begin with the taught one, and none is absurd.
fn tempi_fit(tempi: &[f64]) -> bool {
    (1..=8).contains(&tempi.len())
        && tempi[0] == 1.0
        && tempi.iter().all(|tempo| (0.25..=4.0).contains(tempo))
}

/// Whether sizes fall from 1, not below a hundredth.
fn sizes_fit(sizes: &[f64]) -> bool {
    (1..=8).contains(&sizes.len())
        && sizes[0] == 1.0
        && sizes.windows(2).all(|pair| pair[1] < pair[0] && pair[1] >= 0.01)
}
