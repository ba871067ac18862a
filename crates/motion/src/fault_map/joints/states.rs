//! Where all sensors are in a frame: the likeliest places of all of them together.
//!
//! What comes in: what the joints leave over for each pair of places, and the places of the frame before. What goes out: a place for each sensor of which a joint
//! speaks. Places of least cost on a forest are found exactly, from the leaves to the roots and back (min-sum; Pearl 1988).

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};
use posed_state::Plain;

use super::{Hint, Joint, Place, Pose};

const PLACES: usize = Place::ALL.len();
/// Costs are negative logarithms of likelihoods; a position elsewhere is anywhere in a cubic metre, which costs nothing.
/// A sensor in a mirror, or elsewhere, in any frame; one that was not there before; one that the rules find wrong, here or in a mirror.
const MIRRORED: f64 = 3.0;
const ELSEWHERE: f64 = 4.0;
const CHANGE: f64 = 3.0;
const AGAINST_RULES: f64 = 3.0;

/// Room to work.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Costs {
    /// By sensor: of each place, with all that hangs on it.
    sensors: Vec<[f64; PLACES]>,
    is_spoken_of: Vec<bool>,
    /// By joint: of each place of its nearer sensor and each of the other; whether it speaks.
    joints: Vec<[[f64; PLACES]; PLACES]>,
    speaks: Vec<bool>,
}

impl Costs {
    pub(super) fn new(sensors: usize, joints: usize) -> Self {
        Self {
            sensors: vec![[0.0; PLACES]; sensors],
            is_spoken_of: vec![false; sensors],
            joints: vec![[[0.0; PLACES]; PLACES]; joints],
            speaks: vec![false; joints],
        }
    }

    /// A frame in which no joint has spoken yet.
    pub(super) fn begin(&mut self, before: &[Option<Place>], hint: impl Fn(usize) -> Hint) {
        self.speaks.fill(false);
        self.is_spoken_of.fill(false);
        for (sensor, (costs, before)) in self.sensors.iter_mut().zip(before).enumerate() {
            let is_wrong = hint(sensor) == Hint::Wrong;
            for (cost, place) in costs.iter_mut().zip(Place::ALL) {
                let by_itself = match place {
                    Place::Here => 0.0,
                    Place::Mirrored(_) => MIRRORED,
                    Place::Elsewhere => ELSEWHERE,
                };
                let change = if before.unwrap_or_default() == place { 0.0 } else { CHANGE };
                let against = if is_wrong && place != Place::Elsewhere { AGAINST_RULES } else { 0.0 };
                *cost = by_itself + change + against;
            }
        }
    }

    /// What a joint says: `offset` is to be added to the difference of positions, `scatter` is the covariance of what is left over, m². Returns the
    /// squared distance of Mahalanobis of the positions as they are measured, NaN where `scatter` is none.
    pub(super) fn join(
        &mut self,
        joint: usize,
        (sensor_a, a): (usize, &Pose),
        (sensor_b, b): (usize, &Pose),
        offset: &Vector3<f64>,
        scatter: &Matrix3<f64>,
    ) -> f64 {
        let Some(inverse) = scatter.try_inverse() else { return f64::NAN };
        let squared = |a: Vector3<f64>, b: Vector3<f64>| {
            let left_over = a - b + offset;
            left_over.dot(&(inverse * left_over))
        };
        let density = 0.5 * libm::log(scatter.determinant() * TAU.powi(3));
        for (row, place_a) in self.joints[joint].iter_mut().zip(Place::ALL) {
            for (cost, place_b) in row.iter_mut().zip(Place::ALL) {
                let positions = place_a.undo(a.position).zip(place_b.undo(b.position));
                *cost = positions.map_or(0.0, |(a, b)| 0.5 * squared(a, b) + density);
            }
        }
        self.speaks[joint] = true;
        self.is_spoken_of[sensor_a] = true;
        self.is_spoken_of[sensor_b] = true;
        squared(a.position, b.position)
    }

    /// The places of least cost; each joint stands behind that of its nearer sensor.
    pub(super) fn decide(&mut self, joints: &[Joint], places: &mut [Option<Place>]) {
        for (at, joint) in joints.iter().enumerate().rev() {
            if self.speaks[at] {
                let below = self.sensors[joint.b];
                for (row, cost) in self.joints[at].iter().zip(&mut self.sensors[joint.a]) {
                    *cost += least(row, &below).1;
                }
            }
        }
        let nothing = [0.0; PLACES];
        for (sensor, place) in places.iter_mut().enumerate() {
            let best = least(&self.sensors[sensor], &nothing).0;
            *place = self.is_spoken_of[sensor].then(|| Place::ALL[best]);
        }
        for (at, joint) in joints.iter().enumerate() {
            if let (true, Some(place)) = (self.speaks[at], places[joint.a]) {
                let row = Place::ALL.iter().position(|other| *other == place).unwrap_or_default();
                places[joint.b] = Some(Place::ALL[least(&self.joints[at][row], &self.sensors[joint.b]).0]);
            }
        }
    }
}

/// Where the sum of two rows is least, and what it is there.
fn least(a: &[f64; PLACES], b: &[f64; PLACES]) -> (usize, f64) {
    let sums: [f64; PLACES] = std::array::from_fn(|k| a[k] + b[k]);
    (1..PLACES).fold((0, sums[0]), |best, k| if sums[k] < best.1 { (k, sums[k]) } else { best })
}
