//! A guided run with the pole: what has been collected, and what to do next.
//!
//! What comes in: what each sensor of the pole read at each frame. What goes out: once a second how far it is and what
//! to do next, and at the end the recording for [`super::solve()`]. What it never does: solve, or use what is not believed.

use nalgebra::Vector3;
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::coverage::{self, Ask};
use super::hull::Hull;
use super::pole::{PoleFrame, PoleReading, PoleRun};
use super::problem::line;

/// Distance of the frames that are kept, s: neighbours say the same, and a minute is solved in seconds.
const KEEP_S: f64 = 0.03;
/// Every so many of these are looked at for coverage; distance of two reports, s.
const LOOK_AT: usize = 6;
const REPORT_S: f64 = 1.0;
/// Longest run, frames: ten minutes.
const MOST_FRAMES: usize = 20_000;

/// Instants without which the solver would not begin, with room for those that it will not believe.
const LEAST_INSTANTS: usize = 300;

/// How far a run is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Progress {
    /// False once the run has ended: it is the last of its reports.
    pub collecting: bool,
    /// The pole's sensors in their order along it.
    pub sensors: Vec<String>,
    /// Time since the first reading, s.
    pub seconds: f64,
    /// Instants with readings of three sensors or more.
    pub instants: usize,
    /// Share of the 20 cm cells inside the hull that the pole came near, 0 to 1.
    pub covered: f64,
    /// Share of the four pairs of opposite octants in which the pole was held, 0 to 1.
    pub directions: f64,
    /// Middles of cells inside the hull that it did not come near, at most 60, transmitter frame, m.
    pub unvisited_m: Vec<[f64; 3]>,
    /// Rms distance of the last second's readings from a straight pole of the stated spacing, m: what there is to correct.
    pub residual_m: f64,
    /// What to do next; empty when there is enough.
    pub hint: String,
    /// The same for programs; null when there is enough.
    #[serde(default)]
    pub asks: Option<Ask>,
}

/// A guided run in progress: collects frames, and states once a second what is still missing.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Guide {
    run: PoleRun,
    /// A part of it, for coverage.
    thin: PoleRun,
    kept_s: Option<f64>,
    reported_s: Option<f64>,
    squares: f64,
    readings: f64,
}

impl Guide {
    /// Begins a run. `sensors`: names in their order along the pole; `spacing_m`: measured distance of neighbours.
    /// Neither is checked here: `PoleRun::check_order` does that.
    pub fn new(sensors: Vec<String>, spacing_m: f64) -> Self {
        let run = PoleRun { sensors, spacing_m, frames: Vec::new() };
        Self { thin: run.clone(), run, kept_s: None, reported_s: None, squares: 0.0, readings: 0.0 }
    }

    /// Takes a frame at time `t_s` (s, rising). `reading`: what the sensor of that index along the pole read, `None`
    /// where it is missing or not believed. `emit` gets the progress once a second.
    ///
    /// A frame less than 0.03 s after the last one kept is left out, one with fewer than three sensors is not recorded,
    /// and nothing is kept beyond 20,000 frames (ten minutes).
    pub fn push(
        &mut self,
        t_s: f64,
        reading: impl Fn(usize) -> Option<PoleReading>,
        emit: &mut dyn FnMut(Progress),
    ) {
        if self.kept_s.is_some_and(|kept| t_s < kept + KEEP_S) || self.run.frames.len() >= MOST_FRAMES {
            return;
        }
        let readings: Vec<Option<PoleReading>> = (0..self.run.sensors.len()).map(reading).collect();
        self.kept_s = Some(t_s);
        if readings.iter().flatten().count() >= 3 {
            let frame = PoleFrame { t_s, readings };
            self.measure(&frame);
            if self.run.frames.len().is_multiple_of(LOOK_AT) {
                self.thin.frames.push(frame.clone());
            }
            self.run.frames.push(frame);
        }
        let reported = *self.reported_s.get_or_insert(t_s);
        if t_s >= reported + REPORT_S {
            self.reported_s = Some(t_s);
            emit(self.progress(true));
        }
    }

    fn measure(&mut self, frame: &PoleFrame) {
        let mut row = Vec::new();
        self.run.row(frame, &mut row);
        let (points, offsets): (Vec<Vector3<f64>>, Vec<f64>) = row.into_iter().unzip();
        let (middle, along) = line(&points, &offsets);
        self.squares +=
            points.iter().zip(&offsets).map(|(p, at)| (p - middle - along * *at).norm_squared()).sum::<f64>();
        self.readings += points.len() as f64;
    }

    /// How far the run is; `collecting`: whether it goes on. The residual is that of the readings since the last call,
    /// which begins a new average.
    pub fn progress(&mut self, collecting: bool) -> Progress {
        let residual_m = (self.squares / self.readings.max(1.0)).sqrt();
        (self.squares, self.readings) = (0.0, 0.0);
        let instants = self.run.frames.len();
        let frames = &self.run.frames;
        let seconds = match (frames.first(), frames.last()) {
            (Some(first), Some(last)) => last.t_s - first.t_s,
            _ => 0.0,
        };
        let points: Vec<Vector3<f64>> =
            self.thin.readings().map(|(_, _, reading)| reading.position_m).collect();
        let coverage = Hull::new(points.iter()).map(|hull| coverage::look(&self.thin, &hull));
        let asks = match &coverage {
            None if instants == 0 => Some(Ask::Show),
            None => Some(Ask::Move),
            Some(coverage) => {
                coverage.asks.first().copied().or((instants < LEAST_INSTANTS).then_some(Ask::GoOn))
            }
        };
        let coverage = coverage.unwrap_or_default();
        Progress {
            collecting,
            sensors: self.run.sensors.clone(),
            seconds,
            instants,
            covered: coverage.cells,
            directions: coverage.directions,
            unvisited_m: coverage.unvisited_m.into_iter().map(Into::into).collect(),
            residual_m,
            hint: asks.map(|asks| asks.to_string()).unwrap_or_default(),
            asks,
        }
    }

    /// The recording so far, for `solve`.
    pub fn run(&self) -> &PoleRun {
        &self.run
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn given_a_pole_that_stands_still_the_hint_says_what_to_do() {
        let mut guide = Guide::new(["a", "b", "c", "d"].map(String::from).to_vec(), 0.3);
        let mut emitted = Vec::new();
        for k in 0..3000 {
            let reading = |sensor: usize| {
                let position_m = Vector3::new(1.0, 0.0, 0.3 * sensor as f64 + 0.001 * f64::from(k % 7));
                Some(PoleReading { position_m, orientation: None })
            };
            guide.push(f64::from(k) / 100.0, reading, &mut |progress| emitted.push(progress));
        }
        assert!((28..=30).contains(&emitted.len()), "{}", emitted.len());
        let last = emitted.last().unwrap();
        assert!(last.hint.contains("moved only") || last.hint.contains("hardly ever"), "{last:?}");
        assert!(last.residual_m < 1e-6 && last.seconds > 28.0 && last.instants > 500);
        assert!(guide.run().frames.len() >= last.instants);
    }
}
