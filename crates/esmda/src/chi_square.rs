//! The tail of the chi-square law.

/// Probability that a chi-square variable of `dof` degrees of freedom exceeds `x`.
///
/// `Q(k + 2) = Q(k) + (x/2)^(k/2) exp(-x/2) / Gamma(k/2 + 1)` from `Q(1) = erfc(sqrt(x/2))` and `Q(2) = exp(-x/2)`
/// (M. Abramowitz and I. A. Stegun, "Handbook of mathematical functions", 26.4.4 to 26.4.8): sums of positive terms,
/// so the smallest tails keep their digits. The terms are as many as half the degrees of freedom.
pub(crate) fn tail(x: f64, dof: usize) -> f64 {
    if dof == 0 || x <= 0.0 {
        return 1.0;
    }
    let half = 0.5 * x;
    if half.is_infinite() {
        return 0.0;
    }
    let density = (-half).exp();
    // `term` is (x/2)^(k/2) exp(-x/2) / Gamma(k/2 + 1) for k = 1 or 2, the first that is added.
    let (mut sum, mut term, mut k) = if dof % 2 == 1 {
        (libm::erfc(half.sqrt()), 2.0 * (half / std::f64::consts::PI).sqrt() * density, 1)
    } else {
        (density, half * density, 2)
    };
    while k < dof {
        sum += term;
        k += 2;
        term *= half / (0.5 * k as f64);
    }
    sum.min(1.0)
}
