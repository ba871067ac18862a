//! Headings that no field identifies, held together by the joints of the body.
//!
//! In: the motion of every worn segment, and how sure each heading is. Out: by how much each is to be turned about the vertical. It never touches a
//! tilt, and never turns what a field identifies: that holds what hangs on it.
//!
//! Two segments that meet in a joint feel one acceleration there: carried from both sensors to the joint, the level parts of the two
//! specific forces differ by the angle between their headings. And people do not stand twisted: spine, neck, wrists, ankles, hips, shoulders and
//! collar bones are turned about the vertical to both sides alike, some more, some less. One Kalman filter has the error of each heading and the two things by which
//! it drifts, what is left of the gyro's bias and the error of its scale; both say what two of them differ by.

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use posed_geometry::{so3, wrapped_rad};
use posed_state::Plain;

use super::moving::Moving;
use super::sensor::Sensor;
use super::skeleton::{BodySegment, Limb};
use super::{AHEAD_RAD, BodyFilter, BodySamples, SensorMount, health, yaw_from_upright};
use crate::ahrs::CALIBRATED_HEADING_RAD;

/// Headings: those of [`ALONE`], each by its own sensor, and of the limbs, whose two segments a hinge holds together.
pub(super) const UNITS: usize = ALONE.len() + 4;
const ALONE: [BodySegment; 9] = [
    BodySegment::Torso,
    BodySegment::Pelvis,
    BodySegment::Head,
    BodySegment::HandR,
    BodySegment::FootR,
    BodySegment::HandL,
    BodySegment::FootL,
    BodySegment::ShoulderR,
    BodySegment::ShoulderL,
];
/// States: all errors, rad, then all rates of drift, rad/s, then all errors of scale, which drift as the segment turns.
const STATES: usize = 3 * UNITS;

/// The filter runs once in so long, s.
const WINDOW_S: f64 = 0.5;
/// A heading's random walk, rad per root second, and how long a rate of drift stays, s, and an error of scale: which axis of the gyro is upright changes.
const WALK_RAD: f64 = 2e-4;
const STAYS_S: f64 = 600.0;
/// Drift besides what is known of the gyro's bias, rad/s, and as a share of how far the segment turns about the vertical.
const RATE_RAD_S: f64 = 5e-5;
const SCALE: f64 = 0.003;
/// How well a calibration knows a heading, rad.
const CALIBRATED_RAD: f64 = 0.03;

/// Of the acceleration of a joint counts what is quicker than this, s: a sensor's tilt is wrong for longer.
const QUICK_S: f64 = 1.0;
/// What it is wrong by, m/s², and as a share of it, with the place of the joint besides: tilts, skin and levers, all in step with the movement, so that
/// the same is wrong for as long as somebody goes on in the same way, s.
const FORCE_M_S2: f64 = 0.15;
const FORCE_SHARE: f64 = 0.05;
const STEADY_S: f64 = 10.0;

/// A joint, by the segment below it.
pub(super) struct Link {
    pub(super) below: BodySegment,
    /// How well its place is known from both sides, m.
    place_m: f64,
    /// How far it is turned about the vertical, rad, and for how long, s.
    pub(super) twist_rad: f64,
    twist_s: f64,
}

const fn link(below: BodySegment, place_m: f64, twist_rad: f64, twist_s: f64) -> Link {
    Link { below, place_m, twist_rad, twist_s }
}

pub(super) const LINKS: [Link; 12] = [
    link(BodySegment::Torso, 0.1, 0.15, 10.0),
    link(BodySegment::Head, 0.05, 0.4, 10.0),
    link(BodySegment::HandR, 0.03, 0.3, 10.0),
    link(BodySegment::HandL, 0.03, 0.3, 10.0),
    link(BodySegment::FootR, 0.03, 0.2, 10.0),
    link(BodySegment::FootL, 0.03, 0.2, 10.0),
    link(BodySegment::ThighR, 0.03, 0.25, 20.0),
    link(BodySegment::ThighL, 0.03, 0.25, 20.0),
    link(BodySegment::UpperArmR, 0.05, 0.8, 20.0),
    link(BodySegment::UpperArmL, 0.05, 0.8, 20.0),
    link(BodySegment::ShoulderR, 0.05, 0.15, 10.0),
    link(BodySegment::ShoulderL, 0.05, 0.15, 10.0),
];

/// Which of the headings is the segment's.
pub(super) fn unit(segment: BodySegment) -> usize {
    let alone = ALONE.iter().position(|alone| *alone == segment);
    alone.unwrap_or_else(|| {
        let limb = Limb::ALL.iter().position(|limb| limb.segments()[1..].contains(&segment));
        ALONE.len() + limb.unwrap_or(0)
    })
}

/// What identifies a heading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Source {
    /// A field that is believed.
    Field,
    /// The gyro, which drifts at most so fast, rad/s; `turns`: whether it may be turned, because there is no field.
    Gyro { rate_rad_s: f64, turns: bool },
}

/// Level part of the specific force at a point so far from the sensor, m, m/s², room, and the square of what it changes by per metre, 1/s⁴.
fn level_force(moving: &Moving, from_sensor_m: &Vector3<f64>) -> (Vector2<f64>, f64) {
    let per_m = moving.accel_rad_s2.norm_squared() + moving.angular_velocity_rad_s.norm_squared().powi(2);
    (moving.at(from_sensor_m).xy(), per_m)
}

/// What a joint has felt in the running window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
struct Felt {
    /// Slow part of the level specific force above and below it, m/s²; absent before its first sample.
    slow_m_s2: Option<[Vector2<f64>; 2]>,
    /// Sums of the products along and across of what is quick of both, over its variance.
    along: f64,
    across: f64,
}

impl Felt {
    fn push(&mut self, forces: [Vector2<f64>; 2], variance: f64, dt_s: f64) {
        let slow = self.slow_m_s2.get_or_insert(forces);
        let gain = dt_s / (QUICK_S + dt_s);
        for (slow, force) in slow.iter_mut().zip(&forces) {
            *slow += (force - *slow) * gain;
        }
        let [above, below] = [forces[0] - slow[0], forces[1] - slow[1]];
        let squared = above.norm() * below.norm();
        if squared > variance {
            let weight = dt_s / (2.0 * STEADY_S * (variance + FORCE_SHARE.powi(2) * squared));
            self.along += weight * above.dot(&below);
            self.across += weight * above.perp(&below);
        }
    }

    /// By how much the heading below is turned too far against that above, rad, and how sure that is, 1/rad².
    fn take(&mut self) -> Option<(f64, f64)> {
        let (along, across) = (std::mem::take(&mut self.along), std::mem::take(&mut self.across));
        let information = libm::hypot(along, across);
        (information > 0.0).then(|| (libm::atan2(across, along), information))
    }
}

/// Headings and what holds them together.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Links {
    /// Errors that are not taken off yet, rates, and scales.
    x: SVector<f64, STATES>,
    p: SMatrix<f64, STATES, STATES>,
    /// Whether each heading has begun.
    begun: [bool; UNITS],
    /// How fast each heading may drift, variance, rad²/s².
    rates_rad2_s2: [f64; UNITS],
    /// How far each has turned about the vertical in the running window, rad.
    turned_rad: [f64; UNITS],
    felt: [Felt; LINKS.len()],
    window_s: f64,
}

impl Default for Links {
    fn default() -> Self {
        Self {
            x: SVector::zeros(),
            p: SMatrix::zeros(),
            begun: [false; UNITS],
            rates_rad2_s2: [0.0; UNITS],
            turned_rad: [0.0; UNITS],
            felt: [Felt::default(); LINKS.len()],
            window_s: 0.0,
        }
    }
}

impl Links {
    /// Variance of a segment's heading, rad², against what the first one began with; 0 before it has begun.
    pub(super) fn rad2(&self, segment: BodySegment) -> f64 {
        let u = unit(segment);
        self.p[(u, u)].max(0.0)
    }

    /// Variance of the angle between two headings, rad².
    pub(super) fn between_rad2(&self, one: BodySegment, other: BodySegment) -> f64 {
        let (a, b) = (unit(one), unit(other));
        (self.p[(a, a)] + self.p[(b, b)] - 2.0 * self.p[(a, b)]).max(0.0)
    }

    /// Somebody has said where a segment looks.
    pub(super) fn assert(&mut self, segment: BodySegment) {
        self.begun[unit(segment)] = true;
        self.set(unit(segment), AHEAD_RAD.powi(2));
    }

    /// Something else goes on saying where a segment looks, to this variance, rad²: it is not known worse, nor better for its being said again.
    pub(super) fn confine(&mut self, segment: BodySegment, rad2: f64) {
        let u = unit(segment);
        let known_rad2 = self.p[(u, u)];
        if known_rad2 > rad2 {
            let ph: SVector<f64, STATES> = self.p.column(u).into();
            let gain = ph * ((known_rad2 - rad2) / (known_rad2 * known_rad2));
            self.x -= gain * self.x[u];
            self.p -= gain * ph.transpose();
        }
    }

    /// State `k` is zero, but for this variance, whatever was known before.
    fn set(&mut self, k: usize, variance: f64) {
        self.x[k] = 0.0;
        self.p.row_mut(k).fill(0.0);
        self.p.column_mut(k).fill(0.0);
        self.p[(k, k)] = variance;
    }

    /// A heading may drift so fast from now on, variance, rad²/s²: what a rest has shown of the gyro's bias counts from the same window on.
    fn may_drift(&mut self, u: usize, rad2_s2: f64) {
        let rate = UNITS + u;
        let before_rad2_s2 = std::mem::replace(&mut self.rates_rad2_s2[u], rad2_s2);
        if rad2_s2 >= before_rad2_s2 {
            self.p[(rate, rate)] += rad2_s2 - before_rad2_s2;
        } else {
            self.scale(rate, (rad2_s2 / before_rad2_s2).sqrt());
        }
    }

    /// State `k` is so much less than it was.
    fn scale(&mut self, k: usize, keep: f64) {
        self.x[k] *= keep;
        self.p.row_mut(k).scale_mut(keep);
        self.p.column_mut(k).scale_mut(keep);
    }

    /// Moves on by a window.
    fn predict(&mut self, sources: &[Option<Source>; UNITS], t: f64) {
        let keep = libm::exp(-t / STAYS_S);
        for (u, source) in sources.iter().enumerate() {
            let turned_rad = std::mem::take(&mut self.turned_rad[u]);
            if let Some(Source::Gyro { rate_rad_s, .. }) = source {
                self.may_drift(u, rate_rad_s.powi(2) + RATE_RAD_S.powi(2));
            }
            for (drifts, by) in [(UNITS + u, t), (2 * UNITS + u, turned_rad)] {
                self.x[u] += by * self.x[drifts];
                for k in 0..STATES {
                    self.p[(k, u)] += by * self.p[(k, drifts)];
                }
                for k in 0..STATES {
                    self.p[(u, k)] += by * self.p[(drifts, k)];
                }
                self.scale(drifts, keep);
            }
            if matches!(source, Some(Source::Gyro { .. })) {
                let comes = 1.0 - keep * keep;
                self.p[(UNITS + u, UNITS + u)] += self.rates_rad2_s2[u] * comes;
                self.p[(2 * UNITS + u, 2 * UNITS + u)] += SCALE.powi(2) * comes;
                self.p[(u, u)] += WALK_RAD.powi(2) * t;
            }
        }
    }

    /// The heading of `below` is turned too far against that of `above` by `z`, rad, with variance `r`.
    fn observe(&mut self, above: usize, below: usize, z: f64, r: f64) {
        let ph: SVector<f64, STATES> = self.p.column(below) - self.p.column(above);
        let variance = ph[below] - ph[above] + r;
        let gain = ph / variance;
        self.x += gain * (z - self.x[below] + self.x[above]);
        for j in 0..STATES {
            for k in 0..STATES {
                self.p[(k, j)] -= gain[k] * ph[j];
            }
        }
    }

    /// Headings that are identified from now on; the first one says what the others are held against.
    pub(super) fn begin(&mut self, sources: &[Option<Source>; UNITS]) {
        for (u, source) in sources.iter().enumerate() {
            if let (Some(_), false) = (source, self.begun[u]) {
                let first = !self.begun.contains(&true);
                self.begun[u] = true;
                self.set(u, if first { 0.0 } else { CALIBRATED_RAD.powi(2) });
                self.set(2 * UNITS + u, SCALE.powi(2));
            }
        }
    }

    /// A joint shows by how much the heading below it is turned too far, rad, and how well, 1/rad².
    #[cfg(test)]
    pub(super) fn feel(&mut self, joint: usize, off_rad: f64, information: f64) {
        self.felt[joint].along = information * libm::cos(off_rad);
        self.felt[joint].across = information * libm::sin(off_rad);
    }

    /// Everybody has turned about the vertical so far, rad.
    #[cfg(test)]
    pub(super) fn turned(&mut self, turned_rad: f64) {
        self.turned_rad = [turned_rad; UNITS];
    }

    /// Runs the filter over a window of `t`, s: takes what the joints have felt, and how they are twisted, rad with a weight. Returns by how much each heading
    /// is turned too far that may be turned, rad, and takes it for taken off.
    pub(super) fn run(
        &mut self,
        sources: &[Option<Source>; UNITS],
        twists: &[Option<(f64, f64)>; LINKS.len()],
        t: f64,
    ) -> [f64; UNITS] {
        self.predict(sources, t);
        for (u, source) in sources.iter().enumerate() {
            if *source == Some(Source::Field) {
                self.set(u, CALIBRATED_HEADING_RAD.powi(2));
            }
        }
        for (k, link) in LINKS.iter().enumerate() {
            let felt = self.felt[k].take();
            let Some(parent) = link.below.parent() else { continue };
            let (above, below) = (unit(parent), unit(link.below));
            if sources[above].is_none() || sources[below].is_none() {
                continue;
            }
            if let Some((off_rad, information)) = felt {
                self.observe(above, below, off_rad, 1.0 / information);
            }
            if let Some((twist_rad, weight)) = twists[k] {
                let rad2 = link.twist_rad.powi(2) * 2.0 * link.twist_s / (t * weight);
                self.observe(above, below, twist_rad, rad2);
            }
        }
        std::array::from_fn(|u| match sources[u] {
            Some(Source::Gyro { turns: true, .. }) => std::mem::take(&mut self.x[u]),
            _ => 0.0,
        })
    }
}

impl BodyFilter {
    /// Holds the headings together that no field identifies: after the estimate of one time.
    pub(super) fn link(&mut self, samples: &BodySamples, dt_s: f64) {
        let drifts = |sensor: &Option<Sensor>| sensor.as_ref().is_some_and(|s| s.started && !s.magnetometer);
        if !self.sensors.iter().any(drifts) {
            return;
        }
        let moves = BodySegment::ALL.map(|segment| self.moves(segment, samples));
        let links = &mut self.links;
        // Gyros of one limb, with errors of their own, share its heading.
        let mut gyros = [0.0; UNITS];
        let moving = || {
            BodySegment::ALL
                .into_iter()
                .zip(&moves)
                .filter_map(|(s, moves)| Some((unit(s), &moves.as_ref()?.0)))
        };
        moving().for_each(|(u, _)| gyros[u] += 1.0);
        for (u, moving) in moving() {
            let turns_rad_s = (moving.q_room_segment * moving.angular_velocity_rad_s).z;
            links.turned_rad[u] += turns_rad_s * dt_s / gyros[u];
        }
        for (link, felt) in LINKS.iter().zip(&mut links.felt) {
            let Some(parent) = link.below.parent() else { continue };
            let (Some((above, above_m)), Some((below, below_m))) =
                (&moves[parent.index()], &moves[link.below.index()])
            else {
                felt.slow_m_s2 = None;
                continue;
            };
            let (from_above, per_m_above) =
                level_force(above, &(self.skeleton.joint_in_parent_m(link.below) - above_m));
            let (from_below, per_m_below) =
                level_force(below, &(self.skeleton.joint_in_segment_m(link.below) - below_m));
            let variance = FORCE_M_S2.powi(2) + link.place_m.powi(2) * (per_m_above + per_m_below);
            felt.push([from_above, from_below], variance, dt_s);
        }
        links.window_s += dt_s;
        if links.window_s >= WINDOW_S {
            self.turn();
        }
    }

    /// How a segment moves by its own sensor and the body's estimate, and where the sensor sits on it, m.
    fn moves(&self, segment: BodySegment, samples: &BodySamples) -> Option<(Moving, Vector3<f64>)> {
        let sensor = self.sensors[segment.index()].as_ref()?;
        let sample = samples[segment.index()].filter(health::usable)?;
        let q_room_segment = self.estimate.orientations[segment.index()]?;
        let SensorMount { q_segment_sensor, offset_m, .. } = &sensor.mount;
        sensor.is_settled().then(|| (sensor.moving(&sample, q_segment_sensor, q_room_segment), *offset_m))
    }

    /// What identifies the heading of each unit; `None` where no sensor does.
    fn sources(&self) -> [Option<Source>; UNITS] {
        let of = |segments: &[BodySegment]| {
            let worn = segments.iter().filter_map(|s| self.sensors[s.index()].as_ref()).filter(|s| s.started);
            let (mut source, mut turns) = (None, true);
            for sensor in worn {
                turns &= !sensor.magnetometer;
                if sensor.magnetometer && !sensor.ahrs.magnetic_disturbance() {
                    source = Some(Source::Field);
                }
                if source != Some(Source::Field) {
                    source = Some(Source::Gyro { rate_rad_s: sensor.ahrs.heading_rate_sigma_rad_s(), turns });
                }
            }
            source
        };
        std::array::from_fn(|u| match ALONE.get(u) {
            Some(segment) => of(&[*segment]),
            None => of(&Limb::ALL[u - ALONE.len()].segments()[1..]),
        })
    }

    /// Runs the filter over a window, and turns the headings that no field identifies.
    fn turn(&mut self) {
        let sources = self.sources();
        let orientations = &self.estimate.orientations;
        let twists = std::array::from_fn(|k| {
            let below = LINKS[k].below;
            let parent = below.parent()?;
            let [above, below] = [orientations[parent.index()]?, orientations[below.index()]?];
            // Of a segment that lies the twist from upright says little.
            let weight = |q: &UnitQuaternion<f64>| {
                let rotation = q * super::upright().inverse();
                rotation.k.powi(2) + rotation.w.powi(2)
            };
            let twist_rad = wrapped_rad(yaw_from_upright(&below) - yaw_from_upright(&above));
            Some((twist_rad, (weight(&above) * weight(&below)).max(1e-6)))
        });
        self.links.begin(&sources);
        let t = std::mem::take(&mut self.links.window_s);
        let off_rad = self.links.run(&sources, &twists, t);
        let about_up = |rad: f64| so3::exp(&Vector3::new(0.0, 0.0, rad));
        for (limb, filter) in Limb::ALL.into_iter().zip(&mut self.limbs) {
            let [trunk, upper, _] = limb.segments();
            let base = self.sensors[trunk.index()].as_ref().and_then(Sensor::orientation);
            let off_rad = off_rad[unit(upper)] - if base.is_some() { off_rad[unit(trunk)] } else { 0.0 };
            if off_rad == 0.0 {
                continue;
            }
            let q = base.unwrap_or_else(UnitQuaternion::identity);
            filter.turn(&(q.inverse() * about_up(-off_rad) * q));
        }
        for segment in BodySegment::ALL {
            if let Some(sensor) = &mut self.sensors[segment.index()] {
                sensor.heading = about_up(-off_rad[unit(segment)]) * sensor.heading;
            }
        }
    }
}
