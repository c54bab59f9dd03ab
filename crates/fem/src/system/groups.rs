//! Elimination orders, and the groups of nodes that are eliminated together.

use super::graph::{Graph, NONE, column_counts, elimination_tree, inverse, postorder};

/// Fronts of up to this many unknowns take in a child whatever zeros that stores.
const TINY: usize = 24;

/// Largest share of stored zeros up to a number of own unknowns of the merged front.
const ZERO_SHARE: [(usize, f64); 3] = [(96, 0.4), (192, 0.15), (usize::MAX, 0.06)];

/// A postordered elimination order with its tree.
pub(super) struct Elimination {
    /// Vertex at each position.
    order: Vec<u32>,
    /// Parent of each position.
    tree: Vec<u32>,
    /// Entries below the diagonal in each column.
    count: Vec<u32>,
}

impl Elimination {
    /// The tree of an order, which is postordered.
    pub(super) fn new(graph: &Graph, order: Vec<u32>) -> Self {
        let tree = elimination_tree(graph, &order);
        let post = postorder(&tree);
        let place = inverse(&post);
        let order: Vec<u32> = post.iter().map(|&k| order[k as usize]).collect();
        let moved = |p: u32| if p == NONE { NONE } else { place[p as usize] };
        let tree: Vec<u32> = post.iter().map(|&k| moved(tree[k as usize])).collect();
        let count = column_counts(graph, &order, &tree);
        Self { order, tree, count }
    }

    /// Operations, up to a factor.
    pub(super) fn work(&self) -> f64 {
        self.count.iter().map(|&c| f64::from(c + 1).powi(2)).sum()
    }
}

/// Positions grouped into fronts.
pub(super) struct Groups {
    pub(super) order: Vec<u32>,
    /// First position of each group, and the number of positions.
    pub(super) starts: Vec<usize>,
}

/// A group while groups are merged.
struct Group {
    /// Own positions under the first order.
    own: Vec<u32>,
    /// Own unknowns and rows, in unknowns.
    n_own: usize,
    n_rows: usize,
    /// Entries stored that are zero.
    zeros: f64,
    children: Vec<u32>,
}

impl Groups {
    /// Columns of equal structure make a group; small groups are merged into their parents where
    /// that stores few zeros.
    pub(super) fn merged(elimination: &Elimination, free_axes: &[u8]) -> Self {
        let Elimination { order, tree, count } = elimination;
        let n = order.len();
        let width = |k: usize| free_axes[order[k] as usize].count_ones() as usize;
        let mut group_of = vec![0u32; n];
        let mut groups: Vec<Group> = Vec::new();
        let mut parent_position = Vec::new();
        for k in 0..n {
            let joins = k > 0 && tree[k - 1] == k as u32 && count[k - 1] == count[k] + 1;
            if !joins {
                groups.push(Group {
                    own: Vec::new(),
                    n_own: 0,
                    n_rows: 0,
                    zeros: 0.0,
                    children: Vec::new(),
                });
                parent_position.push(NONE);
            }
            let g = groups.len() - 1;
            group_of[k] = g as u32;
            groups[g].own.push(k as u32);
            groups[g].n_own += width(k);
            // Unknowns of the rows, taken as three a node: exact where no axis is held alone.
            groups[g].n_rows = 3 * count[k] as usize;
            parent_position[g] = tree[k];
        }
        let mut roots = Vec::new();
        for g in 0..groups.len() {
            match parent_position[g] {
                NONE => roots.push(g as u32),
                p => {
                    let parent = group_of[p as usize] as usize;
                    groups[parent].children.push(g as u32);
                }
            }
        }
        for g in 0..groups.len() {
            Self::take_in_children(&mut groups, g);
        }
        let mut result = Self { order: Vec::with_capacity(n), starts: vec![0] };
        for root in roots {
            result.emit(&groups, root as usize, order);
        }
        result
    }

    fn take_in_children(groups: &mut [Group], g: usize) {
        let mut candidates = std::mem::take(&mut groups[g].children);
        // The child that shares most is tried first.
        candidates.sort_by_key(|&c| (std::cmp::Reverse(groups[c as usize].n_rows), c));
        let mut kept = Vec::new();
        for c in candidates {
            let child = &groups[c as usize];
            let parent = &groups[g];
            let n_own = child.n_own + parent.n_own;
            let stored = |own: usize, rows: usize| own as f64 * (own as f64 * 0.5 + rows as f64);
            let merged = stored(n_own, parent.n_rows);
            let zeros =
                merged - stored(child.n_own, child.n_rows) - stored(parent.n_own, parent.n_rows)
                    + child.zeros
                    + parent.zeros;
            let share = ZERO_SHARE.iter().find(|(n, _)| n_own <= *n).map_or(0.0, |(_, s)| *s);
            if n_own <= TINY || zeros <= share * merged {
                let (own, grandchildren) = {
                    let child = &mut groups[c as usize];
                    (std::mem::take(&mut child.own), std::mem::take(&mut child.children))
                };
                let parent = &mut groups[g];
                let mut all = own;
                all.append(&mut parent.own);
                parent.own = all;
                parent.n_own = n_own;
                parent.zeros = zeros;
                kept.extend(grandchildren);
            } else {
                kept.push(c);
            }
        }
        kept.sort_unstable();
        groups[g].children = kept;
    }

    /// Children before parents, without recursion (paths may be as long as the mesh).
    fn emit(&mut self, groups: &[Group], root: usize, order: &[u32]) {
        let mut stack = vec![(root, 0)];
        while let Some((g, next)) = stack.pop() {
            if let Some(&child) = groups[g].children.get(next) {
                stack.push((g, next + 1));
                stack.push((child as usize, 0));
            } else {
                self.order.extend(groups[g].own.iter().map(|&k| order[k as usize]));
                self.starts.push(self.order.len());
            }
        }
    }
}
