//! One ES-MDA update as a value: `prepare` returns a [`Step`] with `apply`.
//!
//! With `n` members, `m` observations, `p` parameters, and primes for "less the ensemble mean",
//!
//! ```text
//! S = L^-1 Y' / sqrt((n - 1) alpha)                                   C_d = L L'
//! (m, n)
//! R = L^-1 (d - Y) / sqrt((n - 1) alpha) + E / sqrt(n - 1)            E: standard normals
//! (m, n)
//! X <- X + X' W,    W = S' (S S' + I)^-1 R = (S' S + I)^-1 S' R       (S' here: transposed)
//! (p, n) (p, n)(n, n)
//! ```
//!
//! which is `x_i + C_xy (C_yy + alpha C_d)^-1 (d + sqrt(alpha) L e_i - y_i)` with all covariances those of the ensemble.
//! `W` knows nothing of the parameters, so they may come in any number of batches of rows.
//!
//! The order of operations was chosen so that small noise does no harm and no product is larger than needed:
//!
//! * Whiten first. The matrix to be solved with is then `I` plus something, its smallest eigenvalue one.
//! * Work on the smaller side: `S S' + I` (m, m) or `S' S + I` (n, n).
//! * Cholesky while the matrix is well conditioned (a bound from its largest row sum, at no cost); else QR of `[S'; I]`,
//!   which never forms the square and sees only the root of the condition number. Singular values on request; the
//!   square-root form needs them. No inverse is formed and nothing is truncated: `w / (1 + w^2)` is the regularisation.
//! * With few observations `W` stays in factors, so that a batch of `p` parameters costs about `2 p m n` multiply-adds
//!   and preparation no `m n^2`; with more than half as many observations as members it is multiplied out.

mod gain;
mod rows;
mod settings;

use faer::prelude::Reborrow;
use faer::{MatMut, MatRef, Par};

use self::gain::Gain;
use self::rows::{Ensemble, Scaled, centred_transpose, check_matrix};
pub use self::settings::{Factorisation, Side, StepReport, StepSettings};
use crate::check::{check_rows, check_shape};
use crate::error::EsmdaError;
use crate::linalg;
use crate::noise::NoiseCovariance;
use crate::schedule::check_alpha;

/// One update of an ensemble, ready to be applied to any parameters of the same members.
///
/// See the [module documentation](self) for the formula, and the crate's first page for an example whose answer is
/// known.
#[derive(Debug, Clone)]
pub struct Step {
    n_members: usize,
    par: Par,
    gain: Gain,
    report: StepReport,
}

impl Step {
    /// Prepares a stochastic step: every member is drawn to its own perturbed observation.
    ///
    /// # Shapes
    ///
    /// `predicted` and `draws` are (`n_obs`, `n_members`), `observed` is (`n_obs`). `predicted`, `observed` and the root
    /// of `noise` share one unit; `draws` are standard normals, one column a member, and `alpha` has no unit.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::NoObservations`]; [`EsmdaError::TooFewMembers`] for fewer than two; [`EsmdaError::Shape`],
    /// [`EsmdaError::NotFinite`], [`EsmdaError::TooLarge`] for an argument by name; [`EsmdaError::Alpha`];
    /// [`EsmdaError::Overflow`] where the noise is so small that whitened numbers leave the range of `f64`;
    /// [`EsmdaError::NoConvergence`] where singular values are requested and not found.
    ///
    /// # Cost
    ///
    /// With `k = min(n_obs, n_members)`: `k^2 max(n_obs, n_members) / 2 + k^3 / 3` multiply-adds by Cholesky.
    pub fn prepare(
        predicted: MatRef<'_, f64>,
        observed: &[f64],
        noise: &NoiseCovariance,
        alpha: f64,
        draws: MatRef<'_, f64>,
        settings: &StepSettings,
    ) -> Result<Self, EsmdaError> {
        let (draws, largest) = (Some(draws), settings.largest);
        let ensemble = Ensemble { predicted, observed, noise, alpha, draws, largest };
        let Scaled { anomalies, innovations } = scaled(&ensemble, settings.par)?;
        let (gain, report) = Gain::stochastic(anomalies, innovations, settings)?;
        Ok(Self { n_members: predicted.ncols(), par: settings.par, gain, report })
    }

    /// Prepares a deterministic step, the symmetric square root (ETKF): `W = w 1' + (I + S' S)^-1/2 - I`.
    ///
    /// The mean moves by the Kalman gain and the anomalies shrink to exactly the posterior covariance of the ensemble's
    /// Gaussian; no draws, so no sampling error of theirs. It transforms the whole ensemble linearly: outliers stay
    /// outliers.
    ///
    /// # Shapes
    ///
    /// As [`Step::prepare`], without draws. `settings.factorisation` and `side` play no part.
    ///
    /// # Errors
    ///
    /// As [`Step::prepare`]; [`EsmdaError::NoConvergence`] if the singular values are not found.
    ///
    /// # Reference
    ///
    /// C. H. Bishop, B. J. Etherton and S. J. Majumdar, "Adaptive sampling with the ensemble transform Kalman filter",
    /// Monthly Weather Review 129, 420-436, 2001.
    pub fn prepare_square_root(
        predicted: MatRef<'_, f64>,
        observed: &[f64],
        noise: &NoiseCovariance,
        alpha: f64,
        settings: &StepSettings,
    ) -> Result<Self, EsmdaError> {
        let (draws, largest) = (None, settings.largest);
        let ensemble = Ensemble { predicted, observed, noise, alpha, draws, largest };
        let Scaled { anomalies, innovations } = scaled(&ensemble, settings.par)?;
        let (gain, report) = Gain::square_root(&anomalies, &innovations)?;
        Ok(Self { n_members: predicted.ncols(), par: settings.par, gain, report })
    }

    /// Updates parameters in place: `X <- X + (X - mean X) W`.
    ///
    /// # Shapes
    ///
    /// `parameters` is (anything, `n_members`), one row a parameter in its own unit. Rows do not see each other.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::Shape`] or [`EsmdaError::NotFinite`], before anything is written.
    ///
    /// # Cost
    ///
    /// About `2 k n_members` multiply-adds a row, with `k = min(n_obs, n_members)`.
    pub fn apply(&self, parameters: MatMut<'_, f64>) -> Result<(), EsmdaError> {
        let wanted = (parameters.nrows(), self.n_members);
        check_matrix("parameters", parameters.rb(), wanted)?;
        linalg::for_row_chunks(parameters, self.par, |rows| {
            let anomalies = centred_transpose(rows.rb());
            self.gain.add_to(rows, anomalies);
        });
        Ok(())
    }

    /// The same into other memory, in one pass: `updated` is `X + (X - mean X) W`, whatever it held.
    ///
    /// # Shapes
    ///
    /// `parameters` and `updated` are (anything, `n_members`).
    ///
    /// # Errors
    ///
    /// As [`Step::apply`]; rows of `updated` may then have been written.
    ///
    /// # Cost
    ///
    /// As [`Step::apply`], which reads the parameters twice.
    pub fn apply_to(
        &self,
        parameters: MatRef<'_, f64>,
        updated: MatMut<'_, f64>,
    ) -> Result<(), EsmdaError> {
        let wanted = (parameters.nrows(), self.n_members);
        check_shape("parameters", parameters.shape(), wanted)?;
        check_shape("updated", updated.shape(), wanted)?;
        linalg::try_for_row_chunks(updated, self.par, |row_0, mut updated| {
            let rows = parameters.get(row_0..row_0 + updated.nrows(), ..);
            check_rows("parameters", row_0, rows)?;
            updated.copy_from(rows);
            self.gain.add_to(updated, centred_transpose(rows));
            Ok(())
        })
    }

    /// Number of members the step was prepared for.
    pub fn n_members(&self) -> usize {
        self.n_members
    }

    /// How it was prepared.
    pub fn report(&self) -> StepReport {
        self.report
    }
}

/// Checks the arguments; `S'` and `R'`.
fn scaled(ensemble: &Ensemble<'_>, par: Par) -> Result<Scaled, EsmdaError> {
    let Ensemble { predicted, observed, noise, alpha, draws, .. } = *ensemble;
    let (n_obs, n_members) = predicted.shape();
    if n_obs == 0 {
        return Err(EsmdaError::NoObservations);
    }
    if n_members < 2 {
        let dropped = Vec::new();
        return Err(EsmdaError::TooFewMembers { kept: n_members, minimum: 2, dropped });
    }
    check_shape("observed", (observed.len(), 1), (n_obs, 1))?;
    check_shape("noise", (noise.n_obs(), 1), (n_obs, 1))?;
    check_alpha(0, alpha)?;
    check_matrix("observed", MatRef::from_column_major_slice(observed, n_obs, 1), (n_obs, 1))?;
    if let Some(draws) = draws {
        check_shape("draws", draws.shape(), predicted.shape())?;
    }
    Scaled::new(ensemble, par)
}
