//! Changes of a stage file that keep its comments and its order.
//!
//! What comes in: the text of a stage file, and changes of its devices, sensors and bodies. What goes out: the changed text; which device,
//! sensor or body a line is about. What it never does: look at whether the result is right ([`check`](super::check()) does), or change who may
//! look and which programs and files the daemon loads: that is for those who may write the file itself.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json};
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Table as Keys, TableLike, Value};

/// Keys of new tables that come first, in this order; all others follow by name.
const FIRST_KEYS: [&str; 12] = [
    "name",
    "driver",
    "device",
    "port",
    "local_port",
    "baud",
    "address",
    "serial",
    "body",
    "segment",
    "height_m",
    "format",
];

/// Tables that a change can be about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "StageTable")]
pub enum Table {
    /// A `[[device]]`.
    Device,
    /// A `[[sensor]]`.
    Sensor,
    /// A `[[body]]`.
    Body,
}

impl Table {
    const ALL: [Self; 3] = [Self::Device, Self::Sensor, Self::Body];

    /// Its key in the stage file.
    pub fn key(self) -> &'static str {
        match self {
            Self::Device => "device",
            Self::Sensor => "sensor",
            Self::Body => "body",
        }
    }
}

/// One change of a stage file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "change", rename_all = "snake_case", deny_unknown_fields)]
#[schemars(rename = "StageChange")]
pub enum Change {
    /// Gives the stage another name.
    NameStage {
        /// Which.
        name: String,
    },
    /// Says how the magnetic transmitter stands in the room.
    PlaceTransmitter {
        /// Its place, m.
        position_m: [f64; 3],
        /// Turns transmitter coordinates into room coordinates: unit quaternion, scalar first.
        orientation_wxyz: [f64; 4],
    },
    /// Adds a device, a sensor or a body behind those that there are.
    Add {
        /// What.
        table: Table,
        /// Its keys, as in the stage file.
        keys: Map<String, Json>,
    },
    /// Sets a key of a device, a sensor or a body. A new `name` is used wherever the file says the old one.
    Set {
        /// Of what.
        table: Table,
        /// Of which, by its name.
        name: String,
        /// Which key.
        key: String,
        /// Its value, as in the stage file; null or absent: the key is removed.
        #[serde(default)]
        value: Option<Json>,
    },
    /// Removes a device with its sensors, a sensor, or a body, which no sensor is worn by any more.
    Remove {
        /// What.
        table: Table,
        /// Which, by its name.
        name: String,
    },
}

/// Why a change is not made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EditError {
    /// The text is no TOML.
    #[error("the stage file is no TOML: {0}; put it right in an editor first (`posed check` has the line)")]
    NoToml(String),
    /// Nothing has this name.
    #[error("the stage file has no {} {name:?}", table.key())]
    Unknown {
        /// Where it was looked for.
        table: Table,
        /// The name.
        name: String,
    },
    /// The tables are written as a list in one value.
    #[error(
        "the stage file writes its {0} as a list in brackets; write [[{0}]] tables, or change it in an editor"
    )]
    Inline(&'static str),
    /// A value that TOML does not have.
    #[error("{0}: TOML has no such value")]
    Value(String),
}

/// The text of a stage file with changes, made one after the other; all that they are not about stays as it is, to the byte.
///
/// # Errors
/// [`EditError`]: the text is no TOML, or a change is about something that is not there.
pub fn edit(text: &str, changes: &[Change]) -> Result<String, EditError> {
    let mut document: DocumentMut = text.parse().map_err(|error: toml_edit::TomlError| {
        EditError::NoToml(error.message().lines().next().unwrap_or_default().to_owned())
    })?;
    for change in changes {
        apply(&mut document, change)?;
    }
    Ok(document.to_string())
}

fn apply(document: &mut DocumentMut, change: &Change) -> Result<(), EditError> {
    match change {
        Change::NameStage { name } => put(document.as_table_mut(), "name", Value::from(name.as_str())),
        Change::PlaceTransmitter { position_m, orientation_wxyz } => {
            let list = |numbers: &[f64]| Value::from(numbers.iter().copied().collect::<Array>());
            let pose = transmitter(document)?;
            put(pose, "position_m", list(position_m));
            put(pose, "orientation_wxyz", list(orientation_wxyz));
        }
        Change::Add { table, keys } => {
            let mut added = Keys::new();
            let mut keys: Vec<(&String, &Json)> = keys.iter().collect();
            keys.sort_by_key(|(key, _)| {
                FIRST_KEYS.iter().position(|first| first == key).unwrap_or(FIRST_KEYS.len())
            });
            for (key, value) in keys {
                added.insert(key, Item::Value(in_toml(key, value)?));
            }
            // An empty line before its header.
            added.decor_mut().set_prefix("\n");
            tables(document, *table)?.push(added);
        }
        Change::Set { table, name, key, value } => {
            let value = value.as_ref().map(|value| in_toml(key, value)).transpose()?;
            let keys = named(document, *table, name)?;
            match &value {
                Some(value) => put(keys, key, value.clone()),
                None => _ = keys.remove(key),
            }
            if key == "name"
                && let Some(new) = value.as_ref().and_then(Value::as_str)
            {
                rename(document, *table, name, new);
            }
        }
        Change::Remove { table, name } => {
            named(document, *table, name)?;
            remove(document, *table, |keys| text_of(keys, "name") == Some(name));
            match table {
                Table::Device => {
                    remove(document, Table::Sensor, |keys| text_of(keys, "device") == Some(name));
                }
                Table::Body => {
                    let worn = |keys: &&mut Keys| text_of(keys, "body") == Some(name);
                    each(document, &["sensor"])
                        .into_iter()
                        .filter(worn)
                        .for_each(|keys| _ = keys.remove("body"));
                }
                Table::Sensor => {}
            }
        }
    }
    Ok(())
}

/// The keys of `[transmitter.pose_in_room]`, which is made where it is not there.
fn transmitter(document: &mut DocumentMut) -> Result<&mut dyn TableLike, EditError> {
    let bad = |key: &str| EditError::Value(key.to_owned());
    let outer = document.entry("transmitter").or_insert_with(|| {
        let mut table = Keys::new();
        // Of itself nothing is to stand there.
        table.set_implicit(true);
        Item::Table(table)
    });
    let pose = match outer.is_inline_table() {
        true => Item::Value(InlineTable::new().into()),
        false => Item::Table(Keys::new()),
    };
    let outer = outer.as_table_like_mut().ok_or_else(|| bad("transmitter"))?;
    outer.entry("pose_in_room").or_insert(pose).as_table_like_mut().ok_or_else(|| bad("pose_in_room"))
}

/// The tables of a kind; a single body stands among them, too.
fn tables(document: &mut DocumentMut, table: Table) -> Result<&mut ArrayOfTables, EditError> {
    let item = document.entry(table.key()).or_insert_with(|| Item::ArrayOfTables(ArrayOfTables::new()));
    if let Item::Table(single) = item {
        let mut all = ArrayOfTables::new();
        let mut single = std::mem::take(single);
        single.set_dotted(false);
        all.push(single);
        *item = Item::ArrayOfTables(all);
    }
    item.as_array_of_tables_mut().ok_or(EditError::Inline(table.key()))
}

fn named<'d>(document: &'d mut DocumentMut, table: Table, name: &str) -> Result<&'d mut Keys, EditError> {
    // A body without a name is called like this; see the schema.
    let is_it = |keys: &Keys| match text_of(keys, "name") {
        Some(known) => known == name,
        None => table == Table::Body && name == "person",
    };
    let found = tables(document, table)?.iter_mut().find(|keys| is_it(keys));
    found.ok_or_else(|| EditError::Unknown { table, name: name.to_owned() })
}

fn remove(document: &mut DocumentMut, table: Table, is_it: impl Fn(&Keys) -> bool) {
    let Ok(all) = tables(document, table) else { return };
    all.retain(|keys| !is_it(keys));
    if all.is_empty() {
        document.remove(table.key());
    }
}

/// Uses a new name wherever the file says the old one.
fn rename(document: &mut DocumentMut, table: Table, old: &str, new: &str) {
    let refers = |document: &mut DocumentMut, path: &[&str], key: &str| {
        for keys in each(document, path) {
            if let Some(item) = keys.get_mut(key) {
                replace(item, old, new);
            }
        }
    };
    match table {
        Table::Device => {
            refers(document, &["sensor"], "device");
            refers(document, &["simulation", "device"], "name");
        }
        Table::Sensor => {
            refers(document, &["simulation", "sensor"], "name");
            refers(document, &["field"], "reference_sensors");
            refers(document, &["field"], "rigid_pairs");
            refers(document, &["keyframes"], "sensors");
            for keys in each(document, &["sensor"]) {
                if let Some(sensor) = keys.get_mut("imu").and_then(|imu| imu.get_mut("sensor")) {
                    replace(sensor, old, new);
                }
            }
        }
        Table::Body => refers(document, &["sensor"], "body"),
    }
}

/// The tables at a path, whether one or several.
fn each<'d>(document: &'d mut DocumentMut, path: &[&str]) -> Vec<&'d mut Keys> {
    let mut found = vec![document.as_table_mut()];
    for key in path {
        found = found
            .into_iter()
            .filter_map(|keys| keys.get_mut(key))
            .flat_map(|item| match item {
                Item::Table(keys) => vec![keys],
                Item::ArrayOfTables(all) => all.iter_mut().collect(),
                Item::Value(_) | Item::None => Vec::new(),
            })
            .collect();
    }
    found
}

/// Replaces a text, alone or in lists.
fn replace(item: &mut Item, old: &str, new: &str) {
    fn within(value: &mut Value, old: &str, new: &str) {
        match value {
            Value::String(text) if text.value() == old => set(value, Value::from(new)),
            Value::Array(list) => list.iter_mut().for_each(|value| within(value, old, new)),
            _ => {}
        }
    }
    if let Some(value) = item.as_value_mut() {
        within(value, old, new);
    }
}

fn text_of<'k>(keys: &'k Keys, key: &str) -> Option<&'k str> {
    keys.get(key)?.as_str()
}

/// Sets a key; a comment behind the value stays.
fn put(keys: &mut dyn TableLike, key: &str, value: Value) {
    match keys.get_mut(key).and_then(Item::as_value_mut) {
        Some(present) => set(present, value),
        None => _ = keys.insert(key, Item::Value(value)),
    }
}

fn set(present: &mut Value, value: Value) {
    let decor = present.decor().clone();
    *present = value;
    *present.decor_mut() = decor;
}

fn in_toml(key: &str, value: &Json) -> Result<Value, EditError> {
    let none = || EditError::Value(key.to_owned());
    Ok(match value {
        Json::Null => return Err(none()),
        Json::Bool(value) => Value::from(*value),
        Json::Number(number) => match (number.as_i64(), number.as_f64()) {
            (Some(whole), _) => Value::from(whole),
            (None, Some(number)) => Value::from(number),
            (None, None) => return Err(none()),
        },
        Json::String(text) => Value::from(text.as_str()),
        Json::Array(list) => {
            let values: Result<Array, EditError> = list.iter().map(|value| in_toml(key, value)).collect();
            Value::from(values?)
        }
        Json::Object(keys) => {
            let mut table = InlineTable::new();
            for (key, value) in keys {
                table.insert(key, in_toml(key, value)?);
            }
            Value::from(table)
        }
    })
}

/// What a line of a stage file is about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Owner {
    /// The kind of its table.
    pub table: Table,
    /// The name that stands there; empty where none does.
    pub name: String,
}

/// For each of these lines (from 1) the device, sensor or body whose table it lies in; `None` where it lies in none of them.
pub fn owners(text: &str, lines: impl IntoIterator<Item = usize>) -> Vec<Option<Owner>> {
    let (document, _) = DeTable::parse_recoverable(text);
    let mut begins = vec![(0, None)];
    for (key, value) in document.get_ref().iter() {
        let table = Table::ALL.into_iter().find(|table| table.key() == key.get_ref());
        headers(value, table, None, &mut begins);
    }
    begins.sort_by_key(|(at, _)| *at);
    let line_of =
        |at: usize| 1 + text.as_bytes()[..at.min(text.len())].iter().filter(|byte| **byte == b'\n').count();
    let begins: Vec<(usize, Option<Owner>)> =
        begins.into_iter().map(|(at, owner)| (line_of(at), owner)).collect();
    lines
        .into_iter()
        .map(|line| {
            begins.iter().rev().find(|(begin, _)| *begin <= line).and_then(|(_, owner)| owner.clone())
        })
        .collect()
}

/// Where the tables of a value begin, and whose they are.
fn headers(
    value: &Spanned<DeValue<'_>>,
    table: Option<Table>,
    owner: Option<&Owner>,
    begins: &mut Vec<(usize, Option<Owner>)>,
) {
    match value.get_ref() {
        DeValue::Table(keys) => {
            let own = table.map(|table| {
                let name = keys.get("name").and_then(|name| name.get_ref().as_str());
                Owner { table, name: name.unwrap_or_default().to_owned() }
            });
            let owner = own.as_ref().or(owner);
            begins.push((value.span().start, owner.cloned()));
            keys.iter().for_each(|(_, value)| headers(value, None, owner, begins));
        }
        DeValue::Array(values) => values.iter().for_each(|value| headers(value, table, owner, begins)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const TEXT: &str = r#"# Our room.
name = "room"   # as on the door

# The wired ones.
[[device]]
name = "chain"
driver = "xbus"
port = "/dev/ttyUSB0" # left socket
baud = 460800

[[device]]
name = "other"
driver = "fastrak"
port = "/dev/ttyUSB1"

[body]
height_m = 1.7

# On the wrist.
[[sensor]]
name = "a"
device = "chain"
address = 1

[[sensor]]
name = "b"
device = "other"
address = 1
imu = { sensor = "a" }

[field]
reference_sensors = ["b"] # on the wall
rigid_pairs = [["a", "b"]]

[server]
listen = "127.0.0.1:9000"
"#;

    fn changed(changes: serde_json::Value) -> Result<String, EditError> {
        let changes: Vec<Change> = serde_json::from_value(changes).unwrap();
        edit(TEXT, &changes)
    }

    #[test]
    fn what_no_change_is_about_stays_to_the_byte() {
        assert_eq!(changed(json!([])).unwrap(), TEXT);
        let named = changed(json!([{"change": "name_stage", "name": "hall"}])).unwrap();
        assert_eq!(named, TEXT.replace("\"room\"", "\"hall\""));
        let port = json!({"change": "set", "table": "device", "name": "chain", "key": "port", "value": "/dev/ttyS0"});
        assert_eq!(changed(json!([port])).unwrap(), TEXT.replace("/dev/ttyUSB0", "/dev/ttyS0"));
        let height =
            json!({"change": "set", "table": "body", "name": "person", "key": "height_m", "value": 1.82});
        let expected = TEXT.replace("[body]", "[[body]]").replace("1.7", "1.82");
        assert_eq!(changed(json!([height])).unwrap(), expected);
    }

    #[test]
    fn what_is_added_stands_behind_its_kind() {
        let added = changed(json!([
            {"change": "add", "table": "device", "keys": {"port": "auto", "name": "new", "driver": "x-imu3"}},
            {"change": "add", "table": "sensor", "keys": {"address": 0, "device": "new", "name": "c", "segment": "head"}},
        ]))
        .unwrap();
        let device = "port = \"/dev/ttyUSB1\"\n\n[[device]]\nname = \"new\"\ndriver = \"x-imu3\"\nport = \"auto\"\n\n[body]";
        let sensor =
            "\n\n[[sensor]]\nname = \"c\"\ndevice = \"new\"\naddress = 0\nsegment = \"head\"\n\n[field]";
        assert!(added.contains(device) && added.contains(sensor), "{added}");
        let first = edit("name = \"s\"", &[]).unwrap();
        assert_eq!(first, "name = \"s\"\n");
        let body =
            serde_json::from_value(json!({"change": "add", "table": "body", "keys": {"height_m": 1.8}}))
                .unwrap();
        assert_eq!(edit("name = \"s\"\n", &[body]).unwrap(), "name = \"s\"\n\n[[body]]\nheight_m = 1.8\n");
    }

    #[test]
    fn a_new_name_is_used_wherever_the_old_one_stood() {
        let renamed = changed(json!([
            {"change": "set", "table": "sensor", "name": "a", "key": "name", "value": "wrist"},
            {"change": "set", "table": "sensor", "name": "b", "key": "name", "value": "wall"},
            {"change": "set", "table": "device", "name": "chain", "key": "name", "value": "wired"},
        ]))
        .unwrap();
        for expected in [
            "reference_sensors = [\"wall\"] # on the wall",
            "rigid_pairs = [[\"wrist\", \"wall\"]]",
            "imu = { sensor = \"wrist\" }",
            "name = \"wrist\"\ndevice = \"wired\"",
        ] {
            assert!(renamed.contains(expected), "{expected}: {renamed}");
        }
    }

    #[test]
    fn how_the_transmitter_stands_is_written_where_it_was_or_behind_all() {
        let place = serde_json::from_value::<Change>(json!({
            "change": "place_transmitter", "position_m": [1.0, 0.25, 0.5], "orientation_wxyz": [1.0, 0.0, 0.0, 0.0],
        }));
        let place = [place.unwrap()];
        let keys = "position_m = [1.0, 0.25, 0.5]\norientation_wxyz = [1.0, 0.0, 0.0, 0.0]\n";
        let header = "[transmitter.pose_in_room]\n";
        assert_eq!(edit(TEXT, &place).unwrap(), format!("{TEXT}\n{header}{keys}"));
        let before = "name = \"s\"\n\n[transmitter.pose_in_room]\nposition_m = [0, 0, 0]\n\n[server]\n";
        let after = format!("name = \"s\"\n\n{header}{keys}\n[server]\n");
        assert_eq!(edit(before, &place).unwrap(), after);
        for text in ["transmitter = {}\n", "transmitter.pose_in_room = { position_m = [0, 0, 0] }\n"] {
            let written: toml::Table = toml::from_str(&edit(text, &place).unwrap()).unwrap();
            assert_eq!(
                written["transmitter"]["pose_in_room"]["position_m"][1].as_float(),
                Some(0.25),
                "{text}"
            );
        }
        assert!(edit("transmitter = 1\n", &place).is_err());
    }

    #[test]
    fn a_device_goes_with_its_sensors_and_a_body_from_those_that_wore_it() {
        let rest = changed(json!([{"change": "remove", "table": "device", "name": "chain"}])).unwrap();
        assert!(!rest.contains("wired ones") && !rest.contains("address = 1\n\n[[sensor]]"), "{rest}");
        assert!(rest.contains("name = \"b\"") && rest.contains("# Our room."), "{rest}");
        let both = TEXT.replace("name = \"a\"", "name = \"a\"\nbody = \"person\"");
        let remove = Change::Remove { table: Table::Body, name: "person".to_owned() };
        let rest = edit(&both.replace("[body]", "[[body]]\nname = \"person\""), &[remove]).unwrap();
        assert!(!rest.contains("body"), "{rest}");
    }

    #[test]
    fn what_cannot_be_done_says_why() {
        let unknown = changed(json!([{"change": "remove", "table": "sensor", "name": "z"}])).unwrap_err();
        assert_eq!(unknown.to_string(), "the stage file has no sensor \"z\"");
        let null = json!([{"change": "add", "table": "sensor", "keys": {"name": null}}]);
        assert_eq!(changed(null).unwrap_err(), EditError::Value("name".to_owned()));
        let list = "name = \"s\"\ndevice = [{ name = \"a\" }]\n";
        let remove = Change::Remove { table: Table::Device, name: "a".to_owned() };
        assert_eq!(edit(list, std::slice::from_ref(&remove)).unwrap_err(), EditError::Inline("device"));
        assert!(matches!(edit("name = ", &[remove]).unwrap_err(), EditError::NoToml(_)));
    }

    #[test]
    fn every_line_knows_what_it_is_about() {
        let line = |text: &str| 1 + TEXT.lines().position(|line| line.starts_with(text)).unwrap();
        let about = |text: &str| {
            let owner = owners(TEXT, [line(text)]).remove(0);
            owner.map(|owner| (owner.table, owner.name))
        };
        assert_eq!(about("name = \"room\""), None);
        assert_eq!(about("baud"), Some((Table::Device, "chain".to_owned())));
        assert_eq!(about("name = \"other\""), Some((Table::Device, "other".to_owned())));
        assert_eq!(about("height_m"), Some((Table::Body, String::new())));
        assert_eq!(about("imu ="), Some((Table::Sensor, "b".to_owned())));
        assert_eq!((about("rigid_pairs"), about("listen")), (None, None));
        let nested =
            "[[sensor]]\nname = \"a\"\n[sensor.imu]\nsensor = \"b\"\n[[simulation.sensor]]\nname = \"a\"\n";
        let about: Vec<bool> = owners(nested, 1..=6).iter().map(Option::is_some).collect();
        assert_eq!(about, [true, true, true, true, false, false]);
    }
}
