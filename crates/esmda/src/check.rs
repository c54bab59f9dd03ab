//! Checks of arguments by name.

use faer::MatRef;

use crate::{EsmdaError, NoiseCovariance};

/// Relative asymmetry that rounding may leave in a covariance.
const SYMMETRY_TOLERANCE: f64 = 1e-10;

/// Refuses another shape.
pub(crate) fn check_shape(
    argument: &'static str,
    found: (usize, usize),
    wanted: (usize, usize),
) -> Result<(), EsmdaError> {
    if found == wanted { Ok(()) } else { Err(EsmdaError::Shape { argument, wanted, found }) }
}

/// Refuses an entry that is not finite, naming the first, row by row.
pub(crate) fn check_finite(
    argument: &'static str,
    matrix: MatRef<'_, f64>,
) -> Result<(), EsmdaError> {
    match find(matrix, |value| !value.is_finite()) {
        Some((row, column, value)) => Err(EsmdaError::NotFinite { argument, row, column, value }),
        None => Ok(()),
    }
}

/// The first entry, row by row, of which `wrong` is true.
pub(crate) fn find(
    matrix: MatRef<'_, f64>,
    wrong: impl Fn(f64) -> bool,
) -> Option<(usize, usize, f64)> {
    (0..matrix.nrows()).find_map(|row| {
        let mut entries = matrix.row(row).iter().copied().enumerate();
        entries.find(|(_, value)| wrong(*value)).map(|(column, value)| (row, column, value))
    })
}

/// An entry that is not the one across the diagonal: row, column, the entry, and that one.
pub(crate) fn find_asymmetry(covariance: MatRef<'_, f64>) -> Option<(usize, usize, f64, f64)> {
    let pairs =
        (0..covariance.ncols()).flat_map(|column| (0..column).map(move |row| (row, column)));
    pairs
        .map(|(row, column)| (row, column, covariance[(row, column)], covariance[(column, row)]))
        .find(|&(row, column, value, mirrored)| {
            let scale = (covariance[(row, row)] * covariance[(column, column)]).abs().sqrt();
            (value - mirrored).abs() > SYMMETRY_TOLERANCE * scale
        })
}

/// Refuses predictions (`n_obs`, `n_members`), observations and noise that do not make an update.
pub(crate) fn check_update(
    predicted: MatRef<'_, f64>,
    observed: &[f64],
    noise: &NoiseCovariance,
) -> Result<(), EsmdaError> {
    let (n_obs, n_members) = predicted.shape();
    if n_obs == 0 {
        return Err(EsmdaError::NoObservations);
    }
    if n_members < 2 {
        let dropped = Vec::new();
        return Err(EsmdaError::TooFewMembers { kept: n_members, minimum: 2, dropped });
    }
    check_shape("observed", (observed.len(), 1), (n_obs, 1))?;
    check_shape("noise", (noise.n_obs(), 1), (n_obs, 1))
}

/// Refuses a setting that breaks its rule.
pub(crate) fn check_setting(
    name: &'static str,
    value: f64,
    rule: &'static str,
    holds: bool,
) -> Result<(), EsmdaError> {
    if holds { Ok(()) } else { Err(EsmdaError::Setting { name, rule, value }) }
}
