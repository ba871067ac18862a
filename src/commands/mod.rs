//! The command line: one file per command, one line per command in [`Command`].
//!
//! What comes in: arguments. What goes out: the answer on stdout (with `--json` one JSON object on one
//! line), everything else on stderr, and an exit code: 0 done, 1 failed, 2 wrong use. What a command never
//! does: panic on bad input, leave a half-written file behind, mix log lines into its answer.
//!
//! The convention of a command's file:
//!
//! ```text
//! #[derive(clap::Args)]
//! #[command(after_help = "Example:\n  posed check stage.toml")]
//! pub(crate) struct Args { .. }
//!
//! pub(crate) fn run(args: Args) -> Result<(), Error> { .. }
//! ```
//! A command whose answer itself is bad news (problems found, nothing answered) prints it and returns
//! [`Error::Reported`]. Answers go through [`print()`] and [`print_json`], which know a closed pipe.

mod body;
mod check;
mod completions;
mod decode;
mod demo;
mod doctor;
mod end;
mod exercise;
mod export;
mod faults;
mod field;
#[cfg(test)]
mod handbook;
mod hub;
mod imu;
mod imus;
mod info;
mod keyframes;
mod man;
mod number;
mod orient;
mod output;
mod progress;
mod reading;
mod recorded;
#[cfg(test)]
mod rehearsal;
mod replay;
mod replay_pty;
mod run;
mod schema;
mod segments;
mod service;
mod session;
mod simulate;
mod simulation;
mod timecode;
mod watch;

use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::prelude::*;

/// Live motion tracking: magnetic trackers in, filtered poses out.
#[derive(Parser)]
#[command(name = "posed", version, arg_required_else_help = true, subcommand_required = true)]
#[command(after_help = "Exit codes: 0 done, 1 failed, 2 wrong use.\n\n\
    Example:\n  posed completions bash > ~/.local/share/bash-completion/completions/posed")]
struct Cli {
    /// What to log on stderr: `error`, `warn`, `info`, `debug`, `trace`, or a filter such as
    /// `info,posed_drivers=trace`.
    #[arg(long, global = true, env = "POSED_LOG", default_value = "info", value_name = "FILTER")]
    log: String,
    #[command(subcommand)]
    command: Command,
}

/// Every command that works, in the order of a first day with the program.
#[derive(Subcommand)]
enum Command {
    /// Runs a simulated stage, the daemon and the page in one process.
    Demo(demo::Args),
    /// Runs the daemon on a stage's devices.
    Run(run::Args),
    /// Shows the stages of many machines on one page and one websocket.
    Hub(hub::Args),
    /// Says all that is wrong with a stage file, by line and key, and how to fix it.
    Check(check::Args),
    /// Runs the virtual devices of a stage on pseudo-terminals, and prints their ports.
    Simulate(simulate::Args),
    /// Lists the serial ports, asks what is there, and reports what is wrong.
    Doctor(doctor::Args),
    /// Plays a recording through the same pipeline: to the websocket, to a file, or against one.
    Replay(replay::Args),
    /// Decodes a capture made elsewhere to CSV, JSON lines or a recording.
    Decode(decode::Args),
    /// Learns exercises from a few repetitions, and counts them.
    Exercise(exercise::Args),
    /// Shows who trained what, when and how well: lists, reports, exports.
    Session(session::Args),
    /// Learns and finds faulty frames of magnetic sensors.
    Faults(faults::Args),
    /// Finds the frames at which a motion changes, and a smooth path between them.
    Keyframes(keyframes::Args),
    /// Learns what the frames of a motion show, and names them.
    Segments(segments::Args),
    /// Reports what is inside a recording, and completes one that breaks off.
    Info(info::Args),
    /// Finds time code in a sound file or a recording, where the two lie together, and claps.
    Timecode(timecode::Args),
    /// Writes a recording's poses or messages to a file that other programs open.
    Export(export::Args),
    /// Orientation of single IMUs from a file of samples.
    Orient(orient::Args),
    /// Intrinsics of an IMU from a recording of rests.
    Imu(imu::Args),
    /// Joint angles and body pose from a recording of IMUs, and how the sensors of a running daemon sit.
    Body(body::Args),
    /// Calibrates the field with a moving calibration pole (wand), corrects poses, draws the map.
    Field(field::Args),
    /// Writes the completion script of a shell.
    Completions(completions::Args),
    /// Writes the manual pages.
    Man(man::Args),
    /// Prints the JSON Schema of all websocket messages.
    Schema(schema::Args),
}

impl Command {
    fn run(self) -> Result<(), Error> {
        match self {
            Self::Demo(args) => demo::run(args),
            Self::Run(args) => run::run(args),
            Self::Hub(args) => hub::run(args),
            Self::Replay(args) => replay::run(args),
            Self::Check(args) => check::run(args),
            Self::Simulate(args) => simulate::run(args),
            Self::Doctor(args) => doctor::run(args),
            Self::Decode(args) => decode::run(args),
            Self::Exercise(args) => exercise::run(args),
            Self::Session(args) => session::run(args),
            Self::Faults(args) => faults::run(args),
            Self::Keyframes(args) => keyframes::run(args),
            Self::Segments(args) => segments::run(args),
            Self::Info(args) => info::run(args),
            Self::Timecode(args) => timecode::run(args),
            Self::Export(args) => export::run(args),
            Self::Orient(args) => orient::run(args),
            Self::Imu(args) => imu::run(args),
            Self::Body(args) => body::run(args),
            Self::Field(args) => field::run(args),
            Self::Completions(args) => completions::run(args),
            Self::Man(args) => man::run(args),
            Self::Schema(args) => schema::run(args),
        }
    }
}

/// Why a command ended other than well.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
    /// The work failed; the sentence states what and what to do about it. Exit code 1.
    #[error("{0}")]
    Failed(String),
    /// The command was asked for something that makes no sense. Exit code 2.
    #[error("{0}")]
    Usage(String),
    /// The work failed, and the answer on stdout already says so. Exit code 1.
    #[error("failed")]
    Reported,
    /// Nobody reads stdout any more, which is the reader's good right. Exit code 0, no word.
    #[error("nobody reads the output")]
    BrokenPipe,
}

impl Error {
    /// A failure from anything that can say what is wrong.
    pub(crate) fn failed(reason: impl std::fmt::Display) -> Self {
        Self::Failed(reason.to_string())
    }

    /// A failure of a file: what was tried, with which file, and what the system said.
    ///
    /// For example `cannot read stage.toml: No such file or directory (os error 2)`.
    pub(crate) fn file(tried: &str, path: &std::path::Path, error: &io::Error) -> Self {
        Self::Failed(format!("cannot {tried} {}: {error}", path.display()))
    }
}

/// Parses the arguments, runs the command, and reports the exit code.
pub(crate) fn main() -> ExitCode {
    #[cfg(feature = "zenoh")]
    hub::prepare();
    let cli = Cli::parse();
    let result = start_log(&cli.log).and_then(|log| {
        let result = cli.command.run();
        // What was logged comes before how it ended.
        drop(log);
        result
    });
    let (code, error) = match result {
        Ok(()) | Err(Error::BrokenPipe) => return ExitCode::SUCCESS,
        Err(Error::Reported) => return ExitCode::from(1),
        Err(error @ Error::Failed(_)) => (1, error),
        Err(error @ Error::Usage(_)) => (2, error),
    };
    notify(&format!("posed: {error}"));
    ExitCode::from(code)
}

/// Log lines that may wait for who reads them.
const LOG_LINES: usize = 1 << 14;

/// Sends log lines to stderr, coloured where a person reads them, until what it returns is dropped. A thread writes them, so that a
/// pipe that nobody reads makes no one wait; what does not fit into its queue is left out.
fn start_log(filter: &str) -> Result<WorkerGuard, Error> {
    let filter: Targets = filter.parse().map_err(|error| {
        Error::Usage(format!("--log {filter}: {error}; give a level such as `info` or `warn,posed=debug`"))
    })?;
    let (stderr, written) =
        NonBlockingBuilder::default().buffered_lines_limit(LOG_LINES).thread_name("log").finish(io::stderr());
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(stderr)
        .with_ansi(io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none())
        .with_target(false);
    let log = tracing_subscriber::registry().with(filter);
    // The journal has the time already.
    match std::env::var_os("JOURNAL_STREAM") {
        Some(_) => log.with(lines.without_time()).init(),
        None => log.with(lines).init(),
    }
    Ok(written)
}

/// Prints a piece of the answer on stdout, as it is.
pub(crate) fn print(text: &str) -> Result<(), Error> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()).map_err(|error| match error.kind() {
        io::ErrorKind::BrokenPipe => Error::BrokenPipe,
        _ => Error::Failed(format!("cannot write to stdout: {error}")),
    })
}

/// Prints an answer for programs: one JSON object on one line of stdout.
pub(crate) fn print_json(answer: &impl serde::Serialize) -> Result<(), Error> {
    let mut line = serde_json::to_string(answer).map_err(Error::failed)?;
    line.push('\n');
    print(&line)
}

/// Says something to the person at the terminal that is no part of the answer, on stderr.
pub(crate) fn notify(sentence: &str) {
    // Nothing is lost with it where even stderr is gone.
    let _ = writeln!(io::stderr(), "{sentence}");
}

/// The whole command line, for completions.
fn command() -> clap::Command {
    Cli::command()
}

#[cfg(test)]
mod tests {
    /// Clap checks names, defaults and conflicts of all commands, and every command shows an example.
    #[test]
    fn the_command_line_is_sound_and_shows_examples() {
        let command = super::command();
        command.clone().debug_assert();
        for subcommand in command.get_subcommands() {
            let help = subcommand.get_after_help().map(ToString::to_string).unwrap_or_default();
            let example = format!("posed {}", subcommand.get_name());
            assert!(help.contains("Example") && help.contains(&example), "{example} has no example");
            assert!(subcommand.get_about().is_some(), "{example} does not say what it does");
        }
    }
}
