//! A chain of hinges whose axes are known, sample by sample.
//!
//! In: samples of each segment's IMU at their own times, and what a calibration found ([`ChainCalibration`]). Out: the orientation
//! of every segment and the angle of every hinge at one time, with their uncertainty. Causal: it never looks ahead, and it never
//! allocates once made. Tilt comes from each sensor's own filter; a hinge corrects the heading between its two sensors and nothing
//! else, as in `joint.rs`, but as a random walk that is followed rather than smoothed.
//!
//! Seen from both sensors the axis points the same way in the room, `R1 j1 = H(d) R2 j2`. How far its height differs between them
//! needs no heading: it tells how noisy the direction is.

use nalgebra::{UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::joint::{BLOCK_S, DRIFT, LEAST_SIGMA, TILT_RAD, UNKNOWN_RAD2, sigma_rad};
use crate::ahrs::{Ahrs, ImuSample, Params};
use posed_geometry::{orientation_from_wxyz, wrapped_rad};

/// How long the noise of an axis is averaged over, s.
const NOISE_S: f64 = 10.0;
/// Heights are typically wrong by this before anything was seen, rad.
const FIRST_NOISE: f64 = 0.05;
/// An axis this near to upright gives no information about the heading: product of its level parts.
const LEAST_LEVEL: f64 = 0.05;
/// After a gap this long a sensor may have been turned, s; the last angular velocity goes on for so long at most.
const AWAY_S: f64 = 0.5;
const AHEAD_S: f64 = 0.1;
/// What a first sample stands for, s.
const FIRST_S: f64 = 0.01;

/// What a calibration found of a chain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ChainCalibration {
    /// One per segment, in the order of the stage file.
    pub segments: Vec<CalibratedSegment>,
}

/// How one sensor of a chain sits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CalibratedSegment {
    /// The segment.
    pub name: String,
    /// Turns segment coordinates into the sensor's.
    pub quat_wxyz: [f64; 4],
    /// The hinge to its parent; absent for the root.
    pub hinge: Option<CalibratedHinge>,
}

/// A hinge between two sensors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CalibratedHinge {
    /// Unit axis in the parent's sensor.
    pub parent_axis: [f64; 3],
    /// The same axis in the segment's own sensor.
    pub axis: [f64; 3],
    /// Angle that counts as zero, rad, beside that of the segments' frames.
    pub zero_rad: f64,
    /// How far two halves of the movement disagree about the axis, degrees.
    pub quality_deg: f64,
}

impl ChainCalibration {
    /// Whether the numbers make a calibration.
    ///
    /// # Errors
    /// One sentence that names the segment.
    pub fn check(&self) -> Result<(), String> {
        for segment in &self.segments {
            let unit = |axis: &[f64; 3]| (Vector3::from(*axis).norm() - 1.0).abs() < 1e-6;
            let hinge = segment.hinge.is_none_or(|hinge| {
                unit(&hinge.parent_axis)
                    && unit(&hinge.axis)
                    && hinge.zero_rad.is_finite()
                    && (0.0..=90.0).contains(&hinge.quality_deg)
            });
            if !hinge || orientation_from_wxyz(segment.quat_wxyz).is_none() {
                return Err(format!("segments: give {:?} a unit quaternion and unit axes", segment.name));
            }
        }
        Ok(())
    }
}

/// A segment of the chain at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LivePose {
    /// Segment to room: z up, the root's yaw 0 at the start; it drifts, for there is no magnetometer.
    pub orientation: UnitQuaternion<f64>,
    /// Angle of the hinge above, rad in (-pi, pi]; 0 for the root.
    pub flexion_rad: f64,
    /// Standard deviation of that angle, rad, at most pi: heading, axis, systematic tilt and play of the sensors; of the
    /// root's tilt.
    pub sigma_rad: f64,
}

/// The filters of a chain, live and without delay. Method: `docs/methods/chain.md`; accuracy: `docs/body.md`, Chains of
/// hinges.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct LiveChain {
    links: Vec<Link>,
}

#[derive(Clone, Debug, PartialEq, Plain)]
struct Link {
    ahrs: Ahrs,
    /// Time of the newest sample, s.
    last_s: Option<f64>,
    /// Segment to sensor.
    mount: UnitQuaternion<f64>,
    hinge: Option<Hinge>,
    /// Of its level frame into the root's, rad.
    heading_rad: f64,
}

#[derive(Clone, Debug, PartialEq, Plain)]
struct Hinge {
    parent: usize,
    /// In the parent's sensor and in the own one; and in the segment's frame.
    axes: [Vector3<f64>; 2],
    axis: Vector3<f64>,
    zero_rad: f64,
    quality_rad: f64,
    /// Turn of the level frame behind the hinge into the one before it, rad, and its variance, rad².
    rotation_rad: f64,
    variance: f64,
    /// Mean squared difference of the axis' heights, rad².
    noise: f64,
    /// The same over what was seen so far, for as long at most, s: how the sensors play.
    play: f64,
    played_s: f64,
    seen_s: Option<f64>,
}

impl LiveChain {
    /// A chain that has seen nothing; `parents` by segment, each before its children. `None` where the calibration is of
    /// other segments (their number, or which have a hinge) or a quaternion is none; [`ChainCalibration::check`] looks at the
    /// rest.
    pub fn new(parents: &[Option<usize>], calibration: &ChainCalibration) -> Option<Self> {
        if parents.len() != calibration.segments.len() {
            return None;
        }
        let links = parents.iter().zip(&calibration.segments).enumerate().map(|(at, (parent, found))| {
            let mount = orientation_from_wxyz(found.quat_wxyz)?;
            let hinge = match (parent, found.hinge) {
                (None, None) => None,
                (Some(parent), Some(hinge)) if *parent < at => {
                    let axes = [hinge.parent_axis, hinge.axis].map(Vector3::from);
                    Some(Hinge {
                        parent: *parent,
                        axes,
                        axis: mount.inverse() * axes[1],
                        zero_rad: hinge.zero_rad,
                        quality_rad: hinge.quality_deg.to_radians(),
                        rotation_rad: 0.0,
                        variance: UNKNOWN_RAD2,
                        noise: FIRST_NOISE * FIRST_NOISE,
                        play: 0.0,
                        played_s: 0.0,
                        seen_s: None,
                    })
                }
                _ => return None,
            };
            let ahrs = Ahrs::new(Params::instantaneous());
            Some(Link { ahrs, last_s: None, mount, hinge, heading_rad: 0.0 })
        });
        Some(Self { links: links.collect::<Option<_>>()? })
    }

    /// Takes a sample of a segment's sensor at its capture time, s; the field in it is not looked at. Times that do not rise
    /// and segments that do not exist change nothing. After a gap of 0.5 s the headings beside the sensor are unknown again.
    pub fn push(&mut self, segment: usize, t_s: f64, sample: &ImuSample) {
        let Some(link) = self.links.get_mut(segment) else { return };
        let since_s = link.last_s.map(|last_s| t_s - last_s);
        let dt_s = match since_s {
            Some(since_s) if since_s <= 0.0 || !since_s.is_finite() => return,
            Some(since_s) if since_s <= AWAY_S => since_s,
            Some(_) => {
                link.ahrs.resume();
                // It may have been turned about the vertical, too.
                link.hinge.iter_mut().for_each(|hinge| hinge.variance = UNKNOWN_RAD2);
                for child in self.links.iter_mut().filter_map(|link| link.hinge.as_mut()) {
                    if child.parent == segment {
                        child.variance = UNKNOWN_RAD2;
                    }
                }
                FIRST_S
            }
            None => FIRST_S,
        };
        let link = &mut self.links[segment];
        link.last_s = Some(t_s);
        link.ahrs.push(&ImuSample { mag: None, ..*sample }, dt_s);
    }

    /// Goes on to a time, s, and corrects the headings by the hinges: once per frame, before [`Self::pose`]. A hinge beside a
    /// sensor that has been silent for 0.5 s keeps its heading.
    pub fn advance(&mut self, t_s: f64) {
        for at in 0..self.links.len() {
            let Some(parent) = self.links[at].hinge.as_ref().map(|hinge| hinge.parent) else { continue };
            let [before, behind] = [parent, at].map(|index| self.links[index].level(t_s));
            let both = before.zip(behind);
            let link = &mut self.links[at];
            let Some(hinge) = &mut link.hinge else { continue };
            if let Some((before, behind)) = both {
                hinge.correct(t_s, &before, &behind);
            }
            let rotation_rad = hinge.rotation_rad;
            self.links[at].heading_rad = self.links[parent].heading_rad + rotation_rad;
        }
    }

    /// A segment at the time of the last [`Self::advance`], s; a sensor's last angular velocity goes on for at most 0.1 s.
    /// `None` where its sensor or its parent's has been silent for more than 0.5 s, or there is no such segment.
    pub fn pose(&self, segment: usize, t_s: f64) -> Option<LivePose> {
        let link = self.links.get(segment)?;
        let orientation = link.orientation(t_s)?;
        let Some(hinge) = &link.hinge else {
            return Some(LivePose { orientation, flexion_rad: 0.0, sigma_rad: TILT_RAD });
        };
        let parent = self.links[hinge.parent].orientation(t_s)?;
        let relative = parent.inverse() * orientation;
        let twist = 2.0 * libm::atan2(relative.imag().dot(&hinge.axis), relative.w);
        let upright = (orientation * hinge.axis).z;
        Some(LivePose {
            orientation,
            flexion_rad: wrapped_rad(twist - hinge.zero_rad),
            sigma_rad: sigma_rad(upright, hinge.variance, hinge.quality_rad, hinge.play),
        })
    }

    /// Whether the standard deviation of the heading across every hinge is below `rad`; true without hinges.
    pub fn is_settled(&self, rad: f64) -> bool {
        self.links.iter().filter_map(|link| link.hinge.as_ref()).all(|hinge| hinge.variance.sqrt() < rad)
    }
}

impl Link {
    /// Sensor to its own level frame at a time, s; the last angular velocity goes on for a moment.
    fn level(&self, t_s: f64) -> Option<UnitQuaternion<f64>> {
        let ahead_s = t_s - self.last_s?;
        let rotation_vector_rad = self.ahrs.angular_velocity_rad_s() * ahead_s.clamp(0.0, AHEAD_S);
        (ahead_s <= AWAY_S)
            .then(|| self.ahrs.orientation_6d() * UnitQuaternion::from_scaled_axis(rotation_vector_rad))
    }

    /// Segment to room.
    fn orientation(&self, t_s: f64) -> Option<UnitQuaternion<f64>> {
        let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.heading_rad);
        Some(heading * self.level(t_s)? * self.mount)
    }
}

impl Hinge {
    /// One step of the filter of the heading: a random walk, seen as far as the axis lies level.
    fn correct(&mut self, t_s: f64, before: &UnitQuaternion<f64>, behind: &UnitQuaternion<f64>) {
        let dt_s = self.seen_s.replace(t_s).map_or(FIRST_S, |last_s| t_s - last_s);
        if dt_s <= 0.0 {
            return;
        }
        self.variance = (self.variance + DRIFT * DRIFT * dt_s).min(UNKNOWN_RAD2);
        let (u, v) = (before * self.axes[0], behind * self.axes[1]);
        let keep = libm::exp(-dt_s / NOISE_S);
        let squared = (u.z - v.z).powi(2);
        self.noise = keep * self.noise + (1.0 - keep) * squared;
        self.played_s = (self.played_s + dt_s).min(NOISE_S);
        self.play += (dt_s / self.played_s).min(1.0) * (squared - self.play);
        let level = u.xy().norm() * v.xy().norm();
        if level < LEAST_LEVEL {
            return;
        }
        let seen = libm::atan2(v.x * u.y - v.y * u.x, v.x * u.x + v.y * u.y);
        // What a block of a second would say with this noise, shared out over its samples.
        let noise = (self.noise + LEAST_SIGMA * LEAST_SIGMA) / level * (BLOCK_S / dt_s.min(BLOCK_S));
        let gain = self.variance / (self.variance + noise);
        self.rotation_rad = wrapped_rad(self.rotation_rad + gain * wrapped_rad(seen - self.rotation_rad));
        self.variance *= 1.0 - gain;
    }
}
