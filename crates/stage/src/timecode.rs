//! `[timecode]`: where SMPTE time code comes in.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use posed_timecode::{Follower, Rate};

/// SMPTE time code of cameras and sound recorders: as sound (LTC) or from a MIDI port (MTC).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Timecode {
    /// What carries it.
    #[serde(default)]
    pub signal: TimecodeSignal,
    /// LTC: a program that writes samples to its standard output, and its arguments: signed 16-bit numbers, little-endian, with nothing before
    /// them. Absent, and without `path`: `arecord` on the system's default input.
    pub command: Option<Vec<String>>,
    /// Instead of a program: a FIFO of such samples; with `signal = "mtc"` the device of a MIDI port, such as `/dev/snd/midiC1D0`. A
    /// relative path begins at the stage file.
    pub path: Option<PathBuf>,
    /// Samples per second of each channel.
    #[serde(default = "default_sample_rate_hz")]
    #[schemars(range(min = 8000, max = 192_000))]
    pub sample_rate_hz: u32,
    /// Channels, whose samples take turns.
    #[serde(default = "default_channels")]
    #[schemars(range(min = 1, max = 64))]
    pub channels: u16,
    /// The channel that carries the code, from 1.
    #[serde(default = "default_channels")]
    #[schemars(range(min = 1, max = 64))]
    pub channel: u16,
    /// Rate of the pictures; absent: that of the code itself. With 47.952 and more two pictures are counted to each frame of the code,
    /// which has 30 a second at most. A code of another rate is a problem of the status.
    pub rate: Option<Rate>,
    /// How long the signal takes from the generator into the computer, ms: what a sound card and its driver add.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub delay_ms: f64,
}

/// What carries time code.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TimecodeSignal {
    /// Linear time code: sound.
    #[default]
    Ltc,
    /// MIDI time code: quarter frames.
    Mtc,
}

fn default_sample_rate_hz() -> u32 {
    48_000
}

fn default_channels() -> u16 {
    1
}

impl Timecode {
    /// The program that gives the samples, with its arguments; `None` where they come from a path.
    pub fn program(&self) -> Option<Vec<String>> {
        if self.path.is_some() {
            return None;
        }
        Some(self.command.clone().unwrap_or_else(|| {
            let (channels, rate) = (self.channels.to_string(), self.sample_rate_hz.to_string());
            // Pieces of 5 ms: what is read sooner is known better.
            let words =
                ["arecord", "-q", "-t", "raw", "-f", "S16_LE", "-c", &channels, "-r", &rate, "-F", "5000"];
            words.map(str::to_owned).to_vec()
        }))
    }

    /// What finds where this code lies on the host's clock.
    pub fn follower(&self) -> Follower {
        Follower::new(self.delay_ms * 1e-3, self.rate.map_or(1, Rate::pictures_per_frame))
    }
}
