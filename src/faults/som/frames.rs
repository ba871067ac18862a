//! Frames of positions: the table's rows, ordered for maps and rules.

use crate::table::Poses;

/// Positions of all sensors at all times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frames {
    /// Names of the sensors.
    pub sensors: Vec<String>,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Positions (m, transmitter axes turned z up), frame by frame in the order of the sensors; NaN where missing.
    pub positions_m: Vec<f64>,
}

impl Frames {
    /// Sorts poses into frames: rows of equal time, a second row of the same sensor beginning a new one.
    pub fn of(poses: &Poses) -> Self {
        let width = 3 * poses.sensors.len();
        let mut frames = Self { sensors: poses.sensors.clone(), ..Self::default() };
        let mut seen = vec![false; poses.sensors.len()];
        for row in &poses.rows {
            let new = frames.t_s.last().is_none_or(|last| *last != row.t_s) || seen[row.sensor];
            if new {
                frames.t_s.push(row.t_s);
                frames.positions_m.resize(frames.positions_m.len() + width, f64::NAN);
                seen.fill(false);
            }
            seen[row.sensor] = true;
            if let Some(position) = row.position_m {
                let start = frames.positions_m.len() - width + 3 * row.sensor;
                frames.positions_m[start..start + 3].copy_from_slice(&position);
            }
        }
        frames
    }

    /// Appends a frame: three numbers a sensor, NaN where missing.
    ///
    /// # Panics
    /// `positions_m` does not hold three numbers a sensor.
    pub fn push(&mut self, t_s: f64, positions_m: &[f64]) {
        assert_eq!(positions_m.len(), 3 * self.sensors.len());
        self.t_s.push(t_s);
        self.positions_m.extend_from_slice(positions_m);
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Positions of one frame, three numbers a sensor.
    pub fn frame(&self, index: usize) -> &[f64] {
        let width = 3 * self.sensors.len();
        &self.positions_m[index * width..(index + 1) * width]
    }

    /// The same, to be written.
    pub(super) fn frame_mut(&mut self, index: usize) -> &mut [f64] {
        let width = 3 * self.sensors.len();
        &mut self.positions_m[index * width..(index + 1) * width]
    }

    /// Positions of one sensor at all times.
    pub fn sensor(&self, sensor: usize) -> Vec<f64> {
        (0..self.len()).flat_map(|k| self.frame(k)[3 * sensor..3 * sensor + 3].to_vec()).collect()
    }

    /// The same frames in another order of sensors; `None` unless the names are the same.
    pub fn in_order_of(&self, sensors: &[String]) -> Option<Self> {
        (sensors.len() == self.sensors.len()).then_some(())?;
        let find = |name: &String| self.sensors.iter().position(|own| own == name);
        let order: Vec<usize> = sensors.iter().map(find).collect::<Option<_>>()?;
        let frame = |k: usize| {
            let frame = self.frame(k);
            order.iter().flat_map(|sensor| frame[3 * sensor..3 * sensor + 3].to_vec()).collect::<Vec<_>>()
        };
        let positions_m = (0..self.len()).flat_map(frame).collect();
        Some(Self { sensors: sensors.to_vec(), t_s: self.t_s.clone(), positions_m })
    }
}
