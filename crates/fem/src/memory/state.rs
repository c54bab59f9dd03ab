//! What a body remembers at its quadrature points, and what of it holds within one step.

use std::borrow::Cow;
use std::sync::Arc;

use rayon::prelude::*;

use super::behaviour::Behaviour;
use super::common::{Common, PointStep};
use super::layout::Layout;
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
    /// What the points remember before the step, a row each.
    before: Arc<Vec<f64>>,
    /// What holds at each point, where that takes long to compute.
    points: Vec<PointStep>,
    /// For elements side by side: of neo-Hookean bodies, where memory is all there is.
    pub(super) remembered: Option<Remembered>,
}

/// What `n` points remember that have been through nothing.
pub(crate) fn fresh_states(behaviour: &Behaviour, n: usize) -> Vec<f64> {
    vec![0.0; n * Layout::new(behaviour).width]
}

impl StepState {
    /// What holds within a step of `length` seconds (0: at once) that ends at `time`, s.
    pub(crate) fn new<M: PointModel>(
        elastic: &M,
        behaviour: &Behaviour,
        before: &Arc<Vec<f64>>,
        n_points: usize,
        length: f64,
        time: f64,
        parallel: bool,
    ) -> Self {
        let common = Common::new(behaviour, length, time);
        let width = common.layout.stride();
        let least = least_part(before.len() / width, parallel);
        let plain = n_points == 1 && common.is_memory_alone() && elastic.neo_hookean().is_some();
        let remembered = plain.then(|| remembered(&common, before, parallel));
        let points = match common.is_dear() {
            true => {
                let rows = before.par_chunks(width).with_min_len(least);
                rows.map(|row| common.point(row)).collect()
            }
            false => Vec::new(),
        };
        Self { common, n_points, before: Arc::clone(before), points, remembered }
    }

    pub(super) fn at(&self, element: usize, point: usize) -> Cow<'_, PointStep> {
        let index = element * self.n_points + point;
        match self.points.get(index) {
            Some(at) => Cow::Borrowed(at),
            None => Cow::Owned(self.common.point(self.common.layout.row(&self.before, index))),
        }
    }

    /// What the points remember at the end of the step, at these displacement gradients (one per point); none where
    /// one is inverted. `spare`: room for it, what they remember at any other time, or empty.
    pub(crate) fn updated<M: PointModel>(
        &self,
        elastic: &M,
        gradients: &[Matrix3],
        spare: Vec<f64>,
        parallel: bool,
    ) -> Option<Vec<f64>> {
        let mut states = spare;
        states.resize(self.before.len(), 0.0);
        let width = self.common.layout.stride();
        let least = least_part(gradients.len(), parallel);
        let both = self.before.par_chunks(width).zip(gradients);
        let whole = states.par_chunks_mut(width).zip(both).with_min_len(least).enumerate().all(
            |(index, (row, (before, h)))| {
                let (element, point) = (index / self.n_points, index % self.n_points);
                row.copy_from_slice(before);
                let law = |he: &Matrix3| elastic.response(element, point, he);
                self.common.update(&self.elastic_at(element, point), h, law, row).is_some()
            },
        );
        whole.then_some(states)
    }

    /// What its elastic stress at a point depends on: nothing of the step where memory is all there is.
    fn elastic_at(&self, element: usize, point: usize) -> Cow<'_, PointStep> {
        match self.common.is_memory_alone() {
            true => Cow::Borrowed(&PointStep::ELASTIC),
            false => self.at(element, point),
        }
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
fn remembered(common: &Common, states: &[f64], parallel: bool) -> Remembered {
    const PLACES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
    let volumetric = common.weights.volumetric;
    let isochoric = if common.split { common.weights.isochoric } else { volumetric };
    let width = common.layout.stride();
    let packed = |eight: &[f64]| {
        let mut six = [[0.0; PACK]; 6];
        for (l, row) in eight.chunks(width).enumerate() {
            let stress = common.history_stress(row).unwrap_or(ZERO);
            for (row, (i, j)) in six.iter_mut().zip(PLACES) {
                row[l] = stress[i][j];
            }
        }
        six
    };
    let least = least_part(states.len() / width, parallel).div_ceil(PACK);
    let stress = if common.layout.remembers() {
        states.par_chunks(PACK * width).with_min_len(least).map(packed).collect()
    } else {
        Vec::new()
    };
    Remembered { volumetric, isochoric, stress }
}
