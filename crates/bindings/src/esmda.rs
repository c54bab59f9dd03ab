//! Schedules, noise, screening and steps.

use faer::MatMut;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use tissuereg_esmda::{
    AdaptiveRule, Factorisation, NoiseCovariance, Schedule, StepSettings, Truncation, step,
};

use crate::arrays::View;
use crate::errors::{self, Class};
use crate::lock;

/// Equal inflation coefficients, float64 (n_steps,).
#[pyfunction]
pub(crate) fn schedule_constant(
    py: Python<'_>,
    n_steps: usize,
) -> PyResult<Bound<'_, PyArray1<f64>>> {
    alphas_of(py, Schedule::constant(n_steps))
}

/// Inflation coefficients each `decrease` times smaller than the one before, float64 (n_steps,).
#[pyfunction]
pub(crate) fn schedule_geometric(
    py: Python<'_>,
    n_steps: usize,
    decrease: f64,
) -> PyResult<Bound<'_, PyArray1<f64>>> {
    alphas_of(py, Schedule::geometric(n_steps, decrease))
}

/// The coefficients given, float64 (n_steps,), if they are positive and their inverses add up to `total`.
#[pyfunction]
#[pyo3(signature = (alphas, *, total=1.0))]
pub(crate) fn check_schedule<'py>(
    py: Python<'py>,
    alphas: &Bound<'py, PyAny>,
    total: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let alphas = View::<f64>::new("alphas", alphas, &[&[None]])?;
    alphas_of(py, Schedule::with_total(alphas.slice(), total))
}

/// The coefficient of the next step by a rule, "dmc" or "ler", from predictions, float64 (n_obs, n_members).
#[pyfunction]
#[pyo3(signature = (predicted, observed, noise, *, rule, assimilated, steps_left))]
pub(crate) fn next_alpha(
    py: Python<'_>,
    predicted: &Bound<'_, PyAny>,
    observed: &Bound<'_, PyAny>,
    noise: &Bound<'_, Noise>,
    rule: &str,
    assimilated: f64,
    steps_left: usize,
) -> PyResult<f64> {
    let (predicted, observed) = compared(predicted, observed)?;
    let rule = match rule {
        "dmc" => AdaptiveRule::DataMisfit,
        "ler" => AdaptiveRule::RestrictedStep,
        other => {
            let message = format!("`rule` must be one of dmc, ler, got {other}");
            return Err(errors::raise(py, Class::Schedule, &message, Some("rule")));
        }
    };
    let (y, d, noise) = (predicted.matrix(), observed.slice(), &noise.get().0);
    tissuereg_esmda::next_alpha(rule, y, d, noise, assimilated, steps_left)
        .map_err(|error| errors::from_esmda(py, &error))
}

fn alphas_of(
    py: Python<'_>,
    schedule: Result<Schedule, tissuereg_esmda::EsmdaError>,
) -> PyResult<Bound<'_, PyArray1<f64>>> {
    let schedule = schedule.map_err(|error| errors::from_esmda(py, &error))?;
    Ok(schedule.alphas().to_vec().into_pyarray(py))
}

/// Members kept, int64, and members dropped, each with its reason.
type Screened<'py> = (Bound<'py, PyArray1<i64>>, Vec<(usize, String)>);

/// Sorts members by their predictions, float64 (n_obs, n_members): NaN, infinite or beyond `limit` is dropped.
#[pyfunction]
pub(crate) fn screen_members<'py>(
    py: Python<'py>,
    predicted: &Bound<'py, PyAny>,
    limit: f64,
) -> PyResult<Screened<'py>> {
    let predicted = View::<f64>::new("predicted", predicted, &[&[None, None]])?;
    let screening = tissuereg_esmda::screen_members(predicted.matrix(), limit);
    let kept: Vec<i64> = screening.kept.iter().map(|&member| member as i64).collect();
    let dropped =
        screening.dropped.iter().map(|(member, reason)| (*member, reason.to_string())).collect();
    Ok((kept.into_pyarray(py), dropped))
}

/// Covariance of the observations' noise, factored.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Noise(pub(crate) NoiseCovariance);

#[pymethods]
impl Noise {
    /// Independent noise from standard deviations, float64 (n_obs,).
    #[staticmethod]
    fn diagonal(py: Python<'_>, std: &Bound<'_, PyAny>) -> PyResult<Self> {
        let std = View::<f64>::new("std", std, &[&[None]])?;
        let noise = NoiseCovariance::diagonal(std.slice());
        noise.map(Self).map_err(|error| errors::from_esmda(py, &error))
    }

    /// Correlated noise from a covariance, float64 (n_obs, n_obs).
    #[staticmethod]
    fn dense(py: Python<'_>, covariance: &Bound<'_, PyAny>) -> PyResult<Self> {
        let covariance = View::<f64>::new("covariance", covariance, &[&[None, None]])?;
        let matrix = covariance.matrix();
        let noise = lock::run_released(py, 1, |_| NoiseCovariance::dense(matrix));
        noise.map(Self).map_err(|error| errors::from_esmda(py, &error))
    }

    /// Independent noise and shared errors: `diag(std)^2 + columns columns'`; float64 (n_obs,) and (n_obs, k).
    #[staticmethod]
    fn low_rank(
        py: Python<'_>,
        std: &Bound<'_, PyAny>,
        columns: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let std = View::<f64>::new("std", std, &[&[None]])?;
        let n_obs = std.slice().len();
        let columns = View::<f64>::new("columns", columns, &[&[Some(n_obs), None]])?;
        let (std, columns) = (std.slice(), columns.matrix());
        let noise = lock::run_released(py, 1, |_| NoiseCovariance::low_rank(std, columns));
        noise.map(Self).map_err(|error| errors::from_esmda(py, &error))
    }

    /// Number of observations.
    #[getter]
    fn n_obs(&self) -> usize {
        self.0.n_obs()
    }

    fn __repr__(&self) -> String {
        format!("Noise(n_obs={})", self.0.n_obs())
    }
}

/// Settings of a step from what Python may choose: a factorisation by name, and what is kept of the anomalies.
pub(crate) fn settings_of(
    py: Python<'_>,
    factorisation: &str,
    energy: Option<f64>,
    rank: Option<usize>,
) -> PyResult<StepSettings> {
    let factorisation = match factorisation {
        "auto" => Factorisation::Auto,
        "cholesky" => Factorisation::Cholesky,
        "qr" => Factorisation::Qr,
        "svd" => Factorisation::Svd,
        other => {
            let choices = "auto, cholesky, qr, svd";
            let message = format!("`factorisation` must be one of {choices}, got {other}");
            return Err(errors::raise(py, Class::Argument, &message, Some("factorisation")));
        }
    };
    let truncation = match (energy, rank) {
        (None, None) => None,
        (Some(energy), None) => Some(Truncation::Energy(energy)),
        (None, Some(rank)) => Some(Truncation::Rank(rank)),
        (Some(_), Some(_)) => {
            let message = "`energy` and `rank` must not both be given: each sets the truncation";
            return Err(errors::raise(py, Class::Argument, message, Some("rank")));
        }
    };
    let settings = StepSettings::default().with_factorisation(factorisation);
    Ok(settings.with_truncation(truncation))
}

/// Predictions, float64 (n_obs, n_members), and what was observed, float64 (n_obs,).
pub(crate) fn compared<'py>(
    predicted: &Bound<'py, PyAny>,
    observed: &Bound<'py, PyAny>,
) -> PyResult<(View<'py, f64>, View<'py, f64>)> {
    let predicted = View::new("predicted", predicted, &[&[None, None]])?;
    let observed = View::new("observed", observed, &[&[Some(predicted.matrix().nrows())]])?;
    Ok((predicted, observed))
}

/// One prepared ES-MDA update. The arrays given must not be written to while it is made or applied.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Step {
    step: step::Step,
    threads: usize,
}

#[pymethods]
impl Step {
    #[new]
    #[pyo3(signature = (
        predicted, observed, noise, draws, *, alpha, threads=0, factorisation="auto", energy=None, rank=None
    ))]
    #[allow(clippy::too_many_arguments)] // Keywords of the Python signature.
    fn new(
        py: Python<'_>,
        predicted: &Bound<'_, PyAny>,
        observed: &Bound<'_, PyAny>,
        noise: &Bound<'_, Noise>,
        draws: &Bound<'_, PyAny>,
        alpha: f64,
        threads: usize,
        factorisation: &str,
        energy: Option<f64>,
        rank: Option<usize>,
    ) -> PyResult<Self> {
        let settings = settings_of(py, factorisation, energy, rank)?;
        let (predicted, observed) = compared(predicted, observed)?;
        let (n_obs, n_members) = predicted.matrix().shape();
        let draws = View::<f64>::new("draws", draws, &[&[Some(n_obs), Some(n_members)]])?;
        let (y, d, e, noise) =
            (predicted.matrix(), observed.slice(), draws.matrix(), &noise.get().0);
        let prepared = lock::run_released(py, threads, |par| {
            step::Step::prepare(y, d, noise, alpha, e, &settings.with_par(par))
        });
        prepared.map(|step| Self { step, threads }).map_err(|error| errors::from_esmda(py, &error))
    }

    /// The deterministic square-root form: no draws.
    #[staticmethod]
    #[pyo3(signature = (predicted, observed, noise, *, alpha, threads=0, energy=None, rank=None))]
    #[allow(clippy::too_many_arguments)] // Keywords of the Python signature.
    fn square_root(
        py: Python<'_>,
        predicted: &Bound<'_, PyAny>,
        observed: &Bound<'_, PyAny>,
        noise: &Bound<'_, Noise>,
        alpha: f64,
        threads: usize,
        energy: Option<f64>,
        rank: Option<usize>,
    ) -> PyResult<Self> {
        let settings = settings_of(py, "auto", energy, rank)?;
        let (predicted, observed) = compared(predicted, observed)?;
        let (y, d, noise) = (predicted.matrix(), observed.slice(), &noise.get().0);
        let prepared = lock::run_released(py, threads, |par| {
            step::Step::prepare_square_root(y, d, noise, alpha, &settings.with_par(par))
        });
        prepared.map(|step| Self { step, threads }).map_err(|error| errors::from_esmda(py, &error))
    }

    /// Updated copy of parameters, float64 (n_parameters, n_members).
    fn apply<'py>(
        &self,
        py: Python<'py>,
        parameters: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let n_members = self.step.n_members();
        let parameters = View::<f64>::new("parameters", parameters, &[&[None, Some(n_members)]])?;
        let n_rows = parameters.shape()[0];
        let prior = parameters.matrix();
        // numpy's own memory: large arrays get large pages.
        let updated = PyArray2::zeros(py, [n_rows, n_members], false);
        {
            let mut writable = updated.readwrite();
            let target = writable.as_slice_mut()?;
            let done = lock::run_released(py, self.threads, |_| {
                let target = MatMut::from_row_major_slice_mut(target, n_rows, n_members);
                self.step.apply_to(prior, target)
            });
            done.map_err(|error| errors::from_esmda(py, &error))?;
        }
        Ok(updated)
    }

    /// Number of members.
    #[getter]
    fn n_members(&self) -> usize {
        self.step.n_members()
    }

    /// How it was factored: "cholesky", "qr" or "svd".
    #[getter]
    fn factorisation(&self) -> String {
        format!("{:?}", self.step.report().factorisation).to_lowercase()
    }

    fn __repr__(&self) -> String {
        format!("Step(n_members={})", self.step.n_members())
    }
}
