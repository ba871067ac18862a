//! The paper's network: x, y, z and their squares, five sigmoid nodes, three linear outputs; 53 numbers, trained by
//! Levenberg-Marquardt.

use nalgebra::{DMatrix, DVector, Vector3};
use serde::{Deserialize, Serialize};

const INPUTS: usize = 6;
const HIDDEN: usize = 5;
const PARAMETERS: usize = HIDDEN * (INPUTS + 1) + 3 * (HIDDEN + 1);

/// A network from measured to corrected positions, both in the transmitter frame, m. Outside the readings that it was trained on
/// it extrapolates. As a file it is refused where it does not have 53 finite numbers, or its scale is not above 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct DistortionNetwork {
    center_m: Vector3<f64>,
    scale_m: f64,
    weights: DVector<f64>,
}

/// A network as a file has it.
#[derive(Serialize, Deserialize)]
struct Parts {
    center_m: [f64; 3],
    scale_m: f64,
    /// Of each hidden node six inputs and its bias, of each output five hidden nodes and its bias.
    weights: Vec<f64>,
}

impl From<DistortionNetwork> for Parts {
    fn from(network: DistortionNetwork) -> Self {
        let weights = network.weights.as_slice().to_vec();
        Self { center_m: network.center_m.into(), scale_m: network.scale_m, weights }
    }
}

impl TryFrom<Parts> for DistortionNetwork {
    type Error = String;

    fn try_from(parts: Parts) -> Result<Self, String> {
        let numbers = parts.weights.iter().chain(&parts.center_m);
        let usable =
            parts.scale_m.is_finite() && parts.scale_m > 0.0 && numbers.clone().all(|n| n.is_finite());
        if parts.weights.len() != PARAMETERS || !usable {
            return Err(format!("a network of {PARAMETERS} finite numbers is expected, and a scale above 0"));
        }
        let weights = DVector::from_vec(parts.weights);
        Ok(Self { center_m: parts.center_m.into(), scale_m: parts.scale_m, weights })
    }
}

impl DistortionNetwork {
    /// An untrained network, which corrects nothing: the identity, scaled to the box of these readings. `pairs` as for
    /// [`DistortionNetwork::train`], of which it takes the readings alone; `None` without any. No randomness.
    pub fn new(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Self> {
        let (first, _) = pairs.first()?;
        let (mut low, mut high) = (*first, *first);
        for (z, _) in pairs {
            low = low.inf(z);
            high = high.sup(z);
        }
        // Small weights, all different, the same on every machine.
        let golden = 0.618_033_988_749_895;
        let mut weights = DVector::from_fn(PARAMETERS, |k, _| 1.2 * ((golden * (k + 1) as f64) % 1.0 - 0.5));
        // Outputs start at nothing: the network adds to the reading.
        weights.rows_mut(HIDDEN * (INPUTS + 1), 3 * (HIDDEN + 1)).fill(0.0);
        Some(Self { center_m: (low + high) / 2.0, scale_m: (0.5 * (high - low).max()).max(0.05), weights })
    }

    fn inputs(&self, z: &Vector3<f64>) -> [f64; INPUTS] {
        let x = (z - self.center_m) / self.scale_m;
        [x.x, x.y, x.z, x.x * x.x, x.y * x.y, x.z * x.z]
    }

    fn hidden(&self, inputs: &[f64; INPUTS]) -> [f64; HIDDEN] {
        std::array::from_fn(|node| {
            let row = &self.weights.as_slice()[node * (INPUTS + 1)..][..INPUTS + 1];
            let sum = row[INPUTS] + inputs.iter().zip(row).map(|(a, b)| a * b).sum::<f64>();
            1.0 / (1.0 + libm::exp(-sum))
        })
    }

    fn output(&self, hidden: &[f64; HIDDEN]) -> Vector3<f64> {
        let weights = &self.weights.as_slice()[HIDDEN * (INPUTS + 1)..];
        Vector3::from_fn(|axis, _| {
            let row = &weights[axis * (HIDDEN + 1)..][..HIDDEN + 1];
            row[HIDDEN] + hidden.iter().zip(row).map(|(a, b)| a * b).sum::<f64>()
        })
    }

    /// The corrected position of a measured one, transmitter frame, m.
    pub fn correct(&self, z: &Vector3<f64>) -> Vector3<f64> {
        z + self.output(&self.hidden(&self.inputs(z))) * self.scale_m
    }

    /// Derivatives of the scaled output by all weights.
    fn derivatives(&self, inputs: &[f64; INPUTS], hidden: &[f64; HIDDEN]) -> DMatrix<f64> {
        let mut derivatives = DMatrix::zeros(PARAMETERS, 3);
        let start = HIDDEN * (INPUTS + 1);
        for axis in 0..3 {
            let row = start + axis * (HIDDEN + 1);
            for node in 0..HIDDEN {
                derivatives[(row + node, axis)] = hidden[node];
                let slope = self.weights[row + node] * hidden[node] * (1.0 - hidden[node]);
                for input in 0..INPUTS {
                    derivatives[(node * (INPUTS + 1) + input, axis)] = slope * inputs[input];
                }
                derivatives[(node * (INPUTS + 1) + INPUTS, axis)] = slope;
            }
            derivatives[(row + HIDDEN, axis)] = 1.0;
        }
        derivatives
    }

    fn square_m2(&self, pairs: &[(Vector3<f64>, Vector3<f64>)]) -> f64 {
        pairs.iter().map(|(z, p)| (self.correct(z) - p).norm_squared()).sum()
    }

    /// Trains on pairs of measured position and target (transmitter frame, m) by so many steps of Levenberg-Marquardt, on from
    /// where it stands; returns the rms distance that is left, 3-D, m, and 0 without pairs.
    pub fn train(&mut self, pairs: &[(Vector3<f64>, Vector3<f64>)], epochs: usize) -> f64 {
        let mut damping = 1e-3;
        let mut square = self.square_m2(pairs);
        for _ in 0..epochs {
            let mut normal = DMatrix::<f64>::identity(PARAMETERS, PARAMETERS) * 1e-9;
            let mut gradient = DVector::<f64>::zeros(PARAMETERS);
            for (z, p) in pairs {
                let inputs = self.inputs(z);
                let hidden = self.hidden(&inputs);
                let derivatives = self.derivatives(&inputs, &hidden);
                let error = (p - z) / self.scale_m - self.output(&hidden);
                normal.gemm(1.0, &derivatives, &derivatives.transpose(), 1.0);
                gradient.gemv(1.0, &derivatives, &error, 1.0);
            }
            for _ in 0..6 {
                let mut damped = normal.clone();
                for k in 0..PARAMETERS {
                    damped[(k, k)] *= 1.0 + damping;
                }
                let Some(solver) = damped.cholesky() else { break };
                let before = self.weights.clone();
                self.weights += solver.solve(&gradient);
                let next = self.square_m2(pairs);
                if next < square {
                    square = next;
                    damping *= 0.2;
                    break;
                }
                self.weights = before;
                damping *= 5.0;
            }
        }
        (square / pairs.len().max(1) as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs() -> Vec<(Vector3<f64>, Vector3<f64>)> {
        (0..300)
            .map(|k| {
                let k = f64::from(k);
                let z = Vector3::new(
                    1.0 + 0.5 * libm::sin(k),
                    0.6 * libm::cos(0.7 * k),
                    0.5 + 0.4 * libm::sin(1.3 * k),
                );
                (z, z * 1.02 + Vector3::new(0.0, 0.01 * z.x * z.x, 0.0))
            })
            .collect()
    }

    #[test]
    fn it_has_53_numbers_and_starts_as_the_identity() {
        assert_eq!(PARAMETERS, 53);
        let network = DistortionNetwork::new(&pairs()).unwrap();
        assert_eq!(network.correct(&Vector3::x()), Vector3::x());
        assert!(DistortionNetwork::new(&[]).is_none());
    }

    #[test]
    fn it_learns_a_smooth_map() {
        let pairs = pairs();
        let mut network = DistortionNetwork::new(&pairs).unwrap();
        let rms_m = network.train(&pairs, 40);
        assert!(rms_m < 5e-4, "{rms_m}");
    }

    #[test]
    fn derivatives_are_differences() {
        let pairs = pairs();
        let mut network = DistortionNetwork::new(&pairs).unwrap();
        network.train(&pairs, 3);
        let z = Vector3::new(1.2, 0.3, 0.7);
        let inputs = network.inputs(&z);
        let derivatives = network.derivatives(&inputs, &network.hidden(&inputs));
        for k in 0..PARAMETERS {
            let mut moved = [network.clone(), network.clone()];
            moved[0].weights[k] += 1e-6;
            moved[1].weights[k] -= 1e-6;
            let [plus, minus] = moved.map(|network| network.output(&network.hidden(&inputs)));
            let difference = (plus - minus) / 2e-6;
            assert!((derivatives.row(k).transpose() - difference).norm() < 1e-7);
        }
    }
}
