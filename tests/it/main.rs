//! Integration tests: one binary, one module per subject.

#![expect(clippy::unwrap_used, reason = "helpers of tests may panic")]

mod cli;
mod reference;
mod server;
mod simulated;
mod stages;
