//! Algebra of 3 x 3 matrices, as far as the history needs it.

use nalgebra::SymmetricEigen;

use super::scalar::{Matrix, Scalar, values};
use crate::material::Matrix3;

pub(super) const ZERO: Matrix3 = [[0.0; 3]; 3];

pub(super) fn zero<S: Scalar>() -> Matrix<S> {
    [[S::constant(0.0); 3]; 3]
}

#[inline(always)]
fn matrix<S>(entry: impl Fn(usize, usize) -> S) -> Matrix<S> {
    std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
}

#[inline]
pub(super) fn product<S: Scalar>(a: &Matrix<S>, b: &Matrix<S>) -> Matrix<S> {
    matrix(|i, j| a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j])
}

pub(super) fn transposed<S: Scalar>(a: &Matrix<S>) -> Matrix<S> {
    matrix(|i, j| a[j][i])
}

pub(super) fn scaled<S: Scalar>(factor: S, a: &Matrix<S>) -> Matrix<S> {
    a.map(|row| row.map(|v| factor * v))
}

pub(super) fn plus<S: Scalar>(a: &Matrix<S>, b: &Matrix<S>) -> Matrix<S> {
    matrix(|i, j| a[i][j] + b[i][j])
}

pub(super) fn minus<S: Scalar>(a: &Matrix<S>, b: &Matrix<S>) -> Matrix<S> {
    matrix(|i, j| a[i][j] - b[i][j])
}

/// `a : b`
#[inline]
pub(super) fn contracted<S: Scalar>(a: &Matrix<S>, b: &Matrix<S>) -> S {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.fold(S::constant(0.0), |sum, (x, y)| sum + *x * *y)
}

#[inline]
pub(super) fn add_scaled<S: Scalar>(sum: &mut Matrix<S>, factor: S, other: &Matrix<S>) {
    for i in 0..3 {
        for j in 0..3 {
            sum[i][j] = sum[i][j] + factor * other[i][j];
        }
    }
}

/// `I + h`
#[inline]
pub(super) fn plus_identity<S: Scalar>(h: &Matrix<S>) -> Matrix<S> {
    plus_scalar(h, S::constant(1.0))
}

/// `h + c I`
#[inline]
pub(super) fn plus_scalar<S: Scalar>(h: &Matrix<S>, c: S) -> Matrix<S> {
    let mut f = *h;
    for i in 0..3 {
        f[i][i] = f[i][i] + c;
    }
    f
}

/// `E = (C − I)/2 = (h + hᵀ + hᵀ h)/2`
pub(super) fn green_strain<S: Scalar>(h: &Matrix<S>) -> Matrix<S> {
    let square = product(&transposed(h), h);
    let half = S::constant(0.5);
    matrix(|i, j| half * (h[i][j] + h[j][i] + square[i][j]))
}

/// Cofactor matrix: `∂ det(m)/∂m`.
fn cofactor<S: Scalar>(m: &Matrix<S>) -> Matrix<S> {
    matrix(|i, j| {
        let [p, q] = [(i + 1) % 3, (i + 2) % 3];
        let [r, s] = [(j + 1) % 3, (j + 2) % 3];
        m[p][r] * m[q][s] - m[p][s] * m[q][r]
    })
}

/// `det(I + h) − 1`, exact for small `h`.
#[inline]
pub(super) fn det_f_minus_one<S: Scalar>(h: &Matrix<S>) -> S {
    let c = cofactor(h);
    let trace = h[0][0] + h[1][1] + h[2][2];
    let second = c[0][0] + c[1][1] + c[2][2];
    let third = h[0][0] * c[0][0] + h[0][1] * c[0][1] + h[0][2] * c[0][2];
    trace + second + third
}

/// `F⁻ᵀ`
pub(super) fn inverse_transposed<S: Scalar>(f: &Matrix<S>) -> Matrix<S> {
    let cofactor = cofactor(f);
    let det = f[0][0] * cofactor[0][0] + f[0][1] * cofactor[0][1] + f[0][2] * cofactor[0][2];
    cofactor.map(|row| row.map(|v| v / det))
}

/// Eigenvalues this close to each other, over 1 plus their size, have the slope between them in
/// place of the divided difference. The error of either is about 1e-11 there.
const CLOSE: f64 = 1e-5;

/// Apply a function to the eigenvalues of a symmetric matrix.
///
/// Its derivative along `Ė` is `Σ f[λ_a, λ_b] (n_a · Ė n_b) n_a ⊗ n_b` with divided differences
/// (Daleckii and Krein; Higham, *Functions of Matrices*, SIAM 2008, theorem 3.11).
pub(super) fn spectral<S: Scalar>(
    symmetric: &Matrix<S>,
    function: impl Fn(f64) -> f64,
    slope: impl Fn(f64) -> f64,
) -> Matrix<S> {
    let given = values(symmetric);
    let eigen = SymmetricEigen::new(nalgebra::Matrix3::from_fn(|i, j| given[i][j]));
    let (lambda, axes) = (&eigen.eigenvalues, &eigen.eigenvectors);
    let mut sum = ZERO;
    for k in 0..3 {
        let value = function(lambda[k]);
        for i in 0..3 {
            for j in 0..3 {
                sum[i][j] += value * axes[(i, k)] * axes[(j, k)];
            }
        }
    }
    if !S::FOLLOWS {
        return sum.map(|row| row.map(S::constant));
    }
    let divided: Matrix3 = matrix(|a, b| {
        let (x, y) = (lambda[a], lambda[b]);
        match (x - y).abs() > CLOSE * (1.0 + x.abs() + y.abs()) {
            true => (function(x) - function(y)) / (x - y),
            false => slope(0.5 * (x + y)),
        }
    });
    matrix(|i, j| {
        let by = |k: usize, l: usize| -> f64 {
            let pair = |ab: usize| {
                let (a, b) = (ab / 3, ab % 3);
                divided[a][b] * axes[(i, a)] * axes[(j, b)] * axes[(k, a)] * axes[(l, b)]
            };
            (0..9).map(pair).sum()
        };
        S::chain(sum[i][j], (0..9).map(|kl| (symmetric[kl / 3][kl % 3], by(kl / 3, kl % 3))))
    })
}

/// Logarithmic strain `½ ln C` of a displacement gradient.
pub(super) fn log_strain<S: Scalar>(h: &Matrix<S>) -> Matrix<S> {
    spectral(&green_strain(h), |e| 0.5 * (2.0 * e).ln_1p(), |e| 1.0 / (1.0 + 2.0 * e))
}
