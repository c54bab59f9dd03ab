//! How the entries of a factor are stored: as they are, or as whole numbers times a scale.
//!
//! A solution reads every entry twice and does little with it, so that its time is that of reading.
//! A metric need not be exact: a column of sixteen-bit whole numbers times one scale takes half the
//! room of single precision, and no iteration more than that on any reference problem.

use faer::traits::RealField;
use pulp::Simd;

use super::fronts::BLOCK;

/// Number type in which a factor is made and used.
pub(crate) trait Precision:
    RealField
    + 'static
    + Copy
    + Default
    + std::ops::AddAssign
    + std::ops::SubAssign
    + std::ops::MulAssign
    + std::ops::Mul<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Add<Output = Self>
    + std::ops::Div<Output = Self>
{
    /// As many as the processor takes at once.
    type Lanes<S: Simd>: Copy;

    fn from_f64(value: f64) -> Self;
    fn to_f64(self) -> f64;
    fn splat<S: Simd>(simd: S, value: Self) -> Self::Lanes<S>;
    /// Whole lanes of a slice.
    fn lanes<S: Simd>(slice: &[Self]) -> &[Self::Lanes<S>];
    fn lanes_mut<S: Simd>(slice: &mut [Self]) -> &mut [Self::Lanes<S>];
    /// `a b + c`
    fn mul_add<S: Simd>(
        simd: S,
        a: Self::Lanes<S>,
        b: Self::Lanes<S>,
        c: Self::Lanes<S>,
    ) -> Self::Lanes<S>;
    fn sum<S: Simd>(simd: S, lanes: Self::Lanes<S>) -> Self;
}

impl Precision for f64 {
    type Lanes<S: Simd> = S::f64s;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }

    #[inline(always)]
    fn splat<S: Simd>(simd: S, value: Self) -> S::f64s {
        simd.splat_f64s(value)
    }

    #[inline(always)]
    fn lanes<S: Simd>(slice: &[Self]) -> &[S::f64s] {
        S::as_simd_f64s(slice).0
    }

    #[inline(always)]
    fn lanes_mut<S: Simd>(slice: &mut [Self]) -> &mut [S::f64s] {
        S::as_mut_simd_f64s(slice).0
    }

    #[inline(always)]
    fn mul_add<S: Simd>(simd: S, a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s {
        simd.mul_add_e_f64s(a, b, c)
    }

    #[inline(always)]
    fn sum<S: Simd>(simd: S, lanes: S::f64s) -> Self {
        simd.reduce_sum_f64s(lanes)
    }
}

impl Precision for f32 {
    type Lanes<S: Simd> = S::f32s;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }

    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    #[inline(always)]
    fn splat<S: Simd>(simd: S, value: Self) -> S::f32s {
        simd.splat_f32s(value)
    }

    #[inline(always)]
    fn lanes<S: Simd>(slice: &[Self]) -> &[S::f32s] {
        S::as_simd_f32s(slice).0
    }

    #[inline(always)]
    fn lanes_mut<S: Simd>(slice: &mut [Self]) -> &mut [S::f32s] {
        S::as_mut_simd_f32s(slice).0
    }

    #[inline(always)]
    fn mul_add<S: Simd>(simd: S, a: S::f32s, b: S::f32s, c: S::f32s) -> S::f32s {
        simd.mul_add_e_f32s(a, b, c)
    }

    #[inline(always)]
    fn sum<S: Simd>(simd: S, lanes: S::f32s) -> Self {
        simd.reduce_sum_f32s(lanes)
    }
}

/// An entry below the diagonal as it is kept.
pub(crate) trait Entry: Copy + Default + Send + Sync + std::fmt::Debug {
    /// What it is made of and turned into.
    type Real: Precision;

    /// The entry over its column's scale.
    fn real(self) -> Self::Real;

    /// The scale for a column of entries.
    fn scale(column: &[Self::Real]) -> Self::Real;

    /// Write entries over their scale.
    fn store(entries: &[Self::Real], scale: Self::Real, out: &mut [Self]);

    /// Entries over their scale, for arithmetic.
    fn widen(block: &[Self; BLOCK]) -> [Self::Real; BLOCK];
}

impl Entry for f64 {
    type Real = f64;

    #[inline(always)]
    fn real(self) -> f64 {
        self
    }

    fn scale(_column: &[f64]) -> f64 {
        1.0
    }

    fn store(entries: &[f64], _scale: f64, out: &mut [f64]) {
        out.copy_from_slice(entries);
    }

    #[inline(always)]
    fn widen(block: &[f64; BLOCK]) -> [f64; BLOCK] {
        *block
    }
}

impl Entry for f32 {
    type Real = f32;

    #[inline(always)]
    fn real(self) -> f32 {
        self
    }

    fn scale(_column: &[f32]) -> f32 {
        1.0
    }

    fn store(entries: &[f32], _scale: f32, out: &mut [f32]) {
        out.copy_from_slice(entries);
    }

    #[inline(always)]
    fn widen(block: &[f32; BLOCK]) -> [f32; BLOCK] {
        *block
    }
}

impl Entry for i16 {
    type Real = f32;

    #[inline(always)]
    fn real(self) -> f32 {
        f32::from(self)
    }

    /// What makes the largest entry the largest whole number.
    #[inline(always)]
    fn scale(column: &[f32]) -> f32 {
        let (chunks, rest) = column.as_chunks::<BLOCK>();
        let mut lanes = [0.0_f32; BLOCK];
        for chunk in chunks {
            for k in 0..BLOCK {
                lanes[k] = if chunk[k].abs() > lanes[k] { chunk[k].abs() } else { lanes[k] };
            }
        }
        let largest = lanes.iter().chain(rest).fold(0.0_f32, |m, v| m.max(v.abs()));
        // Not so small that its inverse overflows.
        (largest / f32::from(i16::MAX)).max(f32::MIN_POSITIVE)
    }

    #[inline(always)]
    fn store(entries: &[f32], scale: f32, out: &mut [i16]) {
        /// In the numbers from here on neighbours differ by one.
        const WHOLE: f32 = 12_582_912.0;
        let inverse = 1.0 / scale;
        for (o, &v) in out.iter_mut().zip(entries) {
            *o = (v * inverse + WHOLE).to_bits().wrapping_sub(WHOLE.to_bits()) as i16;
        }
    }

    #[inline(always)]
    fn widen(block: &[i16; BLOCK]) -> [f32; BLOCK] {
        let mut wide = [0.0; BLOCK];
        for k in 0..BLOCK {
            wide[k] = f32::from(block[k]);
        }
        wide
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bits_are_off_by_half_a_step() {
        let column: Vec<f32> = (0..1001).map(|k| (k as f32 * 0.37).sin() * 1e-3).collect();
        let mut stored = vec![0_i16; column.len()];
        let scale = i16::scale(&column);
        i16::store(&column, scale, &mut stored);
        for (s, c) in stored.iter().zip(&column) {
            assert!((s.real() * scale - c).abs() <= 0.51 * scale, "{s} {c}");
        }
        assert_eq!(stored.iter().map(|s| s.unsigned_abs()).max(), Some(32767));
    }

    #[test]
    fn columns_of_nothing_and_of_tiny_numbers_stay_finite() {
        for column in [[0.0; 3], [1e-42, -2e-42, 0.0], [3e-36, -1e-36, 1e-37]] {
            let mut stored = [1_i16; 3];
            let scale = i16::scale(&column);
            i16::store(&column, scale, &mut stored);
            for (s, c) in stored.iter().zip(&column) {
                assert!((s.real() * scale - c).abs() <= 0.51 * scale, "{s} {c}");
            }
        }
    }
}
