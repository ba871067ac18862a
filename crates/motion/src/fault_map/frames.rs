//! Frames of positions, ordered for maps and rules.

/// Positions of all sensors at all times, one row per frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frames {
    /// Names of the sensors, in the order of the positions.
    pub sensors: Vec<String>,
    /// Times, s, one per frame; learning counts frames, so that they should be evenly spaced.
    pub t_s: Vec<f64>,
    /// Positions (m, transmitter axes turned z up): x, y, z of each sensor, frame by frame; NaN where missing.
    pub positions_m: Vec<f64>,
}

impl Frames {
    /// Appends a frame at `t_s` (s): x, y, z of each sensor, m, NaN where missing.
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

    /// Positions of one frame, m: x, y, z of each sensor, NaN where missing.
    ///
    /// # Panics
    /// There is no such frame.
    pub fn frame(&self, index: usize) -> &[f64] {
        let width = 3 * self.sensors.len();
        &self.positions_m[index * width..(index + 1) * width]
    }

    /// The same, to be written.
    pub(super) fn frame_mut(&mut self, index: usize) -> &mut [f64] {
        let width = 3 * self.sensors.len();
        &mut self.positions_m[index * width..(index + 1) * width]
    }

    /// Positions of one sensor at all times, m: x, y, z frame by frame, NaN where missing.
    ///
    /// # Panics
    /// There are frames but no such sensor.
    pub fn sensor(&self, sensor: usize) -> Vec<f64> {
        (0..self.len()).flat_map(|k| self.frame(k)[3 * sensor..3 * sensor + 3].to_vec()).collect()
    }

    /// The same frames with the sensors in another order; `None` unless the names are the same.
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
