//! Decides what the pieces of a conversation are, once all of them are there.
//!
//! A unit obeys a change of its format or button mode some records after the host has sent it, never before, and in the order of
//! the commands. So the shapes of its records follow each other as the commands do, and each change lies where most pieces
//! fit. A record next to a change must also be what its neighbours are: there a byte too many or too few makes one shape look
//! like the other.

use std::collections::{BTreeMap, BTreeSet};

use super::follow::{Follower, LINE_UNIT};
use super::{CapturedRecord, Decoded};
use crate::flock::wire::record::{self, Record};
use crate::flock::wire::{Format, Shape};

/// Most changes of a unit that may be on their way at once.
const PENDING: usize = 8;
/// Records of a unit that may still be on their way when the host sends a change.
const ON_THE_WAY: usize = 4;
/// Records on either side that say how long one is.
const AROUND: usize = 16;
/// One step of a word's high byte, less one: a byte too many or too few makes greater jumps.
const STEP: u16 = 511;
/// Most by which a word lies outside of its two neighbours: noise, and motion that turns back.
const NOISE: u16 = 128;

/// Bytes that begin like a record: places in the stream.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    pub(super) begin: usize,
    pub(super) end: usize,
    /// A single first byte stands in front of it.
    pub(super) doubtful: bool,
    /// An answer was due when it was cut.
    pub(super) answer_due: bool,
    /// Its first byte may be the last one of that answer, and the record itself has lost its first: then the piece in front is
    /// a record of so many bytes and the rest of the answer.
    pub(super) lent: Option<usize>,
}

/// Format and button mode.
pub(super) type Form = (Format, bool);

/// A unit that has just been switched on, or has lost what it was set to.
const POWER_UP: Form = (Format::PositionAngles, false);

/// What the host set a unit to.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    Format(Format),
    Button(bool),
    Reset,
}

impl Change {
    fn of(self, (format, button): Form) -> Form {
        match self {
            Self::Format(format) => (format, button),
            Self::Button(button) => (format, button),
            Self::Reset => POWER_UP,
        }
    }
}

/// All that the host set a unit to, in order, each with the place in the stream at which it did.
#[derive(Clone, Debug, Default)]
pub(super) struct Timeline {
    changes: Vec<(usize, Change)>,
    /// So many of them before the first record was asked for: they are in force with it.
    settled: usize,
}

impl Timeline {
    pub(super) fn set_format(&mut self, place: usize, format: Format) {
        self.changes.push((place, Change::Format(format)));
    }

    pub(super) fn set_button(&mut self, place: usize, on: bool) {
        self.changes.push((place, Change::Button(on)));
    }

    pub(super) fn reset(&mut self, place: usize) {
        self.changes.push((place, Change::Reset));
    }

    /// The unit reports its format. The host's word counts for more, since answers may be damaged.
    pub(super) fn has_format(&mut self, place: usize, format: Format) {
        if self.first_format().is_none() {
            self.set_format(place, format);
        }
    }

    /// Records are asked for, for the first time: none is on its way.
    pub(super) fn settle(&mut self) {
        self.settled = self.changes.len();
    }

    /// Index of the change from which on the format is known.
    fn first_format(&self) -> Option<usize> {
        self.changes.iter().position(|(_, change)| !matches!(change, Change::Button(_)))
    }

    /// All that there can be.
    pub(super) fn anything() -> Vec<Form> {
        let formats = std::iter::once(POWER_UP.0).chain(Format::ALL);
        formats.flat_map(|format| [(format, false), (format, true)]).collect()
    }

    /// What it may send by now, in any button mode.
    pub(super) fn recent(&self) -> Vec<Form> {
        if self.first_format().is_none() {
            return Self::anything();
        }
        let last = self.changes.iter().rev().take(PENDING + 1);
        let formats = last.filter_map(|(_, change)| match change {
            Change::Format(format) => Some(*format),
            Change::Button(_) => None,
            Change::Reset => Some(POWER_UP.0),
        });
        // More than so many button modes in a row say nothing of the format before them.
        let format = self.changes.iter().rev().find(|(_, change)| !matches!(change, Change::Button(_)));
        let format = format.map(|(_, change)| change.of(POWER_UP).0);
        formats.chain(format).flat_map(|format| [(format, false), (format, true)]).collect()
    }

    /// What it sends once it has obeyed, where that is known.
    pub(super) fn last(&self) -> Option<Form> {
        let known = self.first_format()?;
        let button =
            self.changes[known..].iter().any(|(_, change)| !matches!(change, Change::Format(_))) || known > 0;
        button.then(|| self.forms(POWER_UP)[self.changes.len()])
    }

    /// What it may have sent at any time.
    fn ever(&self) -> Vec<Form> {
        let was_set = |format: Format| {
            self.changes
                .iter()
                .any(|(_, change)| change.of(POWER_UP).0 == format && !matches!(change, Change::Button(_)))
        };
        let formats = Format::ALL.into_iter().filter(|&format| format == POWER_UP.0 || was_set(format));
        if self.first_format().is_none() {
            return Self::anything();
        }
        formats.flat_map(|format| [(format, false), (format, true)]).collect()
    }

    /// The forms that follow each other if the unit begins with this one.
    fn forms(&self, first: Form) -> Vec<Form> {
        let mut forms = vec![first];
        for (_, change) in &self.changes {
            forms.push(change.of(forms[forms.len() - 1]));
        }
        forms
    }
}

/// One unit's pieces, and how they can be read.
struct Unit<'f, 'a> {
    follower: &'f Follower<'a>,
    timeline: &'f Timeline,
    group: bool,
    pieces: Vec<Piece>,
}

/// A way to read a unit's pieces: the form of each, where it fits one.
struct Reading {
    fits: usize,
    forms: Vec<Form>,
    /// Index in `forms` that holds at each piece, and whether the piece fits it.
    at: Vec<(usize, bool)>,
}

impl Unit<'_, '_> {
    fn shape(&self, (format, button): Form) -> Shape {
        Shape { format, button, group: self.group }
    }

    fn bytes(&self, piece: &Piece) -> &[u8] {
        &self.follower.bytes[piece.begin..piece.end]
    }

    fn fits(&self, piece: &Piece, form: Form) -> bool {
        !piece.doubtful && self.follower.fits(self.bytes(piece), piece.begin, self.shape(form))
    }

    fn words(&self, piece: &Piece, form: Form) -> Option<[i16; record::MAX_WORDS]> {
        record::words(self.bytes(piece), self.shape(form)).ok()
    }

    /// The reading that fits most pieces. What the session does not say is tried.
    fn read(&self) -> Reading {
        let mut best: Option<Reading> = None;
        for first in Timeline::anything() {
            let reading = self.follow(first);
            if best.as_ref().is_none_or(|best| reading.fits > best.fits) {
                best = Some(reading);
            }
        }
        let mut reading = best.unwrap_or_else(|| self.follow(POWER_UP));
        self.part_twins(&mut reading);
        reading
    }

    /// Follows the forms from `first` on: each change where most pieces fit, as early as that allows.
    fn follow(&self, first: Form) -> Reading {
        let forms = self.timeline.forms(first);
        // Most pieces that fit when the one at hand is of form `low + k`, and where that came from.
        let mut low = self.timeline.settled;
        let mut best = vec![0];
        let mut steps: Vec<(usize, Vec<(usize, bool)>)> = Vec::with_capacity(self.pieces.len());
        for piece in &self.pieces {
            let high = self.timeline.changes.partition_point(|(place, _)| *place <= piece.begin).max(low);
            let next_low = low.max(high.saturating_sub(PENDING));
            let (mut came, mut most) = (low, best[0]);
            let mut next = Vec::with_capacity(high + 1 - next_low);
            let mut step = Vec::with_capacity(high + 1 - next_low);
            for (k, &form) in forms.iter().enumerate().take(high + 1).skip(low) {
                if let Some(&fits) = best.get(k - low)
                    && fits >= most
                {
                    (came, most) = (k, fits);
                }
                if k >= next_low {
                    let fits = self.fits(piece, form);
                    next.push(most + usize::from(fits));
                    step.push((came, fits));
                }
            }
            steps.push((next_low, step));
            (low, best) = (next_low, next);
        }
        let fits = best.iter().copied().max().unwrap_or(0);
        let last = best.iter().rposition(|&most| most == fits).unwrap_or(0);
        let mut k = low + last;
        let mut at: Vec<(usize, bool)> = steps
            .iter()
            .rev()
            .map(|(low, step)| {
                let (came, fits) = step[k - low];
                (std::mem::replace(&mut k, came), fits)
            })
            .collect();
        at.reverse();
        Reading { fits, forms, at }
    }

    /// Position and angles have records of one length. Which of the first after a change are still of the old kind is shown by
    /// the greatest jump alone.
    fn part_twins(&self, reading: &mut Reading) {
        for i in 1..reading.at.len() {
            let (old, new) = (reading.at[i - 1].0, reading.at[i].0);
            let (old_form, new_form) = (reading.forms[old], reading.forms[new]);
            if old == new || old_form == new_form {
                continue;
            }
            let twins = |piece: &Piece| self.fits(piece, old_form) && self.fits(piece, new_form);
            let end = (i + ON_THE_WAY).min(self.pieces.len());
            let end = (i..end).find(|&k| reading.at[k].0 != new || !twins(&self.pieces[k])).unwrap_or(end);
            let begin = (0..i).rev().find(|&k| reading.at[k].1);
            let Some(begin) = begin.filter(|_| end > i) else { continue };
            let mut words = self.words(&self.pieces[begin], old_form);
            let mut jumps = Vec::new();
            for k in i..end {
                let next = self.words(&self.pieces[k], new_form);
                jumps.push(words.zip(next).map_or(0, |(a, b)| jump(&a, &b)));
                words = next;
            }
            // None of them may be new yet.
            let after = (end..self.pieces.len()).find(|&k| reading.at[k].1).filter(|_| end < i + ON_THE_WAY);
            let form = after.map(|k| reading.forms[reading.at[k].0]).filter(|form| form.0 == new_form.0);
            let next = after.zip(form).and_then(|(k, form)| self.words(&self.pieces[k], form));
            jumps.extend(words.zip(next).map(|(a, b)| jump(&a, &b)));
            let most = jumps.iter().copied().max().unwrap_or(0);
            let change = jumps.iter().position(|&jump| jump == most).unwrap_or(0);
            reading.at[i..i + change].iter_mut().for_each(|at| at.0 = old);
        }
    }

    /// Takes back the records that may be something else, unless their neighbours prove them. One beside damage may be a part of
    /// something or have taken in a part, unless the damaged bytes are a record's length by themselves. One next to a change may
    /// be a damaged one of the other form, with a byte too many or too few.
    fn prove(&self, reading: &mut Reading, whole: &Whole) {
        let found: Vec<usize> = (0..reading.at.len()).filter(|&i| reading.at[i].1).collect();
        let form = |m: usize| found.get(m).map(|&i| reading.forms[reading.at[i].0]);
        let unproven = |&m: &usize| {
            let piece = &self.pieces[found[m]];
            let beside = [m.checked_sub(1).and_then(form), form(m + 1)];
            if self.is_lent(reading, &found, m) {
                return true;
            }
            let others = || beside.into_iter().flatten().filter(|other| Some(*other) != form(m));
            // The words of a record that has lost its button byte are whole: only another one without tells.
            let twin = |other: Form| other.1 && form(m) == Some((other.0, false));
            if others().any(twin) && !beside.contains(&form(m)) {
                return true;
            }
            let [before, after] = whole.damage(piece);
            let len = piece.end - piece.begin;
            let is_part = |other: Form, rest: usize| {
                let other = self.shape(other).len();
                rest > 0 && (other..=other + 1).contains(&(len + rest))
            };
            let is_cut = |other: (usize, Form)| {
                is_part(other.1, before)
                    && self.is_joined(reading, other, piece.begin, piece.begin - before, piece.end)
                    || is_part(other.1, after)
                        && self.is_joined(reading, other, piece.end, piece.begin, piece.end + after)
            };
            let beside = [m.checked_sub(1), Some(m + 1)].into_iter().flatten();
            let mut others_at = beside
                .filter_map(|k| Some((*found.get(k)?, form(k)?)))
                .filter(|other| Some(other.1) != form(m));
            if others_at.any(is_cut) {
                return true;
            }
            let may_be = |other: Form| {
                self.shape(other).len().abs_diff(len) == 1 || is_part(other, before) || is_part(other, after)
            };
            // Damage as long as one or two of the records around, but for a byte, has taken nothing from this one.
            let lengths = whole.lengths(piece);
            let sums = lengths.iter().flat_map(|one| lengths.iter().map(move |other| one + other));
            let lengths: BTreeSet<usize> = lengths.iter().copied().chain(sums).collect();
            let is_apart =
                |damaged: usize| damaged == 0 || lengths.iter().any(|len| len.abs_diff(damaged) <= 1);
            let is_exposed =
                before + after > 0 && (piece.answer_due || !is_apart(before) || !is_apart(after));
            (is_exposed || others().any(may_be)) && !self.is_proven(reading, &found, m)
        };
        let taken_back: Vec<usize> = (0..found.len()).filter(unproven).map(|m| found[m]).collect();
        for i in taken_back {
            reading.at[i].1 = false;
        }
    }

    /// Whether the bytes from `begin` to `end` are a record of the form of that at `known`, and like it, once the first byte at `cut`
    /// is taken out, or its bit 7 is.
    fn is_joined(
        &self,
        reading: &Reading,
        known: (usize, Form),
        cut: usize,
        begin: usize,
        end: usize,
    ) -> bool {
        let (known, form) = known;
        let shape = self.shape(form);
        let mut bytes = self.follower.bytes[begin..end].to_vec();
        if bytes.len() == shape.len() {
            bytes[cut - begin] &= !record::PHASE_BIT;
        } else {
            bytes.remove(cut - begin);
        }
        let known = self.words(&self.pieces[known], reading.forms[reading.at[known].0]);
        record::words(&bytes, shape).ok().zip(known).is_some_and(|(a, b)| jump(&a, &b) <= 2 * STEP)
    }

    /// Whether a record's first byte may be an answer's last one. Of a unit alone, the record in front of that answer must be one.
    fn is_lent(&self, reading: &Reading, found: &[usize], m: usize) -> bool {
        let piece = &self.pieces[found[m]];
        let Some(len) = piece.lent else { return false };
        let Some(known) = m.checked_sub(1).map(|k| found[k]).filter(|_| !self.group) else { return true };
        let Some(front) = self.pieces[..found[m]].last() else { return true };
        let front = Piece { end: front.begin + len, ..*front };
        let words = |piece: &Piece| self.words(piece, reading.forms[reading.at[known].0]);
        words(&front).zip(words(&self.pieces[known])).is_none_or(|(a, b)| jump(&a, &b) <= 2 * STEP)
    }

    /// Whether a record continues its neighbours, one of which may be what is wrong.
    fn is_proven(&self, reading: &Reading, found: &[usize], m: usize) -> bool {
        let before = |k: usize| m.checked_sub(k).map(|at| found[at]);
        let after = |k: usize| found.get(m + k).copied();
        [(1, 1), (2, 1), (1, 2)]
            .into_iter()
            .any(|(b, a)| self.continues(reading, before(b), found[m], after(a)))
    }

    /// Whether a piece lies between its neighbours as those of a sensor in motion do, as far as they are of its format.
    fn continues(&self, reading: &Reading, before: Option<usize>, at: usize, after: Option<usize>) -> bool {
        let format = |i: usize| reading.forms[reading.at[i].0].0;
        let words = |i: usize| self.words(&self.pieces[i], reading.forms[reading.at[i].0]);
        let neighbour = |i: Option<usize>| i.filter(|&i| format(i) == format(at)).and_then(words);
        let Some(here) = words(at) else { return false };
        match (neighbour(before), neighbour(after)) {
            (Some(before), Some(after)) => (0..here.len()).all(|k| {
                let [a, b, whole] = [(here[k], before[k]), (here[k], after[k]), (before[k], after[k])]
                    .map(|(a, b)| u32::from(a.wrapping_sub(b).unsigned_abs()));
                a.max(b) <= u32::from(STEP).max(whole + u32::from(NOISE))
            }),
            (Some(other), None) | (None, Some(other)) => jump(&here, &other) <= 2 * STEP,
            (None, None) => false,
        }
    }
}

fn jump(a: &[i16], b: &[i16]) -> u16 {
    a.iter().zip(b).map(|(a, b)| a.wrapping_sub(*b).unsigned_abs()).max().unwrap_or(0)
}

/// Records and answers that seem whole.
struct Whole {
    /// Where each ends, by where it begins, and the other way round; the log's ends are among them.
    begins: BTreeMap<usize, usize>,
    ends: BTreeMap<usize, usize>,
}

impl Whole {
    fn new(all: impl Iterator<Item = (usize, usize)>, len: usize) -> Self {
        let mut begins: BTreeMap<usize, usize> = all.collect();
        let mut ends: BTreeMap<usize, usize> = begins.iter().map(|(&begin, &end)| (end, begin)).collect();
        ends.insert(0, 0);
        begins.insert(len, len);
        Self { begins, ends }
    }

    /// What is damaged in front of a piece and behind it: numbers of bytes.
    fn damage(&self, piece: &Piece) -> [usize; 2] {
        let before = self.ends.range(..=piece.begin).next_back().map_or(0, |(&end, _)| end);
        let after = self.begins.range(piece.end..).next().map_or(piece.end, |(&begin, _)| begin);
        [piece.begin - before, after - piece.end]
    }

    /// Lengths of the records and answers around a piece.
    fn lengths(&self, piece: &Piece) -> BTreeSet<usize> {
        let before = self.ends.range(..=piece.begin).rev().take(AROUND).map(|(end, begin)| end - begin);
        let after = self.begins.range(piece.end..).take(AROUND).map(|(begin, end)| end - begin);
        before.chain(after).filter(|&len| len > 0).collect()
    }
}

/// Reads all pieces, each unit's by itself.
pub(super) fn decide(mut follower: Follower<'_>) -> Decoded {
    let pieces = std::mem::take(&mut follower.pieces);
    let mut by_unit: BTreeMap<(bool, u8), Vec<Piece>> = BTreeMap::new();
    for (piece, group) in pieces.iter().zip(group_modes(&follower, &pieces)) {
        let address = if group { follower.bytes[piece.end - 1] } else { LINE_UNIT };
        if (1..=126).contains(&address) {
            by_unit.entry((group, address)).or_default().push(*piece);
        }
    }
    let unknown = Timeline::default();
    let mut read = Vec::new();
    for ((group, address), pieces) in by_unit {
        let timeline = follower.units.get(&address).unwrap_or(&unknown);
        let unit = Unit { follower: &follower, timeline, group, pieces };
        let reading = unit.read();
        read.push((address, unit, reading));
    }
    // One that a single first byte stands in front of is not believed, but it is no part of another one.
    let records = read.iter().flat_map(|(_, unit, reading)| {
        let pieces = unit.pieces.iter().zip(&reading.at);
        let fitting = pieces.filter(|(piece, (k, _))| {
            let shape = unit.shape(reading.forms[*k]);
            follower.fits(unit.bytes(piece), piece.begin, shape)
        });
        fitting.map(|(piece, _)| (piece.begin, piece.end))
    });
    let whole = Whole::new(records.chain(follower.answers.iter().copied()), follower.bytes.len());
    for (_, unit, reading) in &mut read {
        unit.prove(reading, &whole);
    }
    let most = read.iter().map(|(.., reading)| reading.fits).max().unwrap_or(0);
    let mut records: BTreeMap<usize, (usize, CapturedRecord)> = BTreeMap::new();
    let mut guessed = 0;
    for (address, unit, reading) in &read {
        // A bird that the session does not list, and that hardly speaks, is damage.
        let share = if follower.listed.is_empty() { 20 } else { 4 };
        if unit.group && !follower.listed.contains(address) && reading.fits * share < most {
            continue;
        }
        for (piece, &(k, fits)) in unit.pieces.iter().zip(&reading.at) {
            let shape = unit.shape(reading.forms[k]);
            let record = follower.read(unit.bytes(piece), piece.begin, shape);
            let Some(record) = record.filter(|_| fits) else { continue };
            guessed += usize::from(unit.timeline.first_format().is_none_or(|first| k <= first));
            records.insert(piece.begin, (piece.end, captured(&follower, piece.begin, shape, record)));
        }
    }
    drop(read);
    let mut summary = follower.summary;
    summary.records = records.len() as u64;
    summary.rejected = (pieces.len() - records.len()) as u64;
    let accepted: usize = records.iter().map(|(begin, (end, _))| end - begin).sum();
    let all: usize = pieces.iter().map(|piece| piece.end - piece.begin).sum();
    summary.bytes_skipped += (all - accepted) as u64;
    let warning = format!(
        "the session does not contain the format of {guessed} records; that which fits most of them was taken"
    );
    Decoded {
        range: follower.scale_at(follower.bytes.len()).range,
        records: records.into_values().map(|(_, record)| record).collect(),
        summary,
        warnings: if guessed > 0 { vec![warning] } else { Vec::new() },
    }
}

fn captured(follower: &Follower<'_>, place: usize, shape: Shape, record: Record) -> CapturedRecord {
    let t = follower.time_of(place).map(str::to_owned);
    CapturedRecord { t, address: record.address.unwrap_or(0), format: shape.format, record }
}

/// Whether each piece was sent in group mode. The mode changes where the first piece fits the new one, and not the old one.
fn group_modes(follower: &Follower<'_>, pieces: &[Piece]) -> Vec<bool> {
    let known: BTreeMap<u8, Vec<Form>> =
        follower.units.iter().map(|(&address, unit)| (address, unit.ever())).collect();
    let anything = Timeline::anything();
    let fits = |piece: &Piece, group: bool| {
        let bytes = &follower.bytes[piece.begin..piece.end];
        let address = if group { bytes[bytes.len() - 1] } else { LINE_UNIT };
        let mut forms = known.get(&address).unwrap_or(&anything).iter();
        (1..=126).contains(&address)
            && forms
                .any(|&(format, button)| follower.fits(bytes, piece.begin, Shape { format, button, group }))
    };
    let mut groups = follower.groups.iter().peekable();
    let mut mode = None;
    let mut before = None;
    let mut modes = Vec::with_capacity(pieces.len());
    for piece in pieces {
        while let Some(&(_, group)) = groups.next_if(|(place, _)| *place <= piece.begin) {
            before = mode.filter(|mode| *mode != group).or(before);
            mode = Some(group);
        }
        let now = *mode.get_or_insert_with(|| {
            // The host has not said it: that which makes sense of most pieces.
            let count = |group: bool| pieces.iter().filter(|piece| fits(piece, group)).count();
            count(true) > count(false)
        });
        let is_new = before.is_none() || fits(piece, now);
        let late = before.filter(|before| !is_new && fits(piece, *before));
        before = before.filter(|_| !is_new);
        modes.push(late.unwrap_or(now));
    }
    modes
}
