//! Tetrahedra with four and with ten nodes: shape gradients and quadrature.
//!
//! Edges are straight in the reference shape, so a tetrahedron has one Jacobian. With barycentric
//! coordinates of the nodes 1 to 3 as `ξ (3)`, the displacement gradient at a point is
//!
//! ```text
//! h = Σ_a u_a ⊗ ∂N_a/∂ξ · ∂ξ/∂X
//! (3, 3)   (3)    (3)     (3, 3)
//! ```
//!
//! so that nine numbers a tetrahedron and one small table per element type suffice.
//!
//! Quadrature: the four-node element has a constant gradient and needs one point. The ten-node
//! element uses the four-point rule of degree 2: its gradient is linear, the linear stiffness is
//! integrated exactly, and 4 points x 6 strains = 24 = 30 − 6 is the least that leaves no
//! deformation without energy. Order 3 in L2 is kept (`tests/convergence.rs`).

mod geometry;

pub(crate) use geometry::{Geometry, PACK, Patches, cross, edges_of};

/// Element type of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Element {
    /// Four nodes, linear displacement. Stiff in bending, and locks near incompressibility.
    #[default]
    Tet4,
    /// Four nodes, linear displacement, volume ratios averaged at the nodes: does not lock near
    /// incompressibility. A quarter of every element is deformed by `(J̄_a / J)^⅓ F` for each of
    /// its corners `a`, with `J̄_a` the volume ratio of all elements around that node, so that a
    /// law answers to the averaged volume and to the element's own change of shape. The potential
    /// energy of that is minimised (average nodal pressure: Bonet and Burton, Commun. Numer. Meth.
    /// Engng 14, 437, 1998; the form that takes any law is the F-bar of de Souza Neto et al., Int.
    /// J. Numer. Meth. Engng 62, 353, 2005, per node and with exact derivatives).
    ///
    /// # Accuracy
    ///
    /// Displacements converge to published ones (`measure/incompressible.rs`; Schröder et al.,
    /// Arch. Comput. Methods Eng. 28, 713, 2021): 0.8 % too little on Cook's membrane in three
    /// dimensions with 24 x 24 cells at `ν = 0.4995`, where [`Element::Tet4`] lacks 2.4 % and
    /// [`Element::Tet10`] with 8 x 8 cells 0.6 %; 0.2 % too much on a pressed block with 8³ cells,
    /// where they lack 5.2 % and have 1.0 % too much (4³). What is missing on coarse meshes is what
    /// linear tets lack in bending at any `ν`. On a dome of 4,000 nodes pulled at a patch, all that is
    /// 10 mm or more from the patch moves as with quadratic tets to 0.2 % at 0.45, 0.49 and 0.4995
    /// (root mean square); linear ones lack 12 % at 0.4995. Of stresses expect less: on the membrane single
    /// elements keep their volume to 4 % only (quadratic ones to 0.1 %), and the pressure changes
    /// from one node to the next by as much as over the body (0.9 of its standard deviation, root
    /// mean square; 0.3 with quadratic tets). There is no stabilisation; take pressures from
    /// [`Element::Tet10`].
    ///
    /// # Cost
    ///
    /// Stiffness couples a node with the elements two rings around: a factor has three times the
    /// entries of one of [`Element::Tet4`] and takes six times the operations. Up to `ν = 0.491`,
    /// and without springs, plain tets serve as the metric of the search, so that such a
    /// factor is made only where the load is large. Above, several are made. Fields per point have
    /// four points an element, one a corner. Hooke's law is linear in the averaged gradient, not in
    /// the displacement.
    Tet4Averaged,
    /// Ten nodes, quadratic displacement; mid-edge nodes are added by the body.
    Tet10,
}

impl Element {
    /// "tet4", "tet4-averaged" or "tet10".
    pub fn name(self) -> &'static str {
        match self {
            Self::Tet4 => "tet4",
            Self::Tet4Averaged => "tet4-averaged",
            Self::Tet10 => "tet10",
        }
    }

    /// Number of nodes of an element.
    pub fn n_nodes(self) -> usize {
        match self {
            Self::Tet4 | Self::Tet4Averaged => 4,
            Self::Tet10 => 10,
        }
    }

    /// Number of quadrature points of an element.
    pub fn n_points(self) -> usize {
        match self {
            Self::Tet4 => 1,
            Self::Tet4Averaged | Self::Tet10 => 4,
        }
    }
}

/// Corners of the six edges, in the order of the mid-edge nodes 4 to 9 (as VTK's quadratic
/// tetrahedron has them).
pub(crate) const EDGES: [[usize; 2]; 6] = [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]];

/// Shape gradients `∂N/∂ξ` at the points of a rule whose weights are equal.
#[derive(Debug)]
pub(crate) struct Rule<const N: usize, const Q: usize> {
    pub(crate) gradients: [[[f64; 3]; N]; Q],
}

/// One point in the middle.
pub(crate) const TET4: Rule<4, 1> =
    Rule { gradients: [[[-1.0, -1.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]] };

/// Four points with barycentric coordinates (5 ± ...√5)/20.
pub(crate) const TET10: Rule<10, 4> = Rule {
    gradients: [
        tet10_gradients([NEAR, FAR, FAR, FAR]),
        tet10_gradients([FAR, NEAR, FAR, FAR]),
        tet10_gradients([FAR, FAR, NEAR, FAR]),
        tet10_gradients([FAR, FAR, FAR, NEAR]),
    ],
};

/// (5 + 3 √5) / 20
const NEAR: f64 = 0.585_410_196_624_968_5;
/// (5 − √5) / 20
const FAR: f64 = 0.138_196_601_125_010_5;

/// `∂N/∂ξ` of the ten-node tetrahedron at barycentric coordinates `l`:
/// `N_a = l_a (2 l_a − 1)` at corners and `N_ab = 4 l_a l_b` at mid-edge nodes.
const fn tet10_gradients(l: [f64; 4]) -> [[f64; 3]; 10] {
    let corner = TET4.gradients[0];
    let mut g = [[0.0; 3]; 10];
    let mut k = 0;
    while k < 3 {
        let mut a = 0;
        while a < 4 {
            g[a][k] = (4.0 * l[a] - 1.0) * corner[a][k];
            a += 1;
        }
        let mut e = 0;
        while e < 6 {
            let [a, b] = EDGES[e];
            g[4 + e][k] = 4.0 * (l[a] * corner[b][k] + l[b] * corner[a][k]);
            e += 1;
        }
        k += 1;
    }
    g
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_of_a_partition_of_unity_sum_to_zero() {
        for point in TET10.gradients {
            for k in 0..3 {
                let sum: f64 = point.iter().map(|g| g[k]).sum();
                assert!(sum.abs() < 1e-14, "sum {sum}");
            }
        }
    }

    #[test]
    fn the_rule_has_the_points_it_names() {
        assert!((NEAR - (5.0 + 3.0 * 5.0_f64.sqrt()) / 20.0).abs() < 1e-16);
        assert!((FAR - (5.0 - 5.0_f64.sqrt()) / 20.0).abs() < 1e-16);
        assert!((NEAR + 3.0 * FAR - 1.0).abs() < 1e-15);
    }
}
