//! Meshes and helpers shared by tests, benches and examples.
#![allow(dead_code, unused_imports)]

pub mod cases;
pub mod incompressible;
pub mod laws;
mod meshes;
pub mod npz;

pub use meshes::*;
