//! Integration tests: one binary, one module per subject.

#[path = "../rig/mod.rs"]
mod rig;

mod acceptance;
mod cli;
mod pipeline;
mod reference;
mod server;
mod stages;
