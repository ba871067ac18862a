//! Gestures: rigid motions of smooth pieces that change their velocity at known frames, for measuring detectors
//! of such changes.
//!
//! What comes in: a seed, a shape, an amplitude, a level of noise. What goes out: one pose per frame. The frames of
//! the changes and the levels of noise are those of L. Merckel and T. Nishida, "Change-point detection on the Lie
//! group SE(3) for segmenting gesture-defined spatial rigid motion" (2010), whose own signal is only a figure.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::random::{Purpose, Random};

/// Number of frames of a gesture.
pub const FRAMES: usize = 1000;
/// Frames at which its velocity changes.
pub const CHANGES: [usize; 6] = [140, 250, 300, 500, 700, 820];
/// Standard deviation of each axis at the levels of noise 0 to 6: positions (m), rotations (degrees).
pub const NOISE: [(f64, f64); 7] =
    [(0.0, 0.0), (0.005, 2.0), (0.01, 2.5), (0.015, 5.0), (0.02, 10.0), (0.025, 20.0), (0.03, 40.0)];

/// How the pieces between the changes look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Constant velocities: linear in the room, angular in body axes.
    Straight,
    /// Velocities that grow or shrink by up to half over a piece.
    Bent,
    /// Velocities that sway sinusoidally, half a period to one per piece.
    Swaying,
}

/// What to make: a rigid motion of seven pieces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gesture {
    /// Which one of its kind: the same gesture gives the same poses.
    pub seed: u64,
    /// How its pieces look.
    pub shape: Shape,
    /// Length of the box that the path about fills, m.
    pub size_m: f64,
    /// How far it turns in all, degrees, about: each piece turns about an axis of its own at 0.7 to 1.3 times the mean angular
    /// velocity.
    pub rotation_deg: f64,
}

impl Gesture {
    /// The gesture of the published table: 2 m and 300 degrees.
    pub fn of_the_table(seed: u64) -> Self {
        Self { seed, shape: Shape::Bent, size_m: 2.0, rotation_deg: 300.0 }
    }

    /// Its [`FRAMES`] poses without noise: body to the frame of reference, m; the first is the identity.
    ///
    /// At each of [`CHANGES`] both velocities turn by a right angle or more; between them they are smooth.
    pub fn poses(&self) -> Vec<Isometry3<f64>> {
        let mut random = Random::new(self.seed, Purpose::Signals(0));
        let direction =
            |random: &mut Random| Vector3::new(random.normal(), random.normal(), random.normal()).normalize();
        // The longest piece, of 200 frames, goes through a third of the box.
        let speed = self.size_m / 600.0;
        let angular_speed = self.rotation_deg.to_radians() / FRAMES as f64;
        let mut pose = Isometry3::identity();
        let mut poses = Vec::with_capacity(FRAMES);
        let mut last: Option<(Vector3<f64>, Vector3<f64>)> = None;
        let mut start = 0;
        for end in CHANGES.into_iter().chain([FRAMES]) {
            // A change turns the path by a right angle at least; and it stays in its box by turning back.
            let (linear, angular) = loop {
                let linear = direction(&mut random) * speed * (0.7 + 0.6 * random.uniform());
                let angular = direction(&mut random) * angular_speed * (0.7 + 0.6 * random.uniform());
                let back = linear.dot(&pose.translation.vector) <= 0.0;
                if back && last.is_none_or(|(v, w)| linear.dot(&v) <= 0.0 && angular.dot(&w) <= 0.0) {
                    break (linear, angular);
                }
            };
            let bends = [random.uniform() - 0.5, random.uniform() - 0.5];
            let periods = 0.5 + 0.5 * random.uniform();
            let sideways = [direction(&mut random) * speed, direction(&mut random) * angular_speed];
            for frame in start..end {
                poses.push(pose);
                let s = (frame - start) as f64 / (end - start) as f64;
                let (v, w) = match self.shape {
                    Shape::Straight => (linear, angular),
                    Shape::Bent => (
                        linear * (1.0 + bends[0] * (2.0 * s - 1.0)),
                        angular * (1.0 + bends[1] * (2.0 * s - 1.0)),
                    ),
                    Shape::Swaying => {
                        let sway = 0.5 * libm::sin(std::f64::consts::TAU * periods * s);
                        (linear + sideways[0] * sway, angular + sideways[1] * sway)
                    }
                };
                pose.translation.vector += v;
                pose.rotation *= UnitQuaternion::from_scaled_axis(w);
                last = Some((v, w));
            }
            start = end;
        }
        poses
    }

    /// Its poses with white Gaussian noise of the given standard deviations per axis, as in [`NOISE`]: positions, m; rotations,
    /// degrees, in body axes. The noise is seeded too.
    pub fn noisy(&self, (sigma_m, sigma_deg): (f64, f64)) -> Vec<Isometry3<f64>> {
        let mut random = Random::new(self.seed, Purpose::Signals(1));
        let mut vector = |sigma: f64| Vector3::new(random.normal(), random.normal(), random.normal()) * sigma;
        let add = |pose: Isometry3<f64>| {
            let shift = vector(sigma_m);
            let rotation = UnitQuaternion::from_scaled_axis(vector(sigma_deg.to_radians()));
            Isometry3::from_parts(
                Translation3::from(pose.translation.vector + shift),
                pose.rotation * rotation,
            )
        };
        self.poses().into_iter().map(add).collect()
    }
}

/// False positives and misses of detections (frame numbers in any order), as the paper counts: a detection less than 10 frames from a change is a
/// hit, further ones near the same change and all others are false.
pub fn count_errors(detections: impl IntoIterator<Item = usize>) -> (usize, usize) {
    let mut hit = [false; CHANGES.len()];
    let mut false_positives = 0;
    for detection in detections {
        let near = CHANGES.iter().position(|change| change.abs_diff(detection) < 10);
        match near {
            Some(change) if !hit[change] => hit[change] = true,
            _ => false_positives += 1,
        }
    }
    (false_positives, hit.iter().filter(|hit| !**hit).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_velocity_changes_at_the_stated_frames_and_nowhere_else() {
        for shape in [Shape::Straight, Shape::Bent, Shape::Swaying] {
            let gesture = Gesture { shape, ..Gesture::of_the_table(3) };
            let poses = gesture.poses();
            assert_eq!(poses.len(), FRAMES);
            let p = |frame: usize| poses[frame].translation.vector;
            let turned = (1..FRAMES - 1).filter(|k| (p(k + 1) - 2.0 * p(*k) + p(k - 1)).norm() > 1e-3);
            assert_eq!(turned.collect::<Vec<_>>(), CHANGES, "{shape:?}");
            let reach = poses.iter().map(|pose| pose.translation.vector.norm()).fold(0.0, f64::max);
            assert!((0.3..2.5).contains(&reach), "{reach}");
        }
    }

    #[test]
    fn noise_has_the_stated_size_and_repeats() {
        let gesture = Gesture::of_the_table(1);
        let (clean, noisy) = (gesture.poses(), gesture.noisy(NOISE[2]));
        assert_eq!(noisy, gesture.noisy(NOISE[2]));
        let squares: f64 = clean
            .iter()
            .zip(&noisy)
            .map(|(a, b)| (a.translation.vector - b.translation.vector).norm_squared())
            .sum();
        let sigma = (squares / (3.0 * FRAMES as f64)).sqrt();
        assert!((sigma / 0.01 - 1.0).abs() < 0.05, "{sigma}");
    }

    #[test]
    fn errors_are_counted_as_published() {
        assert_eq!(count_errors(CHANGES), (0, 0));
        assert_eq!(count_errors([141, 145, 250, 309, 310]), (2, 3));
        assert_eq!(count_errors([]), (0, 6));
    }
}
