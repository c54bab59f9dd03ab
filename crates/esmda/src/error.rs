//! What can go wrong, with the numbers and the place.

use std::fmt;

/// Why a member was dropped; `obs` is the first observation that shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Reason {
    /// A prediction is not a number.
    NotANumber {
        /// Observation.
        obs: usize,
    },
    /// A prediction is infinite.
    Infinite {
        /// Observation.
        obs: usize,
    },
    /// A prediction is finite and absurd.
    TooLarge {
        /// Observation.
        obs: usize,
        /// The prediction.
        value: f64,
        /// Largest absolute value allowed.
        limit: f64,
    },
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotANumber { obs } => write!(f, "prediction {obs} is not a number"),
            Self::Infinite { obs } => write!(f, "prediction {obs} is infinite"),
            Self::TooLarge { obs, value, limit } => {
                write!(f, "prediction {obs} is {value:e}, beyond {limit:e}")
            }
        }
    }
}

/// Why a schedule, a noise covariance or a step was refused.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::{EsmdaError, Schedule};
///
/// let error = Schedule::from_alphas(&[4.0, 2.0, 1.0]).unwrap_err();
/// assert_eq!(error, EsmdaError::ScheduleSum { sum: 1.75, wanted: 1.0 });
/// assert!(!error.is_recoverable());
/// ```
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EsmdaError {
    /// A schedule without steps.
    #[error("a schedule must have at least one step, got none")]
    EmptySchedule,
    /// An inflation coefficient that is not a positive finite number.
    #[error("inflation coefficients must be positive and finite, got {alpha} at step {step}")]
    Alpha {
        /// Step, from zero.
        step: usize,
        /// The coefficient.
        alpha: f64,
    },
    /// The inverse coefficients do not sum to one (or to the requested total).
    #[error("the inverse inflation coefficients must add up to {wanted} within 1e-9, got {sum}")]
    ScheduleSum {
        /// Sum of the inverse coefficients.
        sum: f64,
        /// What it must be.
        wanted: f64,
    },
    /// The wanted decrease of a geometric schedule is not a positive finite number.
    #[error(
        "the decrease of a geometric schedule must be positive, finite and leave all {n_steps} \
         coefficients in range, got {decrease}"
    )]
    Decrease {
        /// Requested value.
        decrease: f64,
        /// Requested number of steps.
        n_steps: usize,
    },
    /// A step beyond the end of the schedule.
    #[error("step {step} was requested, but the schedule has {n_steps} steps (counted from 0)")]
    StepBeyondSchedule {
        /// Requested step, from zero.
        step: usize,
        /// Steps there are.
        n_steps: usize,
    },
    /// A standard deviation that is not a positive finite number.
    #[error(
        "noise standard deviations must be positive and finite, got {std} at observation {obs}"
    )]
    NoiseStd {
        /// Observation.
        obs: usize,
        /// The standard deviation.
        std: f64,
    },
    /// An entry of a noise covariance that is not finite.
    #[error("the noise covariance must be finite, got {value} at row {row}, column {column}")]
    NoiseNotFinite {
        /// Row.
        row: usize,
        /// Column.
        column: usize,
        /// The entry.
        value: f64,
    },
    /// A noise covariance that is not symmetric.
    #[error(
        "the noise covariance must be symmetric, got {value} at row {row}, column {column} and \
         {mirrored} across the diagonal"
    )]
    NoiseNotSymmetric {
        /// Row.
        row: usize,
        /// Column.
        column: usize,
        /// The entry.
        value: f64,
        /// The entry at (`column`, `row`).
        mirrored: f64,
    },
    /// A noise covariance without a Cholesky factor.
    #[error(
        "the noise covariance must be positive definite; its factorisation fails at pivot {pivot}"
    )]
    NoiseNotPositiveDefinite {
        /// Row of the failing pivot.
        pivot: usize,
    },
    /// A prior covariance that is not symmetric.
    #[error(
        "the prior covariance must be symmetric, got {value} at row {row}, column {column} and \
         {mirrored} across the diagonal"
    )]
    PriorNotSymmetric {
        /// Row.
        row: usize,
        /// Column.
        column: usize,
        /// The entry.
        value: f64,
        /// The entry at (`column`, `row`).
        mirrored: f64,
    },
    /// A prior covariance without a Cholesky factor.
    #[error(
        "the prior covariance must be positive definite; its factorisation fails at pivot {pivot}"
    )]
    PriorNotPositiveDefinite {
        /// Row of the failing pivot.
        pivot: usize,
    },
    /// A setting outside its range.
    #[error("`{name}` must be {rule}, got {value}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// What it must be.
        rule: &'static str,
        /// What was given.
        value: f64,
    },
    /// A call of a search before the one that it needs.
    #[error("`{call}` needs {needed} first")]
    OutOfOrder {
        /// The call.
        call: &'static str,
        /// What must come before it.
        needed: &'static str,
    },
    /// A direction in which no derivative can be had: the model fails on either side.
    #[error(
        "the model must predict on at least one side of the point for its derivative along prior \
         direction {direction}; it fails on both"
    )]
    NoDifference {
        /// Column of the prior's root.
        direction: usize,
    },
    /// A search that did not reach a minimum.
    #[error(
        "no minimum was found in {evaluations} evaluations: the next step is {step:e} posterior \
         standard deviations long where {tolerance:e} is wanted"
    )]
    NoMinimum {
        /// Points at which the model was evaluated.
        evaluations: usize,
        /// Length of the undamped step from the best point.
        step: f64,
        /// Length at which the search ends.
        tolerance: f64,
    },
    /// An array of the wrong shape.
    #[error("`{argument}` must have shape {wanted:?}, got {found:?}")]
    Shape {
        /// Name of the argument.
        argument: &'static str,
        /// Rows and columns wanted.
        wanted: (usize, usize),
        /// Rows and columns found.
        found: (usize, usize),
    },
    /// No observations at all.
    #[error("a step needs at least one observation, got none")]
    NoObservations,
    /// An entry that is not a finite number.
    #[error("`{argument}` must be finite, got {value} at row {row}, column {column}")]
    NotFinite {
        /// Name of the argument.
        argument: &'static str,
        /// Row (observation or parameter).
        row: usize,
        /// Column (member; zero for a vector).
        column: usize,
        /// The entry.
        value: f64,
    },
    /// A prediction that no working model makes.
    #[error(
        "`predicted` must stay within {limit:e} in absolute value, got {value:e} at observation \
         {row}, member {column}; drop failed members with `screen_members` first"
    )]
    TooLarge {
        /// Observation.
        row: usize,
        /// Member.
        column: usize,
        /// The prediction.
        value: f64,
        /// The largest absolute value allowed.
        limit: f64,
    },
    /// Predictions so far apart, in standard deviations of the noise, that a product overflows.
    #[error(
        "predictions or innovations over the noise's standard deviation leave the range of f64"
    )]
    Overflow,
    /// Fewer members than needed.
    #[error("at least {minimum} ensemble members must be left, got {kept}")]
    TooFewMembers {
        /// Members left.
        kept: usize,
        /// Members needed.
        minimum: usize,
        /// Members that were dropped, each with its reason.
        dropped: Vec<(usize, Reason)>,
    },
    /// The singular value decomposition did not converge.
    #[error("the singular values of {n_obs} x {n_members} whitened anomalies were not found")]
    NoConvergence {
        /// Rows.
        n_obs: usize,
        /// Columns.
        n_members: usize,
    },
}

impl EsmdaError {
    /// Whether the caller may continue with fewer members or observations: true for errors caused by the data of one
    /// update, false for settings that are wrong for any data.
    pub fn is_recoverable(&self) -> bool {
        match self {
            Self::NotFinite { .. }
            | Self::TooLarge { .. }
            | Self::Overflow
            | Self::NoDifference { .. }
            | Self::NoMinimum { .. }
            | Self::NoConvergence { .. } => true,
            Self::EmptySchedule
            | Self::Alpha { .. }
            | Self::ScheduleSum { .. }
            | Self::Decrease { .. }
            | Self::StepBeyondSchedule { .. }
            | Self::NoiseStd { .. }
            | Self::NoiseNotFinite { .. }
            | Self::NoiseNotSymmetric { .. }
            | Self::NoiseNotPositiveDefinite { .. }
            | Self::PriorNotSymmetric { .. }
            | Self::PriorNotPositiveDefinite { .. }
            | Self::Setting { .. }
            | Self::OutOfOrder { .. }
            | Self::Shape { .. }
            | Self::NoObservations
            | Self::TooFewMembers { .. } => false,
        }
    }

    /// Return what the error is about.
    pub fn class(&self) -> ErrorClass {
        match self {
            Self::EmptySchedule
            | Self::Alpha { .. }
            | Self::ScheduleSum { .. }
            | Self::Decrease { .. }
            | Self::StepBeyondSchedule { .. } => ErrorClass::Schedule,
            Self::NoiseStd { .. }
            | Self::NoiseNotFinite { .. }
            | Self::NoiseNotSymmetric { .. }
            | Self::NoiseNotPositiveDefinite { .. }
            | Self::Overflow
            | Self::NotFinite { argument: "noise", .. } => ErrorClass::Noise,
            Self::PriorNotSymmetric { .. }
            | Self::PriorNotPositiveDefinite { .. }
            | Self::Setting { .. }
            | Self::NotFinite {
                argument: "mean" | "covariance" | "start" | "residual" | "absorbed",
                ..
            } => ErrorClass::Argument,
            Self::OutOfOrder { .. } => ErrorClass::Order,
            Self::NoMinimum { .. } => ErrorClass::Convergence,
            Self::Shape { .. } | Self::NoObservations => ErrorClass::Shape,
            Self::NotFinite { argument: "observed", .. } => ErrorClass::Observed,
            Self::NotFinite { .. }
            | Self::NoDifference { .. }
            | Self::TooLarge { .. }
            | Self::TooFewMembers { .. }
            | Self::NoConvergence { .. } => ErrorClass::Ensemble,
        }
    }

    /// Return where the error is, in words such as "step 2" or "predicted, member 5"; none where it concerns
    /// the whole input.
    pub fn place(&self) -> Option<String> {
        Some(match self {
            Self::Alpha { step, .. } | Self::StepBeyondSchedule { step, .. } => {
                format!("step {step}")
            }
            Self::Decrease { .. } => "decrease".to_owned(),
            Self::NoiseStd { obs, .. } => format!("observation {obs}"),
            Self::NoiseNotFinite { row, column, .. }
            | Self::NoiseNotSymmetric { row, column, .. }
            | Self::PriorNotSymmetric { row, column, .. } => format!("row {row}, column {column}"),
            Self::NoiseNotPositiveDefinite { pivot } | Self::PriorNotPositiveDefinite { pivot } => {
                format!("pivot {pivot}")
            }
            Self::Setting { name, .. } => (*name).to_owned(),
            Self::OutOfOrder { call, .. } => (*call).to_owned(),
            Self::NoDifference { direction } => format!("prior direction {direction}"),
            Self::Shape { argument, .. } => (*argument).to_owned(),
            Self::NoObservations => "predicted".to_owned(),
            Self::NotFinite { argument, row, column, .. } => match self.class() {
                ErrorClass::Observed => format!("{argument}, row {row}"),
                ErrorClass::Ensemble => format!("{argument}, member {column}"),
                _ => format!("{argument}, row {row}, column {column}"),
            },
            Self::TooLarge { column, .. } => format!("predicted, member {column}"),
            Self::EmptySchedule
            | Self::ScheduleSum { .. }
            | Self::NoMinimum { .. }
            | Self::Overflow
            | Self::TooFewMembers { .. }
            | Self::NoConvergence { .. } => return None,
        })
    }
}

/// What an error is about. The list is complete: every [`EsmdaError`] has one of these.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorClass {
    /// Inflation coefficients.
    Schedule,
    /// The covariance of the noise, or numbers over it.
    Noise,
    /// The prior, a setting or another argument.
    Argument,
    /// A call before the one that it needs.
    Order,
    /// A search that did not reach a minimum.
    Convergence,
    /// The shape of an array.
    Shape,
    /// What was observed.
    Observed,
    /// Members, their predictions or parameters.
    Ensemble,
}
