//! The local step: where a tetrahedron's own energy and its distance from a wanted gradient balance.
//!
//! `prox(p) = argmin_z ψ(z) + κ/2 |z − p|²` over matrices of positive determinant. The energy depends on
//! principal stretches alone, so that with `p = U diag(s⁰) Vᵀ` the answer is `U diag(s) Vᵀ` and three
//! numbers are sought (Overby et al., IEEE Trans. Vis. Comput. Graph. 23, 2222, 2017):
//!
//! ```text
//! f(s)  = μ/2 (|s|² − 2 ln J) + λ/2 ln²J + κ/2 |s − s⁰|²,      J = s₁ s₂ s₃ > 0
//! f_i   = μ (s_i − 1/s_i) + λ ln J / s_i + κ (s_i − s⁰_i)
//! f_ij  = λ / (s_i s_j) + δ_ij d_i,      d_i = μ (1 + 1/s_i²) − λ ln J / s_i² + κ
//! ```
//!
//! The second derivative is a diagonal and one dyad. Newton's step is written down at once; where the
//! diagonal is not positive, far out, it is raised until it is, which keeps a direction of descent. `λ` must not be
//! negative: `ln²J` would pull a flat tetrahedron through.

use tissuereg_fem::material::{Matrix3, NeoHookean};

use super::svd::SignedSvd;

/// Newton steps; from four to eight in practice.
const MOST_STEPS: usize = 60;

/// Relative step below which the next one would be below rounding.
const LAST_STEP: f64 = 1e-9;

/// Relative step from which on Newton's method is trusted without comparing energies.
const TRUSTED_STEP: f64 = 1e-4;

/// Stretches from which the search starts at least; targets of inverted tetrahedra are negative.
const LEAST_START: f64 = 0.2;

/// The gradient that balances the energy of a law against the distance from `p`, with weight `kappa`, kPa.
pub(super) fn prox(law: &NeoHookean, kappa: f64, p: &Matrix3) -> Matrix3 {
    let svd = SignedSvd::new(p);
    svd.with_values(stretches(law, kappa, &svd.values))
}

/// Principal stretches of the answer for those of `p`.
fn stretches(law: &NeoHookean, kappa: f64, target: &[f64; 3]) -> [f64; 3] {
    let mut s = target.map(|t| if t > LEAST_START { t } else { LEAST_START });
    for _ in 0..MOST_STEPS {
        let (value, gradient, step) = newton(law, kappa, target, &s);
        let slope: f64 = (0..3).map(|i| gradient[i] * step[i]).sum();
        let relative = (0..3).map(|i| (step[i] / s[i]).abs()).fold(0.0, f64::max);
        let mut length = 1.0;
        // Nine tenths of the way to the boundary, and then far enough down.
        while (0..3).any(|i| s[i] + length * step[i] <= 0.1 * s[i]) && length > 1e-12 {
            length *= 0.5;
        }
        let moved = |length: f64| std::array::from_fn(|i| s[i] + length * step[i]);
        let mut next = moved(length);
        if relative > TRUSTED_STEP {
            while objective(law, kappa, target, &next) > value + 1e-4 * length * slope
                && length > 1e-12
            {
                length *= 0.5;
                next = moved(length);
            }
        }
        s = next;
        if relative.is_nan() || relative < LAST_STEP {
            break;
        }
    }
    s
}

/// Value, gradient and step at given stretches.
fn newton(
    law: &NeoHookean,
    kappa: f64,
    target: &[f64; 3],
    s: &[f64; 3],
) -> (f64, [f64; 3], [f64; 3]) {
    let NeoHookean { mu, lambda } = *law;
    let log = (s[0] * s[1] * s[2]).ln();
    let inverse = s.map(|s| 1.0 / s);
    let gradient: [f64; 3] = std::array::from_fn(|i| {
        mu * (s[i] - inverse[i]) + lambda * log * inverse[i] + kappa * (s[i] - target[i])
    });
    let diagonal: [f64; 3] = std::array::from_fn(|i| {
        let square = inverse[i] * inverse[i];
        (mu * (1.0 + square) - lambda * log * square + kappa).max(1e-3 * kappa)
    });
    // Sherman and Morrison.
    let by_diagonal: [f64; 3] = std::array::from_fn(|i| gradient[i] / diagonal[i]);
    let dyad: [f64; 3] = std::array::from_fn(|i| inverse[i] / diagonal[i]);
    let along: f64 = (0..3).map(|i| inverse[i] * by_diagonal[i]).sum();
    let own: f64 = (0..3).map(|i| inverse[i] * dyad[i]).sum();
    let factor = lambda * along / (1.0 + lambda * own);
    let step = std::array::from_fn(|i| factor * dyad[i] - by_diagonal[i]);
    (value_of(law, kappa, target, s, log), gradient, step)
}

fn objective(law: &NeoHookean, kappa: f64, target: &[f64; 3], s: &[f64; 3]) -> f64 {
    value_of(law, kappa, target, s, (s[0] * s[1] * s[2]).ln())
}

fn value_of(law: &NeoHookean, kappa: f64, target: &[f64; 3], s: &[f64; 3], log: f64) -> f64 {
    let (mut square, mut distance) = (0.0, 0.0);
    for i in 0..3 {
        square += s[i] * s[i];
        distance += (s[i] - target[i]) * (s[i] - target[i]);
    }
    0.5 * (law.mu * (square - 2.0 * log) + law.lambda * log * log + kappa * distance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tissuereg_fem::material::Hyperelastic;

    /// Stretched, compressed, flat and inverted, far and near.
    fn targets() -> Vec<Matrix3> {
        let mut all = vec![
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
            [[0.0; 3]; 3],
            [[-3.0, 0.0, 0.0], [0.0, -3.0, 0.0], [0.0, 0.0, -3.0]],
            [[20.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 9.0]],
        ];
        for k in 0..300 {
            let at = |i: usize| ((k * 9 + i) as f64 * 2.7).sin() * 1.5;
            all.push(std::array::from_fn(|i| {
                std::array::from_fn(|j| at(3 * i + j) + f64::from(u8::from(i == j)))
            }));
        }
        all
    }

    fn laws() -> [NeoHookean; 4] {
        [(10.0, 0.3), (10.0, 0.45), (40.0, 0.495), (5.0, 0.0)]
            .map(|(young, poisson)| NeoHookean::from_young(young, poisson))
    }

    fn det(m: &Matrix3) -> f64 {
        (0..3)
            .map(|i| {
                let (j, k) = ((i + 1) % 3, (i + 2) % 3);
                m[0][i] * (m[1][j] * m[2][k] - m[1][k] * m[2][j])
            })
            .sum()
    }

    #[test]
    fn the_stress_of_the_answer_balances_the_pull_of_the_target() {
        for law in laws() {
            for p in targets() {
                let kappa = law.bulk();
                let z = prox(&law, kappa, &p);
                let h = std::array::from_fn(|i| {
                    std::array::from_fn(|j| z[i][j] - f64::from(u8::from(i == j)))
                });
                let stress = law.stress(&h).expect("of positive volume");
                let size = kappa * p.iter().flatten().fold(1.0_f64, |m, v| m.max(v.abs()));
                for i in 0..3 {
                    for j in 0..3 {
                        let balance = stress[i][j] + kappa * (z[i][j] - p[i][j]);
                        // Rounding, worst where a tetrahedron is pressed flat.
                        assert!(balance.abs() < 1e-10 * size, "{p:?} {balance:e} of {size}");
                    }
                }
            }
        }
    }

    #[test]
    fn an_inverted_or_flat_target_gives_positive_volume() {
        for law in laws() {
            for p in targets().into_iter().filter(|p| det(p) <= 0.0) {
                assert!(det(&prox(&law, law.bulk(), &p)) > 0.0, "{p:?}");
            }
        }
    }

    #[test]
    fn a_rotation_is_its_own_answer() {
        let (sine, cosine) = 0.7_f64.sin_cos();
        let turn = [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]];
        let z = prox(&laws()[1], laws()[1].bulk(), &turn);
        for (a, b) in z.iter().flatten().zip(turn.iter().flatten()) {
            // Rounding.
            assert!((a - b).abs() < 1e-14);
        }
    }
}
