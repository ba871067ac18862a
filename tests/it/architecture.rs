//! `ARCHITECTURE.md` states what uses what as the manifests do.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::supply::uses;

/// Name to what it uses, by the table: `| `posed-x` | where | holds | uses |`.
fn table(text: &str) -> BTreeMap<String, BTreeSet<String>> {
    let rows = text.lines().filter(|line| line.starts_with("| `posed"));
    rows.map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split(" | ").map(str::trim).collect();
        let [name, _, _, uses] = cells[..] else { panic!("four cells: {row}") };
        let uses = uses.trim_matches(['|', ' ']).split(", ").filter(|name| !name.is_empty());
        (name.trim_matches('`').to_owned(), uses.map(|name| format!("posed-{name}")).collect())
    })
    .collect()
}

#[test]
fn the_table_of_crates_is_that_of_the_manifests() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("ARCHITECTURE.md");
    let mut emitted = table(&std::fs::read_to_string(path).unwrap());
    emitted.insert("posed-state-derive".to_owned(), BTreeSet::new());
    assert_eq!(emitted, uses());
}
