//! What displacements of free nodes do at held ones.

use crate::body::Body;
use crate::solve::{Problem, State};
use crate::system::Operator;

/// Rows of the tangent at held nodes, and how they add up to reactions.
#[derive(Debug)]
pub(super) struct HeldRows {
    operator: Operator,
    /// Held node by its place, node of the body and share of the latter's force; see
    /// [`Body::reactions`].
    parts: Vec<(usize, usize, f64)>,
}

impl HeldRows {
    /// None where an element is inverted.
    pub(super) fn new(problem: &Problem, state: &State) -> Option<Self> {
        let body = problem.body;
        let wanted: Vec<bool> = body.held().iter().map(|axes| axes.contains(&true)).collect();
        let operator = problem.operator(state, &wanted)?;
        Some(Self { operator, parts: body.reaction_parts() })
    }

    /// Products with displacements, one row per node, column after column, as reactions, one row a held
    /// node, column after column.
    pub(super) fn products(&self, body: &Body, columns: &[[f64; 3]], n: usize) -> Vec<[f64; 3]> {
        let mut reactions = Vec::with_capacity(n * body.held_nodes().len());
        let mut at_nodes = vec![[0.0; 3]; body.n_nodes()];
        for column in columns.chunks_exact(body.n_nodes()).take(n) {
            let x = column.as_flattened().as_chunks::<1>().0;
            self.operator.product(x, |node, rows| {
                at_nodes[node] = [rows[0][0], rows[1][0], rows[2][0]];
            });
            reactions.extend(self.gathered(body, &at_nodes));
        }
        reactions
    }

    /// [`Body::reactions`] of forces, one row per node.
    pub(super) fn gathered(&self, body: &Body, forces: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let mut rows = vec![[0.0; 3]; body.held_nodes().len()];
        for &(place, node, share) in &self.parts {
            for i in (0..3).filter(|&i| body.held()[node][i]) {
                rows[place][i] += share * forces[node][i];
            }
        }
        rows
    }
}
