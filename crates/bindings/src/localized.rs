//! Steps whose gain is damped parameter by parameter and observation by observation.

use faer::MatMut;
use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;
use tissuereg_esmda::Taper;

use crate::arrays::{self, View};
use crate::errors::{self, Class};
use crate::esmda::{Noise, compared, settings_of};
use crate::lock;

/// Gaspari and Cohn's function of distances over half the distance of no influence, float64 (n,).
#[pyfunction]
pub(crate) fn gaspari_cohn<'py>(
    py: Python<'py>,
    ratios: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let ratios = View::<f64>::new("ratios", ratios, &[&[None]])?;
    let values: Vec<f64> =
        ratios.slice().iter().map(|&ratio| tissuereg_esmda::gaspari_cohn(ratio)).collect();
    Ok(values.into_pyarray(py))
}

/// One prepared localized update. The arrays given must not be written to while it is made or applied.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct LocalizedStep {
    step: tissuereg_esmda::LocalizedStep,
    n_obs: usize,
    threads: usize,
}

#[pymethods]
impl LocalizedStep {
    #[new]
    #[pyo3(signature = (
        predicted, observed, noise, draws, *, alpha, threads=0, energy=None, rank=None
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
        energy: Option<f64>,
        rank: Option<usize>,
    ) -> PyResult<Self> {
        let settings = settings_of(py, "auto", energy, rank)?;
        let (predicted, observed) = compared(predicted, observed)?;
        let (n_obs, n_members) = predicted.matrix().shape();
        let draws = View::<f64>::new("draws", draws, &[&[Some(n_obs), Some(n_members)]])?;
        let (y, d, e, noise) =
            (predicted.matrix(), observed.slice(), draws.matrix(), &noise.get().0);
        let prepared = lock::run_released(py, threads, |par| {
            let settings = settings.with_par(par);
            tissuereg_esmda::LocalizedStep::prepare(y, d, noise, alpha, e, &settings)
        });
        prepared
            .map(|step| Self { step, n_obs, threads })
            .map_err(|error| errors::from_esmda(py, &error))
    }

    /// Updated copy of parameters, float64 (n_parameters, n_members), by a taper, float64 (n_parameters, n_obs).
    fn apply<'py>(
        &self,
        py: Python<'py>,
        parameters: &Bound<'py, PyAny>,
        taper: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let n_members = self.step.n_members();
        let parameters = View::<f64>::new("parameters", parameters, &[&[None, Some(n_members)]])?;
        let n_rows = parameters.shape()[0];
        let taper = View::<f64>::new("taper", taper, &[&[Some(n_rows), Some(self.n_obs)]])?;
        self.update(py, &parameters, Taper::Given(taper.matrix()))
    }

    /// The same by sample correlations with the predictions, "threshold" or "smooth"; 3 / sqrt(n_members) by default.
    #[pyo3(signature = (parameters, *, kind="smooth", threshold=None))]
    fn apply_by_correlation<'py>(
        &self,
        py: Python<'py>,
        parameters: &Bound<'py, PyAny>,
        kind: &str,
        threshold: Option<f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let n_members = self.step.n_members();
        let parameters = View::<f64>::new("parameters", parameters, &[&[None, Some(n_members)]])?;
        let threshold = threshold.unwrap_or_else(|| Taper::default_threshold(n_members));
        let taper = match kind {
            "threshold" => Taper::Threshold(threshold),
            "smooth" => Taper::Smooth(threshold),
            other => {
                let message = format!("`kind` must be one of threshold, smooth, got {other}");
                return Err(errors::raise(py, Class::Argument, &message, Some("kind")));
            }
        };
        self.update(py, &parameters, taper)
    }

    /// Number of members.
    #[getter]
    fn n_members(&self) -> usize {
        self.step.n_members()
    }

    fn __repr__(&self) -> String {
        format!("LocalizedStep(n_members={})", self.step.n_members())
    }
}

impl LocalizedStep {
    fn update<'py>(
        &self,
        py: Python<'py>,
        parameters: &View<'py, f64>,
        taper: Taper<'_>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let shape = [parameters.shape()[0], parameters.shape()[1]];
        let mut values = parameters.slice().to_vec();
        let updated = lock::run_released(py, self.threads, |_| {
            let rows = MatMut::from_row_major_slice_mut(&mut values, shape[0], shape[1]);
            self.step.apply(rows, taper)
        });
        updated.map_err(|error| errors::from_esmda(py, &error))?;
        arrays::from_vec(py, values, shape)
    }
}
