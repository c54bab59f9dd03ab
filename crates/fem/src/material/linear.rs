//! St. Venant–Kirchhoff and Hooke: one quadratic energy, of the Green–Lagrange strain
//! `E = (C − I)/2` and of the small strain `sym h`.
//!
//! ```text
//! ψ = λ/2 (tr E)² + μ E : E
//! ```

use super::tensor::{add_columns, add_outer, add_rows, add_twist, matrix, plus_identity};
use super::tensor::{product, square, strain, trace};
use super::{Matrix3, NeoHookean, Tangent};

const IDENTITY: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// `λ tr E I + 2 μ E`, and the energy.
fn quadratic(moduli: &NeoHookean, e: &Matrix3) -> (f64, Matrix3) {
    let (mu, volume) = (moduli.mu, trace(e));
    let stress =
        matrix(|i, j| 2.0 * mu * e[i][j] + if i == j { moduli.lambda * volume } else { 0.0 });
    (0.5 * moduli.lambda * volume * volume + mu * square(e), stress)
}

/// Energy and stress of Hooke's law.
pub(super) fn hooke_response(moduli: &NeoHookean, h: &Matrix3) -> (f64, Matrix3) {
    quadratic(moduli, &matrix(|i, j| 0.5 * (h[i][j] + h[j][i])))
}

/// Add the tangent of Hooke's law.
pub(super) fn add_hooke_tangent(moduli: &NeoHookean, sum: &mut Tangent) {
    add_outer(sum, moduli.lambda, &IDENTITY, &IDENTITY);
    add_rows(sum, moduli.mu, &IDENTITY);
    add_twist(sum, moduli.mu, &IDENTITY);
}

/// Energy and stress `P = F S` of the St. Venant–Kirchhoff law.
pub(super) fn st_venant_response(moduli: &NeoHookean, h: &Matrix3) -> (f64, Matrix3) {
    let (energy, second) = quadratic(moduli, &strain(h).map(|row| row.map(|v| 0.5 * v)));
    (energy, product(&plus_identity(h), &second))
}

/// Add the tangent of the St. Venant–Kirchhoff law.
pub(super) fn add_st_venant_tangent(moduli: &NeoHookean, h: &Matrix3, sum: &mut Tangent) {
    let f = plus_identity(h);
    let (_, second) = quadratic(moduli, &strain(h).map(|row| row.map(|v| 0.5 * v)));
    add_rows(sum, 1.0, &second);
    add_outer(sum, moduli.lambda, &f, &f);
    add_twist(sum, moduli.mu, &f);
    add_columns(sum, moduli.mu, &matrix(|i, j| (0..3).map(|k| f[i][k] * f[j][k]).sum()));
}
