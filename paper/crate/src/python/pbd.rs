//! Particles with constraints (XPBD).

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::PyArray2;
use pyo3::prelude::*;
use tissuereg_boundary::arrays;
use tissuereg_boundary::errors::{self, Class};
use tissuereg_boundary::views::View;

use crate::{PaperError, Pbd, PbdConstraint, PbdObservation};

/// Particles whose distances, volumes and observed places are constraints with compliance.
#[pyclass(frozen, name = "Pbd", module = "tissuereg_paper._core")]
pub(crate) struct PyPbd {
    pbd: Mutex<Pbd>,
    n_particles: usize,
}

#[pymethods]
impl PyPbd {
    /// Inverse masses, float64 (n,) 1/kg, 0 for a held particle; edges, int64 (e, 2), keep their length at `places`,
    /// float64 (n, 3) mm, and tets, int64 (t, 4), their volume, with compliances of float64 (e,) mm/mN and (t,) mm^5/mN.
    #[new]
    fn new(
        py: Python<'_>,
        inverse_masses: &Bound<'_, PyAny>,
        places: &Bound<'_, PyAny>,
        edges: &Bound<'_, PyAny>,
        edge_compliance: &Bound<'_, PyAny>,
        tets: &Bound<'_, PyAny>,
        tet_compliance: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let masses = View::<f64>::new("inverse_masses", inverse_masses, &[&[None]])?;
        let n_particles = masses.slice().len();
        let places = View::<f64>::new("places", places, &[&[Some(n_particles), Some(3)]])?;
        let distances = constraints::<2>(py, ["edges", "edge_compliance"], edges, edge_compliance)?;
        let volumes = constraints::<4>(py, ["tets", "tet_compliance"], tets, tet_compliance)?;
        let made = Pbd::new(masses.slice().to_vec(), &distances, &volumes)
            .and_then(|mut pbd| pbd.set_rest(places.rows::<3>()).map(|()| pbd));
        let pbd = made.map_err(|error| raised(py, &error))?;
        Ok(Self { pbd: Mutex::new(pbd), n_particles })
    }

    /// Keep the lengths and volumes of other places, float64 (n, 3) mm.
    fn set_rest(&self, py: Python<'_>, places: &Bound<'_, PyAny>) -> PyResult<()> {
        let places = View::<f64>::new("places", places, &[&[Some(self.n_particles), Some(3)]])?;
        let done = self.locked().set_rest(places.rows::<3>());
        done.map_err(|error| raised(py, &error))
    }

    /// Places, float64 (n, 3) mm, moved until they meet the constraints and observations: the mean with weights, float64
    /// (m, k), of particles, int64 (m, k), at observed, float64 (m, 3) mm, with compliance, float64 (m,) mm/mN.
    #[allow(clippy::too_many_arguments)] // one call a frame
    fn project<'py>(
        &self,
        py: Python<'py>,
        places: &Bound<'py, PyAny>,
        particles: &Bound<'py, PyAny>,
        weights: &Bound<'py, PyAny>,
        observed: &Bound<'py, PyAny>,
        compliance: &Bound<'py, PyAny>,
        dt: f64,
        n_iterations: usize,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let places = View::<f64>::new("places", places, &[&[Some(self.n_particles), Some(3)]])?;
        let particles = View::<i64>::new("particles", particles, &[&[None, None]])?;
        let (m, k) = (particles.shape()[0], particles.shape()[1]);
        let weights = View::<f64>::new("weights", weights, &[&[Some(m), Some(k)]])?;
        let observed = View::<f64>::new("observed", observed, &[&[Some(m), Some(3)]])?;
        let compliance = View::<f64>::new("compliance", compliance, &[&[Some(m)]])?;
        let indices = particles.indices::<1>(py, "particles", Class::Mesh)?.into_flattened();
        let pairs: Vec<(usize, f64)> =
            indices.into_iter().zip(weights.slice().iter().copied()).collect();
        let observations: Vec<PbdObservation> = (0..m)
            .map(|row| PbdObservation {
                weights: pairs[row * k..(row + 1) * k].to_vec(),
                place: observed.rows::<3>()[row],
                compliance: compliance.slice()[row],
            })
            .collect();
        let mut moved = places.rows::<3>().to_vec();
        let done = py.detach(|| self.locked().project(&mut moved, &observations, dt, n_iterations));
        done.map_err(|error| raised(py, &error))?;
        arrays::from_points(py, moved)
    }

    /// Number of particles.
    #[getter]
    fn n_particles(&self) -> usize {
        self.n_particles
    }

    fn __repr__(&self) -> String {
        format!("Pbd(n_particles={})", self.n_particles)
    }
}

impl PyPbd {
    /// Rest and multipliers are whole after any call, so that a poisoned lock holds a usable state.
    fn locked(&self) -> MutexGuard<'_, Pbd> {
        self.pbd.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Constraints of one family; their rests are set afterwards.
fn constraints<const N: usize>(
    py: Python<'_>,
    names: [&str; 2],
    particles: &Bound<'_, PyAny>,
    compliance: &Bound<'_, PyAny>,
) -> PyResult<Vec<PbdConstraint<N>>> {
    let particles = View::<i64>::new(names[0], particles, &[&[None, Some(N)]])?;
    let particles = particles.indices::<N>(py, names[0], Class::Mesh)?;
    let compliance = View::<f64>::new(names[1], compliance, &[&[Some(particles.len())]])?;
    let all = particles.into_iter().zip(compliance.slice());
    Ok(all
        .map(|(particles, &compliance)| PbdConstraint { particles, rest: 0.0, compliance })
        .collect())
}

/// The exception for an error of particles.
fn raised(py: Python<'_>, error: &PaperError) -> PyErr {
    match error {
        PaperError::NoSuchParticle { particle, .. } => {
            let place = format!("particle {particle}");
            errors::raise(py, Class::Mesh, &error.to_string(), Some(&place))
        }
        PaperError::Fem(error) => errors::from_fem(py, error, None),
    }
}
