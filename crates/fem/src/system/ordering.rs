//! Elimination order of the nodes: geometric nested dissection or minimum degree.
//!
//! Nested dissection cuts the nodes at the median of their longest principal axis and makes the
//! smallest vertex cover of the cut edges the separator (König: as large as a maximum matching of
//! the bipartite graph of the cut), which is eliminated after both halves. It costs as little as
//! minimum degree and leaves a quarter (4,000 nodes) to a half (20,000) fewer operations on
//! compact organs. Both are counted and the cheaper one is taken, so that odd shapes are safe.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::cliques::Cliques;
use super::fronts::{Analysis, analyse};
use super::graph::{Graph, elimination_tree, postorder};

/// Sets of at most this many nodes are not cut further.
const LEAF: usize = 24;

/// Return the fronts of the cheaper of the two orders.
pub(super) fn best_analysis(
    graph: &Graph,
    points: &[[f64; 3]],
    free_axes: &[u8],
    cliques: Cliques,
    vertex: &[u32],
) -> Analysis {
    let finished = |order: Vec<u32>| {
        let tree = elimination_tree(graph, &order);
        let order: Vec<u32> = postorder(&tree).iter().map(|&k| order[k as usize]).collect();
        analyse(graph, &order, free_axes, cliques, vertex)
    };
    let (geometric, other) = rayon::join(
        || finished(nested_dissection(graph, points)),
        || minimum_degree(graph).map(finished),
    );
    match other {
        Some(other) if other.fronts.work() < geometric.fronts.work() => other,
        _ => geometric,
    }
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
    let mut cut = Cut { graph, points, side: vec![Side::Outside; n], mate: vec![u32::MAX; n] };
    cut.dissect((0..n as u32).collect(), &mut order);
    order
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Outside,
    Low,
    High,
}

struct Cut<'a> {
    graph: &'a Graph,
    points: &'a [[f64; 3]],
    side: Vec<Side>,
    mate: Vec<u32>,
}

impl Cut<'_> {
    fn dissect(&mut self, mut vertices: Vec<u32>, order: &mut Vec<u32>) {
        if vertices.len() <= LEAF {
            order.append(&mut vertices);
            return;
        }
        self.sort_along_longest_axis(&mut vertices);
        let middle = vertices.len() / 2;
        for (k, &v) in vertices.iter().enumerate() {
            self.side[v as usize] = if k < middle { Side::Low } else { Side::High };
        }
        let separator = self.separator(&vertices[..middle]);
        for &v in &vertices {
            self.side[v as usize] = Side::Outside;
        }
        // Membership is marked through `mate`, which is free again after the cover was found.
        for &v in &separator {
            self.mate[v as usize] = 0;
        }
        let keep = |v: &&u32| self.mate[**v as usize] == u32::MAX;
        let low: Vec<u32> = vertices[..middle].iter().filter(keep).copied().collect();
        let high: Vec<u32> = vertices[middle..].iter().filter(keep).copied().collect();
        for &v in &separator {
            self.mate[v as usize] = u32::MAX;
        }
        drop(vertices);
        self.dissect(low, order);
        self.dissect(high, order);
        order.extend(separator);
    }

    fn sort_along_longest_axis(&self, vertices: &mut [u32]) {
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
        for (slot, (_, v)) in vertices.iter_mut().zip(keyed) {
            *slot = v;
        }
    }

    /// Smallest set of vertices that touches every edge between the two sides.
    fn separator(&mut self, low: &[u32]) -> Vec<u32> {
        let border: Vec<u32> =
            low.iter().copied().filter(|&v| self.across(v).next().is_some()).collect();
        for &v in &border {
            self.match_greedily(v);
        }
        let mut visited = std::collections::HashSet::new();
        for &v in &border {
            if self.mate[v as usize] == u32::MAX {
                visited.clear();
                self.augment(v, &mut visited);
            }
        }
        // König: from unmatched low vertices, alternate; the cover is what was not reached on the
        // low side and what was reached on the high side.
        let mut reached_low = std::collections::HashSet::new();
        let mut reached_high = std::collections::BTreeSet::new();
        let mut queue: Vec<u32> =
            border.iter().copied().filter(|&v| self.mate[v as usize] == u32::MAX).collect();
        while let Some(v) = queue.pop() {
            if reached_low.insert(v) {
                for w in self.across(v) {
                    if reached_high.insert(w) {
                        queue.push(self.mate[w as usize]);
                    }
                }
            }
        }
        let mut cover: Vec<u32> =
            border.iter().copied().filter(|v| !reached_low.contains(v)).collect();
        cover.extend(reached_high);
        for &v in &border {
            let w = std::mem::replace(&mut self.mate[v as usize], u32::MAX);
            if w != u32::MAX {
                self.mate[w as usize] = u32::MAX;
            }
        }
        cover
    }

    /// Neighbours on the high side.
    fn across(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        self.graph
            .neighbours(vertex as usize)
            .iter()
            .copied()
            .filter(|&w| self.side[w as usize] == Side::High)
    }

    fn match_greedily(&mut self, v: u32) {
        let free = self.across(v).find(|&w| self.mate[w as usize] == u32::MAX);
        if let Some(w) = free {
            self.mate[v as usize] = w;
            self.mate[w as usize] = v;
        }
    }

    /// Find an augmenting path from an unmatched low vertex, breadth first, and flip it.
    fn augment(&mut self, start: u32, visited: &mut std::collections::HashSet<u32>) {
        let mut queue = std::collections::VecDeque::from([start]);
        let mut reached_from = std::collections::HashMap::new();
        while let Some(v) = queue.pop_front() {
            let next: Vec<u32> = self.across(v).filter(|&w| visited.insert(w)).collect();
            for w in next {
                reached_from.insert(w, v);
                match self.mate[w as usize] {
                    u32::MAX => return self.flip(w, &reached_from),
                    partner => queue.push_back(partner),
                }
            }
        }
    }

    fn flip(&mut self, end: u32, reached_from: &std::collections::HashMap<u32, u32>) {
        let mut w = end;
        while w != u32::MAX {
            let Some(&v) = reached_from.get(&w) else { return };
            let previous = std::mem::replace(&mut self.mate[v as usize], w);
            self.mate[w as usize] = v;
            w = previous;
        }
    }
}
