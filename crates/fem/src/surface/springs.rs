//! Springs between facets of the surface and the place that these have undeformed.

use super::facet::Facet;
use crate::error::FemError;
use crate::history::must;

/// Springs on facets of the surface: a soft bed, or a base that slides with some resistance.
///
/// Energy `½ ∫ (k_n u_n² + k_t |u_t|²) dA` over the undeformed facets, `u_n` along their undeformed
/// normal. They pull as well as push.
///
/// # Examples
///
/// A tetrahedron that stands on springs alone and sinks by weight over stiffness:
///
/// ```
/// use tissuereg_fem::{Body, Element, Load, Material, Mesh, SolveSettings, Springs, Supports, solve};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let bed = Springs { triangles: vec![[0, 2, 1]], normal: 2.0, tangential: 1.0 };
/// let body = Body::new(
///     Mesh::new(nodes, vec![[0, 1, 2, 3]])?,
///     Element::Tet4,
///     Supports::new().rest_on(&bed),
/// )?;
/// let load = Load {
///     nodal_forces: Some(vec![[0.0, 0.0, -4.0]; 4]),
///     springs: vec![bed],
///     ..Load::default()
/// };
/// let answer = solve(&body, &Material::neo_hookean(1e4, 0.3)?, &load, &SolveSettings::default())?;
/// let pushed: f64 = answer.spring_forces[0].iter().map(|f| f[2]).sum();
/// assert!((pushed - 16.0).abs() < 1e-6);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Springs {
    /// Facets by their corner nodes, in any order.
    pub triangles: Vec<[usize; 3]>,
    /// Stiffness along the normal, kPa/mm; at least 0.
    pub normal: f64,
    /// Stiffness in the plane, kPa/mm; at least 0.
    pub tangential: f64,
}

impl Springs {
    /// Check ranges.
    ///
    /// # Errors
    ///
    /// [`FemError::BadParameter`].
    pub(crate) fn check(&self) -> Result<(), FemError> {
        let fits = |k: f64| k >= 0.0 && k.is_finite();
        must("springs.normal", "finite and not negative", self.normal, fits(self.normal))?;
        let tangential = self.tangential;
        must("springs.tangential", "finite and not negative", tangential, fits(tangential))
    }
}

/// Integrals of products of the shape functions over a three-node facet, over its area.
const MASS3: [[f64; 3]; 3] = [[2.0, 1.0, 1.0], [1.0, 2.0, 1.0], [1.0, 1.0, 2.0]];

/// The same for six nodes: corners, then the middles of 01, 12 and 20; times 180.
const MASS6: [[f64; 6]; 6] = [
    [6.0, -1.0, -1.0, 0.0, -4.0, 0.0],
    [-1.0, 6.0, -1.0, 0.0, 0.0, -4.0],
    [-1.0, -1.0, 6.0, -4.0, 0.0, 0.0],
    [0.0, 0.0, -4.0, 32.0, 16.0, 16.0],
    [-4.0, 0.0, 0.0, 16.0, 32.0, 16.0],
    [0.0, -4.0, 0.0, 16.0, 16.0, 32.0],
];

/// One facet on springs.
#[derive(Debug, Clone)]
pub(super) struct SpringFacet {
    pub(super) facet: Facet,
    /// `k_t I + (k_n − k_t) n nᵀ`, kPa/mm.
    stiffness: [[f64; 3]; 3],
}

impl SpringFacet {
    pub(super) fn new(facet: Facet, springs: &Springs) -> Self {
        let n = facet.normal;
        let stiffness = std::array::from_fn(|i| {
            std::array::from_fn(|k| {
                let own = if i == k { springs.tangential } else { 0.0 };
                own + (springs.normal - springs.tangential) * n[i] * n[k]
            })
        });
        Self { facet, stiffness }
    }

    fn mass(&self, a: usize, b: usize) -> f64 {
        match self.facet.nodes.len() {
            3 => self.facet.area / 12.0 * MASS3[a][b],
            _ => self.facet.area / 180.0 * MASS6[a][b],
        }
    }

    /// Stiffness between two of its nodes, mN/mm.
    pub(super) fn block(&self, a: usize, b: usize) -> [[f64; 3]; 3] {
        let mass = self.mass(a, b);
        self.stiffness.map(|row| row.map(|k| mass * k))
    }

    /// Add the forces of a displacement and return its energy, µJ.
    pub(super) fn add_force(&self, displacement: &[f64], force: &mut [f64]) -> f64 {
        let mut energy = 0.0;
        for (a, &node) in self.facet.nodes.iter().enumerate() {
            let mut mean = [0.0; 3];
            for (b, &other) in self.facet.nodes.iter().enumerate() {
                let mass = self.mass(a, b);
                for i in 0..3 {
                    mean[i] += mass * displacement[3 * other + i];
                }
            }
            for i in 0..3 {
                let row: f64 = (0..3).map(|k| self.stiffness[i][k] * mean[k]).sum();
                force[3 * node + i] += row;
                energy += 0.5 * row * displacement[3 * node + i];
            }
        }
        energy
    }
}
