//! What must hold between tables of a stage file, and what types cannot say.
//!
//! The rules read the document rather than the typed stage: a file with one misspelt key still gets all its
//! other problems reported, and every value still knows its place. What has the wrong type is silently left out
//! here, because [`super::shape`] has already said so.

mod attached;
mod body;
mod chain;
mod devices;
mod drivers;
mod field;
mod keyframes;
pub(super) mod models;
mod server;
mod timecode;
mod zenoh;

use std::ops::Range;
use std::path::Path;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::Stage;
use super::problem::{Notes, nearest, one_of};
use super::shape::as_number;

/// Applies all rules to a document; `folder` is where relative paths begin, if files are to be looked at.
pub(super) fn check(document: &Spanned<DeTable<'_>>, folder: Option<&Path>, notes: &mut Notes<'_>) {
    let root = Item { header: document.span(), table: document.get_ref() };
    devices::check(&root, notes);
    if let Some(server) = root.item("server") {
        server::check(&server, folder, notes);
    }
    if let Some(vrpn) = root.item("vrpn") {
        server::check_vrpn(&vrpn, notes);
    }
    for (table, usual) in [("vmc", "192.168.1.20:39539"), ("mvn", "192.168.1.20:9763")] {
        if let Some(table) = root.item(table) {
            server::check_targets(&table, usual, notes);
        }
    }
    if let Some(zenoh) = root.item("zenoh") {
        zenoh::check(&zenoh, folder, notes);
    }
    if let Some(timecode) = root.item("timecode") {
        timecode::check(&timecode, notes);
    }
    if let Some(ros2) = root.item("ros2") {
        zenoh::check_ros2(&ros2, notes);
    }
    if let (Some(recording), Some(folder)) = (root.item("recording"), folder) {
        folder_key(&recording, "folder", folder, notes);
    }
    if let (Some(models), Some(folder)) = (root.item("models"), folder) {
        models::check(&models, folder, notes);
    }
    keyframes::check(&root, notes);
    if let (Some(segments), Some(folder)) = (root.item("segments"), folder) {
        server::segments_model(&segments, folder, notes);
    }
    field::check(&root, notes);
    body::check(&root, notes);
}

/// Applies the rules that need the typed stage, once all others hold.
pub(super) fn check_parsed(
    document: &Spanned<DeTable<'_>>,
    folder: Option<&Path>,
    stage: &Stage,
    notes: &mut Notes<'_>,
) {
    let root = Item { header: document.span(), table: document.get_ref() };
    if let (Some(models), Some(folder)) = (root.item("models"), folder) {
        models::check_faults(&models, folder, stage, notes);
    }
    drivers::check(&root, stage, notes);
    attached::check(&root, stage, notes);
    chain::check(&root, stage, notes);
    body::check_wearer(&root, stage, notes);
}

/// A folder to write to may be missing, it is then made; but it may not be a file.
fn folder_key(table: &Item<'_, '_>, key: &str, folder: &Path, notes: &mut Notes<'_>) {
    let Some(path) = table.text(key) else { return };
    let full = folder.join(path.value);
    if path.value.is_empty() || full.is_file() {
        let message = format!("`{}` is no folder", full.display());
        notes.problem(&path.at, key, message, "name a folder; it is made if it is not there");
    }
}

/// A table with the place of its header.
struct Item<'a, 'i> {
    header: Range<usize>,
    table: &'a DeTable<'i>,
}

/// A value with its place.
struct At<T> {
    value: T,
    at: Range<usize>,
}

impl<'a, 'i> Item<'a, 'i> {
    fn get(&self, key: &str) -> Option<&'a Spanned<DeValue<'i>>> {
        self.table.get(key)
    }

    fn has(&self, key: &str) -> bool {
        self.table.contains_key(key)
    }

    fn text(&self, key: &str) -> Option<At<&'a str>> {
        let value = self.get(key)?;
        Some(At { value: value.get_ref().as_str()?, at: value.span() })
    }

    /// A number without fraction that fits an `i64`.
    fn integer(&self, key: &str) -> Option<At<i64>> {
        let value = self.get(key)?;
        let integer = value.get_ref().as_integer()?;
        Some(At { value: i64::from_str_radix(integer.as_str(), integer.radix()).ok()?, at: value.span() })
    }

    fn number(&self, key: &str) -> Option<At<f64>> {
        let value = self.get(key)?;
        let number = as_number(value.get_ref()).filter(|number| number.is_finite())?;
        Some(At { value: number, at: value.span() })
    }

    fn bool(&self, key: &str) -> bool {
        self.get(key).and_then(|value| value.get_ref().as_bool()).unwrap_or(false)
    }

    fn item(&self, key: &str) -> Option<Item<'a, 'i>> {
        let value = self.get(key)?;
        Some(Item { header: value.span(), table: value.get_ref().as_table()? })
    }

    /// The tables of a list; a single table, which is another mistake, counts as a list of one.
    fn items(&self, key: &str) -> Vec<Item<'a, 'i>> {
        if let Some(item) = self.item(key) {
            return vec![item];
        }
        let list = self.get(key).and_then(|value| value.get_ref().as_array());
        list.into_iter()
            .flat_map(|list| list.iter())
            .filter_map(|value| Some(Item { header: value.span(), table: value.get_ref().as_table()? }))
            .collect()
    }
}

/// Notes each value of `key` that an earlier item has already.
fn unique(items: &[Item<'_, '_>], key: &str, what: &str, notes: &mut Notes<'_>) {
    let mut seen: Vec<At<&str>> = Vec::new();
    for item in items {
        let Some(value) = item.text(key) else { continue };
        match seen.iter().find(|earlier| earlier.value == value.value) {
            Some(earlier) => {
                let message = format!(
                    "`{}` is the {key} of another {what} in line {}",
                    value.value,
                    notes.line(earlier.at.start)
                );
                notes.problem(&value.at, key, message, format!("give each {what} a {key} of its own"));
            }
            None => seen.push(value),
        }
    }
}

/// "did you mean ..?", or the list of what there is.
fn suggest(word: &str, words: &[&str], none: &str) -> String {
    match nearest(word, words.iter().copied()) {
        Some(near) => format!("did you mean `{near}`?"),
        None if words.is_empty() => none.to_owned(),
        None => format!("write {}", one_of(words.iter().copied())),
    }
}
