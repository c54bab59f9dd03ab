//! `C_d = D^2 + B B'`: independent noise, and errors of a few shapes that many observations share.
//!
//! With `D^-1 B = Q diag(s) V'`, `Q` of orthonormal columns,
//!
//! ```text
//! C_d = L L',   L = D H,   H = (I + Q diag(s^2) Q')^1/2 = I + Q diag(sqrt(1 + s^2) - 1) Q'
//! ```
//!
//! and `H^-1` is the same with `1 / sqrt(1 + s^2) - 1` (Woodbury's identity, for the root). Nothing of `n_obs` squared
//! is formed.

use faer::linalg::matmul::matmul;
use faer::prelude::{Reborrow, ReborrowMut};
use faer::{Accum, Mat, MatMut, MatRef, Par};

use crate::check::check_finite;
use crate::{EsmdaError, linalg};

/// The root `L` in factors.
#[derive(Debug, Clone)]
pub(super) struct LowRank {
    /// Diagonal of `D`, (`n_obs`).
    pub(super) std: Vec<f64>,
    /// `Q`, (`n_obs`, `rank`).
    basis: Mat<f64>,
    /// `sqrt(1 + s^2)`, (`rank`).
    stretch: Vec<f64>,
}

impl LowRank {
    /// Of checked standard deviations and `B`, (`n_obs`, one or more).
    pub(super) fn new(std: &[f64], columns: MatRef<'_, f64>) -> Result<Self, EsmdaError> {
        let (n_obs, n_columns) = columns.shape();
        check_finite("columns", columns)?;
        let scaled =
            Mat::from_fn(n_obs, n_columns, |row, column| columns[(row, column)] / std[row]);
        if !scaled.is_all_finite() {
            return Err(EsmdaError::Overflow);
        }
        let failed = EsmdaError::NoConvergence { n_obs, n_members: n_columns };
        let svd = linalg::thin_svd(scaled.as_ref()).ok_or(failed)?;
        let stretch = svd.w.iter().map(|s| s.hypot(1.0)).collect();
        Ok(Self { std: std.to_vec(), basis: svd.u, stretch })
    }

    /// `rows <- rows L^-T`
    pub(super) fn whiten(&self, rows: MatMut<'_, f64>, par: Par) {
        linalg::for_row_chunks(rows, par, |mut chunk| {
            self.scale(chunk.rb_mut(), |value, std| value / std);
            self.stretched(chunk, |stretch| 1.0 / stretch);
        });
    }

    /// `rows <- rows L'`
    pub(super) fn colour(&self, rows: MatMut<'_, f64>, par: Par) {
        linalg::for_row_chunks(rows, par, |mut chunk| {
            self.stretched(chunk.rb_mut(), |stretch| stretch);
            self.scale(chunk, |value, std| value * std);
        });
    }

    /// `rows <- rows L^-1`
    pub(super) fn unscale(&self, rows: MatMut<'_, f64>, par: Par) {
        linalg::for_row_chunks(rows, par, |mut chunk| {
            self.stretched(chunk.rb_mut(), |stretch| 1.0 / stretch);
            self.scale(chunk, |value, std| value / std);
        });
    }

    fn scale(&self, mut rows: MatMut<'_, f64>, change: impl Fn(f64, f64) -> f64) {
        for (obs, &std) in self.std.iter().enumerate() {
            rows.rb_mut().col_mut(obs).iter_mut().for_each(|value| *value = change(*value, std));
        }
    }

    /// `rows <- rows (I + Q diag(factor(stretch) - 1) Q')`
    fn stretched(&self, rows: MatMut<'_, f64>, factor: impl Fn(f64) -> f64) {
        let mut along = Mat::zeros(rows.nrows(), self.stretch.len());
        matmul(along.as_mut(), Accum::Replace, rows.rb(), self.basis.as_ref(), 1.0, Par::Seq);
        for (k, &stretch) in self.stretch.iter().enumerate() {
            let change = factor(stretch) - 1.0;
            along.col_mut(k).iter_mut().for_each(|value| *value *= change);
        }
        matmul(rows, Accum::Add, along.as_ref(), self.basis.transpose(), 1.0, Par::Seq);
    }
}
