//! Streams at the model's pace: channels on an even grid of frames, and their velocities.
//!
//! What comes in: samples of named channels at any times and rates, with gaps. What goes out: one frame per tick of
//! the grid, each value the mean of its samples, NaN where there is none. What it never does: interpolate, or
//! look ahead.

use posed_state::Plain;

/// Longest gap that is filled with empty frames, s; a longer one is jumped over.
const LONGEST_GAP_S: f64 = 2.0;
/// Span of the difference that gives a velocity, s.
const VELOCITY_SPAN_S: f64 = 0.12;

/// A frame is done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame<'a> {
    /// Number on the grid: the frame holds the samples of `[index / rate, (index + 1) / rate)`.
    pub(super) index: u64,
    /// Value per channel; NaN where there is none.
    pub(super) values: &'a [f64],
    /// Whether frames before this one were jumped over.
    pub(super) after_gap: bool,
}

/// Puts samples on the grid.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Resampler {
    rate_hz: f64,
    /// The frame that is being filled.
    current: Option<u64>,
    after_gap: bool,
    sums: Vec<f64>,
    counts: Vec<u32>,
    values: Vec<f64>,
    /// Samples that came too late for their frame.
    late: u64,
}

impl Resampler {
    /// Grid of `rate_hz` for `width` channels.
    pub(super) fn new(rate_hz: f64, width: usize) -> Self {
        Self {
            rate_hz,
            current: None,
            after_gap: false,
            sums: vec![0.0; width],
            counts: vec![0; width],
            values: vec![f64::NAN; width],
            late: 0,
        }
    }

    /// Takes a sample at `t_s`, NaN where a channel has no value, and returns the frames that are done with it.
    /// A sample that is older than the frame being filled, or has no time, is counted and left out.
    pub(super) fn push(&mut self, t_s: f64, values: &[f64], each: &mut dyn FnMut(Frame<'_>)) {
        // A sample on the edge belongs to the frame it begins, whatever its last digit.
        let index = (t_s * self.rate_hz + 1e-6).floor();
        if !(0.0..9e15).contains(&index) {
            self.late += 1;
            return;
        }
        let index = index as u64;
        match self.current {
            Some(current) if index < current => {
                self.late += 1;
                return;
            }
            Some(current) if index > current => {
                self.flush(current, each);
                let gap = index - current - 1;
                if gap as f64 > LONGEST_GAP_S * self.rate_hz {
                    self.after_gap = true;
                } else {
                    for missing in current + 1..index {
                        self.flush(missing, each);
                    }
                }
            }
            _ => {}
        }
        self.current = Some(index);
        for ((sum, count), value) in self.sums.iter_mut().zip(&mut self.counts).zip(values) {
            if value.is_finite() {
                *sum += value;
                *count += 1;
            }
        }
    }

    /// Says the frame that is being filled: the stream has ended.
    pub(super) fn finish(&mut self, each: &mut dyn FnMut(Frame<'_>)) {
        if let Some(current) = self.current.take() {
            self.flush(current, each);
        }
    }

    /// Number of samples left out because they came too late or had no time.
    pub(super) fn late(&self) -> u64 {
        self.late
    }

    fn flush(&mut self, index: u64, each: &mut dyn FnMut(Frame<'_>)) {
        for ((value, sum), count) in self.values.iter_mut().zip(&mut self.sums).zip(&mut self.counts) {
            *value = if *count > 0 { *sum / f64::from(*count) } else { f64::NAN };
            (*sum, *count) = (0.0, 0);
        }
        each(Frame { index, values: &self.values, after_gap: std::mem::take(&mut self.after_gap) });
    }
}

/// Number of frames between the two that a velocity is the difference of.
pub(super) fn velocity_span(rate_hz: f64) -> usize {
    ((VELOCITY_SPAN_S * rate_hz).round() as usize).max(1)
}

/// Appends to each frame its velocities: the difference to the frame some 0.12 s before, per second.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Differentiator {
    rate_hz: f64,
    width: usize,
    /// Ring of the last frames.
    past: Vec<f64>,
    next: usize,
    observation: Vec<f64>,
}

impl Differentiator {
    /// For frames of `width` channels at `rate_hz`.
    pub(super) fn new(rate_hz: f64, width: usize) -> Self {
        let past = vec![f64::NAN; width * velocity_span(rate_hz)];
        Self { rate_hz, width, past, next: 0, observation: vec![f64::NAN; 2 * width] }
    }

    /// Values and velocities; a velocity is NaN where either frame has no value.
    pub(super) fn push(&mut self, values: &[f64]) -> &[f64] {
        let span = self.past.len() / self.width.max(1);
        let past = &mut self.past[self.next * self.width..(self.next + 1) * self.width];
        let (positions, velocities) = self.observation.split_at_mut(self.width);
        for (((position, velocity), past), value) in
            positions.iter_mut().zip(velocities).zip(past).zip(values)
        {
            *position = *value;
            *velocity = (value - *past) * self.rate_hz / span as f64;
            *past = *value;
        }
        self.next = (self.next + 1) % span;
        &self.observation
    }

    /// Forgets the past: the next frame follows a gap.
    pub(super) fn reset(&mut self) {
        self.past.fill(f64::NAN);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(resampler: &mut Resampler, samples: &[(f64, f64)]) -> Vec<(u64, f64, bool)> {
        let mut frames = Vec::new();
        let mut each = |frame: Frame<'_>| frames.push((frame.index, frame.values[0], frame.after_gap));
        for (t_s, value) in samples {
            resampler.push(*t_s, &[*value], &mut each);
        }
        resampler.finish(&mut each);
        frames
    }

    #[test]
    fn given_fast_samples_a_frame_is_their_mean() {
        let samples: Vec<(f64, f64)> = (0..12).map(|i| (f64::from(i) * 0.01, f64::from(i))).collect();
        let frames = frames(&mut Resampler::new(25.0, 1), &samples);
        assert_eq!(frames, [(0, 1.5, false), (1, 5.5, false), (2, 9.5, false)]);
    }

    #[test]
    fn given_a_gap_its_frames_are_empty_and_a_long_one_is_jumped_over() {
        let frames = frames(&mut Resampler::new(10.0, 1), &[(0.0, 1.0), (0.2, 2.0), (60.0, 3.0)]);
        assert_eq!(frames.len(), 4);
        assert!(frames[1].1.is_nan());
        assert_eq!((frames[2], frames[3]), ((2, 2.0, false), (600, 3.0, true)));
    }

    #[test]
    fn given_old_samples_and_bad_times_they_are_counted_and_left_out() {
        let mut resampler = Resampler::new(10.0, 1);
        let samples = [(1.0, 1.0), (0.5, 9.0), (f64::NAN, 9.0), (-1.0, 9.0), (1.05, 3.0)];
        assert_eq!(frames(&mut resampler, &samples), [(10, 2.0, false)]);
        assert_eq!(resampler.late(), 3);
    }

    #[test]
    fn given_a_ramp_the_velocity_is_its_slope() {
        let mut differentiator = Differentiator::new(25.0, 1);
        let last = (0..10).map(|i| differentiator.push(&[f64::from(i) * 0.2]).to_vec()).last().unwrap();
        assert!((last[1] - 5.0).abs() < 1e-12);
        differentiator.reset();
        assert!(differentiator.push(&[0.0])[1].is_nan());
    }
}
