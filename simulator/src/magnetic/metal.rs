//! Metal near a tracker: spheres and a floor, as induced and image dipoles.

use nalgebra::{Matrix3, Unit, Vector3};

use super::dipole::field_matrix;

/// Permeability of vacuum, T m / A.
const MU0: f64 = 4e-7 * std::f64::consts::PI;

/// How the transmitter drives its coils, which decides what eddy currents in a conductor answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Excitation {
    /// Alternating current of this frequency, Hz, detected in phase.
    Ac {
        /// Carrier frequency, Hz.
        frequency_hz: f64,
    },
    /// Direct current pulses: eddy currents have decayed for a while when the field is sampled.
    PulsedDc {
        /// Delay from the step of the current to the sample, s.
        sample_delay_s: f64,
    },
}

/// Response q of a conducting sphere: -1 for a perfect conductor, nearer to 0 for a poor one.
///
/// Time constant of the eddy currents: tau = mu0 sigma a^2 / pi^2. With alternating current the answer
/// is 1 / (1 + 1 / (j f / fc)), fc = 1 / (2 pi tau), of which an in-phase detector sees the real part;
/// with pulses it has decayed to exp(-t / tau).
///
/// `conductivity_s_m` in S/m, `radius_m` in m.
pub fn conductor_response(excitation: Excitation, conductivity_s_m: f64, radius_m: f64) -> f64 {
    let tau_s = MU0 * conductivity_s_m * radius_m * radius_m / std::f64::consts::PI.powi(2);
    match excitation {
        Excitation::Ac { frequency_hz } => {
            let x = std::f64::consts::TAU * frequency_hz * tau_s;
            -(x * x) / (1.0 + x * x)
        }
        Excitation::PulsedDc { sample_delay_s } => -libm::exp(-sample_delay_s / tau_s),
    }
}

/// Response q of a soft-iron sphere of relative permeability mu: 2 (mu - 1) / (mu + 2), without decay.
pub fn iron_response(relative_permeability: f64) -> f64 {
    2.0 * (relative_permeability - 1.0) / (relative_permeability + 2.0)
}

/// A metal sphere, as a dipole that the transmitter alone induces: it does not answer to other metal, nor to how the
/// transmitter's field varies over its size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Centre in the transmitter frame, m.
    pub center_m: Vector3<f64>,
    /// Radius, m.
    pub radius_m: f64,
    /// Response q, from -1, a perfect conductor, to +2, infinitely soft iron; by [`conductor_response`] or [`iron_response`].
    pub response: f64,
}

impl Sphere {
    /// Field at `p_m` of the dipoles that the three source axes induce in the sphere.
    ///
    /// Induced moments (in units of the source's): q a^3 / 2 K(centre). Inside the metal the field is
    /// taken as that of the nearest point of the surface.
    pub(super) fn field(&self, p_m: &Vector3<f64>) -> Matrix3<f64> {
        let moments = self.response * self.radius_m.powi(3) / 2.0 * field_matrix(&self.center_m);
        let mut from_center = p_m - self.center_m;
        let distance_m = from_center.norm();
        if distance_m < self.radius_m {
            let outward = Unit::try_new(from_center, 1e-9).unwrap_or(Vector3::z_axis());
            from_center = outward.into_inner() * self.radius_m;
        }
        field_matrix(&from_center) * moments
    }
}

/// A metal plane without end, as an image of the source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Normal of the plane in the transmitter frame, towards the transmitter.
    pub normal: Unit<Vector3<f64>>,
    /// Distance of the transmitter from the plane, m, not negative.
    pub distance_m: f64,
    /// Strength of the image: 0 none, +1 perfect iron, -1 perfect conductor.
    pub strength: f64,
}

impl Floor {
    /// Field at `p_m` of the image dipoles.
    ///
    /// For iron the image of m is (-m_x, -m_y, m_z) with z along the normal, for a conductor its negative.
    fn field(&self, p_m: &Vector3<f64>) -> Matrix3<f64> {
        let n = self.normal.into_inner();
        let moments = self.strength * (2.0 * n * n.transpose() - Matrix3::identity());
        field_matrix(&(p_m + 2.0 * self.distance_m * n)) * moments
    }
}

/// All metal of a scene; the default has none. Objects add up: they do not answer to one another.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Environment {
    /// Metal objects, as spheres.
    pub spheres: Vec<Sphere>,
    /// The floor, if it holds metal.
    pub floor: Option<Floor>,
}

impl Environment {
    /// Field of the source and all metal at `p_m` (transmitter frame, m), one column per source axis, 1/m^3.
    pub fn field(&self, p_m: &Vector3<f64>) -> Matrix3<f64> {
        let mut field = field_matrix(p_m);
        for sphere in &self.spheres {
            field += sphere.field(p_m);
        }
        if let Some(floor) = &self.floor {
            field += floor.field(p_m);
        }
        field
    }
}

#[cfg(test)]
mod tests {
    use super::super::dipole::{signal_matrix, solve};
    use super::*;
    use nalgebra::UnitQuaternion;

    fn shift_m(environment: &Environment, p: &Vector3<f64>) -> f64 {
        let s = signal_matrix(&environment.field(p), &UnitQuaternion::identity());
        (solve(&s, p).unwrap().position_m - p).norm()
    }

    /// A sphere so small that the source's field is uniform over it.
    fn small_sphere(response: f64) -> Environment {
        let sphere = Sphere { center_m: Vector3::new(1.0, 0.4, -0.2), radius_m: 1e-4, response };
        Environment { spheres: vec![sphere], floor: None }
    }

    #[test]
    fn no_field_enters_a_perfect_conductor() {
        let environment = small_sphere(-1.0);
        let sphere = environment.spheres[0];
        for n in [Vector3::x(), Vector3::y(), Vector3::new(0.6, 0.0, 0.8)] {
            let b = environment.field(&(sphere.center_m + 1.000_001 * sphere.radius_m * n));
            let normal = n.transpose() * b;
            assert!(normal.norm() < 1e-3 * b.norm(), "{normal}");
        }
    }

    #[test]
    fn the_field_stands_upright_on_soft_iron() {
        let environment = small_sphere(iron_response(1e9));
        let sphere = environment.spheres[0];
        let n = Vector3::new(0.6, 0.0, 0.8);
        let b = environment.field(&(sphere.center_m + 1.000_001 * sphere.radius_m * n));
        let tangential = (Matrix3::identity() - n * n.transpose()) * b;
        assert!(tangential.norm() < 1e-3 * b.norm(), "{tangential}");
    }

    #[test]
    fn floors_keep_their_boundary_conditions() {
        let n = Vector3::new(0.0, 0.6, -0.8);
        for p_along in [Vector3::new(0.7, 0.0, 0.0), Vector3::new(-0.3, 0.4, 0.3)] {
            let at = |strength| {
                let floor = Floor { normal: Unit::new_normalize(n), distance_m: 0.5, strength };
                Environment { spheres: vec![], floor: Some(floor) }.field(&(p_along - 0.5 * n))
            };
            let conductor = n.transpose() * at(-1.0);
            assert!(conductor.norm() < 1e-12, "normal field on a conductor: {conductor}");
            let iron = (Matrix3::identity() - n * n.transpose()) * at(1.0);
            assert!(iron.norm() < 1e-12, "tangential field on iron: {iron}");
        }
    }

    #[test]
    fn a_weak_floor_one_metre_below_bends_the_far_field() {
        let floor = Floor { normal: Vector3::z_axis(), distance_m: 1.0, strength: 0.1 };
        let environment = Environment { spheres: vec![], floor: Some(floor) };
        for (r, shift_mm) in [(1.0, 10.6), (1.5, 46.0), (2.0, 106.3), (2.5, 180.1)] {
            let shift_m = shift_m(&environment, &Vector3::new(r, 0.0, 0.0));
            assert!((1e3 * shift_m - shift_mm).abs() < 0.1, "{r}: {shift_m}");
        }
    }

    #[test]
    fn a_sphere_beside_the_path_shifts_by_millimetres_and_grows_with_its_volume() {
        let shift_mm = |radius_m, response| {
            let sphere = Sphere { center_m: Vector3::new(1.0, 0.5, 0.0), radius_m, response };
            let environment = Environment { spheres: vec![sphere], floor: None };
            1e3 * shift_m(&environment, &Vector3::new(2.0, 0.0, 0.0))
        };
        assert!((shift_mm(0.1, -1.0) - 8.8).abs() < 0.1);
        assert!((shift_mm(0.1, 2.0) - 17.8).abs() < 0.1);
        let growth = shift_mm(0.2, -1.0) / shift_mm(0.1, -1.0);
        assert!((growth - 8.0).abs() < 0.5, "{growth}");
    }

    #[test]
    fn eddy_currents_decay() {
        let aluminium = 3.5e7;
        let pulsed =
            |ms| conductor_response(Excitation::PulsedDc { sample_delay_s: ms * 1e-3 }, aluminium, 0.1);
        assert_eq!(pulsed(0.0), -1.0);
        // tau = mu0 sigma a^2 / pi^2 = 44.56 ms.
        assert!((pulsed(44.56) + libm::exp(-1f64)).abs() < 1e-4);
        let ac = |frequency_hz| conductor_response(Excitation::Ac { frequency_hz }, aluminium, 0.1);
        assert!((ac(1.0 / (std::f64::consts::TAU * 0.044_563)) + 0.5).abs() < 1e-4, "half at the corner");
        assert!((ac(10_000.0) + 1.0).abs() < 1e-4);
        assert!((iron_response(1000.0) - 1.994).abs() < 1e-3);
    }
}
