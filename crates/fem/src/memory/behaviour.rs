//! What a material does beyond its elastic law, with the ranges of every number.

use crate::check::must;
use crate::error::FemError;

/// Which part of the stress relaxes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Part {
    /// All of it.
    #[default]
    Whole,
    /// The part of the volume-preserving deformation alone.
    Isochoric,
}

/// Relaxation: a Prony series of the second Piola–Kirchhoff stress.
///
/// `S(t) = (1 − Σ g) S_e(t) + Σ g_i ∫ exp(−(t − s)/τ_i) dS_e(s)`, where `S_e` is the elastic stress;
/// moduli of the law are instantaneous ones.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Relaxation {
    /// Share of the stress that each term relaxes, dimensionless; each above 0, the sum below 1.
    pub g: Vec<f64>,
    /// Relaxation time of each term, s.
    pub tau_s: Vec<f64>,
    /// Which part of the stress relaxes.
    pub part: Part,
}

/// Drainage: relaxation of the volumetric part of the stress, as a stand-in for fluid that leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drainage {
    /// Share that drains, dimensionless, in (0, 1).
    pub share: f64,
    /// Relaxation time, s.
    pub tau_s: f64,
}

/// Softening by earlier load, by the largest energy so far, `Wm`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Softening {
    /// How the energy softens.
    pub form: SofteningForm,
    /// Dimensionless; at least 1.
    pub r: f64,
    /// Energy over which small loads soften, kPa; at least 0, above 0 where `beta` is 0.
    pub m_kpa: f64,
    /// Share of `Wm` added to `m`, dimensionless; at least 0. 0 for damage.
    pub beta: f64,
}

/// How an energy softens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SofteningForm {
    /// Mullins effect: loading for the first time is not softened, and below the largest isochoric
    /// energy so far the isochoric stress is multiplied by
    /// `η = 1 − erf((Wm − W)/(m + β Wm)) / r` (Ogden and Roxburgh 1999).
    OgdenRoxburgh,
    /// Damage: the whole stress, under its first load too, is multiplied by
    /// `η = 1 − (1 − 1/r) (1 − exp(−Wm/m))`, `Wm` being of the whole energy (after Simo 1987).
    Damage,
}

/// Set: a share of the largest strain that stays.
///
/// The largest logarithmic strain so far (by its norm, at each point) times `fraction` is what the
/// material has as its new rest shape: `Fp = exp(fraction · E_log,max)`. It is held within a step
/// and updated at its end, so it shows from the next frame on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Set {
    /// Share of the largest strain that stays, dimensionless, in (0, 1).
    pub fraction: f64,
}

/// Swelling: a stretch `1 + ε(t)`, the same in all directions and everywhere, along a ramp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Swelling {
    /// Strain at the end of the ramp, dimensionless, above −1; negative where the body shrinks.
    pub linear_strain: f64,
    /// Start of the ramp, s.
    pub from_time_s: f64,
    /// End of the ramp, s.
    pub to_time_s: f64,
}

impl Swelling {
    /// Stretch at a time, dimensionless.
    pub fn stretch(&self, time_s: f64) -> f64 {
        let length = self.to_time_s - self.from_time_s;
        let done = if length > 0.0 {
            ((time_s - self.from_time_s) / length).clamp(0.0, 1.0)
        } else if time_s >= self.to_time_s {
            1.0
        } else {
            0.0
        };
        1.0 + done * self.linear_strain
    }
}

/// What a material does beyond its elastic law; the default is nothing.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::{Behaviour, Relaxation};
///
/// let slow = Relaxation { g: vec![0.3, 0.2], tau_s: vec![1.0, 20.0], ..Relaxation::default() };
/// let behaviour = Behaviour { relaxation: Some(slow), ..Behaviour::default() };
/// assert!(behaviour.check().is_ok());
///
/// let all = Relaxation { g: vec![0.6, 0.4], tau_s: vec![1.0, 20.0], ..Relaxation::default() };
/// let behaviour = Behaviour { relaxation: Some(all), ..Behaviour::default() };
/// assert_eq!(
///     behaviour.check().map_err(|e| e.to_string()),
///     Err("`relaxation.g` must be above 0, with a sum below 1; found 1".to_owned())
/// );
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Behaviour {
    /// Relaxation of the stress.
    pub relaxation: Option<Relaxation>,
    /// Viscosity `η` of the Cauchy stress `2 η D`, kPa s; 0 for none.
    pub viscosity_kpa_s: f64,
    /// Softening by earlier load.
    pub softening: Option<Softening>,
    /// Set.
    pub set: Option<Set>,
    /// Drainage.
    pub drainage: Option<Drainage>,
    /// Swelling.
    pub swelling: Option<Swelling>,
}

impl Behaviour {
    /// Check all ranges.
    ///
    /// # Errors
    ///
    /// [`FemError::BadParameter`] with the first value outside its range,
    /// [`FemError::WrongLength`] where `g` and `tau_s` differ in length.
    pub fn check(&self) -> Result<(), FemError> {
        let drained = self.check_drainage()?;
        if let Some(relaxation) = &self.relaxation {
            relaxation.check(drained)?;
        }
        must(
            "viscosity",
            "finite and not negative",
            self.viscosity_kpa_s,
            self.viscosity_kpa_s >= 0.0 && self.viscosity_kpa_s.is_finite(),
        )?;
        if let Some(Softening { form, r, m_kpa, beta }) = self.softening {
            must("softening.r", "at least 1 and finite", r, r >= 1.0 && r.is_finite())?;
            if form == SofteningForm::Damage {
                must("softening.beta", "0 for damage", beta, beta == 0.0)?;
            }
            let fits = beta >= 0.0 && beta.is_finite();
            must("softening.beta", "finite and not negative", beta, fits)?;
            let fits = m_kpa >= 0.0 && m_kpa.is_finite() && (m_kpa > 0.0 || beta > 0.0);
            must("softening.m", "finite and not negative, above 0 where beta is 0", m_kpa, fits)?;
        }
        if let Some(Set { fraction }) = self.set {
            must("set.fraction", "above 0 and below 1", fraction, inside(fraction))?;
        }
        if let Some(swelling) = &self.swelling {
            swelling.check()?;
        }
        Ok(())
    }

    fn check_drainage(&self) -> Result<f64, FemError> {
        let Some(Drainage { share, tau_s }) = self.drainage else { return Ok(0.0) };
        must("drainage.share", "above 0 and below 1", share, inside(share))?;
        must("drainage.tau", "positive and finite", tau_s, tau_s > 0.0 && tau_s.is_finite())?;
        Ok(share)
    }
}

impl Relaxation {
    fn check(&self, drained: f64) -> Result<(), FemError> {
        if self.g.len() != self.tau_s.len() {
            return Err(FemError::WrongLength {
                what: "relaxation.tau (one time a share)",
                expected: self.g.len(),
                found: self.tau_s.len(),
            });
        }
        for &g in &self.g {
            must("relaxation.g", "above 0, with a sum below 1", g, g > 0.0)?;
        }
        let sum: f64 = self.g.iter().sum();
        must("relaxation.g", "above 0, with a sum below 1", sum, sum < 1.0)?;
        let both = if self.part == Part::Whole { sum + drained } else { sum };
        must("relaxation.g", "below 1 in sum, with the share that drains", both, both < 1.0)?;
        for &tau in &self.tau_s {
            must("relaxation.tau", "positive and finite", tau, tau > 0.0 && tau.is_finite())?;
        }
        Ok(())
    }
}

impl Swelling {
    fn check(&self) -> Result<(), FemError> {
        let strain = self.linear_strain;
        let fits = strain > -1.0 && strain.is_finite();
        must("swelling.linear_strain", "above -1 and finite", strain, fits)?;
        let (from, to) = (self.from_time_s, self.to_time_s);
        must("swelling.from_time", "finite", from, from.is_finite())?;
        let fits = to.is_finite() && to >= from;
        must("swelling.to_time", "finite and not before its start", to, fits)
    }
}

fn inside(share: f64) -> bool {
    share > 0.0 && share < 1.0
}
