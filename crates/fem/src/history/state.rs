//! What a body remembers at its quadrature points, and what of it holds within one step.

use rayon::prelude::*;

use super::behaviour::{Behaviour, Part};
use super::point::{bar_gradient, weighted};
use super::prony::{Decay, Memory, Term};
use super::softening::Softened;
use super::tensor::{
    ZERO, add_scaled, contracted, green_strain, inverse_transposed, log_strain, plus_identity,
    product, spectral, transposed,
};
use crate::assembly::PointModel;
use crate::material::{Matrix3, det_f_minus_one};

/// Factors of the volumetric and the isochoric part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Weights {
    pub(super) volumetric: f64,
    pub(super) isochoric: f64,
}

/// What one point remembers.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PointState {
    /// Displacement gradient at the end of the last step.
    gradient: Matrix3,
    /// Of the whole stress, or of its volumetric part where parts relax differently.
    volumetric: Option<Memory>,
    isochoric: Option<Memory>,
    /// Largest isochoric energy so far, kPa.
    largest_energy: f64,
    /// Logarithmic strain of the largest norm so far.
    largest_strain: Matrix3,
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
    /// Largest isochoric energy before the step, kPa.
    largest_energy: f64,
}

/// What holds within a step, at all points.
#[derive(Debug)]
pub(crate) struct StepState {
    behaviour: Behaviour,
    /// `s` at the end of the step.
    pub(super) stretch: f64,
    pub(super) weights: Weights,
    decays: [Decay; 2],
    split: bool,
    n_points: usize,
    points: Vec<PointStep>,
}

/// The terms of the volumetric and of the isochoric part.
fn series(behaviour: &Behaviour) -> [Vec<Term>; 2] {
    let mut volumetric = Vec::new();
    let mut isochoric = Vec::new();
    if let Some(relaxation) = &behaviour.relaxation {
        for (&share, &tau) in relaxation.g.iter().zip(&relaxation.tau_s) {
            isochoric.push(Term { share, tau });
        }
        if relaxation.part == Part::Whole {
            volumetric.clone_from(&isochoric);
        }
    }
    if let Some(drainage) = behaviour.drainage {
        volumetric.push(Term { share: drainage.share, tau: drainage.tau_s });
    }
    [volumetric, isochoric]
}

/// Whether the two parts of the energy have to be told apart.
fn is_split(behaviour: &Behaviour) -> bool {
    let [volumetric, isochoric] = series(behaviour);
    behaviour.softening.is_some() || volumetric != isochoric
}

/// Points of a body that has been through nothing.
pub(super) fn fresh_states(behaviour: &Behaviour, n: usize) -> Vec<PointState> {
    let memory = |terms: &[Term]| (!terms.is_empty()).then(|| Memory::new(terms.len()));
    let [volumetric, isochoric] = series(behaviour);
    let state = PointState {
        gradient: ZERO,
        volumetric: memory(&volumetric),
        isochoric: if is_split(behaviour) { memory(&isochoric) } else { None },
        largest_energy: 0.0,
        largest_strain: ZERO,
    };
    vec![state; n]
}

impl StepState {
    /// What holds within a step of `length` seconds (0: at once) that ends at `time`, s.
    pub(super) fn new(
        behaviour: &Behaviour,
        states: &[PointState],
        n_points: usize,
        length: f64,
        time: f64,
    ) -> Self {
        let decays = series(behaviour).map(|terms| Decay::new(&terms, length));
        let split = is_split(behaviour);
        let stretch = behaviour.swelling.map_or(1.0, |swelling| swelling.stretch(time));
        let weights = Weights { volumetric: decays[0].instant(), isochoric: decays[1].instant() };
        let viscous = if length > 0.0 { 2.0 * behaviour.viscosity_kpa_s / length } else { 0.0 };
        let points = states
            .par_iter()
            .with_min_len(256)
            .map(|state| PointStep {
                pull: pull(behaviour, state, stretch),
                history_stress: history_stress(&decays, state),
                flow: (viscous > 0.0).then(|| Flow::new(viscous, &state.gradient)),
                largest_energy: state.largest_energy,
            })
            .collect();
        Self { behaviour: behaviour.clone(), stretch, weights, decays, split, n_points, points }
    }

    pub(super) fn at(&self, element: usize, point: usize) -> &PointStep {
        &self.points[element * self.n_points + point]
    }

    pub(super) fn is_split(&self) -> bool {
        self.split
    }

    pub(super) fn softened(&self, energy: f64, at: &PointStep) -> Softened {
        match &self.behaviour.softening {
            Some(softening) => softening.at(energy, at.largest_energy),
            None => Softened::virgin(energy),
        }
    }

    /// End the step at these displacement gradients (one a point); false where one is inverted.
    pub(super) fn update<M: PointModel>(
        &self,
        elastic: &M,
        gradients: &[Matrix3],
        states: &mut [PointState],
    ) -> bool {
        states.par_iter_mut().with_min_len(256).zip(gradients).enumerate().all(
            |(index, (state, h))| {
                let (element, point) = (index / self.n_points, index % self.n_points);
                self.update_point(elastic, element, point, h, state).is_some()
            },
        )
    }

    fn update_point<M: PointModel>(
        &self,
        elastic: &M,
        element: usize,
        point: usize,
        h: &Matrix3,
        state: &mut PointState,
    ) -> Option<()> {
        let at = self.at(element, point);
        let law = |he: &Matrix3| elastic.response(element, point, he);
        let second = |weights: Weights| {
            let stored = self.stored(at, h, |he| weighted(law, he, weights, at, self))?;
            let inverse = transposed(&inverse_transposed(&plus_identity(h)));
            Some(product(&inverse, &stored.stress))
        };
        let alone = if self.split { 0.0 } else { 1.0 };
        if let Some(memory) = &mut state.volumetric {
            let stress = second(Weights { volumetric: 1.0, isochoric: alone })?;
            self.decays[0].update(memory, stress);
        }
        if let Some(memory) = &mut state.isochoric {
            let stress = second(Weights { volumetric: 0.0, isochoric: 1.0 })?;
            self.decays[1].update(memory, stress);
        }
        if self.behaviour.softening.is_some() {
            let energy = law(&bar_gradient(&at.elastic_gradient(h)))?.energy;
            state.largest_energy = state.largest_energy.max(energy);
        }
        if self.behaviour.set.is_some() {
            let strain = log_strain(&without_swelling(h, self.stretch));
            let largest = &state.largest_strain;
            if contracted(&strain, &strain) > contracted(largest, largest) {
                state.largest_strain = strain;
            }
        }
        state.gradient = *h;
        Some(())
    }
}

/// `F / s − I`
fn without_swelling(h: &Matrix3, stretch: f64) -> Matrix3 {
    let mut own = h.map(|row| row.map(|v| v / stretch));
    for i in 0..3 {
        own[i][i] += 1.0 / stretch - 1.0;
    }
    own
}

/// `Fp⁻¹ / s`
fn pull(behaviour: &Behaviour, state: &PointState, stretch: f64) -> Option<Matrix3> {
    let fraction = behaviour.set.map_or(0.0, |set| set.fraction);
    let moved = state.largest_strain != ZERO && fraction > 0.0;
    if !moved && stretch == 1.0 {
        return None;
    }
    Some(spectral(&state.largest_strain, |e| (-fraction * e).exp() / stretch))
}

fn history_stress(decays: &[Decay; 2], state: &PointState) -> Option<Matrix3> {
    let parts = [&state.volumetric, &state.isochoric];
    let mut sum = None;
    for (decay, memory) in decays.iter().zip(parts) {
        if let Some(memory) = memory {
            add_scaled(sum.get_or_insert(ZERO), 1.0, &decay.history(memory));
        }
    }
    sum
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
