//! Integration tests: one binary, one module per subject.

mod cli;
mod reference;
mod simulated;
mod stages;
