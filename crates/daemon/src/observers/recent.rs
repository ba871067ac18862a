//! The last two minutes of what was tracked, for teaching an exercise from them.
//!
//! In: estimates, on the fusion thread. Out: a copy of the newest seconds. Its memory is bounded; with very many
//! sensors it reaches less far back.

use std::collections::VecDeque;

use super::{Observer, Times};
use posed_stage::output::{Body, Estimate, Output};
use posed_stage::signals::{self, BodyColumns, InertialColumns};
use posed_stage::{BodyIndex, Stage};

/// How far it reaches back at most, s.
const LONGEST_S: f64 = 120.0;
/// Memory for the values, bytes.
const MOST_BYTES: usize = 32 << 20;

/// The newest rows of signals.
#[derive(Debug)]
pub(crate) struct Recent {
    columns: Vec<String>,
    inertial: InertialColumns,
    angles: BodyColumns,
    /// The newest of each body, without its segments.
    bodies: Vec<Option<Body>>,
    row: Vec<Option<f64>>,
    t_s: VecDeque<f64>,
    /// Row by row; NaN where there is no value.
    values: VecDeque<f64>,
}

/// A copy of some seconds.
#[derive(Clone, Debug, Default)]
pub struct Excerpt {
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Values, row by row.
    pub values: Vec<Option<f64>>,
}

impl Recent {
    /// For a stage.
    pub(crate) fn new(stage: &Stage) -> Self {
        let (inertial, angles) = (InertialColumns::of(stage), BodyColumns::of(stage));
        let columns = signals::columns_of(stage);
        Self {
            columns,
            inertial,
            angles,
            bodies: vec![None; stage.bodies.len()],
            row: Vec::new(),
            t_s: VecDeque::new(),
            values: VecDeque::new(),
        }
    }

    /// The body, which comes before the estimate of its frame.
    fn body(&mut self, body: &Body) {
        // All but the segments, which would have to be allocated.
        let Some(newest) = self.bodies.get_mut(usize::from(body.index)) else { return };
        *newest = Some(Body { segments: Vec::new(), ..*body });
    }

    fn push(&mut self, estimate: &Estimate) {
        let width = self.columns.len();
        if width == 0 {
            return;
        }
        signals::write(estimate, &mut self.row);
        self.inertial.append(estimate, &mut self.row);
        let latest = |body: BodyIndex| self.bodies.get(usize::from(body))?.as_ref();
        self.angles.append(latest, estimate, &mut self.row);
        let now = estimate.t_valid.as_secs_f64();
        while self.t_s.front().is_some_and(|oldest| *oldest < now - LONGEST_S)
            || (self.t_s.len() + 1) * width * size_of::<f64>() > MOST_BYTES
        {
            self.t_s.pop_front();
            self.values.drain(..width);
        }
        self.t_s.push_back(now);
        self.values.extend(self.row.iter().map(|value| value.unwrap_or(f64::NAN)));
    }

    /// The rows after `from_s`, and the columns among them that `wanted` accepts.
    pub(crate) fn after(&self, from_s: f64, wanted: impl Fn(&str) -> bool) -> Excerpt {
        let width = self.columns.len();
        let chosen: Vec<usize> = (0..width).filter(|column| wanted(&self.columns[*column])).collect();
        let first = self.t_s.partition_point(|t_s| *t_s <= from_s);
        let value = |row: usize, column: usize| Some(self.values[row * width + column]);
        Excerpt {
            columns: chosen.iter().map(|column| self.columns[*column].clone()).collect(),
            t_s: self.t_s.range(first..).copied().collect(),
            values: (first..self.t_s.len())
                .flat_map(|row| chosen.iter().map(move |column| (row, *column)))
                .map(|(row, column)| value(row, column).filter(|value| !value.is_nan()))
                .collect(),
        }
    }
}

impl Observer for Recent {
    fn on_output(&mut self, output: &Output<'_>, _: &Times) {
        match output {
            Output::Estimate(estimate) => self.push(estimate),
            Output::Body(body) => self.body(body),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;

    use super::*;
    use posed_stage::output::{PoseEstimate, SensorEstimate, SensorState};

    fn estimate(t_s: f64) -> Estimate {
        let pose = PoseEstimate {
            position_m: Some([t_s, 0.0, 0.0]),
            orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
            velocity_m_s: Some([0.0; 3]),
            angular_velocity_rad_s: [0.0; 3],
            covariance: [0.0; 21],
            sigma_m: Some(0.0),
        };
        let good = SensorEstimate {
            state: SensorState::Ok,
            pose: Some(pose),
            measured: None,
            fault: None,
            ..SensorEstimate::default()
        };
        let t_valid = Timestamp::from_secs_f64(t_s);
        Estimate { t_valid, sensors: vec![SensorEstimate::default(), good], ..Estimate::default() }
    }

    #[test]
    fn it_forgets_what_is_old_and_gives_the_requested_columns() {
        let stage = "name = \"s\"\n[[sensor]]\nname = \"a\"\ndevice = \"d\"\naddress = 1\n[[sensor]]\nname = \"b\"\ndevice = \"d\"\naddress = 2";
        let mut recent = Recent::new(&toml::from_str(stage).unwrap());
        for second in 0..200 {
            recent.push(&estimate(f64::from(second)));
        }
        assert_eq!(recent.t_s.len() as f64, LONGEST_S + 1.0);
        let excerpt = recent.after(196.5, |column| column == "b_x_m" || column == "a_x_m");
        assert_eq!(excerpt.columns, ["a_x_m", "b_x_m"]);
        assert_eq!(excerpt.t_s, [197.0, 198.0, 199.0]);
        assert_eq!(excerpt.values, [None, Some(197.0), None, Some(198.0), None, Some(199.0)]);
    }

    #[test]
    fn many_columns_at_any_rate_take_no_more_than_their_share() {
        let sensors: String = (1..=200)
            .map(|n| format!("[[sensor]]\nname = \"s{n}\"\ndevice = \"d\"\naddress = {n}\n"))
            .collect();
        let mut recent = Recent::new(&toml::from_str(&format!("name = \"s\"\n{sensors}")).unwrap());
        let wide = Estimate { sensors: vec![estimate(0.0).sensors[1]; 200], ..Estimate::default() };
        for tick in 0..10_000 {
            recent.push(&Estimate {
                t_valid: Timestamp::from_secs_f64(f64::from(tick) * 1e-3),
                ..wide.clone()
            });
        }
        let taken = recent.values.len() * size_of::<f64>();
        assert!(taken <= MOST_BYTES && taken > MOST_BYTES / 2, "{taken} bytes");
        assert_eq!(recent.values.len(), recent.t_s.len() * recent.columns.len());
        // The newest are there without a gap.
        let first = 10_000 - recent.t_s.len();
        let expected = (first..10_000).map(|tick| Timestamp::from_secs_f64(tick as f64 * 1e-3).as_secs_f64());
        assert!(recent.t_s.iter().copied().eq(expected));
    }
}
