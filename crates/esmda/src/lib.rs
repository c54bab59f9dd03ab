//! Ensemble smoother with multiple data assimilation (ES-MDA), one step at a time.
//!
//! An ensemble of parameters, one column a member, is drawn towards observations through what each member predicts for
//! them. No gradient of the model is needed, and the remaining spread measures how well the parameters are known. The
//! model stays with the caller: run it, hand over the predictions, apply the step, repeat.
//!
//! # A tour
//!
//! One parameter with the prior N(0, 1), observed directly as 3 with noise of standard deviation 1. The posterior is
//! known: mean 3/2, variance 1/2. Three members can carry the prior exactly:
//!
//! ```
//! use tissuereg_esmda::faer::{Mat, mat};
//! use tissuereg_esmda::{NoiseCovariance, Schedule, Step, StepSettings, screen_members};
//!
//! let prior = mat![[-1.0, 0.0, 1.0]]; // (n_parameters, n_members): mean 0, variance 1
//! let observed = [3.0];
//! let noise = NoiseCovariance::diagonal(&[1.0])?;
//! let settings = StepSettings::default();
//!
//! let mean = |x: &Mat<f64>| x.row(0).iter().sum::<f64>() / 3.0;
//! let variance = |x: &Mat<f64>| x.row(0).iter().map(|v| (v - mean(x)).powi(2)).sum::<f64>() / 2.0;
//!
//! // The same data assimilated in four steps, each with its noise inflated so that they add up to the data once.
//! let schedule = Schedule::geometric(4, 2.0)?;
//! let mut members = prior.clone();
//! for &alpha in schedule.alphas() {
//!     let predicted = members.clone(); // the model: here, the parameter itself
//!     screen_members(predicted.as_ref(), 1e6).at_least(3)?; // failed runs would be dropped here
//!     let step = Step::prepare_square_root(predicted.as_ref(), &observed, &noise, alpha, &settings)?;
//!     step.apply(members.as_mut())?;
//! }
//! assert!((mean(&members) - 1.5).abs() < 1e-14);
//! assert!((variance(&members) - 0.5).abs() < 1e-14);
//!
//! // The stochastic form draws every member to an observation of its own. The draws are an argument: the same draws
//! // give the same bits. These three have mean 0, variance 1 and no correlation with the prior, so the answer is exact
//! // again; with random ones it is exact in the limit of many members.
//! let third = 1.0 / 3.0_f64.sqrt();
//! let draws = mat![[third, -2.0 * third, third]];
//! let mut members = prior.clone();
//! let step = Step::prepare(prior.as_ref(), &observed, &noise, 1.0, draws.as_ref(), &settings)?;
//! step.apply(members.as_mut())?;
//! assert!((mean(&members) - 1.5).abs() < 1e-14);
//! assert!((variance(&members) - 0.5).abs() < 1e-14);
//! # Ok::<(), tissuereg_esmda::EsmdaError>(())
//! ```
//!
//! # What is where
//!
//! * [`step`]: the update and its formula; [`Step::prepare`] returns what has [`Step::apply`].
//! * [`schedule`]: inflation coefficients, checked: `sum 1 / alpha = 1`.
//! * [`noise`]: `C_d`, diagonal or dense, factored once.
//! * [`screening`]: failed members, dropped with their reason.
//! * [`gauss_newton`]: beside the ensemble, the most probable parameters and the Gaussian about them.
//! * [`mixture`]: which Gaussian of a mixture the observations came from.
//! * [`outliers`]: groups of observations that contradict the others after the fit.
//!
//! # Conventions
//!
//! A row is a parameter or an observation, a column a member. Observations, predictions and noise share one unit, any;
//! parameters may have one each. All is `f64`. Bits depend on the input alone: there is no randomness in here, and
//! threads ([`StepSettings::par`]) never change the order of a sum.
//!
//! # Versions
//!
//! Matrices are those of [`faer`], re-exported here, so that no version of it need be guessed. Errors, settings, reports and
//! lists of choices may grow in a minor version: they are `#[non_exhaustive]`, and settings are made from their default.
#![forbid(unsafe_code)]

mod bordered;
mod check;
mod chi_square;
mod error;
pub mod gauss_newton;
mod gaussian;
mod linalg;
pub mod mixture;
pub mod noise;
pub mod outliers;
pub mod schedule;
pub mod screening;
pub mod step;

/// The linear algebra that this crate's arguments are made of, in the version that it takes.
pub use faer;

pub use error::{ErrorClass, EsmdaError, Reason};
pub use gauss_newton::{Evaluation, GaussNewton, Linearised, SearchSettings};
pub use gaussian::Gaussian;
pub use mixture::{ComponentScore, Groups, ScaledComponent, score_components};
pub use noise::NoiseCovariance;
pub use outliers::{GroupScore, score_groups, wrong_groups};
pub use schedule::Schedule;
pub use screening::{Screening, screen_members};
pub use step::{Factorisation, Side, Step, StepReport, StepSettings};

/// The README's code runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadMe;
