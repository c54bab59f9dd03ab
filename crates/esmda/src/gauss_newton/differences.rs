//! Derivatives along the columns of the prior's root by central differences, from one batch of predictions.

use faer::{Mat, MatRef};

use crate::{EsmdaError, Gaussian};

/// The point, then for each prior direction its neighbours at `+h` and `-h` standard deviations: (n, 2 n + 1).
pub(super) fn stencil(point: &[f64], prior: &Gaussian, h: f64) -> Mat<f64> {
    let root = prior.root();
    Mat::from_fn(point.len(), 2 * point.len() + 1, |row, column| match column {
        0 => point[row],
        _ => {
            let sign = if column % 2 == 1 { h } else { -h };
            point[row] + sign * root[(row, (column - 1) / 2)]
        }
    })
}

/// `G M` (n_obs, n) from the predictions of a stencil, and the directions of which one side failed.
///
/// There the difference is one-sided, with an error of order `h` in place of `h^2`.
pub(super) fn sensitivity(
    predicted: MatRef<'_, f64>,
    h: f64,
    largest: f64,
) -> Result<(Mat<f64>, Vec<usize>), EsmdaError> {
    let (n_obs, n_columns) = predicted.shape();
    let n = n_columns / 2;
    let works = |column: usize| predicted.col(column).iter().all(|value| value.abs() <= largest);
    let mut slopes = Mat::zeros(n_obs, n);
    let mut one_sided = Vec::new();
    for direction in 0..n {
        let (plus, minus) = (2 * direction + 1, 2 * direction + 2);
        let (upper, lower, width) = match (works(plus), works(minus)) {
            (true, true) => (plus, minus, 2.0 * h),
            (true, false) => (plus, 0, h),
            (false, true) => (0, minus, h),
            (false, false) => return Err(EsmdaError::NoDifference { direction }),
        };
        if width == h {
            one_sided.push(direction);
        }
        for obs in 0..n_obs {
            slopes[(obs, direction)] = (predicted[(obs, upper)] - predicted[(obs, lower)]) / width;
        }
    }
    Ok((slopes, one_sided))
}
