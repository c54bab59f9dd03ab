//! Coefficients chosen as the assimilation goes, from how far the predictions are from the data.
//!
//! A step far from the data is kept small, as a linear model of it holds only nearby; a step near the data may be
//! large. Every rule proposes a share `1 / alpha` of the data for the next step, and the last step takes what is left,
//! so that the shares add up to one as those of any [`Schedule`](super::Schedule) do.

use faer::{Mat, MatRef, Par};

use crate::check::{check_finite, check_shape, check_update};
use crate::{EsmdaError, NoiseCovariance};

/// How the next coefficient follows from the misfits `phi_j = |L^-1 (d - y_j)|^2 / 2` of the members, `C_d = L L'`.
///
/// `m` is the number of observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum AdaptiveRule {
    /// Data misfit controller: `1 / alpha = max(m / (2 mean phi), sqrt(m / (2 var phi)))`.
    ///
    /// The step in which the tempered likelihood changes by about as much as its noise explains.
    /// M. Iglesias and Y. Yang, "Adaptive regularisation for ensemble Kalman inversion", Inverse Problems 37, 025008,
    /// 2021, doi:10.1088/1361-6420/abd29b.
    DataMisfit,
    /// Restricted step: `alpha = mean phi / (4 m)`, a proposal that the caller doubles while
    /// [`largest_change`] of the update exceeds two prior standard deviations.
    ///
    /// D. H. Le, A. A. Emerick and A. C. Reynolds, "An adaptive ensemble smoother with multiple data assimilation for
    /// assisted history matching", SPE Journal 21, 2195-2207, 2016, doi:10.2118/173214-PA.
    RestrictedStep,
}

/// The coefficient of the next step, dimensionless.
///
/// `assimilated` is the sum of `1 / alpha` over the steps made, zero before the first. At most `steps_left` steps are
/// to follow, this one counted: a share is never smaller than the first of a geometric schedule of that many steps
/// with each coefficient half the one before, so the last step closes the sum and no model that cannot explain its
/// data keeps a schedule from ending.
///
/// # Shapes
///
/// `predicted` is (`n_obs`, `n_members`), `observed` is (`n_obs`); both in the unit of the root of `noise`.
///
/// # Errors
///
/// [`EsmdaError::ScheduleSum`] unless `0 <= assimilated < 1`; [`EsmdaError::EmptySchedule`] for no steps left;
/// [`EsmdaError::NoObservations`], [`EsmdaError::TooFewMembers`], [`EsmdaError::Shape`] and [`EsmdaError::NotFinite`]
/// for the arrays; [`EsmdaError::Overflow`] where a misfit leaves the range of `f64`.
///
/// # Cost
///
/// Whitening of one matrix (`n_obs`, `n_members`) and one pass over it.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::faer::mat;
/// use tissuereg_esmda::{AdaptiveRule, NoiseCovariance, Schedule, next_alpha};
///
/// let noise = NoiseCovariance::diagonal(&[1.0])?;
/// let rule = AdaptiveRule::DataMisfit;
/// // Predictions nine and eleven deviations off: a small share first.
/// let far = next_alpha(rule, mat![[9.0, 11.0]].as_ref(), &[0.0], &noise, 0.0, 20)?;
/// // Near the data the rest is taken at once.
/// let near = next_alpha(rule, mat![[0.1, 0.2]].as_ref(), &[0.0], &noise, 1.0 / far, 19)?;
/// assert!(far > 10.0);
/// assert!(Schedule::from_alphas(&[far, near]).is_ok());
/// # Ok::<(), tissuereg_esmda::EsmdaError>(())
/// ```
pub fn next_alpha(
    rule: AdaptiveRule,
    predicted: MatRef<'_, f64>,
    observed: &[f64],
    noise: &NoiseCovariance,
    assimilated: f64,
    steps_left: usize,
) -> Result<f64, EsmdaError> {
    if !(0.0..1.0).contains(&assimilated) {
        return Err(EsmdaError::ScheduleSum { sum: assimilated, wanted: 1.0 });
    }
    let steps = i32::try_from(steps_left.min(1000)).unwrap_or(1000);
    if steps == 0 {
        return Err(EsmdaError::EmptySchedule);
    }
    let (mean, variance) = misfit_moments(&misfits(predicted, observed, noise)?);
    if !(mean.is_finite() && variance.is_finite()) {
        return Err(EsmdaError::Overflow);
    }
    let n_obs = observed.len() as f64;
    let share = match rule {
        AdaptiveRule::DataMisfit => (n_obs / (2.0 * mean)).max((n_obs / (2.0 * variance)).sqrt()),
        AdaptiveRule::RestrictedStep => 4.0 * n_obs / mean,
    };
    let remaining = 1.0 - assimilated;
    let least = remaining / (2.0_f64.powi(steps) - 1.0);
    // A misfit of zero gives an infinite share, and never 0 / 0: there are observations.
    Ok(1.0 / share.max(least).min(remaining))
}

/// Largest absolute change of a parameter of any member, in the standard deviations given.
///
/// # Shapes
///
/// `before` and `after` are (`n_parameters`, `n_members`), `std` is (`n_parameters`), each row in its own unit.
///
/// # Errors
///
/// [`EsmdaError::Shape`] and [`EsmdaError::NotFinite`] by name; [`EsmdaError::ParameterStd`] for a standard deviation
/// that is not positive and finite.
pub fn largest_change(
    before: MatRef<'_, f64>,
    after: MatRef<'_, f64>,
    std: &[f64],
) -> Result<f64, EsmdaError> {
    let wanted = (std.len(), before.ncols());
    check_shape("before", before.shape(), wanted)?;
    check_shape("after", after.shape(), wanted)?;
    let mut largest = 0.0_f64;
    for (row, &deviation) in std.iter().enumerate() {
        if !(deviation.is_finite() && deviation > 0.0) {
            return Err(EsmdaError::ParameterStd { row, std: deviation });
        }
        for column in 0..before.ncols() {
            let change = (after[(row, column)] - before[(row, column)]).abs() / deviation;
            if !change.is_finite() {
                let (argument, value) = ("after", after[(row, column)]);
                return Err(EsmdaError::NotFinite { argument, row, column, value });
            }
            largest = largest.max(change);
        }
    }
    Ok(largest)
}

/// `phi_j` of every member.
fn misfits(
    predicted: MatRef<'_, f64>,
    observed: &[f64],
    noise: &NoiseCovariance,
) -> Result<Vec<f64>, EsmdaError> {
    check_update(predicted, observed, noise)?;
    check_finite("observed", MatRef::from_column_major_slice(observed, observed.len(), 1))?;
    check_finite("predicted", predicted)?;
    let (n_obs, n_members) = predicted.shape();
    let mut innovations =
        Mat::from_fn(n_members, n_obs, |member, obs| observed[obs] - predicted[(obs, member)]);
    noise.whiten_in_place(innovations.as_mut(), Par::Seq);
    Ok(innovations.row_iter().map(|row| row.squared_norm_l2() / 2.0).collect())
}

/// Mean, and variance over `n - 1`.
fn misfit_moments(misfits: &[f64]) -> (f64, f64) {
    let n = misfits.len() as f64;
    let mean = misfits.iter().sum::<f64>() / n;
    let squares = misfits.iter().map(|misfit| (misfit - mean).powi(2)).sum::<f64>();
    (mean, squares / (n - 1.0))
}
