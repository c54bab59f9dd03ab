//! A step whose gain is damped, parameter by parameter and observation by observation.
//!
//! Few members show chance correlations between quantities that have nothing to do with each other. With `rho` in
//! [0, 1], one row a parameter and one column an observation, the stochastic step becomes
//!
//! ```text
//! x_i <- x_i + (rho o K) (d + sqrt(alpha) L e_i - y_i),    K = C_xy (C_yy + alpha C_d)^-1
//! ```
//!
//! so that an observation does not move a parameter at all where `rho` is zero. With ones everywhere it is
//! [`Step::prepare`](super::Step::prepare). `K` is made a block of rows at a time: memory beside the arguments is
//! two matrices (`n_members`, `n_obs`) and a block (64, `n_obs`) a thread.

use faer::prelude::{Reborrow, ReborrowMut};
use faer::{Mat, MatMut, MatRef, Par};
use rayon::prelude::*;

use super::rows::{Ensemble, Scaled, centred_transpose, check_matrix};
use super::{StepSettings, scaled};
use crate::check::{check_shape, find};
use crate::linalg::{self, product};
use crate::{EsmdaError, NoiseCovariance};

/// Rows of the gain that are made at a time.
const BLOCK_ROWS: usize = 64;

/// Where the factors `rho` come from.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub enum Taper<'a> {
    /// From the caller, (`n_parameters`, `n_obs`), each in [0, 1]; see [`gaspari_cohn`] for factors of distances.
    Given(MatRef<'a, f64>),
    /// One where the sample correlation of parameter and prediction exceeds `threshold` in absolute value, zero
    /// elsewhere.
    Threshold(f64),
    /// `gaspari_cohn((1 - |r|) / (1 - threshold))` of the sample correlation `r`: one at full correlation, 0.21 at
    /// the threshold, zero where `1 - |r|` is twice as much as there.
    ///
    /// X. Luo and T. Bhakta, "Automatic and adaptive localization for ensemble-based history matching", Journal of
    /// Petroleum Science and Engineering 184, 106559, 2020, doi:10.1016/j.petrol.2019.106559.
    Smooth(f64),
}

impl Taper<'_> {
    /// `3 / sqrt(n_members)`, at most one: sample correlations of independent quantities stay below it almost always.
    pub fn default_threshold(n_members: usize) -> f64 {
        (3.0 / (n_members as f64).sqrt()).min(1.0)
    }
}

/// The fifth-order function of compact support of Gaspari and Cohn: one at zero, 5/24 at one, zero from two on.
///
/// `ratio` is a distance over half the distance of no influence.
///
/// G. Gaspari and S. E. Cohn, "Construction of correlation functions in two and three dimensions", Quarterly Journal
/// of the Royal Meteorological Society 125, 723-757, 1999, equation 4.10.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::gaspari_cohn;
///
/// assert_eq!(gaspari_cohn(0.0), 1.0);
/// assert!((gaspari_cohn(1.0) - 5.0 / 24.0).abs() < 1e-15);
/// assert_eq!(gaspari_cohn(2.0), 0.0);
/// ```
pub fn gaspari_cohn(ratio: f64) -> f64 {
    let z = ratio.abs();
    if z <= 1.0 {
        1.0 + z * z * (-5.0 / 3.0 + z * (5.0 / 8.0 + z * (0.5 - 0.25 * z)))
    } else if z < 2.0 {
        let inner = -5.0 + z * (5.0 / 3.0 + z * (5.0 / 8.0 + z * (-0.5 + z / 12.0)));
        // Rounding may leave -1e-16 near two.
        (4.0 + z * inner - 2.0 / (3.0 * z)).max(0.0)
    } else {
        0.0
    }
}

/// One localized stochastic update, ready to be applied to any parameters of the same members.
#[derive(Debug, Clone)]
pub struct LocalizedStep {
    par: Par,
    /// `G` with `K = X' G`, (`n_members`, `n_obs`).
    gain: Mat<f64>,
    /// Perturbed innovations over `sqrt(n_members - 1)` and the root of `alpha`, transposed: (`n_members`, `n_obs`).
    innovations: Mat<f64>,
    /// Directions of the predictions' anomalies, of length one or zero: (`n_members`, `n_obs`).
    directions: Mat<f64>,
}

impl LocalizedStep {
    /// Prepares it; arguments, shapes and errors as [`Step::prepare`](super::Step::prepare).
    ///
    /// Singular values are used whatever `settings.factorisation`; `settings.truncation` counts.
    ///
    /// # Cost
    ///
    /// Singular values of (`n_members`, `n_obs`), three matrices of that size kept.
    pub fn prepare(
        predicted: MatRef<'_, f64>,
        observed: &[f64],
        noise: &NoiseCovariance,
        alpha: f64,
        draws: MatRef<'_, f64>,
        settings: &StepSettings,
    ) -> Result<Self, EsmdaError> {
        let (draws, largest, par) = (Some(draws), settings.largest, settings.par);
        let ensemble = Ensemble { predicted, observed, noise, alpha, draws, largest };
        let Scaled { anomalies, mut innovations } = scaled(&ensemble, settings)?;
        let (n_members, n_obs) = anomalies.shape();
        let failed = EsmdaError::NoConvergence { n_obs, n_members };
        let svd = linalg::thin_svd(anomalies.as_ref()).ok_or(failed)?;
        let mut left = svd.u;
        for (k, &w) in svd.w.iter().enumerate() {
            left.col_mut(k).iter_mut().for_each(|value| *value *= w / (1.0 + w * w));
        }
        let mut gain = product(left.as_ref(), svd.v.transpose());
        noise.unscale_gain_in_place(gain.as_mut(), par);
        noise.colour_in_place(innovations.as_mut(), par);
        let mut directions = centred_transpose(predicted);
        directions.col_iter_mut().for_each(|column| normalise(column.try_as_col_major_mut()));
        Ok(Self { par, gain, innovations, directions })
    }

    /// Updates parameters in place.
    ///
    /// # Shapes
    ///
    /// `parameters` is (`n_parameters`, `n_members`), one row a parameter in its own unit. Rows do not see each other:
    /// they may come in batches, each with its rows of the taper.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::Shape`], [`EsmdaError::NotFinite`] and [`EsmdaError::Taper`] (a factor or threshold outside
    /// [0, 1]), before anything is written.
    ///
    /// # Cost
    ///
    /// About `2 n_obs n_members` multiply-adds a row, three with correlations.
    pub fn apply(&self, parameters: MatMut<'_, f64>, taper: Taper<'_>) -> Result<(), EsmdaError> {
        let (n_members, n_obs) = self.gain.shape();
        check_matrix("parameters", parameters.rb(), (parameters.nrows(), n_members))?;
        check_taper(taper, (parameters.nrows(), n_obs))?;
        let update = |(block, rows): (usize, MatMut<'_, f64>)| {
            self.update_block(rows, block * BLOCK_ROWS, taper);
        };
        if matches!(self.par, Par::Seq) {
            let (mut rest, mut block) = (parameters, 0);
            while rest.nrows() > 0 {
                let n_rows = rest.nrows().min(BLOCK_ROWS);
                let (rows, after) = rest.split_at_row_mut(n_rows);
                update((block, rows));
                (rest, block) = (after, block + 1);
            }
        } else {
            parameters.par_row_chunks_mut(BLOCK_ROWS).enumerate().for_each(update);
        }
        Ok(())
    }

    /// Number of members the step was prepared for.
    pub fn n_members(&self) -> usize {
        self.gain.nrows()
    }

    fn update_block(&self, mut rows: MatMut<'_, f64>, first: usize, taper: Taper<'_>) {
        let anomalies = centred_transpose(rows.rb());
        let mut gain = product(anomalies.transpose(), self.gain.as_ref());
        match taper {
            Taper::Given(factors) => {
                let factors = factors.get(first..first + rows.nrows(), ..);
                multiply(&mut gain, |row, obs| factors[(row, obs)]);
            }
            Taper::Threshold(threshold) => {
                let correlations = self.correlations(anomalies);
                let factor = |r: f64| if r.abs() > threshold { 1.0 } else { 0.0 };
                multiply(&mut gain, |row, obs| factor(correlations[(row, obs)]));
            }
            Taper::Smooth(threshold) => {
                let correlations = self.correlations(anomalies);
                let factor = |r: f64| gaspari_cohn((1.0 - r.abs().min(1.0)) / (1.0 - threshold));
                multiply(&mut gain, |row, obs| factor(correlations[(row, obs)]));
            }
        }
        let change = product(gain.as_ref(), self.innovations.transpose());
        for column in 0..change.ncols() {
            let values = rows.rb_mut().col_mut(column);
            for (value, change) in values.iter_mut().zip(change.col(column).iter()) {
                *value += change;
            }
        }
    }

    /// Sample correlations of parameters and predictions, zero where one has no spread: (rows, `n_obs`).
    fn correlations(&self, mut anomalies: Mat<f64>) -> Mat<f64> {
        anomalies.col_iter_mut().for_each(|column| normalise(column.try_as_col_major_mut()));
        product(anomalies.transpose(), self.directions.as_ref())
    }
}

/// Makes a vector one of length one, unless it is zero.
fn normalise(column: Option<faer::col::ColMut<'_, f64, usize, faer::ContiguousFwd>>) {
    let Some(column) = column else { return };
    let values = column.as_slice_mut();
    // Over the largest first: squares of tiny anomalies would underflow.
    let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    if largest == 0.0 {
        return;
    }
    values.iter_mut().for_each(|value| *value /= largest);
    let length = values.iter().map(|value| value * value).sum::<f64>().sqrt();
    values.iter_mut().for_each(|value| *value /= length);
}

fn multiply(gain: &mut Mat<f64>, factor: impl Fn(usize, usize) -> f64) {
    for obs in 0..gain.ncols() {
        for (row, value) in gain.col_mut(obs).iter_mut().enumerate() {
            *value *= factor(row, obs);
        }
    }
}

fn check_taper(taper: Taper<'_>, wanted: (usize, usize)) -> Result<(), EsmdaError> {
    match taper {
        Taper::Given(factors) => {
            check_shape("taper", factors.shape(), wanted)?;
            match find(factors, |value| !(0.0..=1.0).contains(&value)) {
                Some((row, column, value)) => Err(EsmdaError::Taper { row, column, value }),
                None => Ok(()),
            }
        }
        Taper::Threshold(threshold) if (0.0..=1.0).contains(&threshold) => Ok(()),
        Taper::Smooth(threshold) if (0.0..1.0).contains(&threshold) => Ok(()),
        Taper::Threshold(value) | Taper::Smooth(value) => Err(EsmdaError::Threshold { value }),
    }
}
