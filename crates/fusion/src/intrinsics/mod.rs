//! Intrinsics of one IMU: gyro bias, accelerometer bias and scale, magnetometer ellipsoid.
//!
//! In: a recording in which the unit was placed at rest in many directions (and turned between them). Out: what to
//! subtract and multiply, with its quality; or a refusal that states which directions are missing. It never guesses from
//! directions that were not held.
//!
//! At rest the specific force has the length of gravity whatever the direction: with six unknowns (bias and scale
//! of three axes) nine directions leave three to check with. The magnetometer's samples, of all the
//! recording, lie on an ellipsoid whose centre is the hard iron and whose shape is the soft iron; it is fitted as a quadric.

mod fit;
mod guide;
mod rests;

use nalgebra::{Matrix3, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use self::fit::{fit_ellipsoid, fit_gravity, gain};
pub use self::guide::{Ask, Guide, Progress};
pub use self::rests::SIDES;
use self::rests::{Directions, MIN_REST_S, Rest, RestFinder};
use super::ahrs::ImuSample;

/// Directions held at rest that it takes.
const MIN_DIRECTIONS: usize = 9;
/// From so many on, cross-axis terms are found too: nine unknowns, and three directions to check with.
const CROSS_DIRECTIONS: usize = 12;
/// Largest accepted residual of the specific force's length, m/s².
const MAX_RESIDUAL: f64 = 0.1;
/// Largest accepted residual of the field's length, as a part of it.
const MAX_FIELD_RESIDUAL: f64 = 0.05;
/// Numbers beyond these are no calibration: biases, rad/s and m/s²; scale, from its inverse to this.
const MOST_GYRO_BIAS_RAD_S: f64 = 1.0;
const MOST_ACCEL_BIAS_M_S2: f64 = 5.0;
const MOST_SCALE: f64 = 1.5;

/// What was found for one unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Intrinsics {
    /// The unit: its serial number, or the sensor's name where the device tells none; absent: the file's name specifies it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Subtract from the gyro, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
    /// Standard deviation of that bias between the rests, rad/s.
    pub gyro_bias_sigma_rad_s: f64,
    /// Subtract from the accelerometer, m/s²; then multiply by scale and cross-axis terms.
    pub accel_bias_m_s2: [f64; 3],
    /// Multiply the accelerometer, after subtracting the bias.
    pub accel_scale: [f64; 3],
    /// What each axis feels of another, beside the scale: yz, xz, xy of a symmetric matrix; zero from fewer than 12 directions.
    #[serde(default)]
    pub accel_cross: [f64; 3],
    /// Root mean square of the length's error over the rests, m/s².
    pub accel_residual_m_s2: f64,
    /// Directions that were held.
    pub directions: usize,
    /// The magnetometer's, where there is one.
    pub mag: Option<MagIntrinsics>,
}

/// Hard and soft iron: `m = matrix (raw - offset)` has the length `norm` in every direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MagIntrinsics {
    /// Hard iron, in the unit of the samples.
    pub offset: [f64; 3],
    /// Soft iron, row by row; symmetric, determinant 1.
    pub matrix: [[f64; 3]; 3],
    /// Length of the corrected field, in the unit of the samples.
    pub norm: f64,
    /// Root mean square of the length's error, as a part of the length.
    pub residual: f64,
}

/// Why a unit could not be calibrated.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum IntrinsicsError {
    /// Too few directions at rest.
    #[error(
        "only {found} directions were held at rest, it takes {needed}: place the unit on each of its six sides and on \
         some edges, {seconds:.0} s each"
    )]
    Directions {
        /// Directions there were.
        found: usize,
        /// Directions it takes.
        needed: usize,
        /// How long to hold each, s.
        seconds: f64,
    },
    /// The directions leave a side out.
    #[error("no rest with the unit's {missing} axis up: place it on that side too")]
    Side {
        /// The axis, with its sign.
        missing: &'static str,
    },
    /// The accelerometer does not fit.
    #[error(
        "the rests disagree by {found:.2} m/s² (limit {limit:.2}): hold the unit stiller, or it is broken"
    )]
    Residual {
        /// Root mean square, m/s².
        found: f64,
        /// Largest accepted, m/s².
        limit: f64,
    },
    /// The magnetometer's samples lie on no ellipsoid.
    #[error(
        "the magnetometer's samples show no ellipsoid: turn the unit through all directions, away from iron"
    )]
    Ellipsoid,
    /// The field does not have one length.
    #[error("the field's length varies by {:.0} % (limit {:.0} %): turn the unit farther away from iron", 100.0 * found, 100.0 * MAX_FIELD_RESIDUAL)]
    Field {
        /// Root mean square, as a part of the length.
        found: f64,
    },
}

impl Intrinsics {
    /// Corrects a sample: gyro bias, accelerometer bias, scale and cross-axis terms, hard and soft iron; sensor axes and the
    /// field's unit stay. The gyro's scale and the rotation between the three sensors are not known, and stay as they are.
    pub fn apply(&self, sample: &ImuSample) -> ImuSample {
        let accel = sample.accel_m_s2 - Vector3::from(self.accel_bias_m_s2);
        ImuSample {
            gyro_rad_s: sample.gyro_rad_s - Vector3::from(self.gyro_bias_rad_s),
            accel_m_s2: gain(&Vector3::from(self.accel_scale), &Vector3::from(self.accel_cross)) * accel,
            mag: sample.mag.map(|raw| self.mag.as_ref().map_or(raw, |mag| mag.apply(raw))),
        }
    }
}

impl Intrinsics {
    /// Takes the contents of a file of `posed imu calibrate` or `imu.calibrate` (JSON).
    ///
    /// # Errors
    /// A phrase: these are no intrinsics ([`Self::check`]).
    pub fn from_json(text: &[u8]) -> Result<Self, String> {
        let found: Self = serde_json::from_slice(text).map_err(|error| error.to_string())?;
        found.check()?;
        Ok(found)
    }

    /// Whether the numbers can be those of a unit: biases up to 1 rad/s and 5 m/s², scales between 1/1.5 and 1.5.
    ///
    /// # Errors
    /// One sentence that names the key and what to give.
    pub fn check(&self) -> Result<(), String> {
        let below = |values: &[f64], limit: f64| values.iter().all(|value| value.abs() <= limit);
        let scales = self.accel_scale.iter().all(|scale| (MOST_SCALE.recip()..=MOST_SCALE).contains(scale));
        let mag = self.mag.as_ref().is_none_or(|mag| {
            let numbers = mag.offset.iter().chain(mag.matrix.iter().flatten());
            numbers.chain([&mag.norm]).all(|value| value.is_finite()) && mag.norm > 0.0
        });
        let wrong = [
            (
                !below(&self.gyro_bias_rad_s, MOST_GYRO_BIAS_RAD_S),
                "gyro_bias_rad_s: give three numbers below 1 rad/s",
            ),
            (
                !below(&self.accel_bias_m_s2, MOST_ACCEL_BIAS_M_S2),
                "accel_bias_m_s2: give three numbers below 5 m/s²",
            ),
            (!scales, "accel_scale: give three numbers near 1"),
            (!below(&self.accel_cross, MOST_SCALE - 1.0), "accel_cross: give three numbers near 0"),
            (!mag, "mag: give finite numbers and a norm above 0"),
        ];
        wrong.iter().find(|(wrong, _)| *wrong).map_or(Ok(()), |(_, reason)| Err((*reason).to_owned()))
    }
}

impl MagIntrinsics {
    /// Corrects a field, sensor axes, in the unit of the samples: `matrix (raw - offset)`.
    pub fn apply(&self, raw: Vector3<f64>) -> Vector3<f64> {
        let rows = self.matrix.map(|row| Vector3::from(row).transpose());
        Matrix3::from_rows(&rows) * (raw - Vector3::from(self.offset))
    }
}

/// Calibrates a unit from samples `dt_s` apart, s, as the unit sends them, sensor axes: rests of a second in many directions.
/// Twelve directions give the cross-axis terms, nine to eleven leave them zero. Offline; `docs/methods/imu-intrinsics.md`;
/// what is left: `docs/imu-calibration.md`.
///
/// # Errors
/// [`IntrinsicsError::Directions`] or [`IntrinsicsError::Side`] where directions are missing, [`IntrinsicsError::Residual`]
/// where rests disagree, [`IntrinsicsError::Ellipsoid`] or [`IntrinsicsError::Field`] where the magnetometer saw too little
/// or iron.
pub fn calibrate(samples: &[ImuSample], dt_s: f64) -> Result<Intrinsics, IntrinsicsError> {
    let mut finder = RestFinder::default();
    let times = (0..).map(|k| f64::from(k) * dt_s);
    let rests: Vec<Rest> = times.zip(samples).filter_map(|(t_s, sample)| finder.push(t_s, sample)).collect();
    let fields: Vec<Vector3<f64>> = samples.iter().filter_map(|sample| sample.mag).collect();
    solve(&rests, &fields)
}

/// What follows from rests, and from the fields of all directions.
fn solve(rests: &[Rest], fields: &[Vector3<f64>]) -> Result<Intrinsics, IntrinsicsError> {
    let directions = Directions::of(rests);
    if directions.len() < MIN_DIRECTIONS {
        let found = directions.len();
        return Err(IntrinsicsError::Directions { found, needed: MIN_DIRECTIONS, seconds: 2.0 * MIN_REST_S });
    }
    if let Some((missing, _)) = SIDES.into_iter().zip(directions.sides()).find(|(_, held)| !held) {
        return Err(IntrinsicsError::Side { missing });
    }
    let found = fit_gravity(rests, directions.len() >= CROSS_DIRECTIONS);
    if found.residual.is_nan() || found.residual > MAX_RESIDUAL {
        return Err(IntrinsicsError::Residual { found: found.residual, limit: MAX_RESIDUAL });
    }
    let count = rests.len() as f64;
    let bias = rests.iter().map(|rest| rest.gyro).sum::<Vector3<f64>>() / count;
    let spread = rests.iter().map(|rest| (rest.gyro - bias).norm_squared()).sum::<f64>() / (3.0 * count);
    let mag = if fields.is_empty() { None } else { Some(fit_ellipsoid(fields)?) };
    if let Some(mag) = mag.as_ref().filter(|mag| mag.residual > MAX_FIELD_RESIDUAL) {
        return Err(IntrinsicsError::Field { found: mag.residual });
    }
    Ok(Intrinsics {
        unit: None,
        gyro_bias_rad_s: bias.into(),
        gyro_bias_sigma_rad_s: spread.sqrt(),
        accel_bias_m_s2: found.bias.into(),
        accel_scale: found.scale.into(),
        accel_cross: found.cross.into(),
        accel_residual_m_s2: found.residual,
        directions: directions.len(),
        mag,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_geometry::{GRAVITY_M_S2, so3};

    /// A unit with errors of MPU class, placed at rest in given directions and turned between them.
    fn recording(directions: &[Vector3<f64>]) -> Vec<ImuSample> {
        let (gyro_bias, accel_bias) = (Vector3::new(0.05, -0.03, 0.02), Vector3::new(0.6, -0.7, 0.3));
        let gain = Vector3::new(1.03, 0.98, 1.01);
        let soft = Matrix3::new(1.1, 0.05, -0.03, 0.05, 0.95, 0.02, -0.03, 0.02, 1.0);
        let mut samples = Vec::new();
        let mut noise = 1_u64;
        let mut random = || {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (noise >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        for (k, up) in directions.iter().enumerate() {
            for i in 0..400 {
                // Two seconds at rest, then two of turning about a changing axis.
                let turning = f64::from(i - 200).max(0.0) * 0.01;
                let rotation = so3::exp(&(Vector3::new(1.0, k as f64 % 3.0, 2.0 - k as f64 % 5.0) * turning));
                let side = rotation * up.cross(&Vector3::new(0.3, -0.5, 0.8)).normalize();
                let up = rotation * up.normalize();
                let angular_velocity_rad_s =
                    if turning > 0.0 { Vector3::repeat(1.0) } else { Vector3::zeros() };
                let small = Vector3::from_fn(|_, _| random());
                let field = side * 20.0 - up * 40.0;
                samples.push(ImuSample {
                    gyro_rad_s: angular_velocity_rad_s + gyro_bias + small * 0.01,
                    accel_m_s2: (up * GRAVITY_M_S2).component_div(&gain) + accel_bias + small * 0.05,
                    mag: Some(soft * field + Vector3::new(12.0, -7.0, 25.0) + small * 0.3),
                });
            }
        }
        samples
    }

    fn many() -> Vec<Vector3<f64>> {
        let mut all = Vec::new();
        for s in [1.0, -1.0] {
            all.extend([Vector3::x() * s, Vector3::y() * s, Vector3::z() * s]);
            all.extend([Vector3::new(s, 1.0, 1.0), Vector3::new(-1.0, s, 0.0), Vector3::new(1.0, -1.0, s)]);
        }
        all
    }

    #[test]
    fn errors_of_a_unit_are_found() {
        let samples = recording(&many());
        let found = calibrate(&samples, 0.01).unwrap();
        let off = |a: [f64; 3], b: [f64; 3]| (Vector3::from(a) - Vector3::from(b)).amax();
        assert!(off(found.gyro_bias_rad_s, [0.05, -0.03, 0.02]) < 1e-3);
        assert!(off(found.accel_bias_m_s2, [0.6, -0.7, 0.3]) < 0.02, "{found:?}");
        assert!(off(found.accel_scale, [1.03, 0.98, 1.01]) < 0.003, "{found:?}");
        let mag = found.mag.as_ref().unwrap();
        assert!(off(mag.offset, [12.0, -7.0, 25.0]) < 0.3, "{mag:?}");
        assert!(mag.residual < 0.01, "{mag:?}");
        let corrected = found.apply(&samples[50]);
        assert!((corrected.accel_m_s2.norm() - GRAVITY_M_S2).abs() < 0.05);
        assert!((corrected.mag.unwrap().norm() / mag.norm - 1.0).abs() < 0.03);
    }

    #[test]
    fn cross_axis_terms_are_found_from_twelve_directions() {
        let cross = Vector3::new(0.012, -0.008, 0.015);
        let mut samples = recording(&many());
        for sample in &mut samples {
            sample.accel_m_s2 += gain(&Vector3::zeros(), &cross) * sample.accel_m_s2;
        }
        let found = calibrate(&samples, 0.01).unwrap();
        let rest = found.apply(&samples[50]).accel_m_s2;
        assert!((Vector3::from(found.accel_cross) + cross).amax() < 2e-3, "{found:?}");
        assert!(found.accel_residual_m_s2 < 0.02 && (rest.norm() - GRAVITY_M_S2).abs() < 0.05, "{found:?}");
        // Nine directions leave nothing to check them with.
        let few = calibrate(&samples[..9 * 400], 0.01);
        assert!(few.is_err() || few.is_ok_and(|few| few.accel_cross == [0.0; 3]));
    }

    /// What one receives until all is done; the guide then knows what a file with the same samples would.
    #[test]
    fn a_guide_names_what_is_missing_until_nothing_is() {
        let mut directions = many();
        directions.swap(5, 11);
        let samples = recording(&directions);
        let mut guide = guide::Guide::new(true);
        let mut prompts: Vec<String> = Vec::new();
        for (k, sample) in samples.iter().enumerate() {
            guide.push(k as f64 * 0.01, sample);
            prompts.extend(guide.prompt().filter(|prompt| prompts.last() != Some(prompt)));
        }
        assert_eq!(guide.prompt(), None, "{prompts:?}");
        assert!(prompts[0].starts_with("0 of 12 directions") && prompts[0].contains("-z"), "{prompts:?}");
        assert!(prompts.iter().any(|prompt| prompt.contains("leave it as it is")), "{prompts:?}");
        assert!(prompts.iter().any(|prompt| prompt.contains("edge or a corner")), "{prompts:?}");
        let [live, file] = [guide.solve().unwrap(), calibrate(&samples, 0.01).unwrap()];
        assert_eq!((live.accel_bias_m_s2, live.directions), (file.accel_bias_m_s2, file.directions));
        // Half way it refuses, and states what is missing.
        let mut half = guide::Guide::new(true);
        samples[..2000].iter().enumerate().for_each(|(k, sample)| half.push(k as f64 * 0.01, sample));
        assert!(!half.would_do());
        assert!(matches!(half.solve(), Err(IntrinsicsError::Directions { found: 5, .. })));
        // One who has gone away is noticed, and one who places it as before is reported.
        for k in 0..400 {
            half.push(20.0 + f64::from(k) * 0.01, &samples[1700]);
        }
        assert!(half.prompt().unwrap().contains("this one is known"), "{:?}", half.prompt());
        assert!(half.times_s().1 > 3.0);
    }

    #[test]
    fn what_was_written_is_read_again_and_nonsense_is_refused() {
        let mut found = calibrate(&recording(&many()), 0.01).unwrap();
        let again = |found: &Intrinsics| Intrinsics::from_json(&serde_json::to_vec(found).unwrap());
        assert_eq!(again(&found).as_ref(), Ok(&found));
        found.accel_scale[1] = 0.0;
        assert!(again(&found).unwrap_err().ends_with("accel_scale: give three numbers near 1"));
        assert!(Intrinsics::from_json(b"{}").unwrap_err().contains("missing field"));
    }

    #[test]
    fn missing_directions_are_named() {
        let few = calibrate(&recording(&many()[..5]), 0.01).unwrap_err();
        assert!(matches!(few, IntrinsicsError::Directions { found: 5, .. }), "{few:?}");
        // Everything but what has the z axis well below the horizon.
        let above: Vec<_> = many().into_iter().filter(|up| up.normalize().z > -0.1).collect();
        let side = calibrate(&recording(&above), 0.01).unwrap_err();
        assert_eq!(side, IntrinsicsError::Side { missing: "-z" });
    }

    #[test]
    fn a_magnetometer_that_was_not_turned_is_refused() {
        let mut samples = recording(&many());
        for sample in &mut samples {
            sample.mag = sample.mag.map(|m| Vector3::new(m.x, m.y, 0.0));
        }
        assert_eq!(calibrate(&samples, 0.01).unwrap_err(), IntrinsicsError::Ellipsoid);
    }
}
