//! The state within a time step, and the update of a point's memory at its end, over any [`Scalar`].

use super::behaviour::SofteningForm;
use super::numbers::Numbers;
use super::point::Answer;
use super::prony::{Decay, Memory};
use super::scalar::{Matrix, Scalar, values};
use super::softening::{Softened, Softness};
use super::tensor::{
    contracted, det_f_minus_one, green_strain, inverse_transposed, log_strain, plus, plus_identity,
    plus_scalar, product, scaled, spectral, transposed, zero,
};

/// Factors of the volumetric and the isochoric part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Weights<S> {
    pub(super) volumetric: S,
    pub(super) isochoric: S,
}

impl<S: Scalar> Weights<S> {
    /// Factor of the whole stress, of which damage leaves a share, where all but the isochoric part
    /// has the volumetric factor.
    pub(super) fn of_whole(&self, left: S) -> S {
        self.volumetric + self.isochoric * (left - S::constant(1.0))
    }
}

/// What one point remembers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PointState<S> {
    /// Displacement gradient at the end of the last step.
    pub(super) gradient: Matrix<S>,
    /// Of the whole stress, or of its volumetric part where parts relax differently.
    pub(super) volumetric: Option<Memory<S>>,
    pub(super) isochoric: Option<Memory<S>>,
    /// Largest energy so far that softens, kPa.
    pub(super) largest_energy: S,
    /// Logarithmic strain of the largest norm so far.
    pub(super) largest_strain: Matrix<S>,
}

/// Viscous flow at one point: `½ c ΔE : B ΔE B`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Flow<S> {
    /// `c = 2 η J_n / Δt`, kPa.
    pub(super) factor: S,
    /// `B = C_n⁻¹`
    pub(super) inverse_metric: Matrix<S>,
    /// `E_n`
    pub(super) strain: Matrix<S>,
}

/// What holds at one point within a step.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PointStep<S> {
    /// `A = Fp⁻¹ / s` of `Fe = F A`; none for the identity.
    pub(super) pull: Option<Matrix<S>>,
    /// `S_hist`, kPa.
    pub(super) history_stress: Option<Matrix<S>>,
    pub(super) flow: Option<Flow<S>>,
    /// Largest energy before the step that softens, kPa.
    largest_energy: S,
}

/// What holds at all points alike.
#[derive(Debug, Clone)]
pub(super) struct Common<S> {
    /// `s` at the end of the step.
    pub(super) stretch: S,
    pub(super) weights: Weights<S>,
    decays: [Decay<S>; 2],
    /// Whether the two parts of the energy have to be separated.
    pub(super) split: bool,
    softening: Option<Softness<S>>,
    set: Option<S>,
    /// `2 η / Δt`, kPa.
    viscous: S,
}

impl<S: Scalar> Common<S> {
    /// Of a step of `length` seconds (0: at once) that ends at `time`, s.
    pub(super) fn new(numbers: &Numbers<S>, split: bool, length: f64, time: f64) -> Self {
        let decays = numbers.series().map(|terms| Decay::new(&terms, length));
        let weights = Weights { volumetric: decays[0].instant(), isochoric: decays[1].instant() };
        let viscous = match length > 0.0 {
            true => S::constant(2.0) * numbers.viscosity / S::constant(length),
            false => S::constant(0.0),
        };
        let (softening, set) = (numbers.softening, numbers.set);
        Self { stretch: numbers.stretch(time), weights, decays, split, softening, set, viscous }
    }

    /// What holds at a point.
    pub(super) fn point(&self, state: &PointState<S>) -> PointStep<S> {
        PointStep {
            pull: self.pull(state),
            history_stress: self.history_stress(state),
            flow: (!self.viscous.stays(0.0)).then(|| Flow::new(self.viscous, &state.gradient)),
            largest_energy: state.largest_energy,
        }
    }

    /// Whether something softens in this form.
    pub(super) fn softens(&self, form: SofteningForm) -> bool {
        self.softening.as_ref().is_some_and(|softening| softening.form == form)
    }

    /// Remaining share of the energy that the form softens; all of it for other forms.
    pub(super) fn softened(
        &self,
        form: SofteningForm,
        energy: S,
        at: &PointStep<S>,
    ) -> Softened<S> {
        match &self.softening {
            Some(softening) if softening.form == form => softening.at(energy, at.largest_energy),
            _ => Softened::virgin(energy),
        }
    }

    /// End the step of a point at a displacement gradient; none where it is inverted.
    pub(super) fn update(
        &self,
        at: &PointStep<S>,
        h: &Matrix<S>,
        law: impl Fn(&Matrix<S>) -> Option<Answer<S>>,
        state: &mut PointState<S>,
    ) -> Option<()> {
        let (one, none) = (S::constant(1.0), S::constant(0.0));
        let remembers = state.volumetric.is_some() || state.isochoric.is_some();
        if remembers || self.softening.is_some() {
            let parts = self.parts(at, h, law)?;
            let inverse = transposed(&inverse_transposed(&plus_identity(h)));
            let second = |volumetric: S, isochoric: S| {
                let weights = Weights { volumetric, isochoric };
                product(&inverse, &self.stored(at, h, &parts, weights).stress)
            };
            if let Some(memory) = &mut state.volumetric {
                self.decays[0].update(memory, second(one, if self.split { none } else { one }));
            }
            if let Some(memory) = &mut state.isochoric {
                self.decays[1].update(memory, second(none, one));
            }
            if let Some(softening) = &self.softening {
                let energy = parts.softening_energy(softening.form);
                if energy.value() > state.largest_energy.value() {
                    state.largest_energy = energy;
                }
            }
        }
        if self.set.is_some() {
            let strain = log_strain(&self.without_swelling(h));
            let square = |strain: &Matrix<S>| {
                let strain = values(strain);
                contracted(&strain, &strain)
            };
            if square(&strain) > square(&state.largest_strain) {
                state.largest_strain = strain;
            }
        }
        state.gradient = *h;
        Some(())
    }

    /// `F / s − I`
    fn without_swelling(&self, h: &Matrix<S>) -> Matrix<S> {
        let shrink = S::constant(1.0) / self.stretch;
        plus_scalar(&scaled(shrink, h), shrink - S::constant(1.0))
    }

    /// `Fp⁻¹ / s`
    fn pull(&self, state: &PointState<S>) -> Option<Matrix<S>> {
        let moved = state.largest_strain.as_flattened().iter().any(|v| !v.stays(0.0));
        let shrink = S::constant(1.0) / self.stretch;
        match self.set.filter(|_| moved) {
            Some(fraction) => {
                let stays = scaled(fraction, &state.largest_strain);
                let back = spectral(&stays, |e| (-e).exp(), |e| -(-e).exp());
                Some(scaled(shrink, &back))
            }
            None if self.stretch.stays(1.0) => None,
            None => Some(plus_scalar(&zero(), shrink)),
        }
    }

    fn history_stress(&self, state: &PointState<S>) -> Option<Matrix<S>> {
        let parts = [&state.volumetric, &state.isochoric];
        let mut sum: Option<Matrix<S>> = None;
        for (decay, memory) in self.decays.iter().zip(parts) {
            if let Some(memory) = memory {
                let own = decay.history(memory);
                sum = Some(sum.map_or(own, |sum| plus(&sum, &own)));
            }
        }
        sum
    }
}

impl Common<f64> {
    /// Whether points remember stresses and nothing else happens to them.
    pub(super) fn is_memory_alone(&self) -> bool {
        self.softening.is_none() && self.set.is_none() && self.viscous == 0.0 && self.stretch == 1.0
    }

    /// The same numbers, as constants of another kind.
    pub(super) fn lifted<S: Scalar>(&self) -> Common<S> {
        let one = S::constant;
        Common {
            stretch: one(self.stretch),
            weights: Weights {
                volumetric: one(self.weights.volumetric),
                isochoric: one(self.weights.isochoric),
            },
            decays: [self.decays[0].lifted(), self.decays[1].lifted()],
            split: self.split,
            softening: self.softening.map(|softness| softness.lifted()),
            set: self.set.map(one),
            viscous: one(self.viscous),
        }
    }
}

impl<S: Scalar> Flow<S> {
    fn new(viscous: S, h: &Matrix<S>) -> Self {
        let inverse = inverse_transposed(&plus_identity(h));
        Self {
            factor: viscous * (S::constant(1.0) + det_f_minus_one(h)),
            inverse_metric: product(&transposed(&inverse), &inverse),
            strain: green_strain(h),
        }
    }
}
