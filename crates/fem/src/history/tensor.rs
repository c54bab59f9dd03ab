//! Algebra of 3 x 3 matrices, as far as the history needs it.

use nalgebra::SymmetricEigen;

use crate::material::Matrix3;

pub(super) const ZERO: Matrix3 = [[0.0; 3]; 3];

pub(super) fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    let mut c = ZERO;
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                c[i][j] += a[i][k] * b[k][j];
            }
        }
    }
    c
}

pub(super) fn transposed(a: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

/// `a : b`
pub(super) fn contracted(a: &Matrix3, b: &Matrix3) -> f64 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(x, y)| x * y).sum()
}

pub(super) fn add_scaled(sum: &mut Matrix3, factor: f64, other: &Matrix3) {
    for i in 0..3 {
        for j in 0..3 {
            sum[i][j] += factor * other[i][j];
        }
    }
}

/// `I + h`
pub(super) fn plus_identity(h: &Matrix3) -> Matrix3 {
    let mut f = *h;
    for i in 0..3 {
        f[i][i] += 1.0;
    }
    f
}

/// `E = (C − I)/2 = (h + hᵀ + hᵀ h)/2`
pub(super) fn green_strain(h: &Matrix3) -> Matrix3 {
    let square = product(&transposed(h), h);
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (h[i][j] + h[j][i] + square[i][j])))
}

/// `F⁻ᵀ`
pub(super) fn inverse_transposed(f: &Matrix3) -> Matrix3 {
    let cofactor = crate::material::cofactor(f);
    let det = (0..3).map(|j| f[0][j] * cofactor[0][j]).sum::<f64>();
    cofactor.map(|row| row.map(|v| v / det))
}

/// Apply a function to the eigenvalues of a symmetric matrix.
pub(super) fn spectral(symmetric: &Matrix3, function: impl Fn(f64) -> f64) -> Matrix3 {
    let eigen = SymmetricEigen::new(nalgebra::Matrix3::from_fn(|i, j| symmetric[i][j]));
    let mut sum = ZERO;
    for k in 0..3 {
        let value = function(eigen.eigenvalues[k]);
        for i in 0..3 {
            for j in 0..3 {
                sum[i][j] += value * eigen.eigenvectors[(i, k)] * eigen.eigenvectors[(j, k)];
            }
        }
    }
    sum
}

/// Logarithmic strain `½ ln C` of a displacement gradient.
pub(super) fn log_strain(h: &Matrix3) -> Matrix3 {
    spectral(&green_strain(h), |e| 0.5 * (2.0 * e).ln_1p())
}
