//! Relaxation of one part of the stress: Simo's recursion.
//!
//! Over a step of length `Δt`, with `S_e` linear in time,
//!
//! ```text
//! H_i ← e_i H_i + β_i (S_e,n+1 − S_e,n),     e_i = exp(−Δt/τ_i),  β_i = (1 − e_i) τ_i/Δt
//! S   = (1 − Σ g) S_e,n+1 + Σ g_i H_i  =  a S_e,n+1 + S_hist
//! a   = 1 − Σ g_i (1 − β_i),           S_hist = Σ g_i (e_i H_i,n − β_i S_e,n)
//! ```

use super::scalar::{Matrix, Scalar};
use super::tensor::{add_scaled, zero};
use crate::material::{phi1, phi2};

/// One term of a series: its share and its time, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Term<S> {
    pub(super) share: S,
    pub(super) tau: S,
}

/// What a series remembers at one point.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Memory<S> {
    /// Elastic second Piola–Kirchhoff stress at the end of the last step, kPa.
    pub(super) elastic: Matrix<S>,
    /// `H_i`, kPa.
    pub(super) terms: Vec<Matrix<S>>,
}

impl<S: Scalar> Memory<S> {
    pub(super) fn new(n_terms: usize) -> Self {
        Self { elastic: zero(), terms: vec![zero(); n_terms] }
    }
}

/// `e` and `β` of every term over one step.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Decay<S> {
    factors: Vec<(S, S, S)>,
}

impl<S: Scalar> Decay<S> {
    pub(super) fn new(terms: &[Term<S>], step: f64) -> Self {
        let factors = terms
            .iter()
            .map(|term| {
                let x = S::constant(step) / term.tau;
                let y = -x.value();
                let beta = x.apply(phi1(y), phi2(y) - phi1(y));
                (term.share, x.apply(y.exp(), -y.exp()), beta)
            })
            .collect();
        Self { factors }
    }

    /// `a`: remaining share of an elastic stress that grows within the step.
    pub(super) fn instant(&self) -> S {
        let one = S::constant(1.0);
        let lost = |sum: S, (share, _, beta): &(S, S, S)| sum + *share * (one - *beta);
        one - self.factors.iter().fold(S::constant(0.0), lost)
    }

    /// `S_hist`, kPa.
    pub(super) fn history(&self, memory: &Memory<S>) -> Matrix<S> {
        let mut sum = zero();
        for ((share, e, beta), term) in self.factors.iter().zip(&memory.terms) {
            add_scaled(&mut sum, *share * *e, term);
            add_scaled(&mut sum, -*share * *beta, &memory.elastic);
        }
        sum
    }

    /// End the step at an elastic stress, kPa.
    pub(super) fn update(&self, memory: &mut Memory<S>, elastic: Matrix<S>) {
        for ((_, e, beta), term) in self.factors.iter().zip(&mut memory.terms) {
            for i in 0..3 {
                for j in 0..3 {
                    let change = elastic[i][j] - memory.elastic[i][j];
                    term[i][j] = *e * term[i][j] + *beta * change;
                }
            }
        }
        memory.elastic = elastic;
    }
}

impl Decay<f64> {
    /// The same numbers, as constants of another kind.
    pub(super) fn lifted<S: Scalar>(&self) -> Decay<S> {
        let one = S::constant;
        Decay { factors: self.factors.iter().map(|&(g, e, b)| (one(g), one(e), one(b))).collect() }
    }
}
