//! Meshes and helpers shared by tests, benches and examples.
#![allow(dead_code, unused_imports, clippy::expect_used, clippy::panic)]

pub mod cases;
pub mod incompressible;
pub mod laws;
mod meshes;
pub mod npz;

pub use meshes::*;
