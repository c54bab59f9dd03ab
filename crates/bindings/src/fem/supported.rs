//! A body with its springs, and what is checked against it.

use std::sync::Arc;

use pyo3::prelude::*;
use tissuereg_boundary::errors;
use tissuereg_boundary::views::View;
use tissuereg_fem::{Body, Load, Material, Precision, SolveSettings};

use super::bed::Bed;
use super::law::{Law, warn_of_locking};

/// A body and its springs; copies share both.
#[derive(Debug, Clone)]
pub(super) struct Supported {
    pub(super) body: Arc<Body>,
    pub(super) bed: Arc<Bed>,
}

/// An equilibrium and what it is one of, checked and copied.
pub(super) struct Problem {
    pub(super) material: Material,
    pub(super) load: Load,
    pub(super) displacement: Vec<[f64; 3]>,
    pub(super) precision: Precision,
    pub(super) settings: SolveSettings,
}

impl Supported {
    /// The material of one law and its moduli; warns where its elements lock.
    pub(super) fn material(
        &self,
        [young, poisson]: [&Bound<'_, PyAny>; 2],
        law: Option<&Law>,
    ) -> PyResult<Material> {
        let (py, body) = (young.py(), &self.body);
        let (n_tets, n_points) = (Some(body.n_tets()), Some(body.element().n_points()));
        let moduli: [&[Option<usize>]; 3] = [&[Some(1)], &[n_tets], &[n_tets, n_points]];
        let young = View::<f64>::new("young", young, &moduli)?;
        let poisson = View::<f64>::new("poisson", poisson, &moduli)?;
        let material = law
            .map_or(&Law::default(), |law| law)
            .material(body.element(), body.n_tets(), young.slice(), poisson.slice())
            .map_err(|error| errors::from_fem(py, &error, None))?;
        warn_of_locking(py, body.element(), [&material].into_iter(), poisson.slice())?;
        Ok(material)
    }

    /// A load, on the body's own springs unless it has others.
    pub(super) fn load(
        &self,
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        springs: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Load> {
        let (body, three) = (&self.body, Some(3));
        let (all, corners) = (Some(body.n_nodes()), Some(body.n_corner_nodes()));
        let forces = View::<f64>::optional("forces", forces, &[&[all, three], &[corners, three]])?;
        let body_force = View::<f64>::optional("body_force", body_force, &[&[three]])?;
        let n_held = Some(body.held_nodes().len());
        let prescribed = View::<f64>::optional("prescribed", prescribed, &[&[n_held, three]])?;
        Ok(Load {
            nodal_forces: forces.map(|rows| rows.rows::<3>().to_vec()),
            body_force: body_force.and_then(|v| v.rows().first().copied()).unwrap_or_default(),
            prescribed: prescribed.map(|rows| rows.rows::<3>().to_vec()),
            springs: self.bed.given(springs)?,
        })
    }

    /// One row per node.
    pub(super) fn field(&self, name: &str, rows: &Bound<'_, PyAny>) -> PyResult<Vec<[f64; 3]>> {
        let wanted: [&[Option<usize>]; 1] = [&[Some(self.body.n_nodes()), Some(3)]];
        Ok(View::<f64>::new(name, rows, &wanted)?.rows::<3>().to_vec())
    }
}
