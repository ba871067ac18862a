//! `ARCHITECTURE.md` states what uses what as the manifests do, and the pages of methods name constants that are there.

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

/// Every file below a folder that ends like this.
fn files(folder: &Path, ending: &str, found: &mut Vec<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, ending, found);
        } else if path.extension().is_some_and(|extension| extension == ending) {
            found.push(std::fs::read_to_string(path).unwrap());
        }
    }
}

#[test]
fn the_constants_of_the_pages_of_methods_are_in_the_code() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut code, mut pages) = (Vec::new(), Vec::new());
    files(&root.join("crates"), "rs", &mut code);
    files(&root.join("drivers/src"), "rs", &mut code);
    files(&root.join("docs/methods"), "md", &mut pages);
    let is_name = |word: &&str| {
        word.len() > 2 && word.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
    };
    let words = |text: &str| {
        text.split(|c: char| !c.is_alphanumeric() && c != '_').map(str::to_owned).collect::<Vec<_>>()
    };
    let known: BTreeSet<String> =
        code.iter().flat_map(|text| words(text)).filter(|word| is_name(&word.as_str())).collect();
    let rows = pages.iter().flat_map(|page| page.lines()).filter(|line| line.starts_with("| `"));
    let named =
        rows.flat_map(|row| words(row.split('|').nth(1).unwrap())).filter(|word| is_name(&word.as_str()));
    let named: BTreeSet<String> = named.collect();
    assert!(named.len() > 100, "{}", named.len());
    let gone: Vec<&String> = named.difference(&known).collect();
    assert!(gone.is_empty(), "{gone:?}");
}
