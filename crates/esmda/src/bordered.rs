//! Cholesky factors of some small matrices side by side, a lane each, with further rows that are factored along.
//!
//! A matrix `S = L L'` with rows `B` below becomes `L` with `B L'^-1` below: an innovation `v'` becomes the white `(L^-1 v)'`,
//! and the identity `L'^-1`. One such matrix does not fill vector registers; several do, in the same operations each.

use crate::check::LANES;

/// A number of each matrix.
pub(crate) type Lanes = [f64; LANES];

/// Rows that are reduced at once: their sums do not wait for each other.
const TILE: usize = 4;

/// Lower halves of matrices (n, n), then `v'` of each, then the identity or nothing; factored by [`run`](Self::run).
pub(crate) struct Bordered {
    n: usize,
    rows: Vec<Lanes>,
    /// First pivot of each that is not positive.
    pub(crate) failed: [Option<usize>; LANES],
}

impl Bordered {
    /// All zero but for the identity.
    #[inline(always)]
    pub(crate) fn new(n: usize, identity: bool) -> Self {
        let n_rows = n + 1 + if identity { n } else { 0 };
        let mut rows = vec![[0.0; LANES]; n_rows * n];
        (n + 1..n_rows).for_each(|row| rows[row * n + row - n - 1] = [1.0; LANES]);
        Self { n, rows, failed: [None; LANES] }
    }

    #[inline(always)]
    fn row(&self, i: usize) -> &[Lanes] {
        &self.rows[i * self.n..(i + 1) * self.n]
    }

    /// Row `i` of `S`, of which entries up to the diagonal count; `v'` is row `n`.
    #[inline(always)]
    pub(crate) fn row_mut(&mut self, i: usize) -> &mut [Lanes] {
        &mut self.rows[i * self.n..(i + 1) * self.n]
    }

    /// Factors, a column at a time.
    #[inline(always)]
    pub(crate) fn run(&mut self) {
        let n = self.n;
        for j in 0..n {
            let (above, below) = self.rows.split_at_mut((j + 1) * n);
            let own = &mut above[j * n..];
            let mut pivot = own[j];
            own[..j].iter().for_each(|known| subtract(&mut pivot, known, known));
            for lane in 0..LANES {
                // What is not a number is not positive either.
                let positive = pivot[lane] > 0.0;
                self.failed[lane] = self.failed[lane].or((!positive).then_some(j));
            }
            own[j] = pivot.map(f64::sqrt);
            let inverse = own[j].map(f64::recip);
            // Row q of the identity is zero before column q: later rows are not there yet, and zeros are passed over.
            let n_rows = (below.len() / n).min(n + 1);
            for (number, rows) in below[..n_rows * n].chunks_mut(TILE * n).enumerate() {
                let start = (j + TILE * number).saturating_sub(n);
                if rows.len() == TILE * n {
                    reduce::<TILE>(rows, own, start..j, &inverse);
                } else {
                    rows.chunks_exact_mut(n)
                        .for_each(|row| reduce::<1>(row, own, start..j, &inverse));
                }
            }
        }
    }

    /// Squared length of `L^-1 v` from an entry on.
    #[inline(always)]
    pub(crate) fn square(&self, first: usize) -> Lanes {
        let mut sum = [0.0; LANES];
        for white in &self.row(self.n)[first..] {
            (0..LANES).for_each(|lane| sum[lane] += white[lane] * white[lane]);
        }
        sum
    }

    /// `log det S`, or that of the observations from one on, given those before.
    #[inline(always)]
    pub(crate) fn log_det(&self, first: usize) -> Lanes {
        let mut sum = [0.0; LANES];
        for i in first..self.n {
            (0..LANES).for_each(|lane| sum[lane] += 2.0 * self.row(i)[i][lane].ln());
        }
        sum
    }

    /// `S^-1 v`
    #[inline(always)]
    pub(crate) fn solution(&self) -> Vec<Lanes> {
        let mut left = self.row(self.n).to_vec();
        for i in (0..self.n).rev() {
            let (before, own) = left.split_at_mut(i);
            (0..LANES).for_each(|lane| own[0][lane] /= self.row(i)[i][lane]);
            for (value, known) in before.iter_mut().zip(self.row(i)) {
                subtract(value, known, &own[0]);
            }
        }
        left
    }

    /// Lower half of the diagonal block of `S^-1` of `size` observations from one on, below it the zero `v'`.
    #[inline(always)]
    pub(crate) fn block_of_inverse(&self, first: usize, size: usize) -> Self {
        let mut block = Self::new(size, false);
        for i in 0..size {
            for j in 0..=i {
                let (a, b) = (self.row(self.n + 1 + first + i), self.row(self.n + 1 + first + j));
                let sum = &mut block.row_mut(i)[j];
                for (a, b) in a[first + i..].iter().zip(&b[first + i..]) {
                    (0..LANES).for_each(|lane| sum[lane] += a[lane] * b[lane]);
                }
            }
        }
        block
    }
}

#[inline(always)]
fn subtract(from: &mut Lanes, a: &Lanes, b: &Lanes) {
    (0..LANES).for_each(|lane| from[lane] -= a[lane] * b[lane]);
}

/// Column `known.end` of some rows of `L`, by that row `own` of `L` and the columns `known`.
#[inline(always)]
fn reduce<const N: usize>(
    rows: &mut [Lanes],
    own: &[Lanes],
    known: std::ops::Range<usize>,
    inverse: &Lanes,
) {
    let (n, j) = (own.len(), known.end);
    let mut sums: [Lanes; N] = std::array::from_fn(|row| rows[row * n + j]);
    for k in known {
        for (row, sum) in sums.iter_mut().enumerate() {
            subtract(sum, &rows[row * n + k], &own[k]);
        }
    }
    for (row, sum) in sums.iter().enumerate() {
        (0..LANES).for_each(|lane| rows[row * n + j][lane] = sum[lane] * inverse[lane]);
    }
}
