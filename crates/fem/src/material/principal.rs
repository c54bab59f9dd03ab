//! The Ogden law, in principal stretches.
//!
//! With `εᵢ = ln λᵢ`, `exp(α d) − 1 − α d` stands for
//! `λ̄^α − 1` in the energy, where `d = ε − ln J / 3` (split) sums to nothing, or for
//! `λ^α − 1 − α ln λ` where `d = ε` (coupled). Nothing cancels:
//!
//! ```text
//! ψ  = Σ_p 2 μ_p Σᵢ dᵢ² φ₂(α_p dᵢ)                 φ₂(y) = (eʸ − 1 − y) / y²
//! τᵢ = ∂ψ/∂εᵢ = Σ_p 2 μ_p (tᵢ − m)                 tᵢ = dᵢ φ₁(α_p dᵢ),  φ₁(y) = (eʸ − 1) / y
//!                                                  m = mean t (split), 0 (coupled)
//! ```

use super::kinematics::Kinematics;
use super::spectrum::Stretches;
use super::tensor::{phi1, phi2, phi3, plus_identity, product};
use super::{Matrix3, OgdenTerms, Tangent, Volumetric};

/// What all answers share.
struct Principal {
    stretches: Stretches,
    /// Logarithmic stretches, deviatoric ones of a split law.
    d: [f64; 3],
    split: bool,
}

impl Principal {
    fn new(volumetric: Volumetric, h: &Matrix3, k: &Kinematics) -> Self {
        let stretches = Stretches::new(h);
        let split = volumetric.splits();
        let volume = if split { k.log / 3.0 } else { 0.0 };
        Self { d: stretches.log.map(|e| e - volume), stretches, split }
    }

    /// What a split law leaves of principal stresses.
    fn projected(&self, t: [f64; 3]) -> [f64; 3] {
        let mean = if self.split { t.iter().sum::<f64>() / 3.0 } else { 0.0 };
        t.map(|v| v - mean)
    }

    /// Energy of one term with all of the shear modulus.
    fn energy(&self, alpha: f64) -> f64 {
        2.0 * self.d.iter().map(|d| d * d * phi2(alpha * d)).sum::<f64>()
    }

    /// `F S`
    fn first_stress(&self, h: &Matrix3, tau: &[f64; 3]) -> Matrix3 {
        product(&plus_identity(h), &self.stretches.second_stress(tau))
    }
}

impl OgdenTerms {
    /// `τ` of shear modulus 1.
    fn tau(&self, at: &Principal) -> [f64; 3] {
        let mut tau = [0.0; 3];
        for (alpha, share) in self.terms() {
            let t = at.projected(at.d.map(|v| v * phi1(alpha * v)));
            (0..3).for_each(|i| tau[i] += 2.0 * share * t[i]);
        }
        tau
    }

    /// Energy and stress of shear modulus 1.
    pub(super) fn response(
        &self,
        volumetric: Volumetric,
        h: &Matrix3,
        k: &Kinematics,
    ) -> (f64, Matrix3) {
        let at = Principal::new(volumetric, h, k);
        (self.energy(&at), at.first_stress(h, &self.tau(&at)))
    }

    fn energy(&self, at: &Principal) -> f64 {
        self.terms().map(|(alpha, share)| share * at.energy(alpha)).sum()
    }

    /// Derivatives by the exponent of a term of energy and stress of shear modulus 1.
    pub(super) fn response_by_alpha(
        &self,
        term: usize,
        volumetric: Volumetric,
        h: &Matrix3,
        k: &Kinematics,
    ) -> (f64, Matrix3) {
        let Some((alpha, share)) = self.terms().nth(term) else { return (0.0, [[0.0; 3]; 3]) };
        let at = Principal::new(volumetric, h, k);
        let t = at.d.map(|d| 2.0 * share * d * d * (phi1(alpha * d) - phi2(alpha * d)));
        let cubes = at.d.map(|d| d * d * d * (phi2(alpha * d) - 2.0 * phi3(alpha * d)));
        (2.0 * share * cubes.iter().sum::<f64>(), at.first_stress(h, &at.projected(t)))
    }

    /// Derivatives by the weight of a term of energy and stress of shear modulus 1.
    pub(super) fn response_by_weight(
        &self,
        term: usize,
        volumetric: Volumetric,
        h: &Matrix3,
        k: &Kinematics,
    ) -> (f64, Matrix3) {
        let Some((alpha, _)) = self.terms().nth(term) else { return (0.0, [[0.0; 3]; 3]) };
        let at = Principal::new(volumetric, h, k);
        let own = at.projected(at.d.map(|d| 2.0 * d * phi1(alpha * d)));
        let all = self.tau(&at);
        let total = self.total_weight();
        let stress = at.first_stress(h, &std::array::from_fn(|i| (own[i] - all[i]) / total));
        ((at.energy(alpha) - self.energy(&at)) / total, stress)
    }

    /// Add the tangent of a shear modulus.
    pub(super) fn add_tangent(
        &self,
        mu: f64,
        volumetric: Volumetric,
        h: &Matrix3,
        k: &Kinematics,
        sum: &mut Tangent,
    ) {
        let at = Principal::new(volumetric, h, k);
        let slope = |a, b| mu * self.slope(&at, a, b);
        let divided = |a, b| mu * self.divided(&at, a, b);
        at.stretches.add_tangent(h, &self.tau(&at).map(|t| mu * t), slope, divided, sum);
    }

    /// `∂τ_a/∂ε_b` of shear modulus 1.
    fn slope(&self, at: &Principal, a: usize, b: usize) -> f64 {
        let term = |(alpha, share): (f64, f64)| {
            let e = at.d.map(|d| (alpha * d).exp());
            let mean = e.iter().sum::<f64>() / 3.0;
            let own = if a == b { e[a] } else { 0.0 };
            let volume = if at.split { (e[a] + e[b] - mean) / 3.0 } else { 0.0 };
            2.0 * share * (own - volume)
        };
        self.terms().map(term).sum()
    }

    /// `(τ_a − τ_b)/(c_a − c_b)` of shear modulus 1, also where they are equal.
    fn divided(&self, at: &Principal, a: usize, b: usize) -> f64 {
        let (delta, over_ratio) = at.stretches.log_difference(a, b);
        let term = |(alpha, share): (f64, f64)| {
            2.0 * share * (alpha * at.d[b]).exp() * phi1(alpha * delta) * over_ratio
                / at.stretches.c[b]
        };
        self.terms().map(term).sum()
    }
}
