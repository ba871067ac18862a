//! A custom skeleton of hinges, solved without magnetometers and with the mounting found from the movement.
//!
//! In: the segments with their parents, and a recording of one IMU per segment. Out: per epoch the orientation of
//! every segment and the angle of every hinge. Offline in one respect only: the axes are found from the whole movement
//! first; the filters then run forward and never look ahead.
//!
//! Zero is the posture in which the recording begins (its first quarter of a second) and bending from there is positive; in that
//! posture all segment frames are parallel, x and z of the root level and z as near to its first hinge's axis as that allows.

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::ahrs::{Ahrs, ImuSample, Params};
use super::hinge::{Hinge, HingeParams, wrap};
use super::mounting::{HingeAxes, Refused, hinge_axes};

/// How much of the beginning shows the zero, s.
const ZERO_S: f64 = 0.25;

/// A segment of the chain; the root has no hinge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChainSegment {
    /// Its name.
    pub name: String,
    /// The hinge it hangs on: index of the parent segment, which comes earlier, and the joint's name.
    pub hinge: Option<(usize, String)>,
}

/// All segments' samples at one time; a missing one is `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct Epoch {
    /// Time, s.
    pub t_s: f64,
    /// One per segment.
    pub samples: Vec<Option<ImuSample>>,
}

/// The chain at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainPose {
    /// Time, s.
    pub t_s: f64,
    /// Segment to room (z up, yaw 0 at the start), one per segment.
    pub orientations: Vec<UnitQuaternion<f64>>,
    /// Flexion, rad, one per segment; 0 for the root.
    pub flexion_rad: Vec<f64>,
}

/// A solved chain.
#[derive(Clone, Debug, PartialEq)]
pub struct Solved {
    /// The hinge above each segment: its axis in the parent's and the segment's own sensor.
    pub axes: Vec<Option<HingeAxes>>,
    /// One per epoch.
    pub poses: Vec<ChainPose>,
}

/// Why a chain cannot be solved.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ChainError {
    /// A joint's axis does not show.
    #[error("joint `{joint}`: {reason}")]
    Joint {
        /// Its name.
        joint: String,
        /// What was missing.
        reason: Refused,
    },
    /// Times do not rise.
    #[error("the time does not rise after {t_s} s")]
    Time {
        /// Where.
        t_s: f64,
    },
}

/// Solves a recording.
///
/// # Errors
/// A joint whose axis the movement does not show, or times that do not rise.
pub fn solve(segments: &[ChainSegment], epochs: &[Epoch]) -> Result<Solved, ChainError> {
    if let Some(pair) = epochs
        .windows(2)
        .find(|pair| pair[1].t_s.partial_cmp(&pair[0].t_s) != Some(std::cmp::Ordering::Greater))
    {
        return Err(ChainError::Time { t_s: pair[0].t_s });
    }
    let mut axes = Vec::with_capacity(segments.len());
    for (index, segment) in segments.iter().enumerate() {
        axes.push(match &segment.hinge {
            None => None,
            Some((parent, joint)) => Some(
                find_axes(epochs, *parent, index)
                    .map_err(|reason| ChainError::Joint { joint: joint.clone(), reason })?,
            ),
        });
    }
    let mut poses = Run::new(segments, &axes).over(epochs);
    // Bending is positive: turn the axes that bend the other way, and run again so that all signs agree.
    let mut turned = false;
    for (index, axes) in axes.iter_mut().enumerate() {
        let Some(axes) = axes else { continue };
        if poses.iter().map(|pose| pose.flexion_rad[index]).sum::<f64>() < 0.0 {
            *axes = HingeAxes { first: -axes.first, second: -axes.second, ..*axes };
            turned = true;
        }
    }
    if turned {
        poses = Run::new(segments, &axes).over(epochs);
    }
    Ok(Solved { axes, poses })
}

fn find_axes(epochs: &[Epoch], parent: usize, child: usize) -> Result<HingeAxes, Refused> {
    let pairs: Vec<_> = epochs
        .iter()
        .filter_map(|epoch| {
            let (a, b) = (epoch.samples[parent]?, epoch.samples[child]?);
            Some(([a.gyro_rad_s, b.gyro_rad_s], [a.accel_m_s2, b.accel_m_s2]))
        })
        .filter(|(w, a)| w.iter().chain(a).all(|v| v.iter().all(|v| v.is_finite())))
        .collect();
    hinge_axes(&pairs)
}

/// The filters of a chain.
struct Run<'a> {
    segments: &'a [ChainSegment],
    filters: Vec<Ahrs>,
    hinges: Vec<Option<Hinge>>,
    last_t_s: Option<f64>,
}

impl<'a> Run<'a> {
    fn new(segments: &'a [ChainSegment], axes: &[Option<HingeAxes>]) -> Self {
        // The delay of the sensors' low-pass is not known here, and between equal sensors it cancels.
        let params = Params { gyro_delay_s: 0.0, ..Params::default() };
        let hinges = axes
            .iter()
            .map(|axes| axes.map(|axes| Hinge::new(HingeParams::default(), [axes.first, axes.second])))
            .collect();
        Self { segments, filters: vec![Ahrs::new(params); segments.len()], hinges, last_t_s: None }
    }

    fn over(mut self, epochs: &[Epoch]) -> Vec<ChainPose> {
        let mut poses = Vec::with_capacity(epochs.len());
        let nominal_s = match epochs {
            [first, .., last] => (last.t_s - first.t_s) / (epochs.len() - 1) as f64,
            _ => 0.01,
        };
        for epoch in epochs {
            let dt_s = self.last_t_s.map_or(nominal_s, |last| epoch.t_s - last);
            self.last_t_s = Some(epoch.t_s);
            poses.push(self.step(epoch, dt_s));
        }
        self.level(&mut poses);
        poses
    }

    /// Sensor orientations in the root's level frame and raw hinge angles.
    fn step(&mut self, epoch: &Epoch, dt_s: f64) -> ChainPose {
        for (filter, sample) in self.filters.iter_mut().zip(&epoch.samples) {
            match sample {
                Some(sample) => _ = filter.push(&ImuSample { mag: None, ..*sample }, dt_s),
                None => filter.coast(dt_s),
            }
        }
        let level: Vec<_> = self.filters.iter().map(Ahrs::orientation_6d).collect();
        let mut orientations: Vec<UnitQuaternion<f64>> = Vec::with_capacity(level.len());
        let mut headings: Vec<UnitQuaternion<f64>> = Vec::with_capacity(level.len());
        let mut flexion_rad = Vec::with_capacity(level.len());
        for (index, segment) in self.segments.iter().enumerate() {
            let (heading, angle) = match (&segment.hinge, &mut self.hinges[index]) {
                (Some((parent, _)), Some(hinge)) => {
                    hinge.push(&level[*parent], &level[index], dt_s);
                    let angle = hinge.angle_rad(&level[*parent], &level[index]);
                    (headings[*parent] * hinge.heading(), angle)
                }
                _ => (UnitQuaternion::identity(), 0.0),
            };
            orientations.push(heading * level[index]);
            headings.push(heading);
            flexion_rad.push(angle);
        }
        ChainPose { t_s: epoch.t_s, orientations, flexion_rad }
    }

    /// From sensors to segments: subtracts the zero.
    fn level(&self, poses: &mut [ChainPose]) {
        let Some(start) = poses.first().cloned() else { return };
        let count = poses.iter().take_while(|pose| pose.t_s - start.t_s <= ZERO_S).count();
        let mut zero = vec![0.0; self.segments.len()];
        for (index, zero) in zero.iter_mut().enumerate() {
            // About the first angle, so that no average is taken across the wrap.
            let first = start.flexion_rad[index];
            let sum: f64 = poses[..count].iter().map(|pose| wrap(pose.flexion_rad[index] - first)).sum();
            *zero = first + sum / count as f64;
        }
        let root = self.root_frame(&start);
        let mounts: Vec<_> = start.orientations.iter().map(|q| q.inverse() * root).collect();
        for pose in poses {
            for (index, q) in pose.orientations.iter_mut().enumerate() {
                *q *= mounts[index];
                if self.hinges[index].is_some() {
                    pose.flexion_rad[index] = wrap(pose.flexion_rad[index] - zero[index]);
                }
            }
        }
    }

    /// The common segment frame in the first posture: y up, z the level part of the first hinge's axis.
    fn root_frame(&self, start: &ChainPose) -> UnitQuaternion<f64> {
        let axis = self.hinges.iter().zip(self.segments).find_map(|(hinge, segment)| {
            let (parent, _) = segment.hinge.as_ref()?;
            Some(start.orientations[*parent] * hinge.as_ref()?.axes()[0])
        });
        let z = axis.map_or(Vector3::x(), |axis| Vector3::new(axis.x, axis.y, 0.0));
        let z = z.try_normalize(0.1).unwrap_or_else(Vector3::x);
        let y = Vector3::z();
        UnitQuaternion::from_basis_unchecked(&[y.cross(&z), y, z])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::so3;

    const RATE_HZ: f64 = 100.0;

    /// Three segments on two parallel hinges, sensors askew, gyros biased, no magnetometer.
    fn recording() -> (Vec<ChainSegment>, Vec<Epoch>, Vec<[f64; 2]>) {
        let mounts = [
            so3::exp(&Vector3::new(0.4, -0.9, 0.3)),
            so3::exp(&Vector3::new(-1.2, 0.5, 2.0)),
            so3::exp(&Vector3::new(1.9, 0.2, -0.7)),
        ];
        let levers =
            [Vector3::new(0.0, 0.2, 0.03), Vector3::new(0.02, -0.15, 0.0), Vector3::new(0.0, -0.2, 0.0)];
        let angles = |t: f64| {
            let grow = (t / 4.0).min(1.0);
            [grow * (0.7 - 0.7 * (1.3 * t).cos()), grow * (0.6 - 0.6 * (1.9 * t).cos())]
        };
        let poses = |t: f64| {
            let grow = (t / 4.0).min(1.0);
            let upright = so3::exp(&(Vector3::x() * std::f64::consts::FRAC_PI_2));
            let whole = so3::exp(
                &(Vector3::new((0.9 * t).sin(), 0.6 * (0.7 * t).sin(), 0.8 * (1.1 * t).sin()) * grow),
            ) * upright;
            let [a, b] = angles(t);
            let second = whole * so3::exp(&(Vector3::z() * a));
            let third = second * so3::exp(&(Vector3::z() * b));
            let knee = Vector3::new(0.2 * (1.7 * t).sin(), 0.2 * (1.3 * t).cos(), 1.0) * grow;
            let ankle = knee + second * Vector3::new(0.0, -0.4, 0.0);
            [
                (whole, knee + whole * levers[0]),
                (second, knee + second * levers[1]),
                (third, ankle + third * levers[2]),
            ]
        };
        let segments = vec![
            ChainSegment { name: "a".into(), hinge: None },
            ChainSegment { name: "b".into(), hinge: Some((0, "one".into())) },
            ChainSegment { name: "c".into(), hinge: Some((1, "two".into())) },
        ];
        let h = 1e-3;
        let (mut epochs, mut truth) = (Vec::new(), Vec::new());
        for k in 0..(60.0 * RATE_HZ) as usize {
            let t = k as f64 / RATE_HZ;
            let (before, now, after) = (poses(t - h), poses(t), poses(t + h));
            let samples = (0..3)
                .map(|i| {
                    let rate = so3::log(&(before[i].0.inverse() * after[i].0)) / (2.0 * h);
                    let accel = (after[i].1 + before[i].1 - now[i].1 * 2.0) / (h * h) + Vector3::z() * 9.81;
                    Some(ImuSample {
                        gyro_rad_s: mounts[i].inverse() * rate + Vector3::new(0.004, -0.003, 0.005),
                        accel_m_s2: mounts[i].inverse() * (now[i].0.inverse() * accel),
                        mag: None,
                    })
                })
                .collect();
            epochs.push(Epoch { t_s: t, samples });
            truth.push(angles(t));
        }
        (segments, epochs, truth)
    }

    #[test]
    fn a_chain_is_solved_from_its_movement_alone() {
        let (segments, epochs, truth) = recording();
        let solved = solve(&segments, &epochs).unwrap();
        for joint in 0..2 {
            let sum: f64 = solved
                .poses
                .iter()
                .zip(&truth)
                .map(|(pose, truth)| (pose.flexion_rad[joint + 1] - truth[joint]).powi(2))
                .sum();
            let rms = (sum / truth.len() as f64).sqrt().to_degrees();
            assert!(rms < 1.5, "joint {joint}: {rms} degrees");
        }
    }

    #[test]
    fn missing_samples_are_bridged() {
        let (segments, mut epochs, truth) = recording();
        for (k, epoch) in epochs.iter_mut().enumerate() {
            if k % 7 == 3 {
                epoch.samples[1] = None;
            }
        }
        let solved = solve(&segments, &epochs).unwrap();
        let worst = solved
            .poses
            .iter()
            .zip(&truth)
            .map(|(pose, truth)| (pose.flexion_rad[1] - truth[0]).abs().to_degrees())
            .fold(0.0, f64::max);
        assert!(worst < 6.0, "{worst} degrees");
    }

    #[test]
    fn a_chain_that_does_not_move_names_the_joint() {
        let (segments, mut epochs, _) = recording();
        let still = epochs[0].clone();
        for epoch in &mut epochs {
            epoch.samples.clone_from(&still.samples);
        }
        let error = solve(&segments, &epochs).unwrap_err();
        assert!(error.to_string().starts_with("joint `one`: the movement shows too little"), "{error}");
    }

    #[test]
    fn times_must_rise() {
        let (segments, mut epochs, _) = recording();
        epochs[10].t_s = epochs[9].t_s;
        assert!(matches!(solve(&segments, &epochs), Err(ChainError::Time { .. })));
    }
}
