//! The `posed` binary: the command line over the crates.

#![allow(rustdoc::broken_intra_doc_links, reason = "help texts name tables of the stage file in brackets")]

mod commands;
mod pictures;

fn main() -> std::process::ExitCode {
    commands::main()
}
