//! Numeric Cholesky factor by dense fronts, in single or double precision.
//!
//! A factor made in single precision and kept in whole numbers serves as a metric: its errors are
//! corrected by the iteration around it, and it takes half the time and a quarter of the memory. Fronts are filled from the 3x3 blocks of the cliques
//! (elements), so that no sparse matrix is ever formed. Subtrees are factored at the same time
//! where threads are to be had; every sum is taken in one fixed order, so that the bits do not
//! depend on it.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{
    LltRegularization, cholesky_in_place, cholesky_in_place_scratch,
};
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, Par};

use super::assemble::{Target, add_update, clear_lower};
use super::entry::{Entry, Precision};
use super::fronts::{Front, Fronts};
use super::panels::{AddSquares, Column, Slots, Store, Stored};
use crate::error::FemError;

/// Subtrees with less work than this are not worth a second thread.
const PARALLEL_WORK: f64 = 2e6;

/// Subtrees a thread, about, into which a factorisation is split: enough to share evenly, and few, as each
/// has buffers of its own.
const PIECES: f64 = 16.0;

/// Fronts with less work than this are factored by one thread.
const PARALLEL_FRONT: f64 = 2e7;

/// A matrix given clique by clique.
pub(crate) trait Blocks: Sync {
    /// Write the 3x3 blocks of the pairs `a >= b` of a clique's nodes, row by row, rows of node
    /// `a`; false where the matrix does not exist (an inverted element).
    fn blocks_into(&self, clique: usize, blocks: &mut [[f64; 9]]) -> bool;

    /// Nodes of a clique.
    fn width(&self, clique: usize) -> usize;
}

/// How a factor is made.
#[derive(Clone, Copy)]
pub(crate) struct Making<'a> {
    /// Whether more than one thread may be used.
    pub(crate) parallel: bool,
    /// Raised to end early.
    pub(crate) cancel: Option<&'a AtomicBool>,
}

/// What a factor is made of and kept in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Entries {
    /// Made in single precision, kept in whole numbers.
    Compact,
    /// The same, or double where that finds no positive pivots.
    CompactOrDouble,
    /// Made and kept in single precision, or double where that finds no positive pivots.
    SingleOrDouble,
    Double,
}

/// Factor of a positive definite matrix, in the precision that sufficed.
#[derive(Debug)]
pub(crate) enum Factor {
    /// Made in single precision, kept in whole numbers.
    Compact(Numeric<i16>),
    /// Made and kept in single precision.
    Single(Numeric<f32>),
    Double(Numeric<f64>),
}

impl Factor {
    /// Factor a matrix and keep the factor in chosen entries.
    ///
    /// # Errors
    ///
    /// [`FemError::SingularStiffness`], [`FemError::Cancelled`], [`FemError::TooLarge`].
    pub(crate) fn new(
        fronts: &Fronts,
        matrix: &impl Blocks,
        entries: Entries,
        making: Making,
    ) -> Result<Self, FemError> {
        let double = || Numeric::new(fronts, matrix, making).map(Self::Double);
        let found = match entries {
            Entries::Compact | Entries::CompactOrDouble => {
                Numeric::new(fronts, matrix, making).map(Self::Compact)
            }
            Entries::SingleOrDouble => Numeric::new(fronts, matrix, making).map(Self::Single),
            Entries::Double => return double(),
        };
        match found {
            Err(FemError::SingularStiffness { .. }) if entries != Entries::Compact => double(),
            found => found,
        }
    }

    /// Euclidean norm of the diagonal of the matrix.
    pub(crate) fn diagonal_norm(&self, fronts: &Fronts) -> f64 {
        match self {
            Self::Compact(factor) => factor.diagonal_norm(fronts),
            Self::Single(factor) => factor.diagonal_norm(fronts),
            Self::Double(factor) => factor.diagonal_norm(fronts),
        }
    }
}

/// Panels of all fronts.
#[derive(Debug)]
pub(crate) struct Numeric<E: Entry> {
    panels: Vec<E>,
    /// One an unknown.
    columns: Vec<Column<E::Real>>,
    diagonal_norm: OnceLock<f64>,
}

impl<E: Entry> Numeric<E> {
    fn new(fronts: &Fronts, matrix: &impl Blocks, making: Making) -> Result<Self, FemError> {
        let too_large = |_| FemError::TooLarge { n_dofs: fronts.n_unknowns };
        let mut panels: Vec<E> = Vec::new();
        // Asked for first, since there is no zeroed allocation that may fail.
        panels.try_reserve_exact(fronts.n_entries).map_err(too_large)?;
        panels = vec![E::default(); fronts.n_entries];
        let mut columns = vec![Column::default(); fronts.n_unknowns];
        let share = fronts.work / (PIECES * rayon::current_num_threads() as f64);
        let work = Work { fronts, matrix, making, least_work: share.max(PARALLEL_WORK) };
        let mut rest = Slots { panels: &mut panels, columns: &mut columns };
        let mut scratch = Scratch::default();
        let (mut panel, mut unknown) = (0, 0);
        for &root in &fronts.roots {
            let end = fronts.panel_end(root);
            let end_unknown = fronts.unknown_end(root);
            let (own, after) = rest.split(end - panel, end_unknown - unknown);
            rest = after;
            (panel, unknown) = (end, end_unknown);
            work.subtree(root, own, &mut scratch)?;
        }
        Ok(Self { panels, columns, diagonal_norm: OnceLock::new() })
    }

    pub(super) fn stored<'a>(&'a self, fronts: &'a Fronts, front: &Front) -> Stored<'a, E> {
        Stored {
            steps: fronts.steps_of(front),
            panel: &self.panels[front.panel..front.panel + front.panel_len()],
            columns: &self.columns[front.first..front.first + front.n_own],
        }
    }

    /// `K_ii = Σ_j L_ij²`, as the factor has it.
    fn diagonal_norm(&self, fronts: &Fronts) -> f64 {
        *self.diagonal_norm.get_or_init(|| {
            let mut diagonal = vec![0.0; fronts.n_unknowns];
            let mut local = Vec::new();
            for front in &fronts.fronts {
                local.clear();
                local.resize(front.size(), E::Real::default());
                let (stored, squares) = (self.stored(fronts, front), &mut local);
                pulp::Arch::new().dispatch(AddSquares { stored, squares });
                let (own, below) = local.split_at(front.n_own);
                for (d, v) in diagonal[front.first..].iter_mut().zip(own) {
                    *d += v.to_f64();
                }
                for (&row, v) in fronts.rows_of(front).iter().zip(below) {
                    diagonal[row as usize] += v.to_f64();
                }
            }
            diagonal.iter().map(|d| d * d).sum::<f64>().sqrt()
        })
    }
}

/// Fronts with the updates that they pass on.
type Updates<T> = Vec<(u32, Vec<T>)>;

/// What one thread keeps between fronts.
struct Scratch<T> {
    /// The front at work, before it is stored in steps.
    panel: Vec<T>,
    blocks: Vec<[f64; 9]>,
    memory: Option<MemBuffer>,
    memory_size: usize,
}

impl<T> Default for Scratch<T> {
    fn default() -> Self {
        Self { panel: Vec::new(), blocks: Vec::new(), memory: None, memory_size: 0 }
    }
}

impl<T: Precision> Scratch<T> {
    /// Make room for a panel.
    fn widen(&mut self, entries: usize) {
        if self.panel.len() < entries {
            // The old one goes first.
            self.panel = Vec::new();
            self.panel = vec![T::default(); entries];
        }
    }
}

/// What all threads read.
struct Work<'a, B: Blocks> {
    fronts: &'a Fronts,
    matrix: &'a B,
    making: Making<'a>,
    /// Subtrees with less work than this stay on one thread.
    least_work: f64,
}

impl<B: Blocks> Work<'_, B> {
    /// Factor a subtree into its slots; return the update of its root.
    fn subtree<E: Entry>(
        &self,
        root: u32,
        slots: Slots<E>,
        scratch: &mut Scratch<E::Real>,
    ) -> Result<Vec<E::Real>, FemError> {
        let front = &self.fronts.fronts[root as usize];
        if !self.making.parallel || front.work < self.least_work {
            return self.sequence(root, slots, scratch);
        }
        let entries = slots.panels.len() - front.panel_len();
        let columns = slots.columns.len() - front.n_own;
        let (below, own) = slots.split(entries, columns);
        let children = self.fronts.children_of(front);
        let updates = self.children(children, below, scratch)?;
        let mut update = vec![E::Real::default(); front.update_len()];
        let passed = updates.iter().map(|(child, update)| (*child, update.as_slice()));
        self.front(front, own, passed, &mut update, scratch)?;
        Ok(update)
    }

    /// Factor sibling subtrees, whose slots follow each other.
    fn children<E: Entry>(
        &self,
        children: &[u32],
        slots: Slots<E>,
        scratch: &mut Scratch<E::Real>,
    ) -> Result<Updates<E::Real>, FemError> {
        match *children {
            [] => Ok(Vec::new()),
            [one] => Ok(vec![(one, self.subtree(one, slots, scratch)?)]),
            _ => {
                let (low, high) = children.split_at(children.len() / 2);
                let (begin, middle) = (self.begin(low[0]), self.begin(high[0]));
                let (low_slots, high_slots) =
                    slots.split(middle.panel - begin.panel, middle.first - begin.first);
                let (first, second) = rayon::join(
                    || self.children(low, low_slots, scratch),
                    || self.children(high, high_slots, &mut Scratch::default()),
                );
                let mut all = first?;
                all.extend(second?);
                Ok(all)
            }
        }
    }

    /// First front of a subtree.
    fn begin(&self, root: u32) -> &Front {
        &self.fronts.fronts[self.fronts.fronts[root as usize].first_below]
    }

    /// Factor a subtree front by front. Updates wait on a stack of known height: memory that is new to the
    /// process costs more than most of what is done in it.
    fn sequence<E: Entry>(
        &self,
        root: u32,
        slots: Slots<E>,
        scratch: &mut Scratch<E::Real>,
    ) -> Result<Vec<E::Real>, FemError> {
        let subtree = self.fronts.fronts[root as usize].first_below..root as usize + 1;
        let panel = self.fronts.fronts[subtree.clone()].iter().map(|f| f.size() * f.n_own).max();
        scratch.widen(panel.unwrap_or(0));
        let mut stack = vec![E::Real::default(); self.fronts.stack_of(root)];
        let mut top = 0;
        let mut rest = slots;
        for front in &self.fronts.fronts[subtree] {
            let (own, after) = rest.split(front.panel_len(), front.n_own);
            rest = after;
            let begin = top - self.fronts.passed_to(front);
            let (below, above) = stack.split_at_mut(top);
            let mut at = begin;
            let updates = self.fronts.children_of(front).iter().map(|&child| {
                let update = &below[at..at + self.fronts.fronts[child as usize].update_len()];
                at += update.len();
                (child, update)
            });
            self.front(front, own, updates, &mut above[..front.update_len()], scratch)?;
            stack.copy_within(top..top + front.update_len(), begin);
            top = begin + front.update_len();
        }
        Ok(stack[..top].to_vec())
    }

    /// Assemble and eliminate one front; of its update only what lies on or below the diagonal
    /// means anything.
    fn front<'u, E: Entry>(
        &self,
        front: &Front,
        slots: Slots<E>,
        children: impl Iterator<Item = (u32, &'u [E::Real])>,
        update: &mut [E::Real],
        scratch: &mut Scratch<E::Real>,
    ) -> Result<(), FemError> {
        if self.making.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(FemError::Cancelled);
        }
        scratch.widen(front.size() * front.n_own);
        let mut panel = std::mem::take(&mut scratch.panel);
        clear_lower(update, front.n_rows, front.n_rows);
        clear_lower(&mut panel, front.size(), front.n_own);
        self.add_cliques(front, &mut panel, update, scratch)?;
        for (child, child_update) in children {
            add_update(self.fronts, front, child, child_update, &mut panel, update);
        }
        self.eliminate(front, &mut panel, update, scratch)?;
        let steps = self.fronts.steps_of(front);
        let store = Store { steps, size: front.size(), eliminated: &panel, slots };
        pulp::Arch::new().dispatch(store);
        scratch.panel = panel;
        Ok(())
    }

    fn add_cliques<T: Precision>(
        &self,
        front: &Front,
        panel: &mut [T],
        update: &mut [T],
        scratch: &mut Scratch<T>,
    ) -> Result<(), FemError> {
        let blocks = &mut scratch.blocks;
        for k in front.cliques.clone() {
            let clique = self.fronts.cliques[k] as usize;
            let width = self.matrix.width(clique);
            blocks.resize(width * (width + 1) / 2, [0.0; 9]);
            if !self.matrix.blocks_into(clique, blocks) {
                return Err(FemError::SingularStiffness {
                    pivot: front.first,
                    n_dofs: self.fronts.n_unknowns,
                });
            }
            let spots = &self.fronts.spots[self.fronts.first_spot[k]..][..width];
            let mut target = Target { front, panel, update };
            let mut pair = 0;
            for a in 0..width {
                for b in 0..=a {
                    target.add_block(spots[a], spots[b], a == b, &blocks[pair]);
                    pair += 1;
                }
            }
        }
        Ok(())
    }

    /// Factor the own columns and subtract what they pass on.
    fn eliminate<T: Precision>(
        &self,
        front: &Front,
        panel: &mut [T],
        update: &mut [T],
        scratch: &mut Scratch<T>,
    ) -> Result<(), FemError> {
        let (n_own, n_rows, size) = (front.n_own, front.n_rows, front.size());
        let own_work = (n_own * size * size) as f64;
        let par = match self.making.parallel && own_work > PARALLEL_FRONT {
            true => Par::rayon(0),
            false => Par::Seq,
        };
        if n_own > scratch.memory_size {
            let request = cholesky_in_place_scratch::<T>(n_own, par, Default::default());
            let too_large = |_| FemError::TooLarge { n_dofs: self.fronts.n_unknowns };
            scratch.memory = Some(MemBuffer::try_new(request).map_err(too_large)?);
            scratch.memory_size = n_own;
        }
        let Some(memory) = &mut scratch.memory else { return Ok(()) };
        let panel = MatMut::from_column_major_slice_mut(&mut panel[..size * n_own], size, n_own);
        let (mut own, mut rows) = panel.split_at_row_mut(n_own);
        let factored = cholesky_in_place(
            own.as_mut(),
            LltRegularization::default(),
            par,
            MemStack::new(memory),
            Default::default(),
        );
        let bad = match factored {
            Err(faer::linalg::cholesky::llt::factor::LltError::NonPositivePivot { index }) => {
                Some(index)
            }
            Ok(_) => (0..n_own).find(|&j| {
                let pivot = own[(j, j)].to_f64();
                !(pivot > 0.0 && pivot.is_finite())
            }),
        };
        if let Some(index) = bad {
            return Err(FemError::SingularStiffness {
                pivot: front.first + index,
                n_dofs: self.fronts.n_unknowns,
            });
        }
        if n_rows > 0 {
            solve_lower_triangular_in_place(own.as_ref(), rows.as_mut().transpose_mut(), par);
            matmul(
                MatMut::from_column_major_slice_mut(&mut update[..n_rows * n_rows], n_rows, n_rows),
                BlockStructure::TriangularLower,
                Accum::Add,
                rows.as_ref(),
                BlockStructure::Rectangular,
                rows.as_ref().transpose(),
                BlockStructure::Rectangular,
                T::from_f64(-1.0),
                par,
            );
        }
        Ok(())
    }
}
