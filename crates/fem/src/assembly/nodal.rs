//! Mean displacement gradients at the nodes.
//!
//! The gradient at a node is that of its elements, averaged by their volumes `v_e`:
//!
//! ```text
//! h_a = Σ_e v_e h_e / Σ_e v_e = Σ_b (u_b − u_a) ⊗ g_ab,     g_ab = Σ_e v_e ∂N_b/∂X / Σ_e v_e
//! (3, 3)                              (3)        (3)
//! ```
//!
//! with `e` the elements around node `a` and `∂N_b/∂X` averaged over their points. The sum over `b`
//! leaves out `a` itself, as the gradients of all shape functions add up to nothing.

use rayon::prelude::*;

use super::loops::{CHUNK, PARALLEL_FROM, spatial_gradients};
use crate::element::{Element, Geometry, Rule, TET4, TET10};
use crate::material::Matrix3;

/// What a neighbour's displacement adds to the gradient at a node.
#[derive(Debug, Clone, Copy)]
struct Neighbour {
    node: u32,
    /// `g_ab`, 1/mm. In single precision: who reads means over elements needs no more digits.
    gradient: [f32; 3],
}

/// The weights `g_ab` of all nodes.
#[derive(Debug)]
pub(crate) struct NodalGradients {
    /// First neighbour of each node, and the number of all.
    starts: Vec<u32>,
    neighbours: Vec<Neighbour>,
}

impl NodalGradients {
    pub(crate) fn new(geometry: &Geometry) -> Self {
        match geometry.element {
            Element::Tet4 | Element::Tet4Averaged => Self::with(&TET4, geometry),
            Element::Tet10 => Self::with(&TET10, geometry),
        }
    }

    fn with<const N: usize, const Q: usize>(rule: &Rule<N, Q>, geometry: &Geometry) -> Self {
        let mut mean = [[0.0; 3]; N];
        for (row, a) in mean.iter_mut().zip(0..) {
            *row = std::array::from_fn(|k| {
                rule.gradients.iter().map(|point| point[a][k]).sum::<f64>() / Q as f64
            });
        }
        let (starts, places) = &geometry.node2place;
        let n_nodes = starts.len() - 1;
        let mut all = Self { starts: Vec::with_capacity(n_nodes + 1), neighbours: Vec::new() };
        all.starts.push(0);
        // Place of each node in the list of the node at hand, and the sums there.
        let mut place = vec![u32::MAX; n_nodes];
        let mut own: Vec<(u32, [f64; 3])> = Vec::new();
        for node in 0..n_nodes {
            own.clear();
            let mut volume = 0.0;
            for &at in &places[starts[node] as usize..starts[node + 1] as usize] {
                let element = at as usize / N;
                let weight = geometry.volume[element];
                volume += weight;
                let gradients = spatial_gradients(&mean, &geometry.inverse_jacobian[element]);
                for (&other, gradient) in geometry.nodes_of(element).iter().zip(&gradients) {
                    let slot = &mut place[other as usize];
                    if *slot == u32::MAX {
                        *slot = own.len() as u32;
                        own.push((other, [0.0; 3]));
                    }
                    let sum = &mut own[*slot as usize].1;
                    for j in 0..3 {
                        sum[j] += weight * gradient[j];
                    }
                }
            }
            for &(other, sum) in &own {
                place[other as usize] = u32::MAX;
                if other as usize != node {
                    let gradient = sum.map(|g| (g / volume) as f32);
                    all.neighbours.push(Neighbour { node: other, gradient });
                }
            }
            all.starts.push(all.neighbours.len() as u32);
        }
        all
    }

    /// Write the deformation gradients `I + h_a` of a displacement to `out`, one per node.
    ///
    /// # Shapes
    ///
    /// `displacement` `(3 n_nodes)`, mm.
    pub(crate) fn deformation_into(
        &self,
        displacement: &[f64],
        out: &mut Vec<Matrix3>,
        parallel: bool,
    ) {
        let rows = displacement.as_chunks::<3>().0;
        out.resize(rows.len(), [[0.0; 3]; 3]);
        let one = |(node, f): (usize, &mut Matrix3)| {
            let mut sum = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let own = rows[node];
            let (begin, end) = (self.starts[node] as usize, self.starts[node + 1] as usize);
            for neighbour in &self.neighbours[begin..end] {
                let (u, g) = (rows[neighbour.node as usize], neighbour.gradient.map(f64::from));
                for i in 0..3 {
                    for j in 0..3 {
                        sum[i][j] += (u[i] - own[i]) * g[j];
                    }
                }
            }
            *f = sum;
        };
        if parallel && rows.len() >= PARALLEL_FROM {
            out.par_iter_mut().with_min_len(CHUNK).enumerate().for_each(one);
        } else {
            out.iter_mut().enumerate().for_each(one);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used)]

    use super::*;
    use crate::element::edges_of;
    use crate::mesh::Mesh;

    #[test]
    fn a_uniform_deformation_is_found_at_every_node() {
        let h = [[0.2, -0.3, 0.1], [0.05, 0.4, -0.2], [-0.15, 0.25, 0.3]];
        let nodes = vec![
            [0.0, 0.0, 0.0],
            [9.0, 1.0, 0.0],
            [0.0, 8.0, 1.0],
            [1.0, 0.0, 7.0],
            [8.0, 9.0, 9.0],
        ];
        let mesh = Mesh::new(nodes, vec![[0, 1, 2, 3], [1, 2, 3, 4]]).expect("sound");
        for element in [Element::Tet4, Element::Tet10] {
            let edges = if element == Element::Tet10 { edges_of(&mesh) } else { Vec::new() };
            let (geometry, points) = Geometry::new(&mesh, element, &edges);
            let u: Vec<f64> = points
                .iter()
                .flat_map(|x| h.map(|row| 5.0 + (0..3).map(|j| row[j] * x[j]).sum::<f64>()))
                .collect();
            let mut found = Vec::new();
            NodalGradients::new(&geometry).deformation_into(&u, &mut found, false);
            assert_eq!(found.len(), points.len());
            for f in found {
                for i in 0..3 {
                    for j in 0..3 {
                        let exact = h[i][j] + if i == j { 1.0 } else { 0.0 };
                        assert!((f[i][j] - exact).abs() < 1e-6, "{element:?}: {f:?}");
                    }
                }
            }
        }
    }
}
