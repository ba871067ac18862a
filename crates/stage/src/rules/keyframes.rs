//! Key poses: the sensors that are watched exist, and the method reads the keys that are there.

use super::super::problem::Notes;
use super::{Item, suggest};
use crate::keyframes::{Keyframes, KeyframesMethod};

pub(super) fn check(root: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let Some(keyframes) = root.item("keyframes") else { return };
    let is_paper = keyframes.text("method").is_some_and(|method| method.value == "paper");
    for (key, method) in Keyframes::KEYS {
        if let Some(value) = keyframes.get(key)
            && is_paper != (method == KeyframesMethod::Paper)
        {
            let of = if is_paper { "hinge" } else { "paper" };
            let problem = format!("the method that is chosen does not read `{key}`");
            notes.problem(
                &value.span(),
                key,
                problem,
                format!("choose `method = \"{of}\"`, or delete the key"),
            );
        }
    }
    let sensors = root.items("sensor");
    let names: Vec<&str> = sensors.iter().filter_map(|sensor| Some(sensor.text("name")?.value)).collect();
    let Some(watched) = keyframes.get("sensors").and_then(|value| value.get_ref().as_array()) else { return };
    for value in watched.iter() {
        let Some(name) = value.get_ref().as_str().filter(|name| !names.contains(name)) else { continue };
        let fix = suggest(name, &names, "add a [[sensor]] with this name");
        notes.problem(&value.span(), "sensors", format!("there is no sensor `{name}`"), fix);
    }
}
