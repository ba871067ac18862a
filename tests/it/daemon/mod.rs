//! The daemon as its users see it: real processes, pseudo-terminals, sockets and files.
//!
//! Nothing here asserts how fast something is; waits are generous and end with a line number.

mod body;
mod connections;
mod environment;
mod exercises;
mod faults;
mod library;
mod parts;
pub(crate) mod phones;
mod plug;
pub(crate) mod process;
mod recordings;
mod replay;
mod run;
mod segments;
mod service;
mod sessions;
pub(crate) mod setup;
mod takes;
mod timecode;
