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
mod tets;

use rayon::prelude::*;
use tissuereg_fem::material::{Hyperelastic, NeoHookean};
use tissuereg_fem::{
    Body, Element, FemError, Material, Mesh, ScalarFactor, ScalarScratch, ScalarSystem, Stiffness,
};

use crate::check::{check_dt, check_finite, check_length};
use global::{Matrix, solve_into};
use local::{Local, Tet};
use tets::Tets;

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
/// use tissuereg_fem::{Mesh, Stiffness};
/// use tissuereg_paper::AdmmBody;
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
    tets: Tets,
    laws: Vec<NeoHookean>,
    kappa: Vec<f64>,
    /// kg/mm³
    density: f64,
    masses: Vec<f64>,
    held: Vec<usize>,
    system: ScalarSystem,
    /// With the length of step that it was made for.
    factor: Option<(f64, ScalarFactor)>,
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
    scratch: [ScalarScratch; 3],
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
        let held = held_by_node(held_nodes, mesh.n_nodes())?;
        if density == 0.0 {
            // Only to learn whether a part could move freely.
            Body::new(mesh.clone(), Element::Tet4, held_nodes)?;
        }
        let laws = laws_by_tet(stiffness, mesh.n_tets())?;
        let tets = Tets::new(mesh);
        let system = ScalarSystem::new(mesh, &held)?;
        let density = KG_PER_MM3 * density;
        let (n_nodes, n_free) = (mesh.n_nodes(), system.n_unknowns());
        let mut masses = vec![0.0; n_nodes];
        for (nodes, volume) in tets.nodes.iter().zip(&tets.volume) {
            for &node in nodes {
                masses[node as usize] += density * (0.25 * volume);
            }
        }
        let zeros = || std::array::from_fn(|_| vec![0.0; n_free]);
        let work = Work {
            tets: vec![Tet::default(); tets.len()],
            before: vec![[0.0; 3]; n_nodes],
            nodes: system.nodes().map(|node| node as u32).collect(),
            pulls: vec![[0.0; 3]; n_free],
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
            system,
            factor: None,
            parallel: true,
            displacement: vec![[0.0; 3]; n_nodes],
            velocity: vec![[0.0; 3]; n_nodes],
            tets,
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
        let found = self.iterate(dt, n_iterations, forces).and_then(|report| {
            check_finite("the displacement after the step", &self.displacement).map(|()| report)
        });
        if found.is_err() {
            self.displacement.copy_from_slice(&self.work.before);
            return found;
        }
        for (v, (u, before)) in
            self.velocity.iter_mut().zip(self.displacement.iter().zip(&self.work.before))
        {
            *v = std::array::from_fn(|i| (u[i] - before[i]) / dt);
        }
        found
    }

    /// Stored energy, µJ; infinite where a tetrahedron is inverted.
    pub fn elastic_energy(&self) -> f64 {
        let energy = |e: usize| {
            let h = self.tets.displacement_gradient(e, &self.displacement);
            self.laws[e].energy(&h).map_or(f64::INFINITY, |density| density * self.tets.volume[e])
        };
        (0..self.tets.len()).map(energy).sum()
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
        check_dt(dt)?;
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
            let Self { tets, density, kappa, .. } = &*self;
            let matrix = Matrix { tets, density: *density, kappa, dt };
            let factor = self.system.factor(|tet| matrix.entries(tet), self.parallel)?;
            self.factor = Some((dt, factor));
        }
        Ok(())
    }

    fn iterate(
        &mut self,
        dt: f64,
        n_iterations: usize,
        forces: Option<&[[f64; 3]]>,
    ) -> Result<AdmmReport, FemError> {
        let Self { tets, laws, kappa, masses, parallel, velocity, work, .. } = self;
        let parallel = *parallel;
        let Work { tets: kept, before, nodes, pulls, rhs, change, scratch } = work;
        kept.fill(Tet::default());
        let mut report = AdmmReport { iterations: 0, gap: 0.0, last_change: 0.0 };
        let Some((_, factor)) = &self.factor else { return Ok(report) };
        for _ in 0..n_iterations {
            let displacement = &self.displacement;
            let local = Local { tets, laws, kappa, displacement, parallel };
            local.step(kept);
            // `M (x̄ − x) + Δt² DᵀW² (z − u − D x)` of a node.
            let residual = |(&node, sum): (&u32, &mut [f64; 3])| {
                let node = node as usize;
                let pull = local.pull_at(kept, node);
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
            report.gap = local.gap(kept);
            solve_into(factor, rhs, change, scratch, parallel)?;
            report.last_change = 0.0;
            for (axis, own) in change.iter().enumerate() {
                for (&node, &d) in nodes.iter().zip(own) {
                    self.displacement[node as usize][axis] += d;
                    report.last_change = report.last_change.max(d.abs());
                }
            }
            report.iterations += 1;
        }
        Ok(report)
    }
}

/// Which nodes are held.
fn held_by_node(held_nodes: &[usize], n_nodes: usize) -> Result<Vec<bool>, FemError> {
    let mut held = vec![false; n_nodes];
    for &node in held_nodes {
        let Some(mark) = held.get_mut(node) else {
            return Err(FemError::HeldNodeOutOfRange { node, n_nodes });
        };
        if std::mem::replace(mark, true) {
            return Err(FemError::HeldNodeRepeated { node });
        }
    }
    Ok(held)
}

/// The law of every tetrahedron.
fn laws_by_tet(stiffness: &Stiffness, n_tets: usize) -> Result<Vec<NeoHookean>, FemError> {
    // Checks ranges and lengths.
    Material::new(stiffness.clone())?;
    let (young, poisson) = match stiffness {
        Stiffness::Uniform { young, poisson } => (vec![*young; n_tets], vec![*poisson; n_tets]),
        Stiffness::PerTet { young, poisson } | Stiffness::PerPoint { young, poisson, .. } => {
            check_length("Young's modulus (one entry a tetrahedron)", n_tets, young.len())?;
            let wide = if poisson.len() == 1 { n_tets } else { 1 };
            (young.clone(), poisson.repeat(wide))
        }
    };
    if let Some(&found) = poisson.iter().find(|&&poisson| poisson < 0.0) {
        // The energy of a negative `λ ln²J` has no least value where a tetrahedron is pressed flat.
        let must = "0 or more for this solver";
        return Err(FemError::BadParameter { name: "poisson", must, found });
    }
    Ok(young.iter().zip(&poisson).map(|(&e, &nu)| NeoHookean::from_young(e, nu)).collect())
}
