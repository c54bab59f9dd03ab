//! Stiffness of facets as part of the cliques that hold their nodes.

use super::facet::Facet;
use crate::system::factor::Blocks;

/// Blocks of facets by clique.
#[derive(Debug, Default)]
pub(crate) struct FacetBlocks {
    /// Clique, pair of its nodes as [`Blocks`] counts them, and block; by clique.
    entries: Vec<(usize, usize, [f64; 9])>,
}

impl FacetBlocks {
    /// Add `block(a, b)` of all pairs of a facet's nodes (rows of node `a`).
    pub(super) fn add(&mut self, facet: &Facet, block: impl Fn(usize, usize) -> [[f64; 3]; 3]) {
        for (a, &pa) in facet.places.iter().enumerate() {
            for (b, &pb) in facet.places.iter().enumerate() {
                if pa >= pb {
                    let mut flat = [0.0; 9];
                    flat.copy_from_slice(block(a, b).as_flattened());
                    self.entries.push((facet.clique, pa * (pa + 1) / 2 + pb, flat));
                }
            }
        }
    }

    pub(super) fn sort(&mut self) {
        self.entries.sort_by_key(|entry| entry.0);
    }

    fn add_to(&self, clique: usize, blocks: &mut [[f64; 9]]) {
        let first = self.entries.partition_point(|entry| entry.0 < clique);
        for (_, pair, block) in self.entries[first..].iter().take_while(|e| e.0 == clique) {
            for (sum, value) in blocks[*pair].iter_mut().zip(block) {
                *sum += value;
            }
        }
    }
}

/// A matrix of elements with their facets.
pub(crate) struct WithFacets<'a, E> {
    pub(crate) elements: E,
    pub(crate) facets: &'a FacetBlocks,
}

impl<E: Blocks> Blocks for WithFacets<'_, E> {
    fn width(&self, clique: usize) -> usize {
        self.elements.width(clique)
    }

    fn blocks_into(&self, clique: usize, blocks: &mut [[f64; 9]]) -> bool {
        let upright = self.elements.blocks_into(clique, blocks);
        if upright && !self.facets.entries.is_empty() {
            self.facets.add_to(clique, blocks);
        }
        upright
    }
}
