//! Step length along a direction: keep every element upright and the potential energy falling.
//!
//! A trial is accepted where the energy falls enough (Armijo), or, once energies differ by no more
//! than their rounding, where the slope along the direction has shrunk (the approximate Wolfe
//! condition of Hager and Zhang, SIAM J. Optim. 16, 170, 2005). An inverted element halves the step.

use super::problem::{Problem, State, Workspace, dot};

/// Trials before a direction is abandoned.
const TRIALS: usize = 30;

/// Fraction of the energy predicted by the slope that must be gained.
const ARMIJO: f64 = 1e-4;

/// Share of the smallest det F that a step must keep. Energies rise slowly towards inversion and
/// stiffness fast: steps that end close to it lower the energy, and make the next ones tiny.
const KEPT: f64 = 0.2;

/// What a search along a direction needs to know.
pub(super) struct Search<'a> {
    pub(super) problem: &'a Problem<'a>,
    pub(super) fraction: f64,
    /// On the unknowns, mm.
    pub(super) direction: &'a [f64],
    /// Potential at the start, µJ.
    pub(super) potential: f64,
    /// Slope of the potential along the direction at the start, µJ; negative.
    pub(super) slope: f64,
    /// Rounding of the strain energy where large parts of it cancel, µJ.
    pub(super) rounding: f64,
}

impl Search<'_> {
    /// Find a step length; `trial` and `residual` then hold the new state. None where all trials
    /// fail.
    pub(super) fn run(
        &self,
        from: &State,
        trial: &mut State,
        residual: &mut [f64],
        workspace: &mut Workspace,
    ) -> Option<f64> {
        let work = dot(&self.problem.load.force, &from.displacement).abs() * self.fraction;
        let rounding = 1e-14 * (from.energy.total.abs() + work) + self.rounding;
        let mut alpha = 1.0;
        for _ in 0..TRIALS {
            self.step(from, alpha, trial);
            let upright = self.problem.evaluate(trial, workspace);
            if !upright || trial.energy.min_det_f < KEPT * from.energy.min_det_f.min(1.0) {
                alpha *= 0.5;
                continue;
            }
            self.problem.residual_into(trial, self.fraction, residual);
            let slope = dot(residual, self.direction);
            let potential = self.problem.potential(trial, self.fraction);
            let gained = potential <= self.potential + ARMIJO * alpha * self.slope;
            let flat = potential <= self.potential + rounding && slope <= -0.8 * self.slope;
            if gained || flat {
                return Some(alpha);
            }
            // Where the slope has turned, its zero by interpolation is the better guess.
            let secant = if slope > 0.0 { self.slope / (self.slope - slope) } else { 0.5 };
            alpha *= secant.clamp(0.1, 0.7);
        }
        None
    }

    fn step(&self, from: &State, alpha: f64, trial: &mut State) {
        trial.displacement.copy_from_slice(&from.displacement);
        for (&flat, d) in self.problem.body.pattern().unknown2flat.iter().zip(self.direction) {
            trial.displacement[flat as usize] += alpha * d;
        }
    }
}
