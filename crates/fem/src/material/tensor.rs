//! Matrices, fourth-order tensors and scalar functions that the laws share.

use super::{Matrix3, Tangent};

/// Cofactor matrix: `∂ det(m)/∂m`.
pub(crate) fn cofactor(m: &Matrix3) -> Matrix3 {
    [
        [
            m[1][1] * m[2][2] - m[1][2] * m[2][1],
            m[1][2] * m[2][0] - m[1][0] * m[2][2],
            m[1][0] * m[2][1] - m[1][1] * m[2][0],
        ],
        [
            m[2][1] * m[0][2] - m[2][2] * m[0][1],
            m[2][2] * m[0][0] - m[2][0] * m[0][2],
            m[2][0] * m[0][1] - m[2][1] * m[0][0],
        ],
        [
            m[0][1] * m[1][2] - m[0][2] * m[1][1],
            m[0][2] * m[1][0] - m[0][0] * m[1][2],
            m[0][0] * m[1][1] - m[0][1] * m[1][0],
        ],
    ]
}

/// `det(I + h) − 1`, exact for small `h`.
pub fn det_f_minus_one(h: &Matrix3) -> f64 {
    let c = cofactor(h);
    let trace = h[0][0] + h[1][1] + h[2][2];
    let second = c[0][0] + c[1][1] + c[2][2];
    let third = h[0][0] * c[0][0] + h[0][1] * c[0][1] + h[0][2] * c[0][2];
    trace + second + third
}

pub(super) fn matrix(entry: impl Fn(usize, usize) -> f64) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
}

pub(crate) fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    matrix(|i, j| (0..3).map(|k| a[i][k] * b[k][j]).sum())
}

pub(super) fn trace(m: &Matrix3) -> f64 {
    m[0][0] + m[1][1] + m[2][2]
}

/// Sum of the squares of all entries.
pub(crate) fn square(m: &Matrix3) -> f64 {
    m.iter().flatten().map(|v| v * v).sum()
}

pub(super) fn plus_identity(m: &Matrix3) -> Matrix3 {
    matrix(|i, j| m[i][j] + if i == j { 1.0 } else { 0.0 })
}

/// `C − I = h + hᵀ + hᵀh`, exact for small `h`.
pub(super) fn strain(h: &Matrix3) -> Matrix3 {
    matrix(|i, j| h[i][j] + h[j][i] + (0..3).map(|k| h[k][i] * h[k][j]).sum::<f64>())
}

/// Add `weight m` to a sum.
pub(super) fn add(sum: &mut Matrix3, weight: f64, m: &Matrix3) {
    for i in 0..3 {
        for j in 0..3 {
            sum[i][j] += weight * m[i][j];
        }
    }
}

pub(super) fn all_finite(m: &Matrix3) -> bool {
    m.iter().flatten().all(|v| v.is_finite())
}

/// Add `weight (a ⊗ b + b ⊗ a) / 2`.
pub(super) fn add_outer(sum: &mut Tangent, weight: f64, a: &Matrix3, b: &Matrix3) {
    let (a, b) = (a.as_flattened(), b.as_flattened());
    for p in 0..9 {
        for q in 0..9 {
            sum[p][q] += 0.5 * weight * (a[p] * b[q] + a[q] * b[p]);
        }
    }
}

/// Add `weight δ_ik m_jl`, `m` symmetric.
pub(super) fn add_rows(sum: &mut Tangent, weight: f64, m: &Matrix3) {
    for i in 0..3 {
        for j in 0..3 {
            for l in 0..3 {
                sum[3 * i + j][3 * i + l] += weight * m[j][l];
            }
        }
    }
}

/// Add `weight m_ik δ_jl`, `m` symmetric.
pub(super) fn add_columns(sum: &mut Tangent, weight: f64, m: &Matrix3) {
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                sum[3 * i + j][3 * k + j] += weight * m[i][k];
            }
        }
    }
}

/// Add `weight m_il m_kj`; with `m = F⁻ᵀ` and weight −1 the derivative of `F⁻ᵀ`.
pub(super) fn add_twist(sum: &mut Tangent, weight: f64, m: &Matrix3) {
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                for l in 0..3 {
                    sum[3 * i + j][3 * k + l] += weight * m[i][l] * m[k][j];
                }
            }
        }
    }
}

/// `x − ln(1 + x)` without cancellation, given `log = ln(1 + x)`.
#[inline(always)]
pub(crate) fn x_minus_log(x: f64, log: f64) -> f64 {
    if x.abs() > 0.03 {
        return x - log;
    }
    // x²/2 − x³/3 + ...; ten terms leave less than 1e-16 of the first.
    let mut sum = 0.0;
    for k in (2..12).rev() {
        sum = 1.0 / f64::from(k) - x * sum;
    }
    x * x * sum
}

/// `(eʸ − 1) / y`, 1 at 0.
pub(super) fn phi1(y: f64) -> f64 {
    if y == 0.0 { 1.0 } else { y.exp_m1() / y }
}

/// `(eʸ − 1 − y) / y²`, 1/2 at 0. The slope of [`phi1`] is `phi1 − phi2`.
pub(super) fn phi2(y: f64) -> f64 {
    if y.abs() > 0.5 {
        return (y.exp_m1() - y) / (y * y);
    }
    // Σ yᵏ/(k + 2)!; 14 terms leave less than 1e-17.
    let mut sum = 0.0;
    for k in (2..16).rev() {
        sum = (1.0 + y * sum) / f64::from(k);
    }
    sum
}

/// `(eʸ − 1 − y − y²/2) / y³`, 1/6 at 0. The slope of [`phi2`] is `phi2 − 2 phi3`.
pub(super) fn phi3(y: f64) -> f64 {
    if y.abs() > 0.5 {
        return (phi2(y) - 0.5) / y;
    }
    // Σ yᵏ/(k + 3)!; 14 terms leave less than 1e-18.
    let mut sum = 0.0;
    for k in (4..17).rev() {
        sum = (1.0 + y * sum) / f64::from(k);
    }
    (1.0 + y * sum) / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_meet_their_closed_forms() {
        for y in [-0.5, -0.4999, -0.1, 0.1, 0.4999, 0.5] {
            let closed = (f64::exp_m1(y) - y) / (y * y);
            // The closed form cancels: 1e-16 / y².
            assert!((phi2(y) - closed).abs() < 4e-16 / (y * y), "{y}");
        }
        assert_eq!((phi1(0.0), phi2(0.0), phi3(0.0)), (1.0, 0.5, 1.0 / 6.0));
        for y in [-0.5, -0.4999, -0.3, 0.3, 0.4999, 0.5] {
            assert!((phi3(y) - (phi2(y) - 0.5) / y).abs() < 4e-16 / f64::abs(y), "{y}");
        }
        // Slope of φ1 at 1, e − (e − 1) = 1.
        assert!((phi1(1.0) - phi2(1.0) - 1.0).abs() < 1e-15);
    }
}
