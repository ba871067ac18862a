//! Anchors: surveyed points that a sensor of the pole stood on, for absolute position and against a wrong spacing.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::Serialize;

use super::map::Aligned;
use super::noise::FieldNoise;
use super::pole::{PoleRun, median};

/// Fewest anchors that fix a rigid motion: three, and not on one line.
pub const LEAST_ANCHORS: usize = 3;
/// Standard deviation of a survey, per axis, m.
const SURVEY_SIGMA_M: f64 = 5e-4;
/// A scale that is wrong by less is no wrong spacing: a millimetre in 300 is 0.0033.
const LEAST_SCALE: f64 = 0.0018;

/// A surveyed point and the time during which a sensor of the pole stood on it. Its reading is the median over that
/// time.
#[derive(Clone, Debug, PartialEq)]
pub struct Anchor {
    /// Name, for messages.
    pub name: String,
    /// Index of the sensor along the pole, from 0.
    pub sensor: usize,
    /// First and last time of the stand, both included, s, on the clock of `PoleFrame::t_s`.
    pub t_s: [f64; 2],
    /// The surveyed point in the frame that the map shall have, m.
    pub position_m: Vector3<f64>,
}

/// An anchor and what the sensor read on it.
#[derive(Clone, Debug)]
pub(crate) struct Dwell {
    pub(crate) reading: Vector3<f64>,
    pub(crate) position_m: Vector3<f64>,
    /// Expected square of the error of the mean reading and the survey, per axis, m^2.
    pub(crate) variance_m2: f64,
}

/// Medians of the readings on each anchor; those without readings are left out.
pub(crate) fn dwells(run: &PoleRun, anchors: &[Anchor], noise: &FieldNoise) -> Vec<Dwell> {
    anchors
        .iter()
        .filter_map(|anchor| {
            let readings: Vec<Vector3<f64>> = run
                .frames
                .iter()
                .filter(|frame| (anchor.t_s[0]..=anchor.t_s[1]).contains(&frame.t_s))
                .filter_map(|frame| frame.readings.get(anchor.sensor)?.map(|reading| reading.position_m))
                .collect();
            let reading = Vector3::from_fn(|axis, _| {
                let mut values: Vec<f64> = readings.iter().map(|reading| reading[axis]).collect();
                median(&mut values).unwrap_or(f64::NAN)
            });
            let count = readings.len() as f64;
            // The variance of a median is pi/2 of that of a mean.
            let variance_m2 =
                noise.mean_square_m2(&reading) / 3.0 * 1.571 / count + SURVEY_SIGMA_M * SURVEY_SIGMA_M;
            reading.x.is_finite().then_some(Dwell { reading, position_m: anchor.position_m, variance_m2 })
        })
        .collect()
}

/// The rigid motion that takes the first point of each pair nearest to the second, in the least-squares sense (by
/// singular values; never a reflection). Points in m.
///
/// Without a unique answer it still gives one: fewer than three pairs, or pairs on a line, leave part of the rotation
/// free. The fit has no robust loss: one wrong pair bends it.
pub fn rigid(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Isometry3<f64> {
    let count = pairs.len().max(1) as f64;
    let from = pairs.iter().map(|(a, _)| a).sum::<Vector3<f64>>() / count;
    let to = pairs.iter().map(|(_, b)| b).sum::<Vector3<f64>>() / count;
    let spread = pairs.iter().fold(Matrix3::zeros(), |sum, (a, b)| sum + (b - to) * (a - from).transpose());
    let svd = spread.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Isometry3::identity() };
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Isometry3::from_parts(Translation3::from(to - rotation * from), rotation)
}

/// What the anchors say of a map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Verdict {
    /// The rigid motion to add, where the anchors clearly ask for one.
    pub(crate) alignment: Aligned,
    /// Rms distance of the corrected readings from the surveyed points after it, m.
    pub(crate) rms_m: f64,
    /// Longer by this share than surveyed, where the survey is that exact.
    pub(crate) scale_error: Option<f64>,
}

/// Compares corrected readings with surveyed points. `sigma_m`: how well the map itself is known, 3-D rms.
///
/// A map made of metal knows where the transmitter is, and needs no alignment unless the anchors contradict it.
pub(crate) fn judge(
    dwells: &[Dwell],
    corrected: &[Vector3<f64>],
    sigma_m: f64,
    absolute: bool,
) -> Option<Verdict> {
    if dwells.len() < LEAST_ANCHORS || !spread_out(dwells) {
        return None;
    }
    let pairs: Vec<_> = corrected.iter().copied().zip(dwells.iter().map(|dwell| dwell.position_m)).collect();
    let survey_m2 = dwells.iter().map(|dwell| dwell.variance_m2).sum::<f64>() / dwells.len() as f64;
    let variance = survey_m2 + sigma_m * sigma_m / 3.0;
    let square = |motion: &Isometry3<f64>| {
        pairs
            .iter()
            .map(|(a, b)| ((motion.rotation * a + motion.translation.vector) - b).norm_squared())
            .sum::<f64>()
    };
    let still = Isometry3::identity();
    let numbers = 3.0 * dwells.len() as f64;
    let agrees = square(&still) / variance < numbers + 3.0 * (2.0 * numbers).sqrt();
    let motion = if absolute && agrees { still } else { rigid(&pairs) };
    let surveyed_m2 = spread_m2(dwells.iter().map(|dwell| dwell.position_m));
    let scale = (spread_m2(corrected.iter().copied()) / surveyed_m2).sqrt() - 1.0;
    // How well the map is known does not matter here: one whose lengths are not those of the survey is wrong, and the nearest
    // cause is the spacing. A wrong one also makes a map unsure of places, where it still knows lengths.
    let sigma = (survey_m2 / surveyed_m2).sqrt();
    Some(Verdict {
        alignment: Aligned::from(&motion),
        rms_m: (square(&motion) / dwells.len() as f64).sqrt(),
        scale_error: (scale.abs() > LEAST_SCALE.max(3.0 * sigma)).then_some(scale),
    })
}

/// Sum of the squared distances of points from their middle, m^2.
fn spread_m2(points: impl ExactSizeIterator<Item = Vector3<f64>> + Clone) -> f64 {
    let middle = points.clone().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    points.map(|point| (point - middle).norm_squared()).sum()
}

/// Whether the points span a plane well enough to fix a rotation.
fn spread_out(dwells: &[Dwell]) -> bool {
    let middle = dwells.iter().map(|dwell| dwell.position_m).sum::<Vector3<f64>>() / dwells.len() as f64;
    let mut spread = Matrix3::zeros();
    for dwell in dwells {
        spread += (dwell.position_m - middle) * (dwell.position_m - middle).transpose();
    }
    let mut values = spread.symmetric_eigenvalues();
    values.as_mut_slice().sort_by(f64::total_cmp);
    values[1] > 0.01
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dwells(scale: f64) -> (Vec<Dwell>, Vec<Vector3<f64>>) {
        let positions_m =
            [Vector3::new(1.0, -0.6, 0.4), Vector3::new(1.9, 0.5, 0.5), Vector3::new(1.2, 0.4, 1.3)];
        let dwell = |position_m: Vector3<f64>| Dwell { reading: position_m, position_m, variance_m2: 1e-7 };
        (positions_m.map(dwell).to_vec(), positions_m.map(|position_m| position_m * scale).to_vec())
    }

    #[test]
    fn a_rigid_motion_is_found() {
        let motion = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.2, 0.1, -0.3));
        let (dwells, positions_m) = dwells(1.0);
        let moved: Vec<_> = positions_m
            .iter()
            .map(|p| motion.inverse_transform_vector(&(p - motion.translation.vector)))
            .collect();
        let verdict = judge(&dwells, &moved, 1e-3, false).unwrap();
        assert!(verdict.rms_m < 1e-9 && verdict.scale_error.is_none());
        assert!((verdict.alignment.apply(&moved[0]) - positions_m[0]).norm() < 1e-9);
    }

    #[test]
    fn a_millimetre_in_300_shows() {
        let (dwells, positions_m) = dwells(301.0 / 300.0);
        let error = judge(&dwells, &positions_m, 5e-4, false).unwrap().scale_error.unwrap();
        assert!((error - 1.0 / 300.0).abs() < 1e-6);
    }

    #[test]
    fn points_on_a_line_fix_nothing() {
        let (mut dwells, positions_m) = dwells(1.0);
        for (k, dwell) in dwells.iter_mut().enumerate() {
            dwell.position_m = Vector3::x() * (1.0 + k as f64);
        }
        assert!(judge(&dwells, &positions_m, 1e-3, false).is_none());
    }
}
