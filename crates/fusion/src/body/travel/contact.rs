//! Whether a point of a foot stands.
//!
//! In: how fast the point goes, its acceleration, and how fast its foot turns. Out: how likely it stands, 0 to 1. A hidden Markov model of two states: all vectors are
//! normal about zero, narrow where the point stands and wide where it does not. It knows no floor: what does not move stands.

use nalgebra::Vector3;
use posed_state::Plain;

/// How fast and with which acceleration a point of a foot moves that stands, and one that does not, root mean square of an axis, m/s, m/s².
/// One that stands plays with skin and shoe.
const SPEED_M_S: [f64; 2] = [0.06, 1.0];
const ACCEL_M_S2: [f64; 2] = [0.8, 8.0];
/// A foot that stands lies still or rolls, as often as not. How fast one turns that lies still (in its shoe), and one that does not, root mean square of an axis, rad/s; and
/// with which acceleration the point moves of one that rolls: somebody who runs stands for 0.2 s, and within half of that a foot of 1 m/s comes to rest and leaves.
const STILL: f64 = 0.5;
const TURNS_RAD_S: [f64; 2] = [0.2, 3.0];
const ROLLS_M_S2: f64 = 5.0;
/// So seldom the body's velocity is wrong by anything. It bounds how much a speed speaks against a foot whose own sensor shows that it lies still: so who slid on both
/// feet, or whose contacts were missed, is found again.
const LOST: f64 = 0.003;
/// For so long evidence says the same again, s; and no more than this at a time, natural logarithm.
const CORRELATED_S: f64 = 0.03;
const MOST: f64 = 4.0;
/// A point stands that is likelier to stand than this.
const STANDS: f64 = 0.5;
/// For so long a foot stands, and is off the floor, s: the means.
const STANDS_S: f64 = 0.6;
const SWINGS_S: f64 = 0.4;

/// One point of a foot: its heel, its ball, or the ankle of a foot that wears no sensor.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Contact {
    /// How likely it stands, 0 to 1.
    pub probability: f64,
    /// As far as this time alone shows: one that has just left its place still counts as standing.
    pub now: f64,
    /// For how long it has stood, s, and before this time.
    pub stood_s: f64,
    pub before_s: f64,
    /// Where it was seen last, from the pelvis's sensor, m; `None` where it was not.
    pub last_m: Option<Vector3<f64>>,
}

impl Contact {
    /// Of which nothing is known.
    pub(super) const UNKNOWN: Self =
        Self { probability: 0.5, now: 0.5, stood_s: 0.0, before_s: 0.0, last_m: None };

    /// Takes what is seen after `dt_s`: how fast it goes, m/s, with the variance that this is known to, m²/s², its acceleration, m/s², and how fast its foot turns, rad/s.
    pub(super) fn push(
        &mut self,
        speed_m_s: Option<(Vector3<f64>, f64)>,
        accel_m_s2: Option<Vector3<f64>>,
        turns_rad_s: Option<Vector3<f64>>,
        dt_s: f64,
    ) {
        let mut evidence = 0.0;
        if let Some((speed_m_s, variance_m2_s2)) = speed_m_s {
            let known = likelier(speed_m_s.norm_squared(), SPEED_M_S, variance_m2_s2);
            evidence += either(LOST, 0.0, known);
        }
        let (mut still, mut rolls) = (0.0, 0.0);
        if let Some(accel_m_s2) = accel_m_s2 {
            let [_, moves] = ACCEL_M_S2;
            still += likelier(accel_m_s2.norm_squared(), ACCEL_M_S2, 0.0);
            rolls += likelier(accel_m_s2.norm_squared(), [ROLLS_M_S2, moves], 0.0);
        }
        if let Some(turns_rad_s) = turns_rad_s {
            still += likelier(turns_rad_s.norm_squared(), TURNS_RAD_S, 0.0);
        }
        // A foot of which nobody knows how it turns has to lie still: its ankle lifts as soon as it rolls.
        evidence += if turns_rad_s.is_some() { either(STILL, still, rolls) } else { still };
        let evidence = evidence.clamp(-MOST, MOST);
        self.now = 1.0 / (1.0 + libm::exp(-evidence));
        let evidence = evidence * (dt_s / CORRELATED_S).min(1.0);
        let before = self.probability;
        let stood =
            before + (dt_s / SWINGS_S).min(0.5) * (1.0 - before) - (dt_s / STANDS_S).min(0.5) * before;
        let odds = stood / (1.0 - stood) * libm::exp(evidence);
        self.probability = odds / (1.0 + odds);
        self.before_s = self.stood_s;
        self.stood_s = match (self.stands(), before > STANDS) {
            (false, _) => 0.0,
            (true, false) => dt_s,
            (true, true) => self.stood_s + dt_s,
        };
    }

    pub(super) fn stands(&self) -> bool {
        self.probability > STANDS
    }
}

/// Of two ways, of which the first has this share: how likely both together are, all as natural logarithms.
fn either(share: f64, first: f64, second: f64) -> f64 {
    let most = first.max(second);
    most + libm::log(share * libm::exp(first - most) + (1.0 - share) * libm::exp(second - most))
}

/// By how much likelier a vector of this squared length is in what stands than in what does not, natural logarithm; `known` is the variance of
/// an axis that both have beside their own.
fn likelier(squared: f64, sigmas: [f64; 2], known: f64) -> f64 {
    let [stands, moves] = sigmas.map(|sigma| sigma * sigma + known);
    1.5 * libm::log(moves / stands) - 0.5 * squared * (1.0 / stands - 1.0 / moves)
}
