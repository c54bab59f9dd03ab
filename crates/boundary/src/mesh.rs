//! Meshes from arrays.

use pyo3::prelude::*;
use tissuereg_fem::Mesh;

use crate::errors::{self, Class};
use crate::views::View;

/// A checked mesh of nodes, float64 (n, 3) mm, and tets, int64 (m, 4).
///
/// # Errors
///
/// `ShapeError` and `MeshError`.
pub fn mesh_of(
    py: Python<'_>,
    nodes: &Bound<'_, PyAny>,
    tets: &Bound<'_, PyAny>,
) -> PyResult<Mesh> {
    let nodes = View::<f64>::new("nodes", nodes, &[&[None, Some(3)]])?.rows::<3>().to_vec();
    let tets = tets_of(py, tets)?;
    let mesh = py.detach(|| Mesh::new(nodes, tets));
    mesh.map_err(|error| errors::from_fem(py, &error, None))
}

/// Rows of the four nodes of tets, int64 (m, 4).
///
/// # Errors
///
/// `ShapeError`, and `MeshError` for a negative number.
pub fn tets_of(py: Python<'_>, tets: &Bound<'_, PyAny>) -> PyResult<Vec<[usize; 4]>> {
    View::<i64>::new("tets", tets, &[&[None, Some(4)]])?.indices::<4>(py, "tets", Class::Mesh)
}
