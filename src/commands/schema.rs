//! `posed schema`: the contract with clients.

use posed_protocol::schema;

use super::{Error, print};

/// What to print.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  posed schema > posed.v1.schema.json\n  posed schema --typescript > posed.v1.ts"
)]
pub(crate) struct Args {
    /// TypeScript types instead of JSON Schema.
    #[arg(long)]
    typescript: bool,
    /// Print one JSON object on one line.
    #[arg(long, conflicts_with = "typescript")]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    if args.json {
        super::print_json(&schema::json_schema())
    } else if args.typescript {
        print(&schema::typescript())
    } else {
        print(&schema::json_schema_text())
    }
}
