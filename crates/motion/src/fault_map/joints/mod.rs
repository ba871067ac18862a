//! Joints between sensors on one body: what neighbours say of each other by their orientations.
//!
//! Two sensors on neighbouring segments share a point, the joint: `p_a + R_a c_a = p_b + R_b c_b` with the lever arms `c` in the sensors'
//! own axes. What is left over shows a position that is pulled aside, elsewhere or mirrored, also where no distance between sensors does: orientations
//! stay as they are in either mirror of the transmitter. Learnt from a recording ([`learning`]): which pairs have a joint, and how well it holds. Found anew
//! in each session ([`lever`]): the lever arms, since sensors are worn anyhow. Decided in each frame ([`states`]): where each sensor is, all together.
//! What it never does: look at the future, or speak of lever arms that it does not know yet.

mod learning;
mod lever;
mod states;

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3, Vector6};
use posed_fusion::faults::Mirror;
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::frames::{Frame, Frames};
use super::memory::Point;
use super::side::Side;
pub(super) use learning::learn;
use lever::Lever;
use states::Costs;

/// A lever arm is known once what it predicts is known so well, m.
const KNOWN_M: f64 = 0.02;
/// What is left over is half of all that it can be for the map where it is so many standard deviations an axis.
const STRANGE: f64 = 4.0;
/// Who does not agree for so many frames, while no rule speaks against it, is worn in another way: the lever arms begin anew.
const STUBBORN_FRAMES: u32 = 600;

/// What a recording says of a pair of sensors whose segments share a joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
struct Joint {
    /// The sensor nearer to the root of the tree, and the other.
    a: usize,
    b: usize,
    /// Variance of what is left over, per axis, m²: skin and near noise; and what it grows by with the eighth power of each range (noise
    /// grows with the fourth), m² per m⁸.
    variance_m2: f64,
    variance_per_m8: f64,
}

impl Joint {
    /// Variance of what is left over, per axis, m².
    fn variance(&self, a: &Pose, b: &Pose) -> f64 {
        self.variance_m2 + self.variance_per_m8 * (far(a) + far(b))
    }
}

/// Eighth power of the range, m⁸.
fn far(pose: &Pose) -> f64 {
    pose.position.norm_squared().powi(4)
}

/// The joints of a set of sensors: a forest, each joint behind that of its nearer sensor; trees have three sensors at least, else nobody knows which of two is
/// wrong.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Plain)]
pub(super) struct Joints(Vec<Joint>);

/// Where a sensor is, and how it is turned.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Pose {
    position: Vector3<f64>,
    rotation: Matrix3<f64>,
}

impl Pose {
    fn of(frame: Frame<'_>, sensor: usize) -> Option<Self> {
        let q = frame.orientations_wxyz.get(4 * sensor..4 * sensor + 4)?;
        let p = &frame.positions_m[3 * sensor..3 * sensor + 3];
        let q = Quaternion::new(q[0], q[1], q[2], q[3]);
        let square = q.norm_squared();
        (square.is_finite() && square > 0.25 && p.iter().all(|value| value.is_finite())).then(|| Self {
            position: Vector3::new(p[0], p[1], p[2]),
            rotation: UnitQuaternion::from_quaternion(q).to_rotation_matrix().into_inner(),
        })
    }
}

/// What the joints take a sensor for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub(super) enum Place {
    /// Where it says.
    #[default]
    Here,
    /// Where its image is.
    Mirrored(Mirror),
    /// Neither.
    Elsewhere,
}

impl Place {
    const ALL: [Self; 4] =
        [Self::Here, Self::Mirrored(Mirror::Point), Self::Mirrored(Mirror::Vertical), Self::Elsewhere];

    /// On which side a sensor is there; nothing for one that is elsewhere.
    pub(super) fn side(self) -> Option<Side> {
        match self {
            Self::Here => Some(Side::CLEAN),
            Self::Mirrored(mirror) => Some(Side::CLEAN.through(mirror)),
            Self::Elsewhere => None,
        }
    }

    /// The place that a position stands for; nothing for one that stands for none.
    fn undo(self, p: Vector3<f64>) -> Option<Vector3<f64>> {
        Some(self.side()?.undo(p.into()).into())
    }
}

/// What is remembered from frame to frame, and room to work.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Limbs {
    levers: Vec<Lever>,
    /// Per sensor, where it is; none while no joint speaks of it.
    places: Vec<Option<Place>>,
    /// Per joint, what its sensors leave over of it, as they are measured; NaN while it does not speak.
    shares: Vec<f64>,
    /// Of the latest frame.
    poses: Vec<Option<Pose>>,
    costs: Costs,
}

impl Limbs {
    /// Where the joints say a sensor is in the latest frame, if they speak of it.
    pub(super) fn place(&self, sensor: usize) -> Option<Place> {
        self.places[sensor]
    }

    /// Per joint, what it leaves over in the latest frame with its sensors where they are measured, from 0 to 1: `d² / (d² + 16)` of `d` standard
    /// deviations an axis (the function of Geman and McClure 1987). NaN where nobody knows.
    pub(super) fn shares(&self) -> &[f64] {
        &self.shares
    }
}

/// Whether a share says that a sensor is not where it is measured.
pub(super) fn is_strange(share: f64) -> bool {
    share > 0.5
}

/// What the rules think of a sensor before the joints are asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Hint {
    /// It is here, on the clean side.
    Here(Point),
    /// It is wrong.
    Wrong,
    /// There is none.
    Missing,
}

impl Joints {
    /// Whether nothing is known.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether these are joints of so many sensors, as they are learnt.
    pub(super) fn fit(&self, sensors: usize) -> bool {
        let is_sane = |value: f64| value.is_finite() && value >= 0.0;
        let mut is_child = vec![false; sensors];
        self.0.iter().all(|joint| {
            joint.a < sensors
                && joint.b < sensors
                && joint.a != joint.b
                && joint.variance_m2 > 0.0
                && is_sane(joint.variance_m2)
                && is_sane(joint.variance_per_m8)
                && !std::mem::replace(&mut is_child[joint.b], true)
        }) && self.0.iter().enumerate().all(|(at, joint)| {
            // Parents first: so it is a forest.
            self.0[at..].iter().all(|later| later.b != joint.a)
        })
    }

    /// Nothing is known of how the sensors are worn.
    pub(super) fn limbs(&self, sensors: usize) -> Limbs {
        Limbs {
            levers: vec![Lever::unknown(); self.0.len()],
            places: vec![None; sensors],
            shares: vec![f64::NAN; self.0.len()],
            poses: vec![None; sensors],
            costs: Costs::new(sensors, self.0.len()),
        }
    }

    /// Decides where all sensors are in the next frame, and learns from it how they are worn.
    pub(super) fn follow(&self, limbs: &mut Limbs, frame: Frame<'_>, hint: impl Fn(usize) -> Hint) {
        self.decide(limbs, frame, &hint);
        self.learn(limbs, &hint);
    }

    /// Where all sensors of a recording are and what its joints leave over ([`Limbs::shares`]), frame by frame: for one whose own lever arms, joint by
    /// joint, these are.
    pub(super) fn in_hindsight(
        &self,
        arms: &[Vector6<f64>],
        frames: &Frames,
        hint: impl Fn(usize, usize) -> Hint,
    ) -> (Vec<Option<Place>>, Vec<f64>) {
        let sensors = frames.sensors.len();
        let mut limbs =
            Limbs { levers: arms.iter().copied().map(Lever::known).collect(), ..self.limbs(sensors) };
        let mut places = Vec::with_capacity(frames.len() * sensors);
        let mut shares = Vec::with_capacity(frames.len() * self.len());
        for k in 0..frames.len() {
            self.decide(&mut limbs, frames.frame(k), &|sensor| hint(k, sensor));
            places.extend(&limbs.places);
            shares.extend(&limbs.shares);
        }
        (places, shares)
    }

    fn decide(&self, limbs: &mut Limbs, frame: Frame<'_>, hint: &impl Fn(usize) -> Hint) {
        let Limbs { levers, places, shares, poses, costs } = limbs;
        for (sensor, pose) in poses.iter_mut().enumerate() {
            *pose = Pose::of(frame, sensor);
        }
        costs.begin(places, hint);
        shares.fill(f64::NAN);
        for (at, (joint, lever)) in self.0.iter().zip(levers.iter()).enumerate() {
            let Some((a, b)) = poses[joint.a].zip(poses[joint.b]) else { continue };
            let spread = lever.spread(&a, &b);
            if spread.trace() < 3.0 * KNOWN_M * KNOWN_M {
                let scatter = spread + Matrix3::identity() * joint.variance(&a, &b);
                let square =
                    costs.join(at, (joint.a, &a), (joint.b, &b), &lever.offset(&a, &b), &scatter) / 3.0;
                shares[at] = square / (square + STRANGE * STRANGE);
            }
        }
        costs.decide(&self.0, places);
    }

    fn learn(&self, limbs: &mut Limbs, hint: &impl Fn(usize) -> Hint) {
        let Limbs { levers, places, poses, .. } = limbs;
        for (joint, lever) in self.0.iter().zip(levers.iter_mut()) {
            let Some((mut a, mut b)) = poses[joint.a].zip(poses[joint.b]) else { continue };
            let at = |sensor: usize, p| match (places[sensor], hint(sensor)) {
                (Some(place), _) => place.undo(p),
                (None, Hint::Here(here)) => Some(here.into()),
                (None, _) => None,
            };
            let is_wrong = |sensor| hint(sensor) == Hint::Wrong;
            match at(joint.a, a.position).zip(at(joint.b, b.position)) {
                Some(positions) => {
                    let variance = joint.variance(&a, &b);
                    (a.position, b.position) = positions;
                    lever.learn(&a, &b, variance);
                }
                None if is_wrong(joint.a) || is_wrong(joint.b) => {}
                None => lever.doubt(),
            }
        }
    }
}

#[cfg(test)]
mod tests;
