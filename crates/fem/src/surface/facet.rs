//! Triangles of the surface and the element that each belongs to.

use crate::body::Body;
use crate::element::{EDGES, Element, cross};
use crate::error::FemError;
use crate::mesh::{FACES, ascending};

/// Corners of the edges of a facet, in the order of its mid-edge nodes 3 to 5.
const FACET_EDGES: [[usize; 2]; 3] = [[0, 1], [1, 2], [2, 0]];

/// One facet of a body's surface.
#[derive(Debug, Clone)]
pub(crate) struct Facet {
    /// Clique of the body's matrix that holds its nodes: its element, or a patch around a corner.
    pub(super) clique: usize,
    /// Its nodes: corners, anticlockwise seen from outside, then mid-edge nodes.
    pub(crate) nodes: Vec<usize>,
    /// Place of each node in the clique.
    pub(super) places: Vec<usize>,
    /// Outward normal of the undeformed facet, of length one.
    pub(crate) normal: [f64; 3],
    /// Undeformed area, mm².
    pub(crate) area: f64,
}

/// Facets for triangles of corner nodes in any order.
///
/// # Errors
///
/// [`FemError::NotOnSurface`].
pub(crate) fn facets_of(body: &Body, triangles: &[[usize; 3]]) -> Result<Vec<Facet>, FemError> {
    let owners = body.facet_owners();
    let facet = |(row, &triangle): (usize, &[usize; 3])| match owners.get(&ascending(triangle)) {
        Some(&(tet, face)) => Ok(Facet::new(body, tet, FACES[face])),
        None => Err(FemError::NotOnSurface { row, triangle }),
    };
    triangles.iter().enumerate().map(facet).collect()
}

impl Facet {
    fn new(body: &Body, tet: usize, corners: [usize; 3]) -> Self {
        let mut places = corners.to_vec();
        if body.element() == Element::Tet10 {
            for [a, b] in FACET_EDGES.map(|edge| edge.map(|k| corners[k])) {
                let edge = EDGES.iter().position(|&[p, q]| [p, q] == [a, b] || [q, p] == [a, b]);
                // All six pairs of corners are edges.
                places.push(4 + edge.unwrap_or_default());
            }
        }
        let element = body.geometry().nodes_of(tet);
        let nodes: Vec<usize> = places.iter().map(|&a| element[a] as usize).collect();
        let mut clique = tet;
        if let Some(patches) = &body.geometry().patches {
            clique = nodes[0];
            places = nodes.iter().map(|&node| patches.place(clique, node as u32)).collect();
        }
        let [a, b, c] = [0, 1, 2].map(|k| body.nodes()[nodes[k]]);
        let twice = cross(minus(b, a), minus(c, a));
        let length = twice.iter().map(|v| v * v).sum::<f64>().sqrt();
        Self { clique, nodes, places, normal: twice.map(|v| v / length), area: 0.5 * length }
    }

    /// Add a matrix of its nodes times a direction of all nodes.
    pub(crate) fn add_product(
        &self,
        matrix: &[Vec<[[f64; 3]; 3]>],
        direction: &[f64],
        product: &mut [f64],
    ) {
        for (a, &node) in self.nodes.iter().enumerate() {
            for (b, &other) in self.nodes.iter().enumerate() {
                for i in 0..3 {
                    for k in 0..3 {
                        product[3 * node + i] += matrix[a][b][i][k] * direction[3 * other + k];
                    }
                }
            }
        }
    }
}

pub(super) fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}
