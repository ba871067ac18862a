//! `cargo run --release -p posed-swarm -- --seed 0 --count 1000`: see the library.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use clap::Parser;
use posed_swarm::{Summary, described, minimised, run};

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
    jobs: u64,
    /// Tells the stage file and the parts of the first seed.
    #[arg(long)]
    show: bool,
    /// Does not make failing seeds smaller.
    #[arg(long)]
    as_is: bool,
}

#[derive(Default)]
struct Totals {
    seconds: f64,
    refused: u64,
    frames: u64,
    compared: u64,
    failed: u64,
}

impl Totals {
    fn add(&mut self, summary: Summary) {
        self.seconds += summary.simulated_s;
        self.refused += u64::from(summary.refused);
        self.frames += summary.frames;
        self.compared += summary.compared;
    }
}

#[expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "it tells what it found and how long that took"
)]
fn main() -> std::process::ExitCode {
    let arguments = Arguments::parse();
    if arguments.show {
        let (stage, parts) = described(arguments.seed, arguments.minutes, &arguments.without);
        println!("{stage}\n{}", parts.join("\n"));
    }
    // A panic is told with its seed.
    std::panic::set_hook(Box::new(|_| {}));
    let began = Instant::now();
    let next = AtomicU64::new(arguments.seed);
    let end = arguments.seed + arguments.count;
    let totals = Mutex::new(Totals::default());
    let add =
        |change: &dyn Fn(&mut Totals)| change(&mut totals.lock().unwrap_or_else(|held| held.into_inner()));
    std::thread::scope(|scope| {
        for _ in 0..arguments.jobs {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= end {
                        return;
                    }
                    match run(seed, arguments.minutes, &arguments.without) {
                        Ok(summary) => add(&|totals| totals.add(summary)),
                        Err(failure) => {
                            add(&|totals| totals.failed += 1);
                            let failure =
                                if arguments.as_is { failure } else { minimised(failure, arguments.minutes) };
                            let without: Vec<String> = failure.without.iter().map(usize::to_string).collect();
                            let without = if without.is_empty() {
                                String::new()
                            } else {
                                format!(" --without {}", without.join(","))
                            };
                            println!(
                                "--seed {seed}{without}: {}\n    {}",
                                failure.sentence,
                                failure.parts.join("\n    ")
                            );
                        }
                    }
                }
            });
        }
    });
    let totals = totals.into_inner().unwrap_or_else(|held| held.into_inner());
    println!(
        "{} seeds, {:.2} simulated hours in {:.0} s: {} refused, {} frames, {} values compared, {} failed",
        arguments.count,
        totals.seconds / 3600.0,
        began.elapsed().as_secs_f64(),
        totals.refused,
        totals.frames,
        totals.compared,
        totals.failed
    );
    std::process::ExitCode::from(u8::from(totals.failed > 0))
}
