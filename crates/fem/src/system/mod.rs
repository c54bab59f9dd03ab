//! What is made once a body: parts and rigid modes, the elimination order, the sparsity pattern
//! and its symbolic factor; and the numeric factor made from them.

pub(crate) mod factor;
mod graph;
mod ordering;
pub(crate) mod pattern;
mod rigid;

pub use rigid::RigidModes;
pub(crate) use rigid::check_rigid_modes;
