//! A device's settings from the schema of its driver, so that a new setting is drawn without a word here.

use serde_json::Value;

use crate::dice::Dice;

/// A setting of a driver, with the value that was drawn.
#[derive(Clone, Debug)]
pub(crate) struct Setting {
    pub(crate) key: String,
    pub(crate) value: toml::Value,
}

/// Share of settings that are drawn at all.
const DRAWN: f64 = 0.25;
/// Share of these that lie beyond their limits.
const BEYOND: f64 = 0.01;

/// What a driver's settings may be, as its type says.
pub(crate) fn draw(dice: &mut Dice, schema: &Value) -> Vec<Setting> {
    let mut drawn = Vec::new();
    let Some(properties) = schema["properties"].as_object() else { return drawn };
    for (key, property) in properties {
        // Which unit is which: the plan says it.
        if matches!(key.as_str(), "trackers" | "devices") || !dice.chance(DRAWN) {
            continue;
        }
        let beyond = dice.chance(BEYOND);
        if let Some(value) = value(dice, property, schema, beyond) {
            drawn.push(Setting { key: key.clone(), value });
        }
    }
    drawn
}

fn value(dice: &mut Dice, schema: &Value, root: &Value, beyond: bool) -> Option<toml::Value> {
    if beyond && dice.chance(0.2) {
        return Some(toml::Value::String("what".into()));
    }
    if let Some(path) = schema["$ref"].as_str() {
        let referred = root.pointer(path.strip_prefix('#')?)?;
        return value(dice, referred, root, beyond);
    }
    for alternatives in ["oneOf", "anyOf"] {
        if let Some(of) = schema[alternatives].as_array() {
            let of: Vec<&Value> = of.iter().filter(|one| one["type"] != "null").collect();
            return (!of.is_empty()).then(|| *dice.pick(&of)).and_then(|one| value(dice, one, root, beyond));
        }
    }
    if !schema["const"].is_null() {
        return toml::Value::try_from(&schema["const"]).ok();
    }
    if let Some(words) = schema["enum"].as_array() {
        let words: Vec<&Value> = words.iter().filter(|word| !word.is_null()).collect();
        return toml::Value::try_from(*dice.pick(&words)).ok();
    }
    let kind = match &schema["type"] {
        Value::String(kind) => kind.as_str(),
        Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null")?,
        _ => return None,
    };
    let least = schema["minimum"].as_f64();
    let most = schema["maximum"].as_f64();
    match kind {
        "boolean" => Some(dice.chance(0.5).into()),
        "number" if beyond => {
            let wild = [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e308, 5e-324, -1e9];
            Some((*dice.pick(&wild)).into())
        }
        "number" => {
            let (least, most) = (least.unwrap_or(-1.0), most.unwrap_or(1.0));
            Some(limit_or(dice, least, most, |dice| dice.range(least, most)).into())
        }
        "integer" if beyond => Some((*dice.pick(&[-1i64, 0, 256, 65_536, i64::MAX, i64::MIN])).into()),
        "integer" => {
            let (least, most) = (least.unwrap_or(0.0), most.unwrap_or(255.0));
            Some((limit_or(dice, least, most, |dice| dice.range(least, most)).round() as i64).into())
        }
        "array" => {
            let fixed = schema["minItems"].as_u64().unwrap_or(0);
            let items = (0..fixed).map(|_| value(dice, &schema["items"], root, beyond));
            items.collect::<Option<Vec<_>>>().map(toml::Value::Array)
        }
        "object" => {
            let mut table = toml::Table::new();
            for (key, property) in schema["properties"].as_object()? {
                table.insert(key.clone(), value(dice, property, root, beyond)?);
            }
            Some(toml::Value::Table(table))
        }
        _ => None,
    }
}

/// The limits themselves one time in five.
fn limit_or(dice: &mut Dice, least: f64, most: f64, inside: impl FnOnce(&mut Dice) -> f64) -> f64 {
    match dice.below(10) {
        0 => least,
        1 => most,
        _ => inside(dice),
    }
}
