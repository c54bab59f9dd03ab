//! The search for the most probable parameters, and groups of observations tested after a fit.

use faer::MatRef;
use numpy::{Element, IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;
use tissuereg_boundary::arrays;
use tissuereg_boundary::views::View;
use tissuereg_esmda::{
    EsmdaError, Evaluation, Gaussian, GroupScore, Linearised, SearchSettings, gauss_newton,
    outliers,
};

use crate::errors;
use crate::esmda::Noise;

/// Whether a point was accepted, whether the model failed there, its misfit and the decrease.
type Judged = (bool, bool, f64, f64);

/// Whether the search is over, the length of the next step, and directions with one-sided derivatives.
type Linear = (bool, f64, Vec<usize>);

/// Mean, triangular root of the covariance, and root of the covariance of the predictions.
type Posterior<'py> =
    (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// A search by Gauss-Newton, which names points and is told what the model predicts there.
#[pyclass(module = "tissuereg._core")]
pub(crate) struct GaussNewton(gauss_newton::GaussNewton);

#[pymethods]
impl GaussNewton {
    /// Prior by mean, float64 (n,), and covariance, float64 (n, n); observed, float64 (n_obs,).
    #[new]
    #[pyo3(signature = (mean, covariance, observed, noise, *, start=None, tolerance, max_evaluations, difference,
                        largest))]
    #[expect(clippy::too_many_arguments, reason = "keywords of one Python call")]
    fn new(
        py: Python<'_>,
        mean: &Bound<'_, PyAny>,
        covariance: &Bound<'_, PyAny>,
        observed: &Bound<'_, PyAny>,
        noise: &Bound<'_, Noise>,
        start: Option<Bound<'_, PyAny>>,
        tolerance: f64,
        max_evaluations: usize,
        difference: f64,
        largest: f64,
    ) -> PyResult<Self> {
        let mean = View::<f64>::new("mean", mean, &[&[None]])?;
        let n = Some(mean.slice().len());
        let covariance = View::<f64>::new("covariance", covariance, &[&[n, n]])?;
        let observed = View::<f64>::new("observed", observed, &[&[Some(noise.get().0.n_obs())]])?;
        let start = View::<f64>::optional("start", start.as_ref(), &[&[n]])?;
        let settings = SearchSettings::default()
            .with_tolerance(tolerance)
            .with_max_evaluations(max_evaluations)
            .with_difference(difference)
            .with_largest(largest);
        let made = || {
            let prior = Gaussian::new(mean.slice(), covariance.matrix())?;
            let noise = noise.get().0.clone();
            let search = gauss_newton::GaussNewton::new(prior, observed.slice(), noise, settings)?;
            match &start {
                Some(start) => search.starting_at(start.slice()),
                None => Ok(search),
            }
        };
        made().map(Self).map_err(|error| errors::from_esmda(py, &error))
    }

    /// Where the model is to be evaluated, float64 (n,).
    #[getter]
    fn point<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.point().to_vec().into_pyarray(py)
    }

    /// The point and its neighbours for differences, float64 (n, 2 n + 1).
    #[getter]
    fn stencil<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, self.0.stencil().as_ref())
    }

    /// Judge the point by its predictions, float64 (n_obs,).
    fn evaluate(&mut self, py: Python<'_>, predicted: &Bound<'_, PyAny>) -> PyResult<Judged> {
        let predicted = View::<f64>::new("predicted", predicted, &[&[None]])?;
        let Evaluation { accepted, failed, misfit, decrease, .. } =
            self.0.evaluate(predicted.slice()).map_err(|error| errors::from_esmda(py, &error))?;
        Ok((accepted, failed, misfit, decrease))
    }

    /// Linearise at the accepted point by a Jacobian, float64 (n_obs, n), and step on.
    fn linearise(&mut self, py: Python<'_>, jacobian: &Bound<'_, PyAny>) -> PyResult<Linear> {
        let jacobian = View::<f64>::new("jacobian", jacobian, &[&[None, None]])?;
        linear(py, self.0.linearise(jacobian.matrix()))
    }

    /// The same by differences, from the predictions of the stencil, float64 (n_obs, 2 n + 1).
    fn linearise_by_differences(
        &mut self,
        py: Python<'_>,
        predicted: &Bound<'_, PyAny>,
    ) -> PyResult<Linear> {
        let predicted = View::<f64>::new("predicted", predicted, &[&[None, None]])?;
        linear(py, self.0.linearise_by_differences(predicted.matrix()))
    }

    /// Points evaluated so far, neighbours not counted.
    #[getter]
    fn evaluations(&self) -> usize {
        self.0.evaluations()
    }

    /// Mean, float64 (n,), and roots of the covariances of parameters, (n, n), and predictions, (n_obs, n).
    fn posterior<'py>(&self, py: Python<'py>) -> PyResult<Posterior<'py>> {
        let raised = |error: EsmdaError| errors::from_esmda(py, &error);
        let posterior = self.0.posterior().map_err(raised)?;
        let predicted = self.0.predicted_root().map_err(raised)?;
        let mean = posterior.mean().to_vec().into_pyarray(py);
        Ok((mean, matrix(py, posterior.root())?, matrix(py, predicted.as_ref())?))
    }

    fn __repr__(&self) -> String {
        format!("GaussNewton(n={}, evaluations={})", self.0.point().len(), self.0.evaluations())
    }
}

fn linear(py: Python<'_>, result: Result<Linearised, EsmdaError>) -> PyResult<Linear> {
    let Linearised { converged, step, one_sided, .. } =
        result.map_err(|error| errors::from_esmda(py, &error))?;
    Ok((converged, step, one_sided))
}

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

/// Rows one after the other.
fn matrix<'py>(py: Python<'py>, matrix: MatRef<'_, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let flat = (0..matrix.nrows()).flat_map(|row| matrix.row(row).iter().copied()).collect();
    arrays::from_vec(py, flat, [matrix.nrows(), matrix.ncols()])
}
