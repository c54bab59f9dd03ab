//! Four-node neo-Hookean elements side by side, as many as the processor takes at once.
//!
//! The same mathematics as the scalar law. With `x = J − 1`, the law needs `ln J` and `x − ln J`,
//! and for `|x| < 0.3` both follow from
//!
//! ```text
//! s = x / (2 + x),     x − ln(1 + x) = x²/2 − s (x²/2 + R(s²)),     R = Σ_k 2 s^2k / (2 k + 1)
//! ```
//!
//! where nothing of first order cancels. Other elements are left to the scalar law. The isochoric part
//! `ψ_iso = µ/2 (j² tr C − 3)`, with `j² = J^(−2/3) = 1 + e` and `y = −⅔ ln J`, follows as
//!
//! ```text
//! tr C − 3 = d,    j² tr C − 3 = |h|² − 2 q + 2 (x − ln J) + 3 (e − y) + e d,    q = x − tr h
//! e − y = y² Σ_k y^k / (k + 2)!
//! ```

use pulp::Simd;

/// Largest `|J − 1|` for which the series of the logarithm is summed.
const NEAR: f64 = 0.3;

/// `R` by powers of `s²`: with `s² < 0.032`, twelve terms leave less than 1e-18.
const SERIES: [f64; 12] = {
    let mut terms = [0.0; 12];
    let mut k = 0;
    while k < 12 {
        terms[k] = 2.0 / (2 * k + 3) as f64;
        k += 1;
    }
    terms
};

/// `(e^y − 1 − y) / y²` by powers of `y`: with `|y| < 0.24`, thirteen terms leave less than 1e-18.
const EXPONENTIAL: [f64; 13] = {
    let mut terms = [0.5; 13];
    let mut k = 1;
    while k < 13 {
        terms[k] = terms[k - 1] / (k + 2) as f64;
        k += 1;
    }
    terms
};

/// Three rows of three, one entry an element.
pub(super) type Matrices<S> = [[<S as Simd>::f64s; 3]; 3];

/// What the law and the geometry of some elements take.
#[derive(Clone, Copy)]
pub(super) struct Elements<S: Simd> {
    /// `∂ξ_k/∂X_j`, 1/mm.
    pub(super) jacobian: Matrices<S>,
    /// Volumes, mm³.
    pub(super) weight: S::f64s,
    /// Lamé constants, kPa.
    pub(super) mu: S::f64s,
    pub(super) lambda: S::f64s,
}

/// What elements take that remember stresses, see [`Remembered`](super::Remembered).
#[derive(Clone, Copy)]
pub(super) struct Memory<S: Simd> {
    pub(super) volumetric: S::f64s,
    /// `a_iso − a_vol`, where it is not zero.
    pub(super) excess: Option<S::f64s>,
    pub(super) stress: Option<[S::f64s; 6]>,
}

/// What some elements answer.
pub(super) struct Answer<S: Simd> {
    /// Forces of nodes 1 to 3 by component, mN; node 0 balances them.
    pub(super) force: Matrices<S>,
    /// Strain energy, µJ.
    pub(super) energy: S::f64s,
    /// det F.
    pub(super) det_f: S::f64s,
    /// 0 where the series of the logarithm holds, else 1 (also where `det_f` is NaN).
    pub(super) far: S::f64s,
}

/// Forces and energies for `edges[k][i]`, component `i` of `u_(k+1) − u_0`, mm.
#[inline(always)]
pub(super) fn neo_hookean<S: Simd>(
    simd: S,
    elements: &Elements<S>,
    edges: &Matrices<S>,
    memory: Option<&Memory<S>>,
) -> Answer<S> {
    let Elements { jacobian, weight, mu, lambda } = *elements;
    let splat = |v: f64| simd.splat_f64s(v);
    let (one, half) = (splat(1.0), splat(0.5));
    let zero = [[splat(0.0); 3]; 3];

    // h = Σ_a (u_a − u_0) ⊗ ∂ξ_a/∂X
    let mut h = zero;
    for i in 0..3 {
        for j in 0..3 {
            h[i][j] = sum_of_products(
                simd,
                [edges[0][i], edges[1][i], edges[2][i]],
                [jacobian[0][j], jacobian[1][j], jacobian[2][j]],
            );
        }
    }
    let mut cofactor = zero;
    for i in 0..3 {
        let (p, q) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            let (r, s) = ((j + 1) % 3, (j + 2) % 3);
            let minus = simd.neg_f64s(simd.mul_f64s(h[p][s], h[q][r]));
            cofactor[i][j] = simd.mul_add_e_f64s(h[p][r], h[q][s], minus);
        }
    }
    let trace = simd.add_f64s(simd.add_f64s(h[0][0], h[1][1]), h[2][2]);
    let third = sum_of_products(simd, h[0], cofactor[0]);
    let q = simd.add_f64s(
        simd.add_f64s(cofactor[0][0], cofactor[1][1]),
        simd.add_f64s(cofactor[2][2], third),
    );
    let x = simd.add_f64s(trace, q);
    let rest = x_minus_log(simd, x);
    let log = simd.sub_f64s(x, rest);
    let det_f = simd.add_f64s(one, x);
    let mut square = sum_of_products(simd, h[0], h[0]);
    square = simd.add_f64s(square, sum_of_products(simd, h[1], h[1]));
    square = simd.add_f64s(square, sum_of_products(simd, h[2], h[2]));
    let near = simd.less_than_f64s(simd.abs_f64s(x), splat(NEAR));

    let shape = simd.add_f64s(simd.mul_add_e_f64s(half, square, simd.neg_f64s(q)), rest);
    let half_lambda_log = simd.mul_f64s(simd.mul_f64s(half, lambda), log);
    let mut density = simd.mul_add_e_f64s(half_lambda_log, log, simd.mul_f64s(mu, shape));

    // w P = shear (J h + hᵀ + q I − cof h) + pressure cof F
    let over_det = simd.div_f64s(weight, det_f);
    let shear = simd.mul_f64s(over_det, mu);
    let pressure = simd.mul_f64s(over_det, simd.mul_f64s(lambda, log));
    let grown = simd.add_f64s(one, trace);
    // Entries of J h + hᵀ + q I − cof h and of cof F.
    let inner_and_cofactor = |i: usize, j: usize| {
        let mut inner = simd.sub_f64s(h[j][i], cofactor[i][j]);
        let mut cof_f = simd.sub_f64s(cofactor[i][j], h[j][i]);
        if i == j {
            inner = simd.add_f64s(inner, q);
            cof_f = simd.add_f64s(cof_f, grown);
        }
        (simd.mul_add_e_f64s(det_f, h[i][j], inner), cof_f)
    };
    let mut stress = zero;
    for i in 0..3 {
        for j in 0..3 {
            let (inner, cof_f) = inner_and_cofactor(i, j);
            stress[i][j] = simd.mul_add_e_f64s(shear, inner, simd.mul_f64s(pressure, cof_f));
        }
    }
    if let Some(memory) = memory {
        density = simd.mul_f64s(memory.volumetric, density);
        stress = stress.map(|row| row.map(|v| simd.mul_f64s(memory.volumetric, v)));
        if let Some(excess) = memory.excess {
            let y = simd.mul_f64s(splat(-2.0 / 3.0), log);
            let beyond = exponential_beyond(simd, y);
            let growth = simd.add_f64s(y, beyond);
            let spread = simd.mul_add_e_f64s(splat(2.0), trace, square);
            // |h|² − 2 q + 2 (x − ln J) = 2 shape
            let mut rise = simd.mul_add_e_f64s(splat(2.0), shape, simd.mul_f64s(growth, spread));
            rise = simd.mul_add_e_f64s(splat(3.0), beyond, rise);
            let own = simd.mul_f64s(simd.mul_f64s(half, mu), rise);
            density = simd.mul_add_e_f64s(excess, own, density);
            // w P_iso = j² shear (J h + hᵀ + q I − cof h − d/3 cof F)
            let shear = simd.mul_f64s(simd.mul_f64s(excess, shear), simd.add_f64s(one, growth));
            let third = simd.mul_f64s(splat(-1.0 / 3.0), spread);
            for i in 0..3 {
                for j in 0..3 {
                    let (inner, cof_f) = inner_and_cofactor(i, j);
                    let inner = simd.mul_add_e_f64s(third, cof_f, inner);
                    stress[i][j] = simd.mul_add_e_f64s(shear, inner, stress[i][j]);
                }
            }
        }
        if let Some([s00, s11, s22, s01, s02, s12]) = memory.stress {
            let s = [[s00, s01, s02], [s01, s11, s12], [s02, s12, s22]];
            for i in 0..3 {
                for j in 0..3 {
                    // S : E = Σ S_ij (h_ij + ½ Σ_k h_ki h_kj), and w F S.
                    let column = |j: usize| [h[0][j], h[1][j], h[2][j]];
                    let strain = sum_of_products(simd, column(i), column(j));
                    let strain = simd.mul_add_e_f64s(half, strain, h[i][j]);
                    density = simd.mul_add_e_f64s(s[i][j], strain, density);
                    let first = simd.add_f64s(s[i][j], sum_of_products(simd, h[i], s[j]));
                    stress[i][j] = simd.mul_add_e_f64s(weight, first, stress[i][j]);
                }
            }
        }
    }
    let mut force = zero;
    for k in 0..3 {
        for i in 0..3 {
            force[k][i] = sum_of_products(simd, stress[i], jacobian[k]);
        }
    }
    Answer {
        force,
        energy: simd.mul_f64s(weight, density),
        det_f,
        far: simd.select_f64s(near, splat(0.0), one),
    }
}

#[inline(always)]
fn sum_of_products<S: Simd>(simd: S, a: [S::f64s; 3], b: [S::f64s; 3]) -> S::f64s {
    let last = simd.mul_f64s(a[2], b[2]);
    simd.mul_add_e_f64s(a[0], b[0], simd.mul_add_e_f64s(a[1], b[1], last))
}

/// `e^y − 1 − y` for `|y| < 0.24`.
#[inline(always)]
fn exponential_beyond<S: Simd>(simd: S, y: S::f64s) -> S::f64s {
    let mut series = simd.splat_f64s(0.0);
    for k in (0..EXPONENTIAL.len()).rev() {
        series = simd.mul_add_e_f64s(series, y, simd.splat_f64s(EXPONENTIAL[k]));
    }
    simd.mul_f64s(simd.mul_f64s(y, y), series)
}

/// `x − ln(1 + x)` for `|x| < 0.3`.
#[inline(always)]
fn x_minus_log<S: Simd>(simd: S, x: S::f64s) -> S::f64s {
    let s = simd.div_f64s(x, simd.add_f64s(simd.splat_f64s(2.0), x));
    let z = simd.mul_f64s(s, s);
    let mut series = simd.splat_f64s(0.0);
    for k in (0..SERIES.len()).rev() {
        series = simd.mul_add_e_f64s(series, z, simd.splat_f64s(SERIES[k]));
    }
    let half_square = simd.mul_f64s(simd.splat_f64s(0.5), simd.mul_f64s(x, x));
    let correction = simd.mul_f64s(s, simd.mul_add_e_f64s(z, series, half_square));
    simd.sub_f64s(half_square, correction)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `x − ln(1 + x)` of many numbers.
    struct Many<'a>(&'a mut [f64]);

    impl pulp::WithSimd for Many<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for x in S::as_mut_simd_f64s(self.0).0 {
                *x = x_minus_log(simd, *x);
            }
        }
    }

    #[test]
    fn the_series_is_the_logarithm() {
        let x: Vec<f64> = (-2992..3008).map(|k| f64::from(k) * 1e-4).collect();
        let mut rest = x.clone();
        assert_eq!(x.len() % 8, 0);
        pulp::Arch::new().dispatch(Many(&mut rest));
        for (x, rest) in x.iter().zip(rest).filter(|(x, _)| x.abs() < NEAR) {
            let log = x - rest;
            // Two units in the last place.
            assert!((log - x.ln_1p()).abs() <= 2.0 * f64::EPSILON * log.abs(), "{x}: {log}");
        }
        // Where x and its logarithm agree to all digits: x²/2 − x³/3 + x⁴/4.
        let x = 1e-5;
        let exact = x * x * (0.5 - x * (1.0 / 3.0 - x * 0.25));
        let mut rest = [x; 8];
        pulp::Arch::new().dispatch(Many(&mut rest));
        assert!((rest[0] / exact - 1.0).abs() < 1e-14);
    }
}
