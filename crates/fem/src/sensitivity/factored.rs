//! A factored tangent and its solutions, many at a time, refined where the factor is single.
//!
//! With a factor `S` of `K` in single precision, `x <- x + S⁻¹ (b − K x)` with the product in double
//! precision contracts the error by `|1 − S⁻¹ K|`, about the condition of `K` times 6e-8. A solution is
//! taken when its last correction, times that contraction, is below [`REFINED`]. Every column is judged
//! by itself.

use std::sync::Arc;

use crate::assembly::TangentKind;
use crate::body::Body;
use crate::error::FemError;
use crate::solve::{Precision, Problem, State};
use crate::system::factor::{Entries, Factor};
use crate::system::{Operator, SolveScratch};

/// Error of a refined solution over its size.
const REFINED: f64 = 1e-9;

/// Corrections after which a column counts as lost.
const MOST_CORRECTIONS: usize = 12;

/// Largest contraction with which a single factor is kept; at it a solution takes six corrections.
const CONTRACTION: f64 = 0.03;

/// The exact tangent at an equilibrium, factored.
#[derive(Debug)]
pub(crate) struct Factored {
    pub(crate) factor: Arc<Factor>,
    /// The tangent itself, where the factor is single.
    operator: Option<Operator>,
    /// Factors made on the way, the one that failed included.
    pub(crate) factorisations: usize,
}

/// Buffers of refined solutions.
#[derive(Default)]
pub(crate) struct Buffers {
    pub(crate) solve: SolveScratch,
    values: [Vec<f64>; 3],
}

impl Factored {
    /// Factor the tangent at a state.
    ///
    /// # Errors
    ///
    /// [`FemError::SingularStiffness`], [`FemError::Cancelled`], [`FemError::TooLarge`].
    pub(super) fn new(
        problem: &Problem,
        state: &State,
        precision: Precision,
    ) -> Result<Self, FemError> {
        let make = |entries| problem.factor_in(state, TangentKind::Exact, entries);
        let factor = match precision {
            Precision::Double => make(Entries::Double)?,
            Precision::Single => make(Entries::SingleOrDouble)?,
        };
        let is_single = matches!(factor, Factor::Single(_));
        let factorisations = if is_single || precision == Precision::Double { 1 } else { 2 };
        let mut factored = Self { factor: Arc::new(factor), operator: None, factorisations };
        if is_single {
            let is_free = |axes: &[bool; 3]| *axes != [true; 3];
            let wanted: Vec<bool> = problem.body.held().iter().map(is_free).collect();
            factored.operator = problem.operator(state, &wanted);
            if !factored.contracts(problem.body, problem.parallel) {
                let factor = Arc::new(make(Entries::Double)?);
                factored = Self { factor, operator: None, factorisations: 2 };
            }
        }
        Ok(factored)
    }

    /// Whether corrections of a trial solution shrink fast.
    fn contracts(&self, body: &Body, parallel: bool) -> bool {
        let pattern = body.pattern();
        let mut buffers = Buffers::default();
        // No two neighbours pull alike.
        let pull =
            |&flat: &u32| [if flat.wrapping_mul(0x9E37_79B9) >> 31 == 0 { 1.0 } else { -1.0 }];
        let rhs: Vec<[f64; 1]> = pattern.unknown2flat.iter().map(pull).collect();
        let mut x = vec![[0.0]; rhs.len()];
        self.factor.solve_wide_into(
            &pattern.fronts,
            1.0,
            &rhs,
            &mut x,
            &mut buffers.solve,
            parallel,
        );
        let mut last = norms(&x)[0];
        for _ in 0..2 {
            let correction = norms(self.correction(body, &rhs, &x, &mut buffers, parallel))[0];
            if correction.is_nan() || correction > CONTRACTION * last {
                return false;
            }
            add(&mut x, self.last_correction(&buffers, rhs.len()), &[false]);
            last = correction.max(REFINED * norms(&x)[0]);
        }
        true
    }

    /// Write `K⁻¹ rhs` of `W` right-hand sides on the unknowns to `out`; the number of corrections.
    ///
    /// # Errors
    ///
    /// [`FemError::BadSetting`] where a single factor turns out not to suffice.
    pub(crate) fn solve_into<const W: usize>(
        &self,
        body: &Body,
        rhs: &[[f64; W]],
        out: &mut [[f64; W]],
        buffers: &mut Buffers,
        parallel: bool,
    ) -> Result<usize, FemError> {
        let fronts = &body.pattern().fronts;
        self.factor.solve_wide_into(fronts, 1.0, rhs, out, &mut buffers.solve, parallel);
        if self.operator.is_none() {
            return Ok(0);
        }
        let mut last = norms(out);
        let mut done = last.map(|size| size == 0.0);
        let mut corrections = 0;
        let mut largest = 0.0;
        for _ in 0..MOST_CORRECTIONS {
            let found = norms(self.correction(body, rhs, out, buffers, parallel));
            corrections += done.iter().filter(|done| !**done).count();
            add(out, self.last_correction(buffers, rhs.len()), &done);
            let sizes = norms(out);
            largest = 0.0_f64;
            for w in 0..W {
                // The first answer counts as a correction of nothing.
                let contraction = found[w] / last[w].max(f64::MIN_POSITIVE);
                let left = found[w] * contraction.min(1.0) / sizes[w].max(f64::MIN_POSITIVE);
                done[w] = done[w] || left <= REFINED;
                largest = if done[w] { largest } else { left.max(largest) };
            }
            last = found;
            if done == [true; W] {
                return Ok(corrections);
            }
        }
        let must = "double where the tangent is as close to singular as here (error left)";
        Err(FemError::BadSetting { name: "precision", must, found: largest })
    }

    /// `S⁻¹ (rhs − K x)`, kept in the buffers.
    fn correction<'b, const W: usize>(
        &self,
        body: &Body,
        rhs: &[[f64; W]],
        x: &[[f64; W]],
        buffers: &'b mut Buffers,
        parallel: bool,
    ) -> &'b [[f64; W]] {
        let pattern = body.pattern();
        let Buffers { solve, values: [at_nodes, residual, correction] } = buffers;
        at_nodes.clear();
        at_nodes.resize(3 * W * body.n_nodes(), 0.0);
        let flat = at_nodes.as_chunks_mut::<W>().0;
        for (row, &place) in x.iter().zip(&pattern.unknown2flat) {
            flat[place as usize] = *row;
        }
        residual.resize(3 * W * body.n_nodes(), 0.0);
        let of_nodes = residual.as_chunks_mut::<W>().0;
        if let Some(operator) = &self.operator {
            operator.product(flat, |node, rows| {
                of_nodes[3 * node..3 * node + 3].copy_from_slice(rows);
            });
        }
        // The place of the values at nodes is free again.
        let own = &mut flat[..rhs.len()];
        for ((own, rhs), &place) in own.iter_mut().zip(rhs).zip(&pattern.unknown2flat) {
            *own = std::array::from_fn(|w| rhs[w] - of_nodes[place as usize][w]);
        }
        correction.resize(W * rhs.len(), 0.0);
        let out = correction.as_chunks_mut::<W>().0;
        self.factor.solve_wide_into(&pattern.fronts, 1.0, own, out, solve, parallel);
        out
    }

    /// What [`Factored::correction`] has kept.
    fn last_correction<'b, const W: usize>(
        &self,
        buffers: &'b Buffers,
        n_unknowns: usize,
    ) -> &'b [[f64; W]] {
        &buffers.values[2].as_chunks::<W>().0[..n_unknowns]
    }
}

/// Add corrections to the columns that are not done.
fn add<const W: usize>(x: &mut [[f64; W]], corrections: &[[f64; W]], done: &[bool; W]) {
    for (x, correction) in x.iter_mut().zip(corrections) {
        for w in 0..W {
            x[w] += if done[w] { 0.0 } else { correction[w] };
        }
    }
}

/// Euclidean norm of every column.
fn norms<const W: usize>(rows: &[[f64; W]]) -> [f64; W] {
    let mut squares = [0.0; W];
    for row in rows {
        for w in 0..W {
            squares[w] += row[w] * row[w];
        }
    }
    squares.map(f64::sqrt)
}
