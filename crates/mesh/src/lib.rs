//! More than one machine, over zenoh: a stage's end of it, and the hub that follows many stages.
//!
//! ```text
//! distributor ── Feed ──┐ bounded          ┌──> KEY/feed/*, KEY/topics/*   hubs, other programs
//! fusion thread ── Log ─┴─> own threads ───┼──> KEY/log                    fusion on another machine
//!                                          └──> answers: KEY/status, KEY/recordings/**, KEY/ask/*
//! ```
//! A third end, [`publish_ros2`], has poses, joint angles and measurements for programs of ROS 2, by a session of its own.
//!
//! In: what a stage publishes, with its stamps, and the entries of its input log, by [`connect`] in
//! [`posed_daemon::Options::link`]. Out: the same under the stage's key. What is published is kept for a while and numbered, so
//! that who has missed something asks for it. [`Hub`] takes it on another machine and shows it. Never: a wait of the fusion
//! thread or of the distributor, or a change at a stage by another machine.

mod answers;
mod certificates;
mod feed;
mod frame;
mod hub;
mod input_log;
mod link;
mod links;
mod obstacle;
mod ros2;
mod session;
mod twins;
mod wire;
mod wishes;

pub use self::certificates::{AUTHORITY, CertificatesError, write_certificates};
pub use self::hub::{Hub, HubError, HubOptions};
pub use self::link::connect;
pub use self::ros2::publish_ros2;
pub use self::session::LinkError;
/// zenoh, of the version that stages and hubs speak.
pub use zenoh;
