//! Singular values with a sign: `p = U diag(s) Vᵀ` with rotations `U` and `V`.
//!
//! One-sided Jacobi: rotations from the right make the columns of `p` orthogonal, so that small singular
//! values keep their digits. The least one has the sign of `det p`: an inverted tetrahedron has one negative
//! stretch.

use tissuereg_fem::material::Matrix3;

use crate::vectors::cross;

/// Sweeps over the three pairs of columns; four suffice in practice.
const MOST_SWEEPS: usize = 12;

/// Columns whose cosine is below this are orthogonal.
const ORTHOGONAL: f64 = 1e-15;

/// Columns of `u` and `v`, and the values: largest first, the last one signed.
pub(super) struct SignedSvd {
    u: [[f64; 3]; 3],
    pub(super) values: [f64; 3],
    v: [[f64; 3]; 3],
}

impl SignedSvd {
    pub(super) fn new(p: &Matrix3) -> Self {
        let mut b: [[f64; 3]; 3] = std::array::from_fn(|j| std::array::from_fn(|i| p[i][j]));
        let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for _ in 0..MOST_SWEEPS {
            let mut turned = false;
            for [i, j] in [[0, 1], [0, 2], [1, 2]] {
                turned |= make_orthogonal(&mut b, &mut v, i, j);
            }
            if !turned {
                break;
            }
        }
        for [i, j] in [[0, 1], [1, 2], [0, 1]] {
            if dot(&b[i], &b[i]) < dot(&b[j], &b[j]) {
                swap(&mut b, i, j);
                swap(&mut v, i, j);
            }
        }
        let u0 = unit(b[0]).unwrap_or([1.0, 0.0, 0.0]);
        let along = dot(&u0, &b[1]);
        let rest = std::array::from_fn(|i| b[1][i] - along * u0[i]);
        let u1 = unit(rest).unwrap_or_else(|| perpendicular(&u0));
        let u = [u0, u1, cross(u0, u1)];
        Self { values: std::array::from_fn(|k| dot(&u[k], &b[k])), u, v }
    }

    /// The matrix with the same `U` and `V` and other values.
    pub(super) fn with_values(&self, values: [f64; 3]) -> Matrix3 {
        let mut matrix = [[0.0; 3]; 3];
        for k in 0..3 {
            for i in 0..3 {
                for j in 0..3 {
                    matrix[i][j] += values[k] * self.u[k][i] * self.v[k][j];
                }
            }
        }
        matrix
    }
}

/// Turn columns `i` and `j` until they are orthogonal; false where they were.
fn make_orthogonal(b: &mut [[f64; 3]; 3], v: &mut [[f64; 3]; 3], i: usize, j: usize) -> bool {
    let (of_i, of_j, both) = (dot(&b[i], &b[i]), dot(&b[j], &b[j]), dot(&b[i], &b[j]));
    let turns = both.abs() > ORTHOGONAL * (of_i * of_j).sqrt();
    if turns {
        let zeta = (of_j - of_i) / (2.0 * both);
        let tangent = 1.0_f64.copysign(zeta) / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
        let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
        let sine = cosine * tangent;
        for columns in [b, v] {
            for k in 0..3 {
                let (first, second) = (columns[i][k], columns[j][k]);
                columns[i][k] = cosine * first - sine * second;
                columns[j][k] = sine * first + cosine * second;
            }
        }
    }
    turns
}

/// Exchange two columns; one changes its sign, so that a rotation stays one.
fn swap(columns: &mut [[f64; 3]; 3], i: usize, j: usize) {
    columns.swap(i, j);
    columns[j] = columns[j].map(|value| -value);
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// None where there is no direction.
fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(&a, &a).sqrt();
    (length > 1e-150).then(|| a.map(|value| value / length))
}

/// Some direction across a unit vector.
fn perpendicular(a: &[f64; 3]) -> [f64; 3] {
    let least = (0..3).fold(0, |least, k| if a[k].abs() < a[least].abs() { k } else { least });
    let mut axis = [0.0; 3];
    axis[least] = 1.0;
    unit(cross(*a, axis)).unwrap_or(axis)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrices() -> Vec<Matrix3> {
        let mut all = vec![
            [[0.0; 3]; 3],
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
            [[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [0.0, 1.0, 1.0]],
            [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
            [[1.0, 1e-9, 0.0], [0.0, 1e-12, 0.0], [0.0, 0.0, 1e-3]],
        ];
        for k in 0..200 {
            let at = |i: usize| ((k * 9 + i) as f64 * 1.618).sin() * 2.0;
            all.push(std::array::from_fn(|i| std::array::from_fn(|j| at(3 * i + j))));
        }
        all
    }

    fn det(m: &Matrix3) -> f64 {
        dot(&m[0], &cross(m[1], m[2]))
    }

    #[test]
    fn the_factors_give_the_matrix_back() {
        for p in matrices() {
            let svd = SignedSvd::new(&p);
            let back = svd.with_values(svd.values);
            for i in 0..3 {
                for j in 0..3 {
                    // Some thirty operations on numbers of size 4.
                    assert!((back[i][j] - p[i][j]).abs() < 1e-14, "{p:?} {back:?}");
                }
            }
        }
    }

    #[test]
    fn both_factors_are_rotations_and_the_last_value_has_the_sign_of_the_determinant() {
        for p in matrices() {
            let svd = SignedSvd::new(&p);
            for q in [svd.u, svd.v] {
                assert!((det(&q) - 1.0).abs() < 1e-13, "{q:?}");
                for i in 0..3 {
                    for j in 0..3 {
                        let expected = if i == j { 1.0 } else { 0.0 };
                        assert!((dot(&q[i], &q[j]) - expected).abs() < 1e-13, "{q:?}");
                    }
                }
            }
            let [a, b, c] = svd.values;
            assert!(a + 1e-14 >= b && b >= -1e-14 && b + 1e-14 >= c.abs(), "{:?}", svd.values);
            assert!((a * b * c - det(&p)).abs() < 1e-12, "{:?}", svd.values);
        }
    }
}
