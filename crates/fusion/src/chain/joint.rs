//! A hinge between two IMUs without magnetometers: its axis in both sensors and the heading between them, from a whole
//! recording at once.
//!
//! In: the level orientations of the sensors on both sides, whose headings drift apart, and a guess of the axis in
//! each. Out: better axes, and the rotation about the vertical that makes both orientations agree, over time. It never lets the
//! hinge tilt a sensor: the axis corrects the heading alone.
//!
//! Seen from both sensors the axis points the same way in the room, `R1 j1 = H(d) R2 j2`. With `d` nearly constant over a
//! second, all that the samples of that second say is in three sums, because
//! `R1' H(d) R2 = cos(d) A + sin(d) B + C`. Over these blocks the most probable axes and headings are found in turn: the
//! axes as the first pair of singular vectors of the mean of `R1' H R2`, the headings as a random walk that
//! is seen through each block as well as the axis lies level in it.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use posed_geometry::wrapped_rad;

/// Length of a block, s.
pub(super) const BLOCK_S: f64 = 1.0;
/// How the headings drift apart, rad per sqrt(s): what the gyros' biases and scales do that the orientation filter left.
pub(super) const DRIFT: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Least noise of a block's mean direction of the axis, rad.
pub(super) const LEAST_SIGMA: f64 = 0.15 * std::f64::consts::PI / 180.0;
/// Variance of a heading between two sensors of which nothing is known, rad².
pub(super) const UNKNOWN_RAD2: f64 = 3.3;
/// Error of tilts of calibrated sensors, rad.
pub(super) const TILT_RAD: f64 = 0.005;
/// How often axes and headings are improved in turn, at most.
const ROUNDS: usize = 200;

/// The sums of one second, as means.
struct Block {
    /// Mean time, s.
    t_s: f64,
    /// The terms of `cos(d)`, of `sin(d)` and of neither.
    terms: [Matrix3<f64>; 3],
    /// Which way is up in each sensor.
    up: [Vector3<f64>; 2],
}

/// A hinge that was solved.
pub(super) struct Joint {
    /// Unit axis in the sensor before and the sensor behind the hinge.
    pub(super) axes: [Vector3<f64>; 2],
    /// Turn of the level frame behind the hinge into the one before it, at each sample, rad.
    pub(super) heading_rad: Vec<f64>,
    /// Its variance, were the axes known, rad².
    pub(super) heading_rad2: Vec<f64>,
    /// Variance of how the sensors play against each other about each direction, at each sample, rad²: how far the axis, seen from both, differs
    /// within a block.
    pub(super) play_rad2: Vec<f64>,
}

/// Improves a guess of the axes; `steps_s` is the time since the sample before, s.
pub(super) fn solve(
    guess: [Vector3<f64>; 2],
    before: &[UnitQuaternion<f64>],
    behind: &[UnitQuaternion<f64>],
    steps_s: &[f64],
) -> Joint {
    let blocks = blocks(before, behind, steps_s);
    let mut axes = guess;
    let mut weights = vec![1.0; blocks.len()];
    let mut headings = vec![0.0; blocks.len()];
    for round in 0..ROUNDS {
        headings = walk(&blocks, &axes, &weights, (round > 0).then_some(&headings));
        weigh(&blocks, &axes, &headings, &mut weights);
        let mut sum = Matrix3::zeros();
        for ((block, heading), weight) in blocks.iter().zip(&headings).zip(&weights) {
            sum += block.relative(*heading) * *weight;
        }
        let svd = sum.svd(true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { break };
        let (first, second): (Vector3<f64>, Vector3<f64>) = (u.column(0).into(), v_t.row(0).transpose());
        let sign = first.dot(&axes[0]).signum();
        let next = [first * sign, second * sign];
        let moved = next[0].angle(&axes[0]).max(next[1].angle(&axes[1]));
        axes = next;
        if moved < 1e-6 {
            break;
        }
    }
    let (seen, stiffness) = seen(&blocks, &axes, &weights);
    Joint {
        axes,
        heading_rad: at_samples(&blocks, &headings, steps_s),
        heading_rad2: at_samples(&blocks, &variances(&seen, &stiffness), steps_s),
        play_rad2: at_samples(&blocks, &misfits(&blocks, &axes, &headings), steps_s),
    }
}

impl Block {
    /// Mean of `R1' H R2`.
    fn relative(&self, heading: f64) -> Matrix3<f64> {
        self.terms[0] * libm::cos(heading) + self.terms[1] * libm::sin(heading) + self.terms[2]
    }

    /// What each term reports about axes that agree.
    fn agreement(&self, axes: &[Vector3<f64>; 2]) -> [f64; 3] {
        [0, 1, 2].map(|i| axes[0].dot(&(self.terms[i] * axes[1])))
    }
}

fn blocks(before: &[UnitQuaternion<f64>], behind: &[UnitQuaternion<f64>], steps_s: &[f64]) -> Vec<Block> {
    let z = Vector3::z();
    let upright = z * z.transpose();
    let level = Matrix3::identity() - upright;
    let quarter = z.cross_matrix();
    let mut blocks: Vec<Block> = Vec::new();
    let (mut t_s, mut begin_s, mut count) = (0.0, 0.0, 0.0);
    for ((a, b), dt_s) in before.iter().zip(behind).zip(steps_s) {
        t_s += dt_s;
        if blocks.is_empty() || t_s - begin_s >= BLOCK_S {
            if let Some(block) = blocks.last_mut() {
                block.divide(count);
            }
            blocks.push(Block { t_s: 0.0, terms: [Matrix3::zeros(); 3], up: [Vector3::zeros(); 2] });
            (begin_s, count) = (t_s, 0.0);
        }
        let (r1, r2) = (a.to_rotation_matrix().into_inner().transpose(), b.to_rotation_matrix().into_inner());
        if let Some(block) = blocks.last_mut() {
            count += 1.0;
            block.t_s += t_s;
            for (sum, term) in block.terms.iter_mut().zip([level, quarter, upright]) {
                *sum += r1 * term * r2;
            }
            block.up[0] += r1 * z;
            block.up[1] += r2.transpose() * z;
        }
    }
    if let Some(block) = blocks.last_mut() {
        block.divide(count);
    }
    blocks
}

impl Block {
    /// Sums to means.
    fn divide(&mut self, count: f64) {
        self.t_s /= count;
        self.terms.iter_mut().for_each(|term| *term /= count);
        self.up.iter_mut().for_each(|up| *up /= count);
    }
}

/// Variance of a block's mean direction of the axis, rad², from how far its height differs between the sensors: that needs no heading.
fn noise(blocks: &[Block], axes: &[Vector3<f64>; 2]) -> f64 {
    let mut squares: Vec<f64> =
        blocks.iter().map(|b| (axes[0].dot(&b.up[0]) - axes[1].dot(&b.up[1])).powi(2)).collect();
    // The median of a squared normal variable is 0.455 of its variance.
    median(&mut squares) / 0.455 + LEAST_SIGMA * LEAST_SIGMA
}

/// Half the mean squared angle between the axes as both sensors see them, of each block, rad².
fn misfits(blocks: &[Block], axes: &[Vector3<f64>; 2], headings: &[f64]) -> Vec<f64> {
    let of = |(block, heading): (&Block, &f64)| {
        let [level, quarter, upright] = block.agreement(axes);
        (1.0 - (level * libm::cos(*heading) + quarter * libm::sin(*heading) + upright)).max(0.0)
    };
    blocks.iter().zip(headings).map(of).collect()
}

/// Weight of each block: one in which the sensors play, or do not agree at all, counts less.
fn weigh(blocks: &[Block], axes: &[Vector3<f64>; 2], headings: &[f64], weights: &mut Vec<f64>) {
    let misfits = misfits(blocks, axes, headings);
    let typical = median(&mut misfits.clone()).max(1e-12);
    weights.clear();
    weights.extend(misfits.iter().map(|misfit| 2.0 / (1.0 + misfit / typical)));
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// What is known of the headings: measured heading and its information of each block, rad and rad⁻²; and the stiffness between two, rad⁻².
fn seen(blocks: &[Block], axes: &[Vector3<f64>; 2], weights: &[f64]) -> (Vec<(f64, f64)>, Vec<f64>) {
    let variance = noise(blocks, axes);
    let seen = blocks
        .iter()
        .zip(weights)
        .map(|(block, weight)| {
            let [level, quarter, _] = block.agreement(axes);
            (libm::atan2(quarter, level), weight * libm::hypot(quarter, level) / variance)
        })
        .collect();
    let between = |pair: &[Block]| 1.0 / (DRIFT * DRIFT * (pair[1].t_s - pair[0].t_s).max(1e-3));
    (seen, blocks.windows(2).map(between).collect())
}

/// The most probable headings of the blocks, rad, unwrapped; from those of the round before, if there was one.
fn walk(blocks: &[Block], axes: &[Vector3<f64>; 2], weights: &[f64], held: Option<&Vec<f64>>) -> Vec<f64> {
    let (seen, stiffness) = seen(blocks, axes, weights);
    let mut headings = held.cloned().unwrap_or_else(|| follow(&seen, &stiffness));
    for _ in 0..if held.is_some() { 2 } else { 10 } {
        smooth(&mut headings, &seen, &stiffness);
    }
    headings
}

/// Variances of the smoothed headings, rad²: what is known from both ends meets in each block.
fn variances(seen: &[(f64, f64)], stiffness: &[f64]) -> Vec<f64> {
    let through = |information: f64, stiffness: f64| information * stiffness / (information + stiffness);
    let mut behind = vec![0.0; seen.len()];
    for k in (1..seen.len()).rev() {
        behind[k - 1] = through(behind[k] + seen[k].1, stiffness[k - 1]);
    }
    let mut before = 0.0;
    let mut variances = Vec::with_capacity(seen.len());
    for (k, (_, known)) in seen.iter().enumerate() {
        variances.push((before + known + behind[k]).recip().min(UNKNOWN_RAD2));
        if k < stiffness.len() {
            before = through(before + known, stiffness[k]);
        }
    }
    variances
}

/// A first guess: a filter that follows what is seen, forward.
fn follow(seen: &[(f64, f64)], stiffness: &[f64]) -> Vec<f64> {
    let (mut heading, mut information) = (0.0, 0.0);
    let mut headings = Vec::with_capacity(seen.len());
    for (k, (measured, known)) in seen.iter().enumerate() {
        if k > 0 {
            information = 1.0 / (1.0 / f64::max(information, 1e-9) + 1.0 / stiffness[k - 1]);
        }
        information += known;
        heading += wrapped_rad(measured - heading) * known / information.max(1e-9);
        headings.push(heading);
    }
    headings
}

/// One Gauss-Newton step of all headings: a tridiagonal system.
fn smooth(headings: &mut [f64], seen: &[(f64, f64)], stiffness: &[f64]) {
    let n = headings.len();
    let mut diagonal = vec![0.0; n];
    let mut right = vec![0.0; n];
    for k in 0..n {
        let (measured, known) = seen[k];
        diagonal[k] = known + 1e-6;
        right[k] = known * wrapped_rad(measured - headings[k]);
        if k > 0 {
            diagonal[k] += stiffness[k - 1];
            right[k] -= stiffness[k - 1] * (headings[k] - headings[k - 1]);
        }
        if k + 1 < n {
            diagonal[k] += stiffness[k];
            right[k] += stiffness[k] * (headings[k + 1] - headings[k]);
        }
    }
    for k in 1..n {
        let factor = stiffness[k - 1] / diagonal[k - 1];
        diagonal[k] -= factor * stiffness[k - 1];
        right[k] += factor * right[k - 1];
    }
    for k in (0..n).rev() {
        let next = if k + 1 < n { stiffness[k] * right[k + 1] } else { 0.0 };
        right[k] = (right[k] + next) / diagonal[k];
        headings[k] += right[k];
    }
}

/// Blocks' headings, straight between their mean times.
fn at_samples(blocks: &[Block], headings: &[f64], steps_s: &[f64]) -> Vec<f64> {
    let mut next = 0;
    let mut t_s = 0.0;
    steps_s
        .iter()
        .map(|dt_s| {
            t_s += dt_s;
            while next < blocks.len() && blocks[next].t_s < t_s {
                next += 1;
            }
            if next == 0 || next == blocks.len() {
                return headings[next.min(blocks.len() - 1)];
            }
            let (from, to) = (&blocks[next - 1], &blocks[next]);
            let part = (t_s - from.t_s) / (to.t_s - from.t_s);
            headings[next - 1] + part * (headings[next] - headings[next - 1])
        })
        .collect()
}

/// Angle about the axis from the sensor before to the one behind, rad in (-pi, pi]; its zero depends on how the
/// sensors are mounted.
pub(super) fn angle_rad(
    axes: &[Vector3<f64>; 2],
    heading_rad: f64,
    before: &UnitQuaternion<f64>,
    behind: &UnitQuaternion<f64>,
) -> f64 {
    let [to_z, from_z] = [to_z(&axes[0]), to_z(&axes[1]).inverse()];
    let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
    let q = to_z * (before.inverse() * heading * behind) * from_z;
    wrapped_rad(2.0 * libm::atan2(q.k, q.w))
}

/// Standard deviation of an angle, rad, where the axis' part along the vertical is `upright`: as far as it stands upright an error of the
/// heading turns about it; the sensors play about the axis as they do across it.
pub(super) fn sigma_rad(upright: f64, heading_rad2: f64, quality_rad: f64, play_rad2: f64) -> f64 {
    let variance =
        upright * upright * heading_rad2 + quality_rad.powi(2) + play_rad2 + 2.0 * TILT_RAD.powi(2);
    variance.sqrt().min(std::f64::consts::PI)
}

/// Turns an axis to z.
fn to_z(axis: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(axis, &Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_geometry::so3;

    const DT_S: f64 = 0.01;

    /// A hinge moved in all directions for a minute, whose second sensor's level frame starts 40 degrees off and drifts.
    struct Recording {
        axes: [Vector3<f64>; 2],
        /// Level orientations of both sensors.
        before: Vec<UnitQuaternion<f64>>,
        behind: Vec<UnitQuaternion<f64>>,
        /// The true angle, rad.
        angles: Vec<f64>,
    }

    fn recording(drift_rad_s: f64) -> Recording {
        let axes = [Vector3::new(0.6, 0.0, 0.8), Vector3::new(0.0, -0.8, 0.6)];
        let (mut before, mut behind, mut angles) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..6000 {
            let t = DT_S * f64::from(k);
            let a = so3::exp(&Vector3::new(libm::sin(0.9 * t), 0.8 * libm::cos(0.7 * t), libm::sin(1.1 * t)));
            let angle = 0.8 + 0.7 * libm::sin(2.3 * t);
            let bend = to_z(&axes[0]).inverse() * so3::exp(&(Vector3::z() * angle)) * to_z(&axes[1]);
            behind.push(so3::exp(&(Vector3::z() * (0.7 + drift_rad_s * t))) * a * bend);
            before.push(a);
            angles.push(angle);
        }
        Recording { axes, before, behind, angles }
    }

    #[test]
    fn axes_and_angle_survive_headings_that_drift_apart() {
        let Recording { axes, before, behind, angles } = recording(0.3_f64.to_radians());
        let off = |axis: Vector3<f64>, by: Vector3<f64>| so3::exp(&by) * axis;
        let guess = [off(axes[0], Vector3::new(0.1, 0.2, -0.1)), off(axes[1], Vector3::new(-0.2, 0.1, 0.1))];
        let joint = solve(guess, &before, &behind, &vec![DT_S; before.len()]);
        for (found, axis) in joint.axes.iter().zip(&axes) {
            assert!(found.angle(axis).to_degrees() < 0.1, "{found:?}");
        }
        for (k, angle) in angles.iter().enumerate() {
            let found = angle_rad(&joint.axes, joint.heading_rad[k], &before[k], &behind[k]);
            let off = wrapped_rad(found - angle).to_degrees();
            assert!(off.abs() < 0.5, "{off} degrees off at sample {k}");
        }
    }

    #[test]
    fn an_upright_axis_leaves_the_heading_to_the_gyros() {
        let Recording { before, behind, .. } = recording(0.0);
        let blocks = blocks(&before, &behind, &vec![DT_S; before.len()]);
        let still: Vec<Block> = blocks
            .iter()
            .map(|block| Block {
                t_s: block.t_s,
                terms: [Matrix3::zeros(), Matrix3::zeros(), Vector3::z() * Vector3::z().transpose()],
                up: [Vector3::z(); 2],
            })
            .collect();
        let headings = walk(&still, &[Vector3::z(); 2], &vec![1.0; still.len()], None);
        assert!(headings.iter().all(|heading| *heading == 0.0), "{headings:?}");
    }

    #[test]
    fn the_sums_of_a_block_say_what_its_samples_say() {
        let Recording { axes, before, behind, .. } = recording(0.0);
        let blocks = blocks(&before[..50], &behind[..50], &[DT_S; 50]);
        let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.4);
        let mean: f64 = before[..50]
            .iter()
            .zip(&behind[..50])
            .map(|(a, b)| (a * axes[0]).dot(&(heading * (b * axes[1]))) / 50.0)
            .sum();
        assert_eq!(blocks.len(), 1);
        assert!((axes[0].dot(&(blocks[0].relative(0.4) * axes[1])) - mean).abs() < 1e-12);
    }
}
