//! The sparse system: unknowns in elimination order, lower triangle by columns, symbolic factor.
//!
//! Nodes with at least one free axis are ordered as wholes, then expanded to unknowns. For every
//! pair of nodes of every element the place of its 3x3 block is kept, so that an assembly is a
//! plain scatter without a search.

use faer::Side;
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};

use super::graph::Graph;
use super::ordering::{best_ordering, positions};
use crate::error::FemError;

const NONE: u32 = u32::MAX;

/// Pattern and symbolic factor of a body's stiffness on its free unknowns.
#[derive(Debug)]
pub(crate) struct Pattern {
    /// Flat index `3 node + axis` of each unknown, in elimination order.
    pub(crate) unknown2flat: Vec<u32>,
    /// Unknown of each flat index; `u32::MAX` where held.
    flat2unknown: Vec<u32>,
    /// Start of each column of the lower triangle.
    pub(crate) column_start: Vec<u32>,
    /// Row of each entry of the lower triangle.
    pub(crate) rows: Vec<u32>,
    /// For each element and pair `a >= b` of its nodes: number of entries between the end of the
    /// diagonal block and this block, in each column.
    block_offset: Vec<u32>,
    /// Elimination position of each node; `u32::MAX` where all axes are held.
    position: Vec<u32>,
    /// Symbolic factor; none where nothing is free.
    pub(crate) symbolic: Option<SymbolicCholesky<u32>>,
    /// About the multiply-adds of one numeric factorisation.
    pub(crate) operations: f64,
}

impl Pattern {
    /// Analyse the unknowns of a mesh of `width`-node elements.
    ///
    /// # Shapes
    ///
    /// `points` and `held` one row a node, `elements` flat.
    ///
    /// # Errors
    ///
    /// [`FemError::TooLarge`].
    pub(crate) fn new(
        points: &[[f64; 3]],
        elements: &[u32],
        width: usize,
        held: &[[bool; 3]],
    ) -> Result<Self, FemError> {
        let free: Vec<u32> =
            (0..held.len()).filter(|&n| held[n] != [true; 3]).map(|n| n as u32).collect();
        let mut vertex = vec![NONE; held.len()];
        for (v, &node) in free.iter().enumerate() {
            vertex[node as usize] = v as u32;
        }
        let graph = Graph::of_elements(elements, width, &vertex, free.len());
        let free_points: Vec<[f64; 3]> = free.iter().map(|&n| points[n as usize]).collect();
        let ordering = best_ordering(&graph, &free_points);
        let place = positions(&ordering.order);
        let mut position = vec![NONE; held.len()];
        for (v, &node) in free.iter().enumerate() {
            position[node as usize] = place[v];
        }

        let mut unknown2flat = Vec::new();
        let mut flat2unknown = vec![NONE; 3 * held.len()];
        for &v in &ordering.order {
            let node = free[v as usize];
            for axis in (0..3).filter(|&axis| !held[node as usize][axis]) {
                flat2unknown[3 * node as usize + axis] = unknown2flat.len() as u32;
                unknown2flat.push(3 * node + axis as u32);
            }
        }
        let mut pattern = Self {
            unknown2flat,
            flat2unknown,
            column_start: vec![0],
            rows: Vec::new(),
            block_offset: Vec::new(),
            position,
            symbolic: None,
            operations: ordering.operations,
        };
        let columns = LowerColumns::new(&graph, &ordering.order, &place, &free, &pattern);
        pattern.fill_columns(&columns, held)?;
        pattern.place_blocks(&columns, elements, width);
        pattern.analyse()?;
        Ok(pattern)
    }

    /// Number of unknowns.
    pub(crate) fn n_unknowns(&self) -> usize {
        self.unknown2flat.len()
    }

    /// Number of entries of the lower triangle.
    pub(crate) fn n_entries(&self) -> usize {
        self.rows.len()
    }

    /// Rough cost of a factorisation in units of one solve with it.
    pub(crate) fn factor_to_solve(&self) -> f64 {
        match &self.symbolic {
            Some(symbolic) => self.operations / (symbolic.len_val().max(1) as f64),
            None => 0.0,
        }
    }

    fn fill_columns(&mut self, columns: &LowerColumns, held: &[[bool; 3]]) -> Result<(), FemError> {
        let too_large = FemError::TooLarge { n_dofs: self.unknown2flat.len() };
        for (position, &node) in columns.node.iter().enumerate() {
            let axes: Vec<usize> = (0..3).filter(|&k| !held[node as usize][k]).collect();
            for (rank, _) in axes.iter().enumerate() {
                for &i in &axes[rank..] {
                    self.rows.push(self.flat2unknown[3 * node as usize + i]);
                }
                for &other in columns.below(position) {
                    for i in 0..3 {
                        let row = self.flat2unknown[3 * other as usize + i];
                        if row != NONE {
                            self.rows.push(row);
                        }
                    }
                }
                let end = u32::try_from(self.rows.len()).map_err(|_| too_large.clone())?;
                self.column_start.push(end);
            }
        }
        Ok(())
    }

    fn place_blocks(&mut self, columns: &LowerColumns, elements: &[u32], width: usize) {
        self.block_offset.reserve(elements.len() * (width + 1) / 2);
        for nodes in elements.chunks_exact(width) {
            for a in 0..width {
                for b in 0..=a {
                    let [pa, pb] = [a, b].map(|k| self.position[nodes[k] as usize]);
                    self.block_offset.push(columns.offset(pa, pb));
                }
            }
        }
    }

    fn analyse(&mut self) -> Result<(), FemError> {
        let n = self.n_unknowns();
        if n == 0 {
            return Ok(());
        }
        // In its given order faer analyses the upper triangle, but factorises the lower one.
        let (upper_start, upper_rows) = transposed(&self.column_start, &self.rows);
        let matrix = SymbolicSparseColMatRef::new_checked(n, n, &upper_start, None, &upper_rows);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        let symbolic =
            factorize_symbolic_cholesky(matrix, Side::Upper, SymmetricOrdering::Identity, params)
                .map_err(|_| FemError::TooLarge { n_dofs: n })?;
        self.symbolic = Some(symbolic);
        Ok(())
    }

    /// Add the symmetric matrix of one element to the values of the lower triangle.
    ///
    /// # Shapes
    ///
    /// `nodes` the element's nodes; `blocks` one 3x3 block a pair `a >= b`, row by row, rows of
    /// node `a`; `values` one entry an entry of the pattern.
    pub(crate) fn add_element_into(
        &self,
        element: usize,
        nodes: &[u32],
        blocks: &[[f64; 9]],
        values: &mut [f64],
    ) {
        let n_pairs = blocks.len();
        let offsets = &self.block_offset[element * n_pairs..(element + 1) * n_pairs];
        let mut pair = 0;
        for a in 0..nodes.len() {
            for b in 0..=a {
                let (na, nb) = (nodes[a] as usize, nodes[b] as usize);
                let (offset, block) = (offsets[pair], &blocks[pair]);
                pair += 1;
                if self.position[na] == NONE || self.position[nb] == NONE {
                    continue;
                }
                if self.position[na] >= self.position[nb] {
                    self.add_block(na, nb, offset, |i, k| block[3 * i + k], values);
                } else {
                    self.add_block(nb, na, offset, |i, k| block[3 * k + i], values);
                }
            }
        }
    }

    /// Add one block whose rows belong to `row_node`, eliminated no earlier than `column_node`.
    #[inline(always)]
    fn add_block(
        &self,
        row_node: usize,
        column_node: usize,
        offset: u32,
        block: impl Fn(usize, usize) -> f64,
        values: &mut [f64],
    ) {
        let row_unknowns = &self.flat2unknown[3 * row_node..3 * row_node + 3];
        let column_unknowns = &self.flat2unknown[3 * column_node..3 * column_node + 3];
        let n_columns = column_unknowns.iter().filter(|&&u| u != NONE).count() as u32;
        let mut rank = 0;
        for k in 0..3 {
            let column = column_unknowns[k];
            if column == NONE {
                continue;
            }
            let start = self.column_start[column as usize];
            let mut place =
                if row_node == column_node { start } else { start + (n_columns - rank) + offset };
            for i in 0..3 {
                let row = row_unknowns[i];
                if row == NONE || (row_node == column_node && row < column) {
                    continue;
                }
                values[place as usize] += block(i, k);
                place += 1;
            }
            rank += 1;
        }
    }
}

/// Compressed columns of the transpose of a square pattern.
fn transposed(start: &[u32], rows: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let n = start.len() - 1;
    let mut new_start = vec![0u32; n + 1];
    for &row in rows {
        new_start[row as usize + 1] += 1;
    }
    for k in 0..n {
        new_start[k + 1] += new_start[k];
    }
    let mut cursor = new_start.clone();
    let mut new_rows = vec![0u32; rows.len()];
    for column in 0..n {
        for &row in &rows[start[column] as usize..start[column + 1] as usize] {
            new_rows[cursor[row as usize] as usize] = column as u32;
            cursor[row as usize] += 1;
        }
    }
    (new_start, new_rows)
}

/// Node-level lower triangle in elimination order.
struct LowerColumns {
    /// Node at each position.
    node: Vec<u32>,
    start: Vec<usize>,
    /// Nodes below the diagonal of each column, by ascending position.
    below: Vec<u32>,
    /// Number of unknowns of the column's nodes before each of `below`.
    offset: Vec<u32>,
    /// Position of each of `below`.
    below_position: Vec<u32>,
}

impl LowerColumns {
    fn new(graph: &Graph, order: &[u32], place: &[u32], free: &[u32], pattern: &Pattern) -> Self {
        let n_free = |node: u32| {
            let flat = 3 * node as usize;
            pattern.flat2unknown[flat..flat + 3].iter().filter(|&&u| u != NONE).count() as u32
        };
        let mut columns = Self {
            node: order.iter().map(|&v| free[v as usize]).collect(),
            start: vec![0],
            below: Vec::new(),
            offset: Vec::new(),
            below_position: Vec::new(),
        };
        let mut later = Vec::new();
        for (position, &v) in order.iter().enumerate() {
            later.clear();
            later.extend(
                graph
                    .neighbours(v as usize)
                    .iter()
                    .map(|&w| (place[w as usize], free[w as usize]))
                    .filter(|&(p, _)| p as usize > position),
            );
            later.sort_unstable();
            let mut offset = 0;
            for &(p, node) in &later {
                columns.below.push(node);
                columns.below_position.push(p);
                columns.offset.push(offset);
                offset += n_free(node);
            }
            columns.start.push(columns.below.len());
        }
        columns
    }

    fn below(&self, position: usize) -> &[u32] {
        &self.below[self.start[position]..self.start[position + 1]]
    }

    /// Offset of the block of two nodes of an element, or 0 for a diagonal or held block.
    fn offset(&self, pa: u32, pb: u32) -> u32 {
        if pa == NONE || pb == NONE || pa == pb {
            return 0;
        }
        let (row, column) = (pa.max(pb), pa.min(pb) as usize);
        let range = self.start[column]..self.start[column + 1];
        match self.below_position[range.clone()].binary_search(&row) {
            Ok(k) => self.offset[range.start + k],
            Err(_) => 0,
        }
    }
}
