//! Labelled sequences, and the frames a model makes of them at its own rate.
//!
//! What comes in: positions and classes at any rate. What goes out: positions and classes at the ticks of
//! another rate, straight lines between the frames. What it never does: bridge a gap.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::input::Position;

/// Longest time between two frames that a straight line bridges, s.
pub(super) const GAP_S: f64 = 0.25;

/// A labelled sequence to learn from or to be measured on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequence {
    /// Times, s, rising.
    pub t_s: Vec<f64>,
    /// Joints per frame.
    pub joints: usize,
    /// Positions in the room, z up, m, joint by joint, frame after frame; `None` where missing.
    pub positions_m: Vec<Position>,
    /// Class of each frame; `None` is neither learned nor scored.
    pub classes: Vec<Option<u16>>,
}

impl Sequence {
    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.t_s.len()
    }

    /// Positions of one frame, joint by joint, m.
    ///
    /// # Panics
    /// There is no such frame.
    pub fn positions(&self, frame: usize) -> &[Position] {
        &self.positions_m[frame * self.joints..][..self.joints]
    }

    /// First and last time, s; both 0 without frames.
    pub fn span_s(&self) -> (f64, f64) {
        (self.t_s.first().copied().unwrap_or(0.0), self.t_s.last().copied().unwrap_or(0.0))
    }

    /// Positions at a time, appended to `out`, and the nearest frame. `hint` is a frame not after `t_s`.
    pub(super) fn at(&self, t_s: f64, hint: &mut usize, out: &mut Vec<Position>) -> usize {
        while *hint + 1 < self.frames() && self.t_s[*hint + 1] <= t_s {
            *hint += 1;
        }
        let below = *hint;
        let above = (below + 1).min(self.frames() - 1);
        let rows = [below, above].map(|frame| self.positions(frame));
        between(t_s, (self.t_s[below], rows[0]), (self.t_s[above], rows[1]), out);
        if (self.t_s[above] - t_s).abs() < (t_s - self.t_s[below]).abs() { above } else { below }
    }
}

/// Positions on the straight lines between two frames, appended to `out`.
pub(super) fn between(
    t_s: f64,
    (t_a, a): (f64, &[Position]),
    (t_b, b): (f64, &[Position]),
    out: &mut Vec<Position>,
) {
    let share = if t_b > t_a { ((t_s - t_a) / (t_b - t_a)).clamp(0.0, 1.0) } else { 0.0 };
    let close = t_b - t_a <= GAP_S;
    for (a, b) in a.iter().zip(b) {
        out.push(match (a, b) {
            (Some(a), _) if share < 1e-6 => Some(*a),
            (_, Some(b)) if share > 1.0 - 1e-6 => Some(*b),
            (Some(a), Some(b)) if close => Some(std::array::from_fn(|i| a[i] + share * (b[i] - a[i]))),
            _ => None,
        });
    }
}

/// How training files are changed to be learned from: noise and masks at the borders, by the paper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
#[serde(deny_unknown_fields)]
pub struct Spoiling {
    /// Share of frames whose label is replaced by a random one.
    pub label_noise: f64,
    /// Share of frames within `border_frames` around a border whose label is replaced by a random one.
    pub border_noise: f64,
    /// Width of the border of `border_noise`, frames of the file.
    pub border_frames: usize,
}

/// Frames of `classes` within `width` frames centred on a change of class.
pub(super) fn near_borders(classes: &[Option<u16>], width: usize) -> Vec<bool> {
    let mut near = vec![false; classes.len()];
    for (frame, pair) in classes.windows(2).enumerate() {
        if pair[0] != pair[1] {
            // The border lies between `frame` and `frame + 1`.
            let first = (frame + 1).saturating_sub(width.div_ceil(2));
            let end = (frame + 1 + width / 2).min(near.len());
            near[first..end].fill(true);
        }
    }
    near
}
