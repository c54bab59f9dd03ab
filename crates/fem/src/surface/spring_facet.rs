//! A facet on springs.

use super::facet::Facet;
use super::friction::{LEFT, Slip, Slipping};
use crate::springs::Springs;

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
    /// `k_t I + (k_n − k_t) n nᵀ`, kPa/mm; with friction of the little that never slips.
    stiffness: [[f64; 3]; 3],
    slipping: Option<Slipping>,
}

impl SpringFacet {
    pub(super) fn new(facet: Facet, springs: &Springs) -> Self {
        let n = facet.normal;
        let tangential = springs.tangential * springs.friction.map_or(1.0, |_| LEFT);
        let stiffness = std::array::from_fn(|i| {
            std::array::from_fn(|k| {
                let own = if i == k { tangential } else { 0.0 };
                own + (springs.normal - tangential) * n[i] * n[k]
            })
        });
        let slipping = springs.friction.map(|friction| Slipping::new(&facet, springs, friction));
        Self { facet, stiffness, slipping }
    }

    /// Points that may slip, in their order; none without friction.
    pub(super) fn slips(&self) -> &[Slip] {
        self.slipping.as_ref().map_or(&[], |slipping| &slipping.slips)
    }

    /// The same to be set.
    pub(super) fn slips_mut(&mut self) -> &mut [Slip] {
        self.slipping.as_mut().map_or(&mut [], |slipping| &mut slipping.slips)
    }

    /// What these points remember at a displacement; see [`Slipping::after`].
    pub(super) fn slips_after(&self, displacement: &[f64], slid: bool) -> Vec<Slip> {
        let after = |slipping: &Slipping| slipping.after(&self.facet, displacement, slid);
        self.slipping.as_ref().map_or_else(Vec::new, after)
    }

    fn mass(&self, a: usize, b: usize) -> f64 {
        match self.facet.nodes.len() {
            3 => self.facet.area / 12.0 * MASS3[a][b],
            _ => self.facet.area / 180.0 * MASS6[a][b],
        }
    }

    /// Tangent between all pairs of its nodes at a displacement (none: at rest), mN/mm.
    pub(super) fn matrix(&self, displacement: Option<&[f64]>) -> Vec<Vec<[[f64; 3]; 3]>> {
        let n = self.facet.nodes.len();
        let mut matrix = match &self.slipping {
            Some(slipping) => slipping.matrix(&self.facet, displacement),
            None => vec![vec![[[0.0; 3]; 3]; n]; n],
        };
        for (a, row) in matrix.iter_mut().enumerate() {
            for (b, block) in row.iter_mut().enumerate() {
                let mass = self.mass(a, b);
                for (sum, k) in
                    block.as_flattened_mut().iter_mut().zip(self.stiffness.as_flattened())
                {
                    *sum += mass * k;
                }
            }
        }
        matrix
    }

    /// Add the forces of a displacement and return its energy, µJ.
    pub(super) fn add_force(&self, displacement: &[f64], force: &mut [f64]) -> f64 {
        let mut energy = match &self.slipping {
            Some(slipping) => slipping.add_force(&self.facet, displacement, force),
            None => 0.0,
        };
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
