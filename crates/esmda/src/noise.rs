//! The observations' noise covariance `C_d`, factored once: `C_d = L L'`.
//!
//! All a step needs is `L^-1` times something (whitening); the covariance is never inverted. Whatever the model itself
//! gets wrong at the observations belongs in `C_d` too, or every posterior is too narrow.

mod low_rank;

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::prelude::{Reborrow, ReborrowMut};
use faer::{Accum, Mat, MatMut, MatRef, Par};

use self::low_rank::LowRank;
use crate::check::{check_shape, find, find_asymmetry};
use crate::{EsmdaError, linalg};

/// Covariance of the observations' noise, in the unit of the observations squared.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::faer::mat;
/// use tissuereg_esmda::{EsmdaError, NoiseCovariance};
///
/// assert_eq!(NoiseCovariance::diagonal(&[0.1, 0.2, 0.1])?.n_obs(), 3);
///
/// // Perfectly correlated noise would mean that a difference is known exactly.
/// let singular = mat![[1.0, 1.0], [1.0, 1.0]];
/// let error = NoiseCovariance::dense(singular.as_ref()).unwrap_err();
/// assert_eq!(error, EsmdaError::NoiseNotPositiveDefinite { pivot: 1 });
/// # Ok::<(), EsmdaError>(())
/// ```
#[derive(Debug, Clone)]
pub struct NoiseCovariance {
    root: Root,
}

/// `L` of `C_d = L L'`.
#[derive(Debug, Clone)]
enum Root {
    Diagonal(Vec<f64>),
    Lower(Mat<f64>),
    LowRank(LowRank),
}

impl NoiseCovariance {
    /// Independent noise: one standard deviation an observation.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::NoiseStd`] for one that is not positive and finite.
    pub fn diagonal(std: &[f64]) -> Result<Self, EsmdaError> {
        check_std(std)?;
        Ok(Self { root: Root::Diagonal(std.to_vec()) })
    }

    /// Independent noise and errors that observations share: `C_d = diag(std)^2 + B B'`, `B` the `columns`.
    ///
    /// For the error of a model, say, known from a few samples or modes. `C_d` itself is never formed. The root is not
    /// the lower triangle of [`NoiseCovariance::dense`]: with the same draws the stochastic step differs from its by a
    /// rotation of the draws, in distribution not at all.
    ///
    /// # Shapes
    ///
    /// `std` is (`n_obs`), `columns` is (`n_obs`, anything), both in the unit of the observations.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::NoiseStd`], [`EsmdaError::Shape`] and [`EsmdaError::NotFinite`] for `columns`;
    /// [`EsmdaError::Overflow`] if a column over the standard deviations leaves the range of `f64`;
    /// [`EsmdaError::NoConvergence`] if its singular values are not found.
    ///
    /// # Cost
    ///
    /// Singular values of (`n_obs`, `k`) once, then `2 n_obs k` multiply-adds a whitened vector, `k` columns.
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_esmda::NoiseCovariance;
    /// use tissuereg_esmda::faer::mat;
    ///
    /// // Two trackers of 0.1 mm and a model that is off by 0.3 mm in both or in none.
    /// let noise = NoiseCovariance::low_rank(&[0.1, 0.1], mat![[0.3], [0.3]].as_ref())?;
    /// assert_eq!(noise.n_obs(), 2);
    /// # Ok::<(), tissuereg_esmda::EsmdaError>(())
    /// ```
    pub fn low_rank(std: &[f64], columns: MatRef<'_, f64>) -> Result<Self, EsmdaError> {
        check_std(std)?;
        check_shape("columns", columns.shape(), (std.len(), columns.ncols()))?;
        if columns.ncols() == 0 {
            return Self::diagonal(std);
        }
        Ok(Self { root: Root::LowRank(LowRank::new(std, columns)?) })
    }

    /// Correlated noise: a full covariance, (`n_obs`, `n_obs`).
    ///
    /// # Errors
    ///
    /// [`EsmdaError::Shape`] if it is not square, [`EsmdaError::NoiseNotFinite`], [`EsmdaError::NoiseNotSymmetric`],
    /// [`EsmdaError::NoiseNotPositiveDefinite`] with the failing pivot.
    ///
    /// # Cost
    ///
    /// One Cholesky factorisation, `n_obs^3 / 3` multiply-adds.
    pub fn dense(covariance: MatRef<'_, f64>) -> Result<Self, EsmdaError> {
        check_symmetric(covariance)?;
        let mut lower = covariance.to_owned();
        linalg::cholesky_in_place(lower.as_mut())
            .map_err(|pivot| EsmdaError::NoiseNotPositiveDefinite { pivot })?;
        Ok(Self { root: Root::Lower(lower) })
    }

    /// Number of observations.
    pub fn n_obs(&self) -> usize {
        match &self.root {
            Root::Diagonal(std) => std.len(),
            Root::Lower(lower) => lower.nrows(),
            Root::LowRank(low_rank) => low_rank.std.len(),
        }
    }

    /// The standard deviations, where the noise of no observation depends on another's.
    pub(crate) fn independent(&self) -> Option<&[f64]> {
        match &self.root {
            Root::Diagonal(std) => Some(std),
            Root::Lower(_) | Root::LowRank(_) => None,
        }
    }

    /// Divides the rows of the transpose by the noise: `columns <- columns L^-T`.
    ///
    /// # Shapes
    ///
    /// `columns` is (anything, `n_obs`): one observation a column. Every row is treated on its own.
    pub(crate) fn whiten_in_place(&self, mut columns: MatMut<'_, f64>, par: Par) {
        match &self.root {
            Root::Diagonal(std) => {
                for (obs, std) in std.iter().enumerate() {
                    columns.rb_mut().col_mut(obs).iter_mut().for_each(|value| *value /= std);
                }
            }
            Root::Lower(lower) => linalg::for_row_chunks(columns, par, |chunk| {
                faer::linalg::triangular_solve::solve_lower_triangular_in_place(
                    lower.as_ref(),
                    chunk.transpose_mut(),
                    Par::Seq,
                );
            }),
            Root::LowRank(low_rank) => low_rank.whiten(columns, par),
        }
    }

    /// The opposite of whitening: `columns <- columns L'`, shapes as there.
    pub(crate) fn colour_in_place(&self, mut columns: MatMut<'_, f64>, par: Par) {
        match &self.root {
            Root::Diagonal(std) => {
                for (obs, std) in std.iter().enumerate() {
                    columns.rb_mut().col_mut(obs).iter_mut().for_each(|value| *value *= std);
                }
            }
            Root::Lower(lower) => linalg::for_row_chunks(columns, par, |mut chunk| {
                let whole = BlockStructure::Rectangular;
                let white = chunk.rb().to_owned();
                matmul(
                    chunk.rb_mut(),
                    whole,
                    Accum::Replace,
                    white.as_ref(),
                    whole,
                    lower.transpose(),
                    BlockStructure::TriangularUpper,
                    1.0,
                    Par::Seq,
                );
            }),
            Root::LowRank(low_rank) => low_rank.colour(columns, par),
        }
    }

    /// A gain on whitened observations made one on observations: `columns <- columns L^-1`, shapes as there.
    pub(crate) fn unscale_gain_in_place(&self, columns: MatMut<'_, f64>, par: Par) {
        match &self.root {
            Root::Diagonal(_) => self.whiten_in_place(columns, par),
            Root::Lower(lower) => linalg::for_row_chunks(columns, par, |chunk| {
                faer::linalg::triangular_solve::solve_upper_triangular_in_place(
                    lower.transpose(),
                    chunk.transpose_mut(),
                    Par::Seq,
                );
            }),
            Root::LowRank(low_rank) => low_rank.unscale(columns, par),
        }
    }
}

fn check_std(std: &[f64]) -> Result<(), EsmdaError> {
    let wrong = |std: &f64| !(std.is_finite() && *std > 0.0);
    match std.iter().copied().enumerate().find(|(_, std)| wrong(std)) {
        Some((obs, std)) => Err(EsmdaError::NoiseStd { obs, std }),
        None => Ok(()),
    }
}

fn check_symmetric(covariance: MatRef<'_, f64>) -> Result<(), EsmdaError> {
    let n_obs = covariance.nrows();
    check_shape("covariance", covariance.shape(), (n_obs, n_obs))?;
    if let Some((row, column, value)) = find(covariance, |value| !value.is_finite()) {
        return Err(EsmdaError::NoiseNotFinite { row, column, value });
    }
    match find_asymmetry(covariance) {
        Some((row, column, value, mirrored)) => {
            Err(EsmdaError::NoiseNotSymmetric { row, column, value, mirrored })
        }
        None => Ok(()),
    }
}
