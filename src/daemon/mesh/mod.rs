//! More than one machine: a stage's end of it, over zenoh.
//!
//! ```text
//! distributor ── Feed ──┐ bounded          ┌──> KEY/feed/*, KEY/topics/*   hubs, other programs
//! fusion thread ── Log ─┴─> own threads ───┼──> KEY/log                    fusion on another machine
//!                                          └──> answers: KEY/status, KEY/recordings/**, KEY/ask/*
//! ```
//! In: what is published, with its stamps, and the entries of the input log. Out: the same under the stage's key. What is
//! published is kept for a while and numbered, so that who has missed something asks for it. Never: a wait of the
//! fusion thread or of the distributor. Everything here needs the feature `zenoh`; without it, [`Mesh::start`] says so.

#[cfg(not(feature = "zenoh"))]
mod absent;
#[cfg(feature = "zenoh")]
mod answers;
#[cfg(feature = "zenoh")]
mod feed;
#[cfg(feature = "zenoh")]
mod log;
#[cfg(feature = "zenoh")]
pub(super) mod session;
#[cfg(feature = "zenoh")]
mod stage;
#[cfg(feature = "zenoh")]
mod twins;
#[cfg(feature = "zenoh")]
pub(super) mod wire;

#[cfg(not(feature = "zenoh"))]
pub(super) use self::absent::{Begin, Feed, Log, Mesh};
#[cfg(feature = "zenoh")]
pub(super) use self::feed::Feed;
#[cfg(feature = "zenoh")]
pub(super) use self::log::Log;
#[cfg(feature = "zenoh")]
pub(super) use self::stage::Mesh;
#[cfg(feature = "zenoh")]
pub(super) use self::wire::Begin;

/// What is said where the program cannot do it.
#[cfg(not(feature = "zenoh"))]
pub(super) const ABSENT: &str = "[zenoh]: this posed was built without zenoh; install the packaged one, or build it with `--features zenoh`";
