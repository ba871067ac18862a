//! Follows a recorded conversation: what the host asked decides what the unit's bytes are.

use std::collections::{BTreeMap, VecDeque};

use super::log::{Line, Side};
use super::{CaptureError, CapturedRecord, Decoded, Options, Summary};
use crate::flock::wire::record::{self, PHASE_BIT};
use crate::flock::wire::value::parameter;
use crate::flock::wire::{
    Addressing, BirdStatus, Command, CommandParser, Format, Range, Record, Scale, Shape, Tolerance,
    UnitStatus,
};

/// What a unit is believed to send; `None` = the session has not said it.
#[derive(Clone, Copy, Debug, Default)]
struct Belief {
    format: Option<Format>,
    /// Records of the format before may still be on their way.
    format_before: Option<Format>,
    button: Option<bool>,
}

/// A question that has not been answered in full.
#[derive(Debug)]
struct Question {
    command: Command,
    to: u8,
    len: usize,
    answer: Vec<u8>,
    /// Whether records were asked for after it.
    records_since: bool,
}

/// The unit on the line: what has no prefix, prefix 0 or prefix 1 is for it.
const LINE_UNIT: u8 = 1;

#[derive(Debug, Default)]
struct Follower<'a> {
    options: Options,
    host: CommandParser,
    units: BTreeMap<u8, Belief>,
    group: Option<bool>,
    extended_range: bool,
    scaling: Option<Range>,
    questions: VecDeque<Question>,
    records_expected: bool,
    piece: Vec<u8>,
    piece_t: &'a str,
    records: Vec<CapturedRecord>,
    summary: Summary,
    guessed: u64,
}

/// Decodes the lines of a log, in order: records with what the session says of their units, and counts.
///
/// Where the session does not say the format of a unit, the first one that fits is taken, and a warning tells how many records
/// that concerns. A log without records is no error.
///
/// # Errors
/// [`CaptureError::Empty`]: there are no lines.
pub fn decode(lines: &[Line], options: Options) -> Result<Decoded, CaptureError> {
    if lines.is_empty() {
        return Err(CaptureError::Empty);
    }
    let mut follower = Follower { options, ..Follower::default() };
    for line in lines {
        match line.side {
            Side::Host => line.bytes.iter().for_each(|&byte| follower.host_byte(byte)),
            Side::Unit => follower.unit_bytes(&line.t, &line.bytes),
        }
    }
    follower.close_piece();
    let unfinished: usize = follower.questions.iter().map(|question| question.answer.len()).sum();
    follower.summary.bytes_skipped += unfinished as u64;
    let warnings = (follower.guessed > 0).then(|| {
        format!(
            "the session does not contain the format of {} records; it was taken from their length",
            follower.guessed
        )
    });
    Ok(Decoded {
        range: follower.scale().range,
        records: follower.records,
        summary: follower.summary,
        warnings: warnings.into_iter().collect(),
    })
}

impl<'a> Follower<'a> {
    fn host_byte(&mut self, byte: u8) {
        let Some(Ok(addressed)) = self.host.push(byte) else { return };
        let to = match addressed.to {
            None | Some(0) => LINE_UNIT,
            Some(address) => address,
        };
        let len = addressed.command.answer_len(self.host.addressing);
        if len > 0 {
            let question =
                Question { command: addressed.command, to, len, answer: Vec::new(), records_since: false };
            self.questions.push_back(question);
            return;
        }
        match addressed.command {
            Command::Point | Command::Stream => {
                self.records_expected = true;
                self.questions.iter_mut().for_each(|question| question.records_since = true);
            }
            Command::Format(format) => self.set_format(to, format),
            Command::ButtonMode(on) => self.units.entry(to).or_default().button = Some(on),
            // The slaves forget what they received.
            Command::FbbReset => self.units.retain(|&address, _| address == LINE_UNIT),
            Command::Change { parameter: number, data } => self.learn(to, number, &data),
            _ => {}
        }
    }

    fn set_format(&mut self, to: u8, format: Format) {
        let belief = self.units.entry(to).or_default();
        if belief.format != Some(format) {
            belief.format_before = belief.format;
            belief.format = Some(format);
        }
    }

    /// A parameter's value, from an answer or from the host's change of it.
    fn learn(&mut self, to: u8, number: u8, data: &[u8]) {
        match (number, data) {
            (parameter::GROUP_MODE, &[mode]) => self.group = Some(mode != 0),
            (parameter::POSITION_SCALING, &[low, _]) => {
                self.scaling = Some(if low & 1 == 0 { Range::In36 } else { Range::In72 });
            }
            (parameter::BIRD_STATUS, &[low, high]) => {
                let status = BirdStatus::from_bytes([low, high]);
                if let Some(format) = status.format() {
                    self.set_format(to, format);
                }
                self.records_expected |= status.has(BirdStatus::STREAMING);
            }
            (parameter::MODEL_ID, model) => self.extended_range |= model.starts_with(b"6DERC"),
            (parameter::FLOCK_SYSTEM_STATUS, units) => {
                self.extended_range |=
                    units.iter().any(|&unit| UnitStatus(unit).has(UnitStatus::EXTENDED_RANGE));
            }
            (parameter::FBB_ADDRESSING_MODE, &[code]) => {
                self.host.addressing = Addressing::from_code(code).unwrap_or_default();
            }
            _ => {}
        }
    }

    fn unit_bytes(&mut self, t: &'a str, bytes: &[u8]) {
        self.drop_unanswered(bytes);
        let mut rest = bytes;
        while let Some(&byte) = rest.first() {
            let piece_done = !self.piece.is_empty() && self.interpret(&self.piece).is_some();
            let between = self.piece.is_empty() || piece_done;
            if let Some(question) = self.questions.front()
                && (!question.answer.is_empty() || between)
                && !(question.answer.is_empty() && self.records_expected && self.begins_record(rest))
            {
                self.close_piece();
                rest = self.answer(rest);
                continue;
            }
            if byte & PHASE_BIT != 0 {
                self.close_piece();
                self.piece_t = t;
                self.piece.push(byte);
            } else if self.piece.is_empty() {
                self.summary.bytes_skipped += 1;
            } else {
                self.piece.push(byte);
            }
            rest = &rest[1..];
        }
    }

    /// Gives up questions that the unit has passed over: a later one's answer, or a record asked for later, is here.
    fn drop_unanswered(&mut self, bytes: &[u8]) {
        let Some(first) = self.questions.front() else { return };
        if !first.answer.is_empty() || first.len == bytes.len() {
            return;
        }
        if let Some(fitting) = self.questions.iter().position(|question| question.len == bytes.len()) {
            self.questions.drain(..fitting);
        } else if first.records_since && self.begins_record(bytes) {
            self.questions.pop_front();
        }
    }

    /// Whether these bytes begin with a whole record of what is believed to be running.
    fn begins_record(&self, bytes: &[u8]) -> bool {
        let len =
            bytes.iter().skip(1).position(|&byte| byte & PHASE_BIT != 0).map_or(bytes.len(), |at| at + 1);
        let longest = len.min(record::MAX_LEN);
        (6..=longest).rev().any(|len| self.interpret(&bytes[..len]).is_some())
    }

    /// Takes the open question's part of these bytes; returns the others.
    fn answer<'b>(&mut self, bytes: &'b [u8]) -> &'b [u8] {
        let Some(question) = self.questions.front_mut() else { return bytes };
        let take = (question.len - question.answer.len()).min(bytes.len());
        question.answer.extend_from_slice(&bytes[..take]);
        if question.answer.len() == question.len
            && let Some(question) = self.questions.pop_front()
        {
            self.summary.answers += 1;
            if let Command::Examine(number) = question.command {
                self.learn(question.to, number, &question.answer);
            }
        }
        &bytes[take..]
    }

    /// The open piece has ended: it is a record or nothing.
    fn close_piece(&mut self) {
        if self.piece.is_empty() {
            return;
        }
        let piece = std::mem::take(&mut self.piece);
        match self.interpret(&piece) {
            Some((shape, record, guessed)) => {
                let address = record.address.unwrap_or(0);
                self.guessed += u64::from(guessed);
                // The first record settles what the host has not said.
                self.group.get_or_insert(shape.group);
                let unit = if shape.group { address } else { LINE_UNIT };
                let belief = self.units.entry(unit).or_default();
                if belief.format == Some(shape.format) {
                    belief.format_before = None;
                }
                self.summary.records += 1;
                let t = Some(self.piece_t.to_owned());
                self.records.push(CapturedRecord { t, address, format: shape.format, record });
            }
            None => {
                self.summary.rejected += 1;
                self.summary.bytes_skipped += piece.len() as u64;
            }
        }
    }

    /// Reads a piece as a record of the unit that it names; also whether its shape had to be guessed.
    fn interpret(&self, piece: &[u8]) -> Option<(Shape, Record, bool)> {
        let groups: &[bool] = match self.group {
            Some(true) => &[true],
            Some(false) => &[false],
            None => &[false, true],
        };
        for &group in groups {
            let address = *piece.last()?;
            if group && !(1..=126).contains(&address) {
                continue;
            }
            let unit = if group { address } else { LINE_UNIT };
            let belief = self.units.get(&unit).copied().unwrap_or_default();
            let buttons: &[bool] = match belief.button {
                Some(true) => &[true],
                Some(false) => &[false],
                None => &[false, true],
            };
            let known = [belief.format, belief.format_before];
            // Units power up with position and angles.
            let unknown = std::iter::once(Format::PositionAngles).chain(Format::ALL).map(Some);
            let formats = known.into_iter().chain(unknown.take(if belief.format.is_none() { 8 } else { 0 }));
            for format in formats.flatten() {
                for &button in buttons {
                    let shape = Shape { format, button, group };
                    if let Ok(record) = record::decode(piece, shape, self.scale(), Tolerance::CAPTURE) {
                        return Some((shape, record, belief.format.is_none()));
                    }
                }
            }
        }
        None
    }

    fn scale(&self) -> Scale {
        let found = if self.extended_range { Range::In144 } else { self.scaling.unwrap_or_default() };
        Scale { range: self.options.range.unwrap_or(found), quaternion_sense: self.options.quaternion_sense }
    }
}
