//! Many members on one body.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use numpy::PyArray3;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use tissuereg_boundary::errors::{self, Class};
use tissuereg_boundary::views::View;
use tissuereg_boundary::{arrays, lock, report};
use tissuereg_fem::{Body, FemError, Load, Material, Member, Outcome, SolveSettings, solve_many};

use super::law::{Law, warn_of_locking};
use super::supported::Supported;

/// Equilibria of many members; those that failed are rows of NaN.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct ManySolutions {
    /// Displacement of all nodes, float64 (n_members, n_nodes, 3), mm.
    #[pyo3(get)]
    displacement: Py<PyArray3<f64>>,
    /// Force of the support at each held node, float64 (n_members, h, 3), mN.
    #[pyo3(get)]
    reactions: Py<PyArray3<f64>>,
    /// Members without equilibrium, each with its reason.
    #[pyo3(get)]
    failed: Py<PyList>,
    /// Work done, one entry per member; empty for one that failed.
    #[pyo3(get)]
    reports: Py<PyList>,
}

#[pymethods]
impl ManySolutions {
    fn __repr__(&self, py: Python<'_>) -> String {
        let (n, n_failed) = (self.reports.bind(py).len(), self.failed.bind(py).len());
        format!("ManySolutions(n_members={n}, n_failed={n_failed})")
    }
}

/// Materials and loads of all members, checked and copied.
pub(super) struct Members {
    materials: Vec<Material>,
    loads: Vec<Load>,
    /// Displacements to start from: none, one for all or one per member.
    starts: Vec<Vec<[f64; 3]>>,
}

/// Parts of the loads of all members, the member axis first, and where these start.
pub(super) struct Loads<'a, 'py> {
    pub(super) forces: Option<&'a Bound<'py, PyAny>>,
    pub(super) body_force: Option<&'a Bound<'py, PyAny>>,
    pub(super) prescribed: Option<&'a Bound<'py, PyAny>>,
    pub(super) springs: Option<&'a Bound<'py, PyAny>>,
    pub(super) start: Option<&'a Bound<'py, PyAny>>,
}

impl Members {
    pub(super) fn new(
        owner: &Supported,
        [young, poisson]: [&Bound<'_, PyAny>; 2],
        laws: &[PyRef<'_, Law>],
        loads: Loads<'_, '_>,
    ) -> PyResult<Self> {
        let Supported { body, bed } = owner;
        let Loads { forces, body_force, prescribed, springs, start } = loads;
        let (n_tets, three) = (Some(body.n_tets()), Some(3));
        let (all, corners) = (Some(body.n_nodes()), Some(body.n_corner_nodes()));
        let py = young.py();
        let n_points = Some(body.element().n_points());
        let young = View::<f64>::new(
            "young",
            young,
            &[&[None], &[None, n_tets], &[None, n_tets, n_points]],
        )?;
        let n = young.shape()[0];
        let k = Some(n);
        let poisson =
            View::<f64>::new("poisson", poisson, &[&[k], &[k, n_tets], &[k, n_tets, n_points]])?;
        if laws.len() > 1 && laws.len() != n {
            let message =
                format!("`laws` must hold one law or one a member ({n}), got {}", laws.len());
            return Err(errors::raise(py, Class::Shape, &message, Some("laws")));
        }
        let forces =
            View::<f64>::optional("forces", forces, &[&[k, all, three], &[k, corners, three]])?;
        let body_force = View::<f64>::optional("body_force", body_force, &[&[k, three]])?;
        let n_held = Some(body.held_nodes().len());
        let prescribed = View::<f64>::optional("prescribed", prescribed, &[&[k, n_held, three]])?;

        let n_sets = Some(bed.springs.len());
        let springs = View::<f64>::optional("springs", springs, &[&[k, n_sets, Some(2)]])?;
        let start = View::<f64>::optional("start", start, &[&[k, all, three], &[all, three]])?;
        let starts = start.map_or_else(Vec::new, |view| {
            view.rows::<3>().chunks_exact(body.n_nodes()).map(<[_]>::to_vec).collect()
        });

        let rows = |view: &Option<View<'_, f64>>, member: usize| {
            view.as_ref().map(|view| {
                let rows = view.rows::<3>();
                let each = rows.len() / n;
                rows[member * each..(member + 1) * each].to_vec()
            })
        };
        let (materials, loads) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let mut members = Self { materials, loads, starts };
        for member in 0..n {
            let (of_young, of_poisson) = (part(&young, member, n), part(&poisson, member, n));
            let law = laws.get(if laws.len() == 1 { 0 } else { member });
            let material = law
                .map_or(&Law::default(), |law| law)
                .material(body.element(), body.n_tets(), of_young, of_poisson)
                .map_err(|error| errors::from_fem(py, &error, Some(member)))?;
            members.materials.push(material);
            members.loads.push(Load {
                nodal_forces: rows(&forces, member),
                body_force: body_force.as_ref().map_or([0.0; 3], |rows| rows.rows()[member]),
                prescribed: rows(&prescribed, member),
                springs: bed.with(springs.as_ref().map(|view| {
                    let (rows, each) = (view.rows::<2>(), bed.springs.len());
                    &rows[member * each..(member + 1) * each]
                })),
            });
        }
        warn_of_locking(py, body.element(), members.materials.iter(), poisson.slice())?;
        Ok(members)
    }

    /// Solves all; calls `progress` with the number of finished members whenever it has grown.
    pub(super) fn solve(
        self,
        py: Python<'_>,
        body: &Arc<Body>,
        settings: SolveSettings,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<ManySolutions> {
        let (cancel, finished) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
        let tolerance = settings.tolerance;
        let settings = settings.with_cancel(cancel.clone()).with_progress(finished.clone());
        let shared = body.clone();
        let work = move || {
            let start = |member: usize| {
                self.starts.get(if self.starts.len() == 1 { 0 } else { member }).map(Vec::as_slice)
            };
            let pairs = self.materials.iter().zip(&self.loads).enumerate();
            let members: Vec<Member> = pairs
                .map(|(member, (material, load))| Member { material, load, start: start(member) })
                .collect();
            solve_many(&shared, &members, &settings)
        };
        let mut reported = 0;
        let tick = |_: Python<'_>| {
            let now = finished.load(Ordering::Relaxed);
            if let Some(progress) = progress.filter(|_| now != reported) {
                reported = now;
                progress.call1((now,))?;
            }
            Ok(())
        };
        let outcomes = lock::run_watched(py, &cancel, tick, work)?;
        collect(py, body, outcomes, tolerance)
    }
}

/// One member's entries of an array with the member axis first.
fn part<'a>(view: &'a View<'_, f64>, member: usize, n_members: usize) -> &'a [f64] {
    let each = view.slice().len() / n_members;
    &view.slice()[member * each..(member + 1) * each]
}

/// Arrays of all outcomes. What would be wrong for any member is raised, with the first member that shows it.
fn collect(
    py: Python<'_>,
    body: &Body,
    outcomes: Vec<Outcome>,
    tolerance: f64,
) -> PyResult<ManySolutions> {
    let (n, n_nodes, n_held) = (outcomes.len(), body.n_nodes(), body.held_nodes().len());
    let mut displacement = vec![f64::NAN; n * n_nodes * 3];
    let mut reactions = vec![f64::NAN; n * n_held * 3];
    let (failed, reports) = (PyList::empty(py), PyList::empty(py));
    for (member, outcome) in outcomes.into_iter().enumerate() {
        match outcome {
            Outcome::Solved(solution) => {
                let range = |each: usize| member * each * 3..(member + 1) * each * 3;
                displacement[range(n_nodes)].copy_from_slice(solution.displacement.as_flattened());
                reactions[range(n_held)].copy_from_slice(solution.reactions.as_flattened());
                reports.append(report::of_solve(py, &solution.report, tolerance)?)?;
            }
            Outcome::Failed(error) if FemError::is_recoverable(&error) => {
                failed.append((member, error.to_string()))?;
                reports.append(PyDict::new(py))?;
            }
            Outcome::Failed(error) => return Err(errors::from_fem(py, &error, Some(member))),
        }
    }
    Ok(ManySolutions {
        displacement: arrays::from_vec(py, displacement, [n, n_nodes, 3])?.unbind(),
        reactions: arrays::from_vec(py, reactions, [n, n_held, 3])?.unbind(),
        failed: failed.unbind(),
        reports: reports.unbind(),
    })
}
