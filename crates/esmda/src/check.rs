//! Checks of arguments by name.

use faer::MatRef;

use crate::EsmdaError;

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
    for row in 0..matrix.nrows() {
        for (column, &value) in matrix.row(row).iter().enumerate() {
            if !value.is_finite() {
                return Err(EsmdaError::NotFinite { argument, row, column, value });
            }
        }
    }
    Ok(())
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
