//! Algebra of 3 x 3 matrices, as far as the history needs it.

use crate::material::{Matrix3, eigen};

pub(super) const ZERO: Matrix3 = [[0.0; 3]; 3];

#[inline(always)]
fn matrix(entry: impl Fn(usize, usize) -> f64) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
}

#[inline]
pub(super) fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    matrix(|i, j| a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j])
}

pub(super) fn transposed(a: &Matrix3) -> Matrix3 {
    matrix(|i, j| a[j][i])
}

pub(super) fn scaled(factor: f64, a: &Matrix3) -> Matrix3 {
    a.map(|row| row.map(|v| factor * v))
}

pub(super) fn plus(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    matrix(|i, j| a[i][j] + b[i][j])
}

pub(super) fn minus(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    matrix(|i, j| a[i][j] - b[i][j])
}

/// `a : b`
#[inline]
pub(super) fn contracted(a: &Matrix3, b: &Matrix3) -> f64 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.fold(0.0, |sum, (x, y)| sum + x * y)
}

#[inline]
pub(super) fn add_scaled(sum: &mut Matrix3, factor: f64, other: &Matrix3) {
    for i in 0..3 {
        for j in 0..3 {
            sum[i][j] += factor * other[i][j];
        }
    }
}

/// `I + h`
#[inline]
pub(super) fn plus_identity(h: &Matrix3) -> Matrix3 {
    plus_scalar(h, 1.0)
}

/// `h + c I`
#[inline]
pub(super) fn plus_scalar(h: &Matrix3, c: f64) -> Matrix3 {
    let mut f = *h;
    for i in 0..3 {
        f[i][i] += c;
    }
    f
}

/// `E = (C − I)/2 = (h + hᵀ + hᵀ h)/2`
pub(super) fn green_strain(h: &Matrix3) -> Matrix3 {
    let square = product(&transposed(h), h);
    matrix(|i, j| 0.5 * (h[i][j] + h[j][i] + square[i][j]))
}

/// Cofactor matrix: `∂ det(m)/∂m`.
fn cofactor(m: &Matrix3) -> Matrix3 {
    matrix(|i, j| {
        let [p, q] = [(i + 1) % 3, (i + 2) % 3];
        let [r, s] = [(j + 1) % 3, (j + 2) % 3];
        m[p][r] * m[q][s] - m[p][s] * m[q][r]
    })
}

/// `det(I + h) − 1`, exact for small `h`.
#[inline]
pub(super) fn det_f_minus_one(h: &Matrix3) -> f64 {
    let c = cofactor(h);
    let trace = h[0][0] + h[1][1] + h[2][2];
    let second = c[0][0] + c[1][1] + c[2][2];
    let third = h[0][0] * c[0][0] + h[0][1] * c[0][1] + h[0][2] * c[0][2];
    trace + second + third
}

/// `F⁻ᵀ`
pub(super) fn inverse_transposed(f: &Matrix3) -> Matrix3 {
    let cofactor = cofactor(f);
    let det = f[0][0] * cofactor[0][0] + f[0][1] * cofactor[0][1] + f[0][2] * cofactor[0][2];
    cofactor.map(|row| row.map(|v| v / det))
}

/// Symmetric matrix of these eigenvalues and eigenvectors, its columns.
pub(super) fn spectral(values: &[f64; 3], axes: &Matrix3) -> Matrix3 {
    matrix(|i, j| (0..3).map(|k| values[k] * axes[i][k] * axes[j][k]).sum())
}

/// Logarithmic strain `½ ln C` of a displacement gradient: eigenvalues, and eigenvectors as columns. None where its norm
/// is at most the one given, as far as a bound tells.
pub(super) fn log_strain_beyond(norm: f64, h: &Matrix3) -> Option<([f64; 3], Matrix3)> {
    let strain = green_strain(h);
    let size = contracted(&strain, &strain).sqrt();
    // No eigenvalue is below −size, where the logarithm is the steepest.
    if size < 0.5 && -0.5 * (-2.0 * size).ln_1p() <= norm {
        return None;
    }
    let (values, axes) = eigen(strain);
    Some((values.map(|e| 0.5 * (2.0 * e).ln_1p()), axes))
}
