//! One Python exception class a cause, with the numbers as attributes.
//!
//! The classes are written in Python (`tissuereg/errors.py`) and imported by name. Neither enum of the core crates is
//! `#[non_exhaustive]`: a new variant does not compile here until it is mapped.

use pyo3::PyTypeInfo;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};
use tissuereg_contacts::ContactsError;
use tissuereg_esmda::EsmdaError;
use tissuereg_fem::{Element, FemError, Material};

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
pub(crate) enum Class {
    Base,
    Shape,
    Argument,
    Mesh,
    Support,
    Material,
    Load,
    Marker,
    Schedule,
    Noise,
    Convergence,
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

/// Warn, once a call, of linear tets that lock with one of these materials, whose largest Poisson's ratio is among
/// `poisson`.
pub(crate) fn warn_of_locking<'a>(
    py: Python<'_>,
    element: Element,
    mut materials: impl Iterator<Item = &'a Material>,
    poisson: &[f64],
) -> PyResult<()> {
    if element == Element::Tet4 && materials.any(Material::locks_linear_tets) {
        let largest = poisson.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        py.import("tissuereg._base.locking")?.call_method1("warn_of_locking", (largest,))?;
    }
    Ok(())
}

/// An exception of a class, with its place.
pub(crate) fn raise(py: Python<'_>, class: Class, message: &str, place: Option<&str>) -> PyErr {
    raise_with(py, class, message, place, |_| Ok(()))
}

/// The same, with further attributes. What goes wrong while it is made is raised in its stead.
fn raise_with(
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
pub(crate) fn from_fem(py: Python<'_>, error: &FemError, member: Option<usize>) -> PyErr {
    use FemError as E;
    let message = match member {
        Some(member) => format!("member {member}: {error}"),
        None => error.to_string(),
    };
    let (class, place) = fem_class(error);
    let place = match (member, place) {
        (Some(member), Some(place)) => Some(format!("member {member}, {place}")),
        (Some(member), None) => Some(format!("member {member}")),
        (None, place) => place,
    };
    if matches!(error, E::Cancelled) {
        return PyKeyboardInterrupt::new_err(message);
    }
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

/// Class and place.
fn fem_class(error: &FemError) -> (Class, Option<String>) {
    use FemError as E;
    match error {
        E::EmptyMesh { .. } | E::SingularStiffness { .. } | E::TooLarge { .. } => {
            (Class::Mesh, None)
        }
        E::NonFiniteNode { node, .. } | E::UnusedNode { node, .. } => {
            (Class::Mesh, Some(format!("node {node}")))
        }
        E::NodeOutOfRange { tet, .. }
        | E::RepeatedNode { tet, .. }
        | E::InvertedTet { tet, .. }
        | E::DegenerateTet { tet, .. } => (Class::Mesh, Some(format!("tet {tet}"))),
        E::OverlappingTets { triangle: [a, b, c], .. } => {
            (Class::Mesh, Some(format!("triangle {a} {b} {c}")))
        }
        E::HeldNodeOutOfRange { node, .. } | E::HeldNodeRepeated { node } => {
            (Class::Support, Some(format!("held node {node}")))
        }
        E::Unconstrained(rigid) => (Class::Support, Some(format!("node {}", rigid.node))),
        E::BadYoung { entry, .. } => (Class::Material, Some(format!("young, entry {entry}"))),
        E::BadPoisson { entry, .. } => (Class::Material, Some(format!("poisson, entry {entry}"))),
        E::NoSuchParticle { particle, .. } => (Class::Mesh, Some(format!("particle {particle}"))),
        E::BadLaw { name, .. } => (Class::Material, Some((*name).to_owned())),
        E::BadFibre { entry, .. } => (Class::Material, Some(format!("direction, entry {entry}"))),
        E::WrongLength { what, .. } => (Class::Shape, Some((*what).to_owned())),
        E::NonFinite { what, row, .. } => (Class::Load, Some(format!("{what}, row {row}"))),
        E::NotOnSurface { row, .. } | E::RepeatedFacet { row, .. } => {
            (Class::Load, Some(format!("triangle {row}")))
        }
        E::BadSetting { name, .. } => (Class::Base, Some((*name).to_owned())),
        E::BadParameter { name, .. } => (Class::Material, Some((*name).to_owned())),
        E::TimeRunsBack { time_s, .. } => (Class::Load, Some(format!("time {time_s} s"))),
        E::MissingSprings { triangle: [a, b, c] } => {
            (Class::Support, Some(format!("triangle {a} {b} {c}")))
        }
        E::NoRestShape { .. } | E::NotInEquilibrium { .. } | E::NotStable { .. } => {
            (Class::Convergence, None)
        }
        E::NoSuchCause { what } => (Class::Material, Some(what.clone())),
        E::BadObservation { what, node, .. } => (Class::Load, Some(format!("{what}, node {node}"))),
        E::InvertedStart { tet, .. } => (Class::Load, Some(format!("start, tet {tet}"))),
        E::NoEquilibrium(failure) => {
            let worst = failure.worst_tets.first();
            (Class::Convergence, worst.map(|worst| format!("tet {}", worst.tet)))
        }
        E::NothingRecorded | E::Cancelled => (Class::Base, None),
        // A variant that is newer than this list; `tests/layout` fails for it.
        _ => (Class::Base, None),
    }
}

/// The exception for an error of `tissuereg-esmda`.
pub(crate) fn from_esmda(py: Python<'_>, error: &EsmdaError) -> PyErr {
    use EsmdaError as E;
    let (class, place) = match error {
        E::EmptySchedule | E::ScheduleSum { .. } => (Class::Schedule, None),
        E::Decrease { .. } => (Class::Schedule, Some("decrease".to_owned())),
        E::Alpha { step, .. } | E::StepBeyondSchedule { step, .. } => {
            (Class::Schedule, Some(format!("step {step}")))
        }
        E::NoiseStd { obs, .. } => (Class::Noise, Some(format!("observation {obs}"))),
        E::NoiseNotFinite { row, column, .. } | E::NoiseNotSymmetric { row, column, .. } => {
            (Class::Noise, Some(format!("row {row}, column {column}")))
        }
        E::NoiseNotPositiveDefinite { pivot } => (Class::Noise, Some(format!("pivot {pivot}"))),
        E::Overflow => (Class::Noise, None),
        E::PriorNotSymmetric { row, column, .. } => {
            (Class::Argument, Some(format!("row {row}, column {column}")))
        }
        E::PriorNotPositiveDefinite { pivot } => (Class::Argument, Some(format!("pivot {pivot}"))),
        E::NotFinite {
            argument: argument @ ("mean" | "covariance" | "start" | "residual" | "absorbed"),
            row,
            column,
            ..
        } => (Class::Argument, Some(format!("{argument}, row {row}, column {column}"))),
        E::Setting { name, .. } => (Class::Argument, Some((*name).to_owned())),
        E::OutOfOrder { call, .. } => (Class::Base, Some((*call).to_owned())),
        E::NoDifference { direction } => {
            (Class::Ensemble, Some(format!("prior direction {direction}")))
        }
        E::NoMinimum { .. } => (Class::Convergence, None),
        E::Shape { argument, .. } => (Class::Shape, Some((*argument).to_owned())),
        E::NoObservations => (Class::Shape, Some("predicted".to_owned())),
        E::NotFinite { argument: "observed", row, .. } => {
            (Class::Marker, Some(format!("observed, row {row}")))
        }
        E::NotFinite { argument: argument @ ("columns" | "noise"), row, column, .. } => {
            (Class::Noise, Some(format!("{argument}, row {row}, column {column}")))
        }
        E::NotFinite { argument, column, .. } => {
            (Class::Ensemble, Some(format!("{argument}, member {column}")))
        }
        E::TooLarge { column, .. } => {
            (Class::Ensemble, Some(format!("predicted, member {column}")))
        }
        E::TooFewMembers { .. } | E::NoConvergence { .. } => (Class::Ensemble, None),
        E::ParameterStd { row, .. } => (Class::Argument, Some(format!("std, row {row}"))),
        E::Taper { row, column, .. } => {
            (Class::Argument, Some(format!("taper, row {row}, column {column}")))
        }
        E::Threshold { .. } => (Class::Argument, Some("threshold".to_owned())),
        E::Truncation { .. } => (Class::Argument, Some("truncation".to_owned())),
        _ => (Class::Base, None),
    };
    raise_with(py, class, &error.to_string(), place.as_deref(), |details| match error {
        E::TooFewMembers { dropped, .. } => {
            let dropped: Vec<(usize, String)> =
                dropped.iter().map(|(member, reason)| (*member, reason.to_string())).collect();
            details.set_item("dropped", dropped)
        }
        E::NoiseNotPositiveDefinite { pivot } | E::PriorNotPositiveDefinite { pivot } => {
            details.set_item("pivot", pivot)
        }
        E::NoMinimum { evaluations, step, tolerance } => {
            let report = PyDict::new(py);
            report.set_item("evaluations", evaluations)?;
            report.set_item("last_step", step)?;
            report.set_item("tolerance", tolerance)?;
            details.set_item("report", report)
        }
        _ => Ok(()),
    })
}

/// The exception for an error of `tissuereg-contacts`.
pub(crate) fn from_contacts(py: Python<'_>, error: &ContactsError) -> PyErr {
    use ContactsError as E;
    let (class, place) = match error {
        E::Shape { argument, .. } | E::Index { argument, .. } => (Class::Shape, Some(*argument)),
        E::NotFinite { argument: "innovation", .. } => (Class::Marker, Some("innovation")),
        E::NotFinite { argument, .. } | E::Range { argument, .. } => (Class::Base, Some(*argument)),
        E::NotPositiveDefinite { .. } => (Class::Noise, Some("noise")),
        _ => (Class::Base, None),
    };
    raise(py, class, &error.to_string(), place)
}
