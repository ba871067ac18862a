//! From text to a [`Stage`] or to all its problems: TOML syntax, then shape, then rules, then serde.

use std::ops::Range;
use std::path::Path;
use std::sync::LazyLock;

use serde::Serialize;
use toml::de::{DeTable, Error as TomlError};

use super::problem::{Notes, Problem, Problems};
use super::shape::Shape;
use super::{Stage, rules};

/// The JSON schema of the stage file.
pub(super) static SCHEMA: LazyLock<serde_json::Value> =
    LazyLock::new(|| schemars::schema_for!(Stage).to_value());

/// What is to be said about a stage file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Whether it makes a [`Stage`], as far as was looked: [`check`] looks at no file that it names. Warnings do not count.
    pub ok: bool,
    /// What is wrong, in the order of the lines; empty if `ok`.
    pub problems: Vec<Problem>,
    /// What works, but hardly as it was meant, in the order of the lines.
    pub warnings: Vec<Problem>,
}

/// Reports all that is wrong with the text of a stage file; files that it names are not looked at. A text that is no TOML has
/// problems like any other.
pub fn check(text: &str) -> Report {
    report(text, None).1
}

/// As [`check`], and looks at the files that the stage names; relative paths begin at `folder`. A file that cannot be read, or
/// holds something else, is a problem at the key that names it.
pub fn check_in(text: &str, folder: &Path) -> Report {
    report(text, Some(folder)).1
}

/// Holds the table `key` of a stage file against the JSON schema of its type (as `schemars` makes it), for tables whose types
/// live elsewhere.
///
/// It checks shape and ranges, not whether the type can be read. Gives its problems in the order of the lines; none if there is
/// no such table, or the text is no TOML.
pub fn check_table(text: &str, key: &str, schema: &serde_json::Value) -> Vec<Problem> {
    let mut notes = Notes::new(text);
    if let Ok(document) = DeTable::parse(text)
        && let Some(value) = document.get_ref().get(key)
        && let Some(table) = value.get_ref().as_table()
    {
        Shape::new(schema, &mut notes, false).document(value.span(), table);
    }
    notes.finish().0
}

pub(super) fn parse(text: &str, folder: Option<&Path>) -> Result<Stage, Problems> {
    match report(text, folder) {
        (Some(stage), _) => Ok(stage),
        (None, report) => Err(Problems(report.problems)),
    }
}

/// The stage if it is right, and what is to be said about it.
fn report(text: &str, folder: Option<&Path>) -> (Option<Stage>, Report) {
    let mut notes = Notes::new(text);
    let (document, errors) = DeTable::parse_recoverable(text);
    let mut broken = false;
    // What stands behind a broken header seems to stand in the table before it.
    let mut header_broken = false;
    for error in &errors {
        let duplicate = is_duplicate(error);
        if duplicate && header_broken {
            continue;
        }
        syntax(text, error, &mut notes);
        broken |= !duplicate;
        header_broken |= !duplicate && line_of(text, error).0.trim_start().starts_with('[');
    }
    Shape::new(&SCHEMA, &mut notes, broken).document(document.span(), document.get_ref());
    if !broken {
        rules::check(&document, folder, &mut notes);
    }
    let mut stage = None;
    if !notes.has_problems() {
        match toml::from_str(text) {
            Ok(parsed) => {
                rules::check_parsed(&document, folder, &parsed, &mut notes);
                stage = Some(parsed).filter(|_| !notes.has_problems());
            }
            Err(error) => syntax(text, &error, &mut notes),
        }
    }
    let (problems, warnings) = notes.finish();
    let report = Report { ok: problems.is_empty(), problems, warnings };
    (stage, report)
}

/// Whether an error of the TOML parser is a name that stands in its table already.
fn is_duplicate(error: &TomlError) -> bool {
    error.message().contains("duplicate key")
}

/// The line that an error of the TOML parser is on, and where it starts.
fn line_of<'a>(text: &'a str, error: &TomlError) -> (&'a str, usize) {
    line_around(text, error.span().map_or(0, |at| at.start))
}

/// Notes an error of the TOML parser.
fn syntax(text: &str, error: &TomlError, notes: &mut Notes<'_>) {
    let at = error.span().unwrap_or(0..0);
    let (line, start) = line_of(text, error);
    if is_duplicate(error) {
        let name = text.get(at.clone()).unwrap_or_default().trim_matches(['"', '\'']);
        let (message, fix) = if line.trim_start().starts_with('[') {
            (format!("[{name}] stands here a second time"), "join the two tables into one")
        } else {
            (format!("`{name}` stands here a second time in its table"), "keep one of the two")
        };
        notes.problem(&at, name, message, fix);
        return;
    }
    let (key, message, fix) = broken_line(line);
    let message = message.or(error.message().lines().next()).unwrap_or("this is no TOML");
    // An error at the very end of a line is an error of that line, not of the next.
    notes.broken(&(start.min(at.start)..at.end), key, message, fix);
}

/// The line that a byte is on, and where it starts; the last line with text for the end of the file.
fn line_around(text: &str, offset: usize) -> (&str, usize) {
    let before: Range<usize> = 0..offset.min(text.len());
    let mut head = text.get(before).unwrap_or(text);
    if offset >= text.len() {
        head = text.trim_end();
    }
    let start = head.rfind('\n').map_or(0, |newline| newline + 1);
    let line = text[start..].lines().next().unwrap_or("");
    (line, start)
}

/// The key of a line that is no TOML, the likely message where the parser's own would mislead, and the fix.
fn broken_line(line: &str) -> (&str, Option<&'static str>, String) {
    let Some((key, value)) = line.split_once('=') else {
        let fix = match line.trim_start() {
            table if table.starts_with("[[") => "write [[name]] on a line of its own",
            table if table.starts_with('[') => "write [name] on a line of its own",
            _ => "write key = value, or begin the line with # for a comment",
        };
        let key = line.trim().trim_matches(['[', ']']);
        return (key, None, fix.to_owned());
    };
    let (key, value) = (key.trim(), value.split('#').next().unwrap_or("").trim());
    let is_quote = |c| c == '"' || c == '\'';
    let begins_as_word = value.starts_with(|c: char| c.is_alphabetic() || c == '/');
    let (message, fix) = if value.is_empty() {
        (Some("there is no value"), "write a value behind the equals sign".to_owned())
    } else if value.starts_with(is_quote) && (value.len() == 1 || !value.ends_with(is_quote)) {
        (Some("the quotes are not closed"), "close the quotes".to_owned())
    } else if value.starts_with('[') && !value.ends_with(']') {
        (None, "close the bracket".to_owned())
    } else if begins_as_word && value.parse::<f64>().is_err() {
        (Some("text without quotes"), format!("put the text in quotes: {key} = \"{value}\""))
    } else if value.contains(',') && !value.starts_with(['[', '"', '\'']) {
        (None, "write a decimal point, not a comma; lists stand in [brackets]".to_owned())
    } else {
        (None, "write one value as TOML has it: text in quotes, 1.5, true, or [1, 2, 3]".to_owned())
    };
    (key, message, fix)
}
