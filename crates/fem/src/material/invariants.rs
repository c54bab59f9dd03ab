//! Laws in the first two invariants, isochoric ones or not.
//!
//! `a` and `b` are free of stress at rest, and `½ a` and `½ b` have the small-strain energy of shear
//! modulus 1. With `Ī₁ = J^(−2/3) I₁`, `Ī₂ = J^(−4/3) I₂`, `L = ln J`, `x = J − 1` and
//! `cof F = I + c`, terms of first order are taken out by hand, so that small strains keep their
//! digits:
//!
//! ```text
//! split      a = Ī₁ − 3 = J^(−2/3) (α + 2 (x − L) − 3 (e^(2L/3) − 1 − 2L/3)),       α = |h|² − 2 q
//!            b = Ī₂ − 3 = J^(−4/3) (β + 4 (x − L) − 3 (e^(4L/3) − 1 − 4L/3)),       β = |c|² − 2 tr cof h − 4 det h
//!       ∂a/∂F = 2 J^(−2/3) (h − g − (I₁ − 3)/3 F⁻ᵀ),                                g = F⁻ᵀ − I
//!       ∂b/∂F = 2 J^(−4/3) (2 (h − g) + (I₁ − 3) F − F (C − I) − 2/3 (I₂ − 3) F⁻ᵀ)
//! coupled    a = I₁ − 3 − 2 L        = α + 2 (x − L)
//!            b = I₂ − 3 − 4 L − 2 L² = β + 4 (x − L) − 2 L²
//!       ∂a/∂F = 2 (h − g)
//!       ∂b/∂F = 2 (2 (h − g) + (I₁ − 3) F − F (C − I) − 2 L F⁻ᵀ)
//! ```

use super::kinematics::Kinematics;
use super::tensor::{
    add_columns, add_outer, add_rows, add_twist, matrix, phi2, plus_identity, product, square,
    strain, trace, x_minus_log,
};
use super::{LawKind, Matrix3, Tangent, Volumetric};

const IDENTITY: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl LawKind {
    /// Energy and stress of shear modulus 1.
    pub(super) fn invariant_response(
        &self,
        volumetric: Volumetric,
        h: &Matrix3,
        k: &Kinematics,
    ) -> Option<(f64, Matrix3)> {
        let invariants = Invariants::of(volumetric);
        let (a, slope_of_a) = invariants.first(h, k);
        if !self.has_second() {
            let slopes = self.slopes(a, 0.0)?;
            return Some((slopes.energy, slope_of_a.map(|row| row.map(|v| slopes.a * v))));
        }
        let (b, slope_of_b) = invariants.second(h, k);
        let slopes = self.slopes(a, b)?;
        let stress = matrix(|i, j| slopes.a * slope_of_a[i][j] + slopes.b * slope_of_b[i][j]);
        Some((slopes.energy, stress))
    }

    /// Derivatives by the n-th shape parameter of energy and stress of shear modulus 1.
    pub(super) fn invariant_response_by(
        &self,
        nth: usize,
        volumetric: Volumetric,
        h: &Matrix3,
        k: &Kinematics,
    ) -> (f64, Matrix3) {
        let invariants = Invariants::of(volumetric);
        let (a, slope_of_a) = invariants.first(h, k);
        let (b, slope_of_b) = match self.has_second() {
            true => invariants.second(h, k),
            false => (0.0, [[0.0; 3]; 3]),
        };
        let (energy, by_a, by_b) = self.slopes_by(nth, a, b);
        (energy, matrix(|i, j| by_a * slope_of_a[i][j] + by_b * slope_of_b[i][j]))
    }

    /// Add the tangent of a shear modulus.
    pub(super) fn add_invariant_tangent(
        &self,
        mu: f64,
        volumetric: Volumetric,
        h: &Matrix3,
        k: &Kinematics,
        sum: &mut Tangent,
    ) -> Option<()> {
        let invariants = Invariants::of(volumetric);
        let (a, slope_of_a) = invariants.first(h, k);
        // No law here has curvature in b: its value is not needed.
        let slopes = self.slopes(a, 0.0)?;
        add_outer(sum, mu * slopes.aa, &slope_of_a, &slope_of_a);
        invariants.add_first_curvature(mu * slopes.a, h, k, sum);
        if slopes.b != 0.0 {
            invariants.add_second_curvature(mu * slopes.b, h, k, sum);
        }
        Some(())
    }
}

/// Which invariants: isochoric ones, or those of `C` with what makes them free of stress.
#[derive(Clone, Copy)]
struct Invariants {
    split: bool,
}

impl Invariants {
    fn of(volumetric: Volumetric) -> Self {
        Self { split: volumetric.splits() }
    }

    /// `a` and its slope.
    fn first(self, h: &Matrix3, k: &Kinematics) -> (f64, Matrix3) {
        let value = self.without_first_order(2.0, square(h) - 2.0 * k.q, k);
        let rest = k.inverse_minus_identity(h);
        let g = plus_identity(&rest);
        let (scale, volume) = match self.split {
            true => ((-2.0 / 3.0 * k.log).exp(), (2.0 * k.trace + square(h)) / 3.0),
            false => (1.0, 0.0),
        };
        (value, matrix(|i, j| 2.0 * scale * (h[i][j] - rest[i][j] - volume * g[i][j])))
    }

    /// `b` and its slope.
    fn second(self, h: &Matrix3, k: &Kinematics) -> (f64, Matrix3) {
        let c = square(&cofactor_rest(h, k));
        let of_cofactor = trace(&k.cof_h);
        let det_h = k.q - of_cofactor;
        let mut value = self.without_first_order(4.0, c - 2.0 * of_cofactor - 4.0 * det_h, k);
        let rest = k.inverse_minus_identity(h);
        let (f, g) = (plus_identity(h), plus_identity(&rest));
        let i1 = 2.0 * k.trace + square(h);
        let (scale, volume) = match self.split {
            true => {
                let i2 = 4.0 * k.trace + 2.0 * of_cofactor + c;
                ((-4.0 / 3.0 * k.log).exp(), 2.0 / 3.0 * i2)
            }
            false => {
                value -= 2.0 * k.log * k.log;
                (1.0, 2.0 * k.log)
            }
        };
        let fe = product(&f, &strain(h));
        let slope = |i: usize, j: usize| {
            2.0 * (h[i][j] - rest[i][j]) + i1 * f[i][j] - fe[i][j] - volume * g[i][j]
        };
        (value, matrix(|i, j| 2.0 * scale * slope(i, j)))
    }

    /// An invariant of the order `n` in `J` without its terms of first order, from `α` or `β`.
    fn without_first_order(self, n: f64, rest: f64, k: &Kinematics) -> f64 {
        let own = rest + n * x_minus_log(k.x, k.log);
        if !self.split {
            return own;
        }
        let y = n / 3.0 * k.log;
        (-y).exp() * (own - 3.0 * y * y * phi2(y))
    }

    /// Add `weight ∂²a/∂F²`.
    fn add_first_curvature(self, weight: f64, h: &Matrix3, k: &Kinematics, sum: &mut Tangent) {
        let g = k.inverse_transposed(h);
        if !self.split {
            add_rows(sum, 2.0 * weight, &IDENTITY);
            add_twist(sum, 2.0 * weight, &g);
            return;
        }
        let weight = weight * (-2.0 / 3.0 * k.log).exp();
        let f = plus_identity(h);
        let i1 = square(&f);
        add_rows(sum, 2.0 * weight, &IDENTITY);
        add_outer(sum, -8.0 / 3.0 * weight, &f, &g);
        add_outer(sum, 4.0 / 9.0 * weight * i1, &g, &g);
        add_twist(sum, 2.0 / 3.0 * weight * i1, &g);
    }

    /// Add `weight ∂²b/∂F²`.
    fn add_second_curvature(self, weight: f64, h: &Matrix3, k: &Kinematics, sum: &mut Tangent) {
        let weight = if self.split { weight * (-4.0 / 3.0 * k.log).exp() } else { weight };
        let (f, g) = (plus_identity(h), k.inverse_transposed(h));
        let i1 = square(&f);
        let c = matrix(|i, j| (0..3).map(|m| f[m][i] * f[m][j]).sum());
        let b = matrix(|i, j| (0..3).map(|m| f[i][m] * f[j][m]).sum());
        add_outer(sum, 4.0 * weight, &f, &f);
        add_rows(sum, 2.0 * weight * i1, &IDENTITY);
        add_rows(sum, -2.0 * weight, &c);
        add_twist(sum, -2.0 * weight, &f);
        add_columns(sum, -2.0 * weight, &b);
        if self.split {
            let i2 = square(&k.cof_f(h));
            let fc = product(&f, &c);
            let slope = matrix(|i, j| 2.0 * (i1 * f[i][j] - fc[i][j]));
            add_outer(sum, -8.0 / 3.0 * weight, &slope, &g);
            add_outer(sum, 16.0 / 9.0 * weight * i2, &g, &g);
            add_twist(sum, 4.0 / 3.0 * weight * i2, &g);
        } else {
            add_outer(sum, -4.0 * weight, &g, &g);
            add_twist(sum, 4.0 * weight * (1.0 + k.log), &g);
        }
    }
}

/// `cof F − I`
fn cofactor_rest(h: &Matrix3, k: &Kinematics) -> Matrix3 {
    matrix(|i, j| k.cof_h[i][j] - h[j][i] + if i == j { k.trace } else { 0.0 })
}
