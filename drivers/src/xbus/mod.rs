//! Xbus: Xsens MTi, MTx and MTi-G trackers, and the Xbus Master with its chain of trackers.
//!
//! ```text
//! bytes ─> Framer ─> Setup (what is there? make it so) ─> Stream ─> Sample      XbusSession
//! file  ─> Framer ─> capture ─> records
//! ```
//! [`frame`] finds messages in a byte stream, [`message`] names them, [`mtdata2`] and [`mtdata`] are the
//! two kinds of data message, [`number`] the number formats of both. It never claims an Awinda station or
//! MTw radio sets: their protocol is not public.

pub mod capture;
pub mod counter;
pub mod frame;
pub mod message;
pub mod mtdata;
pub mod mtdata2;
pub mod number;
mod orientation;
pub mod probe;
pub mod session;
mod settings;
mod setup;
mod stream;

pub use frame::{Frame, Framer};
pub use session::XbusSession;
pub use settings::{Sampling, Settings};
