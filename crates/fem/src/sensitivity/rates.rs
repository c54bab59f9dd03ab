//! Solutions with the tangent of an equilibrium, for any model.

use rayon::prelude::*;

use super::cause::Rates;
use super::factored::{Buffers, Factored};
use crate::error::FemError;
use crate::solve::{Method, Precision, Problem, SolveSettings, State, norm};

/// Residual over force up to which a displacement counts as an equilibrium; also about the relative
/// error of derivatives.
const EQUILIBRIUM: f64 = 1e-6;

/// Derivatives of an equilibrium by a cause.
#[derive(Debug, Clone, PartialEq)]
pub struct Derivative {
    /// Of the displacement, one row per node of the body, mm over the unit of the cause.
    pub displacement: Vec<[f64; 3]>,
    /// Of the reactions, one row a held node, mN over the unit of the cause.
    pub reactions: Vec<[f64; 3]>,
}

/// Settings of a factor that serves derivatives: exact in double precision, so that a solution
/// needs no refinement.
pub(super) fn exact(settings: &SolveSettings) -> SolveSettings {
    SolveSettings { method: Method::Newton, ..settings.clone() }
}

/// The exact tangent at an equilibrium, factored.
pub(super) struct Tangent<'a> {
    pub(super) problem: Problem<'a>,
    pub(super) state: &'a State,
    pub(super) factored: &'a Factored,
}

/// Factor the tangent at a state whose forces have been evaluated.
///
/// # Errors
///
/// [`FemError::NotInEquilibrium`], [`FemError::NotStable`], [`FemError::Cancelled`],
/// [`FemError::TooLarge`].
pub(super) fn factor(
    problem: &Problem,
    state: &State,
    precision: Precision,
) -> Result<Factored, FemError> {
    let mut residual = vec![0.0; problem.body.n_unknowns()];
    problem.residual_into(state, 1.0, &mut residual);
    let residual = norm(&residual);
    let factored = Factored::new(problem, state, precision).map_err(|error| match error {
        FemError::SingularStiffness { pivot, n_dofs } => FemError::NotStable { pivot, n_dofs },
        other => other,
    })?;
    // Inner forces of all nodes: also those that balance each other, as under springs or swelling.
    let stiffness = factored.factor.diagonal_norm(&problem.body.pattern().fronts);
    let size = state.displacement.iter().fold(0.0_f64, |m, u| m.max(u.abs()));
    let forces = norm(&state.force).max(norm(&problem.load.force)).max(problem.least_load);
    let limit = EQUILIBRIUM * forces + f64::EPSILON * stiffness * size;
    match residual <= limit {
        true => Ok(factored),
        false => Err(FemError::NotInEquilibrium { residual, limit }),
    }
}

impl Tangent<'_> {
    /// `−K_ff⁻¹ rhs_f` at free components of a vector `(3 n_nodes)`, with zeros at held ones.
    ///
    /// # Errors
    ///
    /// [`FemError::BadSetting`] where a single factor does not suffice.
    pub(super) fn solve(
        &self,
        rhs: &[f64],
        buffers: &mut Buffers,
        parallel: bool,
    ) -> Result<Vec<f64>, FemError> {
        let pattern = self.problem.body.pattern();
        let own: Vec<[f64; 1]> =
            pattern.unknown2flat.iter().map(|&flat| [-rhs[flat as usize]]).collect();
        let mut out = vec![[0.0]; own.len()];
        self.factored.solve_into(self.problem.body, &own, &mut out, buffers, parallel)?;
        let mut full = vec![0.0; rhs.len()];
        for ([x], &flat) in out.iter().zip(&pattern.unknown2flat) {
            full[flat as usize] = *x;
        }
        Ok(full)
    }

    /// `K` times a direction, right in rows of held nodes; in all rows where only held components
    /// move.
    pub(super) fn product(&self, direction: &[f64]) -> Result<Vec<f64>, FemError> {
        let n_dofs = self.problem.body.n_unknowns();
        let product = self.problem.product_at_supports(self.state, direction);
        product.ok_or(FemError::NotStable { pivot: 0, n_dofs })
    }

    /// Derivatives along the rates of a cause.
    pub(super) fn follow(
        &self,
        rates: &Rates,
        buffers: &mut Buffers,
        parallel: bool,
    ) -> Result<Derivative, FemError> {
        let mut rhs = rates.unbalanced.clone();
        if let Some(held) = &rates.held {
            for (sum, value) in rhs.iter_mut().zip(self.product(held)?) {
                *sum += value;
            }
        }
        let mut flat = self.solve(&rhs, buffers, parallel)?;
        if let Some(held) = &rates.held {
            for (sum, value) in flat.iter_mut().zip(held) {
                *sum += value;
            }
        }
        let mut unbalanced = self.product(&flat)?;
        for (sum, value) in unbalanced.iter_mut().zip(&rates.unbalanced) {
            *sum += value;
        }
        let displacement = flat.as_chunks::<3>().0.to_vec();
        let reactions = self.problem.body.reactions(&unbalanced);
        Ok(Derivative { displacement, reactions })
    }

    /// Apply a function to every item, in parallel where there are several.
    pub(super) fn each<I: Sync, R: Send>(
        &self,
        items: &[I],
        one: impl Fn(&I, &mut Buffers, bool) -> Result<R, FemError> + Sync,
    ) -> Result<Vec<R>, FemError> {
        if items.len() == 1 || !self.problem.parallel {
            let mut buffers = Buffers::default();
            return items.iter().map(|i| one(i, &mut buffers, self.problem.parallel)).collect();
        }
        let run = |buffers: &mut Buffers, item: &I| one(item, buffers, false);
        items.par_iter().map_init(Buffers::default, run).collect()
    }
}
