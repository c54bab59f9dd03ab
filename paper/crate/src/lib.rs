//! Rival methods of the paper's contests, on meshes and laws of [`tissuereg_fem`].
//!
//! [`AdmmBody`] moves with inertia, by projective dynamics; [`Pbd`] meets distances, volumes and observed
//! places one after another. Units are those of `tissuereg_fem`: mm, kPa, mN, and s.
//!
//! With the feature `python`, the extension module `tissuereg_paper._core`.
#![deny(unsafe_code)]

mod admm;
mod check;
mod error;
mod pbd;
#[cfg(feature = "python")]
mod python;
mod vectors;

pub use admm::{AdmmBody, AdmmReport};
pub use error::PaperError;
pub use pbd::{Pbd, PbdConstraint, PbdObservation};
