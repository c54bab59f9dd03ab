//! What a bimodular law adds to the neo-Hookean one: stiffness of stretched fibres of all directions.
//!
//! With the principal values `Eₐ` of the Green–Lagrange strain, `⟨x⟩ = max(x, 0)` and the axes `Nₐ`,
//!
//! ```text
//! ψ = μ e Σₐ ⟨Eₐ⟩²,   S = 2 μ e Σₐ ⟨Eₐ⟩ Nₐ ⊗ Nₐ
//! ```
//!
//! The stress is continuous; the tangent jumps where a principal strain changes its sign.

use super::spectrum::Spectrum;
use super::tensor::{add_outer, add_rows, plus_identity, product, strain};
use super::{Matrix3, Tangent};

/// `E`, whose positive part the law feels.
struct Stretched {
    spectrum: Spectrum,
}

impl Stretched {
    fn new(h: &Matrix3) -> Self {
        Self { spectrum: Spectrum::new(strain(h).map(|row| row.map(|v| 0.5 * v))) }
    }

    /// `⟨Eₐ⟩`
    fn positive(&self) -> [f64; 3] {
        self.spectrum.values.map(|e| e.max(0.0))
    }

    /// `2 Σ ⟨Eₐ⟩ Nₐ ⊗ Nₐ`
    fn second_stress(&self) -> Matrix3 {
        self.spectrum.with_values(self.positive().map(|e| 2.0 * e))
    }

    /// `(⟨Eₐ⟩ − ⟨E_b⟩) / (Eₐ − E_b)`, between 0 and 1.
    fn divided(&self, a: usize, b: usize) -> f64 {
        let (own, other) = (self.spectrum.values[a], self.spectrum.values[b]);
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
    let energy = stretched.positive().iter().map(|e| e * e).sum();
    (energy, product(&plus_identity(h), &stretched.second_stress()))
}

/// Add the tangent of an excess times a shear modulus.
pub(super) fn add_tangent(modulus: f64, h: &Matrix3, sum: &mut Tangent) {
    let stretched = Stretched::new(h);
    add_rows(sum, modulus, &stretched.second_stress());
    let dyads = stretched.spectrum.pushed(h);
    for a in 0..3 {
        let own = dyads.one(a, a);
        add_outer(sum, 2.0 * modulus * stretched.divided(a, a), &own, &own);
        for b in 0..a {
            let mixed = dyads.mixed(a, b);
            add_outer(sum, modulus * stretched.divided(a, b), &mixed, &mixed);
        }
    }
}
