//! A swarm of stages in virtual time: what no one would think of, many thousand times over.
//!
//! In: seeds. Out: of each, that everything held, or one sentence and the line that repeats it. A seed draws a stage of one to
//! four devices, their settings at and beyond their limits, faults of devices and lines, a host that oversleeps, and what
//! clients and strangers send; the whole of it runs through virtual devices and the pipeline, without a clock. After every
//! entry and at the end is asked:
//!
//! - Nothing panics; a stage that is right is never refused afterwards.
//! - What is published as good is right, at the very time that is stated: no stale pose, and none that is wrong by more than
//!   20 mm or 5 degrees beyond its noise (IMUs: 8 degrees of tilt, 20 of heading).
//! - All devices are good again within ten seconds of the last fault.
//! - Frames rise, no capture time lies after the frame's end, all numbers are finite.
//! - No entry takes more than 8 MiB or a second (a model: 512 MiB, 20 s), and time never stands still.
//! - A pipeline that is made to panic goes on, with all of the above: without the entry, or from the beginning where it panics again.
//! - A pipeline restored from a snapshot anywhere says the same from then on; a replay of the log ends in the same state.
//! - A recording on a disk that fills up anywhere holds the log up to the last flush.
//!
//! What is not drawn: distorted fields, bodies, and the daemon around the pipeline (threads, sockets), which
//! `tests/it` runs for real. Times are virtual, so that 36 seconds take a few tenths.

mod device;
mod dice;
mod disk;
mod judge;
mod models;
mod plan;
mod settings;
mod trouble;
mod world;

use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

pub use world::Summary;

use dice::Dice;
use plan::{Plan, plan};
use posed_rig::counting::Counting;

// Memory of an entry is among what must hold.
#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Something did not hold.
#[derive(Clone, Debug)]
pub struct Failure {
    /// The seed that shows it.
    pub seed: u64,
    /// Parts of the seed that it does without.
    pub without: Vec<usize>,
    /// What did not hold.
    pub sentence: String,
    /// What is left of the seed.
    pub parts: Vec<String>,
}

impl std::fmt::Display for Failure {
    /// What to type to see it again, and why.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "--seed {}", self.seed)?;
        let without: Vec<String> = self.without.iter().map(usize::to_string).collect();
        if !without.is_empty() {
            write!(f, " --without {}", without.join(","))?;
        }
        write!(f, ": {}\n    {}", self.sentence, self.parts.join("\n    "))
    }
}

/// Runs one seed, `minutes` of simulated time at least 0.5, without these of its parts.
///
/// # Errors
/// What did not hold.
pub fn run(seed: u64, minutes: f64, without: &[usize]) -> Result<Summary, Failure> {
    run_plan(&plan(seed, minutes, without), seed, without)
}

/// As [`run`], and tells how far off every good value of a sensor is that is compared.
///
/// # Errors
/// What did not hold.
pub fn run_traced(seed: u64, minutes: f64, without: &[usize], sensor: &str) -> Result<Summary, Failure> {
    let plan = Plan { traced: Some(sensor.to_owned()), ..plan(seed, minutes, without) };
    run_plan(&plan, seed, without)
}

fn run_plan(plan: &Plan, seed: u64, without: &[usize]) -> Result<Summary, Failure> {
    let attempt = AssertUnwindSafe(|| {
        let (summary, log) = world::run(plan, seed)?;
        let mut dice = Dice::new(seed, (1 << 32) + 1);
        if summary.refused == 0 && dice.chance(0.2) {
            disk::holds(&plan.stage_toml, &log, &mut dice)?;
        }
        Ok(summary)
    });
    let outcome = catch_unwind(attempt).unwrap_or_else(|panic| {
        let words = panic.downcast_ref::<String>().cloned();
        let words = words.or_else(|| panic.downcast_ref::<&str>().map(|words| (*words).to_owned()));
        Err(format!("a panic: {}", words.unwrap_or_default()))
    });
    outcome.map_err(|sentence| Failure {
        seed,
        without: without.to_vec(),
        sentence,
        parts: plan.parts.clone(),
    })
}

/// Runs seeds on so many threads, and tells of each failure as it comes.
pub fn run_all(
    seeds: Range<u64>,
    minutes: f64,
    without: &[usize],
    threads: usize,
    tell: impl Fn(Failure) + Sync,
) -> Summary {
    let next = AtomicU64::new(seeds.start);
    let total = Mutex::new(Summary::default());
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= seeds.end {
                return;
            }
            match run(seed, minutes, without) {
                Ok(summary) => total.lock().expect("nothing panics in it").add(summary),
                Err(failure) => tell(failure),
            }
        }
    };
    std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    total.into_inner().expect("nothing panics in it")
}

/// Leaves out one part after the other as long as something fails, until each that is left is needed.
pub fn minimised(mut failure: Failure, minutes: f64) -> Failure {
    loop {
        let numbers = plan(failure.seed, minutes, &failure.without).numbers;
        let smaller = numbers.iter().rev().find_map(|&number| {
            let mut without = failure.without.clone();
            without.push(number);
            run(failure.seed, minutes, &without).err()
        });
        match smaller {
            Some(smaller) => failure = smaller,
            None => return failure,
        }
    }
}

/// The stage file of a seed, and its parts.
pub fn described(seed: u64, minutes: f64, without: &[usize]) -> (String, Vec<String>) {
    let plan = plan(seed, minutes, without);
    (plan.stage_toml, plan.parts)
}
