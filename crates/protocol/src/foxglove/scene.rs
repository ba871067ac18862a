//! What is drawn: sensors as balls with names, the body as a figure of lines. Pieces of the published schemas, ready to be written.
//!
//! Colours say how far to trust: blue is good, violet repaired or extrapolated, orange suspect, red stuck, grey late or inferred. What is missing is
//! not drawn.

use std::borrow::Cow;

use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::{Names, round};
use posed_fusion::body::{BodySegment, SEGMENTS, Skeleton};
use posed_geometry::isometry;
use posed_stage::output::{Body, Estimate, SegmentEstimate, SegmentState, SensorState};

/// Diameter of a sensor's ball, m.
const BALL_M: f64 = 0.04;
/// Width of the figure's lines, m.
const LINE_M: f64 = 0.035;
/// Height of the letters of a name, m.
const LETTERS_M: f64 = 0.05;
/// Diameter of the figure's head in lengths of head and neck (Drillis & Contini 1966, as the skeleton).
const SKULL: f64 = 0.71;

/// Seconds and nanoseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Time {
    sec: u64,
    nsec: u64,
}

impl Time {
    /// Of nanoseconds since 1970.
    pub(super) fn of(utc_ns: u64) -> Self {
        Self { sec: utc_ns / 1_000_000_000, nsec: utc_ns % 1_000_000_000 }
    }
}

#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Xyz {
    x: f64,
    y: f64,
    z: f64,
}

impl Xyz {
    fn of(position_m: [f64; 3]) -> Self {
        let [x, y, z] = round::each(round::POSITION, position_m);
        Self { x, y, z }
    }
}

#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Xyzw {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Pose {
    pub(super) position: Xyz,
    pub(super) orientation: Xyzw,
}

impl Pose {
    /// Rounded as on our own websocket; `None` of numbers that are none, which JSON cannot say.
    pub(super) fn of(position_m: [f64; 3], orientation_wxyz: [f64; 4]) -> Option<Self> {
        position_m.iter().chain(&orientation_wxyz).all(|value| value.is_finite()).then_some(())?;
        let [w, i, j, k] = round::each(round::QUATERNION, orientation_wxyz);
        Some(Self { position: Xyz::of(position_m), orientation: Xyzw { x: i, y: j, z: k, w } })
    }

    fn at(position_m: [f64; 3]) -> Self {
        let orientation = Xyzw { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };
        Self { position: Xyz::of(position_m), orientation }
    }
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Color {
    r: f64,
    g: f64,
    b: f64,
    a: f64,
}

impl Color {
    const GOOD: Self = Self::rgb(0.16, 0.55, 0.9);
    const MENDED: Self = Self::rgb(0.55, 0.4, 0.9);
    const SUSPECT: Self = Self::rgb(0.95, 0.6, 0.1);
    const STUCK: Self = Self::rgb(0.9, 0.2, 0.2);
    const PALE: Self = Self::rgb(0.6, 0.6, 0.6);

    const fn rgb(r: f64, g: f64, b: f64) -> Self {
        Self { r, g, b, a: 1.0 }
    }

    fn of_sensor(state: SensorState) -> Option<Self> {
        match state {
            SensorState::Ok => Some(Self::GOOD),
            SensorState::Repaired | SensorState::Extrapolated => Some(Self::MENDED),
            SensorState::Suspect => Some(Self::SUSPECT),
            SensorState::Stuck => Some(Self::STUCK),
            SensorState::Late => Some(Self::PALE),
            SensorState::Missing => None,
        }
    }

    fn of_segment(state: SegmentState) -> Option<Self> {
        match state {
            SegmentState::Ok => Some(Self::GOOD),
            SegmentState::Inferred => Some(Self::PALE),
            SegmentState::Suspect => Some(Self::SUSPECT),
            SegmentState::Missing => None,
        }
    }
}

#[derive(Debug, Serialize)]
struct Solid {
    pose: Pose,
    size: Xyz,
    color: Color,
}

impl Solid {
    fn ball(position_m: [f64; 3], diameter_m: f64, color: Color) -> Self {
        let size = Xyz { x: diameter_m, y: diameter_m, z: diameter_m };
        Self { pose: Pose::at(position_m), size, color }
    }
}

#[derive(Debug, Serialize)]
struct Lines {
    r#type: u8,
    pose: Pose,
    thickness: f64,
    scale_invariant: bool,
    points: Vec<Xyz>,
    color: Color,
    colors: Vec<Color>,
    indices: [u32; 0],
}

#[derive(Debug, Serialize)]
struct Text<'a> {
    pose: Pose,
    billboard: bool,
    font_size: f64,
    scale_invariant: bool,
    color: Color,
    text: &'a str,
}

/// What none of an entity's things is.
type Nothing = [u8; 0];

/// `foxglove.SceneUpdate` of one entity, which takes the place of the one before.
#[derive(Debug, Serialize)]
pub(super) struct SceneUpdate<'a> {
    deletions: Nothing,
    entities: [Entity<'a>; 1],
}

#[derive(Debug, Serialize)]
struct Entity<'a> {
    timestamp: Time,
    frame_id: &'static str,
    id: Cow<'static, str>,
    /// Until the next one: the clocks of viewer and stage may differ.
    lifetime: Time,
    frame_locked: bool,
    metadata: Nothing,
    arrows: Nothing,
    cubes: Vec<Solid>,
    spheres: Vec<Solid>,
    cylinders: Nothing,
    lines: Vec<Lines>,
    triangles: Nothing,
    texts: Vec<Text<'a>>,
    models: Nothing,
}

impl<'a> SceneUpdate<'a> {
    fn new(timestamp: Time, id: impl Into<Cow<'static, str>>) -> Self {
        let entity = Entity {
            timestamp,
            frame_id: super::ROOM,
            id: id.into(),
            lifetime: Time::default(),
            frame_locked: false,
            metadata: [],
            arrows: [],
            cubes: Vec::new(),
            spheres: Vec::new(),
            cylinders: [],
            lines: Vec::new(),
            triangles: [],
            texts: Vec::new(),
            models: [],
        };
        Self { deletions: [], entities: [entity] }
    }

    /// Sensors that have a position, and the transmitter.
    pub(super) fn sensors(
        timestamp: Time,
        estimate: &Estimate,
        names: &'a Names,
        transmitter: Option<Pose>,
    ) -> Self {
        let mut scene = Self::new(timestamp, "sensors");
        let [entity] = &mut scene.entities;
        for (sensor, (name, _)) in estimate.sensors.iter().zip(names.sensors()) {
            let position_m = sensor.pose.as_ref().and_then(|pose| pose.position_m);
            let position_m = position_m.filter(|position_m| position_m.iter().all(|value| value.is_finite()));
            let (Some(position_m), Some(color)) = (position_m, Color::of_sensor(sensor.state)) else {
                continue;
            };
            entity.spheres.push(Solid::ball(position_m, BALL_M, color));
            let [x, y, z] = position_m;
            entity.texts.push(Text {
                pose: Pose::at([x, y, z + LETTERS_M]),
                billboard: true,
                font_size: LETTERS_M,
                scale_invariant: false,
                color,
                text: name,
            });
        }
        if let Some(pose) = transmitter {
            // About the size of an extended-range transmitter.
            let size = Xyz { x: 0.3, y: 0.3, z: 0.3 };
            entity.cubes.push(Solid { pose, size, color: Color { a: 0.5, ..Color::PALE } });
        }
        scene
    }

    /// The figure: trunk, shoulders, hips, limbs, head.
    pub(super) fn body(timestamp: Time, body: &Body, skeleton: &Skeleton) -> Self {
        // What is drawn of a body takes the place of what was drawn of it before, and of nobody else.
        let mut scene = match body.index {
            0 => Self::new(timestamp, "body"),
            index => Self::new(timestamp, format!("body{}", u16::from(index) + 1)),
        };
        let [entity] = &mut scene.entities;
        let mut lines = Lines {
            r#type: 2,
            pose: Pose::at([0.0; 3]),
            thickness: LINE_M,
            scale_invariant: false,
            points: Vec::with_capacity(4 * SEGMENTS),
            color: Color::GOOD,
            colors: Vec::with_capacity(4 * SEGMENTS),
            indices: [],
        };
        for segment in BodySegment::ALL {
            let Some(DrawnSegment { color, pose }) = body.segments.get(segment.index()).and_then(placed)
            else {
                continue;
            };
            let mut line = |from: Vector3<f64>, to: Vector3<f64>| {
                for point in [from, to] {
                    lines.points.push(Xyz::of((pose * Point3::from(point)).coords.into()));
                    lines.colors.push(color);
                }
            };
            let [top, joint] = [skeleton.end_in_segment_m(segment), skeleton.joint_in_segment_m(segment)];
            if top != joint {
                line(joint, top);
            }
            let across = match segment {
                BodySegment::Torso if body.segments.len() == SEGMENTS => BodySegment::SHOULDERS,
                BodySegment::Torso => [BodySegment::UpperArmR, BodySegment::UpperArmL],
                BodySegment::Pelvis => [BodySegment::ThighR, BodySegment::ThighL],
                _ => [segment; 2],
            };
            if across[0] != across[1] {
                line(skeleton.joint_in_parent_m(across[0]), skeleton.joint_in_parent_m(across[1]));
            }
            if segment == BodySegment::Head {
                let diameter_m = SKULL * skeleton.head_m;
                let middle = pose * Point3::from(top - Vector3::y() * (0.5 * diameter_m));
                entity.spheres.push(Solid::ball(middle.coords.into(), diameter_m, color));
            }
        }
        entity.lines.push(lines);
        scene
    }
}

struct DrawnSegment {
    color: Color,
    pose: nalgebra::Isometry3<f64>,
}

fn placed(segment: &SegmentEstimate) -> Option<DrawnSegment> {
    let color = Color::of_segment(segment.state)?;
    Some(DrawnSegment { color, pose: isometry(segment.position_m?, segment.orientation_wxyz?)? })
}
