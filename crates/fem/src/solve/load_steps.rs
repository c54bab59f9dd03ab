//! From rest (or a given start) to the full load: at once, or step by step.
//!
//! A step first moves the supports and, by the linear answer of the current metric, the nodes that
//! follow them; then it descends to equilibrium. Steps that fail are halved, easy ones are followed
//! by longer ones.

use super::metric::Metric;
use super::minimise::{Ended, Goal, Minimiser, iterations_per_factor};
use super::problem::{Problem, State, Workspace};
use super::settings::{LoadSteps, Method, SolveSettings};
use super::support_path::SupportPath;
use crate::error::{FemError, NoEquilibrium, StopReason};

/// Smallest step of the load fraction.
const SMALLEST_STEP: f64 = 1.0 / 512.0;

/// Residual over load of steps before the last.
const STEP_TOLERANCE: f64 = 1e-4;

/// Iterations after which a load step is halved.
const STEP_ITERATIONS: usize = 40;

/// The same where the metric is never renewed.
const QUASI_NEWTON_ITERATIONS: usize = 400;

/// Iterations of a long descent: at the full load, and past a limit point. A column buckles in 300.
const LONG_DESCENT: usize = 400;

/// Iterations with a factor in each at the end of a long descent that has not arrived.
const NEWTON_ITERATIONS: usize = 60;

/// Failures from one equilibrium after which a long descent is made, as past a limit point no
/// step is short enough.
const FAILURES: usize = 3;

/// Steps that took no more iterations than this are followed by one twice as long.
const EASY: usize = 12;

/// A turn of the whole body by more than this makes the metric anew, rad.
const TURN: f64 = 0.3;

/// A search for equilibrium and how far it has come.
pub(super) struct Path<'a> {
    pub(super) problem: &'a Problem<'a>,
    pub(super) minimiser: &'a mut Minimiser,
    pub(super) workspace: &'a mut Workspace,
    pub(super) metric: Metric,
    pub(super) supports: SupportPath,
    /// Time allowed to load steps, in iterations.
    pub(super) allowed: f64,
}

/// An intermediate equilibrium, with the metric to continue from there.
struct Reached {
    state: State,
    fraction: f64,
    metric: Metric,
}

impl Path<'_> {
    /// Find the equilibrium under the full load, starting from `start` or from rest.
    pub(super) fn run(&mut self, start: Option<State>) -> Result<State, FemError> {
        let rest = || State::at_rest(self.problem.body.n_nodes());
        let from = if start.is_some() { None } else { Some(0.0) };
        let mut state = start.unwrap_or_else(rest);
        match self.problem.settings.load_steps {
            LoadSteps::Equal(n) => self.equal_steps(n, from, state),
            LoadSteps::Auto => {
                let metric = self.metric.clone();
                let limit = self.limit(STEP_ITERATIONS);
                let ended = self.step(&mut state, from, 1.0, limit)?;
                let ended = self.go_on(&mut state, 1.0, ended, self.allowed)?;
                if ended.stop.is_none() {
                    return Ok(self.finish(state, ended));
                }
                self.allowed += self.work_done();
                let state = State::at_rest(self.problem.body.n_nodes());
                self.adaptive_steps(Reached { state, fraction: 0.0, metric })
            }
        }
    }

    fn equal_steps(
        &mut self,
        n: usize,
        mut from: Option<f64>,
        state: State,
    ) -> Result<State, FemError> {
        let mut reached = Reached { state, fraction: 0.0, metric: self.metric.clone() };
        for k in 1..=n {
            let to = k as f64 / n as f64;
            if k > 1 && self.problem.load.moves_supports {
                self.renew_metric(&reached.state)?;
            }
            let mut attempt = reached.state.clone();
            let ended = self.step(&mut attempt, from, to, self.iterations_left())?;
            if ended.stop.is_some() {
                return Err(self.failure(&reached, to, &attempt, ended));
            }
            if k == n {
                return Ok(self.finish(attempt, ended));
            }
            reached.state = attempt;
            reached.fraction = to;
            from = Some(to);
        }
        Ok(reached.state)
    }

    /// Load steps from rest that adapt to what succeeds; every attempt starts from the last
    /// equilibrium and with its metric.
    fn adaptive_steps(&mut self, mut reached: Reached) -> Result<State, FemError> {
        self.workspace.report.load_steps = 0;
        let mut step: f64 = 0.25;
        let mut failures = 0;
        loop {
            let whole = reached.fraction + 1.01 * step >= 1.0;
            let target = if whole { 1.0 } else { reached.fraction + step };
            let (attempt, ended) = self.climb(&reached, target, failures + 1 == FAILURES)?;
            if ended.stop.is_none() {
                if target >= 1.0 {
                    return Ok(self.finish(attempt, ended));
                }
                if ended.iterations <= EASY {
                    step *= 2.0;
                }
                failures = 0;
                self.renew_metric(&attempt)?;
                let metric = self.metric.clone();
                reached = Reached { state: attempt, fraction: target, metric };
                continue;
            }
            failures += 1;
            step *= 0.5;
            if step >= SMALLEST_STEP && !self.used_up() {
                continue;
            }
            let reason = match ended.stop {
                _ if self.used_up() => StopReason::IterationsUsedUp,
                Some(StopReason::PrescribedInverts) => StopReason::PrescribedInverts,
                _ => StopReason::StepTooSmall,
            };
            let ended = Ended { stop: Some(reason), ..ended };
            return Err(self.failure(&reached, target, &attempt, ended));
        }
    }

    /// Try to go from an equilibrium to that at another fraction, by a long descent where `long`;
    /// where that ended, and how.
    fn climb(
        &mut self,
        reached: &Reached,
        target: f64,
        long: bool,
    ) -> Result<(State, Ended), FemError> {
        self.metric = reached.metric.clone();
        let mut state = reached.state.clone();
        let limit = self.limit(STEP_ITERATIONS);
        let mut ended = self.step(&mut state, Some(reached.fraction), target, limit)?;
        if long && !is_settled(ended) {
            ended = self.go_on(&mut state, target, ended, self.allowed)?;
            if !is_settled(ended) {
                ended = self.newton(&mut state, target)?;
            }
            self.workspace.report.long_descents += usize::from(ended.stop.is_none());
        }
        Ok((state, ended))
    }

    /// Continue a descent that has used up its iterations, up to some work in all.
    fn go_on(
        &mut self,
        state: &mut State,
        target: f64,
        mut ended: Ended,
        work: f64,
    ) -> Result<Ended, FemError> {
        let begin = self.workspace.report.iterations;
        while ended.stop == Some(StopReason::IterationsUsedUp)
            && self.workspace.report.iterations - begin < LONG_DESCENT
            && self.work_done() < work
            && self.iterations_left() > 0
        {
            ended = self.descend(self.problem, state, target, self.limit(STEP_ITERATIONS))?;
        }
        Ok(ended)
    }

    /// The last resort: a descent with a factor in every iteration.
    fn newton(&mut self, state: &mut State, target: f64) -> Result<Ended, FemError> {
        let each = 1.0 + 2.0 * iterations_per_factor(self.problem);
        let affordable = ((self.allowed - self.work_done()) / each).max(0.0) as usize;
        let method = match self.problem.settings.method {
            Method::Auto | Method::Newton => Method::Newton,
            Method::QuasiNewton => Method::QuasiNewton,
        };
        let settings = SolveSettings { method, ..self.problem.settings.clone() };
        let problem = Problem { settings: &settings, ..*self.problem };
        let limit = NEWTON_ITERATIONS.min(affordable).min(self.iterations_left());
        self.descend(&problem, state, target, limit)
    }

    /// Whether the search has taken the time it may.
    fn used_up(&self) -> bool {
        self.iterations_left() == 0 || self.work_done() > self.allowed
    }

    /// Work so far, in iterations: a factor, and evaluations in excess of one an iteration, count
    /// as many as take their time, so that a settled search on a large mesh, where factors cost
    /// most, ends no later than the setting implies.
    fn work_done(&self) -> f64 {
        let report = &self.workspace.report;
        match self.problem.settings.method {
            Method::Auto => {
                report.work_of_iterations()
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

    /// Go from the state at load fraction `from` (none where it is at none) to the equilibrium at
    /// `target`; `state` is left where that ended.
    fn step(
        &mut self,
        state: &mut State,
        from: Option<f64>,
        target: f64,
        max_iterations: usize,
    ) -> Result<Ended, FemError> {
        self.workspace.report.load_steps += 1;
        if !self.move_supports(state, from, target)? {
            return Ok(Ended {
                stop: Some(StopReason::PrescribedInverts),
                residual: 0.0,
                tolerance: 0.0,
                iterations: 0,
            });
        }
        self.descend(self.problem, state, target, max_iterations)
    }

    /// Descend from a state to the equilibrium at `target`.
    fn descend(
        &mut self,
        problem: &Problem,
        state: &mut State,
        target: f64,
        max_iterations: usize,
    ) -> Result<Ended, FemError> {
        let own = problem.settings.tolerance;
        let tolerance = if target < 1.0 { own.max(STEP_TOLERANCE) } else { own };
        let goal = Goal { fraction: target, tolerance, max_iterations };
        self.minimiser.run(problem, goal, state, &mut self.metric, self.workspace)
    }

    /// Move held nodes to where they are at `target`, and let the others follow: by the common
    /// turn of the supports, then by one linear solve, with the change of the forces or, where
    /// that overshoots, without. False where both invert an element (the state is then unchanged).
    fn move_supports(
        &mut self,
        state: &mut State,
        from: Option<f64>,
        target: f64,
    ) -> Result<bool, FemError> {
        let Problem { body, load, .. } = *self.problem;
        let mut carried = state.clone();
        if let (Some(from), Some(turn)) = (from, self.supports.common()) {
            turn.carry(body, from, target, &mut carried.displacement);
            if turn.angle(from, target) > TURN {
                self.renew_metric(&carried)?;
            }
        }
        let mut goal = carried.displacement.clone();
        self.supports.at_into(body, load, target, &mut goal);
        let shift: Vec<f64> = goal.iter().zip(&carried.displacement).map(|(g, u)| g - u).collect();
        if !self.problem.evaluate(&mut carried, self.workspace) {
            return Ok(false);
        }
        if shift.iter().all(|&v| v == 0.0) {
            *state = carried;
            return Ok(true);
        }
        let mut best = self.followed(&carried, &shift, target, target);
        if let Some(from) = from.filter(|_| load.force.iter().any(|&f| f != 0.0)) {
            let potential = |state: &State| self.problem.potential(state, target);
            let slow = self.followed(&carried, &shift, from, target);
            best = match (best, slow) {
                (Some(fast), Some(slow)) if potential(&slow) < potential(&fast) => Some(slow),
                (fast, slow) => fast.or(slow),
            };
        }
        let Some(best) = best else { return Ok(false) };
        *state = best;
        Ok(true)
    }

    /// The state after `shift` of held axes, the free ones following by one linear solve with the
    /// forces at `fraction` of the load; none where that inverts an element.
    fn followed(
        &mut self,
        state: &State,
        shift: &[f64],
        fraction: f64,
        target: f64,
    ) -> Option<State> {
        let Problem { body, load, .. } = *self.problem;
        let pattern = body.pattern();
        let product = self.problem.tangent_product(state, shift)?;
        let mut rhs = vec![0.0; pattern.n_unknowns()];
        self.problem.residual_into(state, fraction, &mut rhs);
        for (r, &flat) in rhs.iter_mut().zip(&pattern.unknown2flat) {
            *r = -*r - product[flat as usize];
        }
        let mut follow = vec![0.0; rhs.len()];
        self.metric.follow(self.problem, state, self.workspace);
        self.metric.apply_into(self.problem, &rhs, &mut follow, self.workspace);
        let mut moved = state.clone();
        for (d, &flat) in follow.iter().zip(&pattern.unknown2flat) {
            moved.displacement[flat as usize] += d;
        }
        self.supports.at_into(body, load, target, &mut moved.displacement);
        self.problem.evaluate(&mut moved, self.workspace).then_some(moved)
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

    fn failure(&self, reached: &Reached, tried: f64, state: &State, ended: Ended) -> FemError {
        let worst_tets = self.problem.worst_tets(&state.displacement);
        let report = &self.workspace.report;
        FemError::NoEquilibrium(Box::new(NoEquilibrium {
            load_fraction: reached.fraction,
            displacement: reached.state.displacement.as_chunks::<3>().0.to_vec(),
            tried_fraction: tried,
            iterations: report.iterations,
            factorisations: report.factorisations,
            residual: ended.residual,
            tolerance: ended.tolerance,
            min_det_f: worst_tets.first().map_or(f64::NAN, |w| w.det_f),
            worst_tets,
            reason: ended.stop.unwrap_or(StopReason::Stalled),
        }))
    }
}

/// Whether more iterations would change nothing.
fn is_settled(ended: Ended) -> bool {
    matches!(ended.stop, None | Some(StopReason::PrescribedInverts))
}
