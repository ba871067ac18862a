//! Where trackers on a body are while a pose is held, against where the pose has them.
//!
//! In: positions of trackers, room frame, z up, m; the skeleton, and where each tracker sits on its segment. Out: the two that are
//! not where who holds the pose has them, or nothing. It knows no heading: heights and level distances are compared.

use nalgebra::Vector3;
use thiserror::Error;

use super::block::BlockKind;
use super::calibrate::posture;
use super::skeleton::{BodySegment, SEGMENTS, Skeleton, upright};

/// Heights and level distances of two trackers may differ from the skeleton's by so much, m, and by so much of their distance.
const PLACE_M: f64 = 0.06;
const PLACE_SHARE: f64 = 0.1;

/// Position of the tracker on each segment, room frame, m, by [`BodySegment::index`]; `None` where none is seen.
pub type Places = [Option<Vector3<f64>>; SEGMENTS];

/// Two trackers are not where the pose has them.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "the trackers on {first} and {second} are {found_m:.2} m apart in {direction}, and {expected_m:.2} m in somebody who holds \
     {pose}: hold it as described"
)]
pub struct Misplaced {
    /// One of the segments.
    pub first: &'static str,
    /// The other.
    pub second: &'static str,
    /// In which pose.
    pub pose: String,
    /// `height`, or `the level`.
    pub direction: &'static str,
    /// How far apart they were, m.
    pub found_m: f64,
    /// How far apart they should be, m.
    pub expected_m: f64,
}

/// The trackers that a body wears beside its IMUs.
#[derive(Clone, Debug)]
pub struct Trackers {
    skeleton: Skeleton,
    /// Where each sits, segment frame, m.
    offsets_m: Places,
    sums_m: [Vector3<f64>; SEGMENTS],
    counts: [f64; SEGMENTS],
}

impl Trackers {
    /// Where each tracker sits on its segment, segment frame, m, by [`BodySegment::index`].
    pub fn new(skeleton: Skeleton, offsets_m: Places) -> Self {
        Self { skeleton, offsets_m, sums_m: Default::default(), counts: Default::default() }
    }

    /// The pose begins anew.
    pub(super) fn clear(&mut self) {
        (self.sums_m, self.counts) = Default::default();
    }

    pub(super) fn push(&mut self, places: &Places) {
        for (index, place) in places.iter().enumerate() {
            if let Some(place) = place.filter(|place| place.iter().all(|value| value.is_finite())) {
                self.sums_m[index] += place;
                self.counts[index] += 1.0;
            }
        }
    }

    /// The two that lie furthest from where the pose has them, if that is too far; what was seen is forgotten.
    pub(super) fn objection_to(&mut self, pose: BlockKind) -> Option<Misplaced> {
        let raised = pose == BlockKind::TPose;
        let orientations = BodySegment::ALL.map(|segment| upright() * posture(segment, raised));
        let origins_m = self.skeleton.origins_m(&orientations, Vector3::zeros());
        let mut seen = Vec::new();
        for segment in BodySegment::ALL {
            let index = segment.index();
            if let Some(offset_m) = self.offsets_m[index].filter(|_| self.counts[index] > 0.0) {
                let place_m = self.sums_m[index] / self.counts[index];
                seen.push((segment, place_m, origins_m[index] + orientations[index] * offset_m));
            }
        }
        self.clear();
        let (mut worst, mut excess) = (None, 0.0);
        for (k, (first, at_m, asked_m)) in seen.iter().enumerate() {
            for (second, other_m, other_asked_m) in &seen[k + 1..] {
                let (found, expected) = (at_m - other_m, asked_m - other_asked_m);
                let limit_m = PLACE_M + PLACE_SHARE * expected.norm();
                let compared = [
                    ("height", found.z.abs(), expected.z.abs(), (found.z - expected.z).abs()),
                    (
                        "the level",
                        found.xy().norm(),
                        expected.xy().norm(),
                        (found.xy().norm() - expected.xy().norm()).abs(),
                    ),
                ];
                for (direction, found_m, expected_m, apart_m) in compared {
                    if apart_m - limit_m > excess {
                        excess = apart_m - limit_m;
                        let (first, second, pose) = (first.name(), second.name(), pose.name());
                        worst = Some(Misplaced { first, second, pose, direction, found_m, expected_m });
                    }
                }
            }
        }
        worst
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    /// An elbow that is bent in both poses contradicts nothing that IMUs measure, but the trackers beside it.
    #[test]
    fn trackers_show_an_elbow_that_is_never_straight() {
        let skeleton = Skeleton::from_height(1.8);
        let worn = [BodySegment::Torso, BodySegment::UpperArmR, BodySegment::ForearmR];
        let mut offsets_m = Places::default();
        worn.into_iter().for_each(|at| offsets_m[at.index()] = Some(skeleton.usual_sensor_m(at)));
        for (bent_deg, pose) in [
            (10.0, BlockKind::NPose),
            (10.0, BlockKind::TPose),
            (80.0, BlockKind::NPose),
            (120.0, BlockKind::TPose),
        ] {
            let facing = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.0);
            let bent = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::to_radians(bent_deg));
            let orientations = BodySegment::ALL.map(|segment| {
                let straight = facing * upright() * posture(segment, pose == BlockKind::TPose);
                if segment == BodySegment::ForearmR { straight * bent } else { straight }
            });
            let origins_m = skeleton.origins_m(&orientations, Vector3::new(0.3, -0.2, 0.9));
            let mut trackers = Trackers::new(skeleton, offsets_m);
            let mut places = Places::default();
            for at in worn.map(BodySegment::index) {
                places[at] = offsets_m[at].map(|offset_m| origins_m[at] + orientations[at] * offset_m);
            }
            trackers.push(&[Some(Vector3::repeat(9.0)); SEGMENTS]);
            trackers.clear();
            for _ in 0..50 {
                trackers.push(&places);
            }
            let found = trackers.objection_to(pose);
            assert_eq!(found.is_some(), bent_deg > 45.0, "{pose:?} {bent_deg} {found:?}");
            assert!(found.is_none_or(|found| found.second == "forearm_r"), "{pose:?}");
            // What was seen is forgotten.
            assert_eq!(trackers.objection_to(pose), None);
        }
    }
}
