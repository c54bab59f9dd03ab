//! The iteration: descend the potential energy at one load fraction until the forces balance.
//!
//! Every iteration carries the metric along, solves once with it, corrects the direction by the
//! L-BFGS memory and searches along it. The methods differ in when the metric is made anew: never,
//! in every iteration, or where the residual falls so slowly that a factor pays for itself.

use super::lbfgs::Memory;
use super::line_search::Search;
use super::metric::Metric;
use super::problem::{Problem, State, Workspace, dot, norm};
use super::settings::Method;
use crate::error::{FemError, StopReason};

/// Iterations that take as long as a factorisation, by its multiply-adds over its entries `x`:
/// `x / (FACTOR_COST[0] + FACTOR_COST[1] x)`. Measured at x = 230 (4,000 nodes) with the metric carried
/// along: 23 on one thread, 12 to 20 on two; at 690 (20,000) 50 and 35.
const FACTOR_COST: [f64; 2] = [7.5, 0.0125];

/// Share of a factor's time that is spent before one is judged, as early iterations reveal little about
/// the rate. Chosen with the outcome of a factor at every iteration known, on 42 loads of a dome of
/// 4,000 nodes and 100 members of many solves. Of these loads 17 were decided anew: 19.1 iterations,
/// 27.5 evaluations and 1.1 further factors instead of 25.9, 38.3 and 0.9 with a share of 0.65 and a
/// rate that leaves trials out.
const WAIT: f64 = 0.45;

/// Iterations that a fresh metric still needs, for the decision to make one.
const AFTER_REFRESH: f64 = 7.0;

/// Share of the first residual below which deformations change too little for the metric to follow.
/// Measured on 100 loads of a dome of 4,000 nodes: 18.0 iterations each at 0, 0.001 and 0.01, 18.1 at
/// 0.1, 22.3 where the metric stays where it was made.
const SETTLED: f64 = 0.01;

/// What a minimisation aims at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Goal {
    /// Fraction of the load.
    pub(super) fraction: f64,
    /// Residual over load.
    pub(super) tolerance: f64,
    /// Iterations allowed.
    pub(super) max_iterations: usize,
}

/// How a minimisation ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ended {
    /// None where it converged.
    pub(super) stop: Option<StopReason>,
    /// Norm of the residual, mN.
    pub(super) residual: f64,
    /// Required norm, mN.
    pub(super) tolerance: f64,
    /// Iterations done.
    pub(super) iterations: usize,
}

/// Buffers of the iteration, kept between load steps and members.
#[derive(Debug)]
pub(super) struct Minimiser {
    memory: Memory,
    residual: Vec<f64>,
    next_residual: Vec<f64>,
    direction: Vec<f64>,
    scratch: Vec<f64>,
    trial: State,
    /// Residual (mN) before each iteration and the work that it took until then, in iterations.
    history: Vec<(f64, f64)>,
}

impl Minimiser {
    pub(super) fn new(n_nodes: usize, n_unknowns: usize) -> Self {
        Self {
            memory: Memory::default(),
            residual: vec![0.0; n_unknowns],
            next_residual: vec![0.0; n_unknowns],
            direction: vec![0.0; n_unknowns],
            scratch: vec![0.0; n_unknowns],
            trial: State::at_rest(n_nodes),
            history: Vec::new(),
        }
    }

    /// Descend from `state` (whose forces are evaluated) to equilibrium.
    ///
    /// # Errors
    ///
    /// [`FemError::Cancelled`], and [`FemError::TooLarge`] from a factor; everything else is an
    /// [`Ended`] with a reason.
    pub(super) fn run(
        &mut self,
        problem: &Problem,
        goal: Goal,
        state: &mut State,
        metric: &mut Metric,
        workspace: &mut Workspace,
    ) -> Result<Ended, FemError> {
        self.memory.clear();
        self.history.clear();
        problem.residual_into(state, goal.fraction, &mut self.residual);
        let mut fresh = false;
        let mut iterations = 0;
        loop {
            problem.check_cancel()?;
            let residual = norm(&self.residual);
            let tolerance = goal.tolerance * problem.load_norm(state, goal.fraction)
                + rounding_floor(problem, metric, state);
            let ended = |stop| Ended { stop, residual, tolerance, iterations };
            // Infinite where squares overflow, and then no measure of anything.
            if !(residual.is_finite() && tolerance.is_finite()) {
                return Ok(ended(Some(StopReason::Stalled)));
            }
            if residual <= tolerance {
                return Ok(ended(None));
            }
            if iterations >= goal.max_iterations {
                return Ok(ended(Some(StopReason::IterationsUsedUp)));
            }
            self.history.push((residual, workspace.report.work_of_iterations()));
            if iterations == 0 || residual > SETTLED * self.history[0].0 {
                metric.follow(problem, state, workspace);
            }
            if self.wants_refresh(problem, metric, tolerance, fresh) {
                metric.renew(problem, state, workspace)?;
                self.memory.clear();
                self.history.clear();
                self.history.push((residual, workspace.report.work_of_iterations()));
                fresh = true;
            }
            if self.advance(problem, goal, state, metric, workspace) {
                iterations += 1;
                workspace.report.iterations += 1;
                fresh = false;
            } else if !self.memory.is_empty() {
                // The memory may be misled by curvature that has gone; the bare metric descends.
                self.memory.clear();
            } else if problem.settings.method == Method::Auto && !fresh {
                metric.renew(problem, state, workspace)?;
                fresh = true;
            } else {
                return Ok(ended(Some(StopReason::Stalled)));
            }
        }
    }

    /// One iteration; false where no step along the direction is acceptable.
    fn advance(
        &mut self,
        problem: &Problem,
        goal: Goal,
        state: &mut State,
        metric: &Metric,
        workspace: &mut Workspace,
    ) -> bool {
        let apply = |rhs: &[f64], out: &mut [f64]| metric.apply_into(problem, rhs, out, workspace);
        self.memory.direction_into(&self.residual, &mut self.scratch, &mut self.direction, apply);
        let slope = dot(&self.residual, &self.direction);
        if slope.is_nan() || slope >= 0.0 {
            return false;
        }
        let search = Search {
            problem,
            fraction: goal.fraction,
            direction: &self.direction,
            potential: problem.potential(state, goal.fraction),
            slope,
            rounding: energy_rounding(problem, metric, state),
        };
        let found = search.run(state, &mut self.trial, &mut self.next_residual, workspace);
        let Some(alpha) = found else { return false };
        if problem.settings.method != Method::Newton {
            self.memory.push(alpha, &self.direction, &self.residual, &self.next_residual);
        }
        std::mem::swap(state, &mut self.trial);
        std::mem::swap(&mut self.residual, &mut self.next_residual);
        true
    }

    /// Whether the metric should be made anew at the current state.
    fn wants_refresh(
        &self,
        problem: &Problem,
        metric: &Metric,
        tolerance: f64,
        fresh: bool,
    ) -> bool {
        match problem.settings.method {
            Method::QuasiNewton => false,
            Method::Newton => !fresh,
            Method::Auto => !fresh && self.converges_slowly(problem, metric, tolerance),
        }
    }

    /// Whether a factor would pay for itself, judged once half of its time has been spent without, by
    /// the rate since then.
    fn converges_slowly(&self, problem: &Problem, metric: &Metric, tolerance: f64) -> bool {
        let cost = iterations_per_factor(problem);
        // A light metric falls short sooner than one of its own tangent.
        let lightness = metric.lightness(problem);
        let wait = (WAIT * cost / lightness.powi(2)).clamp(8.0, 18.0).round() as usize;
        let n = self.history.len();
        if n <= wait {
            return false;
        }
        let ((now, work), (before, work_before)) =
            (self.history[n - 1], self.history[n - 1 - wait]);
        let rate = (now / before).ln() / (work - work_before);
        let remaining = if rate < 0.0 { (tolerance / now).ln() / rate } else { f64::INFINITY };
        remaining > (cost + AFTER_REFRESH) * lightness
    }
}

/// Iterations that take as long as one factorisation.
pub(super) fn iterations_per_factor(problem: &Problem) -> f64 {
    let x = problem.body.pattern().fronts.factor_to_solve();
    x / (FACTOR_COST[0] + FACTOR_COST[1] * x)
}

/// Norm of the rounding errors of the internal forces, mN: each force is a sum of products of
/// stiffness and displacement, and carries the rounding of its largest terms.
fn rounding_floor(problem: &Problem, metric: &Metric, state: &State) -> f64 {
    16.0 * f64::EPSILON * largest_displacement(state) * metric.diagonal_norm(problem)
}

/// Rounding of the strain energy, µJ: a stiff body that turns as a whole has large terms that
/// cancel.
fn energy_rounding(problem: &Problem, metric: &Metric, state: &State) -> f64 {
    f64::EPSILON * largest_displacement(state).powi(2) * metric.diagonal_norm(problem)
}

fn largest_displacement(state: &State) -> f64 {
    state.displacement.iter().fold(0.0_f64, |m, v| m.max(v.abs()))
}
