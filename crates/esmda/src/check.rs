//! Checks of arguments by name.

use std::borrow::Cow;

use faer::MatRef;
use pulp::{Arch, NullaryFnOnce};

use crate::error::EsmdaError;

/// Relative asymmetry that rounding may leave in a covariance.
const SYMMETRY_TOLERANCE: f64 = 1e-10;

/// Partial sums of a pass over a row. Fixed, so that the bits depend on nothing else.
pub(crate) const LANES: usize = 8;

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
    check_rows(argument, 0, matrix)
}

/// Refuses an entry that is not finite; the first of `rows` is row `row_0` of the argument.
pub(crate) fn check_rows(
    argument: &'static str,
    row_0: usize,
    rows: MatRef<'_, f64>,
) -> Result<(), EsmdaError> {
    Arch::new().dispatch(CheckRows { argument, row_0, rows })
}

struct CheckRows<'a> {
    argument: &'static str,
    row_0: usize,
    rows: MatRef<'a, f64>,
}

impl NullaryFnOnce for CheckRows<'_> {
    type Output = Result<(), EsmdaError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        for row in 0..self.rows.nrows() {
            check_row(self.argument, self.row_0 + row, &row_of(self.rows, row))?;
        }
        Ok(())
    }
}

#[inline(always)]
pub(crate) fn check_row(
    argument: &'static str,
    row: usize,
    values: &[f64],
) -> Result<(), EsmdaError> {
    if all_finite(values) {
        return Ok(());
    }
    match values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
        Some((column, &value)) => Err(EsmdaError::NotFinite { argument, row, column, value }),
        None => Ok(()),
    }
}

/// A row as a slice; copied where its entries do not lie together.
#[inline(always)]
pub(crate) fn row_of<'a>(matrix: MatRef<'a, f64>, row: usize) -> Cow<'a, [f64]> {
    match matrix.row(row).try_as_row_major() {
        Some(contiguous) => Cow::Borrowed(contiguous.as_slice()),
        None => Cow::Owned(matrix.row(row).iter().copied().collect()),
    }
}

/// Whether all are finite: zero times anything else is NaN.
#[inline(always)]
pub(crate) fn all_finite(values: &[f64]) -> bool {
    let mut zeros = [0.0; LANES];
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for lane in 0..LANES {
            zeros[lane] += chunk[lane] * 0.0;
        }
    }
    zeros.iter().chain(rest).map(|value| value * 0.0).sum::<f64>() == 0.0
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

/// Refuses a setting that breaks its rule.
pub(crate) fn check_setting(
    name: &'static str,
    value: f64,
    rule: &'static str,
    holds: bool,
) -> Result<(), EsmdaError> {
    if holds { Ok(()) } else { Err(EsmdaError::Setting { name, rule, value }) }
}
