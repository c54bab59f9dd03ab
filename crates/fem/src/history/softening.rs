//! Softening by earlier load: the energy function of Ogden and Roxburgh.

use std::f64::consts::PI;

use super::behaviour::Softening;

/// `φ`, `η = dφ/dW` and `dη/dW` of an isochoric energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Softened {
    /// kPa
    pub(super) energy: f64,
    /// Dimensionless.
    pub(super) slope: f64,
    /// 1/kPa
    pub(super) curvature: f64,
}

impl Softened {
    /// A point under more load than ever before.
    pub(super) fn virgin(energy: f64) -> Self {
        Self { energy, slope: 1.0, curvature: 0.0 }
    }
}

impl Softening {
    /// Softened energy at isochoric energy `energy`, the largest so far being `largest` (kPa).
    ///
    /// `φ(W) = W` from `Wm` on; below, with `z = Wm − W` and `c = m + β Wm`, the integral of `η`
    /// that joins it, `φ(W) = W + (z erf(z/c) + c/√π (exp(−z²/c²) − 1)) / r`.
    pub(super) fn at(&self, energy: f64, largest: f64) -> Softened {
        let z = largest - energy;
        if z <= 0.0 {
            return Softened::virgin(energy);
        }
        let c = self.m_kpa + self.beta * largest;
        let x = z / c;
        let erf = libm::erf(x);
        Softened {
            energy: energy + (z * erf + c / PI.sqrt() * (-x * x).exp_m1()) / self.r,
            slope: 1.0 - erf / self.r,
            curvature: 2.0 / (PI.sqrt() * c * self.r) * (-x * x).exp(),
        }
    }
}
