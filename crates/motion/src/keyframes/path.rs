//! The path between key poses: a spline on SO(3) x R^3.
//!
//! What comes in: recorded poses, one per frame, and the frames of the key poses. What goes out: a pose at any
//! (also fractional) frame. The spline passes through the recorded key poses and has a continuous velocity except
//! at corners. It keeps turning and moving apart, so it does not depend on a screw axis far away.
//!
//! Each segment is split until what is left is the recording's noise. A piece from pose a to pose b is the
//! straight motion between them plus a cubic that vanishes at both ends,
//! `R(s) = R_a exp(s log(R_a' R_b)) exp(e(s))`, `e(0) = e(1) = 0`, and the same with positions. So velocities at
//! the knots enter linearly, are shared by both neighbours, and follow from one tridiagonal least-squares
//! problem for all six channels.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::KeyPose;
use super::smooth::parabola_weights;
use posed_geometry::so3;

/// A segment is split until its residuals are at most so many times the noise.
const NOISE_FACTOR: f64 = 1.2;
/// A piece is at least so many frames long.
const SHORTEST_PIECE: usize = 5;

/// A smooth path through key poses: cubic in position and in the rotation vector between knots, with one velocity per
/// knot, two at a corner. It is fitted with all frames at once, so it is for recordings. Deviations:
/// `docs/keyframes.md`.
#[derive(Clone, Debug)]
pub struct Spline {
    knots: Vec<Knot>,
}

#[derive(Clone, Copy, Debug)]
struct Knot {
    frame: usize,
    pose: Isometry3<f64>,
    corner: bool,
    /// Velocity on arrival and on departure, per frame; equal unless this is a corner.
    arrival: Velocity,
    departure: Velocity,
}

/// Velocity at a knot: linear in the frame of reference, angular in sensor axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Linear velocity, m per frame.
    pub linear: Vector3<f64>,
    /// Angular velocity, rad per frame.
    pub angular: Vector3<f64>,
}

/// Root mean square distance of a path from a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Deviation {
    /// Of positions, m.
    pub position_m: f64,
    /// Of orientations, rad.
    pub rotation_rad: f64,
}

impl Deviation {
    /// Distance of `path`, a pose per frame, from a recording, over `frames` (both ends included; those beyond the
    /// recording are left out). Zero where no frame is left.
    pub fn of(
        path: impl Fn(usize) -> Isometry3<f64>,
        poses: &[Isometry3<f64>],
        frames: std::ops::RangeInclusive<usize>,
    ) -> Self {
        let (mut position, mut rotation, mut count) = (0.0, 0.0, 0.0f64);
        for frame in frames {
            let Some(pose) = poses.get(frame) else { break };
            let at = path(frame);
            position += (at.translation.vector - pose.translation.vector).norm_squared();
            rotation += so3::log(&(at.rotation.inverse() * pose.rotation)).norm_squared();
            count += 1.0;
        }
        let mean = |sum: f64| (sum / count.max(1.0)).sqrt();
        Self { position_m: mean(position), rotation_rad: mean(rotation) }
    }
}

impl Spline {
    /// Fits the path to a recording of at least two poses (m; sensor to the frame of reference); `None` for fewer.
    ///
    /// The ends of the recording are knots too. `keys` outside the recording or out of order are ignored. A segment is
    /// split until its residuals are at most 1.2 times the noise, in pieces of five frames or more.
    pub fn fit(poses: &[Isometry3<f64>], keys: &[KeyPose]) -> Option<Self> {
        let ends = segment_ends(poses.len(), keys)?;
        let noise = Noise::of(poses);
        let mut pieces: Vec<usize> = vec![1; ends.len() - 1];
        loop {
            let mut spline = Self { knots: knots(poses, &ends, &pieces) };
            spline.solve(poses);
            let mut split = false;
            for (pair, count) in ends.windows(2).zip(&mut pieces) {
                let (start, end) = (pair[0].0, pair[1].0);
                let short = (end - start) / (2 * *count) < SHORTEST_PIECE;
                if !short && !noise.explains(&spline.deviation(poses, start..=end)) {
                    *count *= 2;
                    split = true;
                }
            }
            if !split {
                return Some(spline);
            }
        }
    }

    /// Pose at a frame, which may be a fraction; before the first and after the last knot the motion stands.
    pub fn pose(&self, frame: f64) -> Isometry3<f64> {
        let (a, b) = self.piece(frame);
        let length = (b.frame - a.frame) as f64;
        let s = ((frame - a.frame as f64) / length).clamp(0.0, 1.0);
        let chord = Chord::between(a, b);
        let (start, end) = slopes(s);
        let bend = |a: Vector3<f64>, b: Vector3<f64>, chord: Vector3<f64>| {
            (a - chord) * (start * length) + (b - chord) * (end * length)
        };
        let linear = bend(a.departure.linear, b.arrival.linear, chord.linear);
        let angular = bend(a.departure.angular, b.arrival.angular, chord.angular);
        let position = a.pose.translation.vector + chord.linear * (s * length) + linear;
        let rotation = a.pose.rotation * so3::exp(&(chord.angular * (s * length))) * so3::exp(&angular);
        Isometry3::from_parts(Translation3::from(position), rotation)
    }

    /// Frame, velocity on arrival and velocity on departure of each knot, in order; both are equal unless it is a
    /// corner.
    pub fn knots(&self) -> impl Iterator<Item = (usize, Velocity, Velocity)> + '_ {
        self.knots.iter().map(|knot| (knot.frame, knot.arrival, knot.departure))
    }

    /// Distance from the recording that it was fitted to, over `frames`, as `Deviation::of`.
    pub fn deviation(&self, poses: &[Isometry3<f64>], frames: std::ops::RangeInclusive<usize>) -> Deviation {
        Deviation::of(|frame| self.pose(frame as f64), poses, frames)
    }

    fn piece(&self, frame: f64) -> (&Knot, &Knot) {
        let after = self.knots.partition_point(|knot| (knot.frame as f64) <= frame);
        let last = after.clamp(1, self.knots.len() - 1);
        (&self.knots[last - 1], &self.knots[last])
    }

    /// Velocities at the knots by least squares over all frames.
    fn solve(&mut self, poses: &[Isometry3<f64>]) {
        // Corners have two velocities, other knots one.
        let mut unknown = 0;
        let mut indices = Vec::with_capacity(self.knots.len());
        for (k, knot) in self.knots.iter().enumerate() {
            let inner_corner = knot.corner && k > 0 && k + 1 < self.knots.len();
            indices.push((unknown, unknown + usize::from(inner_corner)));
            unknown += 1 + usize::from(inner_corner);
        }
        let mut system = Tridiagonal::new(unknown);
        for (k, pair) in self.knots.windows(2).enumerate() {
            let (a, b) = (&pair[0], &pair[1]);
            let (from, to) = (indices[k].1, indices[k + 1].0);
            let length = (b.frame - a.frame) as f64;
            let chord = Chord::between(a, b);
            for (offset, pose) in poses[a.frame..=b.frame].iter().enumerate() {
                let s = offset as f64 / length;
                let (start, end) = slopes(s);
                let (start, end) = (start * length, end * length);
                let bent = residual(a, &chord, offset as f64, pose);
                let chord = chord.channels();
                let target: [f64; 6] = std::array::from_fn(|c| bent[c] + (start + end) * chord[c]);
                system.add((from, start), (to, end), &target);
            }
            // Where a piece has no frames of its own, the chord decides.
            let weight = 1e-9 * length;
            system.add((from, weight), (to, 0.0), &chord.channels().map(|c| weight * c));
            system.add((to, weight), (from, 0.0), &chord.channels().map(|c| weight * c));
        }
        let velocities = system.solve();
        for (knot, (arrival, departure)) in self.knots.iter_mut().zip(indices) {
            knot.arrival = Velocity::from_channels(&velocities[arrival]);
            knot.departure = Velocity::from_channels(&velocities[departure]);
        }
    }
}

/// The straight motion of a piece, per frame.
struct Chord {
    linear: Vector3<f64>,
    angular: Vector3<f64>,
}

impl Chord {
    fn between(a: &Knot, b: &Knot) -> Self {
        let length = (b.frame - a.frame) as f64;
        let rotation_vector_rad = so3::log(&(a.pose.rotation.inverse() * b.pose.rotation));
        Self {
            linear: (b.pose.translation.vector - a.pose.translation.vector) / length,
            angular: rotation_vector_rad / length,
        }
    }

    fn channels(&self) -> [f64; 6] {
        let (v, w) = (&self.linear, &self.angular);
        [v.x, v.y, v.z, w.x, w.y, w.z]
    }
}

impl Velocity {
    fn from_channels(c: &[f64; 6]) -> Self {
        Self { linear: Vector3::new(c[0], c[1], c[2]), angular: Vector3::new(c[3], c[4], c[5]) }
    }
}

/// What a pose differs from the straight motion, `offset` frames after its start.
fn residual(a: &Knot, chord: &Chord, offset: f64, pose: &Isometry3<f64>) -> [f64; 6] {
    let p = pose.translation.vector - a.pose.translation.vector - chord.linear * offset;
    let straight = a.pose.rotation * so3::exp(&(chord.angular * offset));
    let w = so3::log(&(straight.inverse() * pose.rotation));
    [p.x, p.y, p.z, w.x, w.y, w.z]
}

/// Hermite's cubics that start with slope one, and that end with it.
fn slopes(s: f64) -> (f64, f64) {
    (s * (1.0 - s) * (1.0 - s), s * s * (s - 1.0))
}

/// Frames of key poses with both ends of a recording of `frames` poses, and whether each is a corner; `None` for fewer than
/// two poses. Key poses outside the recording or out of order are left out.
pub fn segment_ends(frames: usize, keys: &[KeyPose]) -> Option<Vec<(usize, bool)>> {
    let last = frames.checked_sub(1).filter(|last| *last > 0)?;
    let mut ends = vec![(0, true)];
    for key in keys {
        let frame = usize::try_from(key.frame).unwrap_or(usize::MAX);
        if frame < last && ends.last().is_some_and(|end| frame > end.0) {
            ends.push((frame, key.corner));
        }
    }
    ends.push((last, true));
    Some(ends)
}

/// Knots at the key poses, and between them where segments are split.
fn knots(poses: &[Isometry3<f64>], ends: &[(usize, bool)], pieces: &[usize]) -> Vec<Knot> {
    let knot = |frame, pose, corner| Knot {
        frame,
        pose,
        corner,
        arrival: Velocity::default(),
        departure: Velocity::default(),
    };
    let mut knots = Vec::new();
    for (pair, count) in ends.windows(2).zip(pieces) {
        let ((start, corner), (end, _)) = (pair[0], pair[1]);
        knots.push(knot(start, poses[start], corner));
        for piece in 1..*count {
            let frame = start + (end - start) * piece / count;
            let reach = (end - start) / (2 * count);
            let reach = reach.min(frame - start).min(end - frame);
            knots.push(knot(frame, local_fit(&poses[frame - reach..=frame + reach]), false));
        }
    }
    if let Some((frame, corner)) = ends.last() {
        knots.push(knot(*frame, poses[*frame], *corner));
    }
    knots
}

/// Value of a parabola fitted to the poses, in the middle of them.
fn local_fit(poses: &[Isometry3<f64>]) -> Isometry3<f64> {
    let half = poses.len() / 2;
    if half < 2 {
        return poses[half];
    }
    let middle = &poses[half];
    let mut position = Vector3::zeros();
    let mut rotation_vector_rad = Vector3::zeros();
    for (pose, weight) in poses.iter().zip(parabola_weights(half)) {
        position += (pose.translation.vector - middle.translation.vector) * weight;
        rotation_vector_rad += so3::log(&(middle.rotation.inverse() * pose.rotation)) * weight;
    }
    let rotation: UnitQuaternion<f64> = middle.rotation * so3::exp(&rotation_vector_rad);
    Isometry3::from_parts(Translation3::from(middle.translation.vector + position), rotation)
}

/// Noise of a recording, by its third differences: what no smooth motion explains.
struct Noise(Deviation);

impl Noise {
    fn of(poses: &[Isometry3<f64>]) -> Self {
        let mut positions = Vec::new();
        let mut rotations = Vec::new();
        for four in poses.windows(4) {
            let p = |k: usize| four[k].translation.vector;
            positions.push((p(3) - (p(2) - p(1)) * 3.0 - p(0)).norm());
            let rotation_vector_rad =
                |k: usize| so3::log(&(four[k].rotation.inverse() * four[k + 1].rotation));
            rotations.push(
                (rotation_vector_rad(2) - rotation_vector_rad(1) * 2.0 + rotation_vector_rad(0)).norm(),
            );
        }
        // The weights 1, 3, 3, 1 add their squares to 20; the median is not moved by corners, and for
        // three axes it is 1.538 of one axis' deviation, the root mean square 1.732.
        let sigma = |values: &mut Vec<f64>| median(values) / 1.538 * 1.732 / 20f64.sqrt();
        Self(Deviation { position_m: sigma(&mut positions), rotation_rad: sigma(&mut rotations) })
    }

    fn explains(&self, deviation: &Deviation) -> bool {
        // Far below a tracker's last digit nothing needs explaining.
        deviation.position_m <= NOISE_FACTOR * self.0.position_m + 1e-6
            && deviation.rotation_rad <= NOISE_FACTOR * self.0.rotation_rad + 1e-6
    }
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Normal equations that couple only neighbours, with six right-hand sides.
struct Tridiagonal {
    diagonal: Vec<f64>,
    beside: Vec<f64>,
    right: Vec<[f64; 6]>,
}

impl Tridiagonal {
    fn new(unknown: usize) -> Self {
        Self { diagonal: vec![0.0; unknown], beside: vec![0.0; unknown], right: vec![[0.0; 6]; unknown] }
    }

    /// Adds the equation `u x_i + v x_j = target`, with j next to i.
    fn add(&mut self, (i, u): (usize, f64), (j, v): (usize, f64), target: &[f64; 6]) {
        self.diagonal[i] += u * u;
        self.diagonal[j] += v * v;
        self.beside[i.min(j)] += u * v;
        for (c, target) in target.iter().enumerate() {
            self.right[i][c] += u * target;
            self.right[j][c] += v * target;
        }
    }

    /// Eliminates forwards and substitutes backwards; the matrix is positive definite.
    fn solve(mut self) -> Vec<[f64; 6]> {
        let n = self.diagonal.len();
        for i in 1..n {
            let factor = self.beside[i - 1] / self.diagonal[i - 1];
            self.diagonal[i] -= factor * self.beside[i - 1];
            for c in 0..6 {
                self.right[i][c] -= factor * self.right[i - 1][c];
            }
        }
        for i in (0..n).rev() {
            for c in 0..6 {
                let after = if i + 1 < n { self.beside[i] * self.right[i + 1][c] } else { 0.0 };
                self.right[i][c] = (self.right[i][c] - after) / self.diagonal[i];
            }
        }
        self.right
    }
}

#[cfg(test)]
#[path = "path_tests.rs"]
mod tests;
