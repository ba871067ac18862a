//! One sensor's tracker: the track that is believed, and the one that may replace it.

use posed_geometry::Timestamp;
use posed_state::Plain;

use super::track::{Track, Tuning};
use crate::faults::{Checked, Gate, MeasuredPose, Prediction, Verdict};
use crate::noise::TrackerNoise;

/// How long a track goes on without a measurement, s.
const COAST_S: f64 = 0.5;
/// Agreeing records that begin a track: two leave the velocity to whatever error one of them had.
const RECORDS_TO_BEGIN: u32 = 3;
/// Agreeing records outside the gate that replace a track: the sensor was taken elsewhere.
const RECORDS_TO_REPLACE: u32 = 5;

/// A track in waiting.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Candidate {
    track: Track,
    records: u32,
}

/// Tracker of one magnetic sensor: position, velocity, orientation and angular velocity in the transmitter frame, at any time
/// asked for, without delay. Method: `docs/methods/magnetic-pose.md`; what faults cost: `docs/fault-tolerance.md`.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Tracker {
    tuning: Tuning,
    noise: TrackerNoise,
    track: Option<Track>,
    candidate: Option<Candidate>,
}

impl Tracker {
    /// A tracker that has seen nothing; three agreeing measurements begin a track.
    pub fn new(noise: TrackerNoise, tuning: Tuning) -> Self {
        Self { tuning, noise, track: None, candidate: None }
    }

    /// Noise model in use, without the factors that the filter has learnt.
    pub fn noise(&self) -> &TrackerNoise {
        &self.noise
    }

    /// Swaps in a measured noise model; from then on nothing is learnt about it.
    pub fn set_noise(&mut self, noise: TrackerNoise) {
        self.noise = noise;
        self.tuning.noise_scale_max = 1.0;
    }

    /// Sets the nominal interval of measurements, s, held within 1 ms to 0.2 s.
    pub fn set_interval_s(&mut self, interval_s: f64) {
        self.tuning.interval_s = interval_s.clamp(1e-3, 0.2);
    }

    /// Sets what the field map leaves of the next measurement's position (variance per axis, m²), and whether the field is
    /// disturbed: then nothing is learnt about the noise.
    pub fn set_doubt(&mut self, position_doubt_m2: f64, disturbed: bool) {
        self.tuning.position_doubt_m2 = position_doubt_m2;
        self.tuning.disturbed = disturbed;
    }

    /// What is expected of a measurement at `t`, transmitter frame; `None` where [`Self::at`] has no track.
    pub fn expectation(&self, t: Timestamp) -> Option<Prediction> {
        self.at(t).map(|track| track.expectation(&self.tuning))
    }

    /// The track moved to `t` ([`Track::predicted`]). `None` before three agreeing measurements, and more than
    /// 0.5 s after the latest measurement that was used.
    pub fn at(&self, t: Timestamp) -> Option<Track> {
        let track = self.track.as_ref()?;
        (t.seconds_since(track.t()) <= COAST_S).then(|| track.predicted(t, &self.tuning))
    }

    /// Takes a checked measurement at its own capture time; times must not go back.
    ///
    /// [`Verdict::Dropped`] where it is withheld, [`Verdict::Used`] inside the gate (99.9 % of chi squared). What is outside
    /// it is [`Verdict::Suspect`] until enough records in a row agree with one another: three where nothing is tracked or the
    /// step was long though inside the gate, five where they contradict the track, which they then replace.
    pub fn push(&mut self, t: Timestamp, checked: &Checked) -> Verdict {
        let pose = &checked.pose;
        if checked.withheld {
            return Verdict::Dropped;
        }
        let Some(mut track) = self.at(t) else {
            self.track = None;
            return self.consider(t, pose, RECORDS_TO_BEGIN);
        };
        match track.expectation(&self.tuning).gate(pose, &self.noise) {
            Gate::Inside => {
                track.update(pose, &self.noise, &self.tuning);
                self.track = Some(track);
                self.candidate = None;
                Verdict::Used
            }
            Gate::Loose => self.consider(t, pose, RECORDS_TO_BEGIN),
            Gate::Outside => self.consider(t, pose, RECORDS_TO_REPLACE),
        }
    }

    /// Adds a measurement to the candidate; it becomes the track once `needed` records agree.
    fn consider(&mut self, t: Timestamp, pose: &MeasuredPose, needed: u32) -> Verdict {
        let continued = self.candidate.and_then(|candidate| {
            let mut track = candidate.track.predicted(t, &self.tuning);
            let fresh = t.seconds_since(candidate.track.t()) <= COAST_S;
            let agrees = track.expectation(&self.tuning).gate(pose, &self.noise) != Gate::Outside;
            (fresh && agrees).then(|| {
                track.update(pose, &self.noise, &self.tuning);
                Candidate { track, records: candidate.records + 1 }
            })
        });
        let candidate = continued.unwrap_or_else(|| Candidate {
            track: Track::new(t, pose, &self.noise, &self.tuning),
            records: 1,
        });
        if candidate.records >= needed {
            self.track = Some(candidate.track);
            self.candidate = None;
            Verdict::Used
        } else {
            self.candidate = Some(candidate);
            Verdict::Suspect
        }
    }
}

#[cfg(test)]
#[path = "tracker_tests.rs"]
mod tests;
