//! The latest values of a stream, in one piece of memory.

use serde::{Deserialize, Serialize};

/// The latest `len` values, oldest first; constant time per value, no allocation once warm.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Window<T> {
    len: usize,
    values: Vec<T>,
}

impl<T: Copy> Window<T> {
    pub(super) fn new(len: usize) -> Self {
        Self { len, values: Vec::with_capacity(2 * len) }
    }

    pub(super) fn push(&mut self, value: T) {
        if self.values.len() >= 2 * self.len {
            let start = self.values.len() + 1 - self.len;
            self.values.copy_within(start.., 0);
            self.values.truncate(self.len - 1);
        }
        self.values.push(value);
    }

    /// All `len` values; `None` until there are so many.
    pub(super) fn full(&self) -> Option<&[T]> {
        self.values.len().checked_sub(self.len).map(|start| &self.values[start..])
    }

    /// What there is, at most `len` values.
    pub(super) fn latest(&self) -> &[T] {
        &self.values[self.values.len().saturating_sub(self.len)..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_holds_the_latest_values_in_order() {
        for len in 1..6 {
            let mut window = Window::new(len);
            for value in 0..40usize {
                window.push(value);
                let first = (value + 1).saturating_sub(len);
                assert_eq!(window.latest(), (first..=value).collect::<Vec<_>>());
                assert_eq!(window.full().is_some(), value + 1 >= len);
            }
        }
    }
}
