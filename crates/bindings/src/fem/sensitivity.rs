//! Derivatives of an equilibrium: what a body is linearised at, by what, and what is observed.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use tissuereg_fem::material::Parameter;
use tissuereg_fem::{FemError, Load, Observation, SolveSettings};

use super::bad_choice;
use crate::arrays::{self, View};
use crate::errors::{self, Class};
use crate::lock;

/// What a derivative is taken by.
#[pyclass(frozen, module = "tissuereg._core")]
#[derive(Clone)]
pub(crate) struct Cause(tissuereg_fem::Cause);

#[pymethods]
impl Cause {
    /// A parameter of the law, moved alike everywhere; `term` counts the terms of an Ogden law.
    #[staticmethod]
    #[pyo3(signature = (name, term=0))]
    fn parameter(py: Python<'_>, name: &str, term: usize) -> PyResult<Self> {
        let parameter = match name {
            "young" => Parameter::Young,
            "poisson" => Parameter::Poisson,
            "share" => Parameter::Share,
            "c2_over_c1" => Parameter::C2OverC1,
            "c3_over_c1" => Parameter::C3OverC1,
            "alpha" => Parameter::Alpha(term),
            "weight" => Parameter::Weight(term),
            "b" => Parameter::B,
            "k1_over_mu" => Parameter::FibreK1,
            "k2" => Parameter::FibreK2,
            other => return Err(bad_choice(py, "name", "a parameter of a law", other)),
        };
        Ok(Self(tissuereg_fem::Cause::Parameter(parameter)))
    }

    /// Young's modulus or Poisson's ratio along a field of rates, float64 (n_tets, n_points).
    #[staticmethod]
    fn field(name: &str, rates: &Bound<'_, PyAny>) -> PyResult<Self> {
        let view = View::<f64>::new("rates", rates, &[&[None, None]])?;
        let rates_of_all = view.slice().to_vec();
        match name {
            "young" => Ok(Self(tissuereg_fem::Cause::YoungField(rates_of_all))),
            "poisson" => Ok(Self(tissuereg_fem::Cause::PoissonField(rates_of_all))),
            other => Err(bad_choice(rates.py(), "name", "`young` or `poisson`", other)),
        }
    }

    /// The load along another one: forces, body force and prescribed displacements as rates.
    #[staticmethod]
    #[pyo3(signature = (*, forces=None, body_force=None, prescribed=None))]
    fn load(
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let rows: [&[Option<usize>]; 1] = [&[None, Some(3)]];
        let forces = View::<f64>::optional("forces", forces, &rows)?;
        let body_force = View::<f64>::optional("body_force", body_force, &[&[Some(3)]])?;
        let prescribed = View::<f64>::optional("prescribed", prescribed, &rows)?;
        Ok(Self(tissuereg_fem::Cause::Load(Load {
            nodal_forces: forces.map(|view| view.rows::<3>().to_vec()),
            body_force: body_force.and_then(|v| v.rows().first().copied()).unwrap_or_default(),
            prescribed: prescribed.map(|view| view.rows::<3>().to_vec()),
            springs: Vec::new(),
        })))
    }

    fn __repr__(&self) -> String {
        use tissuereg_fem::Cause as C;
        match &self.0 {
            C::YoungField(rates) => format!("Cause(YoungField, n_points={})", rates.len()),
            C::PoissonField(rates) => format!("Cause(PoissonField, n_points={})", rates.len()),
            C::Load(_) => "Cause(Load)".to_owned(),
            other => format!("Cause({other:?})"),
        }
    }
}

/// Rows for every cause.
type Stack<'py> = Bound<'py, PyArray3<f64>>;

/// Nodes and weights of displacements, nodes and weights of reactions.
type Weights<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>);

/// An equilibrium with its exact tangent, factored.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Linearised {
    /// Locked by a call for as long as it takes: it takes the call's flag.
    inner: Arc<Mutex<Inner>>,
    body: Arc<tissuereg_fem::Body>,
}

type Inner = tissuereg_fem::Linearised<Arc<tissuereg_fem::Body>>;

impl Linearised {
    /// Factor the tangent at the equilibrium of a problem.
    pub(super) fn new(
        py: Python<'_>,
        body: &Arc<tissuereg_fem::Body>,
        problem: super::OneProblem,
        displacement: Vec<[f64; 3]>,
    ) -> PyResult<Self> {
        let super::OneProblem { material, load, settings } = problem;
        let cancel = Arc::new(AtomicBool::new(false));
        let settings = SolveSettings { cancel: Some(cancel.clone()), ..settings };
        let own = body.clone();
        let work = move || Inner::new(own, &material, &load, &displacement, &settings);
        let inner = lock::run_watched(py, &cancel, |_| Ok(()), work)?
            .map_err(|error| errors::from_fem(py, &error, None))?;
        Ok(Self { inner: Arc::new(Mutex::new(inner)), body: body.clone() })
    }

    /// Run a call that Ctrl-C ends.
    fn call<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Inner) -> Result<T, FemError> + Send + 'static,
    ) -> PyResult<T> {
        let (inner, cancel) = (self.inner.clone(), Arc::new(AtomicBool::new(false)));
        let flag = cancel.clone();
        let watched = move || {
            let mut inner = inner.lock().unwrap_or_else(PoisonError::into_inner);
            inner.cancel_by(Some(flag));
            work(&inner)
        };
        lock::run_watched(py, &cancel, |_| Ok(()), watched)?
            .map_err(|error| errors::from_fem(py, &error, None))
    }
}

#[pymethods]
impl Linearised {
    /// How displacement, float64 (n_causes, n_nodes, 3) mm, and reactions, float64 (n_causes, h, 3) mN, follow each
    /// cause, over its unit.
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        causes: Vec<PyRef<'py, Cause>>,
    ) -> PyResult<(Stack<'py>, Stack<'py>)> {
        let causes: Vec<tissuereg_fem::Cause> =
            causes.iter().map(|cause| cause.0.clone()).collect();
        let n = causes.len();
        let found = self.call(py, move |inner| inner.derivatives(&causes))?;
        let (mut displacement, mut reactions) = (Vec::new(), Vec::new());
        for one in found {
            displacement.extend(one.displacement.into_flattened());
            reactions.extend(one.reactions.into_flattened());
        }
        let (n_nodes, n_held) = (self.body.n_nodes(), self.body.held_nodes().len());
        Ok((
            arrays::from_vec(py, displacement, [n, n_nodes, 3])?,
            arrays::from_vec(py, reactions, [n, n_held, 3])?,
        ))
    }

    /// How observations follow everything. Each is four arrays: nodes, int64 (k,), and the weights of their displacement,
    /// float64 (k, 3); held nodes, int64 (r,), and the weights of their reactions, float64 (r, 3).
    fn adjoints(&self, py: Python<'_>, observations: Vec<Weights<'_>>) -> PyResult<Adjoints> {
        let observations = observations
            .iter()
            .map(|(nodes, weights, held, held_weights)| {
                Ok(Observation {
                    displacement: weights_of(py, ["nodes", "weights"], nodes, weights)?,
                    reactions: weights_of(py, ["held_nodes", "held_weights"], held, held_weights)?,
                })
            })
            .collect::<PyResult<Vec<_>>>()?;
        let found = self.call(py, move |inner| inner.adjoints(&observations))?;
        Adjoints::new(py, &self.body, found)
    }

    fn __repr__(&self) -> String {
        format!("Linearised(n_nodes={})", self.body.n_nodes())
    }
}

/// Nodes with their weights.
pub(super) fn weights_of(
    py: Python<'_>,
    [name, weights_name]: [&str; 2],
    nodes: &Bound<'_, PyAny>,
    weights: &Bound<'_, PyAny>,
) -> PyResult<Vec<(usize, [f64; 3])>> {
    let nodes = View::<i64>::new(name, nodes, &[&[None]])?;
    let nodes = nodes.indices::<1>(py, name, Class::Load)?.into_flattened();
    let weights = View::<f64>::new(weights_name, weights, &[&[Some(nodes.len()), Some(3)]])?;
    Ok(nodes.into_iter().zip(weights.rows::<3>().iter().copied()).collect())
}

/// Derivatives of observations by everything.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Adjoints {
    /// By Young's modulus of every quadrature point, float64 (n_obs, n_tets, n_points), per kPa.
    #[pyo3(get)]
    young: Py<PyArray3<f64>>,
    /// By Poisson's ratio of every quadrature point, float64 (n_obs, n_tets, n_points).
    #[pyo3(get)]
    poisson: Py<PyArray3<f64>>,
    /// By the force at every node, float64 (n_obs, n_nodes, 3), per mN.
    #[pyo3(get)]
    forces: Py<PyArray3<f64>>,
    /// By the body force, float64 (n_obs, 3), per mN/mm^3.
    #[pyo3(get)]
    body_force: Py<PyArray2<f64>>,
    /// By the prescribed displacement of every held node, float64 (n_obs, h, 3), per mm.
    #[pyo3(get)]
    prescribed: Py<PyArray3<f64>>,
}

impl Adjoints {
    fn new(
        py: Python<'_>,
        body: &tissuereg_fem::Body,
        found: Vec<tissuereg_fem::Adjoint>,
    ) -> PyResult<Self> {
        let n = found.len();
        let points = [n, body.n_tets(), body.element().n_points()];
        let gathered = |pick: fn(&tissuereg_fem::Adjoint) -> &[f64], shape| {
            let values = found.iter().flat_map(pick).copied().collect();
            arrays::from_vec(py, values, shape).map(Bound::unbind)
        };
        Ok(Self {
            young: gathered(|one| &one.young, points)?,
            poisson: gathered(|one| &one.poisson, points)?,
            forces: gathered(|one| one.nodal_forces.as_flattened(), [n, body.n_nodes(), 3])?,
            body_force: arrays::from_points(py, found.iter().map(|one| one.body_force).collect())?
                .unbind(),
            prescribed: gathered(
                |one| one.prescribed.as_flattened(),
                [n, body.held_nodes().len(), 3],
            )?,
        })
    }
}

#[pymethods]
impl Adjoints {
    fn __repr__(&self, py: Python<'_>) -> String {
        use numpy::PyUntypedArrayMethods;
        format!("Adjoints(n_obs={})", self.young.bind(py).shape()[0])
    }
}
