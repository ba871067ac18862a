//! Cuts the stream of records and decides which of them to believe.
//!
//! What comes in: read chunks with their stamps. What goes out: [`Sample`]s, and word of birds that left
//! or came back. What it never does: publish a record that a single lost, inserted or phase-flipped
//! byte could have made.
//!
//! The protocol has no checksum, so a record must agree with all there is: it begins at a byte with bit 7
//! set and ends before the next one; its length is that of the bird it names; that bird is the next running
//! one in order; its orientation is a rotation. Three cases need care:
//!
//! - *Two first bytes in a row* (one inserted with bit 7, before or after the true one): nothing tells which is
//!   true, so the record behind a piece of one byte is refused.
//! - *Order after damage*: the bytes of the damage say how many records they were, so the expected bird and
//!   the cycle number stay right. A record that contradicts is refused and its word on the order taken; but where
//!   not a byte is damaged and it continues its bird's last record, the birds before it have stopped speaking.
//! - *A record complete at the end of a chunk*: a byte inserted inside it would make it look complete one byte
//!   early. It is published at once when it continues its bird's previous record within one step of the
//!   high byte in every word, which no shifted record does; otherwise it waits for the next byte to be
//!   a first byte, or for two byte times of silence. In steady motion nothing waits.

use std::time::Duration;

use posed_state::Plain;

use super::wire::record::{self, MAX_LEN, MAX_WORDS, PHASE_BIT};
use super::wire::{Scale, Shape, Tolerance};
use crate::arrivals::{hides_losses, whole_cycles};
use crate::sample::{Arrival, DeviceTime, Measurement, Sample, Timestamp};
use crate::session::Counters;

/// Clean cycles without its record after which a bird is taken out of the order.
const MISSES_TO_LEAVE: u8 = 3;
/// Records of an absent bird after which it is put back.
const SIGHTINGS_TO_RETURN: u8 = 2;
/// Pieces of one wrong length in a row after which a bird has another format: damage does not repeat itself.
const MISFITS_TO_RESHAPE: u8 = 4;
/// Three words and an address.
const SHORTEST_RECORD: usize = 7;
/// Bytes by which damage may differ from whole records, and still say how many they were.
const SLACK_BYTES: u64 = 3;
/// One step of a word's high byte, less one.
const CONTINUES_WITHIN: u16 = 511;

/// What the splitter says.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "nearly all events are samples, and none may allocate")]
pub enum Event {
    /// A record to believe. Its cycle number is that of its place in the order.
    Sample(Sample),
    /// A bird's records have stopped (three clean cycles without one); it is no longer waited for. By its address.
    Left(u8),
    /// It is back, after two of its records; those two are not published. By its address.
    Returned(u8),
    /// A whole piece that ends in the address of a bird which is not known here. One alone may be damage. Only in group mode.
    Stranger(u8),
    /// A bird sends records of another length than its format's, several in a row: it has restarted by itself, and is as it is when it
    /// is switched on. By its address. Only in group mode.
    Reshaped(u8),
}

/// One bird in the order of records.
#[derive(Clone, Debug, Plain)]
struct Slot {
    address: u8,
    shape: Shape,
    /// Words of its last accepted record.
    last: Option<[i16; MAX_WORDS]>,
    /// Clean cycles in a row in which it did not speak; for an absent bird, how often it was seen.
    count: u8,
    /// Length of its latest pieces that are none of its records, and how many of them came in a row; `None` after a record.
    misfits: Option<(usize, u8)>,
}

/// The piece being read: all bytes since a first byte.
#[derive(Clone, Debug, Default, Plain)]
struct Piece {
    /// The bytes, as far as a record could reach and one more.
    bytes: Vec<u8>,
    /// How many there were.
    len: usize,
    t_read: Timestamp,
    t_previous_read: Option<Timestamp>,
    bytes_after: u32,
    /// A later read went on with it.
    split: bool,
    /// Published already; what still comes is stray.
    published: bool,
}

impl Piece {
    /// The address at its end, if it is whole and as long as a record: `None` of what was published.
    fn address(&self) -> Option<u8> {
        let is_whole = !self.published && self.len == self.bytes.len() && self.len >= SHORTEST_RECORD;
        self.bytes.last().copied().filter(|_| is_whole)
    }
}

/// Cuts records out of a stream; see the module's words. Positions are in m in the transmitter frame, orientations sensor to
/// transmitter.
///
/// What it believes has the right form, place and, for matrices and quaternions, norm; a flipped bit in a position or an angle
/// can pass.
#[derive(Clone, Debug, Plain)]
pub struct Splitter {
    slots: Vec<Slot>,
    absent: Vec<Slot>,
    scale: Scale,
    tolerance: Tolerance,
    /// How long a doubtful record waits for a stray byte.
    hold: Duration,
    piece: Piece,
    hold_until: Option<Timestamp>,
    t_last_read: Option<Timestamp>,
    /// The piece before the open one was a single first byte.
    after_lone_first_byte: bool,
    /// Bytes since the end of the last record whose place in the order is known.
    damage: u64,
    /// Index of the slot that comes next, and the number of its cycle.
    next: usize,
    cycle: u64,
    /// Whether `next` is known.
    in_order: bool,
    counters: Counters,
}

impl Splitter {
    /// A splitter for these running birds, by rising address; a single one without group mode has address 0.
    ///
    /// `baud` (bit/s) says how long two bytes take, the time for which a doubtful record is held back.
    pub fn new(birds: &[(u8, Shape)], scale: Scale, tolerance: Tolerance, baud: u32) -> Self {
        Self {
            slots: birds
                .iter()
                .map(|&(address, shape)| Slot { address, shape, last: None, count: 0, misfits: None })
                .collect(),
            absent: Vec::new(),
            scale,
            tolerance,
            hold: Duration::from_secs_f64(2.0 * 10.0 / f64::from(baud.max(300))),
            piece: Piece { bytes: Vec::with_capacity(MAX_LEN + 1), ..Piece::default() },
            hold_until: None,
            t_last_read: None,
            after_lone_first_byte: false,
            damage: 0,
            next: 0,
            cycle: 0,
            in_order: false,
            counters: Counters::default(),
        }
    }

    /// Goes on counting cycles from `cycle`, so that their numbers never repeat after a restart.
    pub fn start_at_cycle(&mut self, cycle: u64) {
        self.cycle = cycle;
    }

    /// Number of the cycle whose record comes next.
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// Whether the last record ended its cycle, or none has come yet.
    pub fn at_cycle_start(&self) -> bool {
        self.next == 0
    }

    /// Takes what has been counted since the last call. Records of absent birds count as refused.
    pub fn take_counters(&mut self) -> Counters {
        std::mem::take(&mut self.counters)
    }

    /// When [`Self::handle_timeout`] has a record to release; `None` while none is held back.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        self.hold_until
    }

    /// Takes one read chunk, read at `now`, and calls `emit` with what it completes, in order.
    pub fn handle_bytes(&mut self, now: Timestamp, bytes: &[u8], emit: &mut impl FnMut(Event)) {
        if bytes.is_empty() {
            return;
        }
        self.hold_until = None;
        for (i, &byte) in bytes.iter().enumerate() {
            if byte & PHASE_BIT != 0 {
                self.close_piece(emit);
                self.piece.t_read = now;
                self.piece.t_previous_read = self.t_last_read;
                self.piece.bytes_after = (bytes.len() - i - 1) as u32;
                self.piece.split = false;
            } else if self.piece.len == 0 || self.piece.published {
                self.skip(1);
                continue;
            } else if i == 0 {
                self.piece.split = true;
            }
            self.piece.len += 1;
            if self.piece.bytes.len() <= MAX_LEN {
                self.piece.bytes.push(byte);
            }
        }
        self.t_last_read = Some(now);
        if let Some(slot) = self.complete_slot() {
            if self.continues(slot) {
                self.judge(slot, emit);
                self.piece.published = true;
            } else {
                self.hold_until = Some(now + self.hold);
            }
        }
    }

    /// Releases the record that waited for a stray byte. A call before [`Self::poll_timeout`] does nothing.
    pub fn handle_timeout(&mut self, now: Timestamp, emit: &mut impl FnMut(Event)) {
        if self.hold_until.is_some_and(|until| now >= until) {
            self.hold_until = None;
            if let Some(slot) = self.complete_slot() {
                self.judge(slot, emit);
                self.piece.published = true;
            }
        }
    }

    /// So many bytes of the stream were lost before they came here; the open piece is given up.
    pub fn handle_dropped(&mut self, bytes: u64) {
        self.abandon_piece();
        self.after_lone_first_byte = false;
        self.skip(bytes);
    }

    /// The stream has stopped: counts what was left open. The order is found anew by the next record.
    pub fn finish(&mut self) {
        self.abandon_piece();
        let cycle_len = self.bytes_before(self.slots.len());
        let records = self.damage * self.slots.len() as u64;
        self.counters.rejected += (records + cycle_len / 2).checked_div(cycle_len).unwrap_or(0);
        self.damage = 0;
        self.in_order = false;
    }

    fn skip(&mut self, bytes: u64) {
        self.damage += bytes;
        self.counters.bytes_skipped += bytes;
    }

    fn clear_piece(&mut self) {
        self.piece.bytes.clear();
        self.piece.len = 0;
        self.piece.published = false;
        self.hold_until = None;
    }

    fn abandon_piece(&mut self) {
        if !self.piece.published {
            self.skip(self.piece.len as u64);
        }
        self.clear_piece();
    }

    /// A first byte ends the open piece, whatever it is.
    fn close_piece(&mut self, emit: &mut impl FnMut(Event)) {
        let lone = self.piece.len == 1;
        match (self.piece.published, self.complete_slot()) {
            (false, Some(slot)) => {
                self.judge(slot, emit);
                self.clear_piece();
            }
            _ => {
                if let Some(address) = self.stranger() {
                    emit(Event::Stranger(address));
                }
                if let Some(address) = self.reshaped() {
                    emit(Event::Reshaped(address));
                }
                self.abandon_piece();
            }
        }
        self.after_lone_first_byte = lone;
    }

    /// The address at the end of the open piece, if no known bird's record could be damaged to this.
    fn stranger(&self) -> Option<u8> {
        let address = self.piece.address().filter(|_| self.damage == 0)?;
        let known = |slot: &Slot| !slot.shape.group || slot.address == address;
        (!self.slots.iter().chain(&self.absent).any(known)).then_some(address)
    }

    /// The bird at the end of the open piece, if its latest pieces were all as long as this one, which is no record of its.
    fn reshaped(&mut self) -> Option<u8> {
        let (address, len) = (self.piece.address()?, self.piece.len);
        let named = |slot: &&mut Slot| slot.shape.group && slot.address == address;
        let slot = self.slots.iter_mut().chain(&mut self.absent).find(named)?;
        let before = slot.misfits.filter(|(before, _)| *before == len).map_or(0, |(_, count)| count);
        let is_certain = before + 1 >= MISFITS_TO_RESHAPE;
        slot.misfits = (!is_certain).then_some((len, before + 1));
        is_certain.then_some(address)
    }

    /// The bird whose record the open, unpublished piece could be: by address and length only.
    fn complete_slot(&self) -> Option<BirdSlot> {
        if self.piece.published || self.piece.len == 0 || self.piece.len != self.piece.bytes.len() {
            return None;
        }
        let fits = |slot: &Slot| {
            slot.shape.len() == self.piece.len
                && (!slot.shape.group || self.piece.bytes.last() == Some(&slot.address))
        };
        (self.slots.iter().position(fits).map(BirdSlot::Running))
            .or_else(|| self.absent.iter().position(fits).map(BirdSlot::Absent))
    }

    /// Whether the complete piece goes on from its bird's last record without a jump in any word.
    fn continues(&self, place: BirdSlot) -> bool {
        let BirdSlot::Running(index) = place else { return false };
        let slot = &self.slots[index];
        let (Some(last), Ok(words)) = (slot.last, record::words(&self.piece.bytes, slot.shape)) else {
            return false;
        };
        last.iter().zip(words).all(|(a, b)| a.wrapping_sub(b).unsigned_abs() <= CONTINUES_WITHIN)
    }

    /// Accepts or refuses a piece of the right length, and moves on in the order either way.
    fn judge(&mut self, place: BirdSlot, emit: &mut impl FnMut(Event)) {
        let index = match place {
            BirdSlot::Running(index) => index,
            BirdSlot::Absent(index) => return self.sight(index, emit),
        };
        let (skipped, skipped_bytes) = self.skipped_records(index);
        let slack = if self.damage == 0 { 0 } else { SLACK_BYTES };
        let agrees = skipped_bytes.abs_diff(self.damage) <= slack;
        // Not a byte is missing or too many: the birds between did not speak. An address that a flipped bit made
        // would not go on where its bird left off.
        let agrees = agrees || (self.damage == 0 && self.continues(place));
        if self.damage > 0 {
            self.counters.rejected += skipped;
        } else if self.in_order && skipped > 0 {
            self.count_misses(index);
        }
        let after_loss = hides_losses(self.damage, skipped_bytes, self.piece.len as u64);
        let position = self.next as u64 + skipped;
        let birds = self.slots.len() as u64;
        let cycle = self.cycle + position / birds;
        self.next = (index + 1) % self.slots.len();
        self.cycle = cycle + u64::from(self.next == 0);
        self.damage = 0;

        let slot = &self.slots[index];
        let decoded = record::decode(&self.piece.bytes, slot.shape, self.scale, self.tolerance);
        let trusted = (agrees || !self.in_order) && !self.after_lone_first_byte;
        self.in_order = true;
        match decoded {
            Ok(decoded) if trusted => {
                self.counters.records += 1;
                let sample = Sample {
                    address: u16::from(slot.address),
                    arrival: Arrival {
                        t_read: self.piece.t_read,
                        t_previous_read: self.piece.t_previous_read,
                        bytes_after: self.piece.bytes_after,
                        cycle_bytes_before: self.bytes_before(index) as u32,
                        split: self.piece.split,
                        after_loss,
                    },
                    t_device: DeviceTime::Cycle(cycle),
                    measurement: Measurement::Pose {
                        position_m: decoded.position_m,
                        clipped: decoded.is_clipped(self.scale.range),
                        orientation_wxyz: decoded.orientation_wxyz,
                        button: decoded.button,
                    },
                };
                let words = record::words(&self.piece.bytes, slot.shape).ok();
                let slot = &mut self.slots[index];
                slot.last = words;
                slot.count = 0;
                slot.misfits = None;
                emit(Event::Sample(sample));
            }
            _ => {
                self.counters.rejected += 1;
                self.counters.bytes_skipped += self.piece.len as u64;
            }
        }
        self.let_go_of_silent_birds(emit);
    }

    /// How many records lie between the expected one and this slot's, as the damage says best, and how many bytes they have.
    fn skipped_records(&self, index: usize) -> (u64, u64) {
        let birds = self.slots.len();
        let to_slot = (index + birds - self.next) % birds;
        let partial: u64 = (0..to_slot).map(|i| self.slots[(self.next + i) % birds].shape.len() as u64).sum();
        let cycle_len = self.bytes_before(birds);
        let whole = whole_cycles(self.damage, partial, cycle_len);
        let skipped_bytes = partial + whole * cycle_len;
        (to_slot as u64 + whole * birds as u64, skipped_bytes)
    }

    /// Bytes of the first `count` records of a cycle.
    fn bytes_before(&self, count: usize) -> u64 {
        self.slots[..count].iter().map(|slot| slot.shape.len() as u64).sum()
    }

    /// Notes the birds between the expected one and `index` as silent, without damage to blame.
    fn count_misses(&mut self, index: usize) {
        let mut i = self.next;
        while i != index {
            self.slots[i].count = self.slots[i].count.saturating_add(1);
            i = (i + 1) % self.slots.len();
        }
    }

    fn let_go_of_silent_birds(&mut self, emit: &mut impl FnMut(Event)) {
        let Some(i) = self.slots.iter().position(|slot| slot.count >= MISSES_TO_LEAVE) else { return };
        let slot = self.slots.remove(i);
        emit(Event::Left(slot.address));
        if i < self.next {
            self.next -= 1;
        }
        if self.next == self.slots.len() {
            // It was the last of its cycle, which ends without it.
            self.next = 0;
            self.cycle += 1;
        }
        self.absent.push(Slot { count: 0, last: None, ..slot });
        self.in_order = false;
    }

    /// An absent bird's record: it is put back after a few of them.
    fn sight(&mut self, index: usize, emit: &mut impl FnMut(Event)) {
        self.counters.rejected += 1;
        self.counters.bytes_skipped += self.piece.len as u64;
        self.absent[index].count += 1;
        if self.absent[index].count < SIGHTINGS_TO_RETURN {
            return;
        }
        let slot = Slot { count: 0, ..self.absent.remove(index) };
        emit(Event::Returned(slot.address));
        let at = self.slots.partition_point(|other| other.address < slot.address);
        let was_closed = self.next == 0;
        // Before the bird that spoke last: of the next cycle, and the rest of this one is missing.
        self.cycle += u64::from(at < self.next);
        self.slots.insert(at, slot);
        self.next = (at + 1) % self.slots.len();
        // The last running bird has closed the cycle of one that comes after it.
        self.cycle += u64::from(self.next == 0 && !was_closed);
        self.in_order = true;
    }
}

/// Where a bird is listed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum BirdSlot {
    Running(usize),
    Absent(usize),
}
