//! Passes over rows: means, and the transposes `S'` and `R'`.
//!
//! Each entry is read once, from a contiguous slice, by loops without branches, which compile to vector instructions:
//! at surgical size such passes cost as much as the algebra.

use faer::{Mat, MatRef, Par};
use pulp::{Arch, NullaryFnOnce};

use crate::check::{LANES, all_finite, check_finite, check_row, check_shape, row_of};
use crate::{EsmdaError, NoiseCovariance, linalg};

/// Mean, and largest absolute value, of a slice that is not empty.
///
/// The mean is exactly the common value where all are equal. The largest passes over NaN, of which the mean tells.
#[inline(always)]
fn mean_and_largest(values: &[f64]) -> (f64, f64) {
    let (first, mut sums, mut largest) = (values[0], [0.0; LANES], [0.0_f64; LANES]);
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for lane in 0..LANES {
            sums[lane] += chunk[lane] - first;
            // `max` would take three instructions.
            let size = chunk[lane].abs();
            largest[lane] = if size > largest[lane] { size } else { largest[lane] };
        }
    }
    let sum = sums.iter().sum::<f64>() + rest.iter().map(|value| value - first).sum::<f64>();
    let sizes = largest.into_iter().chain(rest.iter().map(|value| value.abs()));
    (first + sum / values.len() as f64, sizes.fold(0.0, f64::max))
}

/// Refuses a matrix of another shape or with an entry that is not finite.
pub(super) fn check_matrix(
    argument: &'static str,
    matrix: MatRef<'_, f64>,
    wanted: (usize, usize),
) -> Result<(), EsmdaError> {
    check_shape(argument, matrix.shape(), wanted)?;
    check_finite(argument, matrix)
}

fn check_prediction(row: usize, values: &[f64], limit: f64) -> Result<(), EsmdaError> {
    check_row("predicted", row, values)?;
    match values.iter().enumerate().find(|(_, value)| value.abs() > limit) {
        Some((column, &value)) => Err(EsmdaError::TooLarge { row, column, value, limit }),
        None => Ok(()),
    }
}

/// Transpose of `rows` with each row's mean subtracted: (columns, rows).
pub(super) fn centred_transpose(rows: MatRef<'_, f64>) -> Mat<f64> {
    let mut centred = Mat::zeros(rows.ncols(), rows.nrows());
    Arch::new().dispatch(Centre { rows, centred: &mut centred });
    centred
}

struct Centre<'a> {
    rows: MatRef<'a, f64>,
    centred: &'a mut Mat<f64>,
}

impl NullaryFnOnce for Centre<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for row in 0..self.rows.nrows() {
            let values = row_of(self.rows, row);
            let (mean, _) = mean_and_largest(&values);
            let targets = self.centred.col_as_slice_mut(row);
            targets.iter_mut().zip(&*values).for_each(|(target, value)| *target = value - mean);
        }
    }
}

/// What a step is made of, checked: `S'` and `R'`, both (`n_members`, `n_obs`), an observation's members together.
pub(super) struct Scaled {
    pub(super) anomalies: Mat<f64>,
    pub(super) innovations: Mat<f64>,
}

/// Arguments of a step, of matching shapes.
pub(super) struct Ensemble<'a> {
    /// (`n_obs`, `n_members`)
    pub(super) predicted: MatRef<'a, f64>,
    pub(super) observed: &'a [f64],
    pub(super) noise: &'a NoiseCovariance,
    pub(super) alpha: f64,
    /// (`n_obs`, `n_members`), or none
    pub(super) draws: Option<MatRef<'a, f64>>,
    /// Largest absolute prediction allowed.
    pub(super) largest: f64,
}

impl Scaled {
    pub(super) fn new(ensemble: &Ensemble<'_>, par: Par) -> Result<Self, EsmdaError> {
        let (n_obs, n_members) = ensemble.predicted.shape();
        let mut anomalies = Mat::zeros(n_members, n_obs);
        let mut innovations = Mat::zeros(n_members, n_obs);
        let arch = Arch::new();
        let work = |obs: usize, anomalies: &mut [f64], innovations: &mut [f64]| {
            arch.dispatch(Fill { ensemble, obs, anomalies, innovations })
        };
        linalg::try_for_column_pairs(anomalies.as_mut(), innovations.as_mut(), par, work)?;
        if ensemble.noise.independent().is_none() {
            for matrix in [&mut anomalies, &mut innovations] {
                ensemble.noise.whiten_in_place(matrix.as_mut(), par);
                for obs in 0..n_obs {
                    finite(matrix.col_as_slice(obs))?;
                }
            }
            if let Some(draws) = ensemble.draws {
                for obs in 0..n_obs {
                    add_row(obs, innovations.col_as_slice_mut(obs), draws)?;
                }
            }
        }
        Ok(Self { anomalies, innovations })
    }
}

/// Fills the columns of one observation; noise that is not independent is left to be whitened, and draws after it.
struct Fill<'a> {
    ensemble: &'a Ensemble<'a>,
    obs: usize,
    anomalies: &'a mut [f64],
    innovations: &'a mut [f64],
}

impl NullaryFnOnce for Fill<'_> {
    type Output = Result<(), EsmdaError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self { ensemble, obs, anomalies, innovations } = self;
        let degrees = (ensemble.predicted.ncols() - 1) as f64;
        let std = ensemble.noise.independent().map(|std| std[obs]);
        let scale = 1.0 / ((degrees * ensemble.alpha).sqrt() * std.unwrap_or(1.0));
        let (values, observed) = (row_of(ensemble.predicted, obs), ensemble.observed[obs]);
        let (mean, largest) = mean_and_largest(&values);
        if !(mean.is_finite() && largest <= ensemble.largest) {
            check_prediction(obs, &values, ensemble.largest)?;
        }
        let entries = anomalies.iter_mut().zip(&mut *innovations).zip(&*values);
        entries.for_each(|((anomaly, innovation), value)| {
            *anomaly = (value - mean) * scale;
            *innovation = (observed - value) * scale;
        });
        if let (Some(draws), Some(_)) = (ensemble.draws, std) {
            add_row(obs, innovations, draws)?;
        }
        finite(anomalies)?;
        finite(innovations)
    }
}

/// Adds a row of standard normals, so scaled that the whole has the covariance of the noise.
#[inline(always)]
fn add_row(obs: usize, innovations: &mut [f64], draws: MatRef<'_, f64>) -> Result<(), EsmdaError> {
    let draws = row_of(draws, obs);
    check_row("draws", obs, &draws)?;
    let scale = 1.0 / ((innovations.len() - 1) as f64).sqrt();
    innovations.iter_mut().zip(&*draws).for_each(|(value, draw)| *value += draw * scale);
    Ok(())
}

#[inline(always)]
fn finite(values: &[f64]) -> Result<(), EsmdaError> {
    if all_finite(values) { Ok(()) } else { Err(EsmdaError::Overflow) }
}
