//! An equilibrium as Python sees it.

use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tissuereg_boundary::{arrays, report};

/// An equilibrium.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Solution {
    /// Displacement of all nodes, float64 (n_nodes, 3), mm.
    #[pyo3(get)]
    displacement: Py<PyArray2<f64>>,
    /// Force of the support at each held node, float64 (h, 3), mN.
    #[pyo3(get)]
    reactions: Py<PyArray2<f64>>,
    /// Work done.
    #[pyo3(get)]
    report: Py<PyDict>,
}

impl Solution {
    pub(super) fn new(
        py: Python<'_>,
        solution: tissuereg_fem::Solution,
        tolerance: f64,
    ) -> PyResult<Self> {
        Ok(Self {
            displacement: arrays::from_points(py, solution.displacement)?.unbind(),
            reactions: arrays::from_points(py, solution.reactions)?.unbind(),
            report: report::of_solve(py, &solution.report, tolerance)?.unbind(),
        })
    }
}

#[pymethods]
impl Solution {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let report = self.report.bind(py);
        let iterations = report.get_item("iterations")?;
        Ok(format!("Solution(iterations={})", iterations.map_or("?".to_owned(), |n| n.to_string())))
    }
}
