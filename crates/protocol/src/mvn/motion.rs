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

    /// First and second derivative at the newest body of what `of` says of one, least squares of a parabola; zero while there are fewer than three.
    pub(super) fn derivatives(&self, of: impl Fn(&Figure) -> Vector3<f64>) -> [Vector3<f64>; 2] {
        let mut normal = Matrix3::<f64>::zeros();
        let mut right = Matrix3::<f64>::zeros();
        let now_s = self.0.back().map_or(0.0, |(t_s, _)| *t_s);
        for (t_s, figure) in &self.0 {
            let t_s = t_s - now_s;
            let powers = Vector3::new(1.0, t_s, 0.5 * t_s * t_s);
            normal += powers * powers.transpose();
            right += powers * of(figure).transpose();
        }
        let fit = normal.try_inverse().filter(|_| self.0.len() > 2).map(|inverse| inverse * right);
        fit.map_or([Vector3::zeros(); 2], |fit| [fit.row(1).transpose(), fit.row(2).transpose()])
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
