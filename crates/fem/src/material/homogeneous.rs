//! Material tests: homogeneous deformation of one point, no mesh.
//!
//! Uniaxial and equibiaxial tests leave one or two directions free; their logarithmic stretches
//! minimise the energy, by damped Newton steps from the isochoric ones. With
//! [`Compressibility::Limit`] the volume is kept instead, `K → ∞`, and the pressure follows from the
//! free direction: `P₁₁ = P'₁₁ − P'₃₃ λ₃/λ₁`.

use super::{Hyperelastic, Law, LawKind, Matrix3};

/// Deformation of a material test; axis 0 is the one that is pulled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Mode {
    /// Stretch along one axis, free across it. Shears are held at zero, as they are anyway unless
    /// fibres lie oblique.
    Uniaxial,
    /// Equal stretches along two axes, free along the third.
    Equibiaxial,
    /// `h = γ e₀ ⊗ e₁`
    SimpleShear,
}

/// Whether a test uses the bulk modulus of the law or its limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Compressibility {
    /// As the law has it.
    #[default]
    OfLaw,
    /// Volume is kept.
    Limit,
}

/// Nominal (first Piola–Kirchhoff) stress of a test, kPa: `P₀₀` at a stretch, `P₀₁` at an amount of
/// shear (dimensionless).
///
/// None where the law has no stress there, and for the limit of St. Venant–Kirchhoff and Hooke,
/// which do not separate shape from volume.
///
/// # Examples
///
/// The incompressible neo-Hookean solid, `μ (λ − λ⁻²)`:
///
/// ```
/// use tissuereg_fem::Material;
/// use tissuereg_fem::material::homogeneous::{Compressibility, Mode, nominal_stress};
///
/// let law = Material::neo_hookean(3.0, 0.49)?.law_at(0, 0);
/// let stress = nominal_stress(&law, Mode::Uniaxial, 2.0, Compressibility::Limit);
/// assert!(stress.is_some_and(|p| (p - law.moduli.mu * 1.75).abs() < 1e-12));
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
pub fn nominal_stress(
    law: &Law,
    mode: Mode,
    amount: f64,
    compressibility: Compressibility,
) -> Option<f64> {
    let limit = compressibility == Compressibility::Limit;
    if limit && matches!(law.kind, LawKind::StVenantKirchhoff | LawKind::Hooke) {
        return None;
    }
    if mode == Mode::SimpleShear {
        let mut h = [[0.0; 3]; 3];
        h[0][1] = amount;
        return Some(law.stress(&h)?[0][1]);
    }
    if !(amount > 0.0 && amount.is_finite()) {
        return None;
    }
    let pulled = amount.ln();
    let n_free = if mode == Mode::Uniaxial { 2 } else { 1 };
    // Logarithmic stretches that keep the volume.
    let mut logs = [pulled; 3];
    logs[3 - n_free..].fill(-pulled * (3 - n_free) as f64 / n_free as f64);
    if limit {
        let stress = law.stress(&gradient(&logs))?;
        return Some(stress[0][0] - stress[2][2] * (logs[2] - logs[0]).exp());
    }
    relax(law, &mut logs, n_free)?;
    Some(law.stress(&gradient(&logs))?[0][0])
}

fn gradient(logs: &[f64; 3]) -> Matrix3 {
    let mut h = [[0.0; 3]; 3];
    (0..3).for_each(|i| h[i][i] = logs[i].exp_m1());
    h
}

/// Minimise the energy over the last `n_free` logarithmic stretches.
fn relax(law: &Law, logs: &mut [f64; 3], n_free: usize) -> Option<()> {
    const MAX_STEPS: usize = 200;
    let free = 3 - n_free;
    for _ in 0..MAX_STEPS {
        let step = newton_step(law, logs, free)?;
        let size = step.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        // Below rounding of a logarithm there is nothing to gain.
        let done = size < 1e-14 * (1.0 + logs[0].abs());
        if done {
            return Some(());
        }
        let energy = law.energy(&gradient(logs))?;
        // A stretch may change by a half at a time, and the energy must not rise beyond rounding.
        let mut share = (0.5 / size).min(1.0);
        loop {
            let tried: [f64; 3] = std::array::from_fn(|i| logs[i] + share * step[i]);
            let rise = law.energy(&gradient(&tried)).map(|tried| tried - energy);
            if rise.is_some_and(|rise| rise <= 1e-12 * energy) {
                *logs = tried;
                break;
            }
            share *= 0.5;
            if share * size < 1e-15 {
                return (size < 1e-9).then_some(());
            }
        }
    }
    None
}

/// Newton step of the free logarithmic stretches, in a direction along which the energy falls.
fn newton_step(law: &Law, logs: &[f64; 3], free: usize) -> Option<[f64; 3]> {
    let h = gradient(logs);
    let (stress, tangent) = (law.stress(&h)?, law.tangent(&h)?);
    let stretch = logs.map(f64::exp);
    let slope = |i: usize| stress[i][i] * stretch[i];
    let curvature = |i: usize, j: usize| {
        let of_chart = if i == j { slope(i) } else { 0.0 };
        tangent[4 * i][4 * j] * stretch[i] * stretch[j] + of_chart
    };
    let mut step = [0.0; 3];
    if free == 2 {
        step[2] = -slope(2) / curvature(2, 2).abs();
        return step[2].is_finite().then_some(step);
    }
    let (a, b, c) = (curvature(1, 1), curvature(1, 2), curvature(2, 2));
    let (r, s) = (slope(1), slope(2));
    let det = a * c - b * b;
    if a > 0.0 && det > 0.0 {
        step[1] = -(c * r - b * s) / det;
        step[2] = -(a * s - b * r) / det;
    } else {
        let scale = a.abs() + b.abs() + c.abs();
        (step[1], step[2]) = (-r / scale, -s / scale);
    }
    step.iter().all(|v| v.is_finite()).then_some(step)
}
