//! Solutions with a tangent for many right-hand sides, in blocks that share every reading of the
//! factor.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::factored::Buffers;
use super::held::HeldRows;
use super::rates::Tangent;
use crate::error::FemError;
use crate::system::factor::Factor;
use crate::system::{WIDE, WIDE_SINGLE};

/// Right-hand sides on all components `3 node + axis`; entries of held ones do not count.
pub(super) enum Columns<'a> {
    /// Components with their values, column by column.
    Sparse(&'a [Vec<(usize, f64)>]),
    /// Rows of three, one per node of the body, column after column.
    Dense(&'a [[f64; 3]]),
}

/// What solutions for many right-hand sides are.
pub(super) struct Solutions {
    /// `K_ff⁻¹ b_f` at all nodes with zeros at held ones, one row per node, column after column.
    pub(super) at_nodes: Vec<[f64; 3]>,
    /// `(K x)` at held nodes as reactions, one row a held node, column after column; empty where not
    /// wanted.
    pub(super) at_held: Vec<[f64; 3]>,
    /// Corrections of single-precision solutions.
    pub(super) corrections: usize,
}

impl Tangent<'_> {
    /// Solve for `n` right-hand sides.
    ///
    /// # Errors
    ///
    /// [`FemError::Cancelled`], and [`FemError::BadSetting`] where a single factor does not suffice.
    pub(super) fn solve_columns(
        &self,
        n: usize,
        columns: &Columns,
        held: Option<&HeldRows>,
    ) -> Result<Solutions, FemError> {
        let mut at_nodes = vec![[0.0; 3]; n * self.problem.body.n_nodes()];
        let (at_held, corrections) = match &*self.factored.factor {
            Factor::Double(_) => self.in_blocks::<WIDE>(columns, held, &mut at_nodes)?,
            _ => self.in_blocks::<WIDE_SINGLE>(columns, held, &mut at_nodes)?,
        };
        Ok(Solutions { at_nodes, at_held, corrections })
    }

    fn in_blocks<const W: usize>(
        &self,
        columns: &Columns,
        held: Option<&HeldRows>,
        at_nodes: &mut [[f64; 3]],
    ) -> Result<(Vec<[f64; 3]>, usize), FemError> {
        let n_nodes = self.problem.body.n_nodes();
        let n_blocks = at_nodes.len().div_ceil(W * n_nodes);
        let parallel = self.problem.parallel;
        // Few blocks leave threads over for their subtrees.
        let inner = parallel && n_blocks < 2 * rayon::current_num_threads();
        let block = Block { tangent: self, columns, held, parallel: inner };
        let corrections = AtomicUsize::new(0);
        let one = |buffers: &mut BlockBuffers, (k, out): (usize, &mut [[f64; 3]])| {
            self.problem.check_cancel()?;
            let (at_held, more) = match out.len() / n_nodes {
                few if few <= WIDE => block.solve::<WIDE>(k * W, out, buffers)?,
                _ => block.solve::<W>(k * W, out, buffers)?,
            };
            corrections.fetch_add(more, Ordering::Relaxed);
            Ok(at_held)
        };
        let chunks = W * n_nodes;
        let parts: Vec<Vec<[f64; 3]>> = if parallel {
            let chunks = at_nodes.par_chunks_mut(chunks).enumerate();
            chunks.map_init(BlockBuffers::default, one).collect::<Result<_, FemError>>()?
        } else {
            let mut buffers = BlockBuffers::default();
            let chunks = at_nodes.chunks_mut(chunks).enumerate();
            chunks.map(|chunk| one(&mut buffers, chunk)).collect::<Result<_, FemError>>()?
        };
        Ok((parts.concat(), corrections.into_inner()))
    }
}

#[derive(Default)]
struct BlockBuffers {
    factored: Buffers,
    rhs: Vec<f64>,
    out: Vec<f64>,
}

/// What all blocks read.
struct Block<'a> {
    tangent: &'a Tangent<'a>,
    columns: &'a Columns<'a>,
    held: Option<&'a HeldRows>,
    parallel: bool,
}

impl Block<'_> {
    /// Solve for the columns from `first` on, as many as `at_nodes` has room for.
    fn solve<const W: usize>(
        &self,
        first: usize,
        at_nodes: &mut [[f64; 3]],
        buffers: &mut BlockBuffers,
    ) -> Result<(Vec<[f64; 3]>, usize), FemError> {
        let body = self.tangent.problem.body;
        let unknown2flat = &body.pattern().unknown2flat;
        let n = at_nodes.len() / body.n_nodes();
        let BlockBuffers { factored, rhs, out } = buffers;
        for values in [&mut *rhs, &mut *out] {
            values.clear();
            values.resize(3 * W * body.n_nodes(), 0.0);
        }
        let (rhs, out) = (rhs.as_chunks_mut::<W>().0, out.as_chunks_mut::<W>().0);
        self.fill(first, n, rhs, out);
        let rhs = &rhs[..unknown2flat.len()];
        let x = &mut out[..unknown2flat.len()];
        let corrections =
            self.tangent.factored.solve_into(body, rhs, x, factored, self.parallel)?;
        for (w, column) in at_nodes.chunks_exact_mut(body.n_nodes()).enumerate() {
            let column = column.as_flattened_mut();
            for (row, &flat) in x.iter().zip(unknown2flat) {
                column[flat as usize] = row[w];
            }
        }
        let at_held = self.held.map_or_else(Vec::new, |held| held.products(body, at_nodes, n));
        Ok((at_held, corrections))
    }

    /// Right-hand sides on the unknowns; `spare` has room for all components.
    fn fill<const W: usize>(
        &self,
        first: usize,
        n: usize,
        rhs: &mut [[f64; W]],
        spare: &mut [[f64; W]],
    ) {
        let body = self.tangent.problem.body;
        let unknown2flat = &body.pattern().unknown2flat;
        match self.columns {
            Columns::Sparse(columns) => {
                for (w, column) in columns[first..first + n].iter().enumerate() {
                    column.iter().for_each(|&(flat, value)| spare[flat][w] += value);
                }
                for (row, &flat) in rhs.iter_mut().zip(unknown2flat) {
                    *row = spare[flat as usize];
                }
            }
            Columns::Dense(rows) => {
                let columns = rows[first * body.n_nodes()..].chunks_exact(body.n_nodes());
                for (w, column) in columns.take(n).enumerate() {
                    let column = column.as_flattened();
                    for (row, &flat) in rhs.iter_mut().zip(unknown2flat) {
                        row[w] = column[flat as usize];
                    }
                }
            }
        }
    }
}
