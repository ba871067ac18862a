//! The bodies: who wears what, segments, and when a pose was held.

use super::super::body::{MOST_BODIES, MOVEMENTS, POSES, SEGMENTS, TRUNK_MOVEMENTS};
use super::super::layout::{Wearers, skeleton_of};
use super::super::problem::Notes;
use super::super::{BodyIndex, Skeleton, Stage};
use super::{Item, one_of, suggest, unique};

pub(super) fn check(root: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let sensors = root.items("sensor");
    let bodies = root.items("body");
    if bodies.is_empty() {
        for sensor in &sensors {
            for key in ["body", "segment", "mount_quat_wxyz", "offset_m"] {
                if let Some(value) = sensor.get(key) {
                    notes.problem(
                        &value.span(),
                        key,
                        "nobody wears this sensor",
                        "add a [[body]] table, or remove the key",
                    );
                }
            }
        }
        return;
    }
    named(&bodies, &sensors, notes);
    for body in &bodies {
        let wears = |sensor: &&Item<'_, '_>| match (sensor.text("body"), body.text("name")) {
            (Some(worn_by), Some(name)) => worn_by.value == name.value,
            (None, _) => bodies.len() == 1,
            (Some(_), None) => false,
        };
        let worn: Vec<&Item<'_, '_>> = sensors.iter().filter(wears).collect();
        check_body(body, &worn, notes);
    }
}

/// Names that distinguish bodies, and sensors that say which one wears them.
fn named(bodies: &[Item<'_, '_>], sensors: &[Item<'_, '_>], notes: &mut Notes<'_>) {
    unique(bodies, "name", "body", notes);
    if let Some(first) = bodies.get(MOST_BODIES) {
        let message = format!("more than {MOST_BODIES} bodies are not followed");
        notes.problem(&first.header, "body", message, "follow the others on a stage of their own");
    }
    let several = bodies.len() > 1;
    for body in bodies {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if let Some(name) = body.text("name").filter(|name| !name.value.chars().all(plain)) {
            let fix = "write letters, digits, `-` and `_`: it stands in names of columns and files";
            notes.problem(&name.at, "name", format!("`{}` is no name for a body", name.value), fix);
        }
        if several && !body.has("name") {
            let message = "one of several bodies has no name";
            notes.problem(&body.header, "name", message, "add `name`: who wears the sensors");
        }
        let is_color = |text: &str| {
            text.strip_prefix('#')
                .is_some_and(|hex| hex.len() == 6 && hex.chars().all(|c| c.is_ascii_hexdigit()))
        };
        if let Some(color) = body.text("color").filter(|color| !is_color(color.value)) {
            let message = format!("`{}` is no colour", color.value);
            notes.problem(&color.at, "color", message, "write red, green and blue as \"#rrggbb\"");
        }
    }
    let names: Vec<&str> = bodies.iter().filter_map(|body| Some(body.text("name")?.value)).collect();
    for sensor in sensors {
        match sensor.text("body") {
            Some(body) if !names.contains(&body.value) => {
                let fix = suggest(body.value, &names, "give the body this `name`, or remove the key");
                notes.problem(&body.at, "body", format!("there is no body `{}`", body.value), fix);
            }
            None if several => {
                if let Some(segment) = sensor.get("segment") {
                    let message = "there are several bodies, and nobody is said to wear this sensor";
                    let fix = format!("add `body`: {}", one_of(names.iter().copied()));
                    notes.problem(&segment.span(), "body", message, fix);
                }
            }
            _ => {}
        }
    }
}

fn check_body(body: &Item<'_, '_>, sensors: &[&Item<'_, '_>], notes: &mut Notes<'_>) {
    let segments = body.items("segments");
    let custom = body.text("skeleton").is_some_and(|skeleton| skeleton.value == "custom");
    if custom {
        tree(body, &segments, notes);
    } else if let Some(list) = body.get("segments") {
        let fix = "set skeleton = \"custom\", or remove [[body.segments]]";
        notes.problem(&list.span(), "segments", "the human skeleton has its own segments", fix);
    }
    let names: Vec<&str> = if custom {
        segments.iter().filter_map(|segment| Some(segment.text("name")?.value)).collect()
    } else {
        SEGMENTS.to_vec()
    };
    body_sensors(body, sensors, &names, notes);
    if custom {
        for key in ["reset_by_button", "reset_by_double_tap"] {
            if let Some(value) = body.get(key) {
                let message = "the hinges of a custom skeleton hold their own headings";
                notes.problem(&value.span(), key, message, "remove the key; it is for the human skeleton");
            }
        }
    } else {
        tapped(body, sensors, notes);
    }
    calibrations(body, &segments, custom, notes);
}

/// What the pipeline asks of a human body: one IMU on each segment at most, and a height to make the segments of.
pub(super) fn check_wearer(root: &Item<'_, '_>, stage: &Stage, notes: &mut Notes<'_>) {
    for ((index, body), table) in (0..).zip(&stage.bodies).zip(root.items("body")) {
        if body.skeleton == Skeleton::Human {
            check_human(root, stage, index, &table, notes);
        }
    }
}

fn check_human(
    root: &Item<'_, '_>,
    stage: &Stage,
    index: BodyIndex,
    table: &Item<'_, '_>,
    notes: &mut Notes<'_>,
) {
    let body = &stage.bodies[usize::from(index)];
    match Wearers::of(stage, index) {
        Err([first, second]) => {
            let sensors = root.items("sensor");
            let is_second =
                |sensor: &&Item<'_, '_>| sensor.text("name").is_some_and(|name| name.value == second);
            let at =
                sensors.iter().find(is_second).map_or(table.header.clone(), |sensor| sensor.header.clone());
            let message = format!("the IMUs `{first}` and `{second}` sit on the same segment");
            notes.problem(&at, "segment", message, "give each a `segment` of its own");
        }
        Ok(wearers) if wearers != Wearers::default() && skeleton_of(body).is_none() => {
            // Commands that work on files need none.
            let fix = "add `height_m`: the person's height";
            let message = "sensors sit on a body whose height is not known: `posed run` will not start";
            notes.idle(&table.header, "height_m", message, fix);
        }
        Ok(_) => {}
    }
}

/// A custom skeleton is a tree with its root first and parents before their children.
fn tree(body: &Item<'_, '_>, segments: &[Item<'_, '_>], notes: &mut Notes<'_>) {
    if segments.is_empty() {
        let at = body.get("skeleton").map_or(body.header.clone(), |skeleton| skeleton.span());
        notes.problem(
            &at,
            "segments",
            "a custom skeleton has no segments",
            "add [[body.segments]], or set skeleton = \"human\"",
        );
    }
    unique(segments, "name", "segment", notes);
    unique(segments, "joint", "segment", notes);
    let mut earlier: Vec<&str> = Vec::new();
    for segment in segments {
        match segment.text("parent") {
            Some(parent) if !earlier.contains(&parent.value) => {
                let message = format!("`{}` is no segment above this one", parent.value);
                let fix =
                    suggest(parent.value, &earlier, "put the root first, and parents before their children");
                notes.problem(&parent.at, "parent", message, fix);
            }
            Some(_) => {
                for key in ["joint", "kind"].into_iter().filter(|key| !segment.has(key)) {
                    let message = format!("the key `{key}` of a segment with a parent is missing");
                    let fix = if key == "joint" {
                        "add `joint`: the name of the joint to the parent"
                    } else {
                        "add `kind`: `hinge`, `two_axis` or `ball`"
                    };
                    notes.problem(&segment.header, key, message, fix);
                }
            }
            None if segment.has("parent") => {}
            None => {
                if !earlier.is_empty() {
                    let fix = "add `parent`: a skeleton hangs together, and only its first segment has none";
                    notes.problem(&segment.header, "parent", "a second root", fix);
                }
                for key in ["joint", "kind"] {
                    if let Some(value) = segment.get(key) {
                        notes.problem(
                            &value.span(),
                            key,
                            "the root hangs on no joint",
                            "remove it, or add `parent`",
                        );
                    }
                }
            }
        }
        earlier.extend(segment.text("name").map(|name| name.value));
    }
}

fn body_sensors(body: &Item<'_, '_>, sensors: &[&Item<'_, '_>], names: &[&str], notes: &mut Notes<'_>) {
    let given = body.text("mounting").is_some_and(|mounting| mounting.value == "given");
    for sensor in sensors {
        let segment = sensor.text("segment");
        if let Some(segment) = segment.as_ref().filter(|segment| !names.contains(&segment.value)) {
            let fix = suggest(segment.value, names, "add [[body.segments]]");
            notes.problem(&segment.at, "segment", format!("there is no segment `{}`", segment.value), fix);
        }
        let role = sensor.text("name").is_some_and(|name| names.contains(&name.value));
        let on_body = sensor.has("segment") || role;
        if given && on_body && !sensor.has("mount_quat_wxyz") {
            let fix = "add `mount_quat_wxyz` (sensor to segment), or set mounting = \"calibrate\"";
            notes.problem(
                &sensor.header,
                "mount_quat_wxyz",
                "the mounting is given, but not for this sensor",
                fix,
            );
        }
        if !on_body {
            for key in ["mount_quat_wxyz", "offset_m"] {
                if let Some(value) = sensor.get(key) {
                    notes.problem(&value.span(), key, "this sensor sits on no segment", "add `segment`");
                }
            }
        }
    }
}

/// The segment that is tapped wears a sensor.
fn tapped(body: &Item<'_, '_>, sensors: &[&Item<'_, '_>], notes: &mut Notes<'_>) {
    let Some(tapped) = body.text("reset_by_double_tap") else { return };
    let sits = |sensor: &&Item<'_, '_>| {
        sensor.text("segment").or(sensor.text("name")).is_some_and(|segment| segment.value == tapped.value)
    };
    if !SEGMENTS.contains(&tapped.value) {
        let message = format!("there is no segment `{}`", tapped.value);
        notes.problem(&tapped.at, "reset_by_double_tap", message, suggest(tapped.value, &SEGMENTS, ""));
    } else if !sensors.iter().any(sits) {
        let message = format!("no sensor sits on `{}`", tapped.value);
        notes.problem(&tapped.at, "reset_by_double_tap", message, "name a segment that wears an IMU");
    }
}

fn calibrations(body: &Item<'_, '_>, segments: &[Item<'_, '_>], custom: bool, notes: &mut Notes<'_>) {
    let mut words: Vec<String> = POSES.iter().map(ToString::to_string).collect();
    if custom {
        let joints = segments.iter().filter_map(|segment| Some(segment.text("joint")?.value));
        words.extend(joints.map(|joint| format!("{joint}_flexion")));
    } else {
        words.extend(TRUNK_MOVEMENTS.map(str::to_owned));
        words.extend(
            MOVEMENTS.iter().flat_map(|movement| ["r", "l"].map(|side| format!("{movement}_{side}"))),
        );
    }
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    for calibration in body.items("calibration") {
        if let Some(kind) = calibration.text("kind").filter(|kind| !words.contains(&kind.value)) {
            let message = format!("`{}` is no pose or movement of this skeleton", kind.value);
            notes.problem(&kind.at, "kind", message, suggest(kind.value, &words, ""));
        }
        if let (Some(start), Some(end)) = (calibration.number("start_s"), calibration.number("end_s"))
            && start.value >= end.value
        {
            let message = format!("it ends at {} s, not after its start at {} s", end.value, start.value);
            notes.problem(&end.at, "end_s", message, "write an end_s that is later than start_s");
        }
    }
}
