//! Integration tests: one binary, one module per subject.

#[path = "../rig/mod.rs"]
mod rig;

mod pipeline;
