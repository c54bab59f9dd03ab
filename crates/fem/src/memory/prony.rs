//! Relaxation of one part of the stress: Simo's recursion.
//!
//! Over a step of length `Δt`, with `S_e` linear in time,
//!
//! ```text
//! H_i ← e_i H_i + β_i (S_e,n+1 − S_e,n),     e_i = exp(−Δt/τ_i),  β_i = (1 − e_i) τ_i/Δt
//! S   = (1 − Σ g) S_e,n+1 + Σ g_i H_i  =  a S_e,n+1 + S_hist
//! a   = 1 − Σ g_i (1 − β_i),           S_hist = Σ g_i (e_i H_i,n − β_i S_e,n)
//! ```

use super::tensor::{ZERO, add_scaled};
use crate::material::Matrix3;

/// One term of a series: its share and its time, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Term {
    pub(super) share: f64,
    pub(super) tau: f64,
}

/// What a series remembers at one point.
#[derive(Debug, PartialEq)]
pub(super) struct Memory {
    /// Elastic second Piola–Kirchhoff stress at the end of the last step, kPa.
    pub(super) elastic: Matrix3,
    /// `H_i`, kPa.
    pub(super) terms: Vec<Matrix3>,
}

impl Memory {
    pub(super) fn new(n_terms: usize) -> Self {
        Self { elastic: ZERO, terms: vec![ZERO; n_terms] }
    }
}

impl Clone for Memory {
    fn clone(&self) -> Self {
        Self { elastic: self.elastic, terms: self.terms.clone() }
    }

    /// Without allocation where there are as many terms.
    fn clone_from(&mut self, source: &Self) {
        self.elastic = source.elastic;
        self.terms.clone_from(&source.terms);
    }
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

    /// `S_hist`, kPa.
    pub(super) fn history(&self, memory: &Memory) -> Matrix3 {
        let mut sum = ZERO;
        for ((Term { share, .. }, e, beta), term) in self.factors.iter().zip(&memory.terms) {
            add_scaled(&mut sum, share * e, term);
            add_scaled(&mut sum, -share * beta, &memory.elastic);
        }
        sum
    }

    /// End the step at an elastic stress, kPa.
    pub(super) fn update(&self, memory: &mut Memory, elastic: Matrix3) {
        for ((_, e, beta), term) in self.factors.iter().zip(&mut memory.terms) {
            for i in 0..3 {
                for j in 0..3 {
                    let change = elastic[i][j] - memory.elastic[i][j];
                    term[i][j] = e * term[i][j] + beta * change;
                }
            }
        }
        memory.elastic = elastic;
    }
}
