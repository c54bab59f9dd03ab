//! Arguments that several calls take.

use pyo3::prelude::*;
use tissuereg_boundary::errors::{self, Class};
use tissuereg_boundary::views::View;
use tissuereg_fem::{Element, LoadSteps, Method, SolveSettings};

/// An element by its name.
pub(super) fn element_of(py: Python<'_>, name: &str) -> PyResult<Element> {
    match name {
        "tet4" => Ok(Element::Tet4),
        "tet4-averaged" => Ok(Element::Tet4Averaged),
        "tet10" => Ok(Element::Tet10),
        other => Err(bad_choice(py, "element", "`tet4`, `tet4-averaged` or `tet10`", other)),
    }
}

/// Settings of a solve.
pub(super) fn settings_of(
    py: Python<'_>,
    tolerance: f64,
    max_iterations: usize,
    method: &str,
    load_steps: usize,
    threads: usize,
) -> PyResult<SolveSettings> {
    let method = match method {
        "auto" => Method::Auto,
        "newton" => Method::Newton,
        "quasi-newton" => Method::QuasiNewton,
        other => return Err(bad_choice(py, "method", "`auto`, `newton` or `quasi-newton`", other)),
    };
    let load_steps = if load_steps == 0 { LoadSteps::Auto } else { LoadSteps::Equal(load_steps) };
    let settings = SolveSettings::default()
        .with_tolerance(tolerance)
        .with_max_iterations(max_iterations)
        .with_method(method)
        .with_load_steps(load_steps);
    Ok(settings.with_n_threads(threads))
}

/// The error for a word that is none of those wanted.
pub(super) fn bad_choice(py: Python<'_>, name: &str, wanted: &str, found: &str) -> PyErr {
    errors::raise(py, Class::Base, &format!("`{name}` must be {wanted}, got `{found}`"), Some(name))
}

/// Numbers of nodes that are held.
pub(super) fn nodes_of(
    py: Python<'_>,
    name: &str,
    nodes: &Bound<'_, PyAny>,
) -> PyResult<Vec<usize>> {
    let view = View::<i64>::new(name, nodes, &[&[None]])?;
    Ok(view.indices::<1>(py, name, Class::Support)?.into_flattened())
}

/// Triangles of the surface.
pub(super) fn triangles_of(name: &str, triangles: &Bound<'_, PyAny>) -> PyResult<Vec<[usize; 3]>> {
    let view = View::<i64>::new(name, triangles, &[&[None, Some(3)]])?;
    view.indices::<3>(triangles.py(), name, Class::Load)
}

/// As many numbers as are wanted.
pub(super) fn exactly<const N: usize>(
    py: Python<'_>,
    name: &str,
    numbers: &[f64],
) -> PyResult<[f64; N]> {
    numbers.try_into().map_err(|_| {
        let message = format!("`{name}` must have {N} numbers a set, got {}", numbers.len());
        errors::raise(py, Class::Shape, &message, Some(name))
    })
}
