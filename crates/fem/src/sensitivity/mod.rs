//! Derivatives of equilibria: of displacements and reactions by the parameters of a model.
//!
//! At an equilibrium `r(u, p) = f_int − f_ext = 0` on the free unknowns, with `K = ∂r/∂u`, index
//! `f` for free and `c` for held components,
//!
//! ```text
//! forward   K_ff u̇_f = −(ṙ_f + K_fc u̇_c),          reactions follow by ṙ + K u̇
//! adjoint   J = w_u · u + w_r · r_c,    v_c = w_r,   K_ff v_f = −(w_u,f + K_fc w_r)
//!           J̇ = v · ṙ + (w_u,c + (K v)_c) · u̇_c
//! ```
//!
//! where `ṙ` is the change of `r` at fixed displacement. One solution with the factor of `K` serves
//! one cause and all observations (forward), or one observation and all causes (adjoint): with
//! `ṙ = ∫ ∂P/∂E : ∇N`, `∂J/∂E` of a quadrature point is its volume times `∂P/∂E : ∇v`.
//!
//! Where only forces and supports count, [`Linearised::compliance`] does the adjoint solutions of many
//! observations in blocks that read the factor once, and [`Linearised::unbalanced`] gives `ṙ` of many
//! causes: their derivatives are one product of the two.
//!
//! Fibres that bear tension alone switch at zero strain, with continuous stress: a derivative is that
//! of the side that the state is on, and at the switch itself that of taut fibres.
//!
//! None are there by the place of nodes.
//!
//! # Reference
//!
//! Michaleris, Tortorelli and Vidal, *Int. J. Numer. Methods Eng.* 37, 2471 (1994).

mod adjoint;
mod cause;
mod compliance;
mod factored;
mod held;
mod linearised;
mod near;
mod rates;
mod wide;

pub use adjoint::{Adjoint, Observation};
pub use cause::Cause;
pub use compliance::Compliance;
pub use linearised::{Linearised, TangentReport};
pub use rates::Derivative;
