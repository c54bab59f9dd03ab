//! A configuration of all that is discrete, its covariance and its evidence.

use faer::Mat;

use crate::Problem;
use crate::linalg::{add_scaled_lower, cholesky_in_place, forward};

/// A filled slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Contact {
    /// Patch of the dictionary.
    pub patch: usize,
    /// Entry of [`Prior::variances`](crate::Prior::variances).
    pub size: usize,
}

/// One configuration: what fills the slots, at which level each family is, which groups are wrong.
#[derive(Debug, Clone, PartialEq)]
pub struct Configuration {
    /// One entry per slot.
    pub slots: Vec<Option<Contact>>,
    /// Level of each family.
    pub levels: Vec<usize>,
    /// Whether each group of observations is wrong.
    pub wrong: Vec<bool>,
}

impl Configuration {
    /// Empty slots, every family at its most probable level, nothing wrong.
    pub fn empty(problem: &Problem) -> Self {
        let likeliest = |log_prior: &[f64]| {
            let best = log_prior.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
            best.map_or(0, |(level, _)| level)
        };
        Self {
            slots: vec![None; problem.prior.n_slots],
            levels: problem.prior.families.iter().map(|f| likeliest(&f.log_prior)).collect(),
            wrong: vec![false; problem.prior.wrong.rows.len()],
        }
    }

    /// Logarithm of the prior probability of one slot's content.
    pub(crate) fn log_prior_of_slot(problem: &Problem, slot: Option<Contact>) -> f64 {
        match slot {
            None => problem.prior.log_empty,
            Some(c) => problem.prior.log_filled[c.patch * problem.prior.variances.len() + c.size],
        }
    }

    /// Logarithm of the prior probability of all slots, levels and groups.
    pub(crate) fn log_prior(&self, problem: &Problem) -> f64 {
        let slots: f64 =
            self.slots.iter().map(|&slot| Self::log_prior_of_slot(problem, slot)).sum();
        let families = problem.prior.families.iter().zip(&self.levels);
        let levels: f64 = families.map(|(family, &level)| family.log_prior[level]).sum();
        let wrong = self.wrong.iter().filter(|&&w| w).count() as f64;
        slots + levels + wrong * problem.prior.wrong.log_odds
    }

    /// Lower half of the covariance (`n_obs`, `n_obs`) of the observations; `without` leaves one slot out.
    pub(crate) fn covariance(&self, problem: &Problem, without: Option<usize>) -> Mat<f64> {
        let mut sum = problem.observed.noise.clone();
        let families = problem.families.iter().zip(&problem.prior.families);
        for ((covariance, family), &level) in families.zip(&self.levels) {
            add_scaled_lower(&mut sum, covariance.as_ref(), family.factors[level]);
        }
        for (rows, _) in problem.prior.wrong.rows.iter().zip(&self.wrong).filter(|(_, w)| **w) {
            rows.iter().for_each(|&row| sum[(row, row)] += problem.prior.wrong.variance);
        }
        for (index, slot) in self.slots.iter().enumerate() {
            if let Some(contact) = slot.filter(|_| Some(index) != without) {
                let variance = problem.prior.variances[contact.size];
                add_scaled_lower(&mut sum, problem.dictionary.covariance(contact.patch), variance);
            }
        }
        sum
    }
}

/// A factored covariance with the logarithm of the evidence, up to a constant.
#[derive(Debug, Clone)]
pub(crate) struct Evidence {
    /// Cholesky factor, in the lower half.
    pub(crate) factor: Mat<f64>,
    /// `L^-1 innovation`.
    pub(crate) white: Vec<f64>,
    /// `-1/2 log|C| - 1/2 d' C^-1 d`.
    pub(crate) value: f64,
}

impl Evidence {
    /// From the lower half of a covariance; the first bad pivot where it is not positive definite in floating point.
    pub(crate) fn of(problem: &Problem, mut covariance: Mat<f64>) -> Result<Self, usize> {
        cholesky_in_place(covariance.as_mut())?;
        let white = forward(covariance.as_ref(), &problem.observed.innovation);
        let half_log: f64 = (0..white.len()).map(|i| covariance[(i, i)].ln()).sum();
        let value = -half_log - 0.5 * white.iter().map(|x| x * x).sum::<f64>();
        if value.is_finite() {
            return Ok(Self { factor: covariance, white, value });
        }
        Err(white.iter().position(|x| !x.is_finite()).unwrap_or(0))
    }

    pub(crate) fn of_state(problem: &Problem, state: &Configuration) -> Result<Self, usize> {
        Self::of(problem, state.covariance(problem, None))
    }
}
