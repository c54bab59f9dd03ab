//! What a bimodular law adds to the neo-Hookean one: stiffness of stretched fibres of all directions.
//!
//! With the principal logarithmic strains `εₐ = ln λₐ`, `⟨x⟩ = max(x, 0)`, eigenvalues `cₐ = λₐ²` of
//! `C` and the axes `Nₐ`,
//!
//! ```text
//! ψ = μ e Σₐ ⟨εₐ⟩²,   τₐ = 2 μ e ⟨εₐ⟩,   S = Σₐ τₐ/cₐ Nₐ ⊗ Nₐ
//! ```
//!
//! In logarithmic strains, because others would also stiffen the stretched directions. The
//! stress is continuous; the tangent jumps where a principal strain changes its sign.

use super::spectrum::Stretches;
use super::tensor::{plus_identity, product};
use super::{Matrix3, Tangent};

/// `τ` of an excess of 1 and shear modulus 1.
fn tau(at: &Stretches) -> [f64; 3] {
    at.log.map(|e| 2.0 * e.max(0.0))
}

/// Energy and stress of an excess of 1 and shear modulus 1.
pub(super) fn response(h: &Matrix3) -> (f64, Matrix3) {
    let at = Stretches::new(h);
    let energy = at.log.iter().map(|e| e.max(0.0).powi(2)).sum();
    (energy, product(&plus_identity(h), &at.second_stress(&tau(&at))))
}

/// Add the tangent of an excess times a shear modulus.
pub(super) fn add_tangent(modulus: f64, h: &Matrix3, sum: &mut Tangent) {
    let at = Stretches::new(h);
    let slope = |a: usize, b: usize| {
        if a == b && at.log[a] > 0.0 { 2.0 * modulus } else { 0.0 }
    };
    at.add_tangent(
        h,
        &tau(&at).map(|t| modulus * t),
        slope,
        |a, b| modulus * divided(&at, a, b),
        sum,
    );
}

/// `(τ_a − τ_b)/(c_a − c_b)`, also where they are equal.
fn divided(at: &Stretches, a: usize, b: usize) -> f64 {
    let slope = 2.0 * at.log_difference(a, b).1 / at.c[b];
    match (at.log[a] > 0.0, at.log[b] > 0.0) {
        (true, true) => slope,
        (false, false) => 0.0,
        (true, false) => slope * at.log[a] / (at.log[a] - at.log[b]),
        (false, true) => slope * at.log[b] / (at.log[b] - at.log[a]),
    }
}
