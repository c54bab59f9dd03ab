//! Undirected graphs in compressed rows, and elimination trees on them.

use super::cliques::Cliques;

/// No vertex, no front, no place.
pub(super) const NONE: u32 = u32::MAX;

/// Neighbours of every vertex, without the vertex itself.
#[derive(Debug, Clone)]
pub(super) struct Graph {
    start: Vec<usize>,
    neighbours: Vec<u32>,
}

impl Graph {
    /// Graph whose vertices `vertex[node]` are joined where two nodes share a clique.
    ///
    /// # Shapes
    ///
    /// `vertex` one entry per node, [`NONE`] for nodes that are no vertex.
    pub(super) fn of_cliques(cliques: Cliques, vertex: &[u32], n_vertices: usize) -> Self {
        let mut own = vec![0usize; n_vertices + 1];
        for &node in cliques.nodes() {
            let v = vertex[node as usize];
            if v != NONE {
                own[v as usize + 1] += 1;
            }
        }
        for v in 0..n_vertices {
            own[v + 1] += own[v];
        }
        let mut cursor = own.clone();
        let mut vertex2clique = vec![0u32; own[n_vertices]];
        for (place, &node) in cliques.nodes().iter().enumerate() {
            let v = vertex[node as usize];
            if v != NONE {
                vertex2clique[cursor[v as usize]] = cliques.owner(place) as u32;
                cursor[v as usize] += 1;
            }
        }
        let mut start = vec![0];
        let mut neighbours = Vec::new();
        let mut mark = vec![NONE; n_vertices];
        for v in 0..n_vertices {
            mark[v] = v as u32;
            for &clique in &vertex2clique[own[v]..own[v + 1]] {
                for &node in cliques.get(clique as usize) {
                    let w = vertex[node as usize];
                    if w != NONE && mark[w as usize] != v as u32 {
                        mark[w as usize] = v as u32;
                        neighbours.push(w);
                    }
                }
            }
            start.push(neighbours.len());
        }
        Self { start, neighbours }
    }

    pub(super) fn n_vertices(&self) -> usize {
        self.start.len() - 1
    }

    pub(super) fn neighbours(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.start[vertex]..self.start[vertex + 1]]
    }

    /// Compressed rows: start of each vertex and all neighbours.
    pub(super) fn parts(&self) -> (&[usize], &[u32]) {
        (&self.start, &self.neighbours)
    }
}

/// Parent of each position in the elimination tree of the graph ordered by `order`
/// (position to vertex); [`NONE`] marks roots.
pub(super) fn elimination_tree(graph: &Graph, order: &[u32]) -> Vec<u32> {
    let position = inverse(order);
    let n = order.len();
    let mut parent = vec![NONE; n];
    let mut ancestor = vec![NONE; n];
    for k in 0..n {
        for &w in graph.neighbours(order[k] as usize) {
            let mut i = position[w as usize];
            while (i as usize) < k {
                let next = std::mem::replace(&mut ancestor[i as usize], k as u32);
                if next == NONE {
                    parent[i as usize] = k as u32;
                    break;
                }
                i = next;
            }
        }
    }
    parent
}

/// Positions in postorder: children before parents, each subtree contiguous.
pub(super) fn postorder(parent: &[u32]) -> Vec<u32> {
    let n = parent.len();
    let mut child = vec![NONE; n];
    let mut sibling = vec![NONE; n];
    let mut roots = NONE;
    for k in (0..n).rev() {
        let head = match parent[k] {
            NONE => &mut roots,
            p => &mut child[p as usize],
        };
        sibling[k] = std::mem::replace(head, k as u32);
    }
    let mut order = Vec::with_capacity(n);
    let mut stack = Vec::new();
    let mut root = roots;
    while root != NONE {
        stack.push(root);
        while let Some(&top) = stack.last() {
            match std::mem::replace(&mut child[top as usize], NONE) {
                NONE => {
                    order.push(top);
                    stack.pop();
                }
                first => {
                    child[top as usize] = sibling[first as usize];
                    stack.push(first);
                }
            }
        }
        root = sibling[root as usize];
    }
    order
}

/// Number of entries below the diagonal in each column of the Cholesky factor, by walking every
/// row's subtree.
pub(super) fn column_counts(graph: &Graph, order: &[u32], parent: &[u32]) -> Vec<u32> {
    let position = inverse(order);
    let n = order.len();
    let mut count = vec![0u32; n];
    let mut mark = vec![NONE; n];
    for k in 0..n {
        mark[k] = k as u32;
        for &w in graph.neighbours(order[k] as usize) {
            let mut i = position[w as usize];
            while (i as usize) < k && mark[i as usize] != k as u32 {
                mark[i as usize] = k as u32;
                count[i as usize] += 1;
                i = parent[i as usize];
            }
        }
    }
    count
}

/// Position of each vertex under an order.
pub(super) fn inverse(order: &[u32]) -> Vec<u32> {
    let mut position = vec![0u32; order.len()];
    for (k, &v) in order.iter().enumerate() {
        position[v as usize] = k as u32;
    }
    position
}
