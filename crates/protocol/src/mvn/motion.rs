//! How segments move, which bodies do not say: velocities and accelerations from the last few of them, and where their common centre of mass is.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};

use super::Figure;
use posed_fusion::body::WholeSegment as W;

/// Bodies that a parabola is laid through: 40 ms at 100 Hz.
const WINDOW: usize = 5;
/// After a gap as long the movement begins anew, s.
const GAP_S: f64 = 0.1;

/// The last few bodies.
#[derive(Clone, Debug, Default)]
pub(super) struct Track(VecDeque<(f64, Figure)>);

impl Track {
    pub(super) fn push(&mut self, t_s: f64, figure: &Figure) {
        if self.0.back().is_some_and(|(last_s, _)| t_s <= *last_s || t_s - last_s > GAP_S) {
            self.clear();
        }
        if self.0.len() == WINDOW {
            self.0.pop_front();
        }
        self.0.push_back((t_s, figure.clone()));
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// A parabola through them, least squares.
    pub(super) fn parabola(&self) -> Parabola<'_> {
        let now_s = self.0.back().map_or(0.0, |(t_s, _)| *t_s);
        let powers = |t_s: f64| Vector3::new(1.0, t_s - now_s, 0.5 * (t_s - now_s).powi(2));
        let normal: Matrix3<f64> =
            self.0.iter().map(|(t_s, _)| powers(*t_s) * powers(*t_s).transpose()).sum();
        let inverse = normal.try_inverse().filter(|_| self.0.len() > 2).unwrap_or_default();
        let mut weights = [Vector3::zeros(); WINDOW];
        for (weight, (t_s, _)) in weights.iter_mut().zip(&self.0) {
            *weight = inverse * powers(*t_s);
        }
        Parabola { figures: &self.0, weights }
    }
}

/// What of each body counts for a value at the newest of them and for its derivatives, in this order; nothing while there are fewer than three.
pub(super) struct Parabola<'a> {
    figures: &'a VecDeque<(f64, Figure)>,
    weights: [Vector3<f64>; WINDOW],
}

impl Parabola<'_> {
    /// First and second derivative at the newest body of what `of` says of one.
    pub(super) fn derivatives(&self, of: impl Fn(&Figure) -> Vector3<f64>) -> [Vector3<f64>; 2] {
        let mut derivatives = [Vector3::zeros(); 2];
        for ((_, figure), weight) in self.figures.iter().zip(&self.weights) {
            let value = of(figure);
            derivatives[0] += value * weight.y;
            derivatives[1] += value * weight.z;
        }
        derivatives
    }
}

/// Parts of a body from one joint to another, their shares of its mass, and where along the way each has its centre: Winter 2009, table 4.1 (forearm with
/// hand, shank with foot; trunk from the hips' to the shoulders' mid-points, head and neck at the ear, which is as high as the joint above the neck).
const PARTS: [(W, W, f64, f64); 9] = [
    (W::Head, W::Head, 0.081, 0.0),
    (W::UpperArmR, W::ForearmR, 0.028, 0.436),
    (W::UpperArmL, W::ForearmL, 0.028, 0.436),
    (W::ForearmR, W::HandR, 0.022, 0.682),
    (W::ForearmL, W::HandL, 0.022, 0.682),
    (W::UpperLegR, W::LowerLegR, 0.1, 0.433),
    (W::UpperLegL, W::LowerLegL, 0.1, 0.433),
    (W::LowerLegR, W::FootR, 0.061, 0.606),
    (W::LowerLegL, W::FootL, 0.061, 0.606),
];
const TRUNK: (f64, f64) = (0.497, 0.5);

/// In the room, m.
pub(super) fn centre_of_mass_m(figure: &Figure) -> Vector3<f64> {
    let at = |segment: W| figure.origins_m[segment.index()];
    let shoulders_m = at(W::UpperArmR).lerp(&at(W::UpperArmL), 0.5);
    let trunk_m = at(W::Pelvis).lerp(&shoulders_m, TRUNK.1) * TRUNK.0;
    PARTS.iter().fold(trunk_m, |sum, (from, to, mass, share)| sum + at(*from).lerp(&at(*to), *share) * *mass)
}
