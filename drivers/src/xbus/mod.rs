//! Xbus: Xsens MTi, MTx and MTi-G trackers, and the Xbus Master with its chain of trackers.
//!
//! What comes in: bytes, and the settings of the stage file. What goes out: samples of every tracker
//! , or the decoded records of a capture ([`capture`]). It never claims an Awinda station:
//! the radio protocol is not public.
//!
//! [`frame`] finds messages in a byte stream, [`message`] names them, [`mtdata2`] and [`mtdata`] are the
//! two kinds of data message, [`number`] the number formats that both use.

pub mod capture;
pub mod counter;
pub mod frame;
pub mod message;
pub mod mtdata;
pub mod mtdata2;
pub mod number;
mod orientation;

pub use frame::{Frame, Framer};
