//! Processor time, which another program's work does not stretch: Linux alone tells.

use std::fs::read_to_string;

/// Processor time of all threads so far, s, to a hundredth; not a number where the system does not tell.
pub(crate) fn process_s() -> f64 {
    let stat = read_to_string("/proc/self/stat").unwrap_or_default();
    // The name of the program may hold anything; behind its bracket user and system time are the 12th and 13th.
    let after = stat.rsplit(')').next().unwrap_or_default();
    let ticks: Vec<f64> =
        after.split_whitespace().skip(11).take(2).filter_map(|number| number.parse().ok()).collect();
    if ticks.len() == 2 { (ticks[0] + ticks[1]) / 100.0 } else { f64::NAN }
}

/// Processor time of this thread so far, ns.
pub(crate) fn thread_ns() -> f64 {
    let stat = read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    stat.split_whitespace().next().and_then(|number| number.parse().ok()).unwrap_or(f64::NAN)
}
