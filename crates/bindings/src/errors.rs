//! Exceptions for the errors of `tissuereg-esmda` and `tissuereg-contacts`.

use pyo3::prelude::*;
use tissuereg_boundary::errors::{Class, raise, raise_with};
use tissuereg_contacts::{self as contacts, ContactsError};
use tissuereg_esmda::{self as esmda, EsmdaError};

/// The exception for an error of `tissuereg-esmda`.
pub(crate) fn from_esmda(py: Python<'_>, error: &EsmdaError) -> PyErr {
    use EsmdaError as E;
    let class = match error.class() {
        esmda::ErrorClass::Schedule => Class::Schedule,
        esmda::ErrorClass::Noise => Class::Noise,
        esmda::ErrorClass::Argument => Class::Argument,
        esmda::ErrorClass::Order => Class::Base,
        esmda::ErrorClass::Convergence => Class::Convergence,
        esmda::ErrorClass::Shape => Class::Shape,
        esmda::ErrorClass::Observed => Class::Marker,
        esmda::ErrorClass::Ensemble => Class::Ensemble,
    };
    raise_with(py, class, &error.to_string(), error.place().as_deref(), |details| match error {
        E::TooFewMembers { dropped, .. } => {
            let dropped: Vec<(usize, String)> =
                dropped.iter().map(|(member, reason)| (*member, reason.to_string())).collect();
            details.set_item("dropped", dropped)
        }
        E::NoiseNotPositiveDefinite { pivot } => details.set_item("pivot", pivot),
        _ => Ok(()),
    })
}

/// The exception for an error of `tissuereg-contacts`.
pub(crate) fn from_contacts(py: Python<'_>, error: &ContactsError) -> PyErr {
    let class = match error.class() {
        contacts::ErrorClass::Shape => Class::Shape,
        contacts::ErrorClass::Observed => Class::Marker,
        contacts::ErrorClass::Setting => Class::Base,
        contacts::ErrorClass::Noise => Class::Noise,
    };
    raise(py, class, &error.to_string(), Some(error.place()))
}
