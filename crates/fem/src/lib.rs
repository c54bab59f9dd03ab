//! Static equilibrium of soft hyperelastic bodies on tetrahedral meshes.
#![forbid(unsafe_code)]

mod assembly;
mod body;
mod element;
mod ensemble;
mod error;
mod load;
pub mod material;
mod mesh;
mod solve;
mod supports;
mod system;

pub use body::Body;
pub use element::Element;
pub use ensemble::{Member, Outcome, solve_many};
pub use error::{FemError, NoEquilibrium, StopReason, WorstTet};
pub use load::Load;
pub use material::{Material, Stiffness};
pub use mesh::{DEGENERATE_LIMIT, Mesh};
pub use solve::{
    LoadSteps, Method, Solution, SolveReport, SolveSettings, StageSeconds, solve, solve_from,
};
pub use supports::Supports;
pub use system::RigidModes;
