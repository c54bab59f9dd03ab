//! `tissuereg._core`: the three core crates as Python sees them.
//!
//! Every wrapper checks, views, releases the lock, calls and maps, and does nothing else, with what `tissuereg-boundary`
//! has for it.
#![deny(unsafe_code)]

mod contacts;
mod errors;
mod esmda;
mod fem;
mod group_scores;

use pyo3::prelude::*;

/// The compiled part of tissuereg.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::contacts::Contacts;
    #[pymodule_export]
    use super::esmda::{
        Noise, Step, check_schedule, schedule_geometric, score_components, screen_members,
    };
    #[pymodule_export]
    use super::fem::{
        Adjoints, Behaviour, Body, Cause, Compliance, Law, Linearised, ManySolutions, Rig,
        RigFrame, Solution, check_mesh, closest_rotations, laws, rasterise, surface_triangles,
        tet_volumes,
    };

    #[pymodule_export]
    use super::group_scores::GroupScores;

    /// Version of all parts, from the workspace.
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
