//! Trunk and arms of the made-up people of [`actions`](crate::actions) and [`primitives`](crate::primitives): nine angles in, joints out.

use std::f64::consts::{PI, TAU};

use nalgebra::{Rotation3, Vector3};

use crate::actions::JOINTS;
use crate::random::Random;

/// Angles of the trunk and the arms, rad; of pairs the left one first.
pub(crate) const ANGLES: usize = 9;
pub(crate) const LEAN: usize = 0;
pub(crate) const CROUCH: usize = 1;
pub(crate) const TWIST: usize = 2;
pub(crate) const RAISE: [usize; 2] = [3, 4];
pub(crate) const BEND: [usize; 2] = [5, 6];
pub(crate) const SPREAD: [usize; 2] = [7, 8];
/// +1 to the left, -1 to the right.
pub(crate) const SIGNS: [f64; 2] = [1.0, -1.0];

/// Uniform within `spread` of `mean`.
pub(crate) fn around(random: &mut Random, mean: f64, spread: f64) -> f64 {
    mean + spread * (2.0 * random.uniform() - 1.0)
}

/// How somebody stands when nothing is done, and sways.
pub(crate) struct Carriage {
    pub(crate) rest: [f64; ANGLES],
    sway: [[f64; 3]; ANGLES],
}

impl Carriage {
    /// Draws one; `crouch` is its mean, rad.
    pub(crate) fn draw(random: &mut Random, crouch: f64) -> Self {
        let rest = std::array::from_fn(|index| match index {
            LEAN => around(random, 0.05, 0.05),
            CROUCH => around(random, crouch, 0.04),
            5 | 6 => around(random, 0.35, 0.2),
            7 | 8 => around(random, 0.12, 0.06),
            _ => around(random, 0.0, 0.06),
        });
        let sway = std::array::from_fn(|_| {
            [around(random, 0.03, 0.02), around(random, 0.5, 0.3), around(random, PI, PI)]
        });
        Self { rest, sway }
    }

    /// The angles as they sway at a time.
    pub(crate) fn swayed(&self, mut angles: [f64; ANGLES], t_s: f64) -> [f64; ANGLES] {
        for (angle, [size, rate, shift]) in angles.iter_mut().zip(self.sway) {
            *angle += size * libm::sin(TAU * rate * t_s + shift);
        }
        angles
    }
}

/// A rotation about an axis, rad.
pub(crate) fn about(axis: Vector3<f64>, angle: f64) -> Rotation3<f64> {
    Rotation3::new(axis * angle)
}

/// Places the first thirteen of [`JOINTS`], from hips to hands, of a person of this scale (m).
pub(crate) fn place(
    joints: &mut [Vector3<f64>; JOINTS.len()],
    hips: Vector3<f64>,
    body: Rotation3<f64>,
    angles: &[f64; ANGLES],
    scale: f64,
) {
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    let torso = body * about(z, angles[TWIST]) * about(y, angles[LEAN]);
    joints[0] = hips;
    for (joint, height) in [(1, 0.15), (2, 0.35), (3, 0.5), (4, 0.68)] {
        joints[joint] = hips + torso * Vector3::new(0.0, 0.0, height * scale);
    }
    for (side, sign) in SIGNS.into_iter().enumerate() {
        let arm = torso * about(x, sign * angles[SPREAD[side]]) * about(y, -angles[RAISE[side]]);
        let fore = arm * about(y, -angles[BEND[side]]);
        let first = 5 + 4 * side;
        joints[first] = hips + torso * Vector3::new(0.0, 0.19 * scale * sign, 0.46 * scale);
        joints[first + 1] = joints[first] - arm * z * (0.3 * scale);
        joints[first + 2] = joints[first + 1] - fore * z * (0.26 * scale);
        joints[first + 3] = joints[first + 2] - fore * z * (0.09 * scale);
    }
}

/// As markers on the skin show them: with 2 mm of noise per axis.
pub(crate) fn marked(joints: [Vector3<f64>; JOINTS.len()], random: &mut Random) -> [[f64; 3]; JOINTS.len()] {
    joints.map(|joint| [joint.x, joint.y, joint.z].map(|value| value + 0.002 * random.normal()))
}

/// Holds that nobody leaps: no joint moves 8 m/s (0.11 m a frame), or lies lower or higher than these, m.
#[cfg(test)]
pub(crate) fn assert_no_leap(seed: u64, frames: &[[[f64; 3]; JOINTS.len()]], lowest: f64, highest: f64) {
    for pair in frames.windows(2) {
        for (joint, (a, b)) in pair[0].iter().zip(&pair[1]).enumerate() {
            let step = (Vector3::from(*a) - Vector3::from(*b)).norm();
            assert!(step < 0.11, "{seed}: {} moves {step}", JOINTS[joint]);
            assert!(a[2] > lowest && a[2] < highest, "{seed}: {a:?}");
        }
    }
}
