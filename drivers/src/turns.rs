//! What is lost of sensors that send in turn and do not count: by their order, by the bytes of no record, and by time.
//!
//! What comes in: which sensor's record has come, when, and how many bytes were none until then. What goes out: the number of its cycle,
//! whether that is in doubt, and the losses. Of bytes that never came, whole cycles leave no trace but time, and are counted once that
//! has passed: too late for the number of a cycle, which the clock puts right by itself where it knows that there is doubt.

use posed_state::Plain;

use crate::arrivals::{hides_losses, whole_cycles};
use crate::debt::Debt;
use crate::sample::Timestamp;
use crate::session::Loss;

/// See the module.
#[derive(Clone, Debug, Plain)]
pub(crate) struct Turns {
    losses: Vec<Loss>,
    cycle: u64,
    /// Index of the sensor whose record is due.
    due: usize,
    last_record: Option<Timestamp>,
    debt: Debt,
    /// The stream has been started anew since the last record.
    started: bool,
    /// Bytes of no record, until the last one.
    skipped_before: u64,
    /// By sensor: bytes were lost since its last record, and nobody knows how many.
    after_loss: Vec<bool>,
}

impl Turns {
    /// Of sensors at these addresses, in the order in which they send.
    pub(crate) fn new(addresses: impl Iterator<Item = u16>) -> Self {
        let losses: Vec<Loss> = addresses.map(|address| Loss { address, ..Loss::default() }).collect();
        Self {
            cycle: 0,
            due: 0,
            last_record: None,
            debt: Debt::default(),
            started: false,
            skipped_before: 0,
            after_loss: vec![false; losses.len()],
            losses,
        }
    }

    /// The stream begins anew, with the first sensor.
    pub(crate) fn start(&mut self) {
        self.due = 0;
        self.started = true;
    }

    /// The record of sensor `index` has come, of `len` bytes; `skipped` bytes were none up to here, and all sensors together send
    /// `nominal_hz` records per second at most.
    pub(crate) fn record(&mut self, now: Timestamp, index: usize, len: u64, skipped: u64, nominal_hz: f64) {
        let elapsed_s = self.last_record.replace(now).map_or(0.0, |last| now.seconds_since(last));
        let sensors = self.losses.len();
        if std::mem::take(&mut self.started) {
            self.debt.forgive();
            let missed = (elapsed_s * nominal_hz / sensors as f64).round() as u64;
            self.lose_cycles(missed.saturating_sub(1));
            self.due = index;
            self.skipped_before = skipped;
        }
        let damaged = skipped - std::mem::replace(&mut self.skipped_before, skipped);
        let to_index = (index + sensors - self.due) % sensors;
        let whole = whole_cycles(damaged, to_index as u64 * len, sensors as u64 * len);
        let passed = to_index as u64 + whole * sensors as u64;
        if hides_losses(damaged, passed.saturating_mul(len), len) {
            self.after_loss.fill(true);
        }
        self.cycle += whole;
        self.lose_cycles(whole);
        for _ in 0..to_index {
            self.losses[self.due].lost += 1;
            self.losses[self.due].estimated = true;
            self.step();
        }
        let cycles = self.debt.record(now, passed, sensors, nominal_hz);
        self.lose_cycles(cycles);
        self.step();
    }

    /// The record of sensor `index` is not used after all; `skipped` has its bytes now.
    pub(crate) fn refuse(&mut self, index: usize, skipped: u64) {
        self.skipped_before = skipped;
        self.losses[index].lost += 1;
    }

    /// Number of the present cycle.
    pub(crate) fn cycle(&self) -> u64 {
        self.cycle
    }

    /// Whether that number is in doubt for the sensor; asked once for each of its records.
    pub(crate) fn take_doubt(&mut self, index: usize) -> bool {
        std::mem::take(&mut self.after_loss[index])
    }

    pub(crate) fn losses(&self) -> &[Loss] {
        &self.losses
    }

    fn lose_cycles(&mut self, cycles: u64) {
        for loss in &mut self.losses {
            loss.lost += cycles;
            loss.estimated |= cycles > 0;
        }
    }

    fn step(&mut self) {
        self.due += 1;
        if self.due == self.losses.len() {
            self.due = 0;
            self.cycle += 1;
        }
    }
}
