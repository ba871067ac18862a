//! Numbers the network computes with, and their matrix product.
//!
//! What comes in: views of slices as matrices. What goes out: sums of products. What it never does: read outside a
//! slice; the product is `matrixmultiply`'s, which chooses its kernel (AVX-512, AVX2 and FMA, ...) when it runs.

#![expect(unsafe_code, reason = "the matrix product takes pointers; every view is checked against its slice")]

use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub};

/// A number of the network: `f32` to work with, `f64` to check gradients with.
pub trait Real:
    Copy
    + Default
    + PartialOrd
    + Send
    + Sync
    + std::fmt::Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + MulAssign
    + 'static
{
    /// Zero.
    const ZERO: Self;
    /// One.
    const ONE: Self;
    /// From a constant.
    fn of(value: f64) -> Self;
    /// To a double.
    fn to_f64(self) -> f64;
    /// e to the power of it.
    fn exp(self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// `c += a b`.
    fn add_product(a: View<'_, Self>, b: View<'_, Self>, c: ViewMut<'_, Self>);
}

/// A matrix in a slice: element (i, j) is at `i * row_stride + j * column_stride`.
#[derive(Clone, Copy)]
pub struct View<'a, R> {
    data: &'a [R],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a, R> View<'a, R> {
    /// Rows one after the other.
    pub(super) fn new(data: &'a [R], rows: usize, columns: usize) -> Self {
        assert!(data.len() >= rows * columns, "{rows} x {columns} in {}", data.len());
        Self { data, rows, columns, row_stride: columns, column_stride: 1 }
    }

    /// Rows and columns exchanged.
    pub(super) fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }
}

/// A matrix to add to, rows one after the other.
pub struct ViewMut<'a, R> {
    data: &'a mut [R],
    rows: usize,
    columns: usize,
}

impl<'a, R> ViewMut<'a, R> {
    /// Rows one after the other.
    pub(super) fn new(data: &'a mut [R], rows: usize, columns: usize) -> Self {
        assert!(data.len() >= rows * columns, "{rows} x {columns} in {}", data.len());
        Self { data, rows, columns }
    }
}

macro_rules! real {
    ($real:ty, $gemm:path) => {
        impl Real for $real {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            fn of(value: f64) -> Self {
                value as Self
            }

            fn to_f64(self) -> f64 {
                f64::from(self)
            }

            fn exp(self) -> Self {
                self.exp()
            }

            fn sqrt(self) -> Self {
                self.sqrt()
            }

            fn add_product(a: View<'_, Self>, b: View<'_, Self>, c: ViewMut<'_, Self>) {
                assert_eq!(
                    (a.rows, a.columns, b.columns),
                    (c.rows, b.rows, c.columns),
                    "shapes of a product"
                );
                if c.rows == 0 || c.columns == 0 || a.columns == 0 {
                    return;
                }
                // SAFETY: each view lies inside its slice (asserted where it was made: the largest index of a
                // `rows` x `columns` view, transposed or not, is `rows * columns - 1`), and `c` overlaps neither
                // `a` nor `b`, being borrowed mutably.
                unsafe {
                    $gemm(
                        a.rows,
                        a.columns,
                        b.columns,
                        1.0,
                        a.data.as_ptr(),
                        a.row_stride as isize,
                        a.column_stride as isize,
                        b.data.as_ptr(),
                        b.row_stride as isize,
                        b.column_stride as isize,
                        1.0,
                        c.data.as_mut_ptr(),
                        c.columns as isize,
                        1,
                    );
                }
            }
        }
    };
}

real!(f32, matrixmultiply::sgemm);
real!(f64, matrixmultiply::dgemm);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_add_up_whichever_way_the_matrices_lie() {
        let a = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let b = [1.0, 0.0, -1.0, 2.0, 0.5, 1.0];
        let mut c = [1.0_f64; 4];
        f64::add_product(View::new(&a, 2, 3), View::new(&b, 3, 2), ViewMut::new(&mut c, 2, 2));
        assert_eq!(c, [1.5, 8.0, 3.0, 17.0]);
        let mut c = [0.0_f64; 9];
        f64::add_product(View::new(&a, 2, 3).transposed(), View::new(&b, 2, 3), ViewMut::new(&mut c, 3, 3));
        assert_eq!(c, [9.0, 2.0, 3.0, 12.0, 2.5, 3.0, 15.0, 3.0, 3.0]);
    }

    #[test]
    #[should_panic(expected = "2 x 3 in 5")]
    fn a_view_outside_its_slice_is_refused() {
        View::new(&[0.0; 5], 2, 3);
    }
}
