//! Whether a strap has slipped, and which: what a limb's filter could not predict is held against two explanations, that its sensors sit as well as is believed, and that one
//! of them was turned.
//!
//! In: the residuals that [`super::parameters`] looks at, and how they depend on both mountings. Out: which sensor was turned, if that is far likelier. It moves nothing itself.
//!
//! A generalised likelihood ratio (Willsky and Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear systems", 1976) over a
//! window that forgets: with information Λ and score λ of a mounting, relative to what is believed now, the logarithm of the likelihood under a normal prior of
//! covariance C is `λ'(Λ + C⁻¹)⁻¹λ / 2 - log det(I + ΛC) / 2`; the ratio is that of C = P + S to that of C = P.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use posed_state::Plain;

use super::parameters::{PARAMETERS, mount};
use super::{LimbGeometry, Which};

/// What is seen is forgotten over this time, s.
const WINDOW_S: f64 = 5.0;
/// How much likelier a slip must be, natural logarithm: one in ten minutes and limb is expected at most, among windows of some seconds.
const LIKELIER: f64 = 12.0;
/// A mounting that is turned by less is learnt as it is, rad.
const LEAST_RAD: f64 = 0.12;

/// What the last seconds show of both mountings, relative to what is believed.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Slips {
    information: Matrix6<f64>,
    score: Vector6<f64>,
}

impl Default for Slips {
    fn default() -> Self {
        Self { information: Matrix6::zeros(), score: Vector6::zeros() }
    }
}

impl Slips {
    pub(super) fn forget(&mut self, dt_s: f64) {
        let kept = WINDOW_S / (WINDOW_S + dt_s);
        self.information *= kept;
        self.score *= kept;
    }

    /// A residual that depends on both mountings by `by`; `inverse` is that of its covariance if both sit as is believed.
    pub(super) fn add<const M: usize>(
        &mut self,
        by: &SMatrix<f64, 6, M>,
        inverse: &SMatrix<f64, M, M>,
        residual: &SVector<f64, M>,
    ) {
        let weighed = by * inverse;
        self.information += weighed * by.transpose();
        self.score += weighed * residual;
    }

    /// What is believed has moved.
    pub(super) fn moved(&mut self, by: &Vector6<f64>) {
        self.score -= self.information * by;
    }

    /// Whether it is far likelier that a strap has slipped than that both hold; `known` is the covariance of both mountings, `slipped` the variances of what a
    /// strap that slips turns by, about the segment's axes.
    pub(super) fn found(&self, known: &Matrix6<f64>, slipped: &Vector3<f64>) -> bool {
        let ratio = |which: usize| {
            let at = 3 * which;
            let information = self.information.fixed_view::<3, 3>(at, at).into_owned();
            let score = self.score.fixed_rows::<3>(at).into_owned();
            let holds = known.fixed_view::<3, 3>(at, at).into_owned();
            let (turned_by, slips) =
                explained(&information, &score, &(holds + Matrix3::from_diagonal(slipped)))?;
            let (_, holds) = explained(&information, &score, &holds)?;
            (turned_by.norm() > LEAST_RAD).then_some(slips - holds)
        };
        [0, 1].into_iter().any(|which| ratio(which).is_some_and(|ratio| ratio > LIKELIER))
    }
}

/// The likeliest error under a prior, and the logarithm of the likelihood of what is seen, over that of no error.
fn explained(
    information: &Matrix3<f64>,
    score: &Vector3<f64>,
    prior: &Matrix3<f64>,
) -> Option<(Vector3<f64>, f64)> {
    let posterior = (information + prior.try_inverse()?).try_inverse()?;
    let error = posterior * score;
    let spread = (Matrix3::identity() + information * prior).determinant();
    Some((error, 0.5 * (score.dot(&error) - libm::log(spread))))
}

/// A sensor must be so much likelier to have held than the other, natural logarithm: a thousand to one.
const CERTAIN: f64 = 6.9;
/// 99 % of chi squared with 3 degrees of freedom: by more a mounting differs from what it was, if its strap has held.
const HELD_3: f64 = 11.3;

/// How both sensors sat, and how well that was known: rad², segment's axes.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Held {
    mounts: [UnitQuaternion<f64>; 2],
    known: [Matrix3<f64>; 2],
}

impl Held {
    pub(super) fn of(geometry: &LimbGeometry, p: &SMatrix<f64, PARAMETERS, PARAMETERS>) -> Self {
        let known = |which: Which| p.fixed_view::<3, 3>(mount(which), mount(which)).into_owned();
        Self {
            mounts: [geometry.upper_mount, geometry.lower_mount],
            known: [known(Which::Upper), known(Which::Lower)],
        }
    }

    /// The sensor that has held, if that is certain, what its mounting differs by from what it was, and how well that was known. Both were taken for slipped, so that the
    /// evidence for one that held is how likely its former mounting is by what is known of it now.
    pub(super) fn held(
        &self,
        geometry: &LimbGeometry,
        p: &SMatrix<f64, PARAMETERS, PARAMETERS>,
    ) -> Option<(Which, Vector3<f64>, Matrix3<f64>)> {
        let now = [geometry.upper_mount, geometry.lower_mount];
        let each = [Which::Upper, Which::Lower].map(|which| {
            let k = which as usize;
            let by = (self.mounts[k] * now[k].inverse()).scaled_axis();
            let spread = p.fixed_view::<3, 3>(mount(which), mount(which)) + self.known[k];
            let distance = by.dot(&(spread.try_inverse()? * by));
            Some((which, by, distance, -0.5 * (distance + libm::log(spread.determinant()))))
        });
        let [Some(upper), Some(lower)] = each else { return None };
        let ((which, by, distance, likelihood), other) =
            if upper.3 > lower.3 { (upper, lower) } else { (lower, upper) };
        (likelihood > other.3 + CERTAIN && distance < HELD_3).then_some((
            which,
            by,
            self.known[which as usize],
        ))
    }
}
