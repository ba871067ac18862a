//! What is wrong with a stage file: the line, the key, and how to fix it.

use std::fmt;
use std::ops::Range;
use std::path::PathBuf;

use serde::Serialize;

/// One thing that is wrong, or doubtful, in a stage file. `Display` writes it in one line: line, key, message, fix.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// Line in the file, from 1. A missing key points at the header of its table, a duplicate at the second one.
    pub line: usize,
    /// The key it is about, as it stands in the file (or should stand there); may be empty for broken TOML.
    pub key: String,
    /// What is wrong, without line and key.
    pub message: String,
    /// What to do about it, in words for whoever wrote the file.
    pub fix: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: ", self.line)?;
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        write!(f, "{}; {}", self.message, self.fix)
    }
}

/// All that is wrong with a stage file, in the order of its lines; never empty where this crate gives it. `Display` writes a line
/// for each.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct Problems(pub Vec<Problem>);

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (n, problem) in self.0.iter().enumerate() {
            let separator = if n == 0 { "" } else { "\n" };
            write!(f, "{separator}{problem}")?;
        }
        Ok(())
    }
}

/// Why a stage could not be loaded from a file.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The file cannot be read.
    #[error("cannot read the stage file {}: {error}", path.display())]
    Read {
        /// Which file, as it was asked for.
        path: PathBuf,
        /// What the system said; `InvalidData` where the file is no UTF-8.
        error: std::io::Error,
    },
    /// The file can be read, and is wrong.
    #[error("the stage file {} is not right:\n{problems}", path.display())]
    Wrong {
        /// Which file, as it was asked for.
        path: PathBuf,
        /// All that is wrong with it.
        problems: Problems,
    },
    /// A file with a secret cannot be read, though it could a moment ago.
    #[error("{0}")]
    Secret(String),
}

/// Collects problems and warnings, and knows which byte is on which line.
pub(super) struct Notes<'a> {
    text: &'a str,
    /// Lines that are no TOML: what the parser made of them is not worth a second word.
    broken: Vec<usize>,
    problems: Vec<(usize, Problem)>,
    /// What keeps a stage from running, and no command that works on files.
    idle: Vec<(usize, Problem)>,
    warnings: Vec<(usize, Problem)>,
}

impl<'a> Notes<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        Self { text, broken: Vec::new(), problems: Vec::new(), idle: Vec::new(), warnings: Vec::new() }
    }

    /// The line of a byte, from 1.
    pub(super) fn line(&self, offset: usize) -> usize {
        let end = offset.min(self.text.len());
        1 + self.text.as_bytes()[..end].iter().filter(|byte| **byte == b'\n').count()
    }

    /// Notes a line that is no TOML; nothing else is said about it afterwards.
    pub(super) fn broken(
        &mut self,
        at: &Range<usize>,
        key: &str,
        message: impl Into<String>,
        fix: impl Into<String>,
    ) {
        self.problem(at, key, message, fix);
        self.broken.push(self.line(at.start));
    }

    /// Notes something that makes the file unusable.
    pub(super) fn problem(
        &mut self,
        at: &Range<usize>,
        key: &str,
        message: impl Into<String>,
        fix: impl Into<String>,
    ) {
        let problem = self.at(at.start, key, message.into(), fix.into());
        if !self.broken.contains(&problem.line) {
            self.problems.push((at.start, problem));
        }
    }

    /// Notes something with which no stage runs, though the file can be used otherwise.
    pub(super) fn idle(
        &mut self,
        at: &Range<usize>,
        key: &str,
        message: impl Into<String>,
        fix: impl Into<String>,
    ) {
        let problem = self.at(at.start, key, message.into(), fix.into());
        self.idle.push((at.start, problem));
    }

    /// Notes something that works, but hardly as it was meant.
    pub(super) fn warning(
        &mut self,
        at: &Range<usize>,
        key: &str,
        message: impl Into<String>,
        fix: impl Into<String>,
    ) {
        let warning = self.at(at.start, key, message.into(), fix.into());
        self.warnings.push((at.start, warning));
    }

    fn at(&self, offset: usize, key: &str, message: String, fix: String) -> Problem {
        Problem { line: self.line(offset), key: key.to_owned(), message, fix }
    }

    /// Whether the file cannot be used at all.
    pub(super) fn has_problems(&self) -> bool {
        !self.problems.is_empty()
    }

    /// Problems and warnings, each in the order of the text.
    pub(super) fn finish(mut self) -> (Vec<Problem>, Vec<Problem>) {
        self.problems.append(&mut self.idle);
        self.problems.sort_by_key(|(offset, _)| *offset);
        self.warnings.sort_by_key(|(offset, _)| *offset);
        let strip = |list: Vec<(usize, Problem)>| list.into_iter().map(|(_, problem)| problem).collect();
        (strip(self.problems), strip(self.warnings))
    }
}

/// The candidate that `word` was most likely meant to be, if any is near enough.
pub(super) fn nearest<'w>(word: &str, candidates: impl IntoIterator<Item = &'w str>) -> Option<&'w str> {
    let word = word.to_lowercase();
    candidates
        .into_iter()
        .map(|candidate| (strsim::damerau_levenshtein(&word, candidate), candidate))
        .filter(|(distance, candidate)| {
            // A third of the letters may be wrong, or one may be the beginning of the other.
            let longest = word.chars().count().max(candidate.chars().count());
            let begins = word.len() >= 3 && (candidate.starts_with(&word) || word.starts_with(candidate));
            *distance <= (longest / 3).max(1) || begins
        })
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

/// `` `a`, `b` or `c` ``, for sentences.
pub(super) fn one_of<'w>(words: impl IntoIterator<Item = &'w str>) -> String {
    let words: Vec<String> = words.into_iter().map(|word| format!("`{word}`")).collect();
    match words.split_last() {
        None => String::new(),
        Some((last, [])) => last.clone(),
        Some((last, rest)) => format!("{} or {last}", rest.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_word_is_found_and_a_stranger_is_not() {
        let keys = ["name", "driver", "port", "baud", "format"];
        assert_eq!(nearest("buad", keys), Some("baud"));
        assert_eq!(nearest("Port", keys), Some("port"));
        assert_eq!(nearest("device", keys), None);
        assert_eq!(nearest("baud_rate", keys), Some("baud"));
        assert_eq!(nearest("colour", keys), None);
    }

    #[test]
    fn lines_count_from_one_and_problems_come_in_order() {
        let mut notes = Notes::new("a\nb\nc");
        notes.problem(&(4..5), "c", "late", "x");
        notes.problem(&(0..1), "a", "early", "x");
        let (problems, warnings) = notes.finish();
        assert_eq!(problems.iter().map(|p| p.line).collect::<Vec<_>>(), [1, 3]);
        assert!(warnings.is_empty());
    }
}
