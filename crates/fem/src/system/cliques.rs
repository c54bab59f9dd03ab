//! Sets of nodes that are coupled all with all: elements, or larger patches.

/// Node sets of a mesh, flat.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cliques<'a> {
    nodes: &'a [u32],
    extent: Extent<'a>,
}

/// Where sets begin and end.
#[derive(Debug, Clone, Copy)]
enum Extent<'a> {
    /// All of one width.
    Width(usize),
    /// First entry of each set, and the number of entries.
    Starts(&'a [u32]),
}

impl<'a> Cliques<'a> {
    /// Sets of `width` nodes each.
    pub(crate) fn new(nodes: &'a [u32], width: usize) -> Self {
        Self { nodes, extent: Extent::Width(width) }
    }

    /// Sets of any widths: set `k` has the entries from `starts[k]` to `starts[k + 1]`.
    pub(crate) fn varying(nodes: &'a [u32], starts: &'a [u32]) -> Self {
        Self { nodes, extent: Extent::Starts(starts) }
    }

    /// Number of sets.
    pub(crate) fn len(&self) -> usize {
        match self.extent {
            Extent::Width(width) => self.nodes.len() / width,
            Extent::Starts(starts) => starts.len() - 1,
        }
    }

    /// Nodes of one set.
    pub(crate) fn get(&self, clique: usize) -> &'a [u32] {
        match self.extent {
            Extent::Width(width) => &self.nodes[clique * width..(clique + 1) * width],
            Extent::Starts(starts) => {
                &self.nodes[starts[clique] as usize..starts[clique + 1] as usize]
            }
        }
    }

    /// All nodes, set after set.
    pub(crate) fn nodes(&self) -> &'a [u32] {
        self.nodes
    }

    /// The set that the entry `place` of [`Cliques::nodes`] belongs to.
    pub(crate) fn owner(&self, place: usize) -> usize {
        match self.extent {
            Extent::Width(width) => place / width,
            Extent::Starts(starts) => starts.partition_point(|&start| start as usize <= place) - 1,
        }
    }
}
