//! Material laws and the fields of stiffness they take.
//!
//! A [`LawKind`] is a law with its shape parameters; [`Law`] adds moduli and fibres at one point and
//! answers energy, stress and tangent ([`Hyperelastic`]); [`Material`] holds the fields over a body
//! and gives the element loops the law at a quadrature point.
//!
//! All laws are formed from `h = F − I` with the terms of first order taken out by hand: at strains
//! of 1e-10 energy and stress keep some fourteen digits.

mod bimodular;
mod declaration;
mod fibre;
mod field;
mod free_sides;
pub mod homogeneous;
mod invariants;
mod kind;
mod kinematics;
mod law;
mod laws;
mod linear;
mod neo_hookean;
mod principal;
mod shape;
mod spectrum;
mod stiffness;
mod tensor;

pub use declaration::{Declaration, Range, ShapeParameter};
pub use fibre::Fibre;
pub use field::Material;
pub(crate) use field::PlainLaws;
pub(crate) use free_sides::{FreeSides, PiecePoint, is_finite};
pub use kind::{LawKind, OgdenTerms, Parameter};
pub use kinematics::Volumetric;
pub use law::Law;
pub use neo_hookean::NeoHookean;
pub(crate) use shape::Shape;
pub(crate) use spectrum::eigen;
pub use stiffness::{Directions, Fibres, Stiffness};
pub use tensor::det_f_minus_one;
pub(crate) use tensor::{cofactor, product, square, x_minus_log};

/// A matrix of three rows, `[i][j]`.
pub type Matrix3 = [[f64; 3]; 3];

/// Derivative of a stress by a displacement gradient: `[3 i + j][3 k + l] = ∂P_ij/∂h_kl`.
pub type Tangent = [[f64; 9]; 9];

/// A law that derives its stress from an energy: how [`Law`] and [`NeoHookean`] are read at a point.
///
/// A solve takes the laws of [`LawKind`] alone, by [`Material::with_law`]: implementing this trait
/// for a type of yours does not bring it into one.
///
/// All methods take the displacement gradient `h[i][j] = ∂u_i/∂X_j` (dimensionless) instead of
/// `F = I + h`, so that small strains keep their digits, and return `None` where `det F ≤ 0`
/// (Hooke's law excepted) or where an exponential overflows: a line search treats that as "too
/// far".
///
/// # Units
///
/// Energy density, stress `P` (first Piola–Kirchhoff) and tangent in kPa.
pub trait Hyperelastic {
    /// Energy density `ψ`, kPa.
    fn energy(&self, h: &Matrix3) -> Option<f64>;

    /// Stress `P = ∂ψ/∂h`, kPa.
    fn stress(&self, h: &Matrix3) -> Option<Matrix3>;

    /// Tangent `∂P/∂h`, kPa; symmetric.
    fn tangent(&self, h: &Matrix3) -> Option<Tangent>;

    /// Energy density, stress and `det F` together, for the element loop.
    fn response(&self, h: &Matrix3) -> Option<Response> {
        let det_f = 1.0 + det_f_minus_one(h);
        Some(Response { energy: self.energy(h)?, stress: self.stress(h)?, det_f })
    }
}

/// What a law answers at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// Energy density, kPa.
    pub energy: f64,
    /// First Piola–Kirchhoff stress, kPa.
    pub stress: Matrix3,
    /// Volume ratio `det F`, dimensionless.
    pub det_f: f64,
}
