//! An even choice of a stream whose length nobody knows, in bounded memory.

/// Every k-th value of a stream, with k doubled when there are too many.
#[derive(Clone, Debug)]
pub struct Thinned<T> {
    most: usize,
    every: u64,
    seen: u64,
    kept: Vec<T>,
}

impl<T> Thinned<T> {
    /// Keeps so many at most, two or more.
    pub fn new(most: usize) -> Self {
        Self { most: most.max(2), every: 1, seen: 0, kept: Vec::new() }
    }

    /// Takes the next value, which is made only where it is kept.
    pub fn push(&mut self, value: impl FnOnce() -> T) {
        if self.seen.is_multiple_of(self.every) {
            if self.kept.len() == self.most {
                let mut at = 0;
                self.kept.retain(|_| {
                    at += 1;
                    at % 2 == 1
                });
                self.every *= 2;
            }
            if self.seen.is_multiple_of(self.every) {
                self.kept.push(value());
            }
        }
        self.seen += 1;
    }

    /// Begins anew, in the same memory.
    pub fn clear(&mut self) {
        (self.every, self.seen) = (1, 0);
        self.kept.clear();
    }

    /// How many there were.
    pub fn seen(&self) -> u64 {
        self.seen
    }

    /// Those that are kept, in order.
    pub fn kept(&self) -> &[T] {
        &self.kept
    }

    /// The same, taken out.
    pub fn into_kept(self) -> Vec<T> {
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_evenly_spread_and_never_too_much() {
        for length in [0_usize, 1, 9, 10, 11, 20, 21, 1000] {
            let mut thinned = Thinned::new(10);
            for k in 0..length {
                thinned.push(|| k);
                assert!(thinned.kept().len() <= 10);
            }
            let steps: Vec<usize> = thinned.kept().windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(steps.windows(2).all(|pair| pair[0] == pair[1]), "{length}: {steps:?}");
            assert!(thinned.kept().len() >= length.min(5), "{length}");
            assert_eq!(thinned.seen(), length as u64);
        }
    }
}
