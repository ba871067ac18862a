//! `posed replay REC.mcap`: a recording through the same pipeline.

use std::net::SocketAddr;
use std::path::PathBuf;

/// What to replay, how fast, and where to.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed replay take-1.mcap\n  \
    posed replay take-1.mcap --speed max -o messages.jsonl\n  \
    posed replay take-1.mcap --speed max --expect golden.jsonl\n\n\
    Without -o, --expect and --pty the messages go to the websocket. Exit code 1 if a message differs.")]
pub(crate) struct Args {
    /// The recording.
    recording: PathBuf,
    /// How fast: 1 is as it was, max as fast as this machine can.
    #[arg(long, default_value = "1", value_enum)]
    speed: Speed,
    /// Write the messages to a file, one JSON object on each line.
    #[arg(short, long, value_name = "OUT.jsonl")]
    output: Option<PathBuf>,
    /// Process it anew with another stage file; devices are matched by name.
    #[arg(long, value_name = "STAGE.toml")]
    stage: Option<PathBuf>,
    /// Compare with the messages of this file, and name the first one that differs.
    #[arg(long, value_name = "GOLDEN.jsonl")]
    expect: Option<PathBuf>,
    /// Serve the recorded bytes on pseudo-terminals instead, for other programs to read.
    #[arg(long, conflicts_with_all = ["output", "stage", "expect"])]
    pty: bool,
    /// Address for the page and the websocket.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8787")]
    listen: SocketAddr,
    /// Print the result as one JSON object.
    #[arg(long)]
    json: bool,
}

/// How fast to replay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Speed {
    #[value(name = "1")]
    Real,
    #[value(name = "4")]
    FourTimes,
    Max,
}
