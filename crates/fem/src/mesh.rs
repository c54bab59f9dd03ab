//! Tetrahedral meshes: plain data, checked once.
//!
//! A [`Mesh`] that exists is sound: coordinates are finite, every tetrahedron has four different
//! existing nodes and positive volume, every node belongs to a tetrahedron, and no triangle is
//! shared by more than two tetrahedra. What follows may rely on it.

use std::collections::HashMap;

use crate::check::check_length;
use crate::error::FemError;
use crate::groups::Groups;

/// Volume over longest edge cubed below which a tetrahedron counts as flat.
///
/// A regular tetrahedron has 0.118. Rounding of coordinates leaves about 1e-16 in a flat one.
pub const DEGENERATE_LIMIT: f64 = 1e-10;

/// Corners of the four faces of a tetrahedron, each seen anticlockwise from outside.
pub(crate) const FACES: [[usize; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

/// A checked mesh of four-node tetrahedra.
///
/// # Units
///
/// Coordinates in mm.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::Mesh;
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let mesh = Mesh::new(nodes, vec![[0, 1, 2, 3]])?;
/// assert_eq!(mesh.surface_triangles().len(), 4);
/// assert!((mesh.volume() - 1000.0 / 6.0).abs() < 1e-9);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    nodes: Vec<[f64; 3]>,
    tets: Vec<[usize; 4]>,
    surface_triangles: Vec<[usize; 3]>,
    blocks: Vec<usize>,
}

impl Mesh {
    /// Check nodes and tetrahedra and return them as a mesh.
    ///
    /// The first three nodes of a tetrahedron, seen from the fourth, turn anticlockwise (VTK, Gmsh and
    /// meshio agree), so that `det [x1−x0, x2−x0, x3−x0] > 0`.
    ///
    /// # Shapes
    ///
    /// `nodes` one row per node; `tets` one row of four node indices a tetrahedron.
    ///
    /// # Errors
    ///
    /// [`FemError::EmptyMesh`], [`FemError::NonFiniteNode`], [`FemError::NodeOutOfRange`],
    /// [`FemError::RepeatedNode`], [`FemError::DegenerateTet`], [`FemError::InvertedTet`],
    /// [`FemError::UnusedNode`], [`FemError::OverlappingTets`], in this order of checks.
    ///
    /// # Cost
    ///
    /// One sort of the four faces of all tetrahedra.
    pub fn new(nodes: Vec<[f64; 3]>, tets: Vec<[usize; 4]>) -> Result<Self, FemError> {
        check_nodes(&nodes, &tets)?;
        check_indices(&nodes, &tets)?;
        check_volumes(&nodes, &tets)?;
        check_use(nodes.len(), &tets)?;
        let faces = sorted_faces(nodes.len(), &tets);
        let surface_triangles = boundary_faces(&tets, &faces)?;
        let blocks = blocks_by_tet(tets.len(), &faces);
        Ok(Self { nodes, tets, surface_triangles, blocks })
    }

    /// The same tetrahedra on nodes at other places.
    ///
    /// # Errors
    ///
    /// [`FemError::WrongLength`], and as [`Mesh::new`] for coordinates and volumes.
    pub fn moved_to(&self, nodes: Vec<[f64; 3]>) -> Result<Self, FemError> {
        check_length("nodes", self.n_nodes(), nodes.len())?;
        check_nodes(&nodes, &self.tets)?;
        check_volumes(&nodes, &self.tets)?;
        Ok(Self { nodes, ..self.clone() })
    }

    /// Node coordinates, mm.
    pub fn nodes(&self) -> &[[f64; 3]] {
        &self.nodes
    }

    /// Node indices of each tetrahedron.
    pub fn tets(&self) -> &[[usize; 4]] {
        &self.tets
    }

    /// Number of nodes.
    pub fn n_nodes(&self) -> usize {
        self.nodes.len()
    }

    /// Number of tetrahedra.
    pub fn n_tets(&self) -> usize {
        self.tets.len()
    }

    /// Triangles that belong to one tetrahedron only, anticlockwise seen from outside, in the
    /// order of the tetrahedra that own them.
    pub fn surface_triangles(&self) -> &[[usize; 3]] {
        &self.surface_triangles
    }

    /// Block of each tetrahedron: those connected through triangles share one.
    pub(crate) fn blocks(&self) -> &[usize] {
        &self.blocks
    }

    /// Volume of one tetrahedron, mm³.
    pub fn tet_volume(&self, tet: usize) -> f64 {
        signed_volume(&self.nodes, &self.tets[tet])
    }

    /// Volume of the whole body, mm³.
    pub fn volume(&self) -> f64 {
        self.tets.iter().map(|tet| signed_volume(&self.nodes, tet)).sum()
    }
}

fn check_nodes(nodes: &[[f64; 3]], tets: &[[usize; 4]]) -> Result<(), FemError> {
    if tets.is_empty() || nodes.len() < 4 {
        return Err(FemError::EmptyMesh { n_nodes: nodes.len(), n_tets: tets.len() });
    }
    match nodes.iter().position(|x| !x.iter().all(|c| c.is_finite())) {
        Some(node) => Err(FemError::NonFiniteNode { node, position: nodes[node] }),
        None => Ok(()),
    }
}

fn check_indices(nodes: &[[f64; 3]], tets: &[[usize; 4]]) -> Result<(), FemError> {
    for (tet, corners) in tets.iter().enumerate() {
        for (a, &node) in corners.iter().enumerate() {
            if node >= nodes.len() {
                return Err(FemError::NodeOutOfRange { tet, node, n_nodes: nodes.len() });
            }
            if corners[..a].contains(&node) {
                return Err(FemError::RepeatedNode { tet, node });
            }
        }
    }
    Ok(())
}

fn check_volumes(nodes: &[[f64; 3]], tets: &[[usize; 4]]) -> Result<(), FemError> {
    let mut first_inverted = None;
    let mut n_inverted = 0;
    for (tet, corners) in tets.iter().enumerate() {
        let volume = signed_volume(nodes, corners);
        let relative = volume / longest_edge(nodes, corners).powi(3);
        // Overflow leaves NaN, which is no volume either.
        if relative.is_nan() || relative.abs() <= DEGENERATE_LIMIT {
            return Err(FemError::DegenerateTet { tet, volume, relative, limit: DEGENERATE_LIMIT });
        }
        if volume < 0.0 {
            n_inverted += 1;
            first_inverted.get_or_insert((tet, volume));
        }
    }
    match first_inverted {
        Some((tet, volume)) => {
            Err(FemError::InvertedTet { tet, volume, n_inverted, n_tets: tets.len() })
        }
        None => Ok(()),
    }
}

fn check_use(n_nodes: usize, tets: &[[usize; 4]]) -> Result<(), FemError> {
    let mut used = vec![false; n_nodes];
    for &node in tets.iter().flatten() {
        used[node] = true;
    }
    match used.iter().position(|&u| !u) {
        Some(node) => {
            Err(FemError::UnusedNode { node, n_unused: used.iter().filter(|&&u| !u).count() })
        }
        None => Ok(()),
    }
}

/// One face: its nodes in ascending order, and where it came from (4 tet + face).
type KeyedFace = ([usize; 3], usize);

/// Corners of a triangle in the order by which equal triangles are found.
pub(crate) fn ascending(mut triangle: [usize; 3]) -> [usize; 3] {
    triangle.sort_unstable();
    triangle
}

/// All faces of all tetrahedra, sorted so that equal triangles are neighbours.
fn sorted_faces(n_nodes: usize, tets: &[[usize; 4]]) -> Vec<KeyedFace> {
    // By their lowest node first: only a handful each remain to be sorted.
    let mut faces = Vec::with_capacity(4 * tets.len());
    let mut starts = vec![0; n_nodes + 1];
    for (tet, corners) in tets.iter().enumerate() {
        for (f, face) in FACES.iter().enumerate() {
            let key = ascending(face.map(|a| corners[a]));
            starts[key[0] + 1] += 1;
            faces.push((key, 4 * tet + f));
        }
    }
    for node in 0..n_nodes {
        starts[node + 1] += starts[node];
    }
    let mut sorted = vec![([0; 3], 0); faces.len()];
    let mut next = starts.clone();
    for face in faces {
        let place = &mut next[face.0[0]];
        sorted[*place] = face;
        *place += 1;
    }
    for own in starts.windows(2) {
        sorted[own[0]..own[1]].sort_unstable();
    }
    sorted
}

fn boundary_faces(tets: &[[usize; 4]], faces: &[KeyedFace]) -> Result<Vec<[usize; 3]>, FemError> {
    let mut boundary = Vec::new();
    for group in faces.chunk_by(|a, b| a.0 == b.0) {
        match group {
            [(_, place)] => boundary.push(*place),
            [_, _] => {}
            _ => {
                return Err(FemError::OverlappingTets {
                    triangle: group[0].0,
                    n_tets: group.len(),
                });
            }
        }
    }
    boundary.sort_unstable();
    Ok(boundary.into_iter().map(|p| FACES[p % 4].map(|a| tets[p / 4][a])).collect())
}

/// Tetrahedron and face of every triangle of the surface, by its nodes in ascending order.
pub(crate) type FacetOwners = HashMap<[usize; 3], (usize, usize)>;

/// Find the owners of all facets of a mesh.
pub(crate) fn facet_owners(mesh: &Mesh) -> FacetOwners {
    let mut owners: FacetOwners =
        mesh.surface_triangles().iter().map(|&triangle| (ascending(triangle), (0, 0))).collect();
    for (tet, corners) in mesh.tets().iter().enumerate() {
        for (face, places) in FACES.iter().enumerate() {
            if let Some(owner) = owners.get_mut(&ascending(places.map(|a| corners[a]))) {
                *owner = (tet, face);
            }
        }
    }
    owners
}

fn blocks_by_tet(n_tets: usize, faces: &[KeyedFace]) -> Vec<usize> {
    let mut groups = Groups::new(n_tets);
    for pair in faces.windows(2) {
        if pair[0].0 == pair[1].0 {
            groups.join(pair[0].1 / 4, pair[1].1 / 4);
        }
    }
    groups.numbered()
}

fn edge(nodes: &[[f64; 3]], from: usize, to: usize) -> [f64; 3] {
    std::array::from_fn(|i| nodes[to][i] - nodes[from][i])
}

/// Return the signed volume of every tetrahedron, mm³: negative where a deformation has turned it inside out.
///
/// # Shapes
///
/// `nodes` one row per node, at any places; `tets` one row of four node indices a tetrahedron.
///
/// # Errors
///
/// [`FemError::NodeOutOfRange`], [`FemError::RepeatedNode`].
///
/// # Example
///
/// ```
/// # fn main() -> Result<(), tissuereg_fem::FemError> {
/// let corner = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, -10.0]];
/// let volumes = tissuereg_fem::tet_volumes(&corner, &[[0, 1, 2, 3]])?;
/// assert!((volumes[0] + 1000.0 / 6.0).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
pub fn tet_volumes(nodes: &[[f64; 3]], tets: &[[usize; 4]]) -> Result<Vec<f64>, FemError> {
    check_indices(nodes, tets)?;
    Ok(tets.iter().map(|tet| signed_volume(nodes, tet)).collect())
}

/// Signed volume of a tetrahedron, mm³.
pub(crate) fn signed_volume(nodes: &[[f64; 3]], tet: &[usize; 4]) -> f64 {
    let [a, b, c] = [1, 2, 3].map(|k| edge(nodes, tet[0], tet[k]));
    (a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0]))
        / 6.0
}

fn longest_edge(nodes: &[[f64; 3]], tet: &[usize; 4]) -> f64 {
    let mut longest = 0.0_f64;
    for a in 0..4 {
        for b in 0..a {
            let e = edge(nodes, tet[a], tet[b]);
            longest = longest.max(e.iter().map(|c| c * c).sum::<f64>().sqrt());
        }
    }
    longest
}
