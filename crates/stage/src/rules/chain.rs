//! What of a custom skeleton is not followed: better reported before a session than missed in it.

use super::super::Stage;
use super::super::body::{JointKind, SEGMENTS, Skeleton};
use super::super::problem::Notes;
use super::Item;

/// Segments that are followed live: as many as a human body has.
const LONGEST: usize = SEGMENTS.len();

/// The whole chain is followed or nothing of it, so every reason is named.
pub(super) fn check(root: &Item<'_, '_>, stage: &Stage, notes: &mut Notes<'_>) {
    let Some(body) = stage.body.as_ref().filter(|body| body.skeleton == Skeleton::Custom) else { return };
    let segments = root.item("body").map(|body| body.items("segments")).unwrap_or_default();
    let live = !stage.devices.is_empty();
    for (segment, written) in body.segments.iter().zip(&segments) {
        if let Some(joint) = &segment.joint
            && segment.kind != Some(JointKind::Hinge)
        {
            let message = format!("`{joint}` is no hinge, and chains with other joints are not solved");
            let at = written.get("kind").map_or(written.header.clone(), |kind| kind.span());
            notes.warning(&at, "kind", message, "leave out what hangs on it, or make it a `hinge`");
        }
        if live
            && !stage.sensors.iter().any(|sensor| stage.is_imu(sensor) && sensor.sits_on() == segment.name)
        {
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
