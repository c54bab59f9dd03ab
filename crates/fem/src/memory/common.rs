//! The state within a time step, and the update of a point's memory at its end.

use super::behaviour::{Behaviour, Drainage, Part, Softening, SofteningForm, Swelling};
use super::layout::{Layout, matrix};
use super::prony::{Decay, Term};
use super::softening::Softened;
use super::tensor::{
    ZERO, det_f_minus_one, green_strain, inverse_transposed, plus, plus_identity, plus_scalar,
    product, scaled, transposed,
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
    pub(super) layout: Layout,
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
            layout: Layout::new(behaviour),
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

    /// What holds at a point that remembers a row of numbers.
    pub(super) fn point(&self, row: &[f64]) -> PointStep {
        let Layout { gradient, largest_energy, .. } = self.layout;
        let flows = gradient.filter(|_| self.viscous != 0.0);
        PointStep {
            pull: self.pull(row),
            history_stress: self.history_stress(row),
            flow: flows.map(|first| Flow::new(self.viscous, &matrix(row, first))),
            largest_energy: largest_energy.map_or(0.0, |place| row[place]),
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
    fn pull(&self, row: &[f64]) -> Option<Matrix3> {
        let shrink = 1.0 / self.stretch;
        match self.layout.set.filter(|&place| row[place] > 0.0) {
            Some(place) => Some(scaled(shrink, &matrix(row, place + 1))),
            None if self.stretch == 1.0 => None,
            None => Some(plus_scalar(&ZERO, shrink)),
        }
    }

    /// `S_hist`, kPa; none where no stress is remembered.
    pub(super) fn history_stress(&self, row: &[f64]) -> Option<Matrix3> {
        let mut sum: Option<Matrix3> = None;
        for (decay, place) in self.decays.iter().zip(&self.layout.series) {
            if let Some(place) = place {
                let own = decay.history(&row[place.clone()]);
                sum = Some(sum.map_or(own, |sum| plus(&sum, &own)));
            }
        }
        sum
    }
}

impl Common {
    /// Whether what holds at a point takes long to compute.
    pub(super) fn is_dear(&self) -> bool {
        self.set.is_some() || self.viscous != 0.0
    }

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
