//! Meshes without a body.

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArray4};
use pyo3::prelude::*;
use tissuereg_boundary::mesh::{mesh_of, tets_of};
use tissuereg_boundary::views::View;
use tissuereg_boundary::{arrays, errors, lock};
use tissuereg_fem::Slab;

/// Raises MeshError unless nodes, float64 (n, 3) mm, and tets, int64 (m, 4), make a mesh.
#[pyfunction]
pub(crate) fn check_mesh(
    py: Python<'_>,
    nodes: &Bound<'_, PyAny>,
    tets: &Bound<'_, PyAny>,
) -> PyResult<()> {
    mesh_of(py, nodes, tets).map(|_| ())
}

/// Surface triangles of a mesh, int64 (t, 3), normals outward.
#[pyfunction]
pub(crate) fn surface_triangles<'py>(
    py: Python<'py>,
    nodes: &Bound<'py, PyAny>,
    tets: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<i64>>> {
    arrays::from_triangles(py, mesh_of(py, nodes, tets)?.surface_triangles())
}

/// Signed volumes of tets, float64 (m,) mm^3, with their nodes at any places.
#[pyfunction]
pub(crate) fn tet_volumes<'py>(
    py: Python<'py>,
    nodes: &Bound<'py, PyAny>,
    tets: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let nodes = View::<f64>::new("nodes", nodes, &[&[None, Some(3)]])?;
    let tets = tets_of(py, tets)?;
    let volumes = tissuereg_fem::tet_volumes(nodes.rows::<3>(), &tets);
    Ok(volumes.map_err(|error| errors::from_fem(py, &error, None))?.into_pyarray(py))
}

/// Closest rotations, float64 (n, 9), of matrices, float64 (n, 9), row by row.
#[pyfunction]
pub(crate) fn closest_rotations<'py>(
    py: Python<'py>,
    matrices: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let matrices = View::<f64>::new("matrices", matrices, &[&[None, Some(9)]])?;
    let found = tissuereg_fem::closest_rotations(matrices.rows::<9>()).into_flattened();
    let n = found.len() / 9;
    arrays::from_vec(py, found, [n, 9])
}

/// A field on a grid, and what holds each point.
type OnGrid<'py> = (Bound<'py, PyArray4<f32>>, Bound<'py, PyArray3<u8>>);

/// A nodal field at the points of slices of a grid, float32 (k, j, i, 3), and by which tets, uint8 (k, j, i): 0 none, 1
/// one before number `inner`, 2 another.
///
/// `nodes`, float64 (n, 3), in the coordinates of the grid: column, row, slice; `shape`: first slice, slices, rows,
/// columns. The last tet that holds a point decides.
#[pyfunction]
pub(crate) fn rasterise<'py>(
    py: Python<'py>,
    nodes: &Bound<'py, PyAny>,
    tets: &Bound<'py, PyAny>,
    values: &Bound<'py, PyAny>,
    inner: usize,
    shape: [usize; 4],
    threads: usize,
) -> PyResult<OnGrid<'py>> {
    let nodes = View::<f64>::new("nodes", nodes, &[&[None, Some(3)]])?;
    let values = View::<f64>::new("values", values, &[&[None, Some(3)]])?;
    let tets = tets_of(py, tets)?;
    let marks: Vec<u8> = (0..tets.len()).map(|tet| if tet < inner { 1 } else { 2 }).collect();
    let [first, slices, rows, columns] = shape;
    let slab = Slab { first, slices, rows, columns };
    let (nodes, values) = (nodes.rows::<3>(), values.rows::<3>());
    let found = lock::run_released(py, threads, |par| {
        let parallel = !matches!(par, faer::Par::Seq);
        tissuereg_fem::rasterise(nodes, &tets, values, &marks, slab, parallel)
    });
    let (field, by) = found.map_err(|error| errors::from_fem(py, &error, None))?;
    let field = arrays::from_vec(py, field, [slices, rows, columns, 3])?;
    Ok((field, arrays::from_vec(py, by, [slices, rows, columns])?))
}
