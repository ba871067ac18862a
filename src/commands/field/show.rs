//! `posed field show`.

use std::path::PathBuf;

use posed_field::svg;

use super::{Error, notify, output, read_map};

/// A map, and where to draw it.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed field show field.json -o field.svg")]
pub(crate) struct Args {
    /// The map.
    field: PathBuf,
    /// The picture, `.svg`.
    #[arg(short, long, value_name = "SVG")]
    output: PathBuf,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    if args.output.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("svg")) {
        return Err(Error::Usage(format!("the picture {} must end in .svg", args.output.display())));
    }
    let map = read_map(&args.field)?;
    output::replace(&args.output, |file| file.write_all(svg(&map).as_bytes()))?;
    notify(&format!("wrote {}", args.output.display()));
    Ok(())
}
