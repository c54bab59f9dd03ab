//! The observations' noise covariance `C_d`, factored once: `C_d = L L'`.
//!
//! All a step needs is `L^-1` times something (whitening); the covariance is never inverted. Whatever the model itself
//! gets wrong at the observations belongs in `C_d` too, or every posterior is too narrow.

use faer::prelude::ReborrowMut;
use faer::{Mat, MatMut, MatRef, Par};

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
        }
    }

    /// The standard deviations, where the noise of no observation depends on another's.
    pub(crate) fn independent(&self) -> Option<&[f64]> {
        match &self.root {
            Root::Diagonal(std) => Some(std),
            Root::Lower(_) => None,
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
