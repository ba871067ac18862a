//! The swarm's first seeds; `docs/fault-tolerance.md` states how many more have run.

use std::sync::Mutex;

use posed_swarm::{minimised, run_all};

/// Seeds of this run.
const SEEDS: u64 = 32;
const MINUTES: f64 = 0.6;

#[test]
fn nothing_fails_in_the_first_seeds() {
    let failures = Mutex::new(Vec::new());
    let total = run_all(0..SEEDS, MINUTES, &[], 2, |failure| {
        failures.lock().expect("whole").push(minimised(failure, MINUTES));
    });
    let failures = failures.into_inner().expect("whole");
    assert!(failures.is_empty(), "{failures:#?}");
    assert!(total.compared > 100_000, "{} values were held against the truth", total.compared);
}
