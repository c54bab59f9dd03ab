//! Projective dynamics by ADMM: a moving body with inertia, stepped by local and global steps.
//!
//! One step of implicit Euler minimises `|x − x̄|²_M / (2 Δt²) + Σ_e V_e ψ(D_e x)` over the places `x` of
//! the nodes, with `x̄ = x_t + Δt v_t + Δt² M⁻¹ f`. The alternating direction method of multipliers splits
//! the deformation gradients `z_e = D_e x` off and repeats
//!
//! ```text
//! local     p = D_e x + u_e;   z_e = argmin ψ(z) + κ/2 |z − p|²;   u_e ← p − z_e        every tetrahedron alone
//! global    (M + Δt² DᵀW²D) x = M x̄ + Δt² DᵀW² (z − u)                                  factored once
//! ```
//!
//! from `z = D x`, `u = 0`, with `w_e² = κ V_e` and `κ = λ + 2μ/3`. Then `v = (x − x_t) / Δt`. The global step is solved
//! for the change of `x`, so that held nodes need no terms of their own and small changes keep their digits.
//!
//! # Reference
//!
//! Overby, Brown, Li and Narain, *ADMM ⊇ Projective Dynamics*, IEEE Trans. Vis. Comput. Graph. 23, 2222, 2017.

mod global;
mod local;
mod prox;
mod svd;

use rayon::prelude::*;

use crate::element::{Element, Geometry};
use crate::error::FemError;
use crate::load::{check_finite, check_length};
use crate::material::{Hyperelastic, NeoHookean, Stiffness};
use crate::mesh::Mesh;
use crate::supports::Supports;
use crate::system::factor::Factor;
use crate::system::{SolveScratch, check_rigid_modes};
use global::{Matrix, Order};
use local::{Local, Tet, displacement_gradient};

/// Fewer nodes are not worth a task of their own.
const LEAST_NODES: usize = 256;

/// kg/mm³ in one g/cm³.
const KG_PER_MM3: f64 = 1e-6;

/// A neo-Hookean body of four-node tetrahedra that moves in time.
///
/// # Units
///
/// mm, s, mN, kPa; mass in kg (mN s²/mm); density in g/cm³.
///
/// # Cost
///
/// An iteration is one pass over the tetrahedra, each with a singular value decomposition of its own, and
/// three solutions with a scalar factor. The factor is made anew where `dt` changes. Nothing is
/// allocated between iterations, and the bits do not depend on the number of threads.
///
/// # Examples
///
/// A tetrahedron falls freely: after three steps of 10 ms it has the velocity `g t`.
///
/// ```
/// use tissuereg_fem::{AdmmBody, Mesh, Stiffness};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let mesh = Mesh::new(nodes, vec![[0, 1, 2, 3]])?;
/// let soft = Stiffness::Uniform { young: 10.0, poisson: 0.45 };
/// let mut body = AdmmBody::new(&mesh, &[], &soft, 1.0)?;
/// let weight: Vec<[f64; 3]> = body.masses().iter().map(|m| [0.0, 0.0, -9810.0 * m]).collect();
/// for _ in 0..3 {
///     body.step(0.01, 5, Some(&weight), None)?;
/// }
/// assert!((body.velocity()[0][2] + 9810.0 * 0.03).abs() < 1e-6);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
pub struct AdmmBody {
    geometry: Geometry,
    laws: Vec<NeoHookean>,
    kappa: Vec<f64>,
    /// kg/mm³
    density: f64,
    masses: Vec<f64>,
    held: Vec<usize>,
    order: Order,
    /// With the length of step that it was made for.
    factor: Option<(f64, Factor)>,
    parallel: bool,
    displacement: Vec<[f64; 3]>,
    velocity: Vec<[f64; 3]>,
    work: Work,
}

/// What iterations overwrite.
struct Work {
    tets: Vec<Tet>,
    /// Displacement at the start of the step.
    before: Vec<[f64; 3]>,
    /// Node of each unknown.
    nodes: Vec<u32>,
    /// Right-hand sides by unknown.
    pulls: Vec<[f64; 3]>,
    rhs: [Vec<f64>; 3],
    change: [Vec<f64>; 3],
    scratch: [SolveScratch; 3],
}

/// What a step did.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct AdmmReport {
    /// Iterations done.
    pub iterations: usize,
    /// Root mean square over the volume of what gradients of the nodes differ by from those of the
    /// local steps, dimensionless; 0 where ADMM has converged.
    pub gap: f64,
    /// Largest change of a coordinate in the last iteration, mm.
    pub last_change: f64,
}

impl AdmmBody {
    /// A body at rest.
    ///
    /// # Shapes
    ///
    /// `held_nodes` are held on all axes; there may be none. `density` in g/cm³; 0 leaves inertia out, so
    /// that a step seeks the equilibrium.
    ///
    /// # Errors
    ///
    /// [`FemError::HeldNodeOutOfRange`], [`FemError::HeldNodeRepeated`], [`FemError::BadYoung`],
    /// [`FemError::BadPoisson`], [`FemError::WrongLength`] for moduli that are neither uniform nor one a
    /// tetrahedron, [`FemError::BadParameter`] for a density or a Poisson's ratio that is negative,
    /// [`FemError::Unconstrained`] where there is no inertia and a part could move freely.
    pub fn new(
        mesh: &Mesh,
        held_nodes: &[usize],
        stiffness: &Stiffness,
        density: f64,
    ) -> Result<Self, FemError> {
        if !(density >= 0.0 && density.is_finite()) {
            let must = "0 or more, in g/cm^3";
            return Err(FemError::BadParameter { name: "density", must, found: density });
        }
        let axes = Supports::from(held_nodes).axes_by_node(mesh.n_nodes())?;
        if density == 0.0 {
            check_rigid_modes(mesh, &axes, &[])?;
        }
        let laws = laws_by_tet(stiffness, mesh.n_tets())?;
        let (geometry, points) = Geometry::new(mesh, Element::Tet4, &[]);
        let held: Vec<bool> = axes.iter().map(|axes| axes[0]).collect();
        let order = Order::new(&points, &geometry, &held)?;
        let density = KG_PER_MM3 * density;
        let mut masses = vec![0.0; points.len()];
        for element in 0..geometry.n_elements() {
            for (node, volume) in geometry.volume_weights(element) {
                masses[node] += density * volume;
            }
        }
        let zeros = || std::array::from_fn(|_| vec![0.0; order.n_free()]);
        let work = Work {
            tets: vec![Tet::default(); geometry.n_elements()],
            before: vec![[0.0; 3]; points.len()],
            nodes: order.nodes().map(|node| node as u32).collect(),
            pulls: vec![[0.0; 3]; order.n_free()],
            rhs: zeros(),
            change: zeros(),
            scratch: Default::default(),
        };
        Ok(Self {
            kappa: laws.iter().map(NeoHookean::bulk).collect(),
            laws,
            density,
            masses,
            held: held_nodes.to_vec(),
            order,
            factor: None,
            parallel: true,
            displacement: vec![[0.0; 3]; points.len()],
            velocity: vec![[0.0; 3]; points.len()],
            geometry,
            work,
        })
    }

    /// Whether steps use the threads of the current pool, which they do unless told otherwise; results do
    /// not depend on it.
    pub fn set_parallel(&mut self, parallel: bool) {
        self.parallel = parallel;
    }

    /// Number of nodes.
    pub fn n_nodes(&self) -> usize {
        self.displacement.len()
    }

    /// Held nodes as they were given.
    pub fn held_nodes(&self) -> &[usize] {
        &self.held
    }

    /// Mass of each node, a quarter of that of the tetrahedra around it, kg.
    pub fn masses(&self) -> &[f64] {
        &self.masses
    }

    /// Displacement of each node, mm.
    pub fn displacement(&self) -> &[[f64; 3]] {
        &self.displacement
    }

    /// Velocity of each node, mm/s.
    pub fn velocity(&self) -> &[[f64; 3]] {
        &self.velocity
    }

    /// Put the nodes elsewhere, in any shape: the next step begins there.
    ///
    /// # Shapes
    ///
    /// One row a node: displacement in mm, velocity in mm/s.
    ///
    /// # Errors
    ///
    /// [`FemError::WrongLength`], [`FemError::NonFinite`]; nothing is changed then.
    pub fn set_state(
        &mut self,
        displacement: &[[f64; 3]],
        velocity: &[[f64; 3]],
    ) -> Result<(), FemError> {
        let both = [("displacement", displacement), ("velocity", velocity)];
        for (what, rows) in both {
            check_length(what, self.n_nodes(), rows.len())?;
            check_finite(what, rows)?;
        }
        self.displacement.copy_from_slice(displacement);
        self.velocity.copy_from_slice(velocity);
        Ok(())
    }

    /// Move on by `dt` seconds.
    ///
    /// # Shapes
    ///
    /// `forces` one row a node, mN, constant during the step; `prescribed` where held nodes are at its end, one
    /// row a held node, mm; without it they stay where they are.
    ///
    /// # Errors
    ///
    /// [`FemError::BadSetting`] for a `dt` that is not above 0, [`FemError::WrongLength`],
    /// [`FemError::NonFinite`] for wrong input and for a motion beyond the largest number, and
    /// [`FemError::SingularStiffness`] and [`FemError::TooLarge`] from the factor. The state is that before
    /// the step then.
    pub fn step(
        &mut self,
        dt: f64,
        n_iterations: usize,
        forces: Option<&[[f64; 3]]>,
        prescribed: Option<&[[f64; 3]]>,
    ) -> Result<AdmmReport, FemError> {
        self.check(dt, forces, prescribed)?;
        self.factor_for(dt)?;
        self.work.before.copy_from_slice(&self.displacement);
        if let Some(rows) = prescribed {
            for (&node, row) in self.held.iter().zip(rows) {
                self.displacement[node] = *row;
            }
        }
        let report = self.iterate(dt, n_iterations, forces);
        if let Err(error) = check_finite("the displacement after the step", &self.displacement) {
            self.displacement.copy_from_slice(&self.work.before);
            return Err(error);
        }
        for (v, (u, before)) in
            self.velocity.iter_mut().zip(self.displacement.iter().zip(&self.work.before))
        {
            *v = std::array::from_fn(|i| (u[i] - before[i]) / dt);
        }
        Ok(report)
    }

    /// Stored energy, µJ; infinite where a tetrahedron is inverted.
    pub fn elastic_energy(&self) -> f64 {
        let energy = |e: usize| {
            let h = displacement_gradient(&self.geometry, e, &self.displacement);
            self.laws[e]
                .energy(&h)
                .map_or(f64::INFINITY, |density| density * self.geometry.volume[e])
        };
        (0..self.geometry.n_elements()).map(energy).sum()
    }

    /// Energy of motion, µJ.
    pub fn kinetic_energy(&self) -> f64 {
        let square = |v: &[f64; 3]| v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
        self.masses.iter().zip(&self.velocity).map(|(m, v)| 0.5 * m * square(v)).sum()
    }

    fn check(
        &self,
        dt: f64,
        forces: Option<&[[f64; 3]]>,
        prescribed: Option<&[[f64; 3]]>,
    ) -> Result<(), FemError> {
        if !(dt > 0.0 && dt.is_finite()) {
            let must = "above 0, in s";
            return Err(FemError::BadSetting { name: "dt", must, found: dt });
        }
        if let Some(rows) = forces {
            check_length("forces (one row a node)", self.n_nodes(), rows.len())?;
            check_finite("forces", rows)?;
        }
        if let Some(rows) = prescribed {
            let what = "prescribed displacements (one row a held node)";
            check_length(what, self.held.len(), rows.len())?;
            check_finite("prescribed displacements", rows)?;
        }
        Ok(())
    }

    fn factor_for(&mut self, dt: f64) -> Result<(), FemError> {
        if self.factor.as_ref().is_none_or(|(made_for, _)| *made_for != dt) {
            // The old one goes first.
            self.factor = None;
            let Self { geometry, density, kappa, .. } = self;
            let matrix = Matrix { geometry, density: *density, kappa, dt };
            self.factor = Some((dt, self.order.factor(&matrix, self.parallel)?));
        }
        Ok(())
    }

    fn iterate(&mut self, dt: f64, n_iterations: usize, forces: Option<&[[f64; 3]]>) -> AdmmReport {
        let Self { geometry, laws, kappa, masses, order, parallel, velocity, work, .. } = self;
        let parallel = *parallel;
        let Work { tets, before, nodes, pulls, rhs, change, scratch } = work;
        tets.fill(Tet::default());
        let mut report = AdmmReport { iterations: 0, gap: 0.0, last_change: 0.0 };
        let Some((_, factor)) = &self.factor else { return report };
        for _ in 0..n_iterations {
            let displacement = &self.displacement;
            let local = Local { geometry, laws, kappa, displacement, parallel };
            local.step(tets);
            // `M (x̄ − x) + Δt² DᵀW² (z − u − D x)` of a node.
            let residual = |(&node, sum): (&u32, &mut [f64; 3])| {
                let node = node as usize;
                let pull = local.pull_at(tets, node);
                let force = forces.map_or([0.0; 3], |rows| rows[node]);
                for i in 0..3 {
                    let inertial = before[node][i] - displacement[node][i] + dt * velocity[node][i];
                    sum[i] = masses[node] * inertial + dt * dt * (force[i] + pull[i]);
                }
            };
            if parallel {
                let both = nodes.par_iter().zip(pulls.par_iter_mut());
                both.with_min_len(LEAST_NODES).for_each(residual);
            } else {
                nodes.iter().zip(pulls.iter_mut()).for_each(residual);
            }
            for (axis, own) in rhs.iter_mut().enumerate() {
                own.iter_mut().zip(pulls.iter()).for_each(|(r, pull)| *r = pull[axis]);
            }
            report.gap = local.gap(tets);
            order.solve_into(factor, rhs, change, scratch, parallel);
            report.last_change = 0.0;
            for (axis, own) in change.iter().enumerate() {
                for (&node, &d) in nodes.iter().zip(own) {
                    self.displacement[node as usize][axis] += d;
                    report.last_change = report.last_change.max(d.abs());
                }
            }
            report.iterations += 1;
        }
        report
    }
}

/// Moduli of every tetrahedron.
fn laws_by_tet(stiffness: &Stiffness, n_tets: usize) -> Result<Vec<NeoHookean>, FemError> {
    let laws = stiffness.moduli()?;
    if let Some(&found) = stiffness.fields().1.iter().find(|&&poisson| poisson < 0.0) {
        // The energy of a negative `λ ln²J` has no least value where a tetrahedron is pressed flat.
        let must = "0 or more for this solver";
        return Err(FemError::BadParameter { name: "poisson", must, found });
    }
    match stiffness {
        Stiffness::Uniform { .. } => Ok(vec![laws[0]; n_tets]),
        Stiffness::PerTet { .. } | Stiffness::PerPoint { .. } => {
            check_length("Young's modulus (one entry a tetrahedron)", n_tets, laws.len())?;
            Ok(laws)
        }
    }
}
