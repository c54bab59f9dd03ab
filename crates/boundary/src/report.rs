//! Reports as plain dictionaries.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use tissuereg_fem::{NoEquilibrium, SolveReport};

use crate::arrays;

/// Work of a solve that found its equilibrium.
///
/// # Errors
///
/// What Python raises where it has no memory.
///
/// # Entries
///
/// `residual` is over the norm of the load, as `tolerance` in the call is; with `_mN` as computed.
pub fn of_solve<'py>(
    py: Python<'py>,
    report: &SolveReport,
    tolerance: f64,
) -> PyResult<Bound<'py, PyDict>> {
    let seconds = PyDict::new(py);
    seconds.set_item("factor", report.seconds.factor)?;
    seconds.set_item("iterate", report.seconds.iterate)?;
    let dict = PyDict::new(py);
    dict.set_item("iterations", report.iterations)?;
    dict.set_item("evaluations", report.evaluations)?;
    dict.set_item("solves", report.solves)?;
    dict.set_item("factorisations", report.factorisations)?;
    dict.set_item("analyses", report.analyses)?;
    dict.set_item("load_steps", report.load_steps)?;
    dict.set_item("long_descents", report.long_descents)?;
    dict.set_item("load_fraction", report.load_fraction)?;
    dict.set_item("residual", over_load(report.residual, report.tolerance, tolerance))?;
    dict.set_item("residual_mN", report.residual)?;
    dict.set_item("tolerance_mN", report.tolerance)?;
    dict.set_item("strain_energy", report.strain_energy)?;
    dict.set_item("min_det_f", report.min_det_f)?;
    dict.set_item("seconds", seconds)?;
    Ok(dict)
}

/// Where a solve without equilibrium ended, and the last equilibrium it found.
///
/// # Errors
///
/// What Python raises where it has no memory.
pub fn of_failure<'py>(py: Python<'py>, failure: &NoEquilibrium) -> PyResult<Bound<'py, PyDict>> {
    let worst: Vec<(usize, f64)> = failure.worst_tets.iter().map(|w| (w.tet, w.det_f)).collect();
    let dict = PyDict::new(py);
    dict.set_item("load_fraction", failure.load_fraction)?;
    dict.set_item("tried_fraction", failure.tried_fraction)?;
    dict.set_item("displacement", arrays::from_points(py, failure.displacement.clone())?)?;
    dict.set_item("iterations", failure.iterations)?;
    dict.set_item("factorisations", failure.factorisations)?;
    dict.set_item("residual_mN", failure.residual)?;
    dict.set_item("tolerance_mN", failure.tolerance)?;
    dict.set_item("min_det_f", failure.min_det_f)?;
    dict.set_item("worst_tets", worst)?;
    dict.set_item("reason", failure.reason.to_string())?;
    Ok(dict)
}

/// A residual over the norm of the load: the solver's tolerance in mN is `tolerance` of that norm.
fn over_load(residual: f64, tolerance_force: f64, tolerance: f64) -> f64 {
    if residual == 0.0 { 0.0 } else { residual / tolerance_force * tolerance }
}
