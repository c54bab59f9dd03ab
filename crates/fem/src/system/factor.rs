//! Numeric Cholesky factor by dense fronts, in single or double precision.
//!
//! A single-precision factor serves as a metric: its errors are corrected by the iteration around
//! it, and it takes half the memory and time. Fronts are filled from the 3x3 blocks of the cliques
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

use super::fronts::{Front, Fronts, Spot};
use crate::error::FemError;

/// Subtrees with less work than this are not worth a second thread.
const PARALLEL_WORK: f64 = 2e6;

/// Fronts with less work than this are factored by one thread.
const PARALLEL_FRONT: f64 = 2e7;

/// Number type of a factor.
pub(crate) trait Precision:
    faer::traits::RealField
    + Copy
    + Default
    + std::ops::AddAssign
    + std::ops::SubAssign
    + std::ops::Mul<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Add<Output = Self>
    + std::ops::Div<Output = Self>
{
    fn from_f64(value: f64) -> Self;
    fn to_f64(self) -> f64;
}

impl Precision for f64 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
}

impl Precision for f32 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

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

/// Factor of a positive definite matrix, in the precision that sufficed.
#[derive(Debug)]
pub(crate) enum Factor {
    Single(Numeric<f32>),
    Double(Numeric<f64>),
}

impl Factor {
    /// Factor in single precision, in double where that finds no positive pivots.
    ///
    /// # Errors
    ///
    /// [`FemError::SingularStiffness`], [`FemError::Cancelled`], [`FemError::TooLarge`].
    pub(crate) fn single_or_double(
        fronts: &Fronts,
        matrix: &impl Blocks,
        making: Making,
    ) -> Result<Self, FemError> {
        match Numeric::new(fronts, matrix, making) {
            Ok(factor) => Ok(Self::Single(factor)),
            Err(FemError::SingularStiffness { .. }) => Self::double(fronts, matrix, making),
            Err(error) => Err(error),
        }
    }

    /// Factor in double precision.
    pub(crate) fn double(
        fronts: &Fronts,
        matrix: &impl Blocks,
        making: Making,
    ) -> Result<Self, FemError> {
        Numeric::new(fronts, matrix, making).map(Self::Double)
    }

    /// Euclidean norm of the diagonal of the matrix.
    pub(crate) fn diagonal_norm(&self, fronts: &Fronts) -> f64 {
        match self {
            Self::Single(factor) => factor.diagonal_norm(fronts),
            Self::Double(factor) => factor.diagonal_norm(fronts),
        }
    }
}

/// Panels of all fronts.
#[derive(Debug)]
pub(crate) struct Numeric<T> {
    pub(super) panels: Vec<T>,
    diagonal_norm: OnceLock<f64>,
}

impl<T: Precision> Numeric<T> {
    fn new(fronts: &Fronts, matrix: &impl Blocks, making: Making) -> Result<Self, FemError> {
        let too_large = |_| FemError::TooLarge { n_dofs: fronts.n_unknowns };
        let mut panels: Vec<T> = Vec::new();
        // Asked for first, since there is no zeroed allocation that may fail.
        panels.try_reserve_exact(fronts.n_entries).map_err(too_large)?;
        panels = vec![T::default(); fronts.n_entries];
        let work = Work { fronts, matrix, making };
        let mut rest = panels.as_mut_slice();
        let mut taken = 0;
        for &root in &fronts.roots {
            let end = panel_end(fronts, root);
            let (own, after) = rest.split_at_mut(end - taken);
            rest = after;
            taken = end;
            work.subtree(root, own, &mut Scratch::default())?;
        }
        Ok(Self { panels, diagonal_norm: OnceLock::new() })
    }

    /// `K_ii = Σ_j L_ij²`, as the factor has it.
    fn diagonal_norm(&self, fronts: &Fronts) -> f64 {
        *self.diagonal_norm.get_or_init(|| {
            let mut diagonal = vec![0.0; fronts.n_unknowns];
            for front in &fronts.fronts {
                let rows = fronts.rows_of(front);
                for step in front.steps() {
                    for j in 0..step.n_columns {
                        let begin = front.panel + step.begin + j * step.n_rows;
                        let column = &self.panels[begin..begin + step.n_rows];
                        for (i, v) in column.iter().enumerate().skip(j) {
                            let v = v.to_f64();
                            let unknown = match (step.first + i).checked_sub(front.n_own) {
                                None => front.first + step.first + i,
                                Some(row) => rows[row] as usize,
                            };
                            diagonal[unknown] += v * v;
                        }
                    }
                }
            }
            diagonal.iter().map(|d| d * d).sum::<f64>().sqrt()
        })
    }
}

/// End of the panels of a subtree.
fn panel_end(fronts: &Fronts, root: u32) -> usize {
    let front = &fronts.fronts[root as usize];
    front.panel + front.panel_len()
}

/// What one thread keeps between fronts.
struct Scratch<T> {
    /// Updates no longer needed.
    spare: Vec<Vec<T>>,
    /// The front at work, before it is stored in steps.
    panel: Vec<T>,
    blocks: Vec<[f64; 9]>,
    memory: Option<MemBuffer>,
    memory_size: usize,
}

impl<T> Default for Scratch<T> {
    fn default() -> Self {
        Self {
            spare: Vec::new(),
            panel: Vec::new(),
            blocks: Vec::new(),
            memory: None,
            memory_size: 0,
        }
    }
}

/// What all threads read.
struct Work<'a, B: Blocks> {
    fronts: &'a Fronts,
    matrix: &'a B,
    making: Making<'a>,
}

impl<B: Blocks> Work<'_, B> {
    /// Factor a subtree, whose panels are `panels`; return the update of its root.
    fn subtree<T: Precision>(
        &self,
        root: u32,
        panels: &mut [T],
        scratch: &mut Scratch<T>,
    ) -> Result<Vec<T>, FemError> {
        let front = &self.fronts.fronts[root as usize];
        if !self.making.parallel || front.work < PARALLEL_WORK {
            return self.sequence(root, panels, scratch);
        }
        let (below, own) = panels.split_at_mut(panels.len() - front.panel_len());
        let children = self.fronts.children_of(front);
        let updates = self.children(children, below, scratch)?;
        self.front(front, own, updates, scratch)
    }

    /// Factor sibling subtrees, whose panels follow each other in `panels`.
    fn children<T: Precision>(
        &self,
        children: &[u32],
        panels: &mut [T],
        scratch: &mut Scratch<T>,
    ) -> Result<Vec<(u32, Vec<T>)>, FemError> {
        match *children {
            [] => Ok(Vec::new()),
            [one] => Ok(vec![(one, self.subtree(one, panels, scratch)?)]),
            _ => {
                let (low, high) = children.split_at(children.len() / 2);
                let begin = panel_begin(self.fronts, low[0]);
                let middle = panel_begin(self.fronts, high[0]) - begin;
                let (low_panels, high_panels) = panels.split_at_mut(middle);
                let (first, second) = rayon::join(
                    || self.children(low, low_panels, scratch),
                    || self.children(high, high_panels, &mut Scratch::default()),
                );
                let mut all = first?;
                all.extend(second?);
                Ok(all)
            }
        }
    }

    /// Factor a subtree front by front.
    fn sequence<T: Precision>(
        &self,
        root: u32,
        panels: &mut [T],
        scratch: &mut Scratch<T>,
    ) -> Result<Vec<T>, FemError> {
        let first_below = self.fronts.fronts[root as usize].first_below;
        let mut pending: Vec<(u32, Vec<T>)> = Vec::new();
        let mut rest = panels;
        for f in first_below..=root as usize {
            let front = &self.fronts.fronts[f];
            let (own, after) = rest.split_at_mut(front.panel_len());
            rest = after;
            let updates = pending.split_off(pending.len() - front.children.len());
            let update = self.front(front, own, updates, scratch)?;
            pending.push((f as u32, update));
        }
        Ok(pending.pop().map(|(_, update)| update).unwrap_or_default())
    }

    /// Assemble and eliminate one front; return its update.
    fn front<T: Precision>(
        &self,
        front: &Front,
        stored: &mut [T],
        children: Vec<(u32, Vec<T>)>,
        scratch: &mut Scratch<T>,
    ) -> Result<Vec<T>, FemError> {
        if self.making.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed)) {
            return Err(FemError::Cancelled);
        }
        let mut update = scratch.spare.pop().unwrap_or_default();
        update.clear();
        update.resize(front.n_rows * front.n_rows, T::default());
        let mut panel = std::mem::take(&mut scratch.panel);
        panel.clear();
        panel.resize(front.n_own * front.size(), T::default());
        self.add_cliques(front, &mut panel, &mut update, scratch)?;
        for (child, child_update) in children {
            add_update(self.fronts, front, child, &child_update, &mut panel, &mut update);
            scratch.spare.push(child_update);
        }
        self.eliminate(front, &mut panel, &mut update, scratch)?;
        for step in front.steps() {
            for j in 0..step.n_columns {
                let begin = (step.first + j) * front.size() + step.first;
                stored[step.begin + j * step.n_rows..][..step.n_rows]
                    .copy_from_slice(&panel[begin..begin + step.n_rows]);
            }
        }
        scratch.panel = panel;
        Ok(update)
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
        let panel = MatMut::from_column_major_slice_mut(panel, size, n_own);
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
                MatMut::from_column_major_slice_mut(update, n_rows, n_rows),
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

/// Begin of the panels of a subtree.
fn panel_begin(fronts: &Fronts, root: u32) -> usize {
    fronts.fronts[fronts.fronts[root as usize].first_below].panel
}

/// A front while it is assembled.
struct Target<'a, T> {
    front: &'a Front,
    panel: &'a mut [T],
    update: &'a mut [T],
}

impl<T: Precision> Target<'_, T> {
    /// Add the block of rows of spot `a` and columns of spot `b`.
    #[inline(always)]
    fn add_block(&mut self, a: Spot, b: Spot, diagonal: bool, block: &[f64; 9]) {
        if a.axes == 0b111 && b.axes == 0b111 {
            for i in 0..3 {
                for k in 0..=if diagonal { i } else { 2 } {
                    self.add(a.first + i as u32, b.first + k as u32, block[3 * i + k]);
                }
            }
            return;
        }
        let free = |spot: Spot| (0..3).filter(move |k| spot.axes & (1 << k) != 0);
        for (row, i) in (a.first..).zip(free(a)) {
            for (column, k) in (b.first..).zip(free(b)) {
                if !(diagonal && k > i) {
                    self.add(row, column, block[3 * i + k]);
                }
            }
        }
    }

    #[inline(always)]
    fn add(&mut self, row: u32, column: u32, value: f64) {
        let (row, column) = (row.max(column) as usize, row.min(column) as usize);
        let n_own = self.front.n_own;
        if column < n_own {
            self.panel[column * self.front.size() + row] += T::from_f64(value);
        } else {
            self.update[(column - n_own) * self.front.n_rows + row - n_own] += T::from_f64(value);
        }
    }
}

/// Add the update of a child to its parent's panel and update.
fn add_update<T: Precision>(
    fronts: &Fronts,
    front: &Front,
    child: u32,
    child_update: &[T],
    panel: &mut [T],
    update: &mut [T],
) {
    let child = &fronts.fronts[child as usize];
    let places = fronts.in_parent_of(child);
    let n = child.n_rows;
    // Places ascend: a parent's rows and own unknowns stand in elimination order.
    for j in 0..n {
        let column = places[j] as usize;
        let source = &child_update[j * n + j..(j + 1) * n];
        let target = if column < front.n_own {
            &mut panel[column * front.size()..(column + 1) * front.size()]
        } else {
            let start = (column - front.n_own) * front.n_rows;
            &mut update[start..start + front.n_rows]
        };
        let shift = if column < front.n_own { 0 } else { front.n_own };
        for (&place, &value) in places[j..].iter().zip(source) {
            target[place as usize - shift] += value;
        }
    }
}
