//! What all laws read from a displacement gradient.
//!
//! With `J − 1 = tr h + q`, where `q` gathers what is of second and third order in `h`,
//!
//! ```text
//! cof F   = (1 + tr h) I − hᵀ + cof h
//! F⁻ᵀ − I = (cof h − hᵀ − q I) / J
//! ```
//!
//! keep every digit of small strains.

use super::tensor::{cofactor, trace};
use super::{Matrix3, Tangent, tensor};

/// Volume ratio and cofactor of one deformation gradient.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kinematics {
    /// `J`
    pub(super) det_f: f64,
    /// `J − 1`
    pub(super) x: f64,
    /// `J − 1 − tr h`
    pub(super) q: f64,
    /// `ln J`
    pub(super) log: f64,
    /// `cof h`
    pub(super) cof_h: Matrix3,
    /// `tr h`
    pub(super) trace: f64,
}

impl Kinematics {
    /// None unless `0 < det F < ∞`.
    #[inline(always)]
    pub(super) fn new(h: &Matrix3) -> Option<Self> {
        let cof_h = cofactor(h);
        let trace = trace(h);
        let third = h[0][0] * cof_h[0][0] + h[0][1] * cof_h[0][1] + h[0][2] * cof_h[0][2];
        let q = cof_h[0][0] + cof_h[1][1] + cof_h[2][2] + third;
        let x = trace + q;
        let det_f = 1.0 + x;
        // The comparison is false for NaN as well.
        if det_f > 0.0 && det_f < f64::INFINITY {
            Some(Self { det_f, x, q, log: x.ln_1p(), cof_h, trace })
        } else {
            None
        }
    }

    /// `cof F = J F⁻ᵀ`
    #[inline(always)]
    pub(super) fn cof_f(&self, h: &Matrix3) -> Matrix3 {
        let mut cof = self.cof_h;
        for i in 0..3 {
            for j in 0..3 {
                cof[i][j] -= h[j][i];
            }
            cof[i][i] += 1.0 + self.trace;
        }
        cof
    }

    /// `F⁻ᵀ − I`
    pub(super) fn inverse_minus_identity(&self, h: &Matrix3) -> Matrix3 {
        let mut rest = self.cof_h;
        for i in 0..3 {
            for j in 0..3 {
                rest[i][j] -= h[j][i];
            }
            rest[i][i] -= self.q;
        }
        rest.map(|row| row.map(|v| v / self.det_f))
    }

    /// `F⁻ᵀ`, the slope of `ln J`.
    pub(super) fn inverse_transposed(&self, h: &Matrix3) -> Matrix3 {
        tensor::plus_identity(&self.inverse_minus_identity(h))
    }
}

/// Energy of volume change, and whether a law keeps it apart from that of shape.
///
/// The modulus is the bulk modulus `K` of split laws and `λ` of coupled ones. The neo-Hookean law
/// is always coupled: all laws but Hooke's and St. Venant–Kirchhoff's are it where their shape
/// parameters vanish (Ogden: an exponent of 2) if they are [`Coupled`](Self::Coupled).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Volumetric {
    /// `K/2 ln²J`
    #[default]
    Log,
    /// `K/2 (J − 1)²`
    Quadratic,
    /// `λ/2 ln²J`, and a law in the invariants and stretches of `C` itself, according to [`LawKind`].
    ///
    /// [`LawKind`]: super::LawKind
    Coupled,
}

impl Volumetric {
    /// Whether laws are split into shape and volume.
    pub(super) fn splits(self) -> bool {
        self != Self::Coupled
    }

    /// Energy of modulus 1.
    pub(super) fn energy(self, k: &Kinematics) -> f64 {
        0.5 * match self {
            Self::Log | Self::Coupled => k.log * k.log,
            Self::Quadratic => k.x * k.x,
        }
    }

    /// Slope and curvature in `ln J` of modulus 1.
    pub(super) fn slopes(self, k: &Kinematics) -> (f64, f64) {
        match self {
            Self::Log | Self::Coupled => (k.log, 1.0),
            Self::Quadratic => (k.x * k.det_f, k.det_f * (k.det_f + k.x)),
        }
    }

    /// Add the stress of a modulus.
    pub(super) fn add_stress(self, modulus: f64, h: &Matrix3, k: &Kinematics, sum: &mut Matrix3) {
        tensor::add(sum, modulus * self.slopes(k).0, &k.inverse_transposed(h));
    }

    /// Add the tangent of a modulus.
    pub(super) fn add_tangent(self, modulus: f64, h: &Matrix3, k: &Kinematics, sum: &mut Tangent) {
        let (slope, curvature) = self.slopes(k);
        let g = k.inverse_transposed(h);
        tensor::add_outer(sum, modulus * curvature, &g, &g);
        tensor::add_twist(sum, -modulus * slope, &g);
    }
}
