//! Stiffness of facets as part of the elements that own them.

use super::facet::Facet;
use crate::system::factor::Blocks;

/// Blocks of facets by element.
#[derive(Debug, Default)]
pub(crate) struct FacetBlocks {
    /// Element, pair of its nodes as [`Blocks`] counts them, and block; by element.
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
                    self.entries.push((facet.tet, pa * (pa + 1) / 2 + pb, flat));
                }
            }
        }
    }

    pub(super) fn sort(&mut self) {
        self.entries.sort_by_key(|entry| entry.0);
    }

    fn add_to(&self, element: usize, blocks: &mut [[f64; 9]]) {
        let first = self.entries.partition_point(|entry| entry.0 < element);
        for (_, pair, block) in self.entries[first..].iter().take_while(|e| e.0 == element) {
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
    fn width(&self) -> usize {
        self.elements.width()
    }

    fn blocks_into(&self, element: usize, blocks: &mut [[f64; 9]]) -> bool {
        let upright = self.elements.blocks_into(element, blocks);
        if upright && !self.facets.entries.is_empty() {
            self.facets.add_to(element, blocks);
        }
        upright
    }
}
