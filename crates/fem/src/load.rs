//! Loads: nodal forces, own weight, prescribed displacements. All are dead: they keep their
//! direction and size while the body deforms, so that the potential energy
//! `Π(u) = W(u) − fᵀ u` exists and equilibrium is a minimum of it.

use crate::body::Body;
use crate::check::{check_finite, check_length};
use crate::error::FemError;
use crate::springs::Springs;

/// The load on a body; the default is none.
///
/// Surface tractions become nodal forces by [`Body::traction_forces`].
///
/// # Examples
///
/// Own weight of water-like tissue, 1 g/cm³ under 9,810 mm/s², downwards:
///
/// ```
/// use tissuereg_fem::Load;
///
/// let weight = Load { body_force: [0.0, 0.0, -9.81e-3], ..Load::default() };
/// assert!(weight.nodal_forces.is_none());
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Load {
    /// Forces at nodes, mN: one row per node of the body, or one row a corner node. Rows of held
    /// nodes only change the reactions.
    pub nodal_forces: Option<Vec<[f64; 3]>>,
    /// Force per undeformed volume, mN/mm³, the same everywhere.
    pub body_force: [f64; 3],
    /// Where held nodes go, mm: one row a held node, in the order in which they were given. Axes
    /// that are not held are ignored. None leaves them where they are.
    pub prescribed: Option<Vec<[f64; 3]>>,
    /// Springs between facets of the surface and their undeformed place.
    pub springs: Vec<Springs>,
}

impl Load {
    /// Load of nodal forces alone, mN.
    pub fn from_forces(forces: Vec<[f64; 3]>) -> Self {
        Self { nodal_forces: Some(forces), ..Self::default() }
    }

    /// Load of prescribed displacements alone, mm, one row a held node.
    pub fn from_prescribed(prescribed: Vec<[f64; 3]>) -> Self {
        Self { prescribed: Some(prescribed), ..Self::default() }
    }
}

/// A load on the unknowns of a body: forces and displacements at every node, flat.
#[derive(Debug, Clone)]
pub(crate) struct NodalLoad {
    /// `(3 n_nodes)`, mN.
    pub(crate) force: Vec<f64>,
    /// `(3 n_nodes)`, mm; zero where free.
    pub(crate) prescribed: Vec<f64>,
    /// Whether any prescribed displacement differs from zero.
    pub(crate) moves_supports: bool,
}

impl NodalLoad {
    /// Check a load against a body and spread it over its nodes.
    ///
    /// # Errors
    ///
    /// [`FemError::WrongLength`], [`FemError::NonFinite`].
    pub(crate) fn new(body: &Body, load: &Load) -> Result<Self, FemError> {
        let mut force = vec![0.0; 3 * body.n_nodes()];
        if let Some(rows) = &load.nodal_forces {
            if rows.len() != body.n_nodes() && rows.len() != body.n_corner_nodes() {
                return Err(FemError::WrongLength {
                    what: "nodal forces (one row a node of the body, or one a corner node)",
                    expected: body.n_nodes(),
                    found: rows.len(),
                });
            }
            check_finite("nodal forces", rows)?;
            force[..3 * rows.len()].copy_from_slice(rows.as_flattened());
        }
        check_finite("body force", std::slice::from_ref(&load.body_force))?;
        if load.body_force != [0.0; 3] {
            for element in 0..body.geometry().n_elements() {
                for (node, weight) in body.geometry().volume_weights(element) {
                    for i in 0..3 {
                        force[3 * node + i] += weight * load.body_force[i];
                    }
                }
            }
        }
        let prescribed = match &load.prescribed {
            None => vec![0.0; 3 * body.n_nodes()],
            Some(rows) => {
                check_length(
                    "prescribed displacements (one row a held node)",
                    body.held_nodes().len(),
                    rows.len(),
                )?;
                check_finite("prescribed displacements", rows)?;
                body.held_displacement(rows)
            }
        };
        let moves_supports = prescribed.iter().any(|&v| v != 0.0);
        Ok(Self { force, prescribed, moves_supports })
    }
}
