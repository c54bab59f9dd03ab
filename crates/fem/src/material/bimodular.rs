//! What a bimodular law adds to the neo-Hookean one: stiffness of stretched fibres of all directions.
//!
//! With the principal values `Eₐ` of the Green–Lagrange strain, `⟨x⟩ = max(x, 0)` and the axes `Nₐ`,
//!
//! ```text
//! ψ = μ e Σₐ ⟨Eₐ⟩²,   S = 2 μ e Σₐ ⟨Eₐ⟩ Nₐ ⊗ Nₐ
//! ```
//!
//! The stress is continuous; the tangent jumps where a principal strain changes its sign.

use super::principal::eigen;
use super::tensor::{add_outer, add_rows, matrix, plus_identity, product, strain};
use super::{Matrix3, Tangent};

/// Positive parts of the principal strains, and all that is needed of the rest.
struct Stretched {
    /// Principal Green–Lagrange strains.
    e: [f64; 3],
    /// Their axes, one a column.
    axes: Matrix3,
}

impl Stretched {
    fn new(h: &Matrix3) -> Self {
        let (values, axes) = eigen(strain(h));
        Self { e: values.map(|v| 0.5 * v), axes }
    }

    /// `Σ ⟨Eₐ⟩ Nₐ ⊗ Nₐ`
    fn part(&self) -> Matrix3 {
        let term =
            |i: usize, j: usize, a: usize| self.e[a].max(0.0) * self.axes[i][a] * self.axes[j][a];
        matrix(|i, j| (0..3).map(|a| term(i, j, a)).sum())
    }

    /// `(⟨Eₐ⟩ − ⟨E_b⟩) / (Eₐ − E_b)`, between 0 and 1.
    fn divided(&self, a: usize, b: usize) -> f64 {
        let (own, other) = (self.e[a], self.e[b]);
        match (own > 0.0, other > 0.0) {
            (true, true) => 1.0,
            (false, false) => 0.0,
            (true, false) => own / (own - other),
            (false, true) => other / (other - own),
        }
    }
}

/// Energy and stress of an excess of 1 and shear modulus 1.
pub(super) fn response(h: &Matrix3) -> (f64, Matrix3) {
    let stretched = Stretched::new(h);
    let energy = stretched.e.iter().map(|e| e.max(0.0) * e.max(0.0)).sum();
    let second = stretched.part().map(|row| row.map(|v| 2.0 * v));
    (energy, product(&plus_identity(h), &second))
}

/// Add the tangent of an excess times a shear modulus.
pub(super) fn add_tangent(modulus: f64, h: &Matrix3, sum: &mut Tangent) {
    let stretched = Stretched::new(h);
    add_rows(sum, 2.0 * modulus, &stretched.part());
    let pushed = product(&plus_identity(h), &stretched.axes);
    // (F N_a) ⊗ N_b
    let dyad = |a: usize, b: usize| matrix(|i, j| pushed[i][a] * stretched.axes[j][b]);
    for a in 0..3 {
        let own = dyad(a, a);
        add_outer(sum, 2.0 * modulus * stretched.divided(a, a), &own, &own);
        for b in 0..a {
            let (ab, ba) = (dyad(a, b), dyad(b, a));
            let mixed = matrix(|i, j| ab[i][j] + ba[i][j]);
            add_outer(sum, modulus * stretched.divided(a, b), &mixed, &mixed);
        }
    }
}
