//! Softening by earlier load: energy functions of Ogden and Roxburgh, and of damage.

use std::f64::consts::PI;

use super::behaviour::{Softening, SofteningForm};

/// `φ`, `η = dφ/dW` and `dη/dW` of an energy.
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
    /// A point that nothing softens.
    pub(super) fn virgin(energy: f64) -> Self {
        Self { energy, slope: 1.0, curvature: 0.0 }
    }
}

impl Softening {
    /// Softened energy at energy `energy`, the largest so far being `largest` (kPa).
    pub(super) fn at(&self, energy: f64, largest: f64) -> Softened {
        match self.form {
            SofteningForm::OgdenRoxburgh => self.unloaded(energy, largest),
            SofteningForm::Damage => self.damaged(energy, largest),
        }
    }

    /// `φ(W) = W` from `Wm` on; below, with `z = Wm − W` and `c = m + β Wm`, the integral of `η`
    /// that joins it, `φ(W) = W + (z erf(z/c) + c/√π (exp(−z²/c²) − 1)) / r`.
    fn unloaded(&self, energy: f64, largest: f64) -> Softened {
        let z = largest - energy;
        if z <= 0.0 {
            return Softened::virgin(energy);
        }
        let c = self.m_kpa + self.beta * largest;
        let x = z / c;
        let rest = (-x * x).exp_m1();
        let erf = libm::erf(x);
        Softened {
            energy: energy + (z * erf + c / PI.sqrt() * rest) / self.r,
            slope: 1.0 - erf / self.r,
            curvature: 2.0 / (PI.sqrt() * c * self.r) * (1.0 + rest),
        }
    }

    /// `φ(W) = W − d (W + m (exp(−W/m) − 1))` with `d = 1 − 1/r` from `Wm` on; below, its tangent
    /// there.
    fn damaged(&self, energy: f64, largest: f64) -> Softened {
        let lost = 1.0 - 1.0 / self.r;
        let grows = energy >= largest;
        let top = if grows { energy } else { largest };
        let x = top / self.m_kpa;
        let rest = (-x).exp_m1();
        let slope = 1.0 + lost * rest;
        Softened {
            energy: top - lost * (top + self.m_kpa * rest) + slope * (energy - top),
            slope,
            curvature: if grows { -lost / self.m_kpa * (-x).exp() } else { 0.0 },
        }
    }
}
