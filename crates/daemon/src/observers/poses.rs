//! The last five minutes of raw poses, for learning a fault map from them.
//!
//! In: estimates, on the fusion thread. Out: a copy of the newest seconds as frames. Its memory is bounded; with very many
//! sensors it reaches less far back.

use std::collections::VecDeque;

use nalgebra::Isometry3;

use super::{Observer, Times};
use posed_motion::fault_map::Frames;
use posed_pipeline::{RawPose, raw_poses};
use posed_stage::Stage;
use posed_stage::output::{Estimate, Output};

/// How far it reaches back at most, s.
const LONGEST_S: f64 = 300.0;
/// Memory for the poses, bytes.
const MOST_BYTES: usize = 32 << 20;

/// The newest frames of raw poses, in device axes.
#[derive(Debug)]
pub(crate) struct RecentPoses {
    sensors: Vec<String>,
    indices: Vec<usize>,
    t_s: VecDeque<f64>,
    /// One per sensor and frame.
    poses: VecDeque<RawPose>,
}

impl RecentPoses {
    /// For the magnetic sensors of a stage; a stage without any costs nothing.
    pub(crate) fn new(stage: &Stage) -> Self {
        Self {
            indices: stage.magnetic_indices(),
            sensors: stage.magnetic_sensors().into_iter().map(str::to_owned).collect(),
            t_s: VecDeque::new(),
            poses: VecDeque::new(),
        }
    }

    fn push(&mut self, estimate: &Estimate) {
        let width = self.sensors.len();
        if width == 0 {
            return;
        }
        let now = estimate.t_valid.as_secs_f64();
        while self.t_s.front().is_some_and(|oldest| *oldest < now - LONGEST_S)
            || (self.t_s.len() + 1) * width * size_of::<RawPose>() > MOST_BYTES
        {
            self.t_s.pop_front();
            self.poses.drain(..width);
        }
        self.t_s.push_back(now);
        raw_poses(estimate, &self.indices, |pose| self.poses.push_back(pose));
    }

    /// The newest seconds, all if absent, turned upright.
    pub(crate) fn newest(&self, last_s: Option<f64>, room_transmitter: &Isometry3<f64>) -> Frames {
        let from_s = match (self.t_s.back(), last_s) {
            (Some(newest), Some(last_s)) => newest - last_s,
            _ => f64::NEG_INFINITY,
        };
        let first = self.t_s.partition_point(|t_s| *t_s < from_s);
        let mut frames = Frames {
            sensors: self.sensors.clone(),
            t_s: self.t_s.range(first..).copied().collect(),
            ..Frames::default()
        };
        for pose in self.poses.range(first * self.sensors.len()..) {
            pose.upright(room_transmitter).append_to(&mut frames);
        }
        frames
    }
}

impl Observer for RecentPoses {
    fn on_output(&mut self, output: &Output<'_>, _: &Times) {
        if let Output::Estimate(estimate) = output {
            self.push(estimate);
        }
    }
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;

    use super::*;
    use posed_stage::output::{Measured, SensorEstimate};

    #[test]
    fn it_remembers_five_minutes_and_gives_the_requested_seconds() {
        let text = "name = \"t\"\n[[device]]\nname = \"d\"\ndriver = \"flock-of-birds\"\nport = \"none\"\n\
                    [[sensor]]\nname = \"a\"\ndevice = \"d\"\naddress = 1\n\
                    [[sensor]]\nname = \"b\"\ndevice = \"d\"\naddress = 2\n";
        let mut recent = RecentPoses::new(&toml::from_str(text).unwrap());
        for second in 0..400 {
            let t_valid = Timestamp::from_secs_f64(f64::from(second));
            let measured = Measured {
                t_valid,
                position_m: Some([f64::from(second), 2.0, 3.0]),
                clipped: false,
                orientation_wxyz: None,
                button: None,
                inertial: None,
            };
            let sensor = SensorEstimate { measured: Some(measured), ..SensorEstimate::default() };
            let sensors = vec![sensor, SensorEstimate::default()];
            recent.push(&Estimate { t_valid, sensors, ..Estimate::default() });
        }
        // Upside down, as a Flock's axes are.
        let room = Isometry3::rotation(std::f64::consts::PI * nalgebra::Vector3::x());
        assert_eq!(recent.newest(None, &room).len(), 301);
        let frames = recent.newest(Some(1.0), &room);
        assert_eq!((frames.sensors.join(","), frames.t_s.clone()), ("a,b".into(), vec![398.0, 399.0]));
        let p = frames.positions(1);
        assert!((p[0] - 399.0).abs() < 1e-9 && (p[2] + 3.0).abs() < 1e-9, "{p:?}");
        assert!(p[3..].iter().all(|value| value.is_nan()));
    }

    #[test]
    fn many_sensors_at_any_rate_take_no_more_than_their_share() {
        let sensors: String = (1..=200)
            .map(|n| format!("[[sensor]]\nname = \"s{n}\"\ndevice = \"d\"\naddress = {n}\n"))
            .collect();
        let device = "[[device]]\nname = \"d\"\ndriver = \"flock-of-birds\"\nport = \"none\"\n";
        let mut recent =
            RecentPoses::new(&toml::from_str(&format!("name = \"t\"\n{device}{sensors}")).unwrap());
        let wide = Estimate { sensors: vec![SensorEstimate::default(); 200], ..Estimate::default() };
        for tick in 0..10_000 {
            recent.push(&Estimate {
                t_valid: Timestamp::from_secs_f64(f64::from(tick) * 1e-3),
                ..wide.clone()
            });
        }
        let taken = recent.poses.len() * size_of::<RawPose>();
        assert!(taken <= MOST_BYTES && taken > MOST_BYTES / 2, "{taken} bytes");
        assert_eq!(recent.poses.len(), recent.t_s.len() * 200);
        // The newest are there without a gap.
        let first = 10_000 - recent.t_s.len();
        let expected = (first..10_000).map(|tick| Timestamp::from_secs_f64(tick as f64 * 1e-3).as_secs_f64());
        assert!(recent.t_s.iter().copied().eq(expected));
    }
}
