//! What the bodies of a stage are made of, by name: its segments and joints, their angles, and which sensor sits where.
//!
//! In: a stage. Out: names and indices that the pipeline, messages and exercises share. It knows no measurement.

use std::borrow::Cow;
use std::ops::Range;

use nalgebra::Vector3;

use crate::input::SensorIndex;
use crate::{BodyIndex, Stage};
use posed_fusion::body::{ANGLE_NAMES, BodySegment, SEGMENTS, Skeleton, of_joint};
use posed_fusion::chain::ChainSegment;

/// Distance of several people of whom nobody knows where they are, m.
const SIDE_BY_SIDE_M: f64 = 1.0;

/// Names and places of one of a stage's bodies: the human skeleton, or a chain of hinges.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BodyLayout {
    /// Segments, in the order in which [`crate::output::Body`] has them.
    pub segments: Vec<SegmentLayout>,
    /// Angles that the sensors can show, by their index in [`crate::output::Body::angles_rad`], rising segment by segment.
    pub shown_angles: Vec<usize>,
    /// Whether it is known where its segments are: a chain of hinges has no lengths.
    pub has_places: bool,
}

/// One segment and the joint above it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SegmentLayout {
    /// Its name.
    pub name: Cow<'static, str>,
    /// The joint's name; empty where it hangs on none.
    pub joint: Cow<'static, str>,
    /// Index in [`BodyLayout::segments`] of the segment it hangs on; `None` for the root.
    pub parent: Option<usize>,
    /// The joint's angles, by their index in [`crate::output::Body::angles_rad`]; empty for the root.
    pub angles: Range<usize>,
}

/// Which sensors sit on the segments of the human skeleton.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wearers {
    /// The IMU on each segment, by [`BodySegment::index`]; `None` where none sits.
    pub imus: [Option<SensorIndex>; SEGMENTS],
    /// Magnetic trackers, each with its segment, in the stage's order; several may sit on one segment.
    pub trackers: Vec<(SensorIndex, BodySegment)>,
}

impl Wearers {
    /// The sensors that a body of the stage wears ([`Stage::wearer_of`]) on segments of the human skeleton ([`segment_of`]).
    ///
    /// # Errors
    /// Two IMUs on one segment: their names, the earlier one first.
    pub fn of(stage: &Stage, body: BodyIndex) -> Result<Self, [String; 2]> {
        let mut wearers = Self::default();
        for (index, sensor) in (0..).zip(&stage.sensors) {
            let worn = stage.wearer_of(sensor) == Some(body);
            let Some(segment) = segment_of(sensor).filter(|_| worn) else { continue };
            if !stage.is_imu(sensor) {
                wearers.trackers.push((index, segment));
            } else if let Some(first) = wearers.imus[segment.index()].replace(index) {
                return Err([stage.sensors[usize::from(first)].name.clone(), sensor.name.clone()]);
            }
        }
        Ok(wearers)
    }

    /// The segments that messages have of such a body: all, but for the shoulders where neither wears a sensor.
    pub fn segments(&self) -> &'static [BodySegment] {
        let shoulders = BodySegment::SHOULDERS.into_iter().any(|shoulder| self.has(shoulder));
        let count = if shoulders { SEGMENTS } else { BodySegment::BEFORE_SHOULDERS };
        &BodySegment::ALL[..count]
    }

    fn has(&self, segment: BodySegment) -> bool {
        self.imus[segment.index()].is_some() || self.trackers.iter().any(|(_, at)| *at == segment)
    }
}

/// The lengths of a body, m: in proportion to `body.height_m` ([`Skeleton::from_height`]), each replaced by what
/// `body.lengths_m` gives. `None` without a height, or with one that is not above 0.
pub fn skeleton_of(body: &crate::Body) -> Option<Skeleton> {
    let height_m = body.height_m.filter(|height_m| height_m.is_finite() && *height_m > 0.0)?;
    let by_height = Skeleton::from_height(height_m);
    let measured = body.lengths_m.unwrap_or_default();
    Some(Skeleton {
        shoulder_half_m: measured.shoulders.map_or(by_height.shoulder_half_m, |width_m| 0.5 * width_m),
        hip_half_m: measured.hips.map_or(by_height.hip_half_m, |width_m| 0.5 * width_m),
        trunk_m: measured.trunk.unwrap_or(by_height.trunk_m),
        upper_arm_m: measured.upper_arm.unwrap_or(by_height.upper_arm_m),
        forearm_m: measured.forearm.unwrap_or(by_height.forearm_m),
        thigh_m: measured.thigh.unwrap_or(by_height.thigh_m),
        shank_m: measured.shank.unwrap_or(by_height.shank_m),
        foot_m: measured.ankle.unwrap_or(by_height.foot_m),
        head_m: measured.head.unwrap_or(by_height.head_m),
        hand_m: measured.hand.unwrap_or(by_height.hand_m),
        toes_m: measured.toes.unwrap_or(by_height.toes_m),
    })
}

/// Where a body stands at first, room x and y, m: as its `start_m` says, else above the room's origin, several side by side along y.
pub fn start_of(stage: &Stage, body: BodyIndex) -> [f64; 2] {
    let given = stage.bodies.get(usize::from(body)).and_then(|body| body.start_m);
    given.unwrap_or([0.0, SIDE_BY_SIDE_M * (f64::from(body) - 0.5 * (stage.bodies.len().max(1) - 1) as f64)])
}

/// A body's colour, `#rrggbb`: that of the stage file, else one of its own by its place among the bodies; none is that of a fault.
pub fn color_of(stage: &Stage, body: BodyIndex) -> String {
    const USUAL: [&str; 6] = ["#6f94b8", "#9a7fc1", "#4f9d8f", "#b9769b", "#8a9a4b", "#7d8594"];
    let at = usize::from(body);
    let given = stage.bodies.get(at).and_then(|body| body.color.clone());
    given.unwrap_or_else(|| USUAL[at % USUAL.len()].to_owned())
}

/// The segment of the human skeleton that a sensor sits on: by its `segment`, else by its name; `None` where that is none of
/// its names.
pub fn segment_of(sensor: &crate::Sensor) -> Option<BodySegment> {
    BodySegment::named(sensor.sits_on())
}

/// Where a sensor sits on a segment: `offset_m` of the stage file, segment frame, m; `None` where the stage file does not say,
/// or says that it sits on another.
pub fn offset_on(sensor: &crate::Sensor, segment: BodySegment) -> Option<Vector3<f64>> {
    sensor.offset_m.filter(|_| segment_of(sensor) == Some(segment)).map(Vector3::from)
}

impl BodyLayout {
    /// Of all bodies of a stage, in their order: see [`Self::of`].
    pub fn all(stage: &Stage) -> Vec<Option<Self>> {
        (0..).zip(&stage.bodies).map(|(index, _)| Self::of(stage, index)).collect()
    }

    /// Of a body of a stage that wears sensors. `None` without that body, without a sensor on the human skeleton, with two IMUs on one
    /// of its segments, or with a custom skeleton that is no [`ChainLayout`].
    ///
    /// With an IMU on the body an angle is shown where both segments beside the joint wear a sensor; trackers alone show all of trunk and limbs, and of neck, wrists,
    /// ankles and collar bones those below which one sits.
    pub fn of(stage: &Stage, body: BodyIndex) -> Option<Self> {
        if stage.bodies.get(usize::from(body))?.skeleton != crate::Skeleton::Human {
            return ChainLayout::of(stage, body).map(Self::of_chain);
        }
        let wearers = Wearers::of(stage, body).ok()?;
        if wearers == Wearers::default() {
            return None;
        }
        let segments = wearers.segments().iter().map(|segment| SegmentLayout {
            name: segment.name().into(),
            joint: of_joint(*segment).next().map_or("", |angle| joint_and_angle(ANGLE_NAMES[angle]).0).into(),
            parent: segment.parent().map(BodySegment::index),
            angles: of_joint(*segment),
        });
        // Trackers alone show the whole figure, IMUs what lies between two sensors.
        let imus = wearers.imus.iter().any(Option::is_some);
        let shown = |segment: &BodySegment| {
            let parent = segment.parent();
            let whole = !imus && !BodySegment::LEAVES.contains(segment);
            let worn = wearers.has(*segment);
            parent.is_some_and(|parent| whole || (worn && (!imus || wearers.has(parent))))
        };
        let shown_angles = BodySegment::ALL.into_iter().filter(shown).flat_map(of_joint).collect();
        Some(Self { segments: segments.collect(), shown_angles, has_places: true })
    }

    fn of_chain(chain: ChainLayout) -> Self {
        let ChainLayout { segments, .. } = chain;
        let shown_angles = (0..segments.len()).filter(|at| segments[*at].hinge.is_some()).collect();
        let segments = segments.into_iter().enumerate().map(|(at, segment)| {
            let (parent, joint) =
                segment.hinge.map_or((None, String::new()), |(parent, joint)| (Some(parent), joint));
            let angles = if parent.is_some() { at..at + 1 } else { 0..0 };
            SegmentLayout { name: segment.name.into(), joint: joint.into(), parent, angles }
        });
        Self { segments: segments.collect(), shown_angles, has_places: false }
    }

    /// Names of the segments whose places are known: all, or none for a chain of hinges.
    pub fn places(&self) -> impl Iterator<Item = &str> + Clone {
        self.segments.iter().filter(|_| self.has_places).map(|segment| &*segment.name)
    }

    /// Joint and angle of the angle at `index` of [`crate::output::Body::angles_rad`]: `elbow_r` and `flexion`. Both are empty
    /// where no joint has it.
    pub fn angle(&self, index: usize) -> (&str, &'static str) {
        let above = self.segments.iter().find(|segment| segment.angles.contains(&index));
        above.map_or(("", ""), |segment| (&segment.joint, segment.angle(index)))
    }

    /// Columns of [`Self::shown_angles`] for exercises, in their order: `elbow_r_flexion_deg` and so on, as `posed body solve`
    /// writes them; degrees.
    pub fn columns(&self) -> impl Iterator<Item = String> {
        self.shown_angles.iter().map(|index| {
            let (joint, angle) = self.angle(*index);
            format!("{joint}_{angle}_deg")
        })
    }
}

impl SegmentLayout {
    /// What one of the joint's angles is called, `index` being one of [`Self::angles`]; a hinge of a chain has its flexion alone.
    ///
    /// # Panics
    /// The segment is one of the human skeleton, and `index` is beyond its 44 angles.
    pub fn angle(&self, index: usize) -> &'static str {
        let human = BodySegment::named(&self.name).is_some_and(|segment| of_joint(segment) == self.angles);
        if human { joint_and_angle(ANGLE_NAMES[index]).1 } else { "flexion" }
    }
}

/// A custom skeleton of hinges with an IMU on each segment.
#[derive(Clone, Debug, PartialEq)]
pub struct ChainLayout {
    /// The segments in the order of the stage file, parents first; 1 to 17.
    pub segments: Vec<ChainSegment>,
    /// The IMU on each, in the same order; of several the first in the stage file.
    pub imus: Vec<SensorIndex>,
}

impl ChainLayout {
    /// Of a body of the stage with a custom skeleton. `None` where that is no such chain: no segment, more than 17, a joint that is no hinge,
    /// a parent that is not above its child, or a segment without an IMU.
    pub fn of(stage: &Stage, body: BodyIndex) -> Option<Self> {
        let wearer = Some(body);
        let body = stage.bodies.get(usize::from(body))?;
        if body.skeleton != crate::Skeleton::Custom {
            return None;
        }
        if body.segments.is_empty() || body.segments.len() > SEGMENTS {
            return None;
        }
        let mut segments: Vec<ChainSegment> = Vec::new();
        let mut imus = Vec::new();
        for segment in &body.segments {
            let hinge = match (&segment.parent, &segment.joint) {
                (Some(parent), Some(joint)) if segment.kind == Some(crate::JointKind::Hinge) => {
                    Some((segments.iter().position(|known| known.name == *parent)?, joint.clone()))
                }
                (None, _) => None,
                _ => return None,
            };
            let sits = |sensor: &crate::Sensor| {
                stage.is_imu(sensor) && sensor.sits_on() == segment.name && stage.wearer_of(sensor) == wearer
            };
            imus.push(stage.sensors.iter().position(sits)? as SensorIndex);
            segments.push(ChainSegment { name: segment.name.clone(), hinge });
        }
        Some(Self { segments, imus })
    }
}

/// The joint and the angle that a name of [`ANGLE_NAMES`] is made of: `elbow_r` and `flexion`. A name without `_` is both.
pub fn joint_and_angle(name: &'static str) -> (&'static str, &'static str) {
    name.rsplit_once('_').unwrap_or((name, name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_lengths_take_the_place_of_those_of_the_height() {
        let text = "name = \"a\"\n[body]\nheight_m = 2.0\nlengths_m = { thigh = 0.41, shoulders = 0.4 }";
        let skeleton = skeleton_of(&Stage::parse(text).unwrap().bodies[0]).unwrap();
        let by_height = Skeleton::from_height(2.0);
        assert_eq!((skeleton.thigh_m, skeleton.shoulder_half_m), (0.41, 0.2));
        assert_eq!(
            Skeleton { thigh_m: by_height.thigh_m, shoulder_half_m: by_height.shoulder_half_m, ..skeleton },
            by_height
        );
        assert!(Stage::parse(&text.replace("0.41", "4.1")).is_err());
    }
}
