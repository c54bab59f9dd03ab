//! Observations, and their derivatives by everything at once.

use std::collections::BTreeMap;

use crate::body::Body;
use crate::error::FemError;

/// A scalar observation of an equilibrium: weights times displacements and reactions.
///
/// A coordinate of a marker is the weights of the nodes of its triangle; the force of a pad along
/// an axis is 1 at all of its nodes.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::Observation;
///
/// // The x displacement of a marker in the middle of a triangle.
/// let marker = Observation::of_displacement([4, 5, 7].map(|node| (node, [1.0 / 3.0, 0.0, 0.0])));
/// assert_eq!(marker.displacement.len(), 3);
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observation {
    /// Nodes of the body with the weights of their displacement components; repeated nodes add up.
    pub displacement: Vec<(usize, [f64; 3])>,
    /// Held nodes (by node index) with the weights of their reaction components.
    pub reactions: Vec<(usize, [f64; 3])>,
}

impl Observation {
    /// Weights of displacements alone.
    pub fn of_displacement(weights: impl IntoIterator<Item = (usize, [f64; 3])>) -> Self {
        Self { displacement: weights.into_iter().collect(), reactions: Vec::new() }
    }

    /// Weights of reactions alone.
    pub fn of_reactions(weights: impl IntoIterator<Item = (usize, [f64; 3])>) -> Self {
        Self { displacement: Vec::new(), reactions: weights.into_iter().collect() }
    }

    /// Check the nodes and weights of displacements.
    ///
    /// # Errors
    ///
    /// [`FemError::BadObservation`], [`FemError::NonFinite`].
    pub(crate) fn check_displacement(&self, body: &Body) -> Result<(), FemError> {
        for (row, &(node, values)) in self.displacement.iter().enumerate() {
            if node >= body.n_nodes() {
                let (what, why) = ("the displacement", "does not exist");
                return Err(FemError::BadObservation { what, node, why });
            }
            check("weights of displacements", row, values)?;
        }
        Ok(())
    }

    /// `w_u` and `w_r` at all nodes, flat.
    ///
    /// # Errors
    ///
    /// [`FemError::BadObservation`], [`FemError::NonFinite`].
    pub(crate) fn spread(&self, body: &Body) -> Result<(Vec<f64>, Vec<f64>), FemError> {
        self.check_displacement(body)?;
        let mut by_node = vec![0.0; 3 * body.n_nodes()];
        for &(node, values) in &self.displacement {
            (0..3).for_each(|i| by_node[3 * node + i] += values[i]);
        }
        let places: BTreeMap<usize, usize> =
            body.held_nodes().iter().enumerate().map(|(place, &node)| (node, place)).collect();
        let mut rows = vec![[0.0; 3]; places.len()];
        for (row, &(node, values)) in self.reactions.iter().enumerate() {
            let Some(&place) = places.get(&node) else {
                let (what, why) = ("the reaction", "is not held");
                return Err(FemError::BadObservation { what, node, why });
            };
            check("weights of reactions", row, values)?;
            (0..3).for_each(|i| rows[place][i] += values[i]);
        }
        // Reactions of held mid-edge nodes go to their ends by halves, so they weigh their mean.
        Ok((by_node, body.held_displacement(&rows)))
    }
}

fn check(what: &'static str, row: usize, values: [f64; 3]) -> Result<(), FemError> {
    match values.iter().all(|v| v.is_finite()) {
        true => Ok(()),
        false => Err(FemError::NonFinite { what, row, values }),
    }
}

/// Derivatives of one observation by everything.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjoint {
    /// By Young's modulus of every quadrature point (`n_tets * n_points`), per kPa. The derivative
    /// by a field is the weighted sum.
    pub young: Vec<f64>,
    /// By Poisson's ratio of every quadrature point.
    pub poisson: Vec<f64>,
    /// By the force at every node of the body, per mN.
    pub nodal_forces: Vec<[f64; 3]>,
    /// By the body force, per mN/mm³.
    pub body_force: [f64; 3],
    /// By the prescribed displacement of every held node, per mm; zero along axes that are free.
    pub prescribed: Vec<[f64; 3]>,
    /// By the stiffness of every set of springs along the normal and in the plane, per kPa/mm.
    pub springs: Vec<[f64; 2]>,
}
