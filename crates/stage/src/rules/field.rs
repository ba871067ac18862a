//! The sensors that watch over the field.

use toml::de::DeValue;

use super::super::problem::Notes;
use super::{Item, suggest};

pub(super) fn check(root: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let sensors = root.items("sensor");
    let names: Vec<&str> = sensors.iter().filter_map(|sensor| Some(sensor.text("name")?.value)).collect();
    if let Some(field) = root.item("field") {
        for key in ["reference_sensors", "rigid_pairs"] {
            let list = field.get(key).and_then(|list| list.get_ref().as_array());
            list.into_iter().flat_map(|list| list.iter()).for_each(|one| match one.get_ref() {
                DeValue::Array(pair) => {
                    pair.iter()
                        .for_each(|name| known(name.get_ref().as_str(), name.span(), key, &names, notes));
                    let [a, b] = [0, 1].map(|k| pair.get(k).and_then(|name| name.get_ref().as_str()));
                    if a.is_some() && a == b {
                        let fix = "name two sensors that are fixed to each other";
                        notes.problem(&one.span(), key, "a pair of a sensor with itself", fix);
                    }
                }
                name => known(name.as_str(), one.span(), key, &names, notes),
            });
        }
    }
}

fn known(name: Option<&str>, at: std::ops::Range<usize>, key: &str, names: &[&str], notes: &mut Notes<'_>) {
    let Some(name) = name.filter(|name| !names.contains(name)) else { return };
    let fix = suggest(name, names, "add a [[sensor]] of that name");
    notes.problem(&at, key, format!("there is no sensor `{name}`"), fix);
}
