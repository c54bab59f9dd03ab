//! Checks of input that many modules share.

use crate::error::FemError;

/// Fail unless `holds`.
pub(crate) fn must(
    name: &'static str,
    must: &'static str,
    found: f64,
    holds: bool,
) -> Result<(), FemError> {
    if holds { Ok(()) } else { Err(FemError::BadParameter { name, must, found }) }
}

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
