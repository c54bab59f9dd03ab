//! Which few causes of a large dictionary explain the observations.
//!
//! Observations depend linearly on causes. Hundreds of patches of a surface may each be pushed, in any direction and by
//! any size, but few are: a few slots each hold one patch or none. There are also families of causes with one common
//! unknown size (a background, a body force), and groups of observations that may be wrong as a whole. Given the content
//! of the slots everything is Gaussian and known in closed form. The content is sampled by parallel Markov chains whose
//! jumps compare all patches at once ([`Problem::run`]). [`Problem::moments`] computes from the samples the means and
//! covariances of coefficients and of anything linear in them, [`Problem::draws`] random draws.
//!
//! The crate knows no meshes and no files and draws no random numbers: these are arguments, and the same input gives the
//! same bits at any number of threads.
//!
//! # Example
//!
//! Two patches, six observations; the second patch has been moved by 2 along its first direction:
//!
//! ```
//! use tissuereg_contacts::faer::{Mat, Par};
//! use tissuereg_contacts::{ChainSettings, Dictionary, Observed, Patch, Prior, Problem, Wrong};
//!
//! let dictionary = Dictionary::new(Mat::identity(6, 6), vec![Patch::default(); 2])?;
//! let prior = Prior {
//!     n_slots: 1,
//!     variances: vec![1.0, 4.0],
//!     log_empty: 0.5_f64.ln(),
//!     log_filled: vec![0.125_f64.ln(); 4],
//!     families: Vec::new(),
//!     wrong: Wrong { rows: Vec::new(), variance: 1.0, log_odds: 0.0 },
//! };
//! let observed = Observed {
//!     innovation: vec![0.0, 0.0, 0.0, 2.0, 0.0, 0.0],
//!     noise: Mat::from_fn(6, 6, |i, j| if i == j { 0.01 } else { 0.0 }),
//! };
//! let problem = Problem::new(dictionary, prior, observed)?;
//! let settings = ChainSettings::default();
//! // Any numbers in [0, 1) serve here; a caller draws them.
//! let uniforms = Mat::from_fn(4, problem.n_uniforms(&settings), |i, j| {
//!     (0.618_034 * (1 + i + 7 * j) as f64).fract()
//! });
//! let run = problem.run(&settings, uniforms.as_ref(), &[], Par::Seq)?;
//! assert!(run.samples.iter().all(|s| s.configuration.slots[0].is_some_and(|c| c.patch == 1)));
//! # Ok::<(), tissuereg_contacts::ContactsError>(())
//! ```
//!
//! # Versions
//!
//! Matrices are those of [`faer`], re-exported here, so that no version of it need be guessed. Errors, settings, reports and
//! lists of choices may grow in a minor version: they are `#[non_exhaustive]`, and settings are made from their default.
#![forbid(unsafe_code)]

mod chain;
mod dictionary;
mod elementary;
mod error;
mod gain;
mod linalg;
mod moments;
mod packed;
mod prior;
mod run;
mod settings;
mod state;
mod table;

/// The linear algebra that this crate's arguments are made of, in the version that it takes.
pub use faer;

pub use chain::Counters;
pub use dictionary::{Dictionary, Patch};
pub use error::{ContactsError, ErrorClass};
pub use moments::Moments;
pub use prior::{Family, Observed, Prior, Problem, Wrong};
pub use run::{Run, Sample};
pub use settings::ChainSettings;
pub use state::{Configuration, Contact};

/// The README's code runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadMe;
