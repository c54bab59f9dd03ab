//! Principal values and axes of a strain, and stress and tangent of laws in principal stretches.
//!
//! With the eigenvalues `cᵢ = λᵢ²` of `C`, `εᵢ = ln λᵢ` and principal Kirchhoff stresses `τᵢ(ε)`,
//!
//! ```text
//! S  = Σᵢ sᵢ Nᵢ ⊗ Nᵢ,   sᵢ = τᵢ/cᵢ,   P = F S
//! ```
//!
//! In the tangent `(sᵢ − sⱼ)/(cᵢ − cⱼ)` is formed from `r = cᵢ/cⱼ − 1` by functions that are smooth
//! at `r = 0`: equal stretches need no special case and lose no digits.

use super::tensor::{add_outer, add_rows, matrix, plus_identity, product, strain};
use super::{Matrix3, Tangent};

/// Principal stretches of a displacement gradient.
pub(super) struct Stretches {
    /// Axes of `C`, one per column.
    axes: Matrix3,
    /// Eigenvalues of `C`.
    pub(super) c: [f64; 3],
    /// Logarithmic stretches `ε`.
    pub(super) log: [f64; 3],
}

impl Stretches {
    pub(super) fn new(h: &Matrix3) -> Self {
        let (strains, axes) = eigen(strain(h));
        Self { axes, c: strains.map(|v| 1.0 + v), log: strains.map(|v| 0.5 * v.ln_1p()) }
    }

    /// `S` of principal Kirchhoff stresses.
    pub(super) fn second_stress(&self, tau: &[f64; 3]) -> Matrix3 {
        let (axes, c) = (&self.axes, &self.c);
        matrix(|i, j| (0..3).map(|a| tau[a] / c[a] * axes[i][a] * axes[j][a]).sum())
    }

    /// `ε_a − ε_b`, and that over `r = c_a/c_b − 1`.
    pub(super) fn log_difference(&self, a: usize, b: usize) -> (f64, f64) {
        let ratio = (self.c[a] - self.c[b]) / self.c[b];
        let delta = 0.5 * ratio.ln_1p();
        (delta, if ratio == 0.0 { 0.5 } else { delta / ratio })
    }

    /// Add the tangent of principal Kirchhoff stresses with slopes `∂τ_a/∂ε_b` and divided
    /// differences `(τ_a − τ_b)/(c_a − c_b)`.
    pub(super) fn add_tangent(
        &self,
        h: &Matrix3,
        tau: &[f64; 3],
        slope: impl Fn(usize, usize) -> f64,
        divided: impl Fn(usize, usize) -> f64,
        sum: &mut Tangent,
    ) {
        add_rows(sum, 1.0, &self.second_stress(tau));
        let dyads = Dyads { pushed: product(&plus_identity(h), &self.axes), axes: &self.axes };
        let c = self.c;
        for a in 0..3 {
            let m = dyads.one(a, a);
            add_outer(sum, (slope(a, a) - 2.0 * tau[a]) / (c[a] * c[a]), &m, &m);
            for b in 0..a {
                let other = dyads.one(b, b);
                add_outer(sum, 2.0 * slope(a, b) / (c[a] * c[b]), &m, &other);
                let mixed = dyads.mixed(a, b);
                let theta = divided(a, b) / c[a] - tau[b] / (c[a] * c[b]);
                add_outer(sum, theta, &mixed, &mixed);
            }
        }
    }
}

/// `(F Nₐ) ⊗ N_b`
struct Dyads<'a> {
    pushed: Matrix3,
    axes: &'a Matrix3,
}

impl Dyads<'_> {
    /// That of two axes.
    fn one(&self, a: usize, b: usize) -> Matrix3 {
        matrix(|i, j| self.pushed[i][a] * self.axes[j][b])
    }

    /// That of two axes and of the same in the other order.
    fn mixed(&self, a: usize, b: usize) -> Matrix3 {
        let (ab, ba) = (self.one(a, b), self.one(b, a));
        matrix(|i, j| ab[i][j] + ba[i][j])
    }
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, by Jacobi's rotations.
///
/// Golub and Van Loan, *Matrix Computations*, 4th ed., algorithm 8.5.3; a 3 x 3 matrix is diagonal
/// to rounding after five sweeps, and a NaN passes through.
pub(crate) fn eigen(mut m: Matrix3) -> ([f64; 3], Matrix3) {
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
    // `hypot` would take half of the time; where the square overflows nothing is left to turn.
    let t = half.signum() / (half.abs() + (half * half + 1.0).sqrt());
    let cos = 1.0 / (t * t + 1.0).sqrt();
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
