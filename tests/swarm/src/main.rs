//! `cargo run --profile swarm -p posed-swarm -- --seed 0 --count 1000`: see the library.

use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use clap::Parser;
use posed_swarm::{described, minimised, run_all, run_traced};

/// Runs random stages in virtual time and tells which seeds fail.
#[derive(Parser)]
struct Arguments {
    /// First seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// How many seeds.
    #[arg(long, default_value_t = 1)]
    count: u64,
    /// Simulated minutes of a seed that has faults until the end of their time; others are shorter.
    #[arg(long, default_value_t = 0.6)]
    minutes: f64,
    /// Parts of the seed to leave out.
    #[arg(long, value_delimiter = ',')]
    without: Vec<usize>,
    /// Threads.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// Prints the stage file and the parts of the first seed.
    #[arg(long)]
    show: bool,
    /// Prints every good value of this sensor in the first seed.
    #[arg(long)]
    trace: Option<String>,
    /// Does not make failing seeds smaller.
    #[arg(long)]
    as_is: bool,
}

#[expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "it prints what it found and how long that took"
)]
fn main() -> ExitCode {
    let Arguments { seed, count, minutes, without, jobs, show, trace, as_is } = Arguments::parse();
    if show {
        let (stage, parts) = described(seed, minutes, &without);
        println!("{stage}\n{}", parts.join("\n"));
    }
    // A panic is reported with its seed.
    std::panic::set_hook(Box::new(|_| {}));
    if let Some(sensor) = trace {
        return match run_traced(seed, minutes, &without, &sensor) {
            Ok(_) => ExitCode::SUCCESS,
            Err(failure) => {
                println!("{failure}");
                ExitCode::FAILURE
            }
        };
    }
    let began = Instant::now();
    let failed = AtomicU64::new(0);
    let total = run_all(seed..seed + count, minutes, &without, jobs, |failure| {
        failed.fetch_add(1, Ordering::Relaxed);
        println!("{}", if as_is { failure } else { minimised(failure, minutes) });
    });
    let failed = failed.into_inner();
    println!(
        "{count} seeds, {:.2} simulated hours in {:.0} s: {} refused, {} frames, {} values compared, {failed} failed",
        total.simulated_s / 3600.0,
        began.elapsed().as_secs_f64(),
        total.refused,
        total.frames,
        total.compared,
    );
    ExitCode::from(u8::from(failed > 0))
}
