//! Relaxation of one part of the stress: Simo's recursion.
//!
//! Over a step of length `Δt`, with `S_e` linear in time,
//!
//! ```text
//! H_i ← e_i H_i + β_i (S_e,n+1 − S_e,n),     e_i = exp(−Δt/τ_i),  β_i = (1 − e_i) τ_i/Δt
//! S   = (1 − Σ g) S_e,n+1 + Σ g_i H_i  =  a S_e,n+1 + S_hist
//! a   = 1 − Σ g_i (1 − β_i),           S_hist = Σ g_i (e_i H_i,n − β_i S_e,n)
//! ```

use super::layout::NINE;
use super::tensor::ZERO;
use crate::material::Matrix3;

/// One term of a series: its share and its time, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Term {
    pub(super) share: f64,
    pub(super) tau: f64,
}

/// `e` and `β` of every term over one step.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Decay {
    /// Each term with its `e` and `β`.
    factors: Vec<(Term, f64, f64)>,
}

impl Decay {
    /// Over a step that takes no time.
    pub(super) fn new(terms: &[Term]) -> Self {
        Self { factors: terms.iter().map(|&term| (term, 1.0, 1.0)).collect() }
    }

    /// Go over to a step of another length, s.
    pub(super) fn set_step(&mut self, length: f64) {
        for (term, e, beta) in &mut self.factors {
            // From one exponential.
            let y = -(length / term.tau);
            let decayed = y.exp_m1();
            (*e, *beta) = (1.0 + decayed, if y == 0.0 { 1.0 } else { decayed / y });
        }
    }

    /// `a`: remaining share of an elastic stress that grows within the step.
    pub(super) fn instant(&self) -> f64 {
        let lost = |sum: f64, (term, _, beta): &(Term, f64, f64)| sum + term.share * (1.0 - beta);
        1.0 - self.factors.iter().fold(0.0, lost)
    }

    /// `S_hist`, kPa; `memory`: what is remembered, `S_e` and each `H_i`.
    pub(super) fn history(&self, memory: &[f64]) -> Matrix3 {
        let mut sum = ZERO;
        let (matrices, _) = memory.as_chunks::<NINE>();
        if let Some((elastic, terms)) = matrices.split_first() {
            for ((Term { share, .. }, e, beta), term) in self.factors.iter().zip(terms) {
                let (kept, lost) = (share * e, -share * beta);
                for (k, sum) in sum.as_flattened_mut().iter_mut().enumerate() {
                    *sum += kept * term[k];
                    *sum += lost * elastic[k];
                }
            }
        }
        sum
    }

    /// End the step at an elastic stress, kPa.
    pub(super) fn update(&self, memory: &mut [f64], elastic: &Matrix3) {
        let (matrices, _) = memory.as_chunks_mut::<NINE>();
        if let Some((before, terms)) = matrices.split_first_mut() {
            for ((_, e, beta), term) in self.factors.iter().zip(terms) {
                for (k, elastic) in elastic.as_flattened().iter().enumerate() {
                    term[k] = e * term[k] + beta * (elastic - before[k]);
                }
            }
            before.copy_from_slice(elastic.as_flattened());
        }
    }
}
