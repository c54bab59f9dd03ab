//! A body through time frames, with pads that come and go.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tissuereg_boundary::views::View;
use tissuereg_boundary::{arrays, errors, lock, report};
use tissuereg_fem::{FemError, History, Load, Material, Pad, Resultant, SolveSettings, rest_shape};

use super::behaviour::Behaviour;
use super::body::Body;
use super::given::{bad_choice, nodes_of, settings_of};
use super::law::Law;
use super::supported::Supported;

/// A body, its history and its pads.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Rig {
    rig: Arc<Mutex<tissuereg_fem::Rig>>,
    /// The body as given, and its springs.
    owner: Supported,
    /// Given minus unloaded place of every node, mm; empty where both are the same.
    hung: Vec<[f64; 3]>,
    n_pads: usize,
    settings: SolveSettings,
}

#[pymethods]
impl Rig {
    /// Moduli and law as those of `Body.solve`; pads are nodes, int64 (k,). `hangs_in` is a body force, mN/mm^3, that acts
    /// in the mesh as given already.
    #[new]
    #[pyo3(signature = (body, young, poisson, *, law=None, pads=Vec::new(), behaviour=None, hangs_in=None,
                        tolerance=1e-9, max_iterations=1000, threads=0))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn new(
        py: Python<'_>,
        body: &Body,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        law: Option<&Law>,
        pads: Vec<Bound<'_, PyAny>>,
        behaviour: Option<&Behaviour>,
        hangs_in: Option<&Bound<'_, PyAny>>,
        tolerance: f64,
        max_iterations: usize,
        threads: usize,
    ) -> PyResult<Self> {
        let owner = body.0.clone();
        let material = owner.material([young, poisson], law)?;
        let pads = pads
            .iter()
            .map(|nodes| Ok(Pad { nodes: nodes_of(py, "pads", nodes)? }))
            .collect::<PyResult<Vec<_>>>()?;
        let weight = View::<f64>::optional("hangs_in", hangs_in, &[&[Some(3)]])?;
        let weight = weight.and_then(|view| view.rows::<3>().first().copied());
        let behaviour = behaviour.map_or_else(Default::default, |one| one.0.clone());
        let settings = settings_of(py, tolerance, max_iterations, "auto", 0, threads)?;
        let cancel = Arc::new(AtomicBool::new(false));
        let watched = settings.clone().with_cancel(cancel.clone());
        let n_pads = pads.len();
        let plan = Plan { owner: owner.clone(), material, behaviour, pads, weight };
        let (rig, hung) = lock::run_watched(py, &cancel, |_| Ok(()), move || plan.build(&watched))?
            .map_err(|error| errors::from_fem(py, &error, None))?;
        Ok(Self { rig: Arc::new(Mutex::new(rig)), owner, hung, n_pads, settings })
    }

    /// Equilibrium of the next frame. Rows of NaN in `motions` are pads that are absent; `change` is the change of the
    /// displacement since the last frame that is expected.
    #[pyo3(signature = (time, motions, *, forces=None, body_force=None, prescribed=None, change=None))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn advance(
        &self,
        py: Python<'_>,
        time: f64,
        motions: &Bound<'_, PyAny>,
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        change: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<RigFrame> {
        let three = Some(3);
        let motions = View::<f64>::new("motions", motions, &[&[Some(self.n_pads), three]])?;
        let change =
            View::<f64>::optional("change", change, &[&[Some(self.owner.body.n_nodes()), three]])?;
        let change = change.map(|rows| rows.rows::<3>().to_vec());
        let load = self.owner.load(forces, body_force, prescribed, None)?;
        let absent = |row: &[f64; 3]| row.iter().all(|v| v.is_nan());
        let motions: Vec<Option<[f64; 3]>> =
            motions.rows::<3>().iter().map(|row| (!absent(row)).then_some(*row)).collect();
        let cancel = Arc::new(AtomicBool::new(false));
        let settings = self.settings.clone().with_cancel(cancel.clone());
        let rig = self.rig.clone();
        let work = move || {
            let mut rig = rig.lock().unwrap_or_else(PoisonError::into_inner);
            rig.advance_by(&load, &motions, change.as_deref(), time, &settings)
        };
        let frame = lock::run_watched(py, &cancel, |_| Ok(()), work)?;
        let frame = frame.map_err(|error| errors::from_fem(py, &error, None))?;
        RigFrame::new(py, frame, &self.hung, self.settings.tolerance)
    }

    /// The same rig at its beginning with another material; analyses and factors are shared. Not of a rig that hangs in
    /// its weight, whose unloaded shape depends on the material.
    #[pyo3(signature = (young, poisson, *, law=None, behaviour=None))]
    fn again(
        &self,
        py: Python<'_>,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        law: Option<&Law>,
        behaviour: Option<&Behaviour>,
    ) -> PyResult<Self> {
        if !self.hung.is_empty() {
            let wanted = "one that does not hang in its weight";
            return Err(bad_choice(py, "rig", wanted, "a hung one"));
        }
        let material = self.owner.material([young, poisson], law)?;
        let behaviour = behaviour.map_or_else(Default::default, |one| one.0.clone());
        let rig = self.rig.clone();
        let made = py
            .detach(move || {
                let rig = rig.lock().unwrap_or_else(PoisonError::into_inner);
                rig.afresh(material, behaviour)
            })
            .map_err(|error| errors::from_fem(py, &error, None))?;
        Ok(Self {
            rig: Arc::new(Mutex::new(made)),
            owner: self.owner.clone(),
            hung: Vec::new(),
            n_pads: self.n_pads,
            settings: self.settings.clone(),
        })
    }

    /// Places of all nodes of the unloaded body, float64 (n_nodes, 3), mm.
    #[getter]
    fn rest_nodes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rig = self.rig.clone();
        let nodes = py.detach(move || {
            rig.lock().unwrap_or_else(PoisonError::into_inner).body().nodes().to_vec()
        });
        arrays::from_points(py, nodes)
    }

    fn __repr__(&self) -> String {
        let body = &self.owner.body;
        let (n_nodes, n_held) = (body.n_nodes(), body.held_nodes().len());
        format!("Rig(n_nodes={n_nodes}, n_held={n_held}, n_pads={})", self.n_pads)
    }
}

/// What a rig is made of.
struct Plan {
    owner: Supported,
    material: Material,
    behaviour: tissuereg_fem::Behaviour,
    pads: Vec<Pad>,
    weight: Option<[f64; 3]>,
}

impl Plan {
    /// The rig, and how far each node has sunk in the mesh as given, mm.
    fn build(
        self,
        settings: &SolveSettings,
    ) -> Result<(tissuereg_fem::Rig, Vec<[f64; 3]>), FemError> {
        let Supported { mut body, bed } = self.owner;
        let mut hung = Vec::new();
        if let Some(body_force) = self.weight {
            let load = Load { body_force, springs: bed.springs.clone(), ..Load::default() };
            let rest = rest_shape(&body, &self.material, &load, settings)?;
            let places = body.nodes().iter().zip(rest.body.nodes());
            hung = places.map(|(x, r)| std::array::from_fn(|i| x[i] - r[i])).collect();
            body = Arc::new(rest.body);
        }
        let history = History::new(&body, self.material, self.behaviour)?;
        Ok((tissuereg_fem::Rig::new(body, history, self.pads)?, hung))
    }
}

/// One frame of a rig.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct RigFrame {
    /// Displacement of all nodes from the mesh as given, float64 (n_nodes, 3), mm.
    #[pyo3(get)]
    displacement: Py<PyArray2<f64>>,
    /// Force of the support at each held node, float64 (h, 3), mN.
    #[pyo3(get)]
    reactions: Py<PyArray2<f64>>,
    /// Force of each pad on the body, float64 (n_pads, 3), mN; NaN where absent.
    #[pyo3(get)]
    pad_forces: Py<PyArray2<f64>>,
    /// Its moment about the mean place of the pad's nodes, float64 (n_pads, 3), mN mm; NaN where absent.
    #[pyo3(get)]
    pad_moments: Py<PyArray2<f64>>,
    /// Force of each set of springs on the body, float64 (n_springs, 3), mN.
    #[pyo3(get)]
    spring_forces: Py<PyArray2<f64>>,
    /// Work done.
    #[pyo3(get)]
    report: Py<PyDict>,
}

impl RigFrame {
    fn new(
        py: Python<'_>,
        frame: tissuereg_fem::RigFrame,
        hung: &[[f64; 3]],
        tolerance: f64,
    ) -> PyResult<Self> {
        let mut solution = frame.solution;
        for (row, hung) in solution.displacement.iter_mut().zip(hung) {
            for i in 0..3 {
                row[i] -= hung[i];
            }
        }
        let absent = Resultant { force: [f64::NAN; 3], moment: [f64::NAN; 3] };
        let pads: Vec<Resultant> = frame.pads.iter().map(|pad| pad.unwrap_or(absent)).collect();
        let sum = |rows: &Vec<[f64; 3]>| -> [f64; 3] {
            std::array::from_fn(|i| rows.iter().map(|row| row[i]).sum())
        };
        let points = |rows: Vec<[f64; 3]>| arrays::from_points(py, rows).map(Bound::unbind);
        Ok(Self {
            displacement: points(solution.displacement)?,
            reactions: points(solution.reactions)?,
            pad_forces: points(pads.iter().map(|pad| pad.force).collect())?,
            pad_moments: points(pads.iter().map(|pad| pad.moment).collect())?,
            spring_forces: points(solution.spring_forces.iter().map(sum).collect())?,
            report: report::of_solve(py, &solution.report, tolerance)?.unbind(),
        })
    }
}

#[pymethods]
impl RigFrame {
    fn __repr__(&self, py: Python<'_>) -> String {
        let [n, p] = [&self.displacement, &self.pad_forces].map(|a| rows_of(a.bind(py)));
        format!("RigFrame(n_nodes={n}, n_pads={p})")
    }
}

fn rows_of(array: &Bound<'_, PyArray2<f64>>) -> usize {
    use numpy::PyUntypedArrayMethods;
    array.shape()[0]
}
