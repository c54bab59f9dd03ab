//! Rows of a matrix of cliques, put together: products with many vectors at once.

use super::cliques::Cliques;
use super::factor::Blocks;

/// 3x3 blocks of chosen nodes' rows.
#[derive(Debug)]
pub(crate) struct Operator {
    nodes: Vec<u32>,
    /// First block of each row, and their number.
    starts: Vec<usize>,
    /// Node of each block's column, ascending in a row.
    columns: Vec<u32>,
    blocks: Vec<[f64; 9]>,
}

impl Operator {
    /// Put together the rows of the nodes that are wanted; none where the matrix does not exist.
    ///
    /// # Shapes
    ///
    /// `wanted` one entry per node.
    pub(crate) fn new(cliques: Cliques, matrix: &impl Blocks, wanted: &[bool]) -> Option<Self> {
        let mut own = Self::pattern(cliques, wanted);
        let mut row_of = vec![u32::MAX; wanted.len()];
        for (row, &node) in own.nodes.iter().enumerate() {
            row_of[node as usize] = row as u32;
        }
        let mut blocks = Vec::new();
        for clique in 0..cliques.len() {
            let nodes = cliques.get(clique);
            if !nodes.iter().any(|&node| wanted[node as usize]) {
                continue;
            }
            blocks.resize(nodes.len() * (nodes.len() + 1) / 2, [0.0; 9]);
            if !matrix.blocks_into(clique, &mut blocks) {
                return None;
            }
            let mut pair = 0;
            for (a, &node) in nodes.iter().enumerate() {
                for (b, &other) in nodes[..=a].iter().enumerate() {
                    let block = &blocks[pair];
                    own.add(&row_of, node, other, block);
                    if b < a {
                        let across = std::array::from_fn(|k| block[3 * (k % 3) + k / 3]);
                        own.add(&row_of, other, node, &across);
                    }
                    pair += 1;
                }
            }
        }
        Some(own)
    }

    /// The rows without their values.
    fn pattern(cliques: Cliques, wanted: &[bool]) -> Self {
        let mut n_cliques = vec![0usize; wanted.len() + 1];
        for &node in cliques.nodes() {
            n_cliques[node as usize + 1] += 1;
        }
        for node in 0..wanted.len() {
            n_cliques[node + 1] += n_cliques[node];
        }
        let (first, mut next) = (&n_cliques, n_cliques.clone());
        let mut around = vec![0u32; cliques.nodes().len()];
        for clique in 0..cliques.len() {
            for &node in cliques.get(clique) {
                around[next[node as usize]] = clique as u32;
                next[node as usize] += 1;
            }
        }
        let nodes: Vec<u32> =
            (0..wanted.len()).filter(|&node| wanted[node]).map(|node| node as u32).collect();
        let (mut starts, mut columns) = (vec![0], Vec::new());
        let mut seen = vec![u32::MAX; wanted.len()];
        for &node in &nodes {
            let begin = columns.len();
            for &clique in &around[first[node as usize]..first[node as usize + 1]] {
                for &other in cliques.get(clique as usize) {
                    if std::mem::replace(&mut seen[other as usize], node) != node {
                        columns.push(other);
                    }
                }
            }
            columns[begin..].sort_unstable();
            starts.push(columns.len());
        }
        let blocks = vec![[0.0; 9]; columns.len()];
        Self { nodes, starts, columns, blocks }
    }

    fn add(&mut self, row_of: &[u32], node: u32, other: u32, block: &[f64; 9]) {
        let row = row_of[node as usize] as usize;
        if row_of[node as usize] == u32::MAX {
            return;
        }
        let (begin, end) = (self.starts[row], self.starts[row + 1]);
        let place = begin + self.columns[begin..end].partition_point(|&column| column < other);
        for (sum, value) in self.blocks[place].iter_mut().zip(block) {
            *sum += value;
        }
    }

    /// Call `take(node, rows)` with the three rows of the product of each node, in their order.
    ///
    /// # Shapes
    ///
    /// `x` `(3 n_nodes, W)`.
    pub(crate) fn product<const W: usize>(
        &self,
        x: &[[f64; W]],
        take: impl FnMut(usize, &[[f64; W]; 3]),
    ) {
        pulp::Arch::new().dispatch(Product { operator: self, x, take });
    }
}

/// A type, so that it is compiled for the processor at hand.
struct Product<'a, F, const W: usize> {
    operator: &'a Operator,
    x: &'a [[f64; W]],
    take: F,
}

impl<F: FnMut(usize, &[[f64; W]; 3]), const W: usize> pulp::WithSimd for Product<'_, F, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _simd: S) {
        let Operator { nodes, starts, columns, blocks } = self.operator;
        let x = self.x.as_chunks::<3>().0;
        for (row, &node) in nodes.iter().enumerate() {
            let mut sums = [[0.0; W]; 3];
            for k in starts[row]..starts[row + 1] {
                let (block, x) = (&blocks[k], &x[columns[k] as usize]);
                for i in 0..3 {
                    for j in 0..3 {
                        for w in 0..W {
                            sums[i][w] += block[3 * i + j] * x[j][w];
                        }
                    }
                }
            }
            (self.take)(node as usize, &sums);
        }
    }
}
