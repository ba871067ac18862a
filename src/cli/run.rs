//! `posed run STAGE.toml`: the daemon on the stage's own devices.

use std::net::SocketAddr;
use std::path::PathBuf;

/// What to run.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed run stage.toml\n  posed run stage.toml --record take-1.mcap\n\n\
    Ctrl-C or SIGTERM ends it within 5 s with exit code 0.")]
pub(crate) struct Args {
    /// The stage file; `posed check` says whether it is right, `posed doctor --write-stage` writes a first one.
    stage: PathBuf,
    /// Record everything that comes in, from the first byte on.
    #[arg(long, value_name = "REC.mcap")]
    record: Option<PathBuf>,
    /// Address for the page and the websocket, in place of the stage's; anything but loopback needs a token in the stage.
    #[arg(long, value_name = "HOST:PORT")]
    listen: Option<SocketAddr>,
}
