//! Ensemble smoother with multiple data assimilation, one step at a time.
#![forbid(unsafe_code)]

mod error;
mod linalg;
pub mod noise;
pub mod schedule;
pub mod screening;
pub mod step;

pub use error::EsmdaError;
pub use noise::NoiseCovariance;
pub use schedule::Schedule;
pub use screening::{Reason, Screening, screen_members};
pub use step::{Factorisation, Side, Step, StepReport, StepSettings};
