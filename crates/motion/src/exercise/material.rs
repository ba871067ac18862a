//! A recording made ready for teaching: all its channels on the grid of frames.
//!
//! What comes in: a stream. What goes out: values and observations per frame, and the channels' names. What it never
//! does: choose channels.

use super::channels::{Binding, all_channels};
use super::frames::{Differentiator, Frame, Resampler};

/// Frames per second of a model; slower streams keep their own rate.
pub(super) const RATE_HZ: f64 = 25.0;

/// Named columns over time.
#[derive(Clone, Copy, Debug)]
pub struct Stream<'a> {
    /// Names of the columns.
    pub columns: &'a [String],
    /// Times, s, rising; they need no even spacing.
    pub t_s: &'a [f64],
    /// Values in the columns' own units, one time after the other in the order of `columns`; `None` where there is no
    /// value.
    pub values: &'a [Option<f64>],
}

impl<'a> Stream<'a> {
    /// What lies from one time to another, s, both included; empty where nothing does.
    #[must_use]
    pub fn between(&self, from_s: f64, to_s: f64) -> Stream<'a> {
        let from = self.t_s.partition_point(|t_s| *t_s < from_s);
        let to = self.t_s.partition_point(|t_s| *t_s <= to_s).max(from);
        let width = self.columns.len();
        let values = self.values.get(from * width..to * width).unwrap_or_default();
        Stream { columns: self.columns, t_s: &self.t_s[from..to], values }
    }
}

/// Values per frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Material {
    pub(super) rate_hz: f64,
    pub(super) channels: Vec<String>,
    /// Number of each frame on the grid.
    pub(super) index: Vec<u64>,
    /// `[frame][channel]`, NaN where there is none.
    pub(super) values: Vec<f64>,
    /// `[frame][channel, then velocities]`.
    pub(super) observations: Vec<f64>,
}

impl Material {
    /// Puts a stream on a grid of at most `most_hz`; `channels` or all that it has.
    ///
    /// # Errors
    /// The name of a channel that is not there.
    pub(super) fn new(
        stream: &Stream<'_>,
        channels: Option<&[String]>,
        most_hz: f64,
    ) -> Result<Self, String> {
        let channels = channels.map_or_else(|| all_channels(stream.columns), <[String]>::to_vec);
        let mut binding = Binding::new(&channels, stream.columns)?;
        let rate_hz = rate_of(stream.t_s).min(most_hz);
        let mut resampler = Resampler::new(rate_hz, channels.len());
        let mut material =
            Self { rate_hz, channels, index: Vec::new(), values: Vec::new(), observations: Vec::new() };
        let mut differentiator = Differentiator::new(rate_hz, binding.width());
        let mut take = |frame: Frame<'_>| {
            if frame.after_gap {
                differentiator.reset();
            }
            material.index.push(frame.index);
            material.values.extend_from_slice(frame.values);
            material.observations.extend_from_slice(differentiator.push(frame.values));
        };
        let width = stream.columns.len();
        for (row, t_s) in stream.t_s.iter().enumerate() {
            let row = stream.values.get(row * width..(row + 1) * width).unwrap_or(&[]);
            resampler.push(*t_s, binding.values(row), &mut take);
        }
        resampler.finish(&mut take);
        Ok(material)
    }

    /// Number of channels.
    pub(super) fn width(&self) -> usize {
        self.channels.len()
    }

    /// Number of frames.
    pub(super) fn frames(&self) -> usize {
        self.index.len()
    }

    /// The observations of a path, frame by frame with their states.
    pub(super) fn along<'a>(
        &'a self,
        path: impl Iterator<Item = &'a (usize, usize)> + Clone,
    ) -> impl Iterator<Item = (&'a [f64], usize)> + Clone {
        let width = 2 * self.width();
        path.map(move |(frame, state)| (&self.observations[frame * width..][..width], *state))
    }

    /// The same with some of the channels only.
    pub(super) fn only(&self, chosen: &[usize]) -> Self {
        let width = self.width();
        let pick = |rows: &[f64], width: usize, columns: &[usize]| -> Vec<f64> {
            rows.chunks_exact(width).flat_map(|row| columns.iter().map(|column| row[*column])).collect()
        };
        let both: Vec<usize> = chosen.iter().copied().chain(chosen.iter().map(|c| c + width)).collect();
        Self {
            rate_hz: self.rate_hz,
            channels: chosen.iter().map(|channel| self.channels[*channel].clone()).collect(),
            index: self.index.clone(),
            values: pick(&self.values, width, chosen),
            observations: pick(&self.observations, 2 * width, &both),
        }
    }

    /// Stretches of at least so many seconds in which no channel has a value: beginning and end, s.
    pub(super) fn lost(&self, least_s: f64) -> Vec<[f64; 2]> {
        let there = |frame: &usize| {
            self.values[frame * self.width()..][..self.width()].iter().any(|value| value.is_finite())
        };
        let there: Vec<usize> = (0..self.frames()).filter(there).collect();
        let between = |pair: &[usize]| [self.t_s(pair[0]) + 1.0 / self.rate_hz, self.t_s(pair[1])];
        there.windows(2).map(between).filter(|[from_s, to_s]| to_s - from_s >= least_s).collect()
    }

    /// Standard deviation of a channel; 0 where it has no two values.
    pub(super) fn sd(&self, channel: usize) -> f64 {
        let column = self.values.iter().skip(channel).step_by(self.width()).copied();
        super::hmm::spread(column).map_or(0.0, |(_, sd)| sd)
    }

    /// Values scaled by `weights` over each channel's standard deviation, about their means; a missing value keeps
    /// the one before it.
    pub(super) fn scaled(&self, weights: &[f64]) -> Vec<f64> {
        let width = self.width();
        let mut scaled = vec![0.0; self.values.len()];
        for (channel, weight) in weights.iter().enumerate() {
            let column = self.values.iter().skip(channel).step_by(width).copied();
            let Some((mean, sd)) = super::hmm::spread(column.clone()) else { continue };
            let factor = if sd > 0.0 { weight / sd } else { 0.0 };
            let mut last = 0.0;
            for (frame, value) in column.enumerate() {
                if value.is_finite() {
                    last = (value - mean) * factor;
                }
                scaled[frame * width + channel] = last;
            }
        }
        scaled
    }

    /// Time at the start of a frame, s.
    pub(super) fn t_s(&self, frame: usize) -> f64 {
        match (self.index.get(frame), self.index.last()) {
            (Some(index), _) => *index as f64 / self.rate_hz,
            (None, Some(last)) => (last + 1) as f64 / self.rate_hz,
            (None, None) => 0.0,
        }
    }
}

/// Frames per second that a stream can fill: one over the median step, in whole Hz.
fn rate_of(t_s: &[f64]) -> f64 {
    let mut steps: Vec<f64> =
        t_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    if steps.is_empty() {
        return RATE_HZ;
    }
    steps.sort_by(f64::total_cmp);
    (1.0 / steps[steps.len() / 2] + 0.01).floor().max(1.0)
}
