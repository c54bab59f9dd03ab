//! Sets of nodes that are coupled all with all: elements, or larger patches.

/// Node sets of a mesh, flat.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cliques<'a> {
    nodes: &'a [u32],
    width: usize,
}

impl<'a> Cliques<'a> {
    /// Sets of `width` nodes each.
    pub(crate) fn new(nodes: &'a [u32], width: usize) -> Self {
        Self { nodes, width }
    }

    /// Number of sets.
    pub(crate) fn len(&self) -> usize {
        self.nodes.len() / self.width
    }

    /// Nodes of one set.
    pub(crate) fn get(&self, clique: usize) -> &'a [u32] {
        &self.nodes[clique * self.width..(clique + 1) * self.width]
    }

    /// All nodes, set after set.
    pub(crate) fn nodes(&self) -> &'a [u32] {
        self.nodes
    }

    /// The set that the entry `place` of [`Cliques::nodes`] belongs to.
    pub(crate) fn owner(&self, place: usize) -> usize {
        place / self.width
    }
}
