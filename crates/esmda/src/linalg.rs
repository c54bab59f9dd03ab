//! faer's kernels behind a few functions, each sequential inside.
//!
//! Threads only ever take whole chunks of a fixed size, and sums over chunks run in order: the bits of a result depend
//! neither on the number of threads nor on whether there are any.

use std::convert::Infallible;

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::linalg::svd::ComputeSvdVectors;
use faer::linalg::{cholesky::llt::factor as llt, householder, qr::no_pivoting::factor as qr, svd};
use faer::{Accum, Conj, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;

/// Rows (members, or parameters) that go to a thread at a time.
const ROW_CHUNK: usize = 64;

/// Length of the partial sums of a product over a long inner dimension.
const INNER_CHUNK: usize = 1024;

/// Columns of a block of a symmetric product.
const BLOCK: usize = 128;

/// Runs `work` on chunks of rows, on threads according to `par`.
pub(crate) fn for_row_chunks(
    rows: MatMut<'_, f64>,
    par: Par,
    work: impl Fn(MatMut<'_, f64>) + Send + Sync,
) {
    let infallible = |_, chunk: MatMut<'_, f64>| {
        work(chunk);
        Ok::<(), Infallible>(())
    };
    let Ok(()) = try_for_row_chunks(rows, par, infallible);
}

/// Runs `work` on chunks of rows, given the first one's number, on threads according to `par`; the first chunk's error.
pub(crate) fn try_for_row_chunks<E: Send>(
    rows: MatMut<'_, f64>,
    par: Par,
    work: impl Fn(usize, MatMut<'_, f64>) -> Result<(), E> + Send + Sync,
) -> Result<(), E> {
    if matches!(par, Par::Seq) || rows.nrows() <= ROW_CHUNK {
        let (mut rest, mut first) = (rows, 0);
        while rest.nrows() > 0 {
            let n_rows = ROW_CHUNK.min(rest.nrows());
            let (chunk, after) = rest.split_at_row_mut(n_rows);
            work(first, chunk)?;
            (rest, first) = (after, first + n_rows);
        }
        return Ok(());
    }
    let chunks = rows.par_row_chunks_mut(ROW_CHUNK).enumerate();
    let results: Vec<_> = chunks.map(|(chunk, rows)| work(chunk * ROW_CHUNK, rows)).collect();
    results.into_iter().collect()
}

/// Runs `work` on each column of two matrices of one shape, on threads according to `par`; the first column's error.
pub(crate) fn try_for_column_pairs<E: Send>(
    a: MatMut<'_, f64>,
    b: MatMut<'_, f64>,
    par: Par,
    work: impl Fn(usize, &mut [f64], &mut [f64]) -> Result<(), E> + Send + Sync,
) -> Result<(), E> {
    let on_chunk = |(chunk, (a, b)): (usize, (MatMut<'_, f64>, MatMut<'_, f64>))| {
        let columns = a.col_iter_mut().zip(b.col_iter_mut()).enumerate();
        columns.into_iter().try_for_each(|(column, (a, b))| {
            match (a.try_as_col_major_mut(), b.try_as_col_major_mut()) {
                (Some(a), Some(b)) => {
                    work(chunk * ROW_CHUNK + column, a.as_slice_mut(), b.as_slice_mut())
                }
                // Columns of a matrix of our own always lie together.
                _ => Ok(()),
            }
        })
    };
    if matches!(par, Par::Seq) || a.ncols() <= ROW_CHUNK {
        return on_chunk((0, (a, b)));
    }
    let pairs = a.par_col_chunks_mut(ROW_CHUNK).zip(b.par_col_chunks_mut(ROW_CHUNK));
    let results: Vec<_> = pairs.enumerate().map(on_chunk).collect();
    results.into_iter().collect()
}

/// `f(0), .., f(n - 1)` in order, computed on threads according to `par`.
pub(crate) fn map_in_order<T: Send>(
    n: usize,
    par: Par,
    f: impl Fn(usize) -> T + Send + Sync,
) -> Vec<T> {
    if matches!(par, Par::Seq) || n < 2 {
        (0..n).map(f).collect()
    } else {
        (0..n).into_par_iter().map(f).collect()
    }
}

/// `a b'` for `a`, `b` of shape (n, long); of a symmetric product (`a` is `b`) only the lower half is right.
pub(crate) fn outer_product(
    a: MatRef<'_, f64>,
    b: MatRef<'_, f64>,
    par: Par,
    half: bool,
) -> Mat<f64> {
    let structure =
        if half { BlockStructure::TriangularLower } else { BlockStructure::Rectangular };
    let partial = |chunk: usize| {
        let columns = chunk * INNER_CHUNK..((chunk + 1) * INNER_CHUNK).min(a.ncols());
        let mut product = Mat::zeros(a.nrows(), b.nrows());
        triangular_matmul(
            product.as_mut(),
            structure,
            Accum::Replace,
            a.get(.., columns.clone()),
            BlockStructure::Rectangular,
            b.get(.., columns).transpose(),
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
        product
    };
    let mut partials = map_in_order(a.ncols().div_ceil(INNER_CHUNK), par, partial).into_iter();
    let first = partials.next().unwrap_or_else(|| Mat::zeros(a.nrows(), b.nrows()));
    partials.fold(first, |sum, next| sum + next)
}

/// The lower half of `a' a` for `a` of shape (n, k), a block of columns at a time.
pub(crate) fn gram(a: MatRef<'_, f64>, par: Par) -> Mat<f64> {
    let k = a.ncols();
    if k <= BLOCK {
        let mut whole = Mat::zeros(k, k);
        matmul(whole.as_mut(), Accum::Replace, a.transpose(), a, 1.0, Par::Seq);
        return whole;
    }
    let block = |index: usize| {
        let (from, to) = (index * BLOCK, ((index + 1) * BLOCK).min(k));
        let mut product = Mat::zeros(k - from, to - from);
        let (left, right) = (a.get(.., from..k), a.get(.., from..to));
        matmul(product.as_mut(), Accum::Replace, left.transpose(), right, 1.0, Par::Seq);
        product
    };
    let mut whole = Mat::zeros(k, k);
    for (index, product) in map_in_order(k.div_ceil(BLOCK), par, block).into_iter().enumerate() {
        let from = index * BLOCK;
        let to = from + product.ncols();
        whole.get_mut(from..k, from..to).copy_from(&product);
    }
    whole
}

/// `a b`
pub(crate) fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut product = Mat::zeros(a.nrows(), b.ncols());
    matmul(product.as_mut(), Accum::Replace, a, b, 1.0, Par::Seq);
    product
}

/// Overwrites the lower half by the Cholesky factor; the failing pivot otherwise.
pub(crate) fn cholesky_in_place(matrix: MatMut<'_, f64>) -> Result<(), usize> {
    let scratch =
        llt::cholesky_in_place_scratch::<f64>(matrix.nrows(), Par::Seq, faer::prelude::default());
    llt::cholesky_in_place(
        matrix,
        faer::prelude::default(),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        faer::prelude::default(),
    )
    .map(|_| ())
    .map_err(|llt::LltError::NonPositivePivot { index }| index)
}

/// Thin QR of a tall matrix: `Q` (n, k) and `R`, whose upper triangle (k, k) counts.
pub(crate) fn thin_qr(mut tall: Mat<f64>) -> (Mat<f64>, Mat<f64>) {
    let (n, k) = tall.shape();
    let block_size = qr::recommended_block_size::<f64>(n, k);
    let mut coefficients = Mat::zeros(block_size, k);
    let scratch =
        qr::qr_in_place_scratch::<f64>(n, k, block_size, Par::Seq, faer::prelude::default());
    qr::qr_in_place(
        tall.as_mut(),
        coefficients.as_mut(),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        faer::prelude::default(),
    );
    let mut q = Mat::identity(n, k);
    let scratch = householder::apply_block_householder_sequence_on_the_left_in_place_scratch::<f64>(
        n, block_size, k,
    );
    householder::apply_block_householder_sequence_on_the_left_in_place_with_conj(
        tall.as_ref(),
        coefficients.as_ref(),
        Conj::No,
        q.as_mut(),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
    );
    let r = tall.get(..k, ..).to_owned();
    (q, r)
}

/// Thin singular value decomposition `a = U diag(w) V'`, without truncation.
pub(crate) struct ThinSvd {
    /// (n, k)
    pub(crate) u: Mat<f64>,
    /// (k), descending
    pub(crate) w: Vec<f64>,
    /// (m, k)
    pub(crate) v: Mat<f64>,
}

/// Computes it; `None` if the iteration does not converge.
pub(crate) fn thin_svd(a: MatRef<'_, f64>) -> Option<ThinSvd> {
    let (n, m) = a.shape();
    let k = n.min(m);
    let (mut u, mut v, mut w) = (Mat::zeros(n, k), Mat::zeros(m, k), Diag::zeros(k));
    let thin = ComputeSvdVectors::Thin;
    let scratch = svd::svd_scratch::<f64>(n, m, thin, thin, Par::Seq, faer::prelude::default());
    svd::svd(
        a,
        w.as_mut(),
        Some(u.as_mut()),
        Some(v.as_mut()),
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        faer::prelude::default(),
    )
    .ok()?;
    let w = w.column_vector().iter().copied().collect();
    Some(ThinSvd { u, w, v })
}
