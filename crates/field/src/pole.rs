//! A recording of the pole: all sensors' readings, instant by instant.
//!
//! What comes in: rows of readings in the transmitter frame. What goes out: frames with one slot per sensor, in the
//! order along the pole. The order is that of first appearance, and is checked against the readings, for a swapped
//! pair bends every map.

use nalgebra::{UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::problem::{MAX_SENSORS, line};

/// One sensor at one time, as measured.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct PoleReading {
    /// Position in the transmitter frame, m.
    pub position_m: Vector3<f64>,
    /// Sensor to transmitter, where the device reports it.
    pub orientation: Option<UnitQuaternion<f64>>,
}

/// All sensors at one time.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct PoleFrame {
    /// Time, s; only differences matter.
    pub t_s: f64,
    /// One slot per sensor in the order along the pole; empty where it was not measured, or is not believed.
    pub readings: Vec<Option<PoleReading>>,
}

/// A recording of the calibration pole (wand): sensors on a straight line at equal distances.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct PoleRun {
    /// Names of the sensors in the order along the pole.
    pub sensors: Vec<String>,
    /// Measured distance between neighbouring sensors, m. It is never estimated from the readings.
    pub spacing_m: f64,
    /// The frames, in order of time.
    pub frames: Vec<PoleFrame>,
}

/// Why readings are no recording of a pole.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Serialize, Deserialize)]
pub enum PoleError {
    /// Too few sensors, or more than can be.
    #[error("a pole has 3 to {MAX_SENSORS} sensors, found {0}")]
    Sensors(usize),
    /// The spacing is no length.
    #[error("the spacing of the sensors must be a length above 0 m, found {0} m")]
    Spacing(f64),
    /// Nothing to work with.
    #[error("no time at which three sensors of the pole were measured")]
    Empty,
    /// The order along the pole is another one.
    #[error(
        "the sensors do not stand in the order {given}; the readings say {found}. List them in their order along \
         the pole"
    )]
    Order {
        /// Order of first appearance.
        given: String,
        /// Order that the readings show.
        found: String,
    },
}

impl PoleRun {
    /// Groups readings by time and checks the order of the sensors.
    ///
    /// `rows`: time (s), index in `sensors`, reading (transmitter frame, m); rows of one time follow each other. Rows
    /// with an unknown sensor, a number that is not finite or a position within 1 mm of the transmitter are left out.
    ///
    /// # Errors
    /// The spacing is not above 0; there are fewer than 3 or more than `MAX_SENSORS` sensors; no frame has three
    /// sensors; the readings show another order along the pole.
    pub fn new(
        sensors: Vec<String>,
        spacing_m: f64,
        rows: impl IntoIterator<Item = (f64, usize, PoleReading)>,
    ) -> Result<Self, PoleError> {
        let run = Self::grouped(sensors, spacing_m, rows)?;
        run.check_order()?;
        Ok(run)
    }

    /// Groups readings by time like `PoleRun::new`, whatever the sensors sit on: order and number of sensors are not
    /// checked.
    ///
    /// # Errors
    /// The spacing is not a finite length above 0 m.
    pub fn grouped(
        sensors: Vec<String>,
        spacing_m: f64,
        rows: impl IntoIterator<Item = (f64, usize, PoleReading)>,
    ) -> Result<Self, PoleError> {
        let count = sensors.len();
        if !(spacing_m.is_finite() && spacing_m > 0.0) {
            return Err(PoleError::Spacing(spacing_m));
        }
        let mut frames: Vec<PoleFrame> = Vec::new();
        for (t_s, sensor, reading) in rows {
            let believable =
                reading.position_m.iter().all(|x| x.is_finite()) && reading.position_m.norm() > 1e-3;
            if sensor >= count || !believable {
                continue;
            }
            match frames.last_mut() {
                Some(frame) if frame.t_s == t_s => frame.readings[sensor] = Some(reading),
                _ => {
                    let mut readings = vec![None; count];
                    readings[sensor] = Some(reading);
                    frames.push(PoleFrame { t_s, readings });
                }
            }
        }
        Ok(Self { sensors, spacing_m, frames })
    }

    /// Position of sensor `index` along the pole, from its middle, m: negative for the first half.
    pub fn offset_m(&self, index: usize) -> f64 {
        (index as f64 - (self.sensors.len() as f64 - 1.0) / 2.0) * self.spacing_m
    }

    /// Fills `into` with the position (transmitter frame, m) and the offset along the pole (m) of each reading that a
    /// frame holds; what was there before is removed.
    pub fn row(&self, frame: &PoleFrame, into: &mut Vec<(Vector3<f64>, f64)>) {
        into.clear();
        for (index, reading) in frame.readings.iter().enumerate() {
            if let Some(reading) = reading {
                into.push((reading.position_m, self.offset_m(index)));
            }
        }
    }

    /// All readings: frame, sensor, reading.
    pub(crate) fn readings(&self) -> impl Iterator<Item = (usize, usize, &PoleReading)> {
        self.frames.iter().enumerate().flat_map(|(frame, each)| {
            let readings = each.readings.iter().enumerate();
            readings
                .filter_map(move |(sensor, reading)| reading.as_ref().map(|reading| (frame, sensor, reading)))
        })
    }

    /// Checks the stated order of the sensors: each frame of three sensors or more says where along its own main
    /// direction each stands, and the medians are compared. The order from either end is right.
    ///
    /// # Errors
    /// Fewer than 3 or more than `MAX_SENSORS` sensors, no frame with three of them, or another order, which the error
    /// names.
    pub fn check_order(&self) -> Result<(), PoleError> {
        let count = self.sensors.len();
        if !(3..=MAX_SENSORS).contains(&count) {
            return Err(PoleError::Sensors(count));
        }
        let mut coordinates_m: Vec<Vec<f64>> = vec![Vec::new(); count];
        for frame in &self.frames {
            let known: Vec<(usize, Vector3<f64>)> = frame
                .readings
                .iter()
                .enumerate()
                .filter_map(|(k, reading)| reading.map(|reading| (k, reading.position_m)))
                .collect();
            if known.len() < 3 {
                continue;
            }
            let points: Vec<_> = known.iter().map(|(_, p)| *p).collect();
            let direction = main_direction(&points);
            let (mean, along) = {
                let offsets: Vec<f64> = known.iter().map(|(k, _)| self.offset_m(*k)).collect();
                let (_, guess) = line(&points, &offsets);
                let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
                (mean, if direction.dot(&guess) < 0.0 { -direction } else { direction })
            };
            for (k, p) in known {
                coordinates_m[k].push((p - mean).dot(&along));
            }
        }
        if coordinates_m.iter().all(Vec::is_empty) {
            return Err(PoleError::Empty);
        }
        let medians: Vec<f64> =
            coordinates_m.iter_mut().map(|values| median(values).unwrap_or(f64::NAN)).collect();
        let mut order: Vec<usize> = (0..count).filter(|k| medians[*k].is_finite()).collect();
        order.sort_by(|a, b| medians[*a].total_cmp(&medians[*b]));
        if order.windows(2).all(|pair| pair[0] < pair[1]) || order.windows(2).all(|pair| pair[0] > pair[1]) {
            return Ok(());
        }
        let names =
            |order: &[usize]| order.iter().map(|k| self.sensors[*k].as_str()).collect::<Vec<_>>().join(", ");
        Err(PoleError::Order { given: self.sensors.join(", "), found: names(&order) })
    }
}

/// Direction of the largest spread.
fn main_direction(points: &[Vector3<f64>]) -> Vector3<f64> {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let mut spread = nalgebra::Matrix3::zeros();
    for point in points {
        spread += (point - mean) * (point - mean).transpose();
    }
    let eigen = spread.symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
}

/// Middle value; sorts its input.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(order: [usize; 4]) -> Vec<(f64, usize, PoleReading)> {
        let mut rows = Vec::new();
        for frame in 0..20 {
            let direction = Vector3::new(libm::cos(frame as f64), libm::sin(frame as f64), 0.4).normalize();
            for (sensor, place) in order.into_iter().enumerate() {
                let position_m = Vector3::new(1.0, 0.2, 0.3) + direction * (0.3 * place as f64);
                rows.push((frame as f64, sensor, PoleReading { position_m, orientation: None }));
            }
        }
        rows
    }

    fn names() -> Vec<String> {
        ["a", "b", "c", "d"].map(String::from).to_vec()
    }

    #[test]
    fn sensors_in_order_from_either_end_are_a_pole() {
        let run = PoleRun::new(names(), 0.3, rows([0, 1, 2, 3])).unwrap();
        assert_eq!(run.frames.len(), 20);
        assert!((run.offset_m(0) + 0.45).abs() < 1e-12);
        assert!(PoleRun::new(names(), 0.3, rows([3, 2, 1, 0])).is_ok());
    }

    #[test]
    fn a_swapped_pair_is_refused_with_the_order_that_was_found() {
        let error = PoleRun::new(names(), 0.3, rows([0, 2, 1, 3])).unwrap_err();
        let PoleError::Order { found, .. } = error else { panic!("{error}") };
        assert!(found == "a, c, b, d" || found == "d, b, c, a", "{found}");
    }

    #[test]
    fn what_is_no_pole_is_refused() {
        assert!(PoleRun::new(names(), f64::NAN, rows([0, 1, 2, 3])).is_err());
        assert_eq!(PoleRun::new(names(), 0.3, []), Err(PoleError::Empty));
        assert_eq!(PoleRun::new(vec!["a".into()], 0.3, []), Err(PoleError::Sensors(1)));
    }
}
