//! From rest (or a given start) to the full load: at once, or step by step.
//!
//! A step first moves the supports and, by the linear answer of the current metric, the nodes that
//! follow them; then it descends to equilibrium. Steps that fail are halved, easy ones are followed
//! by longer ones.

use super::metric::Metric;
use super::minimise::{Ended, Goal, Minimiser, iterations_per_factor};
use super::problem::{Problem, State, Workspace};
use super::settings::{LoadSteps, Method};
use crate::error::{FemError, NoEquilibrium, StopReason};

/// Smallest step of the load fraction.
const SMALLEST_STEP: f64 = 1.0 / 512.0;

/// Residual over load of steps before the last.
const STEP_TOLERANCE: f64 = 1e-4;

/// Iterations after which the first attempt at the full load gives way to load steps.
const FIRST_ATTEMPT: usize = 120;

/// Iterations after which a load step is halved.
const STEP_ITERATIONS: usize = 40;

/// Both limits, where the metric is never renewed.
const QUASI_NEWTON_ITERATIONS: usize = 400;

/// Steps that took no more iterations than this are followed by one twice as long.
const EASY: usize = 12;

/// A search for equilibrium and how far it has come.
pub(super) struct Path<'a> {
    pub(super) problem: &'a Problem<'a>,
    pub(super) minimiser: &'a mut Minimiser,
    pub(super) workspace: &'a mut Workspace,
    pub(super) metric: Metric,
}

impl Path<'_> {
    /// Find the equilibrium under the full load, starting from `state`.
    pub(super) fn run(&mut self, mut state: State) -> Result<State, FemError> {
        let mut last = None;
        match self.problem.settings.load_steps {
            LoadSteps::Equal(n) => {
                for k in 1..=n {
                    let (from, to) = ((k - 1) as f64 / n as f64, k as f64 / n as f64);
                    if k > 1 && self.problem.load.moves_supports {
                        self.renew_metric(&state)?;
                    }
                    let ended = self.step(&mut state, to, self.iterations_left())?;
                    if ended.stop.is_some() {
                        return Err(self.failure(from, to, &state, ended));
                    }
                    last = Some(ended);
                }
            }
            LoadSteps::Auto => {
                let mut attempt = state;
                let rest_metric = self.metric.clone();
                let ended = self.step(&mut attempt, 1.0, self.limit(FIRST_ATTEMPT))?;
                if ended.stop.is_none() {
                    return Ok(self.finish(attempt, ended));
                }
                self.metric = rest_metric;
                return self.adaptive_steps();
            }
        }
        match last {
            Some(ended) => Ok(self.finish(state, ended)),
            None => Ok(state),
        }
    }

    /// Load steps from rest that adapt to what succeeds; every attempt starts with the metric of
    /// the last equilibrium.
    fn adaptive_steps(&mut self) -> Result<State, FemError> {
        self.workspace.report.load_steps = 0;
        let allowed = self.work_done() + self.problem.settings.max_iterations as f64;
        let mut metric = self.metric.clone();
        let mut state = State::at_rest(self.problem.body.n_nodes());
        let mut fraction = 0.0;
        let mut step: f64 = 0.25;
        loop {
            let target = if fraction + 1.01 * step >= 1.0 { 1.0 } else { fraction + step };
            let mut attempt = state.clone();
            let ended = self.step(&mut attempt, target, self.limit(STEP_ITERATIONS))?;
            let used_up = self.iterations_left() == 0 || self.work_done() > allowed;
            if ended.stop.is_none() {
                state = attempt;
                fraction = target;
                if fraction >= 1.0 {
                    return Ok(self.finish(state, ended));
                }
                if ended.iterations <= EASY {
                    step *= 2.0;
                }
                self.renew_metric(&state)?;
                metric = self.metric.clone();
                continue;
            }
            step *= 0.5;
            if step < SMALLEST_STEP || used_up {
                let reason = match ended.stop {
                    _ if used_up => StopReason::IterationsUsedUp,
                    Some(StopReason::PrescribedInverts) => StopReason::PrescribedInverts,
                    _ => StopReason::StepTooSmall,
                };
                let ended = Ended { stop: Some(reason), ..ended };
                return Err(self.failure(fraction, target, &attempt, ended));
            }
            self.metric = metric.clone();
        }
    }

    /// Work so far, in iterations: a factor counts as many as take its time, so that a hopeless
    /// search on a large mesh, where factors cost most, ends no later than the setting implies.
    fn work_done(&self) -> f64 {
        let report = &self.workspace.report;
        match self.problem.settings.method {
            Method::Auto => {
                report.iterations as f64
                    + report.factorisations as f64 * iterations_per_factor(self.problem)
            }
            Method::Newton | Method::QuasiNewton => report.iterations as f64,
        }
    }

    /// Renew the metric at an equilibrium, where the method does such things by itself.
    fn renew_metric(&mut self, state: &State) -> Result<(), FemError> {
        match self.problem.settings.method {
            Method::Auto => self.metric.renew(self.problem, state, self.workspace),
            Method::Newton | Method::QuasiNewton => Ok(()),
        }
    }

    /// Iterations allowed in one descent, given what is usual.
    fn limit(&self, usual: usize) -> usize {
        let own = match self.problem.settings.method {
            Method::QuasiNewton => QUASI_NEWTON_ITERATIONS,
            Method::Auto | Method::Newton => usual,
        };
        own.min(self.iterations_left())
    }

    fn iterations_left(&self) -> usize {
        self.problem.settings.max_iterations.saturating_sub(self.workspace.report.iterations)
    }

    /// Go from an equilibrium to that at load fraction `target`; `state` is left where it ended.
    fn step(
        &mut self,
        state: &mut State,
        target: f64,
        max_iterations: usize,
    ) -> Result<Ended, FemError> {
        self.workspace.report.load_steps += 1;
        if !self.move_supports(state, target) {
            return Ok(Ended {
                stop: Some(StopReason::PrescribedInverts),
                residual: 0.0,
                tolerance: 0.0,
                iterations: 0,
            });
        }
        let own = self.problem.settings.tolerance;
        let tolerance = if target < 1.0 { own.max(STEP_TOLERANCE) } else { own };
        let goal = Goal { fraction: target, tolerance, max_iterations };
        self.minimiser.run(self.problem, goal, state, &mut self.metric, self.workspace)
    }

    /// Move held nodes to `target` of their prescribed displacement and let the others follow by
    /// one linear solve; false where that inverts an element (the state is then unchanged).
    fn move_supports(&mut self, state: &mut State, target: f64) -> bool {
        let pattern = self.problem.body.pattern();
        let mut shift = vec![0.0; state.displacement.len()];
        let held = self.problem.body.held().as_flattened();
        for flat in (0..shift.len()).filter(|&flat| held[flat]) {
            shift[flat] = target * self.problem.load.prescribed[flat] - state.displacement[flat];
        }
        if shift.iter().all(|&v| v == 0.0) {
            return self.problem.evaluate(state, self.workspace);
        }
        let Some(product) = self.problem.tangent_product(state, &shift) else { return false };
        let mut rhs = vec![0.0; pattern.n_unknowns()];
        if !self.problem.evaluate(state, self.workspace) {
            return false;
        }
        self.problem.residual_into(state, target, &mut rhs);
        for (r, &flat) in rhs.iter_mut().zip(&pattern.unknown2flat) {
            *r = -*r - product[flat as usize];
        }
        let mut follow = vec![0.0; rhs.len()];
        self.metric.apply_into(self.problem, &rhs, &mut follow, self.workspace);
        for (d, &flat) in follow.iter().zip(&pattern.unknown2flat) {
            shift[flat as usize] = *d;
        }
        let mut moved = state.clone();
        for (u, d) in moved.displacement.iter_mut().zip(&shift) {
            *u += d;
        }
        let upright = self.problem.evaluate(&mut moved, self.workspace);
        if upright {
            *state = moved;
        }
        upright
    }

    fn finish(&mut self, state: State, ended: Ended) -> State {
        let report = &mut self.workspace.report;
        report.load_fraction = 1.0;
        report.residual = ended.residual;
        report.tolerance = ended.tolerance;
        report.min_det_f = state.energy.min_det_f;
        report.strain_energy = state.energy.total;
        state
    }

    fn failure(&self, good: f64, tried: f64, state: &State, ended: Ended) -> FemError {
        let worst_tets = self.problem.worst_tets(&state.displacement);
        FemError::NoEquilibrium(Box::new(NoEquilibrium {
            load_fraction: good,
            tried_fraction: tried,
            iterations: self.workspace.report.iterations,
            residual: ended.residual,
            tolerance: ended.tolerance,
            min_det_f: worst_tets.first().map_or(f64::NAN, |w| w.det_f),
            worst_tets,
            reason: ended.stop.unwrap_or(StopReason::Stalled),
        }))
    }
}
