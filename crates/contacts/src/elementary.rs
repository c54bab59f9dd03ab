//! `exp` and `ln` without branches, so that many run in SIMD lanes; accurate to about 1e-12.

/// Adding it leaves a number's nearest integer in the lowest bits.
const TO_INTEGER: f64 = 6_755_399_441_055_744.0;

/// The logarithm of a positive normal number.
#[inline(always)]
pub(crate) fn ln(x: f64) -> f64 {
    // x = m 2^e with m from sqrt(1/2) to sqrt(2).
    const SQRT_HALF: u64 = 0x3FE6_A09E_667F_3BCD;
    let shifted = x.to_bits().wrapping_sub(SQRT_HALF);
    let mantissa = f64::from_bits((shifted & 0x000F_FFFF_FFFF_FFFF) + SQRT_HALF);
    // The exponent as a number without a conversion of integers: it lands in the low bits of TO_INTEGER.
    let biased = f64::from_bits((shifted >> 52) + TO_INTEGER.to_bits()) - TO_INTEGER;
    let exponent = if biased >= 2048.0 - 0.5 { biased - 4096.0 } else { biased };
    let t = (mantissa - 1.0) / (mantissa + 1.0);
    let s = t * t;
    let series = [15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0];
    let sum = series.iter().fold(1.0 / 17.0, |sum, n| sum * s + 1.0 / n);
    exponent * std::f64::consts::LN_2 + 2.0 * t * sum
}

/// The exponential of a number from -700 to 700.
#[inline(always)]
pub(crate) fn exp(x: f64) -> f64 {
    const LN2_HIGH: f64 = 0.693_147_180_369_123_8;
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    let whole = x * std::f64::consts::LOG2_E + TO_INTEGER;
    let power = whole - TO_INTEGER;
    let r = (x - power * LN2_HIGH) - power * LN2_LOW;
    // 1 / n! from n = 11 down.
    let series = [
        2.505_210_838_544_172e-8,
        2.755_731_922_398_589_3e-7,
        2.755_731_922_398_589e-6,
        2.480_158_730_158_73e-5,
        1.984_126_984_126_984e-4,
        1.388_888_888_888_889e-3,
        8.333_333_333_333_333e-3,
        4.166_666_666_666_666_6e-2,
        1.0 / 6.0,
        0.5,
        1.0,
    ];
    let sum = series.iter().fold(0.0, |sum, c| (sum + c) * r) + 1.0;
    f64::from_bits((whole.to_bits() << 52).wrapping_add(sum.to_bits()))
}

#[cfg(test)]
mod tests {
    use super::{exp, ln};

    #[test]
    fn they_agree_with_the_library() {
        for k in 0..4000 {
            let x = -60.0 + f64::from(k) * 0.0301;
            assert!((exp(x) / x.exp() - 1.0).abs() < 1e-11, "{x}");
            let y = (f64::from(k) * 0.05 - 20.0).exp();
            assert!((ln(y) - y.ln()).abs() < 1e-12 * (1.0 + y.ln().abs()), "{y}");
        }
        for y in [0.5_f64, 0.75, 1.0, 1.0 + 1e-9, 2.0, f64::MAX, f64::MIN_POSITIVE] {
            assert!((ln(y) - y.ln()).abs() < 1e-12 * (1.0 + y.ln().abs()), "{y}");
        }
    }
}
