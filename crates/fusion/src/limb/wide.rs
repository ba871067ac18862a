//! Passes over a covariance and what stands beside it, four numbers at a time where the machine can.
//!
//! In: matrices. Out: the same to the last bit on every machine: AVX multiplies and adds as any other instructions do, only more at
//! once; what would fuse the two (FMA) is left alone. The program is built for the oldest x86-64, which has two at a time.

use nalgebra::SMatrix;

/// A pass that is compiled twice: as it stands, and with AVX for a machine that has it.
macro_rules! wide {
    ($(#[$doc:meta])* $name:ident <$($size:ident),+> ($($argument:ident: $kind:ty),+) -> $out:ty = $plain:ident) => {
        $(#[$doc])*
        pub(super) fn $name<$(const $size: usize),+>($($argument: $kind),+) -> $out {
            #[cfg(target_arch = "x86_64")]
            if std::is_x86_feature_detected!("avx") {
                #[target_feature(enable = "avx")]
                fn avx<$(const $size: usize),+>($($argument: $kind),+) -> $out {
                    $plain($($argument),+)
                }
                #[expect(unsafe_code, reason = "the machine has been asked")]
                // SAFETY: this machine has AVX.
                return unsafe { avx($($argument),+) };
            }
            $plain($($argument),+)
        }
    };
}

wide! {
    /// `p h'`, all M columns in one pass over `p`; columns of `h` from `columns` on are zero.
    product<M, N, R>(p: &SMatrix<f64, R, N>, h: &SMatrix<f64, M, N>, columns: usize) -> SMatrix<f64, R, M> = plain_product
}

wide! {
    /// `p -= a b' + b a'`, in one pass over `p`; what is symmetric stays so to the last bit.
    subtract_both<M, N>(p: &mut SMatrix<f64, N, N>, a: &SMatrix<f64, N, M>, b: &SMatrix<f64, N, M>) -> () = plain_subtract_both
}

wide! {
    /// `p -= a b'`, in one pass over `p`.
    subtract<M, N, R>(p: &mut SMatrix<f64, R, N>, a: &SMatrix<f64, R, M>, b: &SMatrix<f64, N, M>) -> () = plain_subtract
}

#[inline(always)]
#[expect(clippy::needless_range_loop, reason = "plain indices let the compiler vectorise over the rows")]
fn plain_subtract<const M: usize, const N: usize, const R: usize>(
    p: &mut SMatrix<f64, R, N>,
    a: &SMatrix<f64, R, M>,
    b: &SMatrix<f64, N, M>,
) {
    for (j, column) in p.data.0.iter_mut().enumerate() {
        let factors: [f64; M] = std::array::from_fn(|i| b.data.0[i][j]);
        for k in 0..R {
            let mut sum = 0.0;
            for i in 0..M {
                sum += factors[i] * a.data.0[i][k];
            }
            column[k] -= sum;
        }
    }
}

#[inline(always)]
fn plain_product<const M: usize, const N: usize, const R: usize>(
    p: &SMatrix<f64, R, N>,
    h: &SMatrix<f64, M, N>,
    columns: usize,
) -> SMatrix<f64, R, M> {
    let mut out = [[0.0; R]; M];
    for (p, h) in p.data.0.iter().zip(&h.data.0).take(columns) {
        // Many states do not touch many measurements.
        if h.iter().all(|factor| *factor == 0.0) {
            continue;
        }
        for i in 0..M {
            for k in 0..R {
                out[i][k] += h[i] * p[k];
            }
        }
    }
    SMatrix::from_data(nalgebra::ArrayStorage(out))
}

#[inline(always)]
#[expect(clippy::needless_range_loop, reason = "plain indices let the compiler vectorise over the rows")]
fn plain_subtract_both<const M: usize, const N: usize>(
    p: &mut SMatrix<f64, N, N>,
    a: &SMatrix<f64, N, M>,
    b: &SMatrix<f64, N, M>,
) {
    for (j, column) in p.data.0.iter_mut().enumerate() {
        let row: [[f64; 2]; M] = std::array::from_fn(|i| [a.data.0[i][j], b.data.0[i][j]]);
        for k in 0..N {
            let mut sum = 0.0;
            for i in 0..M {
                sum += row[i][1] * a.data.0[i][k] + row[i][0] * b.data.0[i][k];
            }
            column[k] -= sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_machine_finds_the_same_to_the_last_bit() {
        let value = |i: usize, j: usize| {
            libm::sin((7 * i + 13 * j) as f64 * 0.37) * 10_f64.powi((i + j) as i32 % 9 - 4)
        };
        let mut p = SMatrix::<f64, 21, 21>::from_fn(|i, j| value(i.min(j), i.max(j)));
        let h = SMatrix::<f64, 3, 21>::from_fn(|i, j| if j % 4 == 1 { 0.0 } else { value(i, j + 3) });
        let cross = product(&p, &h, 18);
        assert_eq!(cross, plain_product(&p, &h, 18));
        let gain = cross * 0.01;
        let mut plain = p;
        subtract_both(&mut p, &gain, &cross);
        plain_subtract_both(&mut plain, &gain, &cross);
        assert_eq!(p, plain);
        assert_eq!(p, p.transpose());
        let by = SMatrix::<f64, 16, 3>::from_fn(|i, j| value(i, j + 5));
        let mut beside = SMatrix::<f64, 16, 21>::from_fn(value);
        let mut plain = beside;
        subtract(&mut beside, &by, &gain);
        plain_subtract(&mut plain, &by, &gain);
        assert_eq!(beside, plain);
    }
}
