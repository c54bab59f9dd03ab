//! Energy, internal forces and tangent of a displacement field.
//!
//! For every element and quadrature point, with `h` from [`crate::element`] and weight `w`:
//!
//! ```text
//! W    += w ψ(h)
//! f_ai += w Σ_j P_ij ∂N_a/∂X_j                           (3) a node
//! K_ab += w Σ_jl ∂N_a/∂X_j A_ijkl ∂N_b/∂X_l              (3, 3) a pair of nodes
//! ```
//!
//! In parallel, element forces are written to a buffer and then summed node by node in the order
//! of the elements; alone, they are added at once, in the same order. Energies are summed in fixed
//! chunks. So the bits do not depend on the number of threads.

mod averaged;
mod averaged_neo_hookean;
mod averaged_tangent;
mod averages;
mod force;
mod lanes;
mod loops;
mod nodal;
mod packs;
mod points;
mod tangent;
#[cfg(test)]
mod tests;

pub(crate) use force::internal_force_into;
pub(crate) use loops::{Energy, PointModel, Remembered, TangentKind};
pub(crate) use nodal::NodalGradients;
pub(crate) use points::{PointMap, det_f_by_element, gradients_at_points, point_volumes};
pub(crate) use tangent::{ElementTangents, tangent_product_into};
