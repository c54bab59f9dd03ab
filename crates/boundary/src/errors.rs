//! One Python exception class a cause, with the numbers as attributes.
//!
//! The classes are written in Python (`tissuereg/errors.py`) and imported by name. A core error says itself what it is
//! about and where (`class`, `place`), by matches over all its variants; the lists of classes are closed, so that a new
//! variant does not compile in its crate, and a new class not here or in the binding, until it is mapped.

use pyo3::PyTypeInfo;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};
use tissuereg_fem::{ErrorClass, FemError};

use crate::report;

mod imported {
    #![allow(missing_docs)]
    use pyo3::import_exception;

    import_exception!(tissuereg.errors, TissueRegError);
    import_exception!(tissuereg.errors, ShapeError);
    import_exception!(tissuereg.errors, ArgumentError);
    import_exception!(tissuereg.errors, MeshError);
    import_exception!(tissuereg.errors, SupportError);
    import_exception!(tissuereg.errors, MaterialError);
    import_exception!(tissuereg.errors, LoadError);
    import_exception!(tissuereg.errors, MarkerError);
    import_exception!(tissuereg.errors, ScheduleError);
    import_exception!(tissuereg.errors, NoiseError);
    import_exception!(tissuereg.errors, ConvergenceError);
    import_exception!(tissuereg.errors, EnsembleError);
}

/// The classes that the binding raises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// `TissueRegError`
    Base,
    /// `ShapeError`
    Shape,
    /// `ArgumentError`
    Argument,
    /// `MeshError`
    Mesh,
    /// `SupportError`
    Support,
    /// `MaterialError`
    Material,
    /// `LoadError`
    Load,
    /// `MarkerError`
    Marker,
    /// `ScheduleError`
    Schedule,
    /// `NoiseError`
    Noise,
    /// `ConvergenceError`
    Convergence,
    /// `EnsembleError`
    Ensemble,
}

impl Class {
    fn of(self, py: Python<'_>) -> Bound<'_, PyType> {
        match self {
            Self::Base => imported::TissueRegError::type_object(py),
            Self::Shape => imported::ShapeError::type_object(py),
            Self::Argument => imported::ArgumentError::type_object(py),
            Self::Mesh => imported::MeshError::type_object(py),
            Self::Support => imported::SupportError::type_object(py),
            Self::Material => imported::MaterialError::type_object(py),
            Self::Load => imported::LoadError::type_object(py),
            Self::Marker => imported::MarkerError::type_object(py),
            Self::Schedule => imported::ScheduleError::type_object(py),
            Self::Noise => imported::NoiseError::type_object(py),
            Self::Convergence => imported::ConvergenceError::type_object(py),
            Self::Ensemble => imported::EnsembleError::type_object(py),
        }
    }
}

/// An exception of a class, with its place.
pub fn raise(py: Python<'_>, class: Class, message: &str, place: Option<&str>) -> PyErr {
    raise_with(py, class, message, place, |_| Ok(()))
}

/// The same, with further attributes. What goes wrong while it is made is raised in its stead.
pub fn raise_with(
    py: Python<'_>,
    class: Class,
    message: &str,
    place: Option<&str>,
    details: impl FnOnce(&Bound<'_, PyDict>) -> PyResult<()>,
) -> PyErr {
    let made = || {
        let keywords = PyDict::new(py);
        keywords.set_item("where", place)?;
        details(&keywords)?;
        class.of(py).call((message,), Some(&keywords))
    };
    made().map_or_else(|error| error, PyErr::from_value)
}

/// The exception for an error of `tissuereg-fem`; `member` where it concerns one of many.
pub fn from_fem(py: Python<'_>, error: &FemError, member: Option<usize>) -> PyErr {
    use FemError as E;
    let message = match member {
        Some(member) => format!("member {member}: {error}"),
        None => error.to_string(),
    };
    let class = match error.class() {
        ErrorClass::Mesh => Class::Mesh,
        ErrorClass::Support => Class::Support,
        ErrorClass::Material => Class::Material,
        ErrorClass::Load => Class::Load,
        ErrorClass::Shape => Class::Shape,
        ErrorClass::Setting => Class::Base,
        ErrorClass::Convergence => Class::Convergence,
        ErrorClass::Cancelled => return PyKeyboardInterrupt::new_err(message),
    };
    let place = match (member, error.place()) {
        (Some(member), Some(place)) => Some(format!("member {member}, {place}")),
        (Some(member), None) => Some(format!("member {member}")),
        (None, place) => place,
    };
    raise_with(py, class, &message, place.as_deref(), |details| match error {
        E::NonFiniteNode { node, .. }
        | E::UnusedNode { node, .. }
        | E::HeldNodeOutOfRange { node, .. }
        | E::HeldNodeRepeated { node }
        | E::BadObservation { node, .. } => details.set_item("node", node),
        E::NodeOutOfRange { tet, node, .. } | E::RepeatedNode { tet, node } => {
            details.set_item("tet", tet)?;
            details.set_item("node", node)
        }
        E::InvertedTet { tet, volume, .. } | E::DegenerateTet { tet, volume, .. } => {
            details.set_item("tet", tet)?;
            details.set_item("volume", volume)
        }
        E::OverlappingTets { triangle, .. } | E::MissingSprings { triangle } => {
            details.set_item("triangle", triangle.to_vec())
        }
        E::Unconstrained(rigid) => {
            details.set_item("modes", &rigid.modes)?;
            details.set_item("node", rigid.node)?;
            details.set_item("n_parts", rigid.n_parts)
        }
        E::BadYoung { entry, .. } | E::BadPoisson { entry, .. } => details.set_item("entry", entry),
        E::BadFibre { entry, .. } => details.set_item("entry", entry),
        E::NonFinite { row, .. } => details.set_item("row", row),
        E::NotOnSurface { row, triangle } | E::RepeatedFacet { row, triangle, .. } => {
            details.set_item("row", row)?;
            details.set_item("triangle", triangle.to_vec())
        }
        E::InvertedStart { tet, .. } => details.set_item("tet", tet),
        E::NoEquilibrium(failure) => details.set_item("report", report::of_failure(py, failure)?),
        _ => Ok(()),
    })
}
