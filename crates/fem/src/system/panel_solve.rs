//! Solutions with one panel, as many numbers at once as the processor takes.

use pulp::Simd;

use super::entry::{Entry, Precision};
use super::fronts::{BLOCK, STEP, Step};
use super::panels::{Column, Stored};

/// Forward through one panel; as a type, so that it is compiled for the processor at hand.
pub(super) struct Eliminate<'a, E: Entry> {
    pub(super) stored: Stored<'a, E>,
    pub(super) x: &'a mut [E::Real],
}

impl<E: Entry> pulp::WithSimd for Eliminate<'_, E> {
    type Output = ();

    /// `x_own <- L_own⁻¹ x_own`, `x_rows <- x_rows − L_rows x_own`
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        for &step in self.stored.steps {
            let x = &mut self.x[step.first..];
            match step.n_columns {
                1 => eliminate::<S, E, 1>(simd, self.stored, step, x),
                2 => eliminate::<S, E, 2>(simd, self.stored, step, x),
                3 => eliminate::<S, E, 3>(simd, self.stored, step, x),
                4 => eliminate::<S, E, 4>(simd, self.stored, step, x),
                5 => eliminate::<S, E, 5>(simd, self.stored, step, x),
                6 => eliminate::<S, E, 6>(simd, self.stored, step, x),
                7 => eliminate::<S, E, 7>(simd, self.stored, step, x),
                _ => eliminate::<S, E, STEP>(simd, self.stored, step, x),
            }
        }
    }
}

/// Back through one panel.
pub(super) struct Substitute<'a, E: Entry> {
    pub(super) stored: Stored<'a, E>,
    pub(super) x: &'a mut [E::Real],
}

impl<E: Entry> pulp::WithSimd for Substitute<'_, E> {
    type Output = ();

    /// `x_own <- L_own⁻ᵀ (x_own − L_rowsᵀ x_rows)`
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        for &step in self.stored.steps.iter().rev() {
            let x = &mut self.x[step.first..];
            match step.n_columns {
                1 => substitute::<S, E, 1>(simd, self.stored, step, x),
                2 => substitute::<S, E, 2>(simd, self.stored, step, x),
                3 => substitute::<S, E, 3>(simd, self.stored, step, x),
                4 => substitute::<S, E, 4>(simd, self.stored, step, x),
                5 => substitute::<S, E, 5>(simd, self.stored, step, x),
                6 => substitute::<S, E, 6>(simd, self.stored, step, x),
                7 => substitute::<S, E, 7>(simd, self.stored, step, x),
                _ => substitute::<S, E, STEP>(simd, self.stored, step, x),
            }
        }
    }
}

/// Forward through the `C` columns of a step; `x` begins with their own rows.
#[inline(always)]
fn eliminate<S: Simd, E: Entry, const C: usize>(
    simd: S,
    stored: Stored<E>,
    step: Step,
    x: &mut [E::Real],
) {
    let (own, below) = x.split_at_mut(C);
    let head = &stored.panel[step.begin..step.begin + C * STEP];
    let mut scaled = [E::Real::default(); C];
    for c in 0..C {
        let Column { scale, inverse_pivot } = stored.columns[step.first + c];
        own[c] *= inverse_pivot;
        scaled[c] = E::Real::default() - own[c] * scale;
        for i in c + 1..C {
            own[i] += head[c * STEP + i].real() * scaled[c];
        }
    }
    let mut values = [E::Real::splat(simd, E::Real::default()); C];
    for c in 0..C {
        values[c] = E::Real::splat(simd, scaled[c]);
    }
    let blocks = stored.panel[step.blocks()..step.end()].chunks_exact(C * BLOCK);
    for (block, rows) in blocks.zip(below[..step.n_rows].chunks_mut(BLOCK)) {
        if rows.len() == BLOCK {
            add_columns::<S, E, C>(simd, block, &values, rows);
        } else {
            let mut whole = [E::Real::default(); BLOCK];
            whole[..rows.len()].copy_from_slice(rows);
            add_columns::<S, E, C>(simd, block, &values, &mut whole);
            rows.copy_from_slice(&whole[..rows.len()]);
        }
    }
}

/// `rows <- rows + Σ_c column_c value_c`
#[inline(always)]
fn add_columns<S: Simd, E: Entry, const C: usize>(
    simd: S,
    block: &[E],
    values: &[<E::Real as Precision>::Lanes<S>; C],
    rows: &mut [E::Real],
) {
    let columns = block.as_chunks::<BLOCK>().0;
    for (k, x) in E::Real::lanes_mut::<S>(rows).iter_mut().enumerate() {
        let mut sum = *x;
        for c in 0..C {
            let column = E::widen(&columns[c]);
            sum = E::Real::mul_add(simd, E::Real::lanes::<S>(&column)[k], values[c], sum);
        }
        *x = sum;
    }
}

/// Back through the `C` columns of a step; `x` begins with their own rows.
#[inline(always)]
fn substitute<S: Simd, E: Entry, const C: usize>(
    simd: S,
    stored: Stored<E>,
    step: Step,
    x: &mut [E::Real],
) {
    let (own, below) = x.split_at_mut(C);
    let mut sums = [E::Real::splat(simd, E::Real::default()); C];
    let blocks = stored.panel[step.blocks()..step.end()].chunks_exact(C * BLOCK);
    // Backwards, as all of the factor is read.
    for (block, rows) in blocks.zip(below[..step.n_rows].chunks(BLOCK)).rev() {
        if rows.len() == BLOCK {
            add_products::<S, E, C>(simd, block, rows, &mut sums);
        } else {
            let mut whole = [E::Real::default(); BLOCK];
            whole[..rows.len()].copy_from_slice(rows);
            add_products::<S, E, C>(simd, block, &whole, &mut sums);
        }
    }
    let head = &stored.panel[step.begin..step.begin + C * STEP];
    for c in (0..C).rev() {
        let Column { scale, inverse_pivot } = stored.columns[step.first + c];
        let mut sum = E::Real::sum(simd, sums[c]);
        for i in c + 1..C {
            sum += head[c * STEP + i].real() * own[i];
        }
        own[c] = (own[c] - sum * scale) * inverse_pivot;
    }
}

/// `sums_c <- sums_c + column_c · rows`, lane by lane.
#[inline(always)]
fn add_products<S: Simd, E: Entry, const C: usize>(
    simd: S,
    block: &[E],
    rows: &[E::Real],
    sums: &mut [<E::Real as Precision>::Lanes<S>; C],
) {
    let columns = block.as_chunks::<BLOCK>().0;
    for c in 0..C {
        let column = E::widen(&columns[c]);
        for (&x, &l) in E::Real::lanes::<S>(rows).iter().zip(E::Real::lanes::<S>(&column)) {
            sums[c] = E::Real::mul_add(simd, l, x, sums[c]);
        }
    }
}
