//! Checks of input.

use tissuereg_fem::FemError;

/// Fail unless a list has the length that is wanted.
pub(crate) fn check_length(
    what: &'static str,
    expected: usize,
    found: usize,
) -> Result<(), FemError> {
    if expected == found { Ok(()) } else { Err(FemError::WrongLength { what, expected, found }) }
}

/// Fail unless all rows are finite.
pub(crate) fn check_finite(what: &'static str, rows: &[[f64; 3]]) -> Result<(), FemError> {
    match rows.iter().position(|row| !row.iter().all(|v| v.is_finite())) {
        Some(row) => Err(FemError::NonFinite { what, row, values: rows[row] }),
        None => Ok(()),
    }
}

/// Fail unless a length of a time step is above 0.
pub(crate) fn check_dt(dt: f64) -> Result<(), FemError> {
    if dt > 0.0 && dt.is_finite() {
        return Ok(());
    }
    Err(FemError::BadSetting { name: "dt", must: "above 0, in s", found: dt })
}
