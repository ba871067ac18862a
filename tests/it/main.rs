//! Integration tests: one binary, one module per subject.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests may panic and tell what they measured"
)]

mod acceptance;
mod align_live;
mod architecture;
mod boards;
mod body;
mod body_live;
mod browser;
mod captures;
mod chain_live;
#[path = "../chromium/mod.rs"]
mod chromium;
mod cli;
mod daemon;
mod digests;
mod exercise;
mod exports;
mod faults;
mod faults_live;
mod field;
mod field_live;
mod field_real;
mod field_session;
mod handbook;
#[cfg(feature = "zenoh")]
mod hub;
mod imu_live;
mod inertial;
mod keyframes;
mod keyframes_live;
mod motion_commands;
mod open_imu_live;
mod packaging;
mod pipeline;
mod python;
mod recipes;
mod reference;
#[cfg(feature = "zenoh")]
mod ros2;
mod segments;
mod server;
mod sessions;
mod several_people;
mod simulated;
mod stages;
mod supply;
mod trainer;
mod typescript;
