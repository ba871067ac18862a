//! Labelled sequences of the simulated person: one activity after the other with rests between, to learn segments from.
//!
//! What comes in: a seed. What goes out: half a minute or more of the origins of trunk and limbs with a label per frame. What it never
//! does: repeat a person: height, tempo, amplitude, heading and order are drawn anew.

use nalgebra::Vector3;

use super::kinematics::{ANKLE_M, Build, Posture};
use super::script::Activity;
use crate::random::{Purpose, Random};

/// Frames per second of every sequence.
pub const RATE_HZ: f64 = 60.0;
/// Segments of a sequence: trunk and limbs, without head, hands and feet.
pub const SHOWN: usize = 10;
/// Names of the labels; [`Programme::labels`] holds indices of this list.
pub const LABELS: [&str; 5] = ["standing", "walking", "reaching", "curls", "squats"];
const ACTIVITIES: [Activity; 4] = [Activity::Walking, Activity::Reaching, Activity::Curls, Activity::Squats];
/// From this share of its full size on a movement is what it is.
const BEGUN: f64 = 0.25;

/// A labelled sequence of one person, [`RATE_HZ`] frames a second; `frames` and `labels` are of the same length.
#[derive(Clone, Debug, PartialEq)]
pub struct Programme {
    /// Origins of the first [`SHOWN`] of [`SEGMENT_NAMES`](super::SEGMENT_NAMES) frame by frame, room axes (z up), m; white noise of 3 mm per axis is in them.
    pub frames: Vec<[[f64; 3]; SHOWN]>,
    /// Index in [`LABELS`] of each frame.
    pub labels: Vec<usize>,
}

impl Programme {
    /// The sequence of a seed: three times a rest and one of four activities, 28 to 54 s; the same seed gives the same sequence.
    ///
    /// A frame belongs to the activity once its movement has a quarter of its full size, else to `standing`.
    pub fn generate(seed: u64) -> Self {
        let mut random = Random::new(seed, Purpose::Actions);
        let build = Build::of_height(random.within(1.5, 1.95));
        let (heading, tempo, size) =
            (random.within(0.0, std::f64::consts::TAU), random.within(0.75, 1.3), random.within(0.75, 1.05));
        let stoop: Vec<f64> = (0..4).map(|_| random.within(-0.08, 0.08)).collect();
        let mut programme = Self { frames: Vec::new(), labels: Vec::new() };
        for _ in 0..3 {
            let which = random.integer(0, 3) as usize;
            let (rest_s, duration_s) = (random.within(1.5, 4.0), random.within(8.0, 14.0));
            for frame in 0..((rest_s + duration_s) * RATE_HZ) as usize {
                let t = frame as f64 / RATE_HZ - rest_s;
                let mut posture = Posture {
                    pelvis: [heading, 0.0, 0.0],
                    pelvis_m: Vector3::new(0.0, 0.0, build.thigh_m + build.shank_m + ANKLE_M),
                    ..Posture::default()
                };
                let grow = if t > 0.0 { Activity::swell(t, duration_s) } else { 0.0 };
                if t > 0.0 {
                    ACTIVITIES[which].act(&mut posture, tempo * t, size * grow, &build);
                }
                posture.spine[0] += stoop[0];
                posture.pelvis[1] += stoop[1];
                for side in 0..2 {
                    posture.elbow[side][0] += stoop[2].abs() * 3.0;
                    posture.shoulder[side][1] += stoop[3].abs();
                }
                let placed = posture.place(&build);
                let origins = std::array::from_fn(|segment| {
                    // What sensors and filters leave.
                    let wrong = [(); 3].map(|()| 0.003 * random.normal());
                    (placed[segment].origin_m + Vector3::from(wrong)).into()
                });
                programme.frames.push(origins);
                programme.labels.push(if grow < BEGUN { 0 } else { 1 + which });
            }
        }
        programme
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_label_occurs_and_nothing_leaps() {
        let mut counts = [0_usize; LABELS.len()];
        for seed in 0..20 {
            let programme = Programme::generate(seed);
            assert_eq!(programme.frames.len(), programme.labels.len());
            programme.labels.iter().for_each(|label| counts[*label] += 1);
            for pair in programme.frames.windows(2) {
                for (a, b) in pair[0].iter().zip(&pair[1]) {
                    let step = (Vector3::from(*a) - Vector3::from(*b)).norm();
                    // Rests follow from a place that walking has left: only that step is long.
                    assert!(step < 0.15, "{seed}: {step}");
                }
            }
        }
        assert!(counts.iter().all(|count| *count > 500), "{counts:?}");
        assert_eq!(Programme::generate(3), Programme::generate(3));
    }
}
