//! `posed demo`: a simulated stage, the daemon and the page in one process.

use std::net::SocketAddr;
use std::path::PathBuf;

/// The stage that is built in.
const STAGE: &str = include_str!("../../config/demo.toml");

/// What to show.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed demo\n\nThen open the address that it prints; Ctrl-C ends it.")]
pub(crate) struct Args {
    /// Address for the page and the websocket.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8787")]
    listen: SocketAddr,
    /// Simulate another stage file than the one that is built in.
    #[arg(long, value_name = "STAGE.toml")]
    stage: Option<PathBuf>,
    /// Record everything that comes in, from the first byte on.
    #[arg(long, value_name = "REC.mcap")]
    record: Option<PathBuf>,
}
