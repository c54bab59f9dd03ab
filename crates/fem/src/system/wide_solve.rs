//! Solutions with one panel for many right-hand sides at once.
//!
//! A row of the local vector holds one number a right-hand side, so that an entry of the panel, once
//! read, serves all of them. Every right-hand side is worked on in its own lane and in one order: its
//! bits do not depend on what surrounds it.

use pulp::Simd;

use super::entry::{Entry, Precision};
use super::fronts::{BLOCK, STEP, Step};
use super::panels::{Column, Stored};

/// Rows that are held in registers together.
const TILE: usize = 4;

/// Columns whose products are summed together.
const TOGETHER: usize = 4;

/// Calls `$run` with as many vectors as a row of `W` numbers takes.
macro_rules! with_vectors {
    ($run:ident, $simd:expr, $stored:expr, $step:expr, $x:expr) => {
        match const { W * size_of::<E::Real>() / size_of::<<E::Real as Precision>::Lanes<S>>() } {
            0 => {}
            1 => $run::<S, E, W, 1>($simd, $stored, $step, $x),
            2 => $run::<S, E, W, 2>($simd, $stored, $step, $x),
            4 => $run::<S, E, W, 4>($simd, $stored, $step, $x),
            8 => $run::<S, E, W, 8>($simd, $stored, $step, $x),
            _ => $run::<S, E, W, 16>($simd, $stored, $step, $x),
        }
    };
}

/// Forward through one panel; as a type, so that it is compiled for the processor at hand.
pub(super) struct EliminateWide<'a, E: Entry, const W: usize> {
    pub(super) stored: Stored<'a, E>,
    pub(super) x: &'a mut [[E::Real; W]],
}

impl<E: Entry, const W: usize> pulp::WithSimd for EliminateWide<'_, E, W> {
    type Output = ();

    /// `x_own <- L_own⁻¹ x_own`, `x_rows <- x_rows − L_rows x_own`
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for &step in self.stored.steps {
            let x = &mut self.x[step.first..];
            with_vectors!(eliminate, simd, self.stored, step, x);
        }
    }
}

/// Back through one panel.
pub(super) struct SubstituteWide<'a, E: Entry, const W: usize> {
    pub(super) stored: Stored<'a, E>,
    pub(super) x: &'a mut [[E::Real; W]],
}

impl<E: Entry, const W: usize> pulp::WithSimd for SubstituteWide<'_, E, W> {
    type Output = ();

    /// `x_own <- L_own⁻ᵀ (x_own − L_rowsᵀ x_rows)`
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for &step in self.stored.steps.iter().rev() {
            let x = &mut self.x[step.first..];
            with_vectors!(substitute, simd, self.stored, step, x);
        }
    }
}

/// `V` vectors, of a row or of a column.
type Row<S, E, const V: usize> = [<<E as Entry>::Real as Precision>::Lanes<S>; V];

#[inline(always)]
fn load<S: Simd, E: Entry, const W: usize, const V: usize>(row: &[E::Real; W]) -> Row<S, E, V> {
    let lanes = E::Real::lanes::<S>(row);
    std::array::from_fn(|v| lanes[v])
}

#[inline(always)]
fn store<S: Simd, E: Entry, const W: usize, const V: usize>(
    values: Row<S, E, V>,
    row: &mut [E::Real; W],
) {
    E::Real::lanes_mut::<S>(row)[..V].copy_from_slice(&values);
}

/// `a b + c`, `a` one number for all.
#[inline(always)]
fn mul_add<S: Simd, E: Entry, const V: usize>(
    simd: S,
    a: E::Real,
    b: &Row<S, E, V>,
    c: &Row<S, E, V>,
) -> Row<S, E, V> {
    let a = E::Real::splat(simd, a);
    std::array::from_fn(|v| E::Real::mul_add(simd, a, b[v], c[v]))
}

/// Forward through the columns of a step; `x` begins with their own rows.
#[inline(always)]
fn eliminate<S: Simd, E: Entry, const W: usize, const V: usize>(
    simd: S,
    stored: Stored<E>,
    step: Step,
    x: &mut [[E::Real; W]],
) {
    let zero = [E::Real::splat(simd, E::Real::default()); V];
    let n = step.n_columns;
    let (own, below) = x.split_at_mut(n);
    let head = &stored.panel[step.begin..step.blocks()];
    let mut scaled = [zero; STEP];
    for c in 0..n {
        let Column { scale, inverse_pivot } = stored.columns[step.first + c];
        let value = mul_add::<S, E, V>(simd, inverse_pivot, &load::<S, E, W, V>(&own[c]), &zero);
        store::<S, E, W, V>(value, &mut own[c]);
        scaled[c] = mul_add::<S, E, V>(simd, E::Real::default() - scale, &value, &zero);
        for i in c + 1..n {
            let l = head[c * STEP + i].real();
            let row = mul_add::<S, E, V>(simd, l, &scaled[c], &load::<S, E, W, V>(&own[i]));
            store::<S, E, W, V>(row, &mut own[i]);
        }
    }
    let blocks = stored.panel[step.blocks()..step.end()].chunks_exact(n * BLOCK);
    for (block, rows) in blocks.zip(below[..step.n_rows].chunks_mut(BLOCK)) {
        let (tiles, rest) = rows.as_chunks_mut::<TILE>();
        let first = TILE * tiles.len();
        for (t, tile) in tiles.iter_mut().enumerate() {
            add_columns::<S, E, W, V, TILE>(simd, block, &scaled[..n], TILE * t, tile);
        }
        for (k, row) in rest.iter_mut().enumerate() {
            let row = std::array::from_mut(row);
            add_columns::<S, E, W, V, 1>(simd, block, &scaled[..n], first + k, row);
        }
    }
}

/// `rows <- rows + Σ_c column_c value_c` for rows from the one at `first` of a block on.
#[inline(always)]
fn add_columns<S: Simd, E: Entry, const W: usize, const V: usize, const T: usize>(
    simd: S,
    block: &[E],
    values: &[Row<S, E, V>],
    first: usize,
    rows: &mut [[E::Real; W]; T],
) {
    let mut sums: [Row<S, E, V>; T] = std::array::from_fn(|k| load::<S, E, W, V>(&rows[k]));
    for (column, value) in block.as_chunks::<BLOCK>().0.iter().zip(values) {
        let entries = &column[first..first + T];
        for k in 0..T {
            sums[k] = mul_add::<S, E, V>(simd, entries[k].real(), value, &sums[k]);
        }
    }
    for k in 0..T {
        store::<S, E, W, V>(sums[k], &mut rows[k]);
    }
}

/// Back through the columns of a step; `x` begins with their own rows.
#[inline(always)]
fn substitute<S: Simd, E: Entry, const W: usize, const V: usize>(
    simd: S,
    stored: Stored<E>,
    step: Step,
    x: &mut [[E::Real; W]],
) {
    let zero = [E::Real::splat(simd, E::Real::default()); V];
    let n = step.n_columns;
    let (own, below) = x.split_at_mut(n);
    let mut sums = [zero; STEP];
    let blocks = stored.panel[step.blocks()..step.end()].chunks_exact(n * BLOCK);
    // Backwards, as all of the factor is read.
    for (block, rows) in blocks.zip(below[..step.n_rows].chunks(BLOCK)).rev() {
        let columns = block.as_chunks::<BLOCK>().0;
        let (groups, rest) = columns.as_chunks::<TOGETHER>();
        let (group_sums, rest_sums) = sums[..n].as_chunks_mut::<TOGETHER>();
        for (columns, sums) in groups.iter().zip(group_sums) {
            add_products::<S, E, W, V, TOGETHER>(simd, columns, rows, sums);
        }
        for (column, sum) in rest.iter().zip(rest_sums) {
            let (column, sum) = (std::array::from_ref(column), std::array::from_mut(sum));
            add_products::<S, E, W, V, 1>(simd, column, rows, sum);
        }
    }
    let head = &stored.panel[step.begin..step.blocks()];
    for c in (0..n).rev() {
        let Column { scale, inverse_pivot } = stored.columns[step.first + c];
        let mut sum = sums[c];
        for i in c + 1..n {
            let l = head[c * STEP + i].real();
            sum = mul_add::<S, E, V>(simd, l, &load::<S, E, W, V>(&own[i]), &sum);
        }
        let minus = E::Real::default() - scale;
        let value = mul_add::<S, E, V>(simd, minus, &sum, &load::<S, E, W, V>(&own[c]));
        let value = mul_add::<S, E, V>(simd, inverse_pivot, &value, &zero);
        store::<S, E, W, V>(value, &mut own[c]);
    }
}

/// `sums_c <- sums_c + column_c · rows`
#[inline(always)]
fn add_products<S: Simd, E: Entry, const W: usize, const V: usize, const T: usize>(
    simd: S,
    columns: &[[E; BLOCK]; T],
    rows: &[[E::Real; W]],
    sums: &mut [Row<S, E, V>; T],
) {
    let mut own = *sums;
    for (r, row) in rows.iter().enumerate().take(BLOCK) {
        let row = load::<S, E, W, V>(row);
        for k in 0..T {
            own[k] = mul_add::<S, E, V>(simd, columns[k][r].real(), &row, &own[k]);
        }
    }
    *sums = own;
}
