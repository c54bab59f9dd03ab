//! Derivatives of displacements by forces alone, for many observations at once.

use std::borrow::Borrow;
use std::sync::atomic::Ordering;

use rayon::prelude::*;

use super::adjoint::Observation;
use super::cause::Cause;
use super::held::HeldRows;
use super::linearised::Linearised;
use super::rates::Tangent;
use super::wide::{Columns, Solutions};
use crate::body::Body;
use crate::check::check_finite;
use crate::error::FemError;

/// Derivatives of observations of displacements by forces and supports.
#[derive(Debug, Clone, PartialEq)]
pub struct Compliance {
    /// By the force at every node, per mN: one row per node of the body, observation after observation
    /// (`n_obs * n_nodes`); zero at held components.
    pub nodal_forces: Vec<[f64; 3]>,
    /// By the body force, per mN/mm³, one row an observation.
    pub body_force: Vec<[f64; 3]>,
    /// By the prescribed displacement of every held node, per mm: one row a held node, observation
    /// after observation (`n_obs * n_held`); zero along axes that are free.
    pub prescribed: Vec<[f64; 3]>,
}

impl<B: Borrow<Body> + Send + Sync> Linearised<B> {
    /// Derivatives of observations of displacements by forces and supports, without the further
    /// ones of [`Linearised::adjoints`].
    ///
    /// The bits of an observation depend neither on the others nor on the number of threads. With a
    /// double factor they are those of the adjoint up to rounding, with a single one to 1e-9.
    ///
    /// # Errors
    ///
    /// [`FemError::BadObservation`], also for one that weighs reactions; [`FemError::NonFinite`];
    /// [`FemError::Cancelled`].
    ///
    /// # Cost
    ///
    /// One solution an observation, eight (in single precision sixteen and twice) for one reading of the
    /// factor; one pass over the elements at held nodes.
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::{Body, Element, Linearised, Load, Material, Mesh, Observation};
    /// use tissuereg_fem::SolveSettings;
    ///
    /// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    /// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
    /// let material = Material::neo_hookean(10.0, 0.3)?;
    /// let settings = SolveSettings::default();
    /// let rest = [[0.0; 3]; 4];
    /// let here = Linearised::new(&body, &material, &Load::default(), &rest, &settings)?;
    /// let tip = Observation::of_displacement([(3, [0.0, 0.0, 1.0])]);
    /// let compliance = here.compliance(&[tip])?;
    /// assert!(compliance.nodal_forces[3][2] > 0.0, "a pulled tip moves along");
    /// let follows: f64 = compliance.prescribed.iter().map(|row| row[2]).sum();
    /// assert!((follows - 1.0).abs() < 1e-12, "it rises as its base does");
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn compliance(&self, observations: &[Observation]) -> Result<Compliance, FemError> {
        let body = self.body.borrow();
        let columns =
            observations.iter().map(|one| components(one, body)).collect::<Result<Vec<_>, _>>()?;
        let n = columns.len();
        let held = self.held_rows()?;
        let tangent = self.tangent();
        let Solutions { at_nodes, at_held, corrections } = self
            .settings
            .in_pool(|| tangent.solve_columns(n, &Columns::Sparse(&columns), Some(held)))?;
        self.count(n, corrections);
        let weights = body.volume_weights();
        let body_force = at_nodes.chunks_exact(body.n_nodes()).map(|rows| {
            let mut sum = [0.0; 3];
            for (row, weight) in rows.iter().zip(&weights) {
                (0..3).for_each(|i| sum[i] += weight * row[i]);
            }
            sum
        });
        let body_force = body_force.collect();
        let prescribed = prescribed(body, &columns, held, at_held);
        Ok(Compliance { nodal_forces: at_nodes, body_force, prescribed })
    }

    /// Linear responses of the displacement to many fields of nodal forces: `K⁻¹ f`.
    ///
    /// # Shapes
    ///
    /// `forces` one row per node of the body, mN, field after field (`n_fields * n_nodes`); the result
    /// likewise, mm, zero at held components.
    ///
    /// # Errors
    ///
    /// [`FemError::WrongLength`] where the rows are no multiple of the nodes, [`FemError::NonFinite`],
    /// [`FemError::Cancelled`].
    ///
    /// # Cost
    ///
    /// As [`Linearised::compliance`].
    pub fn responses(&self, forces: &[[f64; 3]]) -> Result<Vec<[f64; 3]>, FemError> {
        let n_nodes = self.body.borrow().n_nodes();
        let n = forces.len().div_ceil(n_nodes);
        if forces.len() != n * n_nodes {
            return Err(FemError::WrongLength {
                what: "forces (one row a node of the body, field after field)",
                expected: n * n_nodes,
                found: forces.len(),
            });
        }
        check_finite("forces", forces)?;
        let tangent = self.tangent();
        let found =
            self.settings.in_pool(|| tangent.solve_columns(n, &Columns::Dense(forces), None))?;
        self.count(n, found.corrections);
        Ok(found.at_nodes)
    }

    /// Unbalanced forces of each cause at fixed displacement: the derivative of `f_int − f_ext` by it.
    ///
    /// The derivative of an observation of displacements of free nodes by a cause is
    /// `−Σ nodal_forces · unbalanced` with its [`Compliance`]: many causes cost one product of matrices.
    /// A cause that moves supports leaves the forces of moving them alone.
    ///
    /// # Shapes
    ///
    /// One row per node of the body, mN over the unit of the cause, cause after cause
    /// (`n_causes * n_nodes`).
    ///
    /// # Errors
    ///
    /// As [`Linearised::derivatives`].
    ///
    /// # Cost
    ///
    /// One pass over the elements a cause; that of the law once for all fields of one modulus.
    pub fn unbalanced(&self, causes: &[Cause]) -> Result<Vec<[f64; 3]>, FemError> {
        let n_nodes = self.body.borrow().n_nodes();
        let scene = self.scene();
        let shared = scene.shared_forces(causes)?;
        let one = |cause: &Cause| -> Result<Vec<f64>, FemError> {
            self.settings.check_cancel()?;
            let rates = scene.rates_with(cause, &shared)?;
            let mut unbalanced = rates.unbalanced;
            if let Some(held) = &rates.held {
                for (sum, value) in unbalanced.iter_mut().zip(self.tangent().product(held)?) {
                    *sum += value;
                }
            }
            Ok(unbalanced)
        };
        let columns: Vec<Vec<f64>> =
            self.settings.in_pool(|| match self.settings.is_parallel() {
                true => causes.par_iter().map(one).collect::<Result<_, _>>(),
                false => causes.iter().map(one).collect::<Result<_, _>>(),
            })?;
        let mut all = Vec::with_capacity(columns.len() * n_nodes);
        columns.iter().for_each(|column| all.extend_from_slice(column.as_chunks::<3>().0));
        Ok(all)
    }

    /// Rows of the tangent at held nodes, computed at first use.
    fn held_rows(&self) -> Result<&HeldRows, FemError> {
        let make = || {
            let Tangent { problem, state, .. } = self.tangent();
            HeldRows::new(&problem, state)
        };
        let n_dofs = self.body.borrow().n_unknowns();
        self.held_rows.get_or_init(make).as_ref().ok_or(FemError::NotStable { pivot: 0, n_dofs })
    }

    fn count(&self, right_hand_sides: usize, corrections: usize) {
        self.right_hand_sides.fetch_add(right_hand_sides, Ordering::Relaxed);
        self.corrections.fetch_add(corrections, Ordering::Relaxed);
    }
}

/// Weighed components of an observation of displacements.
fn components(observation: &Observation, body: &Body) -> Result<Vec<(usize, f64)>, FemError> {
    if let Some(&(node, _)) = observation.reactions.first() {
        let (what, why) = ("the reaction", "is none of displacements alone");
        return Err(FemError::BadObservation { what, node, why });
    }
    observation.check_displacement(body)?;
    let rows = observation.displacement.iter();
    Ok(rows.flat_map(|&(node, row)| (0..3).map(move |i| (3 * node + i, row[i]))).collect())
}

/// `w_u,c − K_cf x` as rows of held nodes.
fn prescribed(
    body: &Body,
    columns: &[Vec<(usize, f64)>],
    held: &HeldRows,
    mut at_held: Vec<[f64; 3]>,
) -> Vec<[f64; 3]> {
    at_held.iter_mut().flatten().for_each(|v| *v = -*v);
    let n_held = body.held_nodes().len();
    let mut own = vec![[0.0; 3]; body.n_nodes()];
    for (k, column) in columns.iter().enumerate() {
        if !column.iter().any(|&(flat, _)| body.held()[flat / 3][flat % 3]) {
            continue;
        }
        own.fill([0.0; 3]);
        column.iter().for_each(|&(flat, value)| own[flat / 3][flat % 3] += value);
        let rows = held.gathered(body, &own);
        for (sum, row) in at_held[k * n_held..(k + 1) * n_held].iter_mut().zip(rows) {
            (0..3).for_each(|i| sum[i] += row[i]);
        }
    }
    at_held
}
