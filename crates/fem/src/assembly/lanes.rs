//! Internal forces of four-node neo-Hookean elements, eight at a time.
//!
//! The same mathematics as the general loop in `force`, written on arrays of eight so that the
//! compiler vectorises it for the processor at hand. With `x = J − 1`, the law needs `ln J` and
//! `x − ln J`, and for `|x| < 0.3` both follow from
//!
//! ```text
//! s = x / (2 + x),     x − ln(1 + x) = x²/2 − s (x²/2 + R(s²)),     R = Σ_k 2 s^2k / (2 k + 1)
//! ```
//!
//! where nothing of first order cancels. Other elements are left to the scalar law.

use crate::element::Geometry;
use crate::material::PlainLaws;

/// Elements side by side.
pub(super) const WIDTH: usize = 8;

/// Largest `|J − 1|` for which the series of the logarithm is summed.
const NEAR: f64 = 0.3;

type Lane = [f64; WIDTH];

/// What eight elements answer.
#[derive(Clone, Copy)]
pub(super) struct Answer {
    /// Strain energy, µJ.
    pub(super) energy: Lane,
    /// det F.
    pub(super) det_f: Lane,
    /// Forces of nodes 1 to 3 by component, mN; node 0 balances them.
    pub(super) force: [[Lane; 3]; 3],
    /// Whether the series of the logarithm holds for all eight.
    pub(super) near: bool,
}

/// Evaluates eight elements; a type, so that it is compiled for the processor at hand.
pub(super) struct Eight<'a> {
    pub(super) geometry: &'a Geometry,
    pub(super) laws: PlainLaws<'a>,
    pub(super) displacement: &'a [f64],
    /// First element; those behind the last one repeat it.
    pub(super) first: usize,
}

impl pulp::WithSimd for Eight<'_> {
    type Output = Answer;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Answer {
        self.evaluate()
    }
}

impl Eight<'_> {
    #[inline(always)]
    fn evaluate(&self) -> Answer {
        let mut inputs = Inputs::default();
        self.gather(&mut inputs);
        let Inputs { edges, jacobian, weight, mu, lambda } = inputs;

        // h = Σ_a (u_a − u_0) ⊗ ∂ξ_a/∂X
        let mut h = [[[0.0; WIDTH]; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                for l in 0..WIDTH {
                    h[i][j][l] = edges[0][i][l] * jacobian[0][j][l]
                        + edges[1][i][l] * jacobian[1][j][l]
                        + edges[2][i][l] * jacobian[2][j][l];
                }
            }
        }
        let cofactor = cofactor(&h);
        let mut answer = Answer {
            energy: [0.0; WIDTH],
            det_f: [0.0; WIDTH],
            force: [[[0.0; WIDTH]; 3]; 3],
            near: true,
        };
        let (mut shear, mut pressure) = ([0.0; WIDTH], [0.0; WIDTH]);
        let (mut second, mut trace) = ([0.0; WIDTH], [0.0; WIDTH]);
        let mut far = 0.0_f64;
        for l in 0..WIDTH {
            let tr = h[0][0][l] + h[1][1][l] + h[2][2][l];
            let third = h[0][0][l] * cofactor[0][0][l]
                + h[0][1][l] * cofactor[0][1][l]
                + h[0][2][l] * cofactor[0][2][l];
            let q = cofactor[0][0][l] + cofactor[1][1][l] + cofactor[2][2][l] + third;
            let x = tr + q;
            let rest = x_minus_log(x);
            let log = x - rest;
            let det_f = 1.0 + x;
            let inverse = 1.0 / det_f;
            let mut square = 0.0;
            for i in 0..3 {
                for j in 0..3 {
                    square += h[i][j][l] * h[i][j][l];
                }
            }
            // NaN is far as well.
            far += if x.abs() < NEAR { 0.0 } else { 1.0 };
            answer.det_f[l] = det_f;
            answer.energy[l] =
                weight[l] * (mu[l] * (0.5 * square - q + rest) + 0.5 * lambda[l] * log * log);
            shear[l] = weight[l] * mu[l] * inverse;
            pressure[l] = weight[l] * lambda[l] * log * inverse;
            second[l] = q;
            trace[l] = tr;
        }
        answer.near = far == 0.0;
        // w P = shear (J h + hᵀ + q I − cof h) + pressure cof F
        let mut stress = [[[0.0; WIDTH]; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                let unit = if i == j { 1.0 } else { 0.0 };
                for l in 0..WIDTH {
                    let cof_f = cofactor[i][j][l] - h[j][i][l] + unit * (1.0 + trace[l]);
                    stress[i][j][l] = shear[l]
                        * (answer.det_f[l] * h[i][j][l] + h[j][i][l] - cofactor[i][j][l]
                            + unit * second[l])
                        + pressure[l] * cof_f;
                }
            }
        }
        for k in 0..3 {
            for i in 0..3 {
                for l in 0..WIDTH {
                    answer.force[k][i][l] = stress[i][0][l] * jacobian[k][0][l]
                        + stress[i][1][l] * jacobian[k][1][l]
                        + stress[i][2][l] * jacobian[k][2][l];
                }
            }
        }
        answer
    }

    #[inline(always)]
    fn gather(&self, inputs: &mut Inputs) {
        let last = self.geometry.n_elements() - 1;
        for l in 0..WIDTH {
            let element = (self.first + l).min(last);
            let nodes = &self.geometry.connectivity[4 * element..4 * element + 4];
            let at = |a: usize, i: usize| self.displacement[3 * nodes[a] as usize + i];
            for i in 0..3 {
                let origin = at(0, i);
                for k in 0..3 {
                    inputs.edges[k][i][l] = at(k + 1, i) - origin;
                }
            }
            let jacobian = &self.geometry.inverse_jacobian[element];
            for k in 0..3 {
                for j in 0..3 {
                    inputs.jacobian[k][j][l] = jacobian[k][j];
                }
            }
            let law = self.laws.at(element, 0);
            inputs.weight[l] = self.geometry.volume[element];
            inputs.mu[l] = law.mu;
            inputs.lambda[l] = law.lambda;
        }
    }
}

/// What is gathered for eight elements.
#[derive(Default)]
struct Inputs {
    /// `u_(k+1) − u_0` by component.
    edges: [[Lane; 3]; 3],
    /// `∂ξ_k/∂X_j`.
    jacobian: [[Lane; 3]; 3],
    weight: Lane,
    mu: Lane,
    lambda: Lane,
}

#[inline(always)]
fn cofactor(m: &[[Lane; 3]; 3]) -> [[Lane; 3]; 3] {
    let mut c = [[[0.0; WIDTH]; 3]; 3];
    for i in 0..3 {
        let (p, q) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            let (r, s) = ((j + 1) % 3, (j + 2) % 3);
            for l in 0..WIDTH {
                c[i][j][l] = m[p][r][l] * m[q][s][l] - m[p][s][l] * m[q][r][l];
            }
        }
    }
    c
}

/// `x − ln(1 + x)` for `|x| < 0.3`.
#[inline(always)]
fn x_minus_log(x: f64) -> f64 {
    let s = x / (2.0 + x);
    let z = s * s;
    // z < 0.032: twelve terms leave less than 1e-18.
    let mut series = 0.0;
    for k in (1..13).rev() {
        series = series * z + 2.0 / (2 * k + 1) as f64;
    }
    let half_square = 0.5 * x * x;
    half_square - s * (half_square + z * series)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_is_the_logarithm() {
        for k in -2999..3000 {
            let x = f64::from(k) * 1e-4;
            let log = x - x_minus_log(x);
            // Two units in the last place.
            assert!((log - x.ln_1p()).abs() <= 2.0 * f64::EPSILON * log.abs(), "{x}: {log}");
        }
        // Where x and its logarithm agree to all digits: x²/2 − x³/3 + x⁴/4.
        let x = 1e-5;
        let exact = x * x * (0.5 - x * (1.0 / 3.0 - x * 0.25));
        assert!((x_minus_log(x) / exact - 1.0).abs() < 1e-14);
    }
}
