//! The state within a time step, and the update of a point's memory at its end.

use super::behaviour::{Behaviour, Drainage, Part, Softening, SofteningForm, Swelling};
use super::prony::{Decay, Memory, Term};
use super::softening::Softened;
use super::tensor::{
    ZERO, det_f_minus_one, green_strain, inverse_transposed, plus, plus_identity, plus_scalar,
    product, scaled, spectral, transposed,
};
use crate::material::Matrix3;

/// Factors of the volumetric and the isochoric part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Weights {
    pub(super) volumetric: f64,
    pub(super) isochoric: f64,
}

impl Weights {
    /// Factor of the whole stress, of which damage leaves a share, where all but the isochoric part
    /// has the volumetric factor.
    pub(super) fn of_whole(&self, left: f64) -> f64 {
        self.volumetric + self.isochoric * (left - 1.0)
    }
}

/// What one point remembers.
#[derive(Debug, PartialEq)]
pub(crate) struct PointState {
    /// Displacement gradient at the end of the last step.
    pub(super) gradient: Matrix3,
    /// Of the whole stress, or of its volumetric part where parts relax differently.
    pub(super) volumetric: Option<Memory>,
    pub(super) isochoric: Option<Memory>,
    /// Largest energy so far that softens, kPa.
    pub(super) largest_energy: f64,
    /// Logarithmic strain of the largest norm so far.
    pub(super) largest_strain: Matrix3,
}

impl PointState {
    /// Whether it remembers stresses.
    pub(super) fn remembers(&self) -> bool {
        self.volumetric.is_some() || self.isochoric.is_some()
    }
}

impl Clone for PointState {
    fn clone(&self) -> Self {
        Self { volumetric: self.volumetric.clone(), isochoric: self.isochoric.clone(), ..*self }
    }

    /// Without allocation where as much is remembered.
    fn clone_from(&mut self, source: &Self) {
        self.gradient = source.gradient;
        self.volumetric.clone_from(&source.volumetric);
        self.isochoric.clone_from(&source.isochoric);
        self.largest_energy = source.largest_energy;
        self.largest_strain = source.largest_strain;
    }
}

/// Viscous flow at one point: `½ c ΔE : B ΔE B`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Flow {
    /// `c = 2 η J_n / Δt`, kPa.
    pub(super) factor: f64,
    /// `B = C_n⁻¹`
    pub(super) inverse_metric: Matrix3,
    /// `E_n`
    pub(super) strain: Matrix3,
}

/// What holds at one point within a step.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PointStep {
    /// `A = Fp⁻¹ / s` of `Fe = F A`; none for the identity.
    pub(super) pull: Option<Matrix3>,
    /// `S_hist`, kPa.
    pub(super) history_stress: Option<Matrix3>,
    pub(super) flow: Option<Flow>,
    /// Largest energy before the step that softens, kPa.
    largest_energy: f64,
}

impl PointStep {
    /// At a point that remembers stresses and nothing else, without these: they do not change its elastic stress.
    pub(super) const ELASTIC: Self =
        Self { pull: None, history_stress: None, flow: None, largest_energy: 0.0 };
}

/// What holds at all points alike.
#[derive(Debug, Clone)]
pub(super) struct Common {
    /// `s` at the end of the step.
    pub(super) stretch: f64,
    pub(super) weights: Weights,
    pub(super) decays: [Decay; 2],
    /// Whether the two parts of the energy have to be separated.
    pub(super) split: bool,
    pub(super) softening: Option<Softening>,
    pub(super) set: Option<f64>,
    swelling: Option<Swelling>,
    /// `η`, kPa s.
    viscosity: f64,
    /// `2 η / Δt`, kPa.
    viscous: f64,
}

impl Common {
    /// Of a step of `length` seconds (0: at once) that ends at `time`, s.
    pub(super) fn new(behaviour: &Behaviour, length: f64, time: f64) -> Self {
        let mut common = Self {
            stretch: 1.0,
            weights: Weights { volumetric: 1.0, isochoric: 1.0 },
            decays: behaviour.series().map(|terms| Decay::new(&terms)),
            split: behaviour.is_split(),
            softening: behaviour.softening,
            set: behaviour.set.map(|set| set.fraction),
            swelling: behaviour.swelling,
            viscosity: behaviour.viscosity_kpa_s,
            viscous: 0.0,
        };
        common.set_step(length, time);
        common
    }

    /// Go over to another step of the same behaviour, as [`new`](Self::new), without allocation.
    pub(super) fn set_step(&mut self, length: f64, time: f64) {
        self.decays.iter_mut().for_each(|decay| decay.set_step(length));
        let [volumetric, isochoric] = &self.decays;
        self.weights = Weights { volumetric: volumetric.instant(), isochoric: isochoric.instant() };
        self.stretch = self.swelling.map_or(1.0, |swelling| swelling.stretch(time));
        self.viscous = if length > 0.0 { 2.0 * self.viscosity / length } else { 0.0 };
    }

    /// What holds at a point.
    pub(super) fn point(&self, state: &PointState) -> PointStep {
        PointStep {
            pull: self.pull(state),
            history_stress: self.history_stress(state),
            flow: (self.viscous != 0.0).then(|| Flow::new(self.viscous, &state.gradient)),
            largest_energy: state.largest_energy,
        }
    }

    /// Whether something softens in this form.
    pub(super) fn softens(&self, form: SofteningForm) -> bool {
        self.softening.as_ref().is_some_and(|softening| softening.form == form)
    }

    /// Remaining share of the energy that the form softens; all of it for other forms.
    pub(super) fn softened(&self, form: SofteningForm, energy: f64, at: &PointStep) -> Softened {
        match &self.softening {
            Some(softening) if softening.form == form => softening.at(energy, at.largest_energy),
            _ => Softened::virgin(energy),
        }
    }

    /// `F / s − I`
    pub(super) fn without_swelling(&self, h: &Matrix3) -> Matrix3 {
        let shrink = 1.0 / self.stretch;
        plus_scalar(&scaled(shrink, h), shrink - 1.0)
    }

    /// `Fp⁻¹ / s`
    fn pull(&self, state: &PointState) -> Option<Matrix3> {
        let moved = state.largest_strain.as_flattened().iter().any(|&v| v != 0.0);
        let shrink = 1.0 / self.stretch;
        match self.set.filter(|_| moved) {
            Some(fraction) => {
                let stays = scaled(fraction, &state.largest_strain);
                let back = spectral(&stays, |e| (-e).exp());
                Some(scaled(shrink, &back))
            }
            None if self.stretch == 1.0 => None,
            None => Some(plus_scalar(&ZERO, shrink)),
        }
    }

    /// `S_hist`, kPa; none where no stress is remembered.
    pub(super) fn history_stress(&self, state: &PointState) -> Option<Matrix3> {
        let parts = [&state.volumetric, &state.isochoric];
        let mut sum: Option<Matrix3> = None;
        for (decay, memory) in self.decays.iter().zip(parts) {
            if let Some(memory) = memory {
                let own = decay.history(memory);
                sum = Some(sum.map_or(own, |sum| plus(&sum, &own)));
            }
        }
        sum
    }
}

impl Common {
    /// Whether points remember stresses and nothing else happens to them.
    pub(super) fn is_memory_alone(&self) -> bool {
        self.softening.is_none() && self.set.is_none() && self.viscous == 0.0 && self.stretch == 1.0
    }
}

impl Behaviour {
    /// The terms of the volumetric and of the isochoric part.
    pub(super) fn series(&self) -> [Vec<Term>; 2] {
        let part = self.relaxation.as_ref().map_or(Part::Whole, |relaxation| relaxation.part);
        let pairs = self.relaxation.iter().flat_map(|series| series.g.iter().zip(&series.tau_s));
        let isochoric: Vec<Term> = pairs.map(|(&share, &tau)| Term { share, tau }).collect();
        let mut volumetric = match part {
            Part::Whole => isochoric.clone(),
            Part::Isochoric => Vec::new(),
        };
        let drained = |drainage: Drainage| Term { share: drainage.share, tau: drainage.tau_s };
        volumetric.extend(self.drainage.map(drained));
        [volumetric, isochoric]
    }

    /// Whether the two parts of the energy have to be separated.
    pub(super) fn is_split(&self) -> bool {
        let isochoric = self.relaxation.as_ref().is_some_and(|relaxation| {
            relaxation.part == Part::Isochoric && !relaxation.g.is_empty()
        });
        let softens_unloaded = |s: Softening| s.form == SofteningForm::OgdenRoxburgh;
        self.softening.is_some_and(softens_unloaded) || self.drainage.is_some() || isochoric
    }
}

impl Flow {
    fn new(viscous: f64, h: &Matrix3) -> Self {
        let inverse = inverse_transposed(&plus_identity(h));
        Self {
            factor: viscous * (1.0 + det_f_minus_one(h)),
            inverse_metric: product(&transposed(&inverse), &inverse),
            strain: green_strain(h),
        }
    }
}
