//! Groups of observations tested after a fit.

use numpy::{Element, IntoPyArray, PyArray1};
use pyo3::prelude::*;
use tissuereg_boundary::views::View;
use tissuereg_esmda::{GroupScore, outliers};

use crate::errors;

/// Scores of groups of observations by their fitted residuals.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct GroupScores(Vec<GroupScore>);

#[pymethods]
impl GroupScores {
    /// Residual, float64 (n_obs,); covariances of the noise and of what the fit has absorbed, float64 (n_obs, n_obs); the
    /// group of every observation, int64 (n_obs,).
    #[new]
    fn new(
        py: Python<'_>,
        residual: &Bound<'_, PyAny>,
        noise: &Bound<'_, PyAny>,
        absorbed: &Bound<'_, PyAny>,
        groups: &Bound<'_, PyAny>,
        n_groups: usize,
    ) -> PyResult<Self> {
        let residual = View::<f64>::new("residual", residual, &[&[None]])?;
        let n = Some(residual.slice().len());
        let noise = View::<f64>::new("noise", noise, &[&[n, n]])?;
        let absorbed = View::<f64>::new("absorbed", absorbed, &[&[n, n]])?;
        let groups = View::<i64>::new("groups", groups, &[&[n]])?;
        // A negative number is none below `n_groups` either.
        let index = |&group: &i64| usize::try_from(group).unwrap_or(usize::MAX);
        let groups: Vec<usize> = groups.slice().iter().map(index).collect();
        let (residual, noise, absorbed) = (residual.slice(), noise.matrix(), absorbed.matrix());
        outliers::score_groups(residual, noise, absorbed, &groups, n_groups)
            .map(Self)
            .map_err(|error| errors::from_esmda(py, &error))
    }

    /// Squared length of each group's residual in its own standard deviations, float64 (n_groups,).
    #[getter]
    fn chi_square<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.column(py, |score| score.chi_square)
    }

    /// Observations of each group, int64 (n_groups,).
    #[getter]
    fn n_obs<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        self.column(py, |score| score.n_obs as i64)
    }

    /// Chance of a misfit at least as large where nothing is wrong, float64 (n_groups,).
    #[getter]
    fn p_value<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.column(py, |score| score.p_value)
    }

    /// Share of each group's noise that the fit has absorbed, float64 (n_groups,).
    #[getter]
    fn leverage<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.column(py, |score| score.leverage)
    }

    /// Groups beyond a level that is shared out among all, the worst first.
    fn wrong(&self, level: f64) -> Vec<usize> {
        outliers::wrong_groups(&self.0, level)
    }

    fn __repr__(&self) -> String {
        format!("GroupScores(n_groups={})", self.0.len())
    }
}

impl GroupScores {
    fn column<'py, T: Element>(
        &self,
        py: Python<'py>,
        value: fn(&GroupScore) -> T,
    ) -> Bound<'py, PyArray1<T>> {
        self.0.iter().map(value).collect::<Vec<T>>().into_pyarray(py)
    }
}
