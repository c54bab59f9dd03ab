//! Which nodes are held, and along which axes.

use std::collections::BTreeSet;

use crate::error::FemError;
use crate::mesh::ascending;
use crate::springs::Springs;

/// Held nodes, each along chosen axes.
///
/// A node held along all axes is clamped; one held along one axis rolls in the plane across it.
/// [`Load::prescribed`](crate::Load::prescribed) gives the displacement of a held node.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::Supports;
///
/// let clamped: Supports = [4, 7, 9].into();
/// let rollers = Supports::new().hold(&[4]).hold_axes(&[7, 9], [false, false, true]);
/// assert_eq!(clamped.nodes(), rollers.nodes());
/// assert_eq!(rollers.axes()[1], [false, false, true]);
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Supports {
    nodes: Vec<usize>,
    axes: Vec<[bool; 3]>,
    resting: Vec<Resting>,
}

/// A facet that rests on springs, and in which directions these have stiffness.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Resting {
    pub(crate) triangle: [usize; 3],
    pub(crate) normal: bool,
    pub(crate) tangential: bool,
}

impl Supports {
    /// Return supports that hold nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Hold these nodes along all three axes.
    #[must_use]
    pub fn hold(self, nodes: &[usize]) -> Self {
        self.hold_axes(nodes, [true; 3])
    }

    /// Hold these nodes along the axes marked true (x, y, z).
    #[must_use]
    pub fn hold_axes(mut self, nodes: &[usize], axes: [bool; 3]) -> Self {
        self.nodes.extend_from_slice(nodes);
        self.axes.resize(self.nodes.len(), axes);
        self
    }

    /// Count on springs to hold the body: loads must have springs on these triangles.
    ///
    /// Which way they hold it is seen from their stiffness: springs without tangential stiffness
    /// leave a flat base free to glide.
    #[must_use]
    pub fn rest_on(mut self, springs: &Springs) -> Self {
        let (normal, tangential) = (springs.normal > 0.0, springs.tangential > 0.0);
        let rows = springs.triangles.iter();
        self.resting.extend(rows.map(|&triangle| Resting { triangle, normal, tangential }));
        self
    }

    /// Facets that rest on springs.
    pub(crate) fn resting(&self) -> &[Resting] {
        &self.resting
    }

    /// Check that a load has the springs that are counted on.
    ///
    /// # Errors
    ///
    /// [`FemError::MissingSprings`].
    pub(crate) fn check_springs(&self, springs: &[Springs]) -> Result<(), FemError> {
        let directions = |resting: &Resting| (resting.normal, resting.tangential);
        let there: BTreeSet<([usize; 3], (bool, bool))> = springs
            .iter()
            .flat_map(|set| Self::new().rest_on(set).resting)
            .map(|r| (ascending(r.triangle), directions(&r)))
            .collect();
        let missing = |r: &&Resting| !there.contains(&(ascending(r.triangle), directions(r)));
        match self.resting.iter().find(missing) {
            Some(resting) => Err(FemError::MissingSprings { triangle: resting.triangle }),
            None => Ok(()),
        }
    }

    /// Held nodes, in the order in which they were given.
    pub fn nodes(&self) -> &[usize] {
        &self.nodes
    }

    /// Held axes of each held node.
    pub fn axes(&self) -> &[[bool; 3]] {
        &self.axes
    }

    /// Axes held at every node of the mesh; all false where a node is free.
    pub(crate) fn axes_by_node(&self, n_nodes: usize) -> Result<Vec<[bool; 3]>, FemError> {
        let mut seen = vec![false; n_nodes];
        let mut by_node = vec![[false; 3]; n_nodes];
        for (&node, &axes) in self.nodes.iter().zip(&self.axes) {
            if node >= n_nodes {
                return Err(FemError::HeldNodeOutOfRange { node, n_nodes });
            }
            if std::mem::replace(&mut seen[node], true) {
                return Err(FemError::HeldNodeRepeated { node });
            }
            by_node[node] = axes;
        }
        Ok(by_node)
    }
}

impl From<&[usize]> for Supports {
    fn from(nodes: &[usize]) -> Self {
        Self::new().hold(nodes)
    }
}

impl<const N: usize> From<[usize; N]> for Supports {
    fn from(nodes: [usize; N]) -> Self {
        Self::new().hold(&nodes)
    }
}

impl<const N: usize> From<&[usize; N]> for Supports {
    fn from(nodes: &[usize; N]) -> Self {
        Self::new().hold(nodes)
    }
}

impl From<Vec<usize>> for Supports {
    fn from(nodes: Vec<usize>) -> Self {
        Self::new().hold(&nodes)
    }
}

impl From<&Vec<usize>> for Supports {
    fn from(nodes: &Vec<usize>) -> Self {
        Self::new().hold(nodes)
    }
}
