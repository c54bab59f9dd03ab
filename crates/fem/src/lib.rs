//! Static equilibrium of soft hyperelastic bodies on tetrahedral meshes.
//!
//! A body is analysed once (checks, elimination order, symbolic factor); then any number of
//! materials and loads are solved on it, one by one or many in parallel.
//!
//! # Tour
//!
//! A [`Mesh`] is nodes and tetrahedra, checked. Here a bar of 30 x 10 x 10 mm, every cube of
//! 10 mm cut into six tetrahedra along its diagonal:
//!
//! ```
//! use tissuereg_fem::{Body, Element, Load, Material, Member, Mesh, SolveSettings};
//! use tissuereg_fem::{solve, solve_many};
//!
//! let mut nodes = Vec::new();
//! for x in 0..4 {
//!     for (y, z) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
//!         nodes.push([10.0 * f64::from(x), 10.0 * f64::from(y), 10.0 * f64::from(z)]);
//!     }
//! }
//! let mut tets = Vec::new();
//! for first in [0, 4, 8] {
//!     // Corners of a cube by x + 2 y + 4 z, and the six ways along its edges from 0 to 7.
//!     let corner = |c: usize| first + 4 * (c & 1) + (c >> 1);
//!     for [a, b] in [[1, 3], [3, 2], [2, 6], [6, 4], [4, 5], [5, 1]] {
//!         tets.push([0, a, b, 7].map(corner));
//!     }
//! }
//! let mesh = Mesh::new(nodes, tets)?;
//!
//! // A body knows its element type and which nodes are held; rigid modes left free are an error.
//! let body = Body::new(mesh, Element::Tet10, [0, 1, 2, 3])?;
//! assert_eq!((body.n_corner_nodes(), body.held_nodes().len()), (16, 4));
//!
//! // 10 kPa, nu 0.45, and the weight of 1 g/cm³.
//! let material = Material::neo_hookean(10.0, 0.45)?;
//! let weight = Load { body_force: [0.0, 0.0, -9.81e-3], ..Load::default() };
//! let answer = solve(&body, &material, &weight, &SolveSettings::default())?;
//!
//! // The wall carries the weight of 3,000 mm³, and the end has sunk by some millimetres.
//! let carried: f64 = answer.reactions.iter().map(|r| r[2]).sum();
//! assert!((carried - 29.43).abs() < 1e-6);
//! let sag = -answer.displacement[15][2];
//! assert!(sag > 5.0 && sag < 15.0, "{sag} mm");
//!
//! // Many members: one outcome each, in order; a failed one is an error value, not a panic.
//! let stiffer = Material::neo_hookean(20.0, 0.45)?;
//! let members = [&material, &stiffer].map(|material| Member { material, load: &weight, start: None });
//! let outcomes = solve_many(&body, &members, &SolveSettings::default());
//! let sags: Vec<f64> =
//!     outcomes.iter().filter_map(|o| o.solution()).map(|s| -s.displacement[15][2]).collect();
//! assert!(sags[1] < sags[0]);
//! assert!((sags[0] - sag).abs() < 1e-12, "the same bits alone and in a batch");
//! # Ok::<(), tissuereg_fem::FemError>(())
//! ```
//!
//! # Units
//!
//! mm, kPa, mN throughout: kPa · mm² = mN, energy is µJ, and nothing needs a factor. Density in
//! g/cm³ times 9,810 mm/s² times 10⁻⁶ is a body force in mN/mm³ (water: 9.81e-3).
//!
//! # Method
//!
//! Displacement elements ([`Element`]), among them linear tetrahedra with averaged volume ratios
//! for nearly incompressible bodies ([`Element::Tet4Averaged`]), hyperelastic laws with or without fibres
//! ([`material`]), dead loads. Equilibrium is the minimum of the potential energy;
//! it is sought by L-BFGS in the metric of the undeformed stiffness, whose Cholesky factor is made
//! in single precision: a multifrontal one, filled straight from the elements, on unknowns ordered
//! by nested dissection, with faer's dense kernels. A line search keeps every element upright. Slow convergence makes a factor of the current tangent, failure
//! makes load steps; [`Method`] and [`LoadSteps`] choose otherwise. Residuals are evaluated in
//! double precision, so the answer does not depend on any of this.
//!
//! # Through time
//!
//! [`History`] leads a body from one time frame to the next, with relaxation, rate, softening, set,
//! drainage and swelling ([`Behaviour`]) on any law; [`Rig`] bonds pads to it and releases them.
//! [`stress_history`] is a material test of the same: one point, no mesh.
//! [`Springs`] hold facets of its surface, and [`rest_shape`] finds the unloaded shape of a body that is
//! given in its shape under gravity.
//!
//! # Derivatives
//!
//! [`Linearised`] is an equilibrium with its exact tangent. It gives the derivatives of displacement
//! and reactions by a [`Cause`] (a parameter, a field of moduli, a load, springs) and, by one
//! adjoint solution, those of an [`Observation`] by the stiffness of every quadrature point.
//!
//! # Promises
//!
//! The same input gives the same bits at any number of threads and in any batch (on one machine).
//! No panic on any input; [`FemError`] states what must hold, what was found and where. No file, no
//! network, no random numbers.
//!
//! # Versions
//!
//! Errors, settings, reports and lists of choices may grow in a minor version: they are
//! `#[non_exhaustive]`. Settings are made from their default, plain inputs such as [`Load`] and
//! [`Behaviour`] end with `..Default::default()`. No type of another crate is part of the interface.
#![forbid(unsafe_code)]

mod assembly;
mod body;
mod check;
mod element;
mod ensemble;
mod error;
mod groups;
mod history;
mod load;
pub mod material;
mod memory;
mod mesh;
mod raster;
mod rest_shape;
mod resultant;
mod rigid;
mod rotation;
mod scalar;
mod sensitivity;
mod solve;
mod springs;
mod supports;
mod surface;
mod system;

pub use body::Body;
pub use element::Element;
pub use ensemble::{Member, Outcome, solve_many};
pub use error::{ErrorClass, FemError, NoEquilibrium, RigidModes, StopReason, WorstTet};
pub use history::{History, Pad, Rig, RigFrame};
pub use load::Load;
pub use material::{Material, Stiffness};
pub use memory::{
    Behaviour, Drainage, Part, Relaxation, Set, Softening, SofteningForm, Swelling, stress_history,
};
pub use mesh::{DEGENERATE_LIMIT, Mesh, tet_volumes};
pub use raster::{Slab, rasterise};
pub use rest_shape::{RestShape, rest_shape};
pub use resultant::{Resultant, resultant};
pub use rotation::closest_rotations;
pub use scalar::{ScalarFactor, ScalarScratch, ScalarSystem};
pub use sensitivity::{
    Adjoint, Cause, Compliance, Derivative, Linearised, Observation, TangentReport,
};
pub use solve::{
    LoadSteps, Method, Precision, Solution, SolveReport, SolveSettings, StageSeconds,
    internal_forces, is_stable, solve, solve_from, spring_forces,
};
pub use springs::{Friction, Springs};
pub use supports::Supports;
pub use system::FactorSize;

/// Runs the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
