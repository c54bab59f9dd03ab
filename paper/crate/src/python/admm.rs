//! A body moved by ADMM.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use faer::Par;
use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;
use tissuereg_boundary::errors::{self, Class};
use tissuereg_boundary::mesh::mesh_of;
use tissuereg_boundary::views::View;
use tissuereg_boundary::{arrays, lock};
use tissuereg_fem::Stiffness;

use crate::AdmmBody;

/// A neo-Hookean body of four-node tets that moves in time, stepped by ADMM.
#[pyclass(frozen, name = "AdmmBody", module = "tissuereg_paper._core")]
pub(crate) struct PyAdmmBody {
    body: Arc<Mutex<AdmmBody>>,
    n_nodes: usize,
    n_held: usize,
}

#[pymethods]
impl PyAdmmBody {
    /// Moduli: one for all, float64 (1,), or one per tet, (n_tets,); density in g/cm^3, 0 leaves inertia out.
    #[new]
    #[pyo3(signature = (nodes, tets, held_nodes, young, poisson, *, density))]
    fn new(
        py: Python<'_>,
        nodes: &Bound<'_, PyAny>,
        tets: &Bound<'_, PyAny>,
        held_nodes: &Bound<'_, PyAny>,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        density: f64,
    ) -> PyResult<Self> {
        let held = View::<i64>::new("held_nodes", held_nodes, &[&[None]])?;
        let held = held.indices::<1>(py, "held_nodes", Class::Support)?.into_flattened();
        let mesh = mesh_of(py, nodes, tets)?;
        let moduli: [&[Option<usize>]; 2] = [&[Some(1)], &[Some(mesh.n_tets())]];
        let young = View::<f64>::new("young", young, &moduli)?;
        let poisson = View::<f64>::new("poisson", poisson, &moduli)?;
        let stiffness = match (young.slice(), poisson.slice()) {
            (&[young], &[poisson]) => Stiffness::Uniform { young, poisson },
            (&[young], poisson) => {
                let young = vec![young; poisson.len()];
                Stiffness::PerTet { young, poisson: poisson.to_vec() }
            }
            (young, poisson) => {
                Stiffness::PerTet { young: young.to_vec(), poisson: poisson.to_vec() }
            }
        };
        let body = py.detach(|| AdmmBody::new(&mesh, &held, &stiffness, density));
        let body = body.map_err(|error| errors::from_fem(py, &error, None))?;
        let (n_nodes, n_held) = (body.n_nodes(), held.len());
        Ok(Self { body: Arc::new(Mutex::new(body)), n_nodes, n_held })
    }

    /// Move on by dt seconds: forces, float64 (n_nodes, 3) mN; prescribed, float64 (n_held, 3) mm, the displacement of held
    /// nodes at the end. Returns the gap of the local steps (1) and the largest change of the last iteration (mm).
    #[pyo3(signature = (dt, n_iterations, *, forces=None, prescribed=None, threads=0))]
    fn step(
        &self,
        py: Python<'_>,
        dt: f64,
        n_iterations: usize,
        forces: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        threads: usize,
    ) -> PyResult<(f64, f64)> {
        let three = Some(3);
        let forces = View::<f64>::optional("forces", forces, &[&[Some(self.n_nodes), three]])?;
        let wanted: &[Option<usize>] = &[Some(self.n_held), three];
        let prescribed = View::<f64>::optional("prescribed", prescribed, &[wanted])?;
        let forces = forces.map(|rows| rows.rows::<3>().to_vec());
        let prescribed = prescribed.map(|rows| rows.rows::<3>().to_vec());
        let report = lock::run_released(py, threads, |par| {
            let mut body = self.locked();
            body.set_parallel(!matches!(par, Par::Seq));
            body.step(dt, n_iterations, forces.as_deref(), prescribed.as_deref())
        });
        let report = report.map_err(|error| errors::from_fem(py, &error, None))?;
        Ok((report.gap, report.last_change))
    }

    /// Put the nodes elsewhere: displacement, float64 (n_nodes, 3) mm, and velocity, mm/s.
    fn set_state(
        &self,
        py: Python<'_>,
        displacement: &Bound<'_, PyAny>,
        velocity: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let wanted: &[Option<usize>] = &[Some(self.n_nodes), Some(3)];
        let displacement = View::<f64>::new("displacement", displacement, &[wanted])?;
        let velocity = View::<f64>::new("velocity", velocity, &[wanted])?;
        let done = self.locked().set_state(displacement.rows::<3>(), velocity.rows::<3>());
        done.map_err(|error| errors::from_fem(py, &error, None))
    }

    /// Displacement of every node, float64 (n_nodes, 3), mm.
    #[getter]
    fn displacement<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self.locked().displacement().to_vec();
        arrays::from_points(py, rows)
    }

    /// Velocity of every node, float64 (n_nodes, 3), mm/s.
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self.locked().velocity().to_vec();
        arrays::from_points(py, rows)
    }

    /// Mass of every node, float64 (n_nodes,), kg.
    #[getter]
    fn masses<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.locked().masses().to_vec().into_pyarray(py)
    }

    /// Number of nodes.
    #[getter]
    fn n_nodes(&self) -> usize {
        self.n_nodes
    }

    fn __repr__(&self) -> String {
        format!("AdmmBody(n_nodes={}, n_held={})", self.n_nodes, self.n_held)
    }
}

impl PyAdmmBody {
    /// A step leaves the state whole, so that a poisoned lock holds a usable one.
    fn locked(&self) -> MutexGuard<'_, AdmmBody> {
        self.body.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
