//! Integration tests: one binary, one module per subject.

#![expect(clippy::unwrap_used, reason = "helpers of tests may panic")]

mod acceptance;
mod cli;
mod keyframes;
mod motion_commands;
mod pipeline;
mod reference;
#[path = "../rig/mod.rs"]
mod rig;
mod server;
mod simulated;
mod stages;
