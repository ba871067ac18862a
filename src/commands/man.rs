//! `posed man FOLDER`: the manual pages, one per command.

use std::path::PathBuf;

use super::{Error, print};

/// Where to write them.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed man ~/.local/share/man/man1")]
pub(crate) struct Args {
    /// A folder; it is made if it is not there.
    folder: PathBuf,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let failed = |error| Error::file("write manual pages to", &args.folder, &error);
    std::fs::create_dir_all(&args.folder).map_err(failed)?;
    clap_mangen::generate_to(super::command(), &args.folder).map_err(failed)?;
    print(&format!("wrote the manual pages to {}\n", args.folder.display()))
}
