//! Two-way logs: `<time> : (<level>) <n>. command[<bytes>] <data>` and `receive[<bytes>] <data>`.
//!
//! Printable bytes stand as they are, every other byte as `\xNN`. A backslash may stand for itself, so the
//! stated number of bytes decides how a line is read.

use std::collections::HashSet;

use super::CaptureError;

/// Who spoke.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The computer.
    Host,
    /// The tracker.
    Unit,
}

/// One line of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Time as written: a decimal number, in the unit of the log.
    pub t: String,
    /// Who spoke.
    pub side: Side,
    /// What was sent, escapes undone.
    pub bytes: Vec<u8>,
}

/// Whether a file has at least one line of a log; its data need not be whole.
pub fn is_log(file: &[u8]) -> bool {
    file.split(|&byte| byte == b'\n').any(|line| split(line).is_some())
}

/// Reads all lines; those that are none of a log (comments, empty ones) are passed over.
///
/// Where a line can be read in several ways that give the stated number of bytes, escapes are read as escapes.
///
/// # Errors
/// [`CaptureError::Line`]: a line whose data do not have the stated number of bytes.
pub fn parse(file: &[u8]) -> Result<Vec<Line>, CaptureError> {
    let mut lines = Vec::new();
    for (i, text) in file.split(|&byte| byte == b'\n').enumerate() {
        let Some((t, side, count, data)) = split(text) else { continue };
        let without_return = data.strip_suffix(b"\r").unwrap_or(data);
        let bytes = unescape(without_return, count).or_else(|| unescape(data, count)).ok_or_else(|| {
            CaptureError::Line { line: i + 1, problem: format!("the data are not the stated {count} bytes") }
        })?;
        lines.push(Line { t, side, bytes });
    }
    Ok(lines)
}

/// Time, side, number of bytes and data of a line.
fn split(line: &[u8]) -> Option<(String, Side, usize, &[u8])> {
    let find = |needle: &[u8]| line.windows(needle.len()).position(|window| window == needle);
    let (at, side) = match (find(b". command["), find(b". receive[")) {
        (Some(command), Some(receive)) if receive < command => (receive, Side::Unit),
        (Some(command), _) => (command, Side::Host),
        (None, Some(receive)) => (receive, Side::Unit),
        (None, None) => return None,
    };
    let head = std::str::from_utf8(&line[..at]).ok()?;
    let t = head.split_whitespace().next()?;
    t.parse::<f64>().ok()?;
    let rest = &line[at + b". command[".len()..];
    let close = rest.iter().position(|&byte| byte == b']')?;
    let count = std::str::from_utf8(&rest[..close]).ok()?.parse().ok()?;
    let data = &rest[close + 1..];
    Some((t.to_owned(), side, count, data.strip_prefix(b" ").unwrap_or(data)))
}

/// Reads `data` as exactly `count` bytes; where there are several ways, escapes are read as escapes.
fn unescape(data: &[u8], count: usize) -> Option<Vec<u8>> {
    if count > data.len() {
        return None;
    }
    let mut bytes = Vec::with_capacity(count);
    // Iterative search: each open choice is (where, bytes so far); dead ends are remembered.
    let mut choices: Vec<(usize, usize)> = Vec::new();
    let mut dead = HashSet::new();
    let mut at = 0;
    loop {
        if at == data.len() && bytes.len() == count {
            return Some(bytes);
        }
        if at >= data.len() || bytes.len() >= count || dead.contains(&(at, bytes.len())) {
            let (back_to, len) = choices.pop()?;
            bytes.truncate(len);
            bytes.push(b'\\');
            at = back_to + 1;
            dead.insert((back_to, len));
            continue;
        }
        match escape(&data[at..]) {
            Some((byte, len)) => {
                choices.push((at, bytes.len()));
                bytes.push(byte);
                at += len;
            }
            None => {
                bytes.push(data[at]);
                at += 1;
            }
        }
    }
}

/// The escape that `data` begins with, and its length.
fn escape(data: &[u8]) -> Option<(u8, usize)> {
    match data {
        [b'\\', b'x', high, low, ..] => {
            let digit = |byte: u8| char::from(byte).to_digit(16);
            Some(((digit(*high)? * 16 + digit(*low)?) as u8, 4))
        }
        [b'\\', b'\\', ..] => Some((b'\\', 2)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stated_count_decides_what_a_backslash_is() {
        assert_eq!(unescape(br"O\x01", 2).unwrap(), b"O\x01");
        assert_eq!(unescape(br"\", 1).unwrap(), br"\");
        assert_eq!(unescape(br"a\\x41", 3).unwrap(), br"a\A".to_vec());
        assert_eq!(unescape(br"\x41", 4).unwrap(), br"\x41");
        assert_eq!(unescape(br"\\", 1).unwrap(), br"\");
        assert_eq!(unescape(br"\\", 2).unwrap(), br"\\");
        assert_eq!(unescape(br"abc", 2), None);
        assert_eq!(unescape(b"", 0).unwrap(), b"");
    }

    #[test]
    fn a_line_that_does_not_add_up_is_named() {
        let error = parse(b"1.0 : (INFO) 1. command[1] B\n1.1 : (INFO) 1. receive[3] ab\n").unwrap_err();
        assert!(matches!(error, CaptureError::Line { line: 2, .. }), "{error:?}");
    }
}
