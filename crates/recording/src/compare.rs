//! Do two streams of messages say the same?
//!
//! What comes in: messages in order, expected and got. What goes out: nothing, or the first [`Difference`] with its
//! line, topic, place and both values. Byte by byte; with a tolerance number by number, for files made on another
//! class of machine. What a client gets of its own (`seq`, `dropped`) and the topics of the daemon's own health
//! (`status`, `jobs`) are no part of it.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::Path;

use serde_json::Value;

/// Topics that depend on the wall clock and the machine's load.
const NOT_REPLAYED: [&str; 3] = ["status", "jobs", "session"];

/// Keys of a message that differ from client to client.
const PER_CLIENT: [&str; 2] = ["seq", "dropped"];

/// Whether a replay must say the same on this topic: on all but `status` and `jobs`, which depend on the wall clock and the load.
pub fn is_replayed(topic: &str) -> bool {
    !NOT_REPLAYED.contains(&topic)
}

/// The first place where two streams differ.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("message {line}, topic {topic}, {path}: expected {expected}, got {got}")]
pub struct Difference {
    /// Line of the golden file, or number of the message, from 1.
    pub line: u64,
    /// Topic of the expected message; of the got one where there is no expected one.
    pub topic: String,
    /// Where in the message, for example `sensors[2].position_m[0]`; `message` is all of it.
    pub path: String,
    /// What should be there.
    pub expected: String,
    /// What is there.
    pub got: String,
}

/// How strictly to compare.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Largest difference of two numbers that counts as none, in the numbers' own unit; absent: every byte counts.
    pub tolerance: Option<f64>,
}

impl Comparison {
    /// Compares two messages, JSON texts; `line` is for the [`Difference`]. `seq` and `dropped` do not count.
    ///
    /// # Errors
    /// The first place at which they differ.
    pub fn compare(&self, line: u64, expected: &[u8], got: &[u8]) -> Result<(), Box<Difference>> {
        if shared(expected) == shared(got) {
            return Ok(());
        }
        let difference = |topic: &str, path: &str, expected: String, got: String| {
            let path = if path.is_empty() { "message" } else { path }.to_owned();
            Err(Box::new(Difference { line, topic: topic.to_owned(), path, expected, got }))
        };
        let (old, new) = match (serde_json::from_slice(expected), serde_json::from_slice(got)) {
            (Ok(old), Ok(new)) => (without_client(old), without_client(new)),
            _ => return difference("?", "message", text(expected), text(got)),
        };
        let topic = topic_of(&old);
        match first_difference(&old, &new, self.tolerance, &mut String::new()) {
            Some((path, old, new)) => difference(&topic, &path, old, new),
            // The same values in other words: spaces, order of keys, 1.0 for 1.
            None if self.tolerance.is_none() => difference(&topic, "message", text(expected), text(got)),
            None => Ok(()),
        }
    }
}

/// A golden file (one JSON message per line) that is read along with the messages it should equal.
pub struct Golden<R> {
    lines: R,
    comparison: Comparison,
    line: u64,
    text: String,
}

/// Why a golden file is not met.
#[derive(Debug, thiserror::Error)]
pub enum GoldenError {
    /// It cannot be read.
    #[error("cannot read the expected messages: {0}")]
    Io(#[from] io::Error),
    /// A line is no message.
    #[error("line {line} of the expected messages is no JSON object with a `type`")]
    BadLine {
        /// From 1.
        line: u64,
    },
    /// The first message that differs.
    #[error(transparent)]
    Different(#[from] Box<Difference>),
}

impl Golden<BufReader<File>> {
    /// Opens a golden file.
    ///
    /// # Errors
    /// It cannot be opened.
    pub fn open(path: &Path, comparison: Comparison) -> io::Result<Self> {
        Ok(Self::new(BufReader::new(File::open(path)?), comparison))
    }
}

impl<R: BufRead> Golden<R> {
    /// Compares with these lines: one JSON message each, empty ones left out.
    pub fn new(lines: R, comparison: Comparison) -> Self {
        Self { lines, comparison, line: 0, text: String::new() }
    }

    /// Holds the next message, JSON text, against the next line. A topic that is not replayed (see [`is_replayed`]) is passed
    /// over, in the file too.
    ///
    /// # Errors
    /// They differ, the file ends, it cannot be read, or a line of it is no message.
    pub fn message(&mut self, topic: &str, json: &[u8]) -> Result<(), GoldenError> {
        if !is_replayed(topic) {
            return Ok(());
        }
        if self.advance()?.is_none() {
            let (topic, path) = (topic.to_owned(), "message".to_owned());
            let expected = "no further message".to_owned();
            let difference = Difference { line: self.line + 1, topic, path, expected, got: text(json) };
            return Err(Box::new(difference).into());
        }
        Ok(self.comparison.compare(self.line, self.text.as_bytes(), json)?)
    }

    /// To be called when no message follows.
    ///
    /// # Errors
    /// The file holds more, or cannot be read.
    pub fn finish(&mut self) -> Result<(), GoldenError> {
        let Some(topic) = self.advance()? else { return Ok(()) };
        let (path, expected) = ("message".to_owned(), text(self.text.as_bytes()));
        let got = "no further message".to_owned();
        Err(Box::new(Difference { line: self.line, topic, path, expected, got }).into())
    }

    /// Reads the next line that a replay must say; its topic.
    fn advance(&mut self) -> Result<Option<String>, GoldenError> {
        loop {
            self.text.clear();
            if self.lines.read_line(&mut self.text)? == 0 {
                return Ok(None);
            }
            self.line += 1;
            let length = self.text.trim_end().len();
            self.text.truncate(length);
            if self.text.is_empty() {
                continue;
            }
            let value: Result<Value, _> = serde_json::from_str(&self.text);
            let topic = value.ok().and_then(|value| value.get("type")?.as_str().map(str::to_owned));
            let topic = topic.ok_or(GoldenError::BadLine { line: self.line })?;
            if is_replayed(&topic) {
                return Ok(Some(topic));
            }
        }
    }
}

/// The part of a message that all clients share, as bytes: type and body without the head's numbers.
fn shared(message: &[u8]) -> (&[u8], &[u8]) {
    let number = |rest: &mut &[u8], key: &[u8]| -> Option<()> {
        let after = rest.strip_prefix(key)?;
        let digits = after.iter().take_while(|byte| byte.is_ascii_digit()).count();
        *rest = after[digits..].strip_prefix(b",")?;
        (digits > 0).then_some(())
    };
    let split = |message: &[u8]| -> Option<usize> {
        let mut rest = message.strip_prefix(br#"{"type":""#)?;
        let name = rest.iter().position(|byte| *byte == b'"')?;
        rest = rest[name..].strip_prefix(br#"","#)?;
        number(&mut rest, br#""seq":"#)?;
        number(&mut rest, br#""dropped":"#)?;
        Some(rest.len())
    };
    match split(message) {
        Some(body) => {
            let head = message.iter().position(|byte| *byte == b',').unwrap_or(0);
            (&message[..head], &message[message.len() - body..])
        }
        None => (&[], message),
    }
}

fn without_client(mut message: Value) -> Value {
    if let Some(map) = message.as_object_mut() {
        PER_CLIENT.iter().for_each(|key| drop(map.remove(*key)));
    }
    message
}

fn topic_of(message: &Value) -> String {
    message.get("type").and_then(Value::as_str).unwrap_or("?").to_owned()
}

/// Path and both values of the first difference; `path` is where we are.
fn first_difference(
    old: &Value,
    new: &Value,
    tolerance: Option<f64>,
    path: &mut String,
) -> Option<(String, String, String)> {
    let length = path.len();
    let show = |value: Option<&Value>| {
        value.map_or_else(|| "nothing".to_owned(), |v| text(v.to_string().as_bytes()))
    };
    match (old, new) {
        (Value::Object(olds), Value::Object(news)) => {
            let added = news.iter().filter(|(key, _)| !olds.contains_key(*key)).map(|(key, _)| key);
            for key in olds.keys().chain(added) {
                if length > 0 {
                    path.push('.');
                }
                path.push_str(key);
                match (olds.get(key), news.get(key)) {
                    (Some(old), Some(new)) => {
                        if let found @ Some(_) = first_difference(old, new, tolerance, path) {
                            return found;
                        }
                    }
                    (old, new) => return Some((path.clone(), show(old), show(new))),
                }
                path.truncate(length);
            }
            None
        }
        (Value::Array(olds), Value::Array(news)) => {
            for index in 0..olds.len().max(news.len()) {
                path.push_str(&format!("[{index}]"));
                match (olds.get(index), news.get(index)) {
                    (Some(old), Some(new)) => {
                        if let found @ Some(_) = first_difference(old, new, tolerance, path) {
                            return found;
                        }
                    }
                    (old, new) => return Some((path.clone(), show(old), show(new))),
                }
                path.truncate(length);
            }
            None
        }
        (Value::Number(a), Value::Number(b)) => {
            let near = |tolerance: f64| Some((a.as_f64()? - b.as_f64()?).abs() <= tolerance);
            let same = a == b || tolerance.and_then(near).unwrap_or(false);
            (!same).then(|| (path.clone(), show(Some(old)), show(Some(new))))
        }
        _ => (old != new).then(|| (path.clone(), show(Some(old)), show(Some(new)))),
    }
}

/// For people: not more than a line's worth.
fn text(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    match text.char_indices().nth(120) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.into_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OLD: &str = r#"{"type":"sensors","seq":3,"dropped":0,"t_s":1.5,"sensors":[{"name":"a","position_m":[0.1,0.2,0.3]}]}"#;

    fn compare(tolerance: Option<f64>, new: &str) -> Result<(), Box<Difference>> {
        Comparison { tolerance }.compare(7, OLD.as_bytes(), new.as_bytes())
    }

    #[test]
    fn given_other_client_numbers_it_is_the_same_message() {
        assert_eq!(compare(None, &OLD.replace(r#""seq":3,"dropped":0"#, r#""seq":44,"dropped":5"#)), Ok(()));
    }

    #[test]
    fn given_one_other_number_its_place_is_named() {
        let difference = compare(None, &OLD.replace("0.2", "0.25")).unwrap_err();
        assert_eq!(
            difference.to_string(),
            "message 7, topic sensors, sensors[0].position_m[1]: expected 0.2, got 0.25"
        );
    }

    #[test]
    fn given_a_tolerance_numbers_may_differ_by_it_and_not_by_more() {
        assert_eq!(compare(Some(0.06), &OLD.replace("0.2", "0.25")), Ok(()));
        assert!(compare(Some(0.04), &OLD.replace("0.2", "0.25")).is_err());
        assert!(compare(Some(1.0), &OLD.replace(r#""a""#, r#""b""#)).is_err(), "names are not numbers");
    }

    #[test]
    fn given_another_topic_missing_keys_or_other_spelling_it_differs() {
        for (new, path) in [
            (OLD.replace("sensors\",\"seq", "truth\",\"seq"), "type"),
            (OLD.replace(r#""name":"a","#, ""), "sensors[0].name"),
            (OLD.replace(r#""name":"a","#, r#""name":"a","more":1,"#), "sensors[0].more"),
            (OLD.replace(",0.3]", "]"), "sensors[0].position_m[2]"),
            (OLD.replace(r#""t_s":1.5"#, r#""t_s": 1.5"#), "message"),
            ("broken".to_owned(), "message"),
        ] {
            assert_eq!(compare(None, &new).unwrap_err().path, path, "{new}");
        }
    }

    #[test]
    fn given_a_golden_file_the_daemons_own_topics_are_left_out() {
        let status = r#"{"type":"status","seq":0,"dropped":0,"t_s":1}"#;
        let lines = format!("{status}\n{OLD}\n\n{status}\n");
        let mut golden = Golden::new(lines.as_bytes(), Comparison::default());
        golden.message("jobs", b"{}").unwrap();
        golden.message("sensors", OLD.as_bytes()).unwrap();
        golden.finish().unwrap();
    }

    #[test]
    fn given_more_or_fewer_messages_than_expected_it_says_which() {
        let mut golden = Golden::new(OLD.as_bytes(), Comparison::default());
        let GoldenError::Different(missing) = golden.finish().unwrap_err() else { panic!("another error") };
        assert_eq!((missing.line, missing.got.as_str()), (1, "no further message"));
        let mut golden = Golden::new(&b""[..], Comparison::default());
        let GoldenError::Different(extra) = golden.message("sensors", OLD.as_bytes()).unwrap_err() else {
            panic!("another error")
        };
        assert_eq!((extra.line, extra.expected.as_str()), (1, "no further message"));
    }

    #[test]
    fn given_a_line_that_is_no_message_it_is_named() {
        let mut golden = Golden::new(&b"\nnonsense\n"[..], Comparison::default());
        assert!(matches!(golden.message("sensors", b"{}"), Err(GoldenError::BadLine { line: 2 })));
    }
}
