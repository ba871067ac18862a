//! A field map: a calibration, as its file holds it.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::grid::Shape;
use super::hull::Hull;
use super::model::{Model, Polynomial};
use super::noise::FieldNoise;
use super::report::Report;
use posed_geometry::{orientation_from_wxyz, orientation_to_wxyz};

/// Version of the map file; files of another version are refused.
pub const VERSION: u32 = 1;
/// Distance of the nodes of the grid of uncertainty, m.
const COARSE_STEP_M: f64 = 0.25;
/// Most sources and bumps: each costs time at every node, and beside metal at every reading. A solution has 10 and 60 at most.
const MOST_SOURCES: usize = 64;
const MOST_BUMPS: usize = 256;
/// Farther outside the hull than a model holds, the correction fades to its value at the hull over this, m.
pub(crate) const FADE_M: f64 = 0.2;

/// A rigid motion in a file: rotates, then translates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Aligned {
    /// Translation, m.
    pub position_m: [f64; 3],
    /// Rotation as a unit quaternion, scalar first. No unit quaternion counts as no rotation.
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
    pub(crate) fn rotation(&self) -> UnitQuaternion<f64> {
        orientation_from_wxyz(self.orientation_wxyz).unwrap_or_else(UnitQuaternion::identity)
    }

    /// Moves a point: `rotation * p + position_m`, m.
    pub fn apply(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.rotation() * p + Vector3::from(self.position_m)
    }
}

/// A calibration of the field, as its file holds it; `FieldMap::corrector` makes it ready to use.
///
/// Check `report.accepted` before use: a refused map is kept so that it can be looked at. Method:
/// `docs/methods/field.md`; accuracy: `docs/field.md`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldMap {
    /// Version of the file, 1.
    pub version: u32,
    /// Names of the sensors it was calibrated with, in order along the pole; empty for a map from known positions.
    pub sensors: Vec<String>,
    /// Measured distance of neighbouring sensors of the pole, m; 0 for a map without a pole.
    pub spacing_m: f64,
    /// Correction of positions, transmitter frame, before the alignment.
    pub model: Model,
    /// Rotation vector (rad) that corrects orientations beside what the metal of the model does to them; absent where
    /// the pole did not show one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<Polynomial>,
    /// Noise of the readings, as estimated from the recording.
    pub noise: FieldNoise,
    /// Rigid motion after the correction, from anchors: transmitter frame to that of the survey. Identity without
    /// anchors.
    pub alignment: Aligned,
    /// Where the pole has been, in raw readings, transmitter frame.
    pub hull: Hull,
    /// Error that the map leaves, on a coarse grid, tracker noise not included.
    pub uncertainty: Uncertainty,
    /// What was found, and how good it is.
    pub report: Report,
}

/// Uncertainty of a map on a grid of readings, transmitter frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// Where the nodes are.
    pub shape: Shape,
    /// Standard deviation of a corrected position at each node, 3-D rms, m; x runs fastest.
    pub sigma_m: Vec<f64>,
}

/// The grid of uncertainty for a hull.
pub(crate) fn coarse(hull: &Hull) -> Shape {
    Shape::around(&hull.bounds_m(), FADE_M, COARSE_STEP_M)
}

impl FieldMap {
    /// Takes the contents of a map file (JSON) and checks them. A map that was refused is read as well.
    ///
    /// # Errors
    /// A phrase that follows the name of the file: it is no field map, is of another version, or its numbers do not fit
    /// together.
    pub fn from_json(text: &[u8]) -> Result<Self, String> {
        let map: Self = serde_json::from_slice(text).map_err(|error| format!("is no field map: {error}"))?;
        if map.version != VERSION {
            let found = map.version;
            return Err(format!("is of version {found}; this program reads {VERSION}"));
        }
        map.check().map_err(|reason| format!("is no field map: {reason}"))?;
        Ok(map)
    }

    /// Whether the numbers of a map fit together: sizes of grids, polynomials and bumps, and a hull below 100 m. It
    /// does not judge how good the map is.
    ///
    /// # Errors
    /// A phrase that says what does not fit.
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
        let bumps = self.model.local.as_ref().map_or(0, |local| local.centers_m.len());
        if self.model.sources.len() > MOST_SOURCES || bumps > MOST_BUMPS {
            return Err(format!("a map has {MOST_SOURCES} sources and {MOST_BUMPS} bumps at most"));
        }
        if let Some(local) = &self.model.local
            && local.centers_m.len() != local.coefficients.len()
        {
            return Err("the bumps have another number of coefficients".into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit_known;
    use crate::model::local::Local;

    #[test]
    fn a_map_of_more_parts_than_anybody_solves_is_refused() {
        let pairs: Vec<_> = (0..300)
            .map(|k| {
                let place = |n: usize| (k * n % 31) as f64 / 15.0 - 1.0;
                let p = Vector3::new(place(1), place(7), place(12)) * 0.5;
                (p * 1.03, p)
            })
            .filter(|(z, _)| z.norm() > 0.1)
            .collect();
        let map = fit_known(&pairs, FieldNoise { sigma_signal: 1e-5, floor_m: 3e-4 }).unwrap();
        assert_eq!(map.check(), Ok(()));
        let mut bumpy = map.clone();
        let mut with = |bumps: usize| {
            let points = vec![[0.0; 3]; bumps];
            let local =
                Local { length_m: 0.4, sigma_m: 0.01, centers_m: points.clone(), coefficients: points };
            bumpy.model.local = Some(local);
            bumpy.check()
        };
        assert_eq!(with(MOST_BUMPS), Ok(()));
        assert!(with(MOST_BUMPS + 1).is_err());
    }
}
