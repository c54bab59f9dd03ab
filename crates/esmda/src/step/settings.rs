//! What a caller may choose about a step, and what is told of it.

use faer::Par;

/// How the matrix of a step is factored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Factorisation {
    /// Cholesky where the condition number allows it, else QR.
    Auto,
    /// Cholesky of `S S' + I` whatever its condition.
    Cholesky,
    /// QR of `[S'; I]`.
    Qr,
    /// Singular values of `S`.
    Svd,
}

/// On which side of `S` (`n_obs`, `n_members`) Cholesky and QR work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Side {
    /// The smaller one.
    Smaller,
    /// A matrix with a row an observation.
    Observations,
    /// A matrix with a row per member.
    Members,
}

/// What a caller may choose about a step; the answer depends on it by rounding only, on `par` not at all.
///
/// Further settings may come: start from the default and change what differs.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::{Factorisation, StepSettings, faer::Par};
///
/// let settings = StepSettings::default().with_par(Par::rayon(0)).with_factorisation(Factorisation::Qr);
/// assert_eq!(settings.condition_limit, 1e6);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct StepSettings {
    /// Threads: those of the current rayon pool, or none.
    pub par: Par,
    /// How to factor.
    pub factorisation: Factorisation,
    /// On which side.
    pub side: Side,
    /// Largest condition number that [`Factorisation::Auto`] leaves to Cholesky.
    pub condition_limit: f64,
    /// Largest absolute prediction taken for the work of a sane model, in the unit of the observations.
    pub largest: f64,
}

impl Default for StepSettings {
    fn default() -> Self {
        Self {
            par: Par::Seq,
            factorisation: Factorisation::Auto,
            side: Side::Smaller,
            condition_limit: 1e6,
            largest: 1e12,
        }
    }
}

impl StepSettings {
    /// The same on other threads: [`par`](Self::par).
    #[must_use]
    pub fn with_par(self, par: Par) -> Self {
        Self { par, ..self }
    }

    /// The same with another [`factorisation`](Self::factorisation).
    #[must_use]
    pub fn with_factorisation(self, factorisation: Factorisation) -> Self {
        Self { factorisation, ..self }
    }

    /// The same on another [`side`](Self::side).
    #[must_use]
    pub fn with_side(self, side: Side) -> Self {
        Self { side, ..self }
    }

    /// The same with another [`condition_limit`](Self::condition_limit).
    #[must_use]
    pub fn with_condition_limit(self, condition_limit: f64) -> Self {
        Self { condition_limit, ..self }
    }

    /// The same with another largest prediction: [`largest`](Self::largest).
    #[must_use]
    pub fn with_largest(self, largest: f64) -> Self {
        Self { largest, ..self }
    }
}

/// What was done to prepare a step.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct StepReport {
    /// The factorisation used; never [`Factorisation::Auto`].
    pub factorisation: Factorisation,
    /// The side worked on; [`Side::Smaller`] where singular values were used.
    pub side: Side,
    /// Upper bound on the condition number of the matrix solved with; `None` where it was not formed.
    pub condition_bound: Option<f64>,
    /// `log [N(d; mean Y, C_yy + alpha C_d) / N(0; 0, alpha C_d)]`, of a deterministic step only.
    ///
    /// Where the inverses of all `alpha` of a schedule sum to one, the sum over its steps plus `log N(0; 0, C_d)` is the
    /// log evidence of the observations, exactly so for a linear model and an ensemble with its prior's moments.
    pub log_evidence: Option<f64>,
}
