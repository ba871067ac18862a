//! What else shows a body where it is and which way it faces: a tracker on any of its segments.
//!
//! In: where such a sensor is in the room, how well that is known, and how its segment is turned if it says so. Out: where the hips are. It never turns a limb
//! against the trunk, and headings that a field identifies it leaves alone.

use nalgebra::{UnitQuaternion, Vector3};
use posed_state::Plain;

use super::skeleton::{BodySegment, Limb, SEGMENTS};
use super::{BodyFilter, Heading};

/// What the posture between a segment and the hips adds at least, m.
const POSTURE_M: f64 = 0.02;
/// Anchors that differ by more than so many standard deviations do not say the same.
const AGREE: f64 = 4.0;
/// Longer than this nothing has been heard, s.
const LONGEST_S: f64 = 0.1;
/// In so long a heading follows, s, once it has been identified.
const HEADING_S: f64 = 2.0;
/// A heading that is not known better is not used, rad.
const USED_RAD: f64 = 0.2;
/// An anchor's own place says which way the segment looks to so much, rad.
const WORN_RAD: f64 = 0.05;

/// Where a sensor on a segment is by something else than IMUs.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Anchor {
    /// The segment that wears it.
    pub segment: BodySegment,
    /// Where on it, segment frame, m.
    pub offset_m: Vector3<f64>,
    /// Where it is in the room, m.
    pub position_m: Vector3<f64>,
    /// Standard deviation of that along an axis, m.
    pub sigma_m: f64,
    /// How its segment is turned, segment to room, with the standard deviation about an axis, rad; `None` where it does not say.
    pub orientation: Option<(UnitQuaternion<f64>, f64)>,
}

/// Whether two places, m, with their variances, m², may be one.
fn agree(one: &(Vector3<f64>, f64), other: &(Vector3<f64>, f64)) -> bool {
    (one.0 - other.0).norm_squared() < AGREE * AGREE * (one.1 + other.1)
}

impl BodyFilter {
    /// Something else shows where the body is, at the time of the latest estimate. Where the hips' mid-point is by that, room, m, and its standard deviation along an
    /// axis, m; `None` where nothing was shown, or where one alone says what the feet contradict. Of more than [`SEGMENTS`] only so many count.
    pub fn anchor(&mut self, anchors: &[Anchor]) -> Option<(Vector3<f64>, f64)> {
        if anchors.is_empty() {
            return None;
        }
        let dt_s = std::mem::take(&mut self.unanchored_s).min(LONGEST_S);
        // First which way it faces: where the hips are from the segment goes by that.
        self.face(anchors, dt_s);
        let mut hips = [(Vector3::zeros(), 0.0); SEGMENTS];
        let mut count = 0;
        for (one, seen) in hips.iter_mut().zip(anchors.iter().filter_map(|anchor| self.hips_m(anchor))) {
            *one = seen;
            count += 1;
        }
        let hips = &hips[..count];
        // The one that most of the others agree with, and the feet; and those others.
        let feet = self.estimate.travel.map(|travel| (travel.pelvis_m, travel.sigma_m.powi(2)));
        let votes = |one: &(Vector3<f64>, f64)| {
            (
                hips.iter().filter(|other| agree(one, other)).count(),
                feet.is_some_and(|feet| agree(one, &feet)),
            )
        };
        let best = hips.iter().reduce(|best, one| if votes(one) > votes(best) { one } else { best })?;
        let (mut sum, mut weights, mut count) = (Vector3::zeros(), 0.0, 0);
        for (at_m, variance_m2) in hips.iter().filter(|other| agree(best, other)) {
            sum += at_m / *variance_m2;
            weights += 1.0 / variance_m2;
            count += 1;
        }
        // What the posture makes of them is wrong for all alike.
        let at = (sum / weights, libm::hypot((1.0_f64 / weights).sqrt(), POSTURE_M));
        let (Some(pelvis), Some(q_room_pelvis), Some(_)) = (
            &self.sensors[BodySegment::Pelvis.index()],
            self.estimate.orientations[BodySegment::Pelvis.index()],
            self.estimate.travel,
        ) else {
            return Some(at);
        };
        let sensor_m = q_room_pelvis * pelvis.mount.offset_m;
        self.travel.anchor(at, count > 1, sensor_m, self.estimate.heading_sigma_rad, dt_s)
    }

    /// Where the hips' mid-point is by an anchor, room, m, with its variance along an axis, m²; `None` where nothing shows its segment, nor what that hangs on.
    fn hips_m(&self, anchor: &Anchor) -> Option<(Vector3<f64>, f64)> {
        let segment = anchor.segment;
        let known = self.estimate.orientations[segment.index()];
        let q = known.or(anchor.orientation.map(|(q, _)| q)).or_else(|| {
            let parent = segment.parent().filter(|_| BodySegment::LEAVES.contains(&segment))?;
            self.estimate.orientations[parent.index()]
        })?;
        let mut all = self.estimate.posture;
        all[segment.index()] = q;
        let origins_m = self.skeleton.origins_m(&all, Vector3::zeros());
        let from_hips_m = origins_m[segment.index()] + q * anchor.offset_m;
        // Each segment between is turned wrong by so much.
        let posture_m2: f64 = std::iter::successors(segment.parent(), |segment| segment.parent())
            .map(|above| {
                let lever_m = from_hips_m - origins_m[above.index()];
                lever_m.norm_squared() * self.estimate.sigma_rad[above.index()].min(1.0).powi(2)
            })
            .sum();
        Some((anchor.position_m - from_hips_m, anchor.sigma_m.powi(2) + posture_m2.min(1.0)))
    }

    /// The body faces as those anchors say that know how their segments are turned, if no field identifies its heading.
    fn face(&mut self, anchors: &[Anchor], dt_s: f64) {
        if !matches!(self.estimate.heading, Heading::Held(_))
            || self.sensors.iter().flatten().any(|s| s.magnetometer)
        {
            return;
        }
        let (mut sin, mut cos) = (0.0, 0.0);
        for anchor in anchors {
            let Some((q, sigma_rad)) = anchor.orientation.filter(|(_, sigma_rad)| *sigma_rad < USED_RAD)
            else {
                continue;
            };
            let Some(own) = self.estimate.orientations[anchor.segment.index()] else { continue };
            let off = q * own.inverse();
            let weight = 1.0
                / (sigma_rad.powi(2)
                    + self.estimate.sigma_rad[anchor.segment.index()].powi(2)
                    + WORN_RAD * WORN_RAD);
            self.links.confine(anchor.segment, sigma_rad.powi(2) + WORN_RAD * WORN_RAD);
            let (s, c) = libm::sincos(2.0 * libm::atan2(off.k, off.w));
            sin += weight * s;
            cos += weight * c;
        }
        if (sin, cos) == (0.0, 0.0) {
            return;
        }
        let share = if self.heading_anchored { (dt_s / HEADING_S).min(1.0) } else { 1.0 };
        self.heading_anchored = true;
        let turn_rad = share * libm::atan2(sin, cos);
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad);
        for sensor in self.sensors.iter_mut().flatten().filter(|sensor| sensor.started) {
            sensor.heading = turned * sensor.heading;
        }
        // A limb whose trunk wears nothing hangs in the room, and does not turn with it.
        for (limb, filter) in Limb::ALL.into_iter().zip(&mut self.limbs) {
            let [trunk, ..] = limb.segments();
            if self.sensors[trunk.index()].is_none() && turn_rad.abs() > WORN_RAD {
                filter.restart();
            }
        }
        self.held_s = 0.0;
        self.estimate.orientations.iter_mut().flatten().for_each(|q| *q = turned * *q);
        self.travel.turn(turn_rad);
    }
}
