//! Cholesky factors of some small matrices side by side, a lane each, with further rows that are factored along.
//!
//! A matrix `S = L L'` with rows `B` below becomes `L` with `B L'^-1` below: an innovation `v'` becomes the white `(L^-1 v)'`,
//! and the identity `L'^-1`. One such matrix does not fill vector registers; as many as there are lanes do.

use std::ops::Range;

use pulp::Simd;

/// Rows that are reduced at once: their sums do not wait for each other.
const TILE: usize = 8;

/// Lower halves of matrices (n, n), then `v'` of each, then the identity or nothing; factored by [`run`](Self::run).
pub(crate) struct Bordered<S: Simd> {
    simd: S,
    n: usize,
    /// The lanes of an entry lie together.
    entries: Vec<f64>,
    /// First pivot of each lane that is not positive.
    pub(crate) failed: Vec<Option<usize>>,
}

impl<S: Simd> Bordered<S> {
    /// All zero but for the identity.
    #[inline(always)]
    pub(crate) fn new(simd: S, n: usize, identity: bool) -> Self {
        let n_rows = n + 1 + if identity { n } else { 0 };
        let (entries, failed) = (vec![0.0; n_rows * n * S::F64_LANES], vec![None; S::F64_LANES]);
        let mut made = Self { simd, n, entries, failed };
        (n + 1..n_rows).for_each(|row| made.lanes_mut(row, row - n - 1).fill(1.0));
        made
    }

    /// Entry (i, j) of every lane: of `S` those up to the diagonal count; `v'` is row `n`.
    #[inline(always)]
    pub(crate) fn lanes_mut(&mut self, i: usize, j: usize) -> &mut [f64] {
        let first = (i * self.n + j) * S::F64_LANES;
        &mut self.entries[first..first + S::F64_LANES]
    }

    #[inline(always)]
    fn row(&self, i: usize) -> &[S::f64s] {
        &S::as_simd_f64s(&self.entries).0[i * self.n..(i + 1) * self.n]
    }

    /// Factors, a column at a time.
    #[inline(always)]
    pub(crate) fn run(&mut self) {
        let (simd, n) = (self.simd, self.n);
        let rows = S::as_mut_simd_f64s(&mut self.entries).0;
        for j in 0..n {
            let (above, below) = rows.split_at_mut((j + 1) * n);
            let own = &mut above[j * n..];
            let pivot = simd.sub_f64s(own[j], dot(simd, &own[..j], &own[..j]));
            for (failed, &pivot) in self.failed.iter_mut().zip(lanes_of(&pivot)) {
                // What is not a number is not positive either.
                let positive = pivot > 0.0;
                *failed = failed.or((!positive).then_some(j));
            }
            own[j] = simd.sqrt_f64s(pivot);
            let inverse = simd.div_f64s(simd.splat_f64s(1.0), own[j]);
            // Row q of the identity is zero before column q: later rows are not there yet, and zeros are passed over.
            let n_rows = (below.len() / n).min(n + 1);
            for (number, rows) in below[..n_rows * n].chunks_mut(TILE * n).enumerate() {
                let start = (j + TILE * number).saturating_sub(n);
                if rows.len() == TILE * n {
                    reduce::<S, TILE>(simd, rows, own, start..j, inverse);
                } else {
                    for row in rows.chunks_exact_mut(n) {
                        reduce::<S, 1>(simd, row, own, start..j, inverse);
                    }
                }
            }
        }
    }

    /// Squared length of `L^-1 v` from an entry on.
    #[inline(always)]
    pub(crate) fn square(&self, first: usize) -> Vec<f64> {
        let white = &self.row(self.n)[first..];
        lanes_of(&dot(self.simd, white, white)).to_vec()
    }

    /// `log det S`, or that of the observations from one on, given those before.
    #[inline(always)]
    pub(crate) fn log_det(&self, first: usize) -> Vec<f64> {
        let mut sum = vec![0.0; S::F64_LANES];
        for i in first..self.n {
            sum.iter_mut()
                .zip(lanes_of(&self.row(i)[i]))
                .for_each(|(sum, root)| *sum += 2.0 * root.ln());
        }
        sum
    }

    /// `S^-1 v`, with the lanes of an entry together.
    #[inline(always)]
    pub(crate) fn solution(&self) -> Vec<f64> {
        let (simd, first) = (self.simd, self.n * self.n * S::F64_LANES);
        let mut solution = self.entries[first..first + self.n * S::F64_LANES].to_vec();
        let left = S::as_mut_simd_f64s(&mut solution).0;
        for i in (0..self.n).rev() {
            let own = simd.div_f64s(left[i], self.row(i)[i]);
            left[i] = own;
            for (value, known) in left[..i].iter_mut().zip(self.row(i)) {
                *value = simd.sub_f64s(*value, simd.mul_f64s(*known, own));
            }
        }
        solution
    }

    /// Lower half of the diagonal block of `S^-1` of `size` observations from one on; its `v'` is zero.
    #[inline(always)]
    pub(crate) fn block_of_inverse(&self, first: usize, size: usize) -> Self {
        let mut block = Self::new(self.simd, size, false);
        for i in 0..size {
            let a = &self.row(self.n + 1 + first + i)[first + i..];
            for j in 0..=i {
                let b = &self.row(self.n + 1 + first + j)[first + i..];
                block.lanes_mut(i, j).copy_from_slice(lanes_of(&dot(self.simd, a, b)));
            }
        }
        block
    }
}

/// The lanes of a vector.
#[inline(always)]
fn lanes_of<V: pulp::bytemuck::Pod>(vector: &V) -> &[f64] {
    pulp::bytemuck::cast_slice(std::slice::from_ref(vector))
}

#[inline(always)]
fn dot<S: Simd>(simd: S, a: &[S::f64s], b: &[S::f64s]) -> S::f64s {
    // Closures of iterators would not be compiled for vectors.
    let mut sum = simd.splat_f64s(0.0);
    for (&a, &b) in a.iter().zip(b) {
        sum = simd.mul_add_e_f64s(a, b, sum);
    }
    sum
}

/// Column `known.end` of some rows of `L`, by that row `own` of `L` and the columns `known`.
#[inline(always)]
fn reduce<S: Simd, const N: usize>(
    simd: S,
    rows: &mut [S::f64s],
    own: &[S::f64s],
    known: Range<usize>,
    inverse: S::f64s,
) {
    let (n, j) = (own.len(), known.end);
    let mut sums = [simd.splat_f64s(0.0); N];
    for k in known {
        for (row, sum) in sums.iter_mut().enumerate() {
            *sum = simd.mul_add_e_f64s(rows[row * n + k], own[k], *sum);
        }
    }
    for (row, sum) in sums.into_iter().enumerate() {
        let entry = &mut rows[row * n + j];
        *entry = simd.mul_f64s(simd.sub_f64s(*entry, sum), inverse);
    }
}
