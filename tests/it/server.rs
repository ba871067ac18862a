//! The websocket server with real clients.

mod access;
mod feed;
mod harness;
mod limits;
