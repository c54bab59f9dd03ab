//! A recorded step with its exact tangent.

use super::super::cause::{Cause, Scene};
use super::super::rates::{Tangent, exact, factor};
use crate::assembly::{PointMap, gradients_at_points};
use crate::error::FemError;
use crate::history::{History, Rig, StepModel, StepRecord, Substance};
use crate::material::Matrix3;
use crate::solve::{Model, Precision, Problem, SolveSettings, Solver, State};

/// Where a step ended.
pub(super) struct Arrived<'a> {
    pub(super) step: &'a StepRecord,
    pub(super) substance: Substance<'a>,
    /// Displacement gradients at all points.
    pub(super) gradients: Vec<Matrix3>,
    pub(super) map: PointMap,
}

impl<'a> Arrived<'a> {
    pub(super) fn new(step: &'a StepRecord, history: &'a History) -> Result<Self, FemError> {
        let geometry = step.body.geometry();
        let substance = Substance {
            material: history.material(),
            behaviour: history.behaviour(),
            n_points: step.body.element().n_points(),
        };
        let gradients = gradients_at_points(geometry, &step.displacement);
        let map = PointMap::new(geometry, &step.displacement).ok_or_else(|| inverted(step))?;
        Ok(Self { step, substance, gradients, map })
    }

    /// Do something with the tangent, factored once.
    pub(super) fn with_tangent<R>(
        &self,
        settings: &SolveSettings,
        run: impl FnOnce(&Tangent) -> Result<R, FemError>,
    ) -> Result<R, FemError> {
        settings.check_cancel()?;
        let step = self.step;
        let holds = step.state(self.substance);
        let model = StepModel { elastic: self.substance.material, step: &holds };
        let settings = exact(settings);
        let problem = Problem {
            body: &step.body,
            model: Model::Step(&model),
            surface: &step.surface,
            load: &step.load,
            settings: &settings,
            parallel: settings.is_parallel(),
            least_load: step.least_load,
        };
        let mut state = State::at_rest(step.body.n_nodes());
        state.displacement.copy_from_slice(&step.displacement);
        if !Solver::new(&step.body, problem.parallel).evaluate(&problem, &mut state) {
            return Err(inverted(step));
        }
        let factored = factor(&problem, &state, Precision::Double)?;
        run(&Tangent { problem, state: &state, factored: &factored })
    }

    /// `ṙ` at fixed displacement of springs and skins.
    pub(super) fn surface_rates(&self, cause: &Cause) -> Result<Vec<f64>, FemError> {
        let scene = Scene {
            body: &self.step.body,
            material: self.substance.material,
            springs: &self.step.springs,
            displacement: &self.step.displacement,
            gradients: &self.gradients,
            map: &self.map,
        };
        scene.rates(cause).map(|rates| rates.unbalanced)
    }
}

/// A point of a step has no stress, or none that could be followed.
pub(super) fn inverted(step: &StepRecord) -> FemError {
    let det_f = crate::assembly::det_f_by_element(step.body.geometry(), &step.displacement);
    let worst = det_f.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
    let (tet, det_f) = worst.map_or((0, f64::NAN), |(tet, det_f)| (tet, *det_f));
    FemError::InvertedStart { tet, det_f }
}

/// Recorded steps of a rig.
///
/// # Errors
///
/// [`FemError::NothingRecorded`].
pub(super) fn recorded(rig: &Rig) -> Result<&[std::sync::Arc<StepRecord>], FemError> {
    rig.history().steps().ok_or(FemError::NothingRecorded)
}
