//! The stuck test: a device that repeats its last words.
//!
//! A magnetic sensor hardly ever says the same twice: noise stirs the last digit of one word or another. But
//! near the transmitter the noise is below the words' step, and a sensor at rest may say the same for
//! minutes. So repetition alone is no fault; it is one where the words should have changed: because the
//! sensor itself was moving, or because others move and this one used to stir.

use serde::{Deserialize, Serialize};

use super::{Label, MeasuredPose, Prediction};
use crate::noise::TrackerNoise;

/// So many equal records in a row are stuck.
const STUCK_RECORDS: u32 = 5;
/// How much a predicted pose must differ from the repeated one to prove motion: sigmas, m, rad.
const MOVED_SIGMAS: f64 = 2.0;
const MOVED_M: f64 = 2e-4;
const MOVED_RAD: f64 = 1e-3;
/// Weight of one record in the habit of stirring, and the habit from which on repetition is unusual.
const HABIT_WEIGHT: f64 = 1.0 / 64.0;
const STIRRING: f64 = 0.5;

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Repetition {
    last: Option<MeasuredPose>,
    run: u32,
    /// Share of records that differed from the one before; starts at one: presumed to stir.
    habit: f64,
    /// Labelled since the words stopped changing; stays until they change.
    labelled: bool,
}

impl Default for Repetition {
    fn default() -> Self {
        Self { last: None, run: 0, habit: 1.0, labelled: false }
    }
}

impl Repetition {
    /// `raw` are the device's words, `seen` the same pose on the side where the filter has it.
    pub(super) fn check(
        &mut self,
        raw: &MeasuredPose,
        seen: &MeasuredPose,
        prediction: Option<&Prediction>,
        noise: &TrackerNoise,
        others_move: bool,
    ) -> Option<Label> {
        let same = self.last.as_ref() == Some(raw);
        self.last = Some(*raw);
        if !same {
            self.habit += HABIT_WEIGHT * (1.0 - self.habit);
            self.run = 1;
            self.labelled = false;
            return None;
        }
        self.run += 1;
        let moved = prediction.is_some_and(|prediction| has_moved(prediction, seen, noise));
        let unusual = others_move && self.habit > STIRRING && self.run >= STUCK_RECORDS;
        if self.labelled || moved || unusual {
            self.labelled = true;
            return Some(if self.run >= STUCK_RECORDS { Label::Stuck } else { Label::Repeated });
        }
        self.habit -= HABIT_WEIGHT * self.habit;
        None
    }
}

fn has_moved(prediction: &Prediction, seen: &MeasuredPose, noise: &TrackerNoise) -> bool {
    let position = seen.position_m.is_some_and(|position| {
        let sigma = (noise.position_m2(&position).trace() / 3.0 * prediction.position_noise_scale).sqrt();
        prediction.position_innovation(&position).norm() > (MOVED_SIGMAS * sigma).max(MOVED_M)
    });
    let rotation = seen.orientation.is_some_and(|orientation| {
        let place = seen.position_m.as_ref();
        let sigma = (noise.rotation_rad2(place).trace() / 3.0 * prediction.rotation_noise_scale).sqrt();
        prediction.rotation_innovation(&orientation).norm() > (MOVED_SIGMAS * sigma).max(MOVED_RAD)
    });
    position || rotation
}
