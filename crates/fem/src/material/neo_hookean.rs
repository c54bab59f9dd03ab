//! The compressible neo-Hookean law.
//!
//! With `J − 1 = tr h + q`, where `q` gathers what is of second and third order in `h`, and
//! `cof F = (1 + tr h) I − hᵀ + cof h`, nothing of first order cancels in
//!
//! ```text
//! ψ   = μ (|h|²/2 − q + (x − ln(1 + x))) + λ/2 ln²J,     x = J − 1
//! J P = μ (J h + hᵀ + q I − cof h) + λ ln J cof F
//! ```
//!
//! which are the usual `μ/2 (tr C − 3) − μ ln J + λ/2 ln²J` and `μ (F − F⁻ᵀ) + λ ln J F⁻ᵀ`.

use super::kinematics::Kinematics;
use super::tensor::x_minus_log;
use super::{Hyperelastic, Matrix3, Response, Tangent};

/// Compressible neo-Hookean solid.
///
/// Energy density `ψ = μ/2 (tr C − 3) − μ ln J + λ/2 (ln J)²`, stress
/// `P = μ (F − F⁻ᵀ) + λ ln J F⁻ᵀ`, with `F = I + h`, `C = FᵀF`, `J = det F`.
/// Both are formed from `h`, never from `F − I`, so that small strains keep their
/// digits.
///
/// # Units
///
/// `mu`, `lambda`, energy density and stress in kPa; `h` has none.
///
/// # Reference
///
/// Bonet and Wood, *Nonlinear Continuum Mechanics for Finite Element Analysis*,
/// 2nd ed., Cambridge University Press, 2008.
///
/// # Examples
///
/// An undeformed solid is free of stress, and a small stretch is answered by the
/// linear modulus `λ + 2μ`:
///
/// ```
/// use tissuereg_fem::material::{Hyperelastic, NeoHookean};
///
/// let liver = NeoHookean { mu: 2.0, lambda: 20.0 };
/// assert_eq!(liver.stress(&[[0.0; 3]; 3]), Some([[0.0; 3]; 3]));
///
/// let mut h = [[0.0; 3]; 3];
/// h[0][0] = 1e-9;
/// let p = liver.stress(&h).ok_or("inverted")?;
/// assert!((p[0][0] / 1e-9 - 24.0).abs() < 1e-6);
/// # Ok::<(), &'static str>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeoHookean {
    /// Shear modulus `μ`, kPa.
    pub mu: f64,
    /// First Lamé constant `λ`, kPa.
    pub lambda: f64,
}

impl NeoHookean {
    /// Law with the linear response of Young's modulus `young` (kPa) and Poisson's ratio
    /// `poisson`: `μ = E / (2 (1 + ν))`, `λ = E ν / ((1 + ν)(1 − 2ν))`.
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::material::NeoHookean;
    ///
    /// let law = NeoHookean::from_young(10.0, 0.25);
    /// assert_eq!((law.mu, law.lambda), (4.0, 4.0));
    /// ```
    pub fn from_young(young: f64, poisson: f64) -> Self {
        Self {
            mu: young / (2.0 * (1.0 + poisson)),
            lambda: young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
        }
    }

    /// Bulk modulus `K = λ + 2μ/3`, kPa.
    pub fn bulk(&self) -> f64 {
        self.lambda + 2.0 / 3.0 * self.mu
    }

    /// Derivative of the moduli by Young's modulus at fixed Poisson's ratio.
    pub(super) fn by_young(&self) -> Self {
        let Self { mu, lambda } = *self;
        let young = mu * (3.0 * lambda + 2.0 * mu) / (lambda + mu);
        Self { mu: mu / young, lambda: lambda / young }
    }

    /// Derivative of the moduli by Poisson's ratio at fixed Young's modulus:
    /// `∂μ = −μ/(1 + ν)`, `∂K = 2 K/(1 − 2ν)`.
    pub(super) fn by_poisson(&self) -> Self {
        let Self { mu, lambda } = *self;
        // 1 + ν and 1 − 2ν, the latter without cancellation near 1/2.
        let plus = (3.0 * lambda + 2.0 * mu) / (2.0 * (lambda + mu));
        let minus = mu / (lambda + mu);
        let (by_mu, by_bulk) = (-mu / plus, 2.0 * self.bulk() / minus);
        Self { mu: by_mu, lambda: by_bulk - 2.0 / 3.0 * by_mu }
    }
}

impl NeoHookean {
    #[inline(always)]
    fn energy_of(&self, h: &Matrix3, k: &Kinematics) -> f64 {
        let square: f64 = h.iter().flatten().map(|v| v * v).sum();
        self.mu * (0.5 * square - k.q + x_minus_log(k.x, k.log)) + 0.5 * self.lambda * k.log * k.log
    }

    #[inline(always)]
    fn stress_of(&self, h: &Matrix3, k: &Kinematics) -> Matrix3 {
        let cof_f = k.cof_f(h);
        let inverse_j = 1.0 / k.det_f;
        let pressure = self.lambda * k.log * inverse_j;
        let shear = self.mu * inverse_j;
        let mut stress = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                stress[i][j] =
                    shear * (k.det_f * h[i][j] + h[j][i] - k.cof_h[i][j]) + pressure * cof_f[i][j];
            }
            stress[i][i] += shear * k.q;
        }
        stress
    }
}

impl NeoHookean {
    /// `F⁻ᵀ` and `μ − λ ln J`, of which the tangent is made; none where inverted.
    #[inline(always)]
    pub(crate) fn tangent_parts(&self, h: &Matrix3) -> Option<(Matrix3, f64)> {
        let kinematics = Kinematics::new(h)?;
        let mut g = kinematics.cof_f(h);
        let inverse_j = 1.0 / kinematics.det_f;
        for row in &mut g {
            for v in row {
                *v *= inverse_j;
            }
        }
        Some((g, self.mu - self.lambda * kinematics.log))
    }
}

impl Hyperelastic for NeoHookean {
    fn energy(&self, h: &Matrix3) -> Option<f64> {
        Kinematics::new(h).map(|k| self.energy_of(h, &k))
    }

    fn stress(&self, h: &Matrix3) -> Option<Matrix3> {
        Kinematics::new(h).map(|k| self.stress_of(h, &k))
    }

    /// `∂P_ij/∂h_kl = μ δ_ik δ_jl + (μ − λ ln J) G_il G_kj + λ G_ij G_kl`, with `G = F⁻ᵀ`.
    fn tangent(&self, h: &Matrix3) -> Option<Tangent> {
        let kinematics = Kinematics::new(h)?;
        let g = kinematics.cof_f(h).map(|row| row.map(|v| v / kinematics.det_f));
        let twist = self.mu - self.lambda * kinematics.log;
        let mut tangent = [[0.0; 9]; 9];
        for i in 0..3 {
            for j in 0..3 {
                for k in 0..3 {
                    for l in 0..3 {
                        tangent[3 * i + j][3 * k + l] =
                            twist * g[i][l] * g[k][j] + self.lambda * g[i][j] * g[k][l];
                    }
                }
                tangent[3 * i + j][3 * i + j] += self.mu;
            }
        }
        Some(tangent)
    }

    #[inline(always)]
    fn response(&self, h: &Matrix3) -> Option<Response> {
        let k = Kinematics::new(h)?;
        Some(Response {
            energy: self.energy_of(h, &k),
            stress: self.stress_of(h, &k),
            det_f: k.det_f,
        })
    }
}
