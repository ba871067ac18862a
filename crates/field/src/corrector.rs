//! The fast form of a field map, which corrects poses.
//!
//! What comes in: a pose as measured, in the transmitter frame. What goes out: the pose corrected, how far it may be
//! off, and whether it lies outside of what was calibrated. No delay, no state, no allocation.

use nalgebra::{UnitQuaternion, Vector3};

use super::grid::{Grid, Shape};
use super::map::{Aligned, FADE_M, FieldMap};
use super::model::Model;
use super::model::metal::Metal;
use super::model::rotation::by_metal;
use super::noise::FieldNoise;
use super::trust;
use posed_geometry::so3;

/// Distance of the nodes of the grid of corrections, m.
const STEP_M: f64 = 0.08;
/// Where the grid is off the model by more than this, beside metal, it gets patches, and where these are too the model
/// itself is asked: m, and share of the noise.
const ROUGH_M: f64 = 1e-4;
const ROUGH_SHARE: f64 = 0.04;
/// Outside the hull a model still holds for this, m, farther if it is of metal alone.
const KEEP_M: f64 = 0.1;
const KEEP_METAL_M: f64 = 0.3;

/// A corrected position and how far to trust it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected {
    /// Corrected position, m, in the transmitter frame, or in that of the anchors where the map is aligned to them.
    pub position_m: Vector3<f64>,
    /// Expected rms 3-D error, tracker noise included, m; absolute with anchors or metal alone, else after rigid
    /// alignment. Twice this value is meant to hold 90 to 99 % of the errors; `docs/field.md` says how often it does.
    pub sigma_m: f64,
    /// What the map leaves of the distortion, the tracker's own noise not included, 3-D rms, m.
    pub map_sigma_m: f64,
    /// Unreliable: outside of what was calibrated, or `sigma_m` above 5 cm, as where metal folds the field and two
    /// places give the same reading.
    pub extrapolated: bool,
}

/// A field map ready to correct: positions, rotations and errors on grids of 8 cm, refined beside metal.
///
/// Immutable, without delay, without allocation per call. Outside the hull the model holds for 0.1 m (0.3 m if it is of
/// metal alone), then the correction fades to its value at the hull over 0.2 m. Method: `docs/methods/field.md`.
#[derive(Clone, Debug)]
pub struct Corrector {
    /// Correction and distance outside the hull.
    positions: Grid,
    /// Rotation vector, and 3-D rms of the error of a corrected position, m.
    rotations: Grid,
    /// To ask where the grid is too coarse.
    model: Model,
    metal: Option<Metal>,
    alignment: Aligned,
    rotation: UnitQuaternion<f64>,
    aligned: bool,
    keep_m: f64,
    noise: FieldNoise,
}

/// What is stated is a little less than the expected rms, so that two sigmas hold 90 to 99 % whatever the noise is
/// like: 97.3 % of a disc and 98.7 % of a ball, where the bare rms would hold 98.2 and 99.3 %.
const STATED: f64 = 0.95;
/// Where a corrected position may be farther off than this, nothing was calibrated, m.
const LARGEST_SIGMA_M: f64 = 0.05;

impl FieldMap {
    /// Makes the fast form. It takes a good part of a second: call it where time does not matter. `Prepared` does it
    /// once.
    pub fn corrector(&self) -> Corrector {
        let physical = self.model.polynomial.is_none() && self.model.local.is_none();
        let keep_m = if physical { KEEP_METAL_M } else { KEEP_M };
        let shape = Shape::around(&self.hull.bounds_m(), keep_m + FADE_M + STEP_M, STEP_M);
        let metal = self.model.metal();
        let correction = |z: &Vector3<f64>| self.model.answer_in(metal.as_ref(), z, None) - z;
        let mut positions = Grid::new(shape.clone(), |z| {
            let outside = self.hull.outside_m(z);
            let share = ((outside - keep_m) / FADE_M).clamp(0.0, 1.0);
            let share = share * share * (3.0 - 2.0 * share);
            let mut change = Vector3::zeros();
            if share > 0.0 {
                change += correction(&self.hull.inward(z)) * share;
            }
            if share < 1.0 {
                change += correction(z) * (1.0 - share);
            }
            [change.x, change.y, change.z, outside]
        });
        if let Some(metal) = &metal {
            // Farther outside nobody asks for a tenth of a millimetre.
            let tolerance = |z: &Vector3<f64>| {
                let rough_m = ROUGH_M.max(ROUGH_SHARE * self.noise.mean_square_m2(z).sqrt());
                (self.hull.outside_m(z) <= KEEP_M).then_some(rough_m)
            };
            positions.refine(tolerance, |z| {
                let change = self.model.plain_in(metal, z)? - z;
                Some([change.x, change.y, change.z, self.hull.outside_m(z)])
            });
        }
        let sigma = trust::sigma(self, &positions, &shape, metal.as_ref());
        let rotations = Grid::by_index(shape, |index, z| {
            let z_in = self.hull.inward(z);
            let mut q = UnitQuaternion::identity();
            if let Some(metal) = &metal {
                let position = looked_up(&positions, &self.model, Some(metal), &z_in).0;
                q = by_metal(metal, &z_in, &position);
            }
            if let Some(rotation) = &self.rotation {
                q = so3::exp(&rotation.at(&z_in)) * q;
            }
            let rotation_vector_rad = so3::log(&q);
            [rotation_vector_rad.x, rotation_vector_rad.y, rotation_vector_rad.z, sigma[index]]
        });
        let aligned = self.alignment != Aligned::default();
        let rotation = self.alignment.rotation();
        let model = self.model.clone();
        Corrector {
            positions,
            rotations,
            model,
            metal,
            alignment: self.alignment,
            rotation,
            aligned,
            keep_m,
            noise: self.noise,
        }
    }
}

/// The corrected position by the grid, and by the model where that is too coarse; and how far outside the hull the reading is, m.
fn looked_up(
    positions: &Grid,
    model: &Model,
    metal: Option<&Metal>,
    z: &Vector3<f64>,
) -> (Vector3<f64>, f64) {
    let ([x, y, w, outside], sound) = positions.fine(z);
    let p = z + Vector3::new(x, y, w);
    (if sound { p } else { model.answer_in(metal, z, Some(p)) }, outside)
}

impl Corrector {
    /// The corrected position before the alignment, and how far outside the hull the reading is, m.
    pub(crate) fn unaligned(&self, z: &Vector3<f64>) -> (Vector3<f64>, f64) {
        looked_up(&self.positions, &self.model, self.metal.as_ref(), z)
    }

    fn align(&self, p: Vector3<f64>) -> Vector3<f64> {
        if self.aligned { self.rotation * p + Vector3::from(self.alignment.position_m) } else { p }
    }

    /// The corrected position of a reading `z` (transmitter frame, m), as in `Corrected::position_m`, without its
    /// error. It answers anywhere, also far outside the hull: `Corrector::correct` says whether to believe it.
    pub fn position(&self, z: &Vector3<f64>) -> Vector3<f64> {
        self.align(self.unaligned(z).0)
    }

    /// What a sensor at the true position `p` would read, transmitter frame, m: the inverse of `Corrector::position`.
    ///
    /// A correction changes so little over its own length that three steps of its fixed point are enough. Where metal
    /// folds the field there are several answers, and this is one of them.
    pub fn reading(&self, p: &Vector3<f64>) -> Vector3<f64> {
        let unaligned = if self.aligned {
            self.rotation.inverse() * (p - Vector3::from(self.alignment.position_m))
        } else {
            *p
        };
        let mut z = unaligned;
        for _ in 0..3 {
            z -= self.unaligned(&z).0 - unaligned;
        }
        z
    }

    /// Corrects a reading `z` (transmitter frame, m), and returns how far to trust it. Constant time but beside strong
    /// metal, where the model itself is asked; no allocation. Accuracy and honesty of the error: `docs/field.md`.
    pub fn correct(&self, z: &Vector3<f64>) -> Corrected {
        let (unaligned, outside) = self.unaligned(z);
        let mut variance_m2 = self.rotations.trilinear(z)[3].powi(2);
        let noise_m2 = self.noise.mean_square_m2(z);
        let beyond = self.positions.beyond(z);
        let mut outside_m = outside;
        if beyond > 0.0 {
            outside_m = beyond + self.keep_m + FADE_M;
            variance_m2 += noise_m2;
        }
        // Outside nobody has looked: a tenth of the way is as good a guess as any.
        let guess = 0.1 * outside_m.max(0.0);
        let variance_m2 = variance_m2 + guess * guess;
        let sigma_m = STATED * variance_m2.sqrt();
        let map_sigma_m = (variance_m2 - noise_m2).max(0.0).sqrt();
        let extrapolated = outside_m > 0.0 || sigma_m > LARGEST_SIGMA_M;
        Corrected { position_m: self.align(unaligned), sigma_m, map_sigma_m, extrapolated }
    }

    /// The corrected orientation of a sensor that reads position `z` (transmitter frame, m) and `orientation` (sensor
    /// to transmitter): sensor to transmitter, or to the frame of the anchors. Outside the hull the rotation of the
    /// nearest point towards its middle is used. No error is stated; `docs/field.md` measures it.
    pub fn orientation(&self, z: &Vector3<f64>, orientation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        let [x, y, w, _] = self.rotations.trilinear(z);
        self.rotation * so3::exp(&Vector3::new(x, y, w)) * orientation
    }
}
