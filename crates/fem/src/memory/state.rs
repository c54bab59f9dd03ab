//! What a body remembers at its quadrature points, and what of it holds within one step.

use std::borrow::Cow;
use std::sync::Arc;

use rayon::prelude::*;

use super::behaviour::Behaviour;
use super::common::{Common, PointState, PointStep};
use super::prony::{Memory, Term};
use super::tensor::ZERO;
use crate::assembly::{PointModel, Remembered};
use crate::element::PACK;
use crate::material::{Matrix3, PlainLaws, Response, Tangent};

/// Points from which on threads share them.
const SHARED: usize = 256;

/// What holds within a step, at all points.
#[derive(Debug)]
pub(crate) struct StepState {
    pub(super) common: Common,
    n_points: usize,
    /// What the points remember before the step.
    before: Arc<Vec<PointState>>,
    /// What holds at each point; none where elements are taken side by side.
    points: Vec<PointStep>,
    /// For elements side by side: of neo-Hookean bodies, where memory is all there is.
    pub(super) remembered: Option<Remembered>,
}

/// Points of a body that has been through nothing.
pub(crate) fn fresh_states(behaviour: &Behaviour, n: usize) -> Vec<PointState> {
    vec![fresh_state(behaviour); n]
}

/// A point that has been through nothing.
pub(super) fn fresh_state(behaviour: &Behaviour) -> PointState {
    let memory = |terms: &[Term]| (!terms.is_empty()).then(|| Memory::new(terms.len()));
    let [volumetric, isochoric] = behaviour.series();
    PointState {
        gradient: ZERO,
        volumetric: memory(&volumetric),
        isochoric: if behaviour.is_split() { memory(&isochoric) } else { None },
        largest_energy: 0.0,
        largest_strain: ZERO,
    }
}

impl StepState {
    /// What holds within a step of `length` seconds (0: at once) that ends at `time`, s.
    pub(crate) fn new<M: PointModel>(
        elastic: &M,
        behaviour: &Behaviour,
        before: &Arc<Vec<PointState>>,
        n_points: usize,
        length: f64,
        time: f64,
        parallel: bool,
    ) -> Self {
        let common = Common::new(behaviour, length, time);
        let least = least_part(before.len(), parallel);
        let plain = n_points == 1 && common.is_memory_alone() && elastic.neo_hookean().is_some();
        let remembered = plain.then(|| remembered(&common, before, parallel));
        let points = match plain {
            true => Vec::new(),
            false => {
                before.par_iter().with_min_len(least).map(|state| common.point(state)).collect()
            }
        };
        Self { common, n_points, before: Arc::clone(before), points, remembered }
    }

    pub(super) fn at(&self, element: usize, point: usize) -> Cow<'_, PointStep> {
        let index = element * self.n_points + point;
        match self.points.get(index) {
            Some(at) => Cow::Borrowed(at),
            None => Cow::Owned(self.common.point(&self.before[index])),
        }
    }

    /// What the points remember at the end of the step, at these displacement gradients (one per point); none where
    /// one is inverted. `spare`: room for it, all states of any earlier step or none.
    pub(crate) fn updated<M: PointModel>(
        &self,
        elastic: &M,
        gradients: &[Matrix3],
        spare: Vec<PointState>,
        parallel: bool,
    ) -> Option<Vec<PointState>> {
        let mut states = spare;
        let filled = states.len();
        states.extend(self.before.iter().skip(filled).cloned());
        let least = least_part(states.len(), parallel);
        let both = self.before.par_iter().zip(gradients);
        let whole = states.par_iter_mut().zip(both).with_min_len(least).enumerate().all(
            |(index, (state, (before, h)))| {
                let (element, point) = (index / self.n_points, index % self.n_points);
                state.clone_from(before);
                let at = self.points.get(index).unwrap_or(&PointStep::ELASTIC);
                let law = |he: &Matrix3| elastic.response(element, point, he);
                self.common.update(at, h, law, state).is_some()
            },
        );
        whole.then_some(states)
    }
}

/// Points that a thread takes at least: all of them where threads share nothing.
fn least_part(n_points: usize, parallel: bool) -> usize {
    if parallel { SHARED } else { n_points.max(1) }
}

/// A time step of a body as the element loops see it.
#[derive(Debug)]
pub(crate) struct StepModel<'a, M> {
    /// The law at every point.
    pub(crate) elastic: &'a M,
    /// What holds within the step.
    pub(crate) step: &'a StepState,
}

impl<M: PointModel> PointModel for StepModel<'_, M> {
    fn response(&self, element: usize, point: usize, h: &Matrix3) -> Option<Response> {
        let law = |he: &Matrix3| self.elastic.response(element, point, he);
        let at = self.step.at(element, point);
        self.step.common.response(&at, h, law)
    }

    fn tangent(&self, element: usize, point: usize, h: &Matrix3) -> Option<Tangent> {
        let at = self.step.at(element, point);
        let law = |he: &Matrix3| self.elastic.response(element, point, he);
        let law_tangent = |he: &Matrix3| self.elastic.tangent(element, point, he);
        self.step.common.tangent(&at, h, law, law_tangent)
    }

    fn remembering(&self) -> Option<(PlainLaws<'_>, &Remembered)> {
        self.elastic.neo_hookean().zip(self.step.remembered.as_ref())
    }
}

/// What is remembered, eight points at a time.
fn remembered(common: &Common, states: &[PointState], parallel: bool) -> Remembered {
    const PLACES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
    let volumetric = common.weights.volumetric;
    let isochoric = if common.split { common.weights.isochoric } else { volumetric };
    let some = states.first().is_some_and(PointState::remembers);
    let packed = |eight: &[PointState]| {
        let mut six = [[0.0; PACK]; 6];
        for (l, state) in eight.iter().enumerate() {
            let stress = common.history_stress(state).unwrap_or(ZERO);
            for (row, (i, j)) in six.iter_mut().zip(PLACES) {
                row[l] = stress[i][j];
            }
        }
        six
    };
    let least = least_part(states.len(), parallel).div_ceil(PACK);
    let stress = if some {
        states.par_chunks(PACK).with_min_len(least).map(packed).collect()
    } else {
        Vec::new()
    };
    Remembered { volumetric, isochoric, stress }
}
