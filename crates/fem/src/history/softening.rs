//! Softening by earlier load: energy functions of Ogden and Roxburgh, and of damage.

use std::f64::consts::PI;

use super::behaviour::SofteningForm;
use super::scalar::Scalar;

/// `φ`, `η = dφ/dW` and `dη/dW` of an energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Softened<S> {
    /// kPa
    pub(super) energy: S,
    /// Dimensionless.
    pub(super) slope: S,
    /// 1/kPa
    pub(super) curvature: f64,
}

impl<S: Scalar> Softened<S> {
    /// A point that nothing softens.
    pub(super) fn virgin(energy: S) -> Self {
        Self { energy, slope: S::constant(1.0), curvature: 0.0 }
    }
}

/// Numbers of the softening.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Softness<S> {
    pub(super) form: SofteningForm,
    pub(super) r: S,
    pub(super) m_kpa: S,
    pub(super) beta: S,
}

impl<S: Scalar> Softness<S> {
    /// Softened energy at energy `energy`, the largest so far being `largest` (kPa).
    pub(super) fn at(&self, energy: S, largest: S) -> Softened<S> {
        match self.form {
            SofteningForm::OgdenRoxburgh => self.unloaded(energy, largest),
            SofteningForm::Damage => self.damaged(energy, largest),
        }
    }

    /// `φ(W) = W` from `Wm` on; below, with `z = Wm − W` and `c = m + β Wm`, the integral of `η`
    /// that joins it, `φ(W) = W + (z erf(z/c) + c/√π (exp(−z²/c²) − 1)) / r`.
    fn unloaded(&self, energy: S, largest: S) -> Softened<S> {
        let z = largest - energy;
        if z.value() <= 0.0 {
            return Softened::virgin(energy);
        }
        let c = self.m_kpa + self.beta * largest;
        let ratio = z / c;
        let x = ratio.value();
        let bell = (-x * x).exp();
        let erf = ratio.apply(libm::erf(x), 2.0 / PI.sqrt() * bell);
        let rest = ratio.apply((-x * x).exp_m1(), -2.0 * x * bell);
        let root = S::constant(PI.sqrt());
        Softened {
            energy: energy + (z * erf + c / root * rest) / self.r,
            slope: S::constant(1.0) - erf / self.r,
            curvature: 2.0 / (PI.sqrt() * c.value() * self.r.value()) * bell,
        }
    }

    /// `φ(W) = W − d (W + m (exp(−W/m) − 1))` with `d = 1 − 1/r` from `Wm` on; below, its tangent
    /// there.
    fn damaged(&self, energy: S, largest: S) -> Softened<S> {
        let one = S::constant(1.0);
        let lost = one - one / self.r;
        let grows = energy.value() >= largest.value();
        let top = if grows { energy } else { largest };
        let ratio = top / self.m_kpa;
        let x = ratio.value();
        let rest = ratio.apply((-x).exp_m1(), -(-x).exp());
        let slope = one + lost * rest;
        Softened {
            energy: top - lost * (top + self.m_kpa * rest) + slope * (energy - top),
            slope,
            curvature: if grows { -lost.value() / self.m_kpa.value() * (-x).exp() } else { 0.0 },
        }
    }
}

impl Softness<f64> {
    /// The same numbers, as constants of another kind.
    pub(super) fn lifted<S: Scalar>(self) -> Softness<S> {
        let one = S::constant;
        Softness { form: self.form, r: one(self.r), m_kpa: one(self.m_kpa), beta: one(self.beta) }
    }
}
