//! Arrays out: they own what the core returned.

use numpy::{Element, IntoPyArray, PyArray, PyArrayMethods};
use pyo3::prelude::*;

/// An array of any shape over the entries given; their number must fit.
///
/// # Errors
///
/// What numpy raises where the number of entries does not fit.
pub fn from_vec<'py, T: Element, const N: usize>(
    py: Python<'py>,
    values: Vec<T>,
    shape: [usize; N],
) -> PyResult<Bound<'py, PyArray<T, numpy::ndarray::Dim<[usize; N]>>>>
where
    numpy::ndarray::Dim<[usize; N]>: numpy::ndarray::Dimension,
    [usize; N]: numpy::ndarray::IntoDimension<Dim = numpy::ndarray::Dim<[usize; N]>>,
{
    values.into_pyarray(py).reshape(shape)
}

/// Points, one per row.
///
/// # Errors
///
/// What numpy raises where the number of entries does not fit.
pub fn from_points(
    py: Python<'_>,
    points: Vec<[f64; 3]>,
) -> PyResult<Bound<'_, numpy::PyArray2<f64>>> {
    let n = points.len();
    from_vec(py, points.into_flattened(), [n, 3])
}

/// Node numbers of triangles, one per row.
///
/// # Errors
///
/// What numpy raises where the number of entries does not fit.
pub fn from_triangles<'py>(
    py: Python<'py>,
    triangles: &[[usize; 3]],
) -> PyResult<Bound<'py, numpy::PyArray2<i64>>> {
    let flat: Vec<i64> = triangles.as_flattened().iter().map(|&node| node as i64).collect();
    from_vec(py, flat, [triangles.len(), 3])
}
