//! `posed`: a live motion tracking daemon, as a library.
//!
//! ```text
//! bytes -> drivers -> Sample -> clock -> Frame -> faults -> fusion -> Estimate -> clients
//! ```
//! The core is one plain struct that is pushed entries of the input log and says outputs; it has no clock,
//! no thread and no randomness. The daemon around it owns ports, threads, sockets, files and time.

pub mod animation;
pub mod atomic_file;
pub mod clock;
pub mod daemon;
pub mod faults;
pub mod field;
pub mod foxglove;
pub mod frame;
pub mod fusion;
pub mod geometry;
pub mod input;
pub mod layout;
pub mod lsl;
pub mod motion;
pub mod name;
pub mod noise;
pub mod output;
pub mod pipeline;
pub mod protocol;
pub mod recording;
pub mod signals;
pub mod stage;
pub mod svg;
pub mod table;
pub mod vmc;
pub mod vrpn;
