//! The latest values of a stream, in one piece of memory.

use posed_state::Plain;

/// The latest `len` values, oldest first; constant time per value, no allocation once warm.
#[derive(Clone, Debug, Plain)]
pub struct Window<T> {
    len: usize,
    values: Vec<T>,
}

impl<T: Copy> Window<T> {
    /// Room for `len` values; nothing is allocated later.
    pub fn new(len: usize) -> Self {
        Self { len, values: Vec::with_capacity(2 * len) }
    }

    /// Takes the next value; the oldest is dropped once there are `len`.
    pub fn push(&mut self, value: T) {
        if self.values.len() >= 2 * self.len {
            let start = self.values.len() + 1 - self.len;
            self.values.copy_within(start.., 0);
            self.values.truncate(self.len - 1);
        }
        self.values.push(value);
    }

    /// Forgets all values.
    pub fn clear(&mut self) {
        self.values.clear();
    }

    /// All `len` values, oldest first; `None` until there are so many.
    pub fn full(&self) -> Option<&[T]> {
        self.values.len().checked_sub(self.len).map(|start| &self.values[start..])
    }

    /// The values there are, oldest first, at most `len`.
    pub fn latest(&self) -> &[T] {
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
