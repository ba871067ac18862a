//! Loops over independent items: on all cores with the feature `parallel`, one item after the other without it. Results keep
//! the order of the items, so that both give the same to the bit.

#[cfg(feature = "parallel")]
pub use rayon::prelude::*;
#[cfg(not(feature = "parallel"))]
pub use serial::*;

#[cfg(not(feature = "parallel"))]
mod serial {
    /// `into_par_iter` of rayon, one item after the other.
    pub trait IntoParallelIterator: IntoIterator + Sized {
        /// The items, in order.
        fn into_par_iter(self) -> Self::IntoIter {
            self.into_iter()
        }
    }

    impl<T: IntoIterator> IntoParallelIterator for T {}

    /// `par_iter` and `par_iter_mut` of rayon, one item after the other.
    pub trait ParallelSlice<T> {
        /// The items, in order.
        fn par_iter(&self) -> std::slice::Iter<'_, T>;
        /// The items, in order, to be changed.
        fn par_iter_mut(&mut self) -> std::slice::IterMut<'_, T>;
    }

    impl<T> ParallelSlice<T> for [T] {
        fn par_iter(&self) -> std::slice::Iter<'_, T> {
            self.iter()
        }

        fn par_iter_mut(&mut self) -> std::slice::IterMut<'_, T> {
            self.iter_mut()
        }
    }
}
