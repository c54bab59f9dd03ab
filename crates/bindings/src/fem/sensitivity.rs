//! Derivatives of an equilibrium: what a body is linearised at, by what, and what is observed.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, PoisonError, RwLock};

use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tissuereg_boundary::errors::{self, Class};
use tissuereg_boundary::views::View;
use tissuereg_boundary::{arrays, lock};
use tissuereg_fem::material::Parameter;
use tissuereg_fem::{self as fem, FemError, Load, Observation, Precision};

use super::given::{bad_choice, settings_of};
use super::solution::Solution;
use super::supported::{Problem, Supported};

/// What a derivative is taken by.
#[pyclass(frozen, module = "tissuereg._core")]
#[derive(Clone)]
pub(crate) struct Cause(fem::Cause);

#[pymethods]
impl Cause {
    /// A number of the law, moved alike everywhere, or, by a name with a dot, one of springs; `term` counts terms of series
    /// and sets of springs.
    #[staticmethod]
    #[pyo3(signature = (name, term=0))]
    fn parameter(py: Python<'_>, name: &str, term: usize) -> PyResult<Self> {
        let parameter = match name {
            "young" => Parameter::Young,
            "poisson" => Parameter::Poisson,
            "k1_over_mu" => Parameter::FibreK1,
            "k2" => Parameter::FibreK2,
            "springs.normal_kpa_per_mm" => return Ok(Self(fem::Cause::SpringNormal(term))),
            "springs.tangential_kpa_per_mm" => {
                return Ok(Self(fem::Cause::SpringTangential(term)));
            }
            other => Parameter::shape_named(other, term).ok_or_else(|| {
                let wanted = "a parameter of a law or of springs";
                bad_choice(py, "name", wanted, other)
            })?,
        };
        Ok(Self(fem::Cause::Parameter(parameter)))
    }

    /// Young's modulus or Poisson's ratio along a field of rates, float64 (n_tets, n_points).
    #[staticmethod]
    fn field(name: &str, rates: &Bound<'_, PyAny>) -> PyResult<Self> {
        let view = View::<f64>::new("rates", rates, &[&[None, None]])?;
        let rates_of_all = view.slice().to_vec();
        let cause = match name {
            "young" => fem::Cause::YoungField(rates_of_all),
            "poisson" => fem::Cause::PoissonField(rates_of_all),
            other => return Err(bad_choice(rates.py(), "name", "`young` or `poisson`", other)),
        };
        Ok(Self(cause))
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
        Ok(Self(fem::Cause::Load(Load {
            nodal_forces: forces.map(|view| view.rows::<3>().to_vec()),
            body_force: body_force.and_then(|v| v.rows().first().copied()).unwrap_or_default(),
            prescribed: prescribed.map(|view| view.rows::<3>().to_vec()),
            springs: Vec::new(),
        })))
    }

    fn __repr__(&self) -> String {
        use fem::Cause as C;
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
    /// Locked by a call for as long as it takes, which takes the call's flag; solves near by go side by side.
    inner: Arc<RwLock<Inner>>,
    owner: Supported,
    /// That of the settings, for solves near by.
    threads: usize,
}

type Inner = tissuereg_fem::Linearised<Arc<tissuereg_fem::Body>>;

impl Linearised {
    /// Factor the tangent at the equilibrium of a problem.
    pub(super) fn new(py: Python<'_>, owner: &Supported, problem: Problem) -> PyResult<Self> {
        let Problem { material, load, displacement, precision, settings } = problem;
        let threads = settings.n_threads;
        let cancel = Arc::new(AtomicBool::new(false));
        let settings = settings.with_cancel(cancel.clone());
        let own = owner.body.clone();
        let work =
            move || Inner::in_precision(own, &material, &load, &displacement, &settings, precision);
        let inner = watched(py, &cancel, work)?;
        Ok(Self { inner: Arc::new(RwLock::new(inner)), owner: owner.clone(), threads })
    }

    /// Numbers of nodes and of held ones.
    fn sizes(&self) -> [usize; 2] {
        [self.owner.body.n_nodes(), self.owner.body.held_nodes().len()]
    }

    /// Run a call that Ctrl-C ends.
    fn call<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Inner) -> Result<T, FemError> + Send + 'static,
    ) -> PyResult<T> {
        let (inner, cancel) = (self.inner.clone(), Arc::new(AtomicBool::new(false)));
        let flag = cancel.clone();
        let work = move || {
            let mut inner = inner.write().unwrap_or_else(PoisonError::into_inner);
            inner.cancel_by(Some(flag));
            work(&inner)
        };
        watched(py, &cancel, work)
    }
}

/// Run work that Ctrl-C ends by a flag.
fn watched<T: Send + 'static>(
    py: Python<'_>,
    cancel: &Arc<AtomicBool>,
    work: impl FnOnce() -> Result<T, FemError> + Send + 'static,
) -> PyResult<T> {
    lock::run_watched(py, cancel, |_| Ok(()), work)?
        .map_err(|error| errors::from_fem(py, &error, None))
}

#[pymethods]
impl Linearised {
    /// Derivatives of displacement, float64 (n_causes, n_nodes, 3) mm, and reactions, float64 (n_causes, h, 3) mN, by each
    /// cause, over its unit.
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        causes: Vec<PyRef<'py, Cause>>,
    ) -> PyResult<(Stack<'py>, Stack<'py>)> {
        let causes: Vec<fem::Cause> = causes.iter().map(|cause| cause.0.clone()).collect();
        let n = causes.len();
        let found = self.call(py, move |inner| inner.derivatives(&causes))?;
        let (mut displacement, mut reactions) = (Vec::new(), Vec::new());
        for one in found {
            displacement.extend(one.displacement.into_flattened());
            reactions.extend(one.reactions.into_flattened());
        }
        let [n_nodes, n_held] = self.sizes();
        Ok((
            arrays::from_vec(py, displacement, [n, n_nodes, 3])?,
            arrays::from_vec(py, reactions, [n, n_held, 3])?,
        ))
    }

    /// Derivatives of observations by all inputs. Each is four arrays: nodes, int64 (k,), and the weights of their displacement,
    /// float64 (k, 3); held nodes, int64 (r,), and the weights of their reactions, float64 (r, 3).
    fn adjoints(&self, py: Python<'_>, observations: Vec<Weights<'_>>) -> PyResult<Adjoints> {
        let observations = observations_of(py, &observations)?;
        let found = self.call(py, move |inner| inner.adjoints(&observations))?;
        Adjoints::new(py, &self.owner, found)
    }

    /// Derivatives of observations of displacements by forces and supports: arguments as those of `adjoints`, without reactions.
    fn compliance(&self, py: Python<'_>, observations: Vec<Weights<'_>>) -> PyResult<Compliance> {
        let observations = observations_of(py, &observations)?;
        let n = observations.len();
        let found = self.call(py, move |inner| inner.compliance(&observations))?;
        let [n_nodes, n_held] = self.sizes();
        let stack = |rows: Vec<[f64; 3]>, each| {
            arrays::from_vec(py, rows.into_flattened(), [n, each, 3]).map(Bound::unbind)
        };
        Ok(Compliance {
            forces: stack(found.nodal_forces, n_nodes)?,
            body_force: arrays::from_points(py, found.body_force)?.unbind(),
            prescribed: stack(found.prescribed, n_held)?,
        })
    }

    /// Linear response of the displacement to each of many fields of nodal forces, float64 (n_fields, n_nodes, 3) mN; mm in the same
    /// shape.
    fn responses<'py>(&self, py: Python<'py>, forces: &Bound<'py, PyAny>) -> PyResult<Stack<'py>> {
        let [n_nodes, _] = self.sizes();
        let forces = View::<f64>::new("forces", forces, &[&[None, Some(n_nodes), Some(3)]])?;
        let n = forces.shape()[0];
        let rows = forces.rows::<3>().to_vec();
        let found = self.call(py, move |inner| inner.responses(&rows))?;
        arrays::from_vec(py, found.into_flattened(), [n, n_nodes, 3])
    }

    /// Unbalanced nodal forces, float64 (n_causes, n_nodes, 3) mN over the unit of each cause, that it leaves where
    /// nothing moves.
    fn unbalanced<'py>(
        &self,
        py: Python<'py>,
        causes: Vec<PyRef<'py, Cause>>,
    ) -> PyResult<Stack<'py>> {
        let causes: Vec<fem::Cause> = causes.iter().map(|cause| cause.0.clone()).collect();
        let n = causes.len();
        let found = self.call(py, move |inner| inner.unbalanced(&causes))?;
        arrays::from_vec(py, found.into_flattened(), [n, self.sizes()[0], 3])
    }

    /// Equilibrium of the same body and material under another load, sought from here with the factor at hand; several
    /// threads may ask at once.
    #[pyo3(signature = (*, forces=None, body_force=None, prescribed=None, springs=None, tolerance=1e-9,
                        max_iterations=1000, threads=None))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn solve_near(
        &self,
        py: Python<'_>,
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        springs: Option<&Bound<'_, PyAny>>,
        tolerance: f64,
        max_iterations: usize,
        threads: Option<usize>,
    ) -> PyResult<Solution> {
        let load = self.owner.load(forces, body_force, prescribed, springs)?;
        let threads = threads.unwrap_or(self.threads);
        let (inner, cancel) = (self.inner.clone(), Arc::new(AtomicBool::new(false)));
        let settings = settings_of(py, tolerance, max_iterations, "auto", 0, threads)?
            .with_cancel(Some(cancel.clone()));
        let work = move || {
            inner.read().unwrap_or_else(PoisonError::into_inner).solve_near(&load, &settings)
        };
        let answer = watched(py, &cancel, work)?;
        Solution::new(py, answer, tolerance)
    }

    /// Work so far: `precision` of the factor, `factorisations`, `right_hand_sides` and their `corrections`.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let inner = self.inner.clone();
        let report =
            py.detach(move || inner.read().unwrap_or_else(PoisonError::into_inner).report());
        let dict = PyDict::new(py);
        dict.set_item(
            "precision",
            match report.precision {
                Precision::Double => "double",
                Precision::Single => "single",
            },
        )?;
        dict.set_item("factorisations", report.factorisations)?;
        dict.set_item("right_hand_sides", report.right_hand_sides)?;
        dict.set_item("corrections", report.corrections)?;
        Ok(dict)
    }

    fn __repr__(&self) -> String {
        format!("Linearised(n_nodes={})", self.sizes()[0])
    }
}

fn observations_of(py: Python<'_>, given: &[Weights<'_>]) -> PyResult<Vec<Observation>> {
    let one = |(nodes, weights, held, held_weights): &Weights<'_>| {
        Ok(Observation {
            displacement: weights_of(py, ["nodes", "weights"], nodes, weights)?,
            reactions: weights_of(py, ["held_nodes", "held_weights"], held, held_weights)?,
        })
    };
    given.iter().map(one).collect()
}

/// Nodes with their weights.
fn weights_of(
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
    /// By the stiffness of every set of springs along the normal and in the plane, float64 (n_obs, n_sets, 2), per kPa/mm.
    #[pyo3(get)]
    springs: Py<PyArray3<f64>>,
}

/// Derivatives of observations of displacements by forces and supports.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Compliance {
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

#[pymethods]
impl Compliance {
    fn __repr__(&self, py: Python<'_>) -> String {
        use numpy::PyUntypedArrayMethods;
        format!("Compliance(n_obs={})", self.forces.bind(py).shape()[0])
    }
}

impl Adjoints {
    fn new(
        py: Python<'_>,
        Supported { body, bed }: &Supported,
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
            springs: gathered(|one| one.springs.as_flattened(), [n, bed.springs.len(), 2])?,
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
