//! Schedules, noise, screening and steps.

use faer::{MatMut, MatRef};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use tissuereg_boundary::arrays;
use tissuereg_boundary::errors::{Class, raise};
use tissuereg_boundary::lock;
use tissuereg_boundary::views::View;
use tissuereg_esmda::{
    ComponentScore, Factorisation, Groups, NoiseCovariance, ScaledComponent, Schedule,
    StepSettings, mixture, step,
};

use crate::errors;

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

/// Of every pair: log density (n_pairs,), pulls (n_pairs, n_obs), misfits and log determinants (n_pairs, n_groups).
type Scores<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
);

/// Scores pairs of component, int64 (n_pairs,), and scale, float64 (n_pairs,), of a mixture: covariances, float64
/// (n_components, n_obs, n_obs), innovations, float64 (n_components, n_obs), noise, float64 (n_obs, n_obs). `group`
/// observations are compared with the others, all or the `last` ones; 0 for none.
#[pyfunction]
#[pyo3(signature = (covariances, innovations, component, scale, noise, *, group=0, last=false, threads=0))]
#[allow(clippy::too_many_arguments)] // Keywords of the Python signature.
pub(crate) fn score_components<'py>(
    py: Python<'py>,
    covariances: &Bound<'py, PyAny>,
    innovations: &Bound<'py, PyAny>,
    component: &Bound<'py, PyAny>,
    scale: &Bound<'py, PyAny>,
    noise: &Bound<'py, PyAny>,
    group: usize,
    last: bool,
    threads: usize,
) -> PyResult<Scores<'py>> {
    let innovations = View::<f64>::new("innovations", innovations, &[&[None, None]])?;
    let (n_components, n_obs) = innovations.matrix().shape();
    let wanted = [Some(n_components), Some(n_obs), Some(n_obs)];
    let covariances = View::<f64>::new("covariances", covariances, &[&wanted])?;
    let component = View::<i64>::new("component", component, &[&[None]])?;
    let scale = View::<f64>::new("scale", scale, &[&[Some(component.slice().len())]])?;
    let noise = View::<f64>::new("noise", noise, &[&[Some(n_obs), Some(n_obs)]])?;
    let stacked = MatRef::from_row_major_slice(covariances.slice(), n_components * n_obs, n_obs);
    let pairs: Vec<ScaledComponent> = component
        .slice()
        .iter()
        .zip(scale.slice())
        // A negative number is no component either.
        .map(|(&number, &scale)| ScaledComponent {
            component: usize::try_from(number).unwrap_or(usize::MAX),
            scale,
        })
        .collect();
    let (innovations, noise) = (innovations.matrix(), noise.matrix());
    let groups = match (group, last) {
        (0, _) => Groups::Nothing,
        (_, false) => Groups::Every(group),
        (_, true) => Groups::Last(group),
    };
    let scores = lock::run_released(py, threads, |par| {
        mixture::score_components(stacked, innovations, &pairs, noise, groups, par)
    })
    .map_err(|error| errors::from_esmda(py, &error))?;
    let table = |width: usize, row: fn(&ComponentScore) -> &[f64]| {
        let flat = scores.iter().flat_map(|score| row(score).iter().copied()).collect();
        arrays::from_vec(py, flat, [scores.len(), width])
    };
    let n_groups = scores.first().map_or(0, |score| score.misfits.len());
    let logs: Vec<f64> = scores.iter().map(|score| score.log_density).collect();
    Ok((
        logs.into_pyarray(py),
        table(n_obs, |score| &score.pull)?,
        table(n_groups, |score| &score.misfits)?,
        table(n_groups, |score| &score.log_dets)?,
    ))
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

    /// Number of observations.
    #[getter]
    fn n_obs(&self) -> usize {
        self.0.n_obs()
    }

    fn __repr__(&self) -> String {
        format!("Noise(n_obs={})", self.0.n_obs())
    }
}

/// Settings of a step with a factorisation by name.
fn settings_of(py: Python<'_>, factorisation: &str) -> PyResult<StepSettings> {
    let factorisation = match factorisation {
        "auto" => Factorisation::Auto,
        "cholesky" => Factorisation::Cholesky,
        "qr" => Factorisation::Qr,
        "svd" => Factorisation::Svd,
        other => {
            let choices = "auto, cholesky, qr, svd";
            let message = format!("`factorisation` must be one of {choices}, got {other}");
            return Err(raise(py, Class::Argument, &message, Some("factorisation")));
        }
    };
    Ok(StepSettings::default().with_factorisation(factorisation))
}

/// Predictions, float64 (n_obs, n_members), and what was observed, float64 (n_obs,).
fn compared<'py>(
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
        predicted, observed, noise, draws, *, alpha, threads=0, factorisation="auto"
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
    ) -> PyResult<Self> {
        let settings = settings_of(py, factorisation)?;
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
    #[pyo3(signature = (predicted, observed, noise, *, alpha, threads=0))]
    #[allow(clippy::too_many_arguments)] // Keywords of the Python signature.
    fn square_root(
        py: Python<'_>,
        predicted: &Bound<'_, PyAny>,
        observed: &Bound<'_, PyAny>,
        noise: &Bound<'_, Noise>,
        alpha: f64,
        threads: usize,
    ) -> PyResult<Self> {
        let (predicted, observed) = compared(predicted, observed)?;
        let (y, d, noise) = (predicted.matrix(), observed.slice(), &noise.get().0);
        let prepared = lock::run_released(py, threads, |par| {
            let settings = StepSettings::default().with_par(par);
            step::Step::prepare_square_root(y, d, noise, alpha, &settings)
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

    /// `log [N(d; mean Y, C_yy + alpha C_d) / N(0; 0, alpha C_d)]`, of the square-root form; None of the other.
    #[getter]
    fn log_evidence(&self) -> Option<f64> {
        self.step.report().log_evidence
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
