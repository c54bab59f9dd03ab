//! Reference geometry of all elements of a body, and its mid-edge nodes.

use super::{EDGES, Element};
use crate::mesh::Mesh;
use crate::system::Cliques;

/// What the element loops read, made once a body.
#[derive(Debug)]
pub(crate) struct Geometry {
    pub(crate) element: Element,
    /// Node indices, `element.n_nodes()` an element, flat.
    pub(crate) connectivity: Vec<u32>,
    /// `∂ξ/∂X` of each element, `[k][j] = ∂ξ_k/∂X_j`, 1/mm.
    pub(crate) inverse_jacobian: Vec<[[f64; 3]; 3]>,
    /// Volume of each element, mm³.
    pub(crate) volume: Vec<f64>,
    /// Places in the connectivity at which each node occurs: starts, then places, ascending.
    pub(crate) node2place: (Vec<u32>, Vec<u32>),
    /// Elements of [`Element::Tet4`] eight by eight; nothing for others.
    pub(crate) packs: Packs,
    /// Patches of [`Element::Tet4Averaged`]; none for other elements.
    pub(crate) patches: Option<Patches>,
}

/// Elements whose numbers stand side by side.
pub(crate) const PACK: usize = 8;

/// Four-node elements eight by eight, each number of all eight together. The last pack is filled
/// with elements without volume, whose nodes are one.
#[derive(Debug, Default)]
pub(crate) struct Packs {
    /// Nodes 0 to 3.
    pub(crate) nodes: Vec<[[u32; PACK]; 4]>,
    /// `∂ξ_k/∂X_j`, 1/mm.
    pub(crate) inverse_jacobian: Vec<[[[f64; PACK]; 3]; 3]>,
    /// mm³.
    pub(crate) volume: Vec<[f64; PACK]>,
}

impl Packs {
    fn new(connectivity: &[u32], inverse_jacobian: &[[[f64; 3]; 3]], volume: &[f64]) -> Self {
        let mut packs = Self::default();
        for first in (0..volume.len()).step_by(PACK) {
            let mut nodes = [[connectivity[4 * first]; PACK]; 4];
            let mut jacobians = [[[0.0; PACK]; 3]; 3];
            let mut volumes = [0.0; PACK];
            for (l, element) in (first..volume.len().min(first + PACK)).enumerate() {
                for a in 0..4 {
                    nodes[a][l] = connectivity[4 * element + a];
                }
                for k in 0..3 {
                    for j in 0..3 {
                        jacobians[k][j][l] = inverse_jacobian[element][k][j];
                    }
                }
                volumes[l] = volume[element];
            }
            packs.nodes.push(nodes);
            packs.inverse_jacobian.push(jacobians);
            packs.volume.push(volumes);
        }
        packs
    }
}

/// The elements around each node.
#[derive(Debug)]
pub(crate) struct Patches {
    /// First entry of each patch in `nodes`, and the number of entries.
    starts: Vec<u32>,
    /// Nodes of the elements around each node, itself included, ascending.
    nodes: Vec<u32>,
    /// Volume of the elements around each node, mm³; 0 where there is none.
    pub(crate) volume: Vec<f64>,
}

impl Patches {
    fn new(connectivity: &[u32], (starts, places): &(Vec<u32>, Vec<u32>), volume: &[f64]) -> Self {
        let mut patches = Self { starts: vec![0], nodes: Vec::new(), volume: Vec::new() };
        for around in starts.windows(2).map(|s| &places[s[0] as usize..s[1] as usize]) {
            let elements = around.iter().map(|&place| place as usize / 4);
            let mut own: Vec<u32> =
                elements.clone().flat_map(|e| connectivity[4 * e..][..4].to_vec()).collect();
            own.sort_unstable();
            own.dedup();
            patches.nodes.extend(own);
            patches.starts.push(patches.nodes.len() as u32);
            patches.volume.push(elements.map(|e| volume[e]).sum());
        }
        patches
    }

    /// Nodes of the patch around a node.
    pub(crate) fn nodes_of(&self, node: usize) -> &[u32] {
        &self.nodes[self.starts[node] as usize..self.starts[node + 1] as usize]
    }

    /// Place of a node in the patch around `centre`, of which it must be.
    pub(crate) fn place(&self, centre: usize, node: u32) -> usize {
        self.nodes_of(centre).partition_point(|&other| other < node)
    }
}

impl Geometry {
    /// Geometry of a mesh and the positions of all nodes (mid-edge nodes after the corners).
    pub(crate) fn new(
        mesh: &Mesh,
        element: Element,
        edges: &[[usize; 2]],
    ) -> (Self, Vec<[f64; 3]>) {
        let mut nodes = mesh.nodes().to_vec();
        let connectivity = match element {
            Element::Tet4 | Element::Tet4Averaged => {
                mesh.tets().iter().flatten().map(|&n| n as u32).collect()
            }
            Element::Tet10 => {
                nodes
                    .extend(edges.iter().map(|&[a, b]| midpoint(mesh.nodes()[a], mesh.nodes()[b])));
                quadratic_connectivity(mesh, edges)
            }
        };
        let (inverse_jacobian, volume): (Vec<[[f64; 3]; 3]>, Vec<f64>) =
            (0..mesh.n_tets()).map(|t| (inverse_jacobian(mesh, t), mesh.tet_volume(t))).unzip();
        let node2place = places(&connectivity, nodes.len());
        let patches = (element == Element::Tet4Averaged)
            .then(|| Patches::new(&connectivity, &node2place, &volume));
        let packs = match element {
            Element::Tet4 => Packs::new(&connectivity, &inverse_jacobian, &volume),
            Element::Tet4Averaged | Element::Tet10 => Packs::default(),
        };
        let geometry =
            Self { element, connectivity, inverse_jacobian, volume, node2place, packs, patches };
        (geometry, nodes)
    }

    pub(crate) fn n_elements(&self) -> usize {
        self.volume.len()
    }

    /// Sets of nodes that the stiffness couples: those of an element, or of a patch.
    pub(crate) fn cliques(&self) -> Cliques<'_> {
        match &self.patches {
            Some(patches) => Cliques::varying(&patches.nodes, &patches.starts),
            None => self.elements(),
        }
    }

    /// Nodes of all elements.
    pub(crate) fn elements(&self) -> Cliques<'_> {
        Cliques::new(&self.connectivity, self.element.n_nodes())
    }

    /// Nodes of one element.
    pub(crate) fn nodes_of(&self, element: usize) -> &[u32] {
        let width = self.element.n_nodes();
        &self.connectivity[element * width..(element + 1) * width]
    }

    /// Weights of a constant density at the nodes of an element: integrals of the shape functions
    /// over its volume. (The corners of a ten-node tetrahedron get −1/20, its mid-edges 1/5.)
    pub(crate) fn volume_weights(&self, element: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let volume = self.volume[element];
        let kind = self.element;
        self.nodes_of(element).iter().enumerate().map(move |(a, &node)| {
            let share = match (kind, a < 4) {
                (Element::Tet4 | Element::Tet4Averaged, _) => 0.25,
                (Element::Tet10, true) => -0.05,
                (Element::Tet10, false) => 0.2,
            };
            (node as usize, share * volume)
        })
    }
}

/// All edges of a mesh, corners ascending, sorted.
pub(crate) fn edges_of(mesh: &Mesh) -> Vec<[usize; 2]> {
    let mut edges: Vec<[usize; 2]> =
        mesh.tets().iter().flat_map(|tet| EDGES.map(|[a, b]| sorted(tet[a], tet[b]))).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

fn sorted(a: usize, b: usize) -> [usize; 2] {
    [a.min(b), a.max(b)]
}

fn midpoint(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| 0.5 * (a[i] + b[i]))
}

fn quadratic_connectivity(mesh: &Mesh, edges: &[[usize; 2]]) -> Vec<u32> {
    let mut connectivity = Vec::with_capacity(10 * mesh.n_tets());
    for tet in mesh.tets() {
        connectivity.extend(tet.iter().map(|&n| n as u32));
        for [a, b] in EDGES {
            // Every edge of every tetrahedron is in the list it was made from.
            let edge = edges.partition_point(|e| *e < sorted(tet[a], tet[b]));
            connectivity.push((mesh.n_nodes() + edge) as u32);
        }
    }
    connectivity
}

fn inverse_jacobian(mesh: &Mesh, tet: usize) -> [[f64; 3]; 3] {
    let x = mesh.tets()[tet].map(|n| mesh.nodes()[n]);
    let [a, b, c]: [[f64; 3]; 3] =
        std::array::from_fn(|k| std::array::from_fn(|i| x[k + 1][i] - x[0][i]));
    let six_volumes = 6.0 * mesh.tet_volume(tet);
    [cross(b, c), cross(c, a), cross(a, b)].map(|row| row.map(|v| v / six_volumes))
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn places(connectivity: &[u32], n_nodes: usize) -> (Vec<u32>, Vec<u32>) {
    let mut start = vec![0u32; n_nodes + 1];
    for &node in connectivity {
        start[node as usize + 1] += 1;
    }
    for node in 0..n_nodes {
        start[node + 1] += start[node];
    }
    let mut cursor = start.clone();
    let mut list = vec![0u32; connectivity.len()];
    for (place, &node) in connectivity.iter().enumerate() {
        list[cursor[node as usize] as usize] = place as u32;
        cursor[node as usize] += 1;
    }
    (start, list)
}
