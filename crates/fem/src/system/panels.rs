//! Panels as they are kept: written from eliminated fronts.

use super::entry::{Entry, Precision};
use super::fronts::{BLOCK, STEP, Step};

/// One column of the factor, apart from its entries below the diagonal.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Column<R> {
    /// Of the entries below the diagonal.
    pub(super) scale: R,
    /// One over the entry on the diagonal.
    pub(super) inverse_pivot: R,
}

/// One front of a factor.
#[derive(Clone, Copy)]
pub(super) struct Stored<'a, E: Entry> {
    pub(super) steps: &'a [Step],
    pub(super) panel: &'a [E],
    pub(super) columns: &'a [Column<E::Real>],
}

/// What some consecutive fronts write.
pub(super) struct Slots<'a, E: Entry> {
    pub(super) panels: &'a mut [E],
    pub(super) columns: &'a mut [Column<E::Real>],
}

impl<'a, E: Entry> Slots<'a, E> {
    /// The first fronts, of so many entries and columns, and the others.
    pub(super) fn split(self, entries: usize, columns: usize) -> (Slots<'a, E>, Slots<'a, E>) {
        let (panels, other_panels) = self.panels.split_at_mut(entries);
        let (columns, other_columns) = self.columns.split_at_mut(columns);
        (Self { panels, columns }, Self { panels: other_panels, columns: other_columns })
    }
}

/// Adds the squares of the rows of a panel; a type, so that it is compiled for the processor at
/// hand.
pub(super) struct AddSquares<'a, E: Entry> {
    pub(super) stored: Stored<'a, E>,
    pub(super) squares: &'a mut [E::Real],
}

impl<E: Entry> pulp::WithSimd for AddSquares<'_, E> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        let one = E::Real::from_f64(1.0);
        let Stored { steps, panel, columns } = self.stored;
        for step in steps {
            let n = step.n_columns;
            let head = &panel[step.begin..step.blocks()];
            let blocks = &panel[step.blocks()..step.end()];
            let (own, below) = self.squares[step.first..].split_at_mut(n);
            for j in 0..n {
                let Column { scale, inverse_pivot } = columns[step.first + j];
                let (pivot, factor) = (one / inverse_pivot, scale * scale);
                own[j] += pivot * pivot;
                for i in j + 1..n {
                    let v = head[j * STEP + i].real();
                    own[i] += v * v * factor;
                }
                for (block, rows) in blocks.chunks(n * BLOCK).zip(below.chunks_mut(BLOCK)) {
                    let column = &block[j * BLOCK..(j + 1) * BLOCK];
                    for (square, v) in rows.iter_mut().zip(column) {
                        *square += v.real() * v.real() * factor;
                    }
                }
            }
        }
    }
}

/// Stores the columns of an eliminated front.
pub(super) struct Store<'a, E: Entry> {
    pub(super) steps: &'a [Step],
    /// Rows of the front.
    pub(super) size: usize,
    /// Column by column.
    pub(super) eliminated: &'a [E::Real],
    pub(super) slots: Slots<'a, E>,
}

impl<E: Entry> pulp::WithSimd for Store<'_, E> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        let one = E::Real::from_f64(1.0);
        for step in self.steps {
            let n = step.n_columns;
            let (head, blocks) = self.slots.panels[step.begin..step.end()].split_at_mut(n * STEP);
            for j in 0..n {
                let diagonal = (step.first + j) * (self.size + 1);
                let column = &self.eliminated[diagonal..][..n - j + step.n_rows];
                let (own, below) = column.split_at(n - j);
                let scale = E::scale(&column[1..]);
                let inverse_pivot = one / own[0];
                self.slots.columns[step.first + j] = Column { scale, inverse_pivot };
                E::store(&own[1..], scale, &mut head[j * STEP + j + 1..j * STEP + n]);
                for (block, rows) in blocks.chunks_mut(n * BLOCK).zip(below.chunks(BLOCK)) {
                    E::store(rows, scale, &mut block[j * BLOCK..j * BLOCK + rows.len()]);
                }
            }
        }
    }
}
