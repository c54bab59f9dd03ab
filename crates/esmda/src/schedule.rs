//! Inflation coefficients: how one observation is spread over several steps.
//!
//! Assimilating the same data `n` times with its covariance multiplied by `alpha_1 .. alpha_n` equals, in the linear
//! Gaussian case, assimilating it once exactly if `sum 1 / alpha_i = 1`. With `sum 1 / alpha_i = c` the posterior
//! precision is `I + c G' C_d^-1 G`: the data count `c` times. So the sum is checked, to 1e-9.
//!
//! Reference: A. A. Emerick and A. C. Reynolds, "Ensemble smoother with multiple data assimilation", Computers &
//! Geosciences 55, 3-15, 2013, doi:10.1016/j.cageo.2012.03.011.

use crate::EsmdaError;

/// How far the sum of the inverse coefficients may lie from what it must be.
pub const SUM_TOLERANCE: f64 = 1e-9;

/// Checked inflation coefficients, one per step, dimensionless.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::Schedule;
///
/// assert_eq!(Schedule::constant(4)?.alphas(), [4.0; 4]);
/// // Each coefficient half the one before: the late steps, made on a better ensemble, count more.
/// assert_eq!(Schedule::geometric(3, 2.0)?.alphas(), [7.0, 3.5, 1.75]);
/// assert!(Schedule::from_alphas(&[28.0 / 3.0, 7.0, 4.0, 2.0]).is_ok());
/// // The data counted twice, on purpose.
/// assert!(Schedule::with_total(&[1.0, 1.0], 2.0).is_ok());
/// # Ok::<(), tissuereg_esmda::EsmdaError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    alphas: Vec<f64>,
}

impl Schedule {
    /// `n_steps` equal coefficients, each `n_steps`.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::EmptySchedule`] for no steps.
    pub fn constant(n_steps: usize) -> Result<Self, EsmdaError> {
        Self::geometric(n_steps, 1.0)
    }

    /// `n_steps` coefficients, each the one before over `decrease`:
    /// `alpha_i = alpha_0 / decrease^i`, `alpha_0 = sum_i decrease^i`.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::EmptySchedule`] for no steps; [`EsmdaError::Decrease`] if `decrease` is not positive and finite or so
    /// large or small that a coefficient leaves the range of `f64`.
    pub fn geometric(n_steps: usize, decrease: f64) -> Result<Self, EsmdaError> {
        if n_steps == 0 {
            return Err(EsmdaError::EmptySchedule);
        }
        let powers = std::iter::successors(Some(1.0_f64), |power| Some(power * decrease));
        let powers: Vec<f64> = powers.take(n_steps).collect();
        let first: f64 = powers.iter().sum();
        let alphas: Vec<f64> = powers.iter().map(|power| first / power).collect();
        let in_range = alphas.iter().all(|alpha| alpha.is_finite() && *alpha > 0.0);
        if !(decrease.is_finite() && decrease > 0.0 && in_range) {
            return Err(EsmdaError::Decrease { decrease, n_steps });
        }
        Self::from_alphas(&alphas)
    }

    /// A given list.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::EmptySchedule`] for an empty list, [`EsmdaError::Alpha`] for a coefficient that is not positive and
    /// finite, [`EsmdaError::ScheduleSum`] if the inverses do not add up to one within [`SUM_TOLERANCE`].
    pub fn from_alphas(alphas: &[f64]) -> Result<Self, EsmdaError> {
        Self::with_total(alphas, 1.0)
    }

    /// A given list whose inverses add up to `total` on purpose: the data count `total` times.
    ///
    /// # Errors
    ///
    /// As [`Schedule::from_alphas`], with `total` in place of one.
    pub fn with_total(alphas: &[f64], total: f64) -> Result<Self, EsmdaError> {
        if alphas.is_empty() {
            return Err(EsmdaError::EmptySchedule);
        }
        for (step, &alpha) in alphas.iter().enumerate() {
            check_alpha(step, alpha)?;
        }
        let sum: f64 = alphas.iter().map(|alpha| 1.0 / alpha).sum();
        // Written so that a NaN total is refused as well.
        if (sum - total).abs() < SUM_TOLERANCE {
            Ok(Self { alphas: alphas.to_vec() })
        } else {
            Err(EsmdaError::ScheduleSum { sum, wanted: total })
        }
    }

    /// The coefficients, in the order of the steps.
    pub fn alphas(&self) -> &[f64] {
        &self.alphas
    }

    /// Number of steps.
    pub fn n_steps(&self) -> usize {
        self.alphas.len()
    }

    /// The coefficient of one step, counted from zero.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::StepBeyondSchedule`] for one step too many.
    pub fn alpha(&self, step: usize) -> Result<f64, EsmdaError> {
        let n_steps = self.n_steps();
        self.alphas.get(step).copied().ok_or(EsmdaError::StepBeyondSchedule { step, n_steps })
    }
}

/// Refuses a coefficient that is not positive and finite, or whose inverse is not.
pub(crate) fn check_alpha(step: usize, alpha: f64) -> Result<(), EsmdaError> {
    if alpha.is_finite() && alpha > 0.0 && (1.0 / alpha).is_finite() {
        Ok(())
    } else {
        Err(EsmdaError::Alpha { step, alpha })
    }
}
