//! `tissuereg_paper._core`: the rivals as Python sees them, with the exceptions of `tissuereg.errors`.

mod admm;
mod pbd;

use pyo3::prelude::*;

/// The compiled part of tissuereg-paper.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::admm::PyAdmmBody;
    #[pymodule_export]
    use super::pbd::PyPbd;

    /// Version of all parts, from the workspace.
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
