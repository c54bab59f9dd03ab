//! faer's kernels, sequential: chains run in parallel, each of them on one thread.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor as llt;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Accum, Mat, MatMut, MatRef, Par};

/// Overwrites the lower half by the Cholesky factor; the failing pivot otherwise.
pub(crate) fn cholesky_in_place(matrix: MatMut<'_, f64>) -> Result<(), usize> {
    let request =
        llt::cholesky_in_place_scratch::<f64>(matrix.nrows(), Par::Seq, faer::prelude::default());
    llt::cholesky_in_place(
        matrix,
        faer::prelude::default(),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(request)),
        faer::prelude::default(),
    )
    .map(|_| ())
    .map_err(|llt::LltError::NonPositivePivot { index }| index)
}

/// `L^-1 right` in place.
pub(crate) fn forward_in_place(factor: MatRef<'_, f64>, right: MatMut<'_, f64>) {
    solve_lower_triangular_in_place(factor, right, Par::Seq);
}

/// `L^-1 right` of one vector.
pub(crate) fn forward(factor: MatRef<'_, f64>, right: &[f64]) -> Vec<f64> {
    let mut x = right.to_vec();
    for j in 0..x.len() {
        let below = &column(factor, j)[j..];
        let value = x[j] / below[0];
        x[j] = value;
        for (left, entry) in x[j + 1..].iter_mut().zip(&below[1..]) {
            *left -= entry * value;
        }
    }
    x
}

/// `L'^-1 right` of one vector.
pub(crate) fn backward(factor: MatRef<'_, f64>, right: &[f64]) -> Vec<f64> {
    let mut x = right.to_vec();
    for j in (0..x.len()).rev() {
        let own = &column(factor, j)[j..];
        let below: f64 = own[1..].iter().zip(&x[j + 1..]).map(|(entry, x)| entry * x).sum();
        x[j] = (x[j] - below) / own[0];
    }
    x
}

/// `a b`.
pub(crate) fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut out = Mat::zeros(a.nrows(), b.ncols());
    matmul(out.as_mut(), Accum::Replace, a, b, 1.0, Par::Seq);
    out
}

/// `out += scale a b'`.
pub(crate) fn add_outer(out: MatMut<'_, f64>, a: MatRef<'_, f64>, b: MatRef<'_, f64>, scale: f64) {
    matmul(out, Accum::Add, a, b.transpose(), scale, Par::Seq);
}

/// `out += scale other`, entry by entry.
pub(crate) fn add_scaled(mut out: MatMut<'_, f64>, other: MatRef<'_, f64>, scale: f64) {
    for j in 0..out.ncols() {
        for i in 0..out.nrows() {
            out[(i, j)] += scale * other[(i, j)];
        }
    }
}

/// `out += scale other` in the lower half, whole columns at a time.
pub(crate) fn add_scaled_lower(out: &mut Mat<f64>, other: MatRef<'_, f64>, scale: f64) {
    for j in 0..out.ncols() {
        let own = &mut out.col_as_slice_mut(j)[j..];
        for (sum, value) in own.iter_mut().zip(&column(other, j)[j..]) {
            *sum += scale * value;
        }
    }
}

/// A column of a matrix that is stored column by column.
pub(crate) fn column(matrix: MatRef<'_, f64>, j: usize) -> &[f64] {
    matrix.col(j).try_as_col_major().map_or(&[], |column| column.as_slice())
}

/// `(L L')^-1`.
pub(crate) fn inverse(factor: MatRef<'_, f64>) -> Mat<f64> {
    let mut out = Mat::identity(factor.nrows(), factor.nrows());
    solve_lower_triangular_in_place(factor, out.as_mut(), Par::Seq);
    solve_upper_triangular_in_place(factor.transpose(), out.as_mut(), Par::Seq);
    out
}
