//! Steps as they went.

use std::sync::Arc;

use super::common::PointState;
use super::follow::Substance;
use super::state::StepState;
use crate::body::Body;
use crate::load::NodalLoad;
use crate::surface::{Springs, SurfaceTerms};

/// One time step as it went, with all that its derivatives need.
#[derive(Debug)]
pub(crate) struct StepRecord {
    pub(crate) body: Body,
    pub(crate) springs: Vec<Springs>,
    pub(crate) surface: SurfaceTerms,
    pub(crate) load: NodalLoad,
    /// Steps before the frame that this one leads to, and the fraction of the way that it ends at.
    pub(crate) from: usize,
    pub(crate) part: f64,
    /// Memory before the step.
    pub(super) before: Arc<Vec<PointState<f64>>>,
    pub(super) length: f64,
    pub(super) time: f64,
    /// At its end, `(3 n_nodes)`, mm.
    pub(crate) displacement: Vec<f64>,
    pub(crate) least_load: f64,
}

impl StepRecord {
    /// What holds within the step, as the solver had it.
    pub(crate) fn state(&self, substance: Substance) -> StepState {
        let Substance { behaviour, n_points, .. } = substance;
        StepState::new(behaviour, &self.before, n_points, self.length, self.time)
    }

    /// Numbers that a point remembers.
    pub(crate) fn memory_len(&self) -> usize {
        self.before.first().map_or(0, PointState::len)
    }
}
