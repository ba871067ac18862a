//! The swarm's first seeds; `docs/fault-tolerance.md` states how many more have run.

use std::sync::atomic::{AtomicU64, Ordering};

use posed_swarm::{minimised, run};

/// Seeds of this run.
const SEEDS: u64 = 64;
const MINUTES: f64 = 0.6;

#[test]
fn nothing_fails_in_the_first_seeds() {
    let next = AtomicU64::new(0);
    let work = || {
        let mut compared = 0;
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= SEEDS {
                return compared;
            }
            match run(seed, MINUTES, &[]) {
                Ok(summary) => compared += summary.compared,
                Err(failure) => panic!("{:#?}", minimised(failure, MINUTES)),
            }
        }
    };
    let compared: u64 = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..2).map(|_| scope.spawn(work)).collect();
        threads.into_iter().map(|thread| thread.join().expect("no seed fails")).sum()
    });
    assert!(compared > 100_000, "{compared} values were held against the truth");
}
