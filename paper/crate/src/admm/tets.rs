//! Linear tetrahedra as the steps read them.

use tissuereg_fem::Mesh;
use tissuereg_fem::material::Matrix3;

use crate::vectors::cross;

/// Tetrahedra of a mesh, made once.
#[derive(Debug)]
pub(super) struct Tets {
    /// Nodes of each.
    pub(super) nodes: Vec<[u32; 4]>,
    /// `∂ξ/∂X` of each, `[k][j] = ∂ξ_k/∂X_j`, 1/mm.
    pub(super) inverse_jacobian: Vec<Matrix3>,
    /// mm³
    pub(super) volume: Vec<f64>,
    /// Corners that each node is, as `4 tet + corner`: starts, then corners, ascending.
    pub(super) node2corner: (Vec<u32>, Vec<u32>),
}

impl Tets {
    pub(super) fn new(mesh: &Mesh) -> Self {
        let nodes: Vec<[u32; 4]> = mesh.tets().iter().map(|tet| tet.map(|n| n as u32)).collect();
        let node2corner = corners_by_node(nodes.as_flattened(), mesh.n_nodes());
        Self {
            nodes,
            inverse_jacobian: (0..mesh.n_tets()).map(|tet| inverse_jacobian(mesh, tet)).collect(),
            volume: (0..mesh.n_tets()).map(|tet| mesh.tet_volume(tet)).collect(),
            node2corner,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.volume.len()
    }

    /// `∂N_a/∂X` of the four nodes of a tetrahedron, 1/mm.
    #[inline(always)]
    pub(super) fn shape_gradients(&self, tet: usize) -> [[f64; 3]; 4] {
        let [b, c, d] = self.inverse_jacobian[tet];
        let first = std::array::from_fn(|j| -(b[j] + c[j] + d[j]));
        [first, b, c, d]
    }

    /// `F` of a tetrahedron.
    #[inline(always)]
    pub(super) fn deformation_gradient(&self, tet: usize, u: &[[f64; 3]]) -> Matrix3 {
        let mut f = self.displacement_gradient(tet, u);
        (0..3).for_each(|i| f[i][i] += 1.0);
        f
    }

    /// `∂u/∂X` of a tetrahedron.
    #[inline(always)]
    pub(super) fn displacement_gradient(&self, tet: usize, u: &[[f64; 3]]) -> Matrix3 {
        let [first, others @ ..] = self.nodes[tet].map(|node| u[node as usize]);
        let rows = &self.inverse_jacobian[tet];
        let mut h = [[0.0; 3]; 3];
        for k in 0..3 {
            for i in 0..3 {
                let difference = others[k][i] - first[i];
                for j in 0..3 {
                    h[i][j] += difference * rows[k][j];
                }
            }
        }
        h
    }
}

fn inverse_jacobian(mesh: &Mesh, tet: usize) -> Matrix3 {
    let x = mesh.tets()[tet].map(|n| mesh.nodes()[n]);
    let [a, b, c]: [[f64; 3]; 3] =
        std::array::from_fn(|k| std::array::from_fn(|i| x[k + 1][i] - x[0][i]));
    let six_volumes = 6.0 * mesh.tet_volume(tet);
    [cross(b, c), cross(c, a), cross(a, b)].map(|row| row.map(|v| v / six_volumes))
}

fn corners_by_node(nodes: &[u32], n_nodes: usize) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; n_nodes + 1];
    for &node in nodes {
        starts[node as usize + 1] += 1;
    }
    for node in 0..n_nodes {
        starts[node + 1] += starts[node];
    }
    let mut next = starts.clone();
    let mut corners = vec![0u32; nodes.len()];
    for (corner, &node) in nodes.iter().enumerate() {
        corners[next[node as usize] as usize] = corner as u32;
        next[node as usize] += 1;
    }
    (starts, corners)
}
