//! Straps that wander: a sensor turns slowly on its segment, to and fro within a minute or two.

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::random::Random;

/// Waves of each axis, and how long the shortest and the longest take, s.
const WAVES: usize = 3;
const PERIODS_S: [f64; 2] = [30.0, 180.0];

/// How far a sensor has turned on its segment since it was put on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Strap {
    /// Of each wave about each axis: rad/s, rad.
    waves: [[[f64; 2]; WAVES]; 3],
    amplitude_rad: f64,
}

impl Strap {
    /// One that turns by this about each axis, root mean square over time.
    pub(crate) fn draw(sigma_rad: f64, random: &mut Random) -> Self {
        let mut wave = || {
            let [least, most] = PERIODS_S.map(libm::log);
            [TAU / libm::exp(random.within(least, most)), random.within(0.0, TAU)]
        };
        let waves = std::array::from_fn(|_| std::array::from_fn(|_| wave()));
        // Waves, and where they were at the beginning.
        Self { waves, amplitude_rad: sigma_rad / (WAVES as f64).sqrt() }
    }

    /// As a rotation vector in segment axes, rad; zero at 0 s.
    pub(crate) fn turned_rad(&self, t_s: f64) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let waves = &self.waves[axis];
            let wave = |[speed, phase]: &[f64; 2]| libm::sin(speed * t_s + phase) - libm::sin(*phase);
            self.amplitude_rad * waves.iter().map(wave).sum::<f64>()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;

    #[test]
    fn a_strap_wanders_slowly_and_as_far_as_it_is_told() {
        let (mut squares, mut count) = (0.0, 0.0);
        for index in 0..40 {
            let strap = Strap::draw(0.1, &mut Random::new(3, Purpose::Strap(index)));
            assert_eq!(strap.turned_rad(0.0), Vector3::zeros());
            for step in 1..200 {
                let t_s = 5.0 * f64::from(step);
                let turned_rad = strap.turned_rad(t_s);
                squares += turned_rad.norm_squared() / 3.0;
                count += 1.0;
                let speed_rad_s = (strap.turned_rad(t_s + 0.1) - turned_rad).norm() / 0.1;
                assert!(speed_rad_s < 0.1 * TAU / 5.0, "{speed_rad_s}");
            }
        }
        let rms_rad: f64 = libm::sqrt(squares / count);
        assert!((0.08..0.12).contains(&rms_rad), "{rms_rad}");
    }
}
