//! What a body remembers at its quadrature points, and what of it holds within one step.

use rayon::prelude::*;

use super::behaviour::Behaviour;
use super::common::{Common, PointState, PointStep};
use super::prony::{Memory, Term};
use super::tensor::ZERO;
use crate::assembly::{PointModel, Remembered};
use crate::element::PACK;
use crate::material::{Matrix3, PlainLaws, Response, Tangent};

/// What holds within a step, at all points.
#[derive(Debug)]
pub(crate) struct StepState {
    pub(super) common: Common,
    n_points: usize,
    points: Vec<PointStep>,
    /// For elements side by side, where memory is all there is.
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
    pub(crate) fn new(
        behaviour: &Behaviour,
        states: &[PointState],
        n_points: usize,
        length: f64,
        time: f64,
    ) -> Self {
        let common = Common::new(behaviour, length, time);
        let points: Vec<PointStep> =
            states.par_iter().with_min_len(256).map(|state| common.point(state)).collect();
        let plain = n_points == 1 && common.is_memory_alone();
        let remembered = plain.then(|| remembered(&common, &points));
        Self { common, n_points, points, remembered }
    }

    pub(super) fn at(&self, element: usize, point: usize) -> &PointStep {
        &self.points[element * self.n_points + point]
    }

    /// End the step at these displacement gradients (one per point); false where one is inverted.
    pub(crate) fn update<M: PointModel>(
        &self,
        elastic: &M,
        gradients: &[Matrix3],
        states: &mut [PointState],
    ) -> bool {
        states.par_iter_mut().with_min_len(256).zip(gradients).enumerate().all(
            |(index, (state, h))| {
                let (element, point) = (index / self.n_points, index % self.n_points);
                let law = |he: &Matrix3| elastic.response(element, point, he);
                self.common.update(self.at(element, point), h, law, state).is_some()
            },
        )
    }
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
        self.step.common.response(at, h, law)
    }

    fn tangent(&self, element: usize, point: usize, h: &Matrix3) -> Option<Tangent> {
        let at = self.step.at(element, point);
        let law = |he: &Matrix3| self.elastic.response(element, point, he);
        let law_tangent = |he: &Matrix3| self.elastic.tangent(element, point, he);
        self.step.common.tangent(at, h, law, law_tangent)
    }

    fn remembering(&self) -> Option<(PlainLaws<'_>, &Remembered)> {
        self.elastic.neo_hookean().zip(self.step.remembered.as_ref())
    }
}

/// What is remembered, eight points at a time.
fn remembered(common: &Common, points: &[PointStep]) -> Remembered {
    const PLACES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
    let volumetric = common.weights.volumetric;
    let isochoric = if common.split { common.weights.isochoric } else { volumetric };
    let some = points.first().is_some_and(|point| point.history_stress.is_some());
    let packed = |eight: &[PointStep]| {
        let mut six = [[0.0; PACK]; 6];
        for (l, point) in eight.iter().enumerate() {
            let stress = point.history_stress.unwrap_or(ZERO);
            for (row, (i, j)) in six.iter_mut().zip(PLACES) {
                row[l] = stress[i][j];
            }
        }
        six
    };
    let stress = if some {
        points.par_chunks(PACK).with_min_len(32).map(packed).collect()
    } else {
        Vec::new()
    };
    Remembered { volumetric, isochoric, stress }
}
