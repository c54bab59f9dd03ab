//! Material tests: homogeneous deformation of one point, no mesh.
//!
//! Uniaxial and equibiaxial tests leave one or two directions free; their logarithmic stretches
//! minimise the energy (`free_sides`). With
//! [`Compressibility::Limit`] the volume is kept instead, `K → ∞`, and the pressure follows from the
//! free direction: `P₁₁ = P'₁₁ − P'₃₃ λ₃/λ₁`. A test through time, with memory, is
//! [`stress_history`](crate::stress_history).

use super::free_sides::FreeSides;
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
    let Some(n_free) = mode.n_free() else {
        return Some(law.stress(&sheared(amount))?[0][1]).filter(|stress| stress.is_finite());
    };
    if !(amount > 0.0 && amount.is_finite()) {
        return None;
    }
    let mut piece = FreeSides::new(n_free);
    piece.pull(amount);
    if !limit {
        let (found, ()) = piece.settle(law)?;
        return piece.pulled_stress(&found);
    }
    let (h, stress) = (piece.gradient(), law.stress(&piece.gradient())?);
    let free = stress[2][2] * (1.0 + h[2][2]) / (1.0 + h[0][0]);
    Some(stress[0][0] - free).filter(|stress| stress.is_finite())
}

impl Mode {
    /// Directions that are free; none where the whole deformation is given.
    pub(crate) fn n_free(self) -> Option<usize> {
        match self {
            Self::Uniaxial => Some(2),
            Self::Equibiaxial => Some(1),
            Self::SimpleShear => None,
        }
    }
}

/// `h` of simple shear.
pub(crate) fn sheared(amount: f64) -> Matrix3 {
    [[0.0, amount, 0.0], [0.0; 3], [0.0; 3]]
}
