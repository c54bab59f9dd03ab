//! Elimination order of the nodes: geometric nested dissection or minimum degree.
//!
//! Nested dissection cuts the nodes at the median of their longest principal axis and eliminates
//! the separator that the cut leads to after both halves. On compact organs that leaves a third
//! (4,000 nodes) to a half (20,000) fewer operations than minimum degree. Both are counted and the
//! cheaper one is taken, so that odd shapes are safe.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::cliques::Cliques;
use super::fronts::{Analysis, analyse};
use super::graph::Graph;
use super::groups::Elimination;
use super::separator::{Halves, Parts};

/// Sets of at most this many nodes are not cut further.
const LEAF: usize = 12;

/// Return the fronts of the cheaper of the two orders.
pub(super) fn best_analysis(
    graph: &Graph,
    points: &[[f64; 3]],
    free_axes: &[u8],
    cliques: Cliques,
    vertex: &[u32],
) -> Analysis {
    let (geometric, other) = rayon::join(
        || Elimination::new(graph, nested_dissection(graph, points)),
        || minimum_degree(graph).map(|order| Elimination::new(graph, order)),
    );
    let best = match other {
        Some(other) if other.work() < geometric.work() => other,
        _ => geometric,
    };
    analyse(graph, best, free_axes, cliques, vertex)
}

/// Approximate minimum degree by faer; none where it fails for want of memory.
fn minimum_degree(graph: &Graph) -> Option<Vec<u32>> {
    let n = graph.n_vertices();
    let (start, neighbours) = graph.parts();
    let start: Vec<u32> = start.iter().map(|&s| u32::try_from(s).ok()).collect::<Option<_>>()?;
    let pattern = SymbolicSparseColMatRef::new_unsorted_checked(n, n, &start, None, neighbours);
    let mut order = vec![0u32; n];
    let mut position = vec![0u32; n];
    let mut memory =
        MemBuffer::try_new(amd::order_maybe_unsorted_scratch::<u32>(n, neighbours.len())).ok()?;
    let stack = MemStack::new(&mut memory);
    amd::order_maybe_unsorted(&mut order, &mut position, pattern, amd::Control::default(), stack)
        .ok()?;
    Some(order)
}

fn nested_dissection(graph: &Graph, points: &[[f64; 3]]) -> Vec<u32> {
    let n = graph.n_vertices();
    let mut order = Vec::with_capacity(n);
    let mut dissection = Dissection { points, halves: Halves::new(graph) };
    dissection.dissect((0..n as u32).collect(), &mut order);
    order
}

struct Dissection<'a> {
    points: &'a [[f64; 3]],
    halves: Halves<'a>,
}

impl Dissection<'_> {
    fn dissect(&mut self, vertices: Vec<u32>, order: &mut Vec<u32>) {
        if vertices.len() <= LEAF {
            order.extend(vertices);
            return;
        }
        let Parts { low, high, separator } = self.halves.separate(&self.sorted(&vertices));
        drop(vertices);
        self.dissect(low, order);
        self.dissect(high, order);
        order.extend(separator);
    }

    /// Vertices in the order of their places along their longest principal axis.
    fn sorted(&self, vertices: &[u32]) -> Vec<u32> {
        let point = |v: u32| Vector3::from(self.points[v as usize]);
        let centre: Vector3<f64> =
            vertices.iter().map(|&v| point(v)).sum::<Vector3<f64>>() / vertices.len() as f64;
        let spread: Matrix3<f64> =
            vertices.iter().map(|&v| (point(v) - centre) * (point(v) - centre).transpose()).sum();
        let eigen = SymmetricEigen::new(spread);
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let mut keyed: Vec<(f64, u32)> =
            vertices.iter().map(|&v| (axis.dot(&(point(v) - centre)), v)).collect();
        keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        keyed.into_iter().map(|(_, v)| v).collect()
    }
}
