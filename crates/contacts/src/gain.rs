//! How three more causes of one variance change the evidence.

/// `v b' (I + v S)^-1 b` and `|I + v S|` for `S = [xx, yy, zz, xy, xz, yz]`, by elimination.
///
/// Rounding may leave next to nothing of a pivot that is at least one; then it is one.
#[inline(always)]
pub(crate) fn gain_of(s: &[f64; 6], b: &[f64; 3], variance: f64) -> (f64, f64) {
    let [xx, yy, zz, xy, xz, yz] = s.map(|entry| variance * entry);
    let first = 1.0 + xx;
    let (y, z) = (xy / first, xz / first);
    let second = f64::max(1.0 + yy - y * xy, 1.0);
    let left = yz - y * xz;
    let w = left / second;
    let third = f64::max(1.0 + zz - z * xz - w * left, 1.0);
    let (b1, b2) = (b[1] - y * b[0], b[2] - z * b[0]);
    let b2 = b2 - w * b1;
    let exponent = variance * (b[0] * b[0] / first + b1 * b1 / second + b2 * b2 / third);
    (exponent, first * second * third)
}

#[cfg(test)]
mod tests {
    use super::gain_of;

    #[test]
    fn three_causes_are_eliminated_as_by_hand() {
        // I + S = [[2, 1, 0], [1, 3, 1], [0, 1, 2]]: determinant 8, inverse [[5, -2, 1], [-2, 4, -2], [1, -2, 5]] / 8.
        let (exponent, determinant) =
            gain_of(&[0.5, 1.0, 0.5, 0.5, 0.0, 0.5], &[1.0, 2.0, 3.0], 2.0);
        assert!((determinant - 8.0).abs() < 1e-14);
        let wanted = 2.0 * (5.0 + 16.0 + 45.0 - 8.0 + 6.0 - 24.0) / 8.0;
        assert!((exponent - wanted).abs() < 1e-13);
    }

    #[test]
    fn a_direction_that_others_hold_already_gains_nothing() {
        let (exponent, determinant) =
            gain_of(&[1e8, 1e8, 0.0, 1e8, 0.0, 0.0], &[1.0, 1.0, 0.0], 1e3);
        assert!((determinant / 2e11 - 1.0).abs() < 1e-3 && (exponent * 1e8 - 1.0).abs() < 1e-3);
    }
}
