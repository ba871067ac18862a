//! Guides somebody through the calibration of one IMU, and notices by itself which directions were held.
//!
//! In: the unit's own samples as they come, uncorrected. Out: what is still missing and what to do next, in words; in the end
//! the intrinsics. It has no clock: time is that of the samples.

use nalgebra::Vector3;

use super::super::ahrs::ImuSample;
use super::rests::{Directions, RestFinder, SIDES};
use super::{CROSS_DIRECTIONS, Intrinsics, IntrinsicsError, MIN_DIRECTIONS, fit, solve};

/// From so much on of the sphere the field was seen all around.
const SEEN_ENOUGH: f64 = 0.01;
/// A field this far from the last one, as a part of it, is a new one.
const NEW_FIELD: f64 = 0.05;
/// Fields that are kept.
const MOST_FIELDS: usize = 20_000;
/// The unit rests, as far as one can see after this long, s.
const SEEMS_TO_REST_S: f64 = 0.4;

/// A calibration of one unit on its way, from its samples as it sends them.
#[derive(Clone, Debug)]
pub struct Guide {
    magnetometer: bool,
    finder: RestFinder,
    rests: Vec<super::rests::Rest>,
    directions: Directions,
    fields: Vec<Vector3<f64>>,
    /// Of the fields, looked at now and then.
    seen: f64,
    /// Times of the first sample, of the newest, and of the newest thing that was new, s.
    times_s: Option<[f64; 3]>,
    /// The last rest was in a direction that was held before.
    again: bool,
}

/// What somebody is asked to do with the unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// Turn it on: it rests in a direction that is known.
    Another,
    /// Leave it as it is.
    Keep,
    /// Place it on a side that was not up yet.
    Side,
    /// Lean it on an edge or a corner.
    Edge,
    /// Turn it through all directions of the field.
    Field,
}

impl Ask {
    /// Its word for programs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Another => "another",
            Self::Keep => "keep",
            Self::Side => "side",
            Self::Edge => "edge",
            Self::Field => "field",
        }
    }
}

/// How far a calibration is.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Directions held at rest, at least 20 degrees apart.
    pub directions: usize,
    /// Directions that are asked for: 12.
    pub wanted: usize,
    /// Which of [`SIDES`] were up, to 40 degrees.
    pub sides: [bool; 6],
    /// How much of the sphere the field was seen in, as a part of what it takes, 0 to 1; `None` without a magnetometer.
    pub field: Option<f64>,
}

impl Guide {
    /// Without a new direction for so long nobody is at work any more, s; it is for the caller to stop then.
    pub const PATIENCE_S: f64 = 60.0;
    /// Longest calibration, s; it is for the caller to stop then.
    pub const LONGEST_S: f64 = 600.0;

    /// A calibration that has seen nothing; with `magnetometer` the field is fitted too, and asked for.
    pub fn new(magnetometer: bool) -> Self {
        Self {
            magnetometer,
            finder: RestFinder::default(),
            rests: Vec::new(),
            directions: Directions::default(),
            fields: Vec::new(),
            seen: 0.0,
            times_s: None,
            again: false,
        }
    }

    /// A sample at its capture time, s, not corrected. Numbers that are not finite and times that go back change nothing.
    pub fn push(&mut self, t_s: f64, sample: &ImuSample) {
        let finite = sample.gyro_rad_s.iter().chain(sample.accel_m_s2.iter()).all(|value| value.is_finite());
        let [_, newest_s, new_s] = self.times_s.get_or_insert([t_s; 3]);
        if !finite || t_s < *newest_s {
            return;
        }
        *newest_s = t_s;
        if let Some(rest) = self.finder.push(t_s, sample) {
            self.again = !self.directions.push(&rest);
            if !self.again {
                *new_s = t_s;
            }
            self.rests.push(rest);
        }
        let field =
            sample.mag.filter(|field| self.magnetometer && field.iter().all(|value| value.is_finite()));
        if let Some(field) = field
            && self.fields.len() < MOST_FIELDS
            && self.fields.last().is_none_or(|last| (field - last).norm() > NEW_FIELD * field.norm())
        {
            self.fields.push(field);
            if self.fields.len().is_multiple_of(20) {
                let seen = fit::seen(&self.fields);
                if seen > self.seen * 1.1 {
                    *new_s = t_s;
                }
                self.seen = seen;
            }
        }
    }

    /// How far it is, by the samples so far; [`Self::prompt`] gives the next step.
    pub fn progress(&self) -> Progress {
        Progress {
            directions: self.directions.len(),
            wanted: CROSS_DIRECTIONS,
            sides: self.directions.sides(),
            field: self.magnetometer.then(|| (self.seen / SEEN_ENOUGH).min(1.0)),
        }
    }

    /// What to do now; `None` once all is done.
    pub fn asks(&self) -> Option<Ask> {
        let Progress { directions, wanted, sides, field } = self.progress();
        let rests = self.finder.resting_s() > SEEMS_TO_REST_S;
        let a_side_is_missing = sides.contains(&false);
        if self.again && rests && (directions < wanted || a_side_is_missing) {
            return Some(Ask::Another);
        }
        if rests && directions < wanted {
            return Some(Ask::Keep);
        }
        if a_side_is_missing {
            return Some(Ask::Side);
        }
        if directions < wanted {
            return Some(Ask::Edge);
        }
        field.filter(|field| *field < 1.0).map(|_| Ask::Field)
    }

    /// The same as a sentence without a full stop.
    pub fn prompt(&self) -> Option<String> {
        let Progress { directions, wanted, sides, field } = self.progress();
        let count = format!("{directions} of {wanted} directions");
        self.asks().map(|asks| match asks {
            Ask::Another => format!("{count}: this one is known; turn the unit to another side or edge"),
            Ask::Keep => format!("{count}: leave it as it is"),
            Ask::Side => {
                let missing: Vec<&str> =
                    SIDES.iter().zip(sides).filter(|(_, held)| !held).map(|(name, _)| *name).collect();
                let sides = missing.join(", ");
                format!("{count}: place the unit on another side and let it rest for 2 s; still to be up: {sides}")
            }
            Ask::Edge => format!("{count}: lean the unit on an edge or a corner and let it rest for 2 s"),
            Ask::Field => format!(
                "the field was seen in {:.0} % of what it takes: turn the unit slowly through all directions, away from iron",
                100.0 * field.unwrap_or_default()
            ),
        })
    }

    /// How long it has been at work, and how long nothing new came, s; zero before the first sample.
    pub fn times_s(&self) -> (f64, f64) {
        self.times_s.map_or((0.0, 0.0), |[first, newest, new]| (newest - first, newest - new))
    }

    /// Whether the directions are enough for [`Self::solve`] (nine, all six sides), though more were asked for.
    pub fn would_do(&self) -> bool {
        self.directions.len() >= MIN_DIRECTIONS && self.directions.sides().iter().all(|held| *held)
    }

    /// The intrinsics by what was seen so far, with [`Intrinsics::unit`] absent; the same as [`super::calibrate`] finds, but
    /// that of fields only those are kept that differ by 5 %.
    ///
    /// # Errors
    /// As [`super::calibrate`]: directions that are missing, rests that disagree, or a magnetometer that saw too little.
    pub fn solve(&self) -> Result<Intrinsics, IntrinsicsError> {
        if self.magnetometer && self.fields.is_empty() && self.would_do() {
            return Err(IntrinsicsError::Ellipsoid);
        }
        solve(&self.rests, &self.fields)
    }
}
