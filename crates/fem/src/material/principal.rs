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
use super::tensor::{
    add_outer, add_rows, matrix, phi1, phi2, phi3, plus_identity, product, strain,
};
use super::{Matrix3, OgdenTerms, Tangent, Volumetric};

/// What all answers share.
struct Principal {
    /// Eigenvalues of `C`.
    c: [f64; 3],
    /// Eigenvectors, one a column.
    axes: Matrix3,
    /// Logarithmic stretches, deviatoric ones of a split law.
    d: [f64; 3],
    split: bool,
}

impl Principal {
    fn new(volumetric: Volumetric, h: &Matrix3, k: &Kinematics) -> Self {
        let (values, axes) = eigen(strain(h));
        let split = volumetric.splits();
        let volume = if split { k.log / 3.0 } else { 0.0 };
        let d = values.map(|v| 0.5 * v.ln_1p() - volume);
        Self { c: values.map(|v| 1.0 + v), axes, d, split }
    }

    /// What a split law leaves of principal stresses.
    fn projected(&self, t: [f64; 3]) -> [f64; 3] {
        let mean = if self.split { t.iter().sum::<f64>() / 3.0 } else { 0.0 };
        t.map(|v| v - mean)
    }

    /// `Σᵢ sᵢ Nᵢ ⊗ Nᵢ` with `sᵢ = τᵢ/cᵢ`.
    fn second_stress(&self, tau: &[f64; 3]) -> Matrix3 {
        matrix(|i, j| (0..3).map(|a| tau[a] / self.c[a] * self.axes[i][a] * self.axes[j][a]).sum())
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
        let f = plus_identity(h);
        add_rows(sum, 1.0, &at.second_stress(&tau));
        let pushed = product(&f, &at.axes);
        // (F N_a) ⊗ N_b
        let dyad = |a: usize, b: usize| matrix(|i, j| pushed[i][a] * at.axes[j][b]);
        let c = at.c;
        for a in 0..3 {
            let m = dyad(a, a);
            add_outer(sum, (mu * self.slope(&at, a, a) - 2.0 * tau[a]) / (c[a] * c[a]), &m, &m);
            for b in 0..a {
                let other = dyad(b, b);
                let slope = 2.0 * mu * self.slope(&at, a, b) / (c[a] * c[b]);
                add_outer(sum, slope, &m, &other);
                let (ab, ba) = (dyad(a, b), dyad(b, a));
                let mixed = matrix(|i, j| ab[i][j] + ba[i][j]);
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

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, by Jacobi's rotations.
///
/// Golub and Van Loan, *Matrix Computations*, 4th ed., algorithm 8.5.3; a 3 x 3 matrix is diagonal
/// to rounding after five sweeps, and a NaN passes through.
pub(super) fn eigen(mut m: Matrix3) -> ([f64; 3], Matrix3) {
    let mut axes = plus_identity(&[[0.0; 3]; 3]);
    for _ in 0..10 {
        if m[0][1] == 0.0 && m[0][2] == 0.0 && m[1][2] == 0.0 {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotate(&mut m, &mut axes, p, q);
        }
    }
    ([m[0][0], m[1][1], m[2][2]], axes)
}

/// Make entry `(p, q)` zero.
fn rotate(m: &mut Matrix3, axes: &mut Matrix3, p: usize, q: usize) {
    let off = m[p][q];
    let scale = m[p][p].abs().min(m[q][q].abs());
    if off.abs() <= f64::EPSILON * 1e-3 * scale {
        (m[p][q], m[q][p]) = (0.0, 0.0);
        return;
    }
    let half = 0.5 * (m[q][q] - m[p][p]) / off;
    let t = half.signum() / (half.abs() + half.hypot(1.0));
    let cos = 1.0 / t.hypot(1.0);
    let sin = t * cos;
    m[p][p] -= t * off;
    m[q][q] += t * off;
    (m[p][q], m[q][p]) = (0.0, 0.0);
    let r = 3 - p - q;
    let (x, y) = (m[r][p], m[r][q]);
    (m[r][p], m[r][q]) = (cos * x - sin * y, sin * x + cos * y);
    (m[p][r], m[q][r]) = (m[r][p], m[r][q]);
    for row in axes {
        (row[p], row[q]) = (cos * row[p] - sin * row[q], sin * row[p] + cos * row[q]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_eigenvectors_rebuild_the_matrix() {
        let tiny = 1e-14;
        for m in [
            [[2.0, -1.0, 0.5], [-1.0, 3.0, 0.25], [0.5, 0.25, -4.0]],
            [[1.0, tiny, 0.0], [tiny, 1.0, tiny], [0.0, tiny, 1.0]],
            [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
            [[5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 5.0]],
        ] {
            let (values, axes) = eigen(m);
            for i in 0..3 {
                for j in 0..3 {
                    let rebuilt: f64 = (0..3).map(|a| values[a] * axes[i][a] * axes[j][a]).sum();
                    assert!((rebuilt - m[i][j]).abs() < 4e-15, "{m:?}");
                    let inner: f64 = (0..3).map(|a| axes[i][a] * axes[j][a]).sum();
                    assert!((inner - if i == j { 1.0 } else { 0.0 }).abs() < 1e-15, "{m:?}");
                }
            }
        }
    }
}
