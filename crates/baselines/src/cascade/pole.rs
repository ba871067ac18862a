//! What every filter of the pole gives, and takes as known.

use nalgebra::Vector3;

/// Longest gap that is predicted through, s.
pub(super) const LONGEST_GAP_S: f64 = 0.5;
/// Iterations of an update end below this step, m, or after so many.
pub(super) const STEP_M: f64 = 1e-6;
pub(super) const ROUNDS: usize = 5;

/// Where the pole is, in the frame of the readings: the transmitter's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pole {
    /// The place that offsets count from, m: the pole's middle in a [`Track`].
    pub origin_m: Vector3<f64>,
    /// Direction towards greater offsets: unit, or nearly where a filter carries a quaternion.
    pub along: Vector3<f64>,
}

impl Pole {
    /// Where the sensor `offset_m` from the origin is, m; offsets as of [`posed_field::PoleRun::offset_m`].
    pub fn position_m(&self, offset_m: f64) -> Vector3<f64> {
        self.origin_m + self.along * offset_m
    }
}

/// How far the iterations of an update still move the sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Steps {
    sum_m: [f64; ROUNDS],
    frames: u32,
}

impl Steps {
    /// Counts the iteration `round` of a frame, which took one pole for another; returns by how much it moved the sensors that were
    /// measured, in the mean, m.
    pub(super) fn push(
        &mut self,
        round: usize,
        before: &Pole,
        after: &Pole,
        row: &[(Vector3<f64>, f64)],
    ) -> f64 {
        let moved =
            row.iter().map(|(_, offset)| (after.position_m(*offset) - before.position_m(*offset)).norm());
        let mean_m = moved.sum::<f64>() / row.len().max(1) as f64;
        self.frames += u32::from(round == 0);
        self.sum_m[round] += mean_m;
        mean_m
    }

    /// Mean step of each iteration over all frames, m: Fig. 5. A frame that has converged counts as 0.
    pub fn mean_m(&self) -> [f64; ROUNDS] {
        self.sum_m.map(|sum| sum / f64::from(self.frames.max(1)))
    }
}

/// The pole over a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// One for each frame; none where fewer than three sensors were measured.
    pub poles: Vec<Option<Pole>>,
    /// How the filter's updates converged.
    pub steps: Steps,
}
