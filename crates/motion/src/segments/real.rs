//! Numbers the network computes with, and their matrix product.
//!
//! What comes in: views of slices as matrices. What goes out: sums of products. What it never does: read outside a
//! slice; the product is `gemm`'s, which chooses its kernel (AVX-512, AVX2 and FMA, ...) when it runs, so that its last bits are
//! the processor's: for training and whole sequences, while the live stream multiplies in one order of its own. Doubles,
//! which only check gradients, are multiplied one by one.

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
    /// To a double, exactly.
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
    ($real:ty, $exp:path, $add_product:path) => {
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
                $exp(self)
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
                if c.rows > 0 && c.columns > 0 && a.columns > 0 {
                    $add_product(a, b, c);
                }
            }
        }
    };
}

real!(f32, libm::expf, kernel);
real!(f64, libm::exp, one_by_one);

fn kernel(a: View<'_, f32>, b: View<'_, f32>, c: ViewMut<'_, f32>) {
    let gemm = gemm_f32::gemm::f32::get_gemm_fn();
    // It wants columns of the result in one piece: the product of the transposed is the transposed product.
    let (rows, columns, inner) = (c.columns, c.rows, a.columns);
    // SAFETY: each view lies inside its slice (asserted where it was made: the largest index of a `rows` x `columns`
    // view, transposed or not, is `rows * columns - 1`), the shapes fit and none is empty (`add_product`), and `c`
    // overlaps neither `a` nor `b`, being borrowed mutably.
    unsafe {
        gemm(
            rows,
            columns,
            inner,
            c.data.as_mut_ptr(),
            c.columns as isize,
            1,
            true,
            b.data.as_ptr(),
            b.row_stride as isize,
            b.column_stride as isize,
            a.data.as_ptr(),
            a.row_stride as isize,
            a.column_stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            gemm_common::Parallelism::None,
        );
    }
}

fn one_by_one(a: View<'_, f64>, b: View<'_, f64>, c: ViewMut<'_, f64>) {
    for (i, row) in c.data.chunks_exact_mut(c.columns).take(c.rows).enumerate() {
        for k in 0..a.columns {
            let factor = a.data[i * a.row_stride + k * a.column_stride];
            for (j, sum) in row.iter_mut().enumerate() {
                *sum += factor * b.data[k * b.row_stride + j * b.column_stride];
            }
        }
    }
}

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

    /// Sums of small whole numbers are exact.
    #[test]
    fn the_kernel_says_what_multiplying_one_by_one_says() {
        fn product<R: Real>([rows, inner, columns]: [usize; 3], turned: [bool; 2]) -> Vec<f64> {
            let numbers = |count: usize, step: usize| -> Vec<R> {
                (0..count).map(|at| R::of((at * step % 7) as f64 - 3.0)).collect()
            };
            let (a, b) = (numbers(rows * inner, 3), numbers(inner * columns, 5));
            let mut c = numbers(rows * columns, 2);
            let a =
                if turned[0] { View::new(&a, inner, rows).transposed() } else { View::new(&a, rows, inner) };
            let b = if turned[1] {
                View::new(&b, columns, inner).transposed()
            } else {
                View::new(&b, inner, columns)
            };
            R::add_product(a, b, ViewMut::new(&mut c, rows, columns));
            c.into_iter().map(R::to_f64).collect()
        }
        for shape in [
            [1, 1, 1],
            [2, 3, 2],
            [1, 40, 9],
            [33, 1, 17],
            [81, 57, 64],
            [130, 260, 70],
            [0, 3, 2],
            [2, 0, 3],
        ] {
            for turned in [[false, false], [true, false], [false, true], [true, true]] {
                assert_eq!(
                    product::<f32>(shape, turned),
                    product::<f64>(shape, turned),
                    "{shape:?} {turned:?}"
                );
            }
        }
    }

    #[test]
    #[should_panic(expected = "2 x 3 in 5")]
    fn a_view_outside_its_slice_is_refused() {
        View::new(&[0.0; 5], 2, 3);
    }
}
