//! The rotation that is closest to a 3 by 3 matrix.

use nalgebra::DMatrix;

/// Newton steps to the sum of the singular values; it converges quadratically from above, and six are usual.
const MOST_NEWTON: usize = 30;

/// Change of that sum, as a share of it, that ends the steps.
const CONVERGED: f64 = 1e-14;

/// Least share of the largest possible value that the denominator of the closed form may have: rounding grows with its
/// inverse.
const LEAST_BELOW: f64 = 1e-4;

/// The rotation closest to a matrix, for each of many: `R` that maximises `trace(Rᵀ C)`, `det R = 1`.
///
/// Matrices are row by row. NaN everywhere for a matrix with a number that is not finite. In closed form but for one
/// scalar (F. L. Markley, "Attitude determination using vector observations: a fast optimal matrix algorithm", Journal of
/// the Astronautical Sciences 41, 261-280, 1993); by singular values where two of these nearly vanish, as the rotation is
/// then hardly defined. Cost: some tens of products and six divisions each.
///
/// ```
/// let turned = [0.0, -2.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 2.0];
/// let found = tissuereg_fem::closest_rotations(&[turned])[0];
/// assert!((found[1] + 1.0).abs() < 1e-12 && (found[8] - 1.0).abs() < 1e-12);
/// ```
#[must_use]
pub fn closest_rotations(matrices: &[[f64; 9]]) -> Vec<[f64; 9]> {
    matrices.iter().map(closest_rotation).collect()
}

fn closest_rotation(matrix: &[f64; 9]) -> [f64; 9] {
    // Of size one, so that no fourth power leaves the range of numbers.
    let size = matrix.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    let matrix = if size > 0.0 { matrix.map(|x| x / size) } else { *matrix };
    let rows = [0, 3, 6].map(|i| [matrix[i], matrix[i + 1], matrix[i + 2]]);
    let [a, b, c] = rows;
    // The rows of the cofactors of C.
    let cofactors = [cross(b, c), cross(c, a), cross(a, b)];
    let squares = square(&rows);
    let det = dot(a, cofactors[0]);
    let of_cofactors = square(&cofactors);
    let mut total = (3.0 * squares).sqrt();
    for _ in 0..MOST_NEWTON {
        let off = total * total - squares;
        let step =
            (off * off - 8.0 * total * det - 4.0 * of_cofactors) / (4.0 * off * total - 8.0 * det);
        total -= step;
        if step.is_nan() || step.abs() <= CONVERGED * total {
            break;
        }
    }
    let half = 0.5 * (total * total - squares);
    let below = half * total - det;
    // NaN is not above the limit either.
    if below > LEAST_BELOW * squares * total && below.is_finite() {
        // C C' C: products of rows, then their sums of rows.
        let products = [
            [dot(a, a), dot(a, b), dot(a, c)],
            [dot(b, a), dot(b, b), dot(b, c)],
            [dot(c, a), dot(c, b), dot(c, c)],
        ];
        let mut turned = [0.0; 9];
        for i in 0..3 {
            for j in 0..3 {
                let cubic = products[i][0] * a[j] + products[i][1] * b[j] + products[i][2] * c[j];
                turned[3 * i + j] =
                    ((half + squares) * rows[i][j] + total * cofactors[i][j] - cubic) / below;
            }
        }
        return turned;
    }
    by_singular_values(&matrix)
}

fn by_singular_values(matrix: &[f64; 9]) -> [f64; 9] {
    let nothing = [f64::NAN; 9];
    if !matrix.iter().all(|x| x.is_finite()) {
        return nothing;
    }
    // The decomposition of matrices of any size: that of 3 by 3 ones loses half of the digits.
    let parts = DMatrix::from_row_slice(3, 3, matrix).svd(true, true);
    let (Some(mut left), Some(right)) = (parts.u, parts.v_t) else {
        return nothing;
    };
    if (&left * &right).determinant() < 0.0 {
        // The direction of the least singular value, which is the last.
        left.column_mut(2).neg_mut();
    }
    let turned = left * right;
    std::array::from_fn(|k| turned[(k / 3, k % 3)])
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn square(rows: &[[f64; 3]; 3]) -> f64 {
    rows.iter().map(|row| dot(*row, *row)).sum()
}
