//! Systems with one unknown a node: a symmetric matrix that is a sum over tetrahedra, factored.

use std::sync::Arc;

use crate::check::check_length;
use crate::error::FemError;
use crate::mesh::Mesh;
use crate::system::factor::{Blocks, Entries, Factor, Making};
use crate::system::pattern::Pattern;
use crate::system::{Cliques, SolveScratch};

/// Where a scalar stands among the three axes of a body's unknowns.
const AXIS: usize = 2;

/// The free nodes of a mesh in elimination order, with the symbolic factor of matrices that couple the
/// nodes of a tetrahedron.
///
/// Analysed once, used by any number of [`ScalarFactor`]s: for heat, potentials, or anything else that
/// treats the axes alike.
///
/// # Examples
///
/// The Laplacian of one tetrahedron with one free node, `Σ_e V ∇N·∇N`:
///
/// ```
/// use tissuereg_fem::{Mesh, ScalarSystem};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let mesh = Mesh::new(nodes, vec![[0, 1, 2, 3]])?;
/// let system = ScalarSystem::new(&mesh, &[true, true, true, false])?;
/// let volume = mesh.volume();
/// // Pairs (0, 0), (1, 0), (1, 1), (2, 0) .. (3, 3): the last is that of the free node with itself.
/// let factor = system.factor(|_| [volume / 100.0; 10], false)?;
/// let mut potential = vec![0.0];
/// factor.solve_into(&[1.0], &mut potential, &mut Default::default(), false)?;
/// assert!((potential[0] - 100.0 / volume).abs() < 1e-15);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug, Clone)]
pub struct ScalarSystem {
    pattern: Arc<Pattern>,
}

/// The factor of a positive definite matrix of a [`ScalarSystem`], in double precision.
#[derive(Debug, Clone)]
pub struct ScalarFactor {
    pattern: Arc<Pattern>,
    factor: Arc<Factor>,
}

/// Buffers of solutions, kept between calls; one for each that runs at a time.
#[derive(Default)]
pub struct ScalarScratch(SolveScratch);

impl ScalarSystem {
    /// Analyse the free nodes of a mesh.
    ///
    /// # Shapes
    ///
    /// `held` one entry per node: true where there is no unknown.
    ///
    /// # Errors
    ///
    /// [`FemError::WrongLength`], [`FemError::TooLarge`].
    pub fn new(mesh: &Mesh, held: &[bool]) -> Result<Self, FemError> {
        check_length("held (one entry a node)", mesh.n_nodes(), held.len())?;
        let connectivity: Vec<u32> =
            mesh.tets().iter().flatten().map(|&node| node as u32).collect();
        let axes: Vec<[bool; 3]> = held.iter().map(|&held| [true, true, held]).collect();
        let pattern = Pattern::new(mesh.nodes(), Cliques::new(&connectivity, 4), &axes)?;
        Ok(Self { pattern: Arc::new(pattern) })
    }

    /// Number of unknowns.
    pub fn n_unknowns(&self) -> usize {
        self.pattern.n_unknowns()
    }

    /// Node of each unknown, in elimination order.
    pub fn nodes(&self) -> impl Iterator<Item = usize> + '_ {
        self.pattern.unknown2flat.iter().map(|&flat| flat as usize / 3)
    }

    /// Factor the matrix whose entries of every tetrahedron are given, in the pairs of its nodes
    /// `(a, b)` with `a >= b`, row by row.
    ///
    /// # Errors
    ///
    /// [`FemError::SingularStiffness`] for a matrix that is not positive definite,
    /// [`FemError::TooLarge`].
    ///
    /// # Cost
    ///
    /// One factorisation of a third of a body's unknowns. With `parallel` the threads of the current
    /// pool are used; the bits do not depend on it.
    pub fn factor(
        &self,
        entries: impl Fn(usize) -> [f64; 10] + Sync,
        parallel: bool,
    ) -> Result<ScalarFactor, FemError> {
        let making = Making { parallel, cancel: None };
        let factor = Factor::new(&self.pattern.fronts, &Entry(entries), Entries::Double, making)?;
        Ok(ScalarFactor { pattern: Arc::clone(&self.pattern), factor: Arc::new(factor) })
    }
}

impl ScalarFactor {
    /// Write the solution for a right-hand side to `out`.
    ///
    /// # Shapes
    ///
    /// `rhs` and `out` one entry an unknown, in the order of [`ScalarSystem::nodes`].
    ///
    /// # Errors
    ///
    /// [`FemError::WrongLength`].
    pub fn solve_into(
        &self,
        rhs: &[f64],
        out: &mut [f64],
        scratch: &mut ScalarScratch,
        parallel: bool,
    ) -> Result<(), FemError> {
        let n = self.pattern.n_unknowns();
        check_length("right-hand side (one entry an unknown)", n, rhs.len())?;
        check_length("solution (one entry an unknown)", n, out.len())?;
        self.factor.solve_into(&self.pattern.fronts, 1.0, rhs, out, &mut scratch.0, parallel);
        Ok(())
    }
}

/// Entries of tetrahedra as blocks of one axis.
struct Entry<F>(F);

impl<F: Fn(usize) -> [f64; 10] + Sync> Blocks for Entry<F> {
    fn width(&self, _clique: usize) -> usize {
        4
    }

    fn blocks_into(&self, clique: usize, blocks: &mut [[f64; 9]]) -> bool {
        for (block, entry) in blocks.iter_mut().zip((self.0)(clique)) {
            *block = [0.0; 9];
            block[4 * AXIS] = entry;
        }
        true
    }
}
