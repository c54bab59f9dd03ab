//! The Ogden law, in principal stretches.
//!
//! With the eigenvalues `cᵢ = λᵢ²` of `C` and `εᵢ = ln λᵢ`, `exp(α d) − 1 − α d` stands for
//! `λ̄^α − 1` in the energy, where `d = ε − ln J / 3` (split) sums to nothing, or for
//! `λ^α − 1 − α ln λ` where `d = ε` (coupled). Nothing cancels:
//!
//! ```text
//! ψ  = Σ_p 2 μ_p Σᵢ dᵢ² φ₂(α_p dᵢ)                 φ₂(y) = (eʸ − 1 − y) / y²
//! τᵢ = ∂ψ/∂εᵢ = Σ_p 2 μ_p (tᵢ − m)                 tᵢ = dᵢ φ₁(α_p dᵢ),  φ₁(y) = (eʸ − 1) / y
//! S  = Σᵢ τᵢ/cᵢ Nᵢ ⊗ Nᵢ,   P = F S                 m = mean t (split), 0 (coupled)
//! ```
//!
//! In the tangent `(sᵢ − sⱼ)/(cᵢ − cⱼ)` is formed from `r = cᵢ/cⱼ − 1` by functions that are smooth
//! at `r = 0`: equal stretches need no special case and lose no digits.

use super::kinematics::Kinematics;
use super::spectrum::Spectrum;
use super::tensor::{add_outer, add_rows, phi1, phi2, phi3, plus_identity, product, strain};
use super::{Matrix3, OgdenTerms, Tangent, Volumetric};

/// What all answers share.
struct Principal {
    /// Of `C − I`.
    spectrum: Spectrum,
    /// Eigenvalues of `C`.
    c: [f64; 3],
    /// Logarithmic stretches, deviatoric ones of a split law.
    d: [f64; 3],
    split: bool,
}

impl Principal {
    fn new(volumetric: Volumetric, h: &Matrix3, k: &Kinematics) -> Self {
        let spectrum = Spectrum::new(strain(h));
        let split = volumetric.splits();
        let volume = if split { k.log / 3.0 } else { 0.0 };
        let d = spectrum.values.map(|v| 0.5 * v.ln_1p() - volume);
        Self { c: spectrum.values.map(|v| 1.0 + v), spectrum, d, split }
    }

    /// What a split law leaves of principal stresses.
    fn projected(&self, t: [f64; 3]) -> [f64; 3] {
        let mean = if self.split { t.iter().sum::<f64>() / 3.0 } else { 0.0 };
        t.map(|v| v - mean)
    }

    /// `Σᵢ sᵢ Nᵢ ⊗ Nᵢ` with `sᵢ = τᵢ/cᵢ`.
    fn second_stress(&self, tau: &[f64; 3]) -> Matrix3 {
        self.spectrum.with_values(std::array::from_fn(|a| tau[a] / self.c[a]))
    }

    /// Energy of one term with all of the shear modulus.
    fn energy(&self, alpha: f64) -> f64 {
        2.0 * self.d.iter().map(|d| d * d * phi2(alpha * d)).sum::<f64>()
    }

    /// `F S`
    fn first_stress(&self, h: &Matrix3, tau: &[f64; 3]) -> Matrix3 {
        product(&plus_identity(h), &self.second_stress(tau))
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
        let tau = self.tau(&at).map(|t| mu * t);
        add_rows(sum, 1.0, &at.second_stress(&tau));
        let dyads = at.spectrum.pushed(h);
        let c = at.c;
        for a in 0..3 {
            let m = dyads.one(a, a);
            add_outer(sum, (mu * self.slope(&at, a, a) - 2.0 * tau[a]) / (c[a] * c[a]), &m, &m);
            for b in 0..a {
                let other = dyads.one(b, b);
                let slope = 2.0 * mu * self.slope(&at, a, b) / (c[a] * c[b]);
                add_outer(sum, slope, &m, &other);
                let mixed = dyads.mixed(a, b);
                let theta = mu * self.divided(&c, &at.d, a, b) / c[a] - tau[b] / (c[a] * c[b]);
                add_outer(sum, theta, &mixed, &mixed);
            }
        }
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
    fn divided(&self, c: &[f64; 3], d: &[f64; 3], a: usize, b: usize) -> f64 {
        let ratio = (c[a] - c[b]) / c[b];
        // Difference of the logarithmic stretches, and that over the ratio.
        let delta = 0.5 * ratio.ln_1p();
        let over_ratio = if ratio == 0.0 { 0.5 } else { delta / ratio };
        let term = |(alpha, share): (f64, f64)| {
            2.0 * share * (alpha * d[b]).exp() * phi1(alpha * delta) * over_ratio / c[b]
        };
        self.terms().map(term).sum()
    }
}
