//! State that is put away and goes on.
//!
//! What comes in: any value made of plain data. What goes out: bytes, little-endian and in the order of the fields, with a fingerprint
//! of the layout in front and their sum behind; and the same value again. What it never does: read bytes of another layout or ones
//! that have changed, trust a length with memory, make code for more than one format.
//!
//! The sum finds damage, not malice: whoever forges a snapshot with its sum makes a value that no program would have made.
//!
//! A [`Plain`] is written and read whole. A [`State`] is read in place: what made it has put its parameters and models there
//! (`#[state(keep)]`), and only what changed since comes from the bytes. What must be as it was, like the name of a part, is written
//! too and compared (`#[state(same)]`). Every value is a state.
//!
//! ```
//! use posed_state::{State, Plain, restore, snapshot};
//!
//! #[derive(Plain)]
//! struct Estimate {
//!     angle_rad: f64,
//!     variance_rad2: f64,
//! }
//!
//! #[derive(State)]
//! struct Filter {
//!     /// From the stage file.
//!     #[state(keep)]
//!     noise_rad: f64,
//!     estimate: Estimate,
//! }
//!
//! let new = || Filter { noise_rad: 0.1, estimate: Estimate { angle_rad: 0.0, variance_rad2: 1.0 } };
//! let mut filter = new();
//! filter.estimate.angle_rad = 0.5;
//! let bytes = snapshot(&filter);
//!
//! let mut again = new();
//! restore(&mut again, &bytes)?;
//! assert_eq!(again.estimate.angle_rad, 0.5);
//! # Ok::<(), posed_state::Damaged>(())
//! ```

// So that the derived code finds this crate in its own tests.
extern crate self as posed_state;

pub mod layout;
mod reader;
mod values;
mod writer;

pub use posed_state_derive::{Plain, State};
pub use reader::{Damaged, Reader};
pub use writer::Writer;

/// Plain data that is written and read whole. Derive it; every field must be [`Plain`].
pub trait Plain: Sized {
    /// Fingerprint of what is written: names of types and fields, in order. It does not depend on values.
    const LAYOUT: u64;

    /// Appends the value, without the fingerprint.
    fn save(&self, to: &mut Writer);

    /// Takes a value, and leaves the reader behind it.
    ///
    /// # Errors
    /// The bytes end, or hold what is no such value. What was taken until then is lost.
    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged>;
}

/// What is read in place of what is already there. Derive it; fields with `#[state(keep)]` are neither written nor read.
pub trait State {
    /// Fingerprint of what is written, as [`Plain::LAYOUT`]; kept fields are no part of it.
    const LAYOUT: u64;

    /// Appends what changes while it runs, without the fingerprint.
    fn save_state(&self, to: &mut Writer);

    /// Takes what was saved. After an error part of it is taken: throw the value away.
    ///
    /// # Errors
    /// The bytes end, hold what is no such state, or that of a value with more or fewer parts.
    fn load_state(&mut self, from: &mut Reader<'_>) -> Result<(), Damaged>;
}

impl<T: Plain> State for T {
    const LAYOUT: u64 = T::LAYOUT;

    fn save_state(&self, to: &mut Writer) {
        Plain::save(self, to);
    }

    fn load_state(&mut self, from: &mut Reader<'_>) -> Result<(), Damaged> {
        *self = T::read(from)?;
        Ok(())
    }
}

/// A state as bytes, little-endian: eight of the fingerprint, then the state, then eight of the sum of all these. The same state gives the same bytes on every machine.
pub fn snapshot<T: State>(state: &T) -> Vec<u8> {
    let mut writer = Writer::default();
    writer.word(T::LAYOUT);
    state.save_state(&mut writer);
    writer.seal();
    writer.into_bytes()
}

/// Puts a [`snapshot`] in place of `state`, which must have been made from the same parameters: those are not in the bytes.
///
/// # Errors
/// The bytes are damaged, too many, or of another layout. After [`Damaged::OtherLayout`] and [`Damaged::Changed`] `state` is as it
/// was; after any other error throw it away.
pub fn restore<T: State>(state: &mut T, bytes: &[u8]) -> Result<(), Damaged> {
    if Reader::new(bytes).word()? != T::LAYOUT {
        return Err(Damaged::OtherLayout);
    }
    let mut reader = Reader::unsealed(bytes)?;
    reader.word()?;
    state.load_state(&mut reader)?;
    reader.end()
}
