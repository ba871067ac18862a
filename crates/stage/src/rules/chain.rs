//! What of a custom skeleton is not followed: better reported before a session than missed in it.

use super::super::body::{BodyIndex, JointKind, SEGMENTS, Skeleton};
use super::super::problem::Notes;
use super::super::{Sensor, Stage};
use super::Item;

/// Segments that are followed live: as many as a human body has.
const LONGEST: usize = SEGMENTS.len();

/// The whole chain is followed or nothing of it, so every reason is named.
pub(super) fn check(root: &Item<'_, '_>, stage: &Stage, notes: &mut Notes<'_>) {
    for ((index, body), table) in (0..).zip(&stage.bodies).zip(root.items("body")) {
        if body.skeleton == Skeleton::Custom {
            followed(stage, index, &table, notes);
        }
    }
}

fn followed(stage: &Stage, index: BodyIndex, table: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let (body, segments) = (&stage.bodies[usize::from(index)], table.items("segments"));
    let live = !stage.devices.is_empty();
    let sits = |sensor: &Sensor, name: &str| {
        stage.is_imu(sensor) && sensor.sits_on() == name && stage.wearer_of(sensor) == Some(index)
    };
    for (segment, written) in body.segments.iter().zip(&segments) {
        if let Some(joint) = &segment.joint
            && segment.kind != Some(JointKind::Hinge)
        {
            let message = format!("`{joint}` is no hinge, and chains with other joints are not solved");
            let at = written.get("kind").map_or(written.header.clone(), |kind| kind.span());
            notes.warning(&at, "kind", message, "leave out what hangs on it, or make it a `hinge`");
        }
        if live && !stage.sensors.iter().any(|sensor| sits(sensor, &segment.name)) {
            let message = format!("no IMU sits on `{}`: the chain is not followed live", segment.name);
            let fix = format!("add `segment = \"{}\"` to the [[sensor]] of an inertial device", segment.name);
            notes.warning(&written.header, "segments", message, fix);
        }
    }
    if live && let Some(first) = segments.get(LONGEST) {
        let message = format!("chains of more than {LONGEST} segments are not followed live");
        notes.warning(
            &first.header,
            "segments",
            message,
            "`posed body solve` takes longer ones from a recording",
        );
    }
}
