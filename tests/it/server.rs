//! The websocket server with real clients.
#![expect(clippy::unwrap_used, reason = "helpers of tests")]

mod access;
mod feed;
mod foxglove;
pub(crate) mod harness;
mod limits;
mod outputs;
mod vrpn;
