//! The unknowns of a body in elimination order, and the fronts of its matrix.
//!
//! Nodes with at least one free axis are ordered as wholes, then expanded to unknowns.

use super::cliques::Cliques;
use super::fronts::Fronts;
use super::graph::{Graph, NONE};
use super::ordering::best_analysis;
use crate::error::FemError;

/// Order and symbolic factor of a body's stiffness on its free unknowns.
#[derive(Debug)]
pub(crate) struct Pattern {
    /// Flat index `3 node + axis` of each unknown, in elimination order.
    pub(crate) unknown2flat: Vec<u32>,
    pub(crate) fronts: Fronts,
}

impl Pattern {
    /// Analyse the unknowns of nodes that are coupled in cliques.
    ///
    /// # Shapes
    ///
    /// `points` and `held` one row per node.
    ///
    /// # Errors
    ///
    /// [`FemError::TooLarge`].
    pub(crate) fn new(
        points: &[[f64; 3]],
        cliques: Cliques,
        held: &[[bool; 3]],
    ) -> Result<Self, FemError> {
        let free: Vec<u32> =
            (0..held.len()).filter(|&n| held[n] != [true; 3]).map(|n| n as u32).collect();
        let mut vertex = vec![NONE; held.len()];
        for (v, &node) in free.iter().enumerate() {
            vertex[node as usize] = v as u32;
        }
        let axes: Vec<u8> = free
            .iter()
            .map(|&n| (0..3).map(|k| u8::from(!held[n as usize][k]) << k).sum())
            .collect();
        let graph = Graph::of_cliques(cliques, &vertex, free.len());
        let free_points: Vec<[f64; 3]> = free.iter().map(|&n| points[n as usize]).collect();
        let analysis = best_analysis(&graph, &free_points, &axes, cliques, &vertex);
        if analysis.fronts.rows.len().max(analysis.fronts.n_local) > u32::MAX as usize {
            return Err(FemError::TooLarge { n_dofs: analysis.fronts.n_unknowns });
        }
        let mut unknown2flat = Vec::with_capacity(analysis.fronts.n_unknowns);
        for &v in &analysis.order {
            let node = free[v as usize];
            let own = axes[v as usize];
            unknown2flat.extend((0..3).filter(|k| own & (1 << k) != 0).map(|k| 3 * node + k));
        }
        Ok(Self { unknown2flat, fronts: analysis.fronts })
    }

    /// Number of unknowns.
    pub(crate) fn n_unknowns(&self) -> usize {
        self.unknown2flat.len()
    }
}
