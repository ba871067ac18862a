//! A field map: the file of a calibration, and the fast form that corrects poses.
//!
//! What comes in: a pose as measured, in the transmitter frame. What goes out: the pose corrected, how far it may be
//! off, and whether it lies outside of what was calibrated. No delay, no state, no allocation.

use std::path::Path;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::grid::{Grid, Shape};
use super::hull::Hull;
use super::model::metal::Metal;
use super::model::{Model, Polynomial};
use super::noise::FieldNoise;
use super::orientation::by_metal;
use super::report::Report;
use super::trust;
use crate::geometry::{orientation_from_wxyz, orientation_to_wxyz, so3};

/// Version of the file.
pub const VERSION: u32 = 1;
/// Nodes of the grid of corrections, m apart, and of the uncertainty.
const STEP_M: f64 = 0.08;
const COARSE_STEP_M: f64 = 0.25;
/// Where the grid is off the model by more than this, beside metal, it gets patches, and where these are too the model
/// itself is asked: m, and share of the noise.
const ROUGH_M: f64 = 1e-4;
const ROUGH_SHARE: f64 = 0.04;
/// Outside the hull a model still holds for this, m, farther if it is of metal alone; then the correction fades to its
/// value at the hull over the next.
const KEEP_M: f64 = 0.1;
const KEEP_METAL_M: f64 = 0.3;
const FADE_M: f64 = 0.2;

/// A rigid motion in a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Aligned {
    /// Translation, m.
    pub position_m: [f64; 3],
    /// Rotation, scalar first.
    pub orientation_wxyz: [f64; 4],
}

impl Default for Aligned {
    fn default() -> Self {
        Self::from(&Isometry3::identity())
    }
}

impl From<&Isometry3<f64>> for Aligned {
    fn from(motion: &Isometry3<f64>) -> Self {
        Self {
            position_m: motion.translation.vector.into(),
            orientation_wxyz: orientation_to_wxyz(&motion.rotation),
        }
    }
}

impl Aligned {
    fn rotation(&self) -> UnitQuaternion<f64> {
        orientation_from_wxyz(self.orientation_wxyz).unwrap_or_else(UnitQuaternion::identity)
    }

    /// Moves a point.
    pub fn apply(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.rotation() * p + Vector3::from(self.position_m)
    }
}

/// A calibration, as its file holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldMap {
    /// Version of the file, 1.
    pub version: u32,
    /// Names of the sensors of the pole.
    pub sensors: Vec<String>,
    /// Measured distance between them, m.
    pub spacing_m: f64,
    /// Correction of positions, transmitter frame.
    pub model: Model,
    /// Rotation vector (rad) to add to what the metal of the model does to orientations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<Polynomial>,
    /// Noise of the readings.
    pub noise: FieldNoise,
    /// Rigid motion after the correction, from anchors.
    pub alignment: Aligned,
    /// Where the pole has been.
    pub hull: Hull,
    /// Standard deviation (3-D rms, m, tracker noise not included) of the correction on a coarse grid.
    pub uncertainty: Uncertainty,
    /// What was found, and how good it is.
    pub report: Report,
}

/// Uncertainty of a map on a grid, x fastest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// Where the nodes are.
    pub shape: Shape,
    /// 3-D rms at each node, m.
    pub sigma_m: Vec<f64>,
}

/// A corrected pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected {
    /// Position, m.
    pub position_m: Vector3<f64>,
    /// Expected rms 3-D error, tracker noise included, m; absolute with anchors or metal, else after rigid alignment.
    pub sigma_m: f64,
    /// What the map leaves of it, the tracker's own noise not included, 3-D rms, m.
    pub map_sigma_m: f64,
    /// Outside of what was calibrated, or where metal folds the field: two places give the same reading.
    pub extrapolated: bool,
}

/// A map ready to correct: everything on grids.
#[derive(Clone, Debug)]
pub struct Corrector {
    /// Correction and distance outside the hull.
    positions: Grid,
    /// Rotation vector, and 3-D rms of what a corrected position is off by, m.
    rotations: Grid,
    /// To ask where the grid is too coarse.
    model: Model,
    metal: Option<Metal>,
    alignment: Aligned,
    turn: UnitQuaternion<f64>,
    aligned: bool,
    keep_m: f64,
    noise: FieldNoise,
}

/// What is stated is a little less than the expected rms, so that two sigmas hold 90 to 99 % whatever the noise is
/// like: 97.3 % of a disc and 98.7 % of a ball, where the bare rms would hold 98.2 and 99.3 %.
const STATED: f64 = 0.95;
/// Where a corrected position may be farther off than this, nothing was calibrated, m.
const LARGEST_SIGMA_M: f64 = 0.05;

/// The grid of uncertainty for a hull.
pub(crate) fn coarse(hull: &Hull) -> Shape {
    Shape::around(&hull.bounds_m(), FADE_M, COARSE_STEP_M)
}

impl FieldMap {
    /// Reads a file.
    ///
    /// # Errors
    /// One sentence: it cannot be read, is no map, or is one of another version.
    pub fn read(path: &Path) -> Result<Self, String> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| format!("cannot read {}: {error}", path.display()))?;
        let map: Self = serde_json::from_str(&text)
            .map_err(|error| format!("{} is no field map: {error}", path.display()))?;
        if map.version != VERSION {
            let found = map.version;
            return Err(format!("{} is of version {found}; this program reads {VERSION}", path.display()));
        }
        map.check().map_err(|reason| format!("{} is no field map: {reason}", path.display()))?;
        Ok(map)
    }

    /// Whether the numbers of a file that was read fit together.
    ///
    /// # Errors
    /// What does not.
    pub fn check(&self) -> Result<(), String> {
        let Shape { low_m, step_m, counts } = &self.uncertainty.shape;
        let sound = low_m.iter().all(|x| x.is_finite())
            && step_m.is_finite()
            && *step_m > 0.0
            && counts.iter().all(|count| (4..=1000).contains(count));
        if !sound || self.uncertainty.sigma_m.len() != counts.iter().product::<usize>() {
            return Err("the grid of the uncertainty has another size".into());
        }
        if self.hull.reach_m.len() != super::hull::directions().count() {
            return Err("the hull has another number of directions".into());
        }
        let [low, high] = self.hull.bounds_m();
        if !(0..3).all(|axis| {
            (high[axis] - low[axis]).is_finite() && (0.0..100.0).contains(&(high[axis] - low[axis]))
        }) {
            return Err("the hull is no body of less than 100 m".into());
        }
        for polynomial in self.model.polynomial.iter().chain(&self.rotation) {
            polynomial.check()?;
        }
        if let Some(local) = &self.model.local
            && local.centers_m.len() != local.coefficients.len()
        {
            return Err("the bumps have another number of coefficients".into());
        }
        Ok(())
    }

    /// Makes the fast form.
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
        if metal.is_some() {
            // Farther outside nobody asks for a tenth of a millimetre.
            let tolerance = |z: &Vector3<f64>| {
                let rough_m = ROUGH_M.max(ROUGH_SHARE * self.noise.mean_square_m2(z).sqrt());
                (self.hull.outside_m(z) <= KEEP_M).then_some(rough_m)
            };
            positions.refine(tolerance, |z| {
                let change = correction(z);
                [change.x, change.y, change.z, self.hull.outside_m(z)]
            });
        }
        let sigma = trust::sigma(self, &positions, &shape, metal.as_ref());
        let rotations = Grid::by_index(shape, |index, z| {
            let z_in = self.hull.inward(z);
            let mut turn = UnitQuaternion::identity();
            if let Some(metal) = &metal {
                turn = by_metal(metal, &z_in, &(z_in + correction(&z_in)));
            }
            if let Some(rotation) = &self.rotation {
                turn = so3::exp(&rotation.at(&z_in)) * turn;
            }
            let turn = so3::log(&turn);
            [turn.x, turn.y, turn.z, sigma[index]]
        });
        let aligned = self.alignment != Aligned::default();
        let turn = self.alignment.rotation();
        let model = self.model.clone();
        Corrector {
            positions,
            rotations,
            model,
            metal,
            alignment: self.alignment,
            turn,
            aligned,
            keep_m,
            noise: self.noise,
        }
    }
}

impl Corrector {
    /// The corrected position before the alignment, and how far outside the hull the reading is, m.
    pub(crate) fn unaligned(&self, z: &Vector3<f64>) -> (Vector3<f64>, f64) {
        let ([x, y, w, outside], sound) = self.positions.fine(z);
        let p = z + Vector3::new(x, y, w);
        if !sound {
            return (self.model.answer_in(self.metal.as_ref(), z, Some(p)), outside);
        }
        (p, outside)
    }

    fn align(&self, p: Vector3<f64>) -> Vector3<f64> {
        if self.aligned { self.turn * p + Vector3::from(self.alignment.position_m) } else { p }
    }

    /// The corrected position alone.
    pub fn position(&self, z: &Vector3<f64>) -> Vector3<f64> {
        self.align(self.unaligned(z).0)
    }

    /// What a sensor at `p` would read: the inverse of [`Corrector::position`], m.
    ///
    /// A correction changes so little over its own length that three steps of its fixed point are enough.
    pub fn reading(&self, p: &Vector3<f64>) -> Vector3<f64> {
        let unaligned = if self.aligned {
            self.turn.inverse() * (p - Vector3::from(self.alignment.position_m))
        } else {
            *p
        };
        let mut z = unaligned;
        for _ in 0..3 {
            z -= self.unaligned(&z).0 - unaligned;
        }
        z
    }

    /// Corrects a position, and says how far to trust it.
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

    /// The corrected orientation of a sensor that reads `z` and `orientation` (sensor to transmitter).
    pub fn orientation(&self, z: &Vector3<f64>, orientation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        let [x, y, w, _] = self.rotations.trilinear(z);
        self.turn * so3::exp(&Vector3::new(x, y, w)) * orientation
    }
}
