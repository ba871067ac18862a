//! Frames of poses, ordered for maps and rules.

use super::pairs::quantile;

/// One frame: what all sensors report at one time, in the order of their names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame<'a> {
    /// x, y, z of each sensor, m, in transmitter axes turned z up; NaN where missing.
    pub positions_m: &'a [f64],
    /// w, x, y, z of each sensor: sensor to the same axes, of unit norm; NaN where missing. Empty where nobody knows any.
    pub orientations_wxyz: &'a [f64],
}

/// Positions of all sensors at all times, one row per frame, and their orientations where these are known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frames {
    /// Names of the sensors, in the order of the positions.
    pub sensors: Vec<String>,
    /// Times, s, one per frame; learning counts frames, so that they should be evenly spaced.
    pub t_s: Vec<f64>,
    /// Positions (m, transmitter axes turned z up): x, y, z of each sensor, frame by frame; NaN where missing.
    pub positions_m: Vec<f64>,
    /// Orientations (sensor to the same axes, unit quaternions): w, x, y, z of each sensor, frame by frame; NaN where missing. Empty where nobody knows any.
    pub orientations_wxyz: Vec<f64>,
}

impl Frames {
    /// Appends a frame at `t_s` (s): x, y, z of each sensor, m, NaN where missing. Orientations are unknown.
    ///
    /// # Panics
    /// `positions_m` does not hold three numbers a sensor; or other frames have orientations.
    pub fn push(&mut self, t_s: f64, positions_m: &[f64]) {
        self.push_poses(t_s, Frame { positions_m, orientations_wxyz: &[] });
    }

    /// Appends a frame at `t_s` (s).
    ///
    /// # Panics
    /// It does not hold three numbers a sensor and four of its orientation, or none of these where other frames have none.
    pub fn push_poses(&mut self, t_s: f64, frame: Frame<'_>) {
        assert_eq!(frame.positions_m.len(), 3 * self.sensors.len());
        assert!(self.is_empty() || self.orientations_wxyz.is_empty() == frame.orientations_wxyz.is_empty());
        assert!([0, 4 * self.sensors.len()].contains(&frame.orientations_wxyz.len()));
        self.t_s.push(t_s);
        self.positions_m.extend_from_slice(frame.positions_m);
        self.orientations_wxyz.extend_from_slice(frame.orientations_wxyz);
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// The usual time from one frame to the next, s; 0 for fewer than two frames.
    pub fn interval_s(&self) -> f64 {
        quantile(&mut self.t_s.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<_>>(), 0.5)
    }

    /// How many frames should be between one and that before it, by their times and the usual interval, s.
    ///
    /// # Panics
    /// There is no such frame.
    pub fn missing_before(&self, index: usize, interval_s: f64) -> usize {
        let since_s = index.checked_sub(1).map_or(0.0, |before| self.t_s[index] - self.t_s[before]);
        if interval_s > 0.0 { ((since_s / interval_s).round() - 1.0).max(0.0) as usize } else { 0 }
    }

    /// One frame.
    ///
    /// # Panics
    /// There is no such frame.
    pub fn frame(&self, index: usize) -> Frame<'_> {
        let width = 4 * self.sensors.len();
        let orientations_wxyz = match self.orientations_wxyz.is_empty() {
            true => &[][..],
            false => &self.orientations_wxyz[index * width..(index + 1) * width],
        };
        Frame { positions_m: self.positions(index), orientations_wxyz }
    }

    /// Positions of one frame, m: x, y, z of each sensor, NaN where missing.
    ///
    /// # Panics
    /// There is no such frame.
    pub fn positions(&self, index: usize) -> &[f64] {
        let width = 3 * self.sensors.len();
        &self.positions_m[index * width..(index + 1) * width]
    }

    /// The same, to be written.
    pub(super) fn positions_mut(&mut self, index: usize) -> &mut [f64] {
        let width = 3 * self.sensors.len();
        &mut self.positions_m[index * width..(index + 1) * width]
    }

    /// Positions of one sensor at all times, m: x, y, z frame by frame, NaN where missing.
    ///
    /// # Panics
    /// There are frames but no such sensor.
    pub fn sensor(&self, sensor: usize) -> Vec<f64> {
        (0..self.len()).flat_map(|k| self.positions(k)[3 * sensor..3 * sensor + 3].to_vec()).collect()
    }

    /// The same frames with the sensors in another order; `None` unless the names are the same.
    pub fn in_order_of(&self, sensors: &[String]) -> Option<Self> {
        (sensors.len() == self.sensors.len()).then_some(())?;
        let find = |name: &String| self.sensors.iter().position(|own| own == name);
        let order: Vec<usize> = sensors.iter().map(find).collect::<Option<_>>()?;
        let reorder = |values: &[f64], numbers: usize| -> Vec<f64> {
            let row = |row: &[f64]| {
                let of = |sensor: &usize| row[numbers * sensor..numbers * (sensor + 1)].to_vec();
                order.iter().flat_map(of).collect::<Vec<_>>()
            };
            values.chunks_exact((numbers * order.len()).max(1)).flat_map(row).collect()
        };
        Some(Self {
            sensors: sensors.to_vec(),
            t_s: self.t_s.clone(),
            positions_m: reorder(&self.positions_m, 3),
            orientations_wxyz: reorder(&self.orientations_wxyz, 4),
        })
    }
}
