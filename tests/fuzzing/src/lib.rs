//! What the fuzz targets run: everything that comes from outside, taken as it is taken in service.
//!
//! In: any bytes. Out: nothing; a fault is a panic, an abort for too much memory, or a time-out. `fuzz/` has a program per target for
//! `cargo fuzz`, `fuzz/corpus/` the inputs, which also run as a test (`tests/corpora.rs`); `cargo run -p posed-fuzzing` writes those
//! of them that are made rather than found. What must hold for each target stands with it, and in `docs/fault-tolerance.md`.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "here a fault is a panic")]

mod files;
mod log;
mod mesh;
mod messages;
mod model;
mod network;
mod recording;
pub mod seeds;
mod snapshot;
mod stage_file;
mod stand;
mod tables;
mod timecode;

use posed_drivers::fuzzing as drivers;
use posed_rig::counting::{Counting, within};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What one input may have live at once, bytes.
const BUDGET: i64 = 256 << 20;
/// A network within its own limit, 256 MiB of numbers, beside its file, its copy in the log and what is computed from it.
const NETWORK_BUDGET: i64 = 1 << 30;

/// Something that takes bytes from outside.
pub struct Target {
    /// Its name, and that of its corpus.
    pub name: &'static str,
    /// What it may have live at once, bytes.
    pub budget: i64,
    run: fn(&[u8]),
}

/// All of them.
pub const TARGETS: &[Target] = &[
    target("flock", |data| _ = drivers::flock(data)),
    target("xbus", |data| _ = drivers::xbus(data)),
    target("x_imu3", |data| _ = drivers::x_imu3(data)),
    target("fastrak", |data| _ = drivers::fastrak(data)),
    target("motionstar", |data| _ = drivers::motionstar(data)),
    target("open_imu", |data| _ = drivers::open_imu(data)),
    target("polhemus", |data| _ = drivers::polhemus(data)),
    target("slimevr", |data| _ = drivers::slimevr(data)),
    target("vrpn", |data| _ = drivers::vrpn(data)),
    target("witmotion", |data| _ = drivers::witmotion(data)),
    target("client_message", messages::client),
    target("foxglove_viewer", posed_protocol::foxglove::fuzz_viewer),
    target("vrpn_client", posed_protocol::vrpn::fuzz_client),
    target("mesh_message", mesh::message),
    target("model", model::model),
    Target { budget: NETWORK_BUDGET, ..target("segmentation_network", network::network) },
    target("snapshot", snapshot::snapshot),
    target("recording", recording::recording),
    target("tables", tables::tables),
    target("stage_file", stage_file::stage_file),
    target("timecode", timecode::timecode),
];

const fn target(name: &'static str, run: fn(&[u8])) -> Target {
    Target { name, budget: BUDGET, run }
}

impl Target {
    /// Gives it an input.
    ///
    /// # Panics
    /// It has found a fault.
    pub fn run(&self, data: &[u8]) {
        within(self.budget, || (self.run)(data));
    }
}

/// Gives an input to the target of that name.
///
/// # Panics
/// There is none, or it has found a fault.
pub fn run(name: &str, data: &[u8]) {
    TARGETS.iter().find(|target| target.name == name).expect("a target").run(data);
}
