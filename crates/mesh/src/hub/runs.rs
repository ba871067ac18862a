//! Which runs of which daemons are there, to see where two have one key.

use std::collections::{BTreeMap, BTreeSet};

/// Runs that are known.
pub(super) const RUNS: usize = 512;

/// Runs that are there now, by the stage's key.
#[derive(Debug, Default)]
pub(super) struct Runs(BTreeMap<String, BTreeSet<String>>);

impl Runs {
    /// A run has come or gone: how many its key has now. `None` where too many are known for one more.
    pub(super) fn see(&mut self, key: &str, run: &str, there: bool) -> Option<usize> {
        if !there {
            let Some(runs) = self.0.get_mut(key) else { return Some(0) };
            runs.remove(run);
            let left = runs.len();
            if left == 0 {
                self.0.remove(key);
            }
            return Some(left);
        }
        let is_known = self.0.get(key).is_some_and(|runs| runs.contains(run));
        if !is_known && self.0.values().map(BTreeSet::len).sum::<usize>() >= RUNS {
            return None;
        }
        let runs = self.0.entry(key.to_owned()).or_default();
        runs.insert(run.to_owned());
        Some(runs.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_runs_than_are_known_are_not_looked_at_and_those_that_are_known_stay_so() {
        let mut runs = Runs::default();
        assert_eq!((runs.see("a", "1", true), runs.see("a", "2", true)), (Some(1), Some(2)));
        let strangers = (0..1000).map(|n| runs.see(&format!("stranger/{n}"), "1", true)).collect::<Vec<_>>();
        assert!(strangers[..RUNS - 2].iter().all(|seen| *seen == Some(1)));
        assert!(strangers[RUNS - 2..].iter().all(Option::is_none));
        assert_eq!(runs.0.values().map(BTreeSet::len).sum::<usize>(), RUNS);
        // Two have one key still, also if it is said again, and until one of them is gone.
        assert_eq!(runs.see("a", "2", true), Some(2));
        assert_eq!(runs.see("b", "1", false), Some(0), "one that was not looked at");
        assert_eq!(runs.see("a", "1", false), Some(1));
        // Then there is room for one more.
        assert_eq!((runs.see("a", "3", true), runs.see("b", "1", true)), (Some(2), None));
    }
}
