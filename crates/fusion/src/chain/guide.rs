//! Guides somebody through the calibration of a chain of hinges.
//!
//! In: samples of all its IMUs as they come. Out: what to do next, in words; in the end a recording that begins with the posture
//! that counts as zero and goes on with a movement of all hinges. It has no clock: time is that of the samples.

use nalgebra::Vector3;

use super::Epoch;

/// For so long the zero posture is held, s, with angular velocities that differ by less from their mean, rad/s.
const HOLD_S: f64 = 1.5;
const STILL_RAD_S: f64 = 0.15;
/// For so long the chain is to move, s, with angular velocities above this, rad/s.
const MOVE_S: f64 = 30.0;
const MOVES_RAD_S: f64 = 0.3;

/// A calibration on its way: 1.5 s of stillness, then 30 s of movement.
#[derive(Clone, Debug, Default)]
pub struct Guide {
    epochs: Vec<Epoch>,
    held: bool,
    moved_s: f64,
}

impl Guide {
    /// Longest calibration, s; it is for the caller to stop then.
    pub const LONGEST_S: f64 = 300.0;

    /// Takes the samples of one time, one per segment; times that do not rise change nothing. Whoever moves before the zero
    /// posture has been held begins that anew.
    pub fn push(&mut self, epoch: Epoch) {
        let since_s = self.epochs.last().map_or(0.0, |last| epoch.t_s - last.t_s);
        if since_s < 0.0 || (since_s == 0.0 && !self.epochs.is_empty()) {
            return;
        }
        let gyros_rad_s = || epoch.samples.iter().flatten().map(|sample| sample.gyro_rad_s);
        if self.held {
            if gyros_rad_s().map(|w| w.norm()).fold(0.0, f64::max) > MOVES_RAD_S {
                self.moved_s += since_s.min(0.1);
            }
        } else if let Some(first) = self.epochs.first() {
            let apart = |(a, b): (&Option<_>, &Option<_>)| match (a, b) {
                (Some(a), Some(b)) => distance(a, b),
                _ => 0.0,
            };
            if first.samples.iter().zip(&epoch.samples).map(apart).fold(0.0, f64::max) > STILL_RAD_S {
                self.epochs.clear();
            }
        }
        self.epochs.push(epoch);
        let span_s = self.epochs.first().zip(self.epochs.last()).map_or(0.0, |(a, b)| b.t_s - a.t_s);
        self.held |= span_s >= HOLD_S;
    }

    /// How far it is, 0 to 1: 0 until the zero posture has been held, 0.1 then.
    pub fn progress(&self) -> f64 {
        if self.held { 0.1 + 0.9 * (self.moved_s / MOVE_S).min(1.0) } else { 0.0 }
    }

    /// What to do now, a sentence without a full stop; `None` once all is done.
    pub fn prompt(&self) -> Option<&'static str> {
        match (self.held, self.moved_s < MOVE_S) {
            (false, _) => Some("1 of 2: Hold all hinges as they are to count as zero, and keep still"),
            (true, true) => Some(
                "2 of 2: Bend every hinge to and fro, turn the whole chain about all its axes, and go on",
            ),
            (true, false) => None,
        }
    }

    /// What was recorded so far, the zero posture first, for [`super::calibrate::calibrate`].
    pub fn recorded(&self) -> &[Epoch] {
        &self.epochs
    }
}

fn distance(a: &crate::ahrs::ImuSample, b: &crate::ahrs::ImuSample) -> f64 {
    let apart: Vector3<f64> = a.gyro_rad_s - b.gyro_rad_s;
    apart.norm()
}
