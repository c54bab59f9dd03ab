//! A family of fibres, added to any law.
//!
//! ```text
//! ψ_f = k₁/(2 k₂) (exp(k₂ ⟨E⟩²) − 1),    E = J^(−2/3) |F n|² − 1
//! ```
//!
//! where `⟨E⟩` is `E`, or its positive part where fibres bear tension alone. `E` is formed as
//! `J^(−2/3) (2 n·h n + |h n|² − (J^(2/3) − 1))`. Holzapfel, Gasser and Ogden, *Journal of
//! Elasticity* 61, 2000, without dispersion.

use super::kinematics::Kinematics;
use super::tensor::{add_outer, add_rows, add_twist, matrix, phi1, phi2};
use super::{Matrix3, Tangent};

/// Fibres at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fibre {
    /// Stiffness over the shear modulus of the matrix, `k₁/μ`; not negative.
    pub k1_over_mu: f64,
    /// Rate of stiffening `k₂`, dimensionless; not negative.
    pub k2: f64,
    /// Direction in the undeformed body, unit length.
    pub direction: [f64; 3],
    /// Whether shortened fibres are slack.
    pub tension_only: bool,
}

/// Strain of the fibres, its slope and what its curvature needs.
struct Stretch {
    strain: f64,
    slope: Matrix3,
    /// `J^(−2/3)`
    scale: f64,
    /// `|F n|²`
    square: f64,
    /// `F n ⊗ n`
    dyad: Matrix3,
    inverse: Matrix3,
}

impl Fibre {
    /// None where the fibres are slack. Without strain they count as taut: the undeformed tangent
    /// holds them.
    fn stretch(&self, h: &Matrix3, k: &Kinematics) -> Option<Stretch> {
        let n = self.direction;
        let hn: [f64; 3] = std::array::from_fn(|i| (0..3).map(|j| h[i][j] * n[j]).sum());
        let growth: f64 = (0..3).map(|i| hn[i] * (2.0 * n[i] + hn[i])).sum();
        let scale = (-2.0 / 3.0 * k.log).exp();
        let strain = scale * (growth - (2.0 / 3.0 * k.log).exp_m1());
        if self.tension_only && strain < 0.0 {
            return None;
        }
        let dyad = matrix(|i, j| (n[i] + hn[i]) * n[j]);
        let inverse = k.inverse_transposed(h);
        let square = 1.0 + growth;
        let slope = matrix(|i, j| 2.0 * scale * (dyad[i][j] - square / 3.0 * inverse[i][j]));
        Some(Stretch { strain, slope, scale, square, dyad, inverse })
    }

    /// Energy and stress in a matrix of shear modulus 1.
    pub(super) fn response(&self, h: &Matrix3, k: &Kinematics) -> (f64, Matrix3) {
        let Some(at) = self.stretch(h, k) else { return (0.0, [[0.0; 3]; 3]) };
        let square = at.strain * at.strain;
        let pull = self.k1_over_mu * at.strain * (self.k2 * square).exp();
        let energy = 0.5 * self.k1_over_mu * square * phi1(self.k2 * square);
        (energy, at.slope.map(|row| row.map(|v| pull * v)))
    }

    /// Derivatives of energy and stress by `k₂`.
    pub(super) fn response_by_k2(&self, h: &Matrix3, k: &Kinematics) -> (f64, Matrix3) {
        let Some(at) = self.stretch(h, k) else { return (0.0, [[0.0; 3]; 3]) };
        let square = at.strain * at.strain;
        let y = self.k2 * square;
        let energy = 0.5 * self.k1_over_mu * square * square * (phi1(y) - phi2(y));
        let pull = self.k1_over_mu * at.strain * square * y.exp();
        (energy, at.slope.map(|row| row.map(|v| pull * v)))
    }

    /// Add the tangent in a matrix of a shear modulus.
    pub(super) fn add_tangent(&self, mu: f64, h: &Matrix3, k: &Kinematics, sum: &mut Tangent) {
        let Some(at) = self.stretch(h, k) else { return };
        let square = at.strain * at.strain;
        let stiffness = mu * self.k1_over_mu * (self.k2 * square).exp();
        add_outer(sum, stiffness * (1.0 + 2.0 * self.k2 * square), &at.slope, &at.slope);
        let weight = stiffness * at.strain * at.scale;
        let n = self.direction;
        add_rows(sum, 2.0 * weight, &matrix(|i, j| n[i] * n[j]));
        add_outer(sum, -8.0 / 3.0 * weight, &at.dyad, &at.inverse);
        add_outer(sum, 4.0 / 9.0 * weight * at.square, &at.inverse, &at.inverse);
        add_twist(sum, 2.0 / 3.0 * weight * at.square, &at.inverse);
    }
}
