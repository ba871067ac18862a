//! What is wrong with an inertial sensor: noise, bias, scale, misalignment, limits, steps.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::random::Random;

/// How good the inertial sensors of a device are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ImuClass {
    /// No errors at all.
    Ideal,
    /// A calibrated motion tracker.
    #[default]
    Mtx,
    /// A bare chip.
    Mpu,
    /// A present-day chip on somebody's own board or in a phone, calibrated as it corrects itself.
    Board,
}

/// Errors of three axes of one kind, in the unit of what they measure; the default has none. What is drawn is drawn from the
/// scenario's seed, normal, per axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisErrors {
    /// White noise, one-sided density, unit/sqrt(Hz). A sample of `dt` seconds has the deviation
    /// `density / sqrt(2 dt)`: what a filter at the Nyquist frequency lets through.
    pub noise_density: f64,
    /// Standard deviation of the offset at the start, drawn once per sensor.
    pub bias: f64,
    /// Random walk of the offset, unit/sqrt(s); 0: it is constant.
    pub bias_walk: f64,
    /// Standard deviation of the relative scale error of each axis, drawn once.
    pub scale: f64,
    /// Standard deviation of the share of each axis that another one feels, drawn once.
    pub misalignment: f64,
    /// Largest magnitude that an axis reports; 0: no limit.
    pub range: f64,
    /// Quantisation step; 0: not quantised.
    pub step: f64,
}

/// Errors of the orientation that a device computes: slow wander of inclination and heading, a Gauss-Markov process of 10 s in
/// room axes. It is drawn for itself and does not follow the errors of the device's gyroscope, accelerometer and magnetometer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FilterErrors {
    /// Standard deviation of the tilt about each level axis, rad.
    pub tilt_rad: f64,
    /// Standard deviation of the heading, rad.
    pub heading_rad: f64,
    /// The heading has any constant offset as well, uniform over the circle, drawn once: the device trusts no magnetometer.
    pub any_heading: bool,
}

/// All errors of an inertial sensor; the default has none. Delays, temperature and the mounting's play are not modelled.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuErrors {
    /// Of the gyroscope: angular velocity, rad/s.
    pub gyroscope: AxisErrors,
    /// Of the accelerometer: specific force, m/s².
    pub accelerometer: AxisErrors,
    /// Of the magnetometer: magnetic field, in units of the field at the place of calibration.
    pub magnetometer: AxisErrors,
    /// Of the orientation that the device computes.
    pub filter: FilterErrors,
}

impl ImuErrors {
    /// The errors of a class; the figures are those of the makers' data sheets.
    pub fn of(class: ImuClass) -> Self {
        let degree = 1f64.to_radians();
        let g = super::GRAVITY_M_S2;
        let filter =
            FilterErrors { tilt_rad: 0.5 * degree, heading_rad: 1.0 * degree, ..FilterErrors::default() };
        match class {
            ImuClass::Ideal => Self::default(),
            ImuClass::Mtx => Self {
                gyroscope: AxisErrors {
                    noise_density: 0.1 * degree,
                    bias: 0.3 * degree,
                    bias_walk: 0.003 * degree,
                    scale: 1e-3,
                    misalignment: 1e-3,
                    range: 1200.0 * degree,
                    step: 0.0,
                },
                accelerometer: AxisErrors {
                    noise_density: 0.003,
                    bias: 0.02,
                    bias_walk: 2e-4,
                    scale: 3e-4,
                    misalignment: 1e-3,
                    range: 50.0,
                    step: 0.0,
                },
                magnetometer: AxisErrors {
                    noise_density: 5e-4,
                    bias: 1e-3,
                    bias_walk: 0.0,
                    scale: 5e-3,
                    misalignment: 1e-3,
                    range: 1.5,
                    step: 0.0,
                },
                filter,
            },
            ImuClass::Mpu => Self {
                gyroscope: AxisErrors {
                    noise_density: 0.01 * degree,
                    bias: 2.5 * degree,
                    bias_walk: 0.003 * degree,
                    scale: 0.015,
                    misalignment: 0.01,
                    range: 2000.0 * degree,
                    step: 2000.0 * degree / 32768.0,
                },
                accelerometer: AxisErrors {
                    noise_density: 300e-6 * super::GRAVITY_M_S2,
                    bias: 0.035 * super::GRAVITY_M_S2,
                    bias_walk: 2e-4,
                    scale: 0.015,
                    misalignment: 0.01,
                    range: 16.0 * super::GRAVITY_M_S2,
                    step: 16.0 * super::GRAVITY_M_S2 / 32768.0,
                },
                // Of a field of 50 microtesla.
                magnetometer: AxisErrors {
                    noise_density: 2e-3,
                    bias: 0.1,
                    bias_walk: 0.0,
                    scale: 0.03,
                    misalignment: 0.01,
                    range: 96.0,
                    step: 0.6 / 50.0,
                },
                filter: FilterErrors { tilt_rad: 1.0 * degree, heading_rad: 2.0 * degree, ..filter },
            },
            // As the data sheets of BNO085 and ICM-42688 have it.
            ImuClass::Board => Self {
                gyroscope: AxisErrors {
                    noise_density: 0.005 * degree,
                    bias: 0.2 * degree,
                    bias_walk: 0.003 * degree,
                    scale: 5e-3,
                    misalignment: 5e-3,
                    range: 2000.0 * degree,
                    step: 2000.0 * degree / 32768.0,
                },
                accelerometer: AxisErrors {
                    noise_density: 100e-6 * g,
                    bias: 0.01 * g,
                    bias_walk: 2e-4,
                    scale: 5e-3,
                    misalignment: 5e-3,
                    range: 8.0 * g,
                    step: 8.0 * g / 32768.0,
                },
                magnetometer: AxisErrors {
                    noise_density: 2e-3,
                    bias: 0.03,
                    bias_walk: 0.0,
                    scale: 0.01,
                    misalignment: 0.01,
                    range: 96.0,
                    step: 0.3 / 50.0,
                },
                filter: FilterErrors { tilt_rad: 1.0 * degree, heading_rad: 2.0 * degree, ..filter },
            },
        }
    }
}

/// The errors of one sensor's three axes, drawn.
#[derive(Clone, Debug)]
pub(crate) struct Axes {
    errors: AxisErrors,
    /// Identity, scale and misalignment.
    gain: Matrix3<f64>,
    bias: Vector3<f64>,
}

/// Three normal numbers.
fn normals(random: &mut Random) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.normal())
}

impl Axes {
    pub(crate) fn draw(errors: AxisErrors, random: &mut Random) -> Self {
        let gain = Matrix3::from_fn(|row, column| {
            let normal = random.normal();
            if row == column { 1.0 + errors.scale * normal } else { errors.misalignment * normal }
        });
        Self { errors, gain, bias: errors.bias * normals(random) }
    }

    /// `sat((I + S + N) x + b + noise)`, quantised; `dt_s` is the time that the sample stands for.
    pub(crate) fn measure(&mut self, x: &Vector3<f64>, dt_s: f64, random: &mut Random) -> Vector3<f64> {
        self.bias += self.errors.bias_walk * dt_s.sqrt() * normals(random);
        let noise = self.errors.noise_density / (2.0 * dt_s).sqrt() * normals(random);
        let y = self.gain * x + self.bias + noise;
        let AxisErrors { range, step, .. } = self.errors;
        y.map(|y| {
            let y = if range > 0.0 { y.clamp(-range, range) } else { y };
            if step > 0.0 { (y / step).round() * step } else { y }
        })
    }
}

/// Time constant of the wander of a device's own orientation, s.
const WANDER_S: f64 = 10.0;

/// The error of the orientation that one device computes.
#[derive(Clone, Debug)]
pub(crate) struct FilterError {
    errors: FilterErrors,
    heading_offset_rad: f64,
    /// Rotation vector of the error, room axes, in deviations.
    wander: Vector3<f64>,
}

impl FilterError {
    pub(crate) fn draw(errors: FilterErrors, random: &mut Random) -> Self {
        let offset = std::f64::consts::TAU * (random.uniform() - 0.5);
        let heading_offset_rad = if errors.any_heading { offset } else { 0.0 };
        Self { errors, heading_offset_rad, wander: normals(random) }
    }

    /// The orientation that the device gives, `dt_s` after the last one (a Gauss-Markov wander).
    pub(crate) fn apply(
        &mut self,
        truth: &UnitQuaternion<f64>,
        dt_s: f64,
        random: &mut Random,
    ) -> UnitQuaternion<f64> {
        let keep = libm::exp(-dt_s / WANDER_S);
        self.wander = keep * self.wander + (1.0 - keep * keep).sqrt() * normals(random);
        let FilterErrors { tilt_rad, heading_rad, .. } = self.errors;
        let error = self.wander.component_mul(&Vector3::new(tilt_rad, tilt_rad, heading_rad));
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.heading_offset_rad)
            * UnitQuaternion::from_scaled_axis(error)
            * truth
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;

    fn random() -> Random {
        Random::new(4, Purpose::Signals(2))
    }

    #[test]
    fn without_errors_nothing_changes() {
        let mut random = random();
        let x = Vector3::new(1.0, -2.0, 3.0);
        assert_eq!(Axes::draw(AxisErrors::default(), &mut random).measure(&x, 0.01, &mut random), x);
        let mut filter = FilterError::draw(FilterErrors::default(), &mut random);
        let q = UnitQuaternion::from_scaled_axis(x);
        assert!(filter.apply(&q, 0.01, &mut random).angle_to(&q) < 1e-12);
    }

    #[test]
    fn noise_has_its_density_and_the_bias_walks_as_it_should() {
        let mut random = random();
        let errors = AxisErrors { noise_density: 0.2, ..AxisErrors::default() };
        let mut axes = Axes::draw(errors, &mut random);
        let n = 20_000;
        let square: f64 =
            (0..n).map(|_| axes.measure(&Vector3::zeros(), 0.01, &mut random).norm_squared()).sum();
        // sigma^2 = density^2 / (2 dt) = 2, three axes.
        assert!((square / f64::from(n) / 6.0 - 1.0).abs() < 0.03, "{}", square / f64::from(n));

        let errors = AxisErrors { bias_walk: 0.3, ..AxisErrors::default() };
        let square: f64 = (0..400)
            .map(|_| {
                let mut axes = Axes::draw(errors, &mut random);
                (0..100).for_each(|_| {
                    axes.measure(&Vector3::zeros(), 0.04, &mut random);
                });
                axes.bias.norm_squared()
            })
            .sum();
        // After 4 s: 3 x 0.09 x 4.
        assert!((square / 400.0 / 1.08 - 1.0).abs() < 0.15, "{}", square / 400.0);
    }

    #[test]
    fn values_saturate_and_come_in_steps() {
        let mut random = random();
        let errors = AxisErrors { range: 2.0, step: 0.25, ..AxisErrors::default() };
        let mut axes = Axes::draw(errors, &mut random);
        let y = axes.measure(&Vector3::new(5.0, -7.0, 0.62), 0.01, &mut random);
        assert_eq!(y, Vector3::new(2.0, -2.0, 0.5));
    }

    #[test]
    fn gain_and_bias_are_constant_and_of_their_size() {
        let mut random = random();
        let errors = AxisErrors { bias: 0.5, scale: 0.02, misalignment: 0.01, ..AxisErrors::default() };
        let (mut bias, mut scale, mut cross) = (0.0, 0.0, 0.0);
        for _ in 0..500 {
            let mut axes = Axes::draw(errors, &mut random);
            let zero = axes.measure(&Vector3::zeros(), 0.01, &mut random);
            assert_eq!(zero, axes.measure(&Vector3::zeros(), 0.01, &mut random));
            let x = axes.measure(&Vector3::x(), 0.01, &mut random) - zero;
            bias += zero.x * zero.x / 500.0;
            scale += (x.x - 1.0).powi(2) / 500.0;
            cross += x.y * x.y / 500.0;
        }
        for (got, wanted) in [(bias, 0.25), (scale, 4e-4), (cross, 1e-4)] {
            assert!((got / wanted - 1.0).abs() < 0.25, "{got} {wanted}");
        }
    }

    #[test]
    fn the_filters_wander_has_its_deviations() {
        let mut random = random();
        let errors = FilterErrors { tilt_rad: 0.01, heading_rad: 0.03, any_heading: false };
        let (mut tilt, mut heading) = (0.0, 0.0);
        let mut filter = FilterError::draw(errors, &mut random);
        for _ in 0..2000 {
            let error = filter.apply(&UnitQuaternion::identity(), 20.0, &mut random).scaled_axis();
            tilt += error.x * error.x / 2000.0;
            heading += error.z * error.z / 2000.0;
        }
        assert!((tilt / 1e-4 - 1.0).abs() < 0.15, "{tilt}");
        assert!((heading / 9e-4 - 1.0).abs() < 0.15, "{heading}");
        let errors = FilterErrors { any_heading: true, ..FilterErrors::default() };
        let mut filter = FilterError::draw(errors, &mut random);
        let q = filter.apply(&UnitQuaternion::identity(), 0.01, &mut random);
        assert!((q.scaled_axis() - Vector3::z() * filter.heading_offset_rad).norm() < 1e-9);
    }
}
