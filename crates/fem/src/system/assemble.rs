//! Filling a front: blocks of cliques and the updates of its children.

use super::entry::Precision;
use super::fronts::{Front, Fronts, Spot};

/// Clear a matrix by columns on and below the diagonal.
pub(super) fn clear_lower<T: Precision>(matrix: &mut [T], n_rows: usize, n_columns: usize) {
    for j in 0..n_columns {
        matrix[j * (n_rows + 1)..(j + 1) * n_rows].fill(T::default());
    }
}

/// A front while it is assembled.
pub(super) struct Target<'a, T> {
    pub(super) front: &'a Front,
    pub(super) panel: &'a mut [T],
    pub(super) update: &'a mut [T],
}

impl<T: Precision> Target<'_, T> {
    /// Add the block of rows of spot `a` and columns of spot `b`.
    #[inline(always)]
    pub(super) fn add_block(&mut self, a: Spot, b: Spot, diagonal: bool, block: &[f64; 9]) {
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
pub(super) fn add_update<T: Precision>(
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
    // Rows that stand together in the child mostly do so in the parent.
    let runs: Vec<&[u32]> = places.chunk_by(|a, b| a + 1 == *b).collect();
    let mut j = 0;
    // Places ascend: a parent's rows and own unknowns stand in elimination order.
    for (k, run) in runs.iter().enumerate() {
        for (skipped, &column) in run.iter().enumerate() {
            let column = column as usize;
            let (target, shift) = if column < front.n_own {
                (&mut panel[column * front.size()..(column + 1) * front.size()], 0)
            } else {
                let start = (column - front.n_own) * front.n_rows;
                (&mut update[start..start + front.n_rows], front.n_own)
            };
            let mut source = &child_update[j * n + j..(j + 1) * n];
            let rest_of_run = &run[skipped..];
            for rows in std::iter::once(&rest_of_run).chain(&runs[k + 1..]) {
                let (values, behind) = source.split_at(rows.len());
                source = behind;
                let begin = rows[0] as usize - shift;
                for (t, &value) in target[begin..begin + rows.len()].iter_mut().zip(values) {
                    *t += value;
                }
            }
            j += 1;
        }
    }
}
