//! Integration tests: one binary, one module per subject.

mod cli;
mod inertial;
mod reference;
mod stages;
