//! `posed completions SHELL`: the completion script of a shell, on stdout.

use super::{Error, print};

/// What to write.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed completions bash > ~/.local/share/bash-completion/completions/posed"
)]
pub(crate) struct Args {
    /// The shell that is to learn the commands.
    shell: clap_complete::Shell,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut super::command(), "posed", &mut script);
    print(&String::from_utf8_lossy(&script))
}
