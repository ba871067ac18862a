//! Follows a recorded conversation: what the host asked decides what the unit's bytes are.
//!
//! What comes in: the lines of a log. What goes out: answers are learned from, the rest of the unit's bytes is cut into pieces
//! that may be records, and each unit's [`Timeline`] knows what it was set to. What the pieces are is decided in the end,
//! when all of them are there: see [`super::judge`].

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use super::judge::{self, Piece, Timeline};
use super::log::{Line, Side};
use super::{CaptureError, Decoded, Options, Summary};
use crate::flock::wire::record::{self, MAX_LEN, PHASE_BIT};
use crate::flock::wire::value::parameter;
use crate::flock::wire::{
    Addressing, BirdStatus, Command, CommandParser, Range, Scale, Shape, Tolerance, UnitStatus,
};

/// Pieces after which a question has no answer any more: a flock's status takes the time of a hundred records at most.
const STALE_PIECES: usize = 128;
/// Pieces within which most answers come.
const PROMPT_PIECES: usize = 16;
/// Questions that may be open at once; a host waits for its answers.
const MOST_QUESTIONS: usize = 16;
/// Bytes after a first byte that are looked at together: more than any record has.
const LONGEST_PIECE: usize = 4 * MAX_LEN;
/// The unit on the line: what has no prefix, prefix 0 or prefix 1 is for it.
pub(super) const LINE_UNIT: u8 = 1;

/// A question that has not been answered.
#[derive(Debug)]
struct Question {
    command: Command,
    to: u8,
    len: usize,
    /// Place in the stream at which it was asked, and pieces that had been cut by then.
    place: usize,
    pieces: usize,
}

impl Question {
    /// Whether its answer may well come with as many pieces cut.
    fn is_prompt(&self, pieces: usize) -> bool {
        self.pieces + PROMPT_PIECES > pieces
    }
}

/// What may stand at a place between two records.
enum Gap {
    /// Answers to the questions of this range, so many bytes, with a record or the host's word behind them.
    Answers(std::ops::Range<usize>, usize),
    /// The same, with a first byte behind them; the record that it begins is damaged.
    Perhaps(std::ops::Range<usize>, usize),
    /// More of the log must be read first.
    Unknown,
    /// No answer.
    None,
}

/// What both sides said, as far as the log has been read.
#[derive(Debug, Default)]
pub(super) struct Follower<'a> {
    /// All bytes of the unit, those after the present line included.
    pub(super) bytes: Vec<u8>,
    /// Place of the first byte of each line, and the line's time.
    times: Vec<(usize, &'a str)>,
    cursor: usize,
    host: CommandParser,
    questions: VecDeque<Question>,
    /// Place from which on there may be records.
    records_from: Option<usize>,
    streaming: bool,
    pub(super) pieces: Vec<Piece>,
    /// Where answers begin and end that have nothing but whole ones and records beside them.
    pub(super) answers: Vec<(usize, usize)>,
    pub(super) units: BTreeMap<u8, Timeline>,
    /// Group mode from a place on.
    pub(super) groups: Vec<(usize, bool)>,
    /// Where it has not been said: pieces that can only be of a group, less those that can only be of a unit alone.
    group_votes: i64,
    /// Addresses that the session says are there.
    pub(super) listed: BTreeSet<u8>,
    /// Whether the host has said it.
    configured: bool,
    /// Answers that say that the range is extended, less those that say that it is not.
    extended: i64,
    /// Full scale of a standard transmitter from a place on, where it has been said.
    ranges: Vec<(usize, Range)>,
    pub(super) options: Options,
    pub(super) summary: Summary,
}

/// Decodes the lines of a log, in order: records with what the session says of their units, and counts.
///
/// Where the session does not say the format of a unit, that which fits most of its records is taken, and a warning tells how
/// many records that concerns. Where a format or button mode changes, records of both sides of the change are distinguished by
/// what fits; one of which nothing tells is left out. A log without records is no error.
///
/// # Errors
/// [`CaptureError::Empty`]: there are no lines.
pub fn decode(lines: &[Line], options: Options) -> Result<Decoded, CaptureError> {
    if lines.is_empty() {
        return Err(CaptureError::Empty);
    }
    let mut follower = Follower { options, ..Follower::default() };
    for line in lines.iter().filter(|line| line.side == Side::Unit) {
        follower.times.push((follower.bytes.len(), &line.t));
        follower.bytes.extend_from_slice(&line.bytes);
    }
    let mut place = 0;
    for line in lines {
        match line.side {
            Side::Host => {
                follower.advance(place);
                line.bytes.iter().for_each(|&byte| follower.host_byte(place, byte));
            }
            Side::Unit => place += line.bytes.len(),
        }
    }
    follower.advance(place);
    Ok(judge::decide(follower))
}

impl<'a> Follower<'a> {
    /// Time of the line that holds a byte.
    pub(super) fn time_of(&self, place: usize) -> Option<&'a str> {
        let line = self.times.partition_point(|&(start, _)| start <= place);
        self.times.get(line.checked_sub(1)?).map(|&(_, t)| t)
    }

    /// Meaning of the words of a record that begins at `place`.
    pub(super) fn scale_at(&self, place: usize) -> Scale {
        let said = self.ranges.iter().rev().find(|(from, _)| *from <= place).map(|&(_, range)| range);
        let extended = (self.extended > 0).then_some(Range::In144);
        let range = self.options.range.or(extended).or(said).unwrap_or_default();
        Scale { range, quaternion_sense: self.options.quaternion_sense }
    }

    fn host_byte(&mut self, place: usize, byte: u8) {
        let Some(Ok(addressed)) = self.host.push(byte) else { return };
        let to = match addressed.to {
            None | Some(0) => LINE_UNIT,
            Some(address) => address,
        };
        let len = addressed.command.answer_len(self.host.addressing);
        if len > 0 {
            if !self.streaming && self.cursor < place {
                // The host has given up: what came for its last question is no answer.
                self.summary.bytes_skipped += (place - self.cursor) as u64;
                self.cursor = place;
                self.questions.clear();
            }
            let pieces = self.pieces.len();
            if self.questions.len() == MOST_QUESTIONS {
                self.questions.pop_front();
            }
            self.questions.push_back(Question { command: addressed.command, to, len, place, pieces });
            return;
        }
        match addressed.command {
            command @ (Command::Point | Command::Stream) => {
                self.streaming = command == Command::Stream;
                if self.records_from.is_none() {
                    self.units.values_mut().for_each(Timeline::settle);
                }
                self.records_from.get_or_insert(place);
            }
            Command::StreamStop | Command::Sleep => self.streaming = false,
            Command::Format(format) => self.units.entry(to).or_default().set_format(place, format),
            Command::ButtonMode(on) => self.units.entry(to).or_default().set_button(place, on),
            // The slaves forget what they received.
            Command::FbbReset => {
                let slaves = self.units.iter_mut().filter(|(address, _)| **address != LINE_UNIT);
                slaves.for_each(|(_, unit)| unit.reset(place));
            }
            Command::Change { parameter: parameter::FBB_AUTO_CONFIG, data } => {
                self.configured = true;
                self.listed = data.first().into_iter().flat_map(|&units| 1..=units.min(126)).collect();
            }
            Command::Change { parameter: number, data } => self.learn(place, to, number, &data),
            _ => {}
        }
    }

    /// A parameter's value, from an answer or from the host's change of it. What it cannot be was damaged.
    fn learn(&mut self, place: usize, to: u8, number: u8, data: &[u8]) {
        match (number, data) {
            (parameter::GROUP_MODE, &[mode @ (0 | 1)]) => self.groups.push((place, mode == 1)),
            (parameter::POSITION_SCALING, &[low @ (0 | 1), 0]) => {
                self.ranges.push((place, if low == 0 { Range::In36 } else { Range::In72 }));
            }
            (parameter::BIRD_STATUS, &[low, high]) => {
                let status = BirdStatus::from_bytes([low, high]);
                if let Some(format) = status.format() {
                    self.units.entry(to).or_default().has_format(place, format);
                }
                if status.has(BirdStatus::STREAMING) {
                    self.streaming = true;
                    self.records_from.get_or_insert(place);
                }
            }
            (parameter::MODEL_ID, model) => self.extended += i64::from(model.starts_with(b"6DERC")),
            (parameter::FLOCK_SYSTEM_STATUS, units) => {
                let units =
                    || (1..).zip(units.iter().copied().map(UnitStatus)).filter(|(_, unit)| unit.0 != 0);
                // The host knows how many it has set up. One that speaks of others has a byte too many or too few.
                let is_there = |(at, unit): (u8, UnitStatus)| {
                    unit.has(UnitStatus::ACCESSIBLE) && (!self.configured || self.listed.contains(&at))
                };
                if units().all(is_there) {
                    self.listed.extend(units().map(|(at, _)| at));
                    let extended = units().any(|(_, unit)| unit.has(UnitStatus::EXTENDED_RANGE));
                    self.extended += if extended { 1 } else { -1 };
                }
            }
            (parameter::FBB_ADDRESSING_MODE, &[code]) => {
                self.host.addressing = Addressing::from_code(code).unwrap_or(self.host.addressing);
            }
            _ => {}
        }
    }

    /// Cuts the unit's bytes up to `end`, where the host speaks next; what cannot be identified yet waits.
    fn advance(&mut self, end: usize) {
        let is_last = end == self.bytes.len();
        while self.cursor < end {
            let at = self.cursor;
            while self.questions.front().is_some_and(|first| first.pieces + STALE_PIECES < self.pieces.len())
            {
                self.questions.pop_front();
            }
            if let Some(len) = self.record_at(at) {
                // What the host says at `end` may be answered within: with the answer's first bytes it looks like a longer one.
                if at + len > end && (self.streaming || !self.is_boundary(at + len)) {
                    return;
                }
                self.cut(at + len);
                continue;
            }
            if !self.questions.is_empty() {
                match self.gap(at, end) {
                    // A part of a damaged record may have an answer's length, too.
                    Gap::Answers(range, len) | Gap::Perhaps(range, len)
                        if self.streaming
                            && !self.is_between_set(at, len)
                            && self.is_answered_behind(at, &range) => {}
                    Gap::Answers(range, len) => {
                        self.answers.push((at, at + len));
                        self.take_answers(range, len);
                        continue;
                    }
                    Gap::Perhaps(range, len) => {
                        self.take_answers(range, len);
                        continue;
                    }
                    Gap::Unknown if !is_last => return,
                    Gap::Unknown | Gap::None => {}
                }
            }
            let horizon = self.bytes.len().min(at + LONGEST_PIECE);
            let next = (at + 1..horizon).find(|&place| self.bytes[place] & PHASE_BIT != 0).unwrap_or(horizon);
            if next > end {
                return;
            }
            self.cut(next);
        }
    }

    /// Bytes up to `end` are a piece, if they begin like one.
    fn cut(&mut self, end: usize) {
        let begin = std::mem::replace(&mut self.cursor, end);
        if self.bytes[begin] & PHASE_BIT == 0 {
            self.summary.bytes_skipped += (end - begin) as u64;
            return;
        }
        // Of two first bytes in a row one is not true, and nothing tells which.
        let doubtful = self.pieces.last().is_some_and(|last| last.end == begin && last.end - last.begin == 1);
        if self.groups.is_empty() {
            let [alone, group] =
                [false, true].map(|group| self.may_be(&self.bytes[begin..end], begin, group));
            self.group_votes += i64::from(group) - i64::from(alone);
        }
        let last = self.pieces.last().filter(|last| last.end == begin);
        let due = || self.questions.iter().filter(|question| question.is_prompt(self.pieces.len()));
        let lent = last.and_then(|last| {
            let as_set = |len: &usize| self.is_as_set(&self.bytes[last.begin..last.begin + len]);
            let fits = |len: &usize| {
                let answer = last.begin + len;
                due().any(|due| answer + due.len == begin + 1 && self.may_answer(due, answer))
            };
            self.lengths_at(last.begin).filter(as_set).find(fits)
        });
        let answer_due = !self.questions.is_empty();
        self.pieces.push(Piece { begin, end, doubtful, answer_due, lent });
    }

    fn is_boundary(&self, place: usize) -> bool {
        self.bytes.get(place).is_none_or(|byte| byte & PHASE_BIT != 0)
    }

    /// Length of the record at `place`, if one begins there, and after it what may follow a record.
    fn record_at(&self, place: usize) -> Option<usize> {
        let ends = |len: &usize| {
            let end = place + len;
            let gap = || self.gap(end, self.bytes.len());
            self.is_boundary(end) || matches!(gap(), Gap::Answers(..) | Gap::Perhaps(..))
        };
        // What the unit was set to last is likelier than a longer record that an answer's bytes complete.
        self.set_at(place).filter(ends).or_else(|| self.lengths_at(place).find(ends))
    }

    /// Whether a record has the length of what its unit was set to last.
    fn is_as_set(&self, record: &[u8]) -> bool {
        let group = self.groups.last().map_or(self.group_votes > 0, |&(_, group)| group);
        let unit = if group { record[record.len() - 1] } else { LINE_UNIT };
        let form = self.units.get(&unit).and_then(Timeline::last);
        form.is_some_and(|(format, button)| Shape { format, button, group }.len() == record.len())
    }

    /// Whether `len` bytes at `place` have records of what their units were set to last on both sides.
    fn is_between_set(&self, place: usize, len: usize) -> bool {
        let last = self.pieces.last().filter(|last| last.end == place);
        last.is_some_and(|last| self.set_at(last.begin) == Some(place - last.begin))
            && self.set_at(place + len).is_some()
    }

    /// Whether answers to these questions stand a little behind `place`, between such records.
    fn is_answered_behind(&self, place: usize, questions: &std::ops::Range<usize>) -> bool {
        let horizon = self.bytes.len().min(place + LONGEST_PIECE);
        let questions = || self.questions.range(questions.clone());
        let len: usize = questions().map(|question| question.len).sum();
        (place + 1..horizon)
            .filter_map(|begin| Some(begin + self.set_at(begin)?))
            .filter(|&end| end < horizon && self.set_at(end).is_none() && self.set_at(end + len).is_some())
            .any(|end| questions().next().is_some_and(|question| self.may_answer(question, end)))
    }

    /// Length of the record of what its unit was set to last that begins at `place`.
    fn set_at(&self, place: usize) -> Option<usize> {
        self.lengths_at(place).find(|len| self.is_as_set(&self.bytes[place..place + len]))
    }

    /// Whether a whole record begins at `place`, with another first byte or nothing behind it.
    fn begins_record(&self, place: usize) -> bool {
        self.lengths_at(place).any(|len| self.is_boundary(place + len))
    }

    /// Lengths of the records that the bytes at `place` may be, by what their units may send.
    fn lengths_at(&self, place: usize) -> impl Iterator<Item = usize> {
        let expected = self.records_from.is_some_and(|from| from <= place)
            && self.bytes.get(place).is_some_and(|byte| byte & PHASE_BIT != 0);
        let front = &self.bytes[place.min(self.bytes.len())..self.bytes.len().min(place + MAX_LEN)];
        let phase = front.iter().skip(1).position(|byte| byte & PHASE_BIT != 0);
        let longest = if expected { phase.map_or(front.len(), |at| at + 1) } else { 0 };
        let modes: &[bool] = match (self.groups.last(), self.group_votes) {
            (Some((_, true)), _) | (None, 1..) => &[true],
            (Some((_, false)), _) | (None, ..=-1) => &[false],
            (None, 0) => &[false, true],
        };
        let fits = move |len: &usize| modes.iter().any(|&group| self.may_be(&front[..*len], place, group));
        (6..=longest).rev().filter(fits)
    }

    /// Whether bytes can be a record that its unit sends by now, in group mode or not.
    fn may_be(&self, bytes: &[u8], place: usize, group: bool) -> bool {
        let address = bytes[bytes.len() - 1];
        let unit = if group { address } else { LINE_UNIT };
        let forms = self.units.get(&unit).map_or_else(Timeline::anything, Timeline::recent);
        (!group || self.may_be_bird(address))
            && forms
                .into_iter()
                .any(|(format, button)| self.fits(bytes, place, Shape { format, button, group }))
    }

    fn may_be_bird(&self, address: u8) -> bool {
        (1..=126).contains(&address) && (self.listed.is_empty() || self.listed.contains(&address))
    }

    pub(super) fn fits(&self, bytes: &[u8], place: usize, shape: Shape) -> bool {
        bytes.len() == shape.len() && self.read(bytes, place, shape).is_some()
    }

    /// The record of this shape that the bytes at `place` are.
    pub(super) fn read(&self, bytes: &[u8], place: usize, shape: Shape) -> Option<record::Record> {
        let record = record::decode(bytes, shape, self.scale_at(place), Tolerance::CAPTURE).ok()?;
        record.button.is_none_or(|button| super::BUTTONS.contains(&button)).then_some(record)
    }

    /// What stands between the record that ends at `at` and the next one, or the host's word at `end`.
    fn gap(&self, at: usize, end: usize) -> Gap {
        let ends = |place: usize| place == end || place <= self.bytes.len() && self.begins_record(place);
        let mut len = 0;
        for (k, question) in self.questions.iter().enumerate() {
            if !self.may_answer(question, at + len) {
                break;
            }
            len += question.len;
            if ends(at + len) {
                return Gap::Answers(0..k + 1, len);
            }
        }
        // Earlier ones may never be answered.
        for (k, question) in self.questions.iter().enumerate().skip(1) {
            if ends(at + question.len) && self.may_answer(question, at) {
                return Gap::Answers(k..k + 1, question.len);
            }
        }
        let longest = self.questions.iter().map(|question| question.len).sum::<usize>() + MAX_LEN;
        // The record behind it may be damaged: then its first byte must do, unless a damaged one stands here. A flock's status
        // has first bytes of its own, and no record is like it.
        for (k, question) in self.questions.iter().enumerate() {
            let end = at + question.len;
            let is_status = question.command == Command::Examine(parameter::FLOCK_SYSTEM_STATUS);
            if (is_status || !self.is_boundary(at)) && self.is_boundary(end) && self.may_answer(question, at)
            {
                return Gap::Perhaps(k..k + 1, question.len);
            }
        }
        if (at + 1..self.bytes.len().min(at + longest)).any(|place| self.begins_record(place))
            || end > at + longest
        {
            Gap::None
        } else {
            Gap::Unknown
        }
    }

    /// Whether the bytes at `at` can be the answer. In a stream damaged records may have an answer's length.
    fn may_answer(&self, question: &Question, at: usize) -> bool {
        let Some(bytes) = self.bytes.get(at..at + question.len) else { return false };
        match question.command {
            _ if !self.streaming => true,
            Command::Examine(parameter::FLOCK_SYSTEM_STATUS) => {
                bytes.iter().all(|&unit| unit == 0 || UnitStatus(unit).has(UnitStatus::ACCESSIBLE))
            }
            Command::Examine(parameter::POSITION_SCALING) => matches!(bytes, [0 | 1, 0]),
            Command::Examine(parameter::MODEL_ID) => bytes.iter().all(|byte| (b' '..=b'~').contains(byte)),
            _ => true,
        }
    }

    /// The next `len` bytes answer the questions of `range`; those before it are given up.
    fn take_answers(&mut self, range: std::ops::Range<usize>, len: usize) {
        self.questions.drain(..range.start);
        let knows = self.units.values().any(|unit| unit.last().is_some());
        let is_prompt = self.questions.front().is_some_and(|question| question.place == self.cursor);
        let is_clean =
            if self.streaming { !knows || self.is_between_set(self.cursor, len) } else { is_prompt };
        let (mut at, end) = (self.cursor, self.cursor + len);
        self.cursor = end;
        for question in self.questions.drain(..range.len()).collect::<Vec<_>>() {
            let answer = self.bytes[at..at + question.len].to_vec();
            at += question.len;
            self.summary.answers += 1;
            if is_clean && question.is_prompt(self.pieces.len()) {
                self.pieces[question.pieces..].iter_mut().for_each(|piece| piece.lent = None);
            }
            if let Command::Examine(number) = question.command {
                // What stands beside damage may be another answer, and these two decide on all positions.
                let is_scale = matches!(number, parameter::POSITION_SCALING | parameter::FLOCK_SYSTEM_STATUS);
                if is_clean || !is_scale {
                    self.learn(at, question.to, number, &answer);
                }
            }
        }
    }
}
