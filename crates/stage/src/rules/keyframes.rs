//! Key poses: the sensors that are watched exist.

use super::super::problem::Notes;
use super::{Item, suggest};

pub(super) fn check(root: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let Some(keyframes) = root.item("keyframes") else { return };
    let sensors = root.items("sensor");
    let names: Vec<&str> = sensors.iter().filter_map(|sensor| Some(sensor.text("name")?.value)).collect();
    let Some(watched) = keyframes.get("sensors").and_then(|value| value.get_ref().as_array()) else { return };
    for value in watched.iter() {
        let Some(name) = value.get_ref().as_str().filter(|name| !names.contains(name)) else { continue };
        let fix = suggest(name, &names, "add a [[sensor]] with this name");
        notes.problem(&value.span(), "sensors", format!("there is no sensor `{name}`"), fix);
    }
}
