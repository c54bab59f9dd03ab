//! `tissuereg._core`: the three core crates as Python sees them.
//!
//! Every wrapper checks, views, releases the lock, calls and maps, and does nothing else. Arrays come in as C-ordered
//! views (`arrays`), long calls run where Ctrl-C is heard (`lock`), errors leave as the classes of
//! `tissuereg/errors.py` (`errors`).
#![deny(unsafe_code)]

mod arrays;
mod contacts;
mod errors;
mod esmda;
mod fem;
mod gauss_newton;
mod localized;
mod lock;
mod report;

use pyo3::prelude::*;

/// The compiled part of tissuereg.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::contacts::Contacts;
    #[pymodule_export]
    use super::esmda::{
        Noise, Step, check_schedule, next_alpha, schedule_constant, schedule_geometric,
        screen_members,
    };
    #[pymodule_export]
    use super::fem::{
        Adjoints, Body, Cause, Compliance, Law, Linearised, ManySolutions, PyAdmmBody, PyPbd, Rig,
        RigFrame, Solution, check_mesh, laws, surface_triangles, tet_volumes,
    };
    #[pymodule_export]
    use super::localized::{LocalizedStep, gaspari_cohn};

    #[pymodule_export]
    use super::gauss_newton::{GaussNewton, GroupScores};

    /// Version of all parts, from the workspace.
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
