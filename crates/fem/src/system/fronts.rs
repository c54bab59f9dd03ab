//! Symbolic factorisation: dense fronts, and where everything goes in them.
//!
//! Nodes are eliminated in groups, *fronts*. A front owns consecutive unknowns (its columns) and
//! couples them to unknowns of later fronts (its rows). Its factor is one dense panel,
//!
//! ```text
//! [ L_own  ]   (n_own, n_own)
//! [ L_rows ]   (n_rows, n_own)
//! ```
//!
//! and eliminating its columns leaves an update `(n_rows, n_rows)` that is added to its parent, of
//! whose unknowns all its rows are (multifrontal method: Duff and Reid, ACM Trans. Math. Softw. 9,
//! 302, 1983). Children stand before their parents and every subtree is contiguous, in fronts, in
//! unknowns and in panels, so that subtrees can be worked on at the same time.

use super::cliques::Cliques;
use super::graph::{Graph, NONE, inverse};
use super::groups::{Elimination, Groups};

/// Columns of a panel that stand together, as a step: first the square of their own rows, column by
/// column, then the rows below in blocks, each column by column. So a solution reads it end to end.
pub(super) const STEP: usize = 8;

/// Rows of a block of a step; the last one is filled with zeros.
pub(super) const BLOCK: usize = 16;

/// One front.
#[derive(Debug, Clone)]
pub(super) struct Front {
    /// First own unknown.
    pub(super) first: usize,
    /// Number of own unknowns.
    pub(super) n_own: usize,
    /// Number of rows below them.
    pub(super) n_rows: usize,
    /// Place of its rows in [`Fronts::rows`].
    pub(super) rows: usize,
    /// Place of its panel, and the number of its entries.
    pub(super) panel: usize,
    panel_len: usize,
    /// Its steps in [`Fronts::steps`].
    steps: std::ops::Range<usize>,
    /// Place of its local vector in a solve.
    pub(super) local: usize,
    /// Its parent, [`NONE`] for a root.
    pub(super) parent: u32,
    /// First front of its subtree.
    pub(super) first_below: usize,
    /// Its children in [`Fronts::children`].
    pub(super) children: std::ops::Range<usize>,
    /// Cliques that are added in it, in [`Fronts::cliques`].
    pub(super) cliques: std::ops::Range<usize>,
    /// Multiply-adds of its subtree.
    pub(super) work: f64,
}

impl Front {
    /// Number of unknowns that take part.
    pub(super) fn size(&self) -> usize {
        self.n_own + self.n_rows
    }

    /// Entries of its update.
    pub(super) fn update_len(&self) -> usize {
        self.n_rows * self.n_rows
    }

    /// Entries of the panel.
    pub(super) fn panel_len(&self) -> usize {
        self.panel_len
    }
}

/// Some columns of a panel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    /// First column.
    pub(super) first: usize,
    pub(super) n_columns: usize,
    /// Place in the panel.
    pub(super) begin: usize,
    /// Rows below these columns' own.
    pub(super) n_rows: usize,
}

impl Step {
    /// Steps of a panel of `n_own` columns and `size` rows.
    fn of_panel(n_own: usize, size: usize) -> impl Iterator<Item = Self> {
        let mut begin = 0;
        (0..n_own).step_by(STEP).map(move |first| {
            let n_columns = STEP.min(n_own - first);
            let step = Self { first, n_columns, begin, n_rows: size - first - n_columns };
            begin = step.end();
            step
        })
    }

    /// Place of the blocks in the panel.
    pub(super) fn blocks(&self) -> usize {
        self.begin + self.n_columns * STEP
    }

    /// End in the panel.
    pub(super) fn end(&self) -> usize {
        self.blocks() + self.n_rows.div_ceil(BLOCK) * BLOCK * self.n_columns
    }
}

/// Where a node of a clique lies in a front: local unknown of its first free axis, and its free
/// axes as bits.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spot {
    pub(super) first: u32,
    pub(super) axes: u8,
}

/// All fronts of a matrix.
#[derive(Debug)]
pub(crate) struct Fronts {
    pub(super) fronts: Vec<Front>,
    /// Unknowns of the rows of all fronts, ascending in each.
    pub(super) rows: Vec<u32>,
    /// Place of each of these rows among the unknowns of the parent front.
    pub(super) in_parent: Vec<u32>,
    pub(super) children: Vec<u32>,
    /// Steps of all panels.
    steps: Vec<Step>,
    /// Fronts without parent.
    pub(super) roots: Vec<u32>,
    /// Cliques by the front in which they are added.
    pub(super) cliques: Vec<u32>,
    /// Spots of the nodes of all cliques, in the order of the cliques.
    pub(super) spots: Vec<Spot>,
    /// First spot of each of these cliques.
    pub(super) first_spot: Vec<usize>,
    pub(super) n_unknowns: usize,
    /// Entries of all panels.
    pub(crate) n_entries: usize,
    /// Unknowns of all fronts, rows included.
    pub(super) n_local: usize,
    /// Multiply-adds of a factorisation.
    pub(super) work: f64,
}

/// An order of the nodes with the fronts that it leads to.
pub(super) struct Analysis {
    /// Vertex of the graph at each position; fronts own consecutive positions.
    pub(super) order: Vec<u32>,
    pub(super) fronts: Fronts,
}

impl Fronts {
    /// Work of a factorisation over entries of the factor: its cost in units of a solve.
    pub(crate) fn factor_to_solve(&self) -> f64 {
        self.work / self.n_entries.max(1) as f64
    }

    /// Places of the local vectors of a subtree.
    pub(super) fn local_range(&self, root: u32) -> std::ops::Range<usize> {
        let front = &self.fronts[root as usize];
        self.fronts[front.first_below].local..front.local + front.size()
    }

    /// End of the panels of a subtree.
    pub(super) fn panel_end(&self, root: u32) -> usize {
        let front = &self.fronts[root as usize];
        front.panel + front.panel_len()
    }

    /// End of the unknowns of a subtree.
    pub(super) fn unknown_end(&self, root: u32) -> usize {
        let front = &self.fronts[root as usize];
        front.first + front.n_own
    }

    pub(super) fn steps_of(&self, front: &Front) -> &[Step] {
        &self.steps[front.steps.clone()]
    }

    pub(super) fn rows_of(&self, front: &Front) -> &[u32] {
        &self.rows[front.rows..front.rows + front.n_rows]
    }

    pub(super) fn in_parent_of(&self, front: &Front) -> &[u32] {
        &self.in_parent[front.rows..front.rows + front.n_rows]
    }

    /// Entries of the updates of a front's children.
    pub(super) fn passed_to(&self, front: &Front) -> usize {
        let update_len = |&child: &u32| self.fronts[child as usize].update_len();
        self.children_of(front).iter().map(update_len).sum()
    }

    /// Entries of the updates that wait at the same time while a subtree is factored front by front.
    pub(super) fn stack_of(&self, root: u32) -> usize {
        let (mut top, mut most) = (0, 0);
        for front in &self.fronts[self.fronts[root as usize].first_below..=root as usize] {
            most = most.max(top + front.update_len());
            top = top + front.update_len() - self.passed_to(front);
        }
        most
    }

    pub(super) fn children_of(&self, front: &Front) -> &[u32] {
        &self.children[front.children.clone()]
    }
}

/// Find the fronts of a graph under an elimination order.
///
/// # Shapes
///
/// `free_axes` bits of the free axes of each vertex; `vertex_of_node` one entry per node, [`NONE`]
/// where all axes are held.
pub(super) fn analyse(
    graph: &Graph,
    elimination: Elimination,
    free_axes: &[u8],
    cliques: Cliques,
    vertex_of_node: &[u32],
) -> Analysis {
    let groups = Groups::merged(&elimination, free_axes);
    let order = groups.order;
    let position = inverse(&order);
    let width = |v: u32| free_axes[v as usize].count_ones() as usize;
    let n = order.len();

    let mut first_unknown = vec![0usize; n + 1];
    for (k, &v) in order.iter().enumerate() {
        first_unknown[k + 1] = first_unknown[k] + width(v);
    }
    let n_fronts = groups.starts.len() - 1;
    let mut front_of = vec![0u32; n];
    for f in 0..n_fronts {
        front_of[groups.starts[f]..groups.starts[f + 1]].fill(f as u32);
    }

    // Rows of each front as positions: neighbours of its nodes and rows of its children.
    let mut rows_start = vec![0usize];
    let mut rows: Vec<u32> = Vec::new();
    let mut parent = vec![NONE; n_fronts];
    let mut children_of: Vec<Vec<u32>> = vec![Vec::new(); n_fronts];
    let mut mark = vec![NONE; n];
    for f in 0..n_fronts {
        let end = groups.starts[f + 1];
        let begin = rows.len();
        for &v in &order[groups.starts[f]..end] {
            for &w in graph.neighbours(v as usize) {
                let p = position[w as usize];
                if p as usize >= end && mark[p as usize] != f as u32 {
                    mark[p as usize] = f as u32;
                    rows.push(p);
                }
            }
        }
        for &c in &children_of[f] {
            for k in rows_start[c as usize]..rows_start[c as usize + 1] {
                let p = rows[k];
                if p as usize >= end && mark[p as usize] != f as u32 {
                    mark[p as usize] = f as u32;
                    rows.push(p);
                }
            }
        }
        rows[begin..].sort_unstable();
        rows_start.push(rows.len());
        if let Some(&p) = rows[begin..].first() {
            parent[f] = front_of[p as usize];
            children_of[parent[f] as usize].push(f as u32);
        }
    }

    let mut built = Fronts {
        fronts: Vec::with_capacity(n_fronts),
        rows: Vec::new(),
        in_parent: Vec::new(),
        children: Vec::new(),
        steps: Vec::new(),
        roots: Vec::new(),
        cliques: Vec::new(),
        spots: Vec::new(),
        first_spot: Vec::new(),
        n_unknowns: first_unknown[n],
        n_entries: 0,
        n_local: 0,
        work: 0.0,
    };
    // Local unknown of a position in a front, for its parent's children and its cliques.
    let mut local = vec![NONE; n];
    for f in 0..n_fronts {
        let (begin, end) = (groups.starts[f], groups.starts[f + 1]);
        let first = first_unknown[begin];
        let n_own = first_unknown[end] - first;
        let rows_at = built.rows.len();
        for &p in &rows[rows_start[f]..rows_start[f + 1]] {
            let p = p as usize;
            built.rows.extend((first_unknown[p]..first_unknown[p + 1]).map(|u| u as u32));
        }
        let n_rows = built.rows.len() - rows_at;
        let children = built.children.len()..built.children.len() + children_of[f].len();
        built.children.extend(&children_of[f]);
        let mut work = front_work(n_own, n_rows);
        let mut first_below = f;
        for &c in &children_of[f] {
            work += built.fronts[c as usize].work;
            first_below = first_below.min(built.fronts[c as usize].first_below);
        }
        if parent[f] == NONE {
            built.roots.push(f as u32);
            built.work += work;
        }
        let steps = built.steps.len();
        built.steps.extend(Step::of_panel(n_own, n_own + n_rows));
        let panel_len = built.steps[steps..].last().map_or(0, Step::end);
        built.fronts.push(Front {
            first,
            n_own,
            n_rows,
            rows: rows_at,
            panel: built.n_entries,
            panel_len,
            steps: steps..built.steps.len(),
            local: built.n_local,
            parent: parent[f],
            first_below,
            children,
            cliques: 0..0,
            work,
        });
        built.n_entries += panel_len;
        built.n_local += n_own + n_rows;
    }
    built.in_parent = vec![NONE; built.rows.len()];
    let owner = owners(cliques, vertex_of_node, &position, &front_of);
    let mut by_front: Vec<Vec<u32>> = vec![Vec::new(); n_fronts];
    for (clique, &front) in owner.iter().enumerate() {
        if front != NONE {
            by_front[front as usize].push(clique as u32);
        }
    }
    for f in 0..n_fronts {
        let (begin, end) = (groups.starts[f], groups.starts[f + 1]);
        let mut next = 0u32;
        let mut place = |p: usize| {
            local[p] = next;
            next += (first_unknown[p + 1] - first_unknown[p]) as u32;
        };
        (begin..end).for_each(&mut place);
        rows[rows_start[f]..rows_start[f + 1]].iter().for_each(|&p| place(p as usize));
        for &c in &children_of[f] {
            let at = built.fronts[c as usize].rows;
            let mut k = at;
            for &p in &rows[rows_start[c as usize]..rows_start[c as usize + 1]] {
                let p = p as usize;
                for axis in 0..first_unknown[p + 1] - first_unknown[p] {
                    built.in_parent[k] = local[p] + axis as u32;
                    k += 1;
                }
            }
        }
        let clique_begin = built.cliques.len();
        for &clique in &by_front[f] {
            built.cliques.push(clique);
            built.first_spot.push(built.spots.len());
            for &node in cliques.get(clique as usize) {
                let v = vertex_of_node[node as usize];
                built.spots.push(match v {
                    NONE => Spot { first: 0, axes: 0 },
                    _ => Spot {
                        first: local[position[v as usize] as usize],
                        axes: free_axes[v as usize],
                    },
                });
            }
        }
        built.fronts[f].cliques = clique_begin..built.cliques.len();
    }
    Analysis { order, fronts: built }
}

/// Front in which each clique is added: that of its node eliminated first.
fn owners(cliques: Cliques, vertex: &[u32], position: &[u32], front_of: &[u32]) -> Vec<u32> {
    (0..cliques.len())
        .map(|clique| {
            cliques
                .get(clique)
                .iter()
                .map(|&node| vertex[node as usize])
                .filter(|&v| v != NONE)
                .map(|v| position[v as usize])
                .min()
                .map_or(NONE, |first| front_of[first as usize])
        })
        .collect()
}

/// Multiply-adds of one front: `Σ (rows left)²` over its columns, halved for symmetry.
fn front_work(n_own: usize, n_rows: usize) -> f64 {
    let (a, b) = (n_rows as f64, (n_own + n_rows) as f64);
    0.5 * (b * (b + 1.0) * (2.0 * b + 1.0) - a * (a + 1.0) * (2.0 * a + 1.0)) / 6.0
}
