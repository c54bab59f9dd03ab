//! What observations feel of the points of a recorded step, backwards.

use rayon::prelude::*;

use super::common::{Common, PointState};
use super::follow::{Substance, follow_law};
use super::record::StepRecord;
use super::scalar::{Matrix, constant};
use super::tape::{Tape, Var};
use crate::material::{Matrix3, Parameter};

/// Derivatives of several observations by what points remember and by their moduli.
pub(crate) struct Backward {
    /// Number of observations.
    pub(crate) n: usize,
    /// By the memory, `[point][observation][number]`.
    pub(crate) memory: Vec<f64>,
    /// By Young's modulus and Poisson's ratio, `[point][observation]`.
    pub(crate) moduli: Vec<[f64; 2]>,
}

impl Backward {
    pub(crate) fn new(n: usize, n_points: usize, memory_len: usize) -> Self {
        Self {
            n,
            memory: vec![0.0; n * n_points * memory_len],
            moduli: vec![[0.0; 2]; n * n_points],
        }
    }
}

/// Numbers that a point depends on, on a tape: moduli, memory, and the displacement gradient where
/// it moves.
struct Inputs<'t> {
    moduli: [(Parameter, Var<'t>); 2],
    state: PointState<Var<'t>>,
    h: Matrix<Var<'t>>,
}

const MODULI: usize = 2;

impl<'t> Inputs<'t> {
    fn new(tape: &'t Tape, state: &PointState<f64>, h: &Matrix3, moves: bool) -> Self {
        let moduli = [Parameter::Young, Parameter::Poisson].map(|p| (p, tape.input(0.0)));
        let state = state.map(|value| tape.input(value));
        let h = match moves {
            true => h.map(|row| row.map(|value| tape.input(value))),
            false => constant(h),
        };
        Self { moduli, state, h }
    }
}

impl StepRecord {
    fn plain(&self, substance: Substance) -> Common<f64> {
        let numbers = substance.behaviour.numbers(|_, value| value);
        Common::new(&numbers, substance.behaviour.is_split(), self.length, self.time)
    }

    /// Take the derivatives by the memory after the step to those by the memory before it, and return
    /// those by the displacement gradients, `[point][observation]`.
    pub(crate) fn memory_back(
        &self,
        substance: Substance,
        gradients: &[Matrix3],
        back: &mut Backward,
    ) -> Option<Vec<Matrix3>> {
        let common = self.plain(substance);
        let (n, width) = (back.n, self.memory_len());
        let mut by_gradient = vec![[[0.0; 3]; 3]; n * gradients.len()];
        let one = |work: &mut Work,
                   index: usize,
                   memory: &mut [f64],
                   moduli: &mut [[f64; 2]],
                   by_h: &mut [Matrix3]| {
            if memory.iter().all(|&v| v == 0.0) {
                return Some(());
            }
            work.tape.clear();
            let inputs = Inputs::new(&work.tape, &self.before[index], &gradients[index], true);
            let lifted = common.lifted();
            let at = lifted.point(&inputs.state);
            let law = law_of(substance, index);
            let mut after = inputs.state.clone();
            lifted.update(&at, &inputs.h, |he| follow_law(&law, &inputs.moduli, he), &mut after)?;
            let mut places = Vec::with_capacity(width);
            after.for_each(|number: Var| places.push(number.place()));
            for (k, memory) in memory.chunks_exact_mut(width).enumerate() {
                let weights = &mut work.weights;
                weights.clear();
                weights.resize(work.tape.len(), 0.0);
                for (place, weight) in places.iter().zip(memory.iter()) {
                    if let Some(place) = place {
                        weights[*place] += weight;
                    }
                }
                work.tape.sweep(weights);
                let (own, rest) = weights[MODULI..].split_at(width);
                memory.copy_from_slice(own);
                (0..MODULI).for_each(|m| moduli[k][m] += weights[m]);
                by_h[k].as_flattened_mut().copy_from_slice(&rest[..9]);
            }
            Some(())
        };
        let done: Option<Vec<()>> = back
            .memory
            .par_chunks_mut((n * width).max(1))
            .zip(back.moduli.par_chunks_mut(n.max(1)))
            .zip(by_gradient.par_chunks_mut(n.max(1)))
            .enumerate()
            .with_min_len(64)
            .map_init(Work::default, |work, (index, ((memory, moduli), by_h))| {
                one(work, index, memory, moduli, by_h)
            })
            .collect();
        done.map(|_| by_gradient)
    }

    /// Add what the observations feel of the stress at fixed displacement, where each weighs it by
    /// `pulls`, `[observation][point]`.
    pub(crate) fn stress_back(
        &self,
        substance: Substance,
        gradients: &[Matrix3],
        pulls: &[Vec<Matrix3>],
        back: &mut Backward,
    ) -> Option<()> {
        let common = self.plain(substance);
        let (n, width) = (back.n, self.memory_len());
        let one = |work: &mut Work, index: usize, memory: &mut [f64], moduli: &mut [[f64; 2]]| {
            work.tape.clear();
            let inputs = Inputs::new(&work.tape, &self.before[index], &gradients[index], false);
            let lifted = common.lifted();
            let at = lifted.point(&inputs.state);
            let law = law_of(substance, index);
            let answer =
                lifted.response(&at, &inputs.h, |he| follow_law(&law, &inputs.moduli, he))?;
            for (k, memory) in memory.chunks_exact_mut(width).enumerate() {
                let weights = &mut work.weights;
                weights.clear();
                weights.resize(work.tape.len(), 0.0);
                let pull = pulls[k][index].as_flattened();
                for (number, weight) in answer.stress.as_flattened().iter().zip(pull) {
                    if let Some(place) = number.place() {
                        weights[place] += weight;
                    }
                }
                work.tape.sweep(weights);
                let own = &weights[MODULI..MODULI + width];
                memory.iter_mut().zip(own).for_each(|(sum, v)| *sum += v);
                (0..MODULI).for_each(|m| moduli[k][m] += weights[m]);
            }
            Some(())
        };
        let done: Option<Vec<()>> = back
            .memory
            .par_chunks_mut((n * width).max(1))
            .zip(back.moduli.par_chunks_mut(n.max(1)))
            .enumerate()
            .with_min_len(64)
            .map_init(Work::default, |work, (index, (memory, moduli))| {
                one(work, index, memory, moduli)
            })
            .collect();
        done.map(|_| ())
    }
}

fn law_of(substance: Substance, index: usize) -> crate::material::Law {
    substance.material.law_at(index / substance.n_points, index % substance.n_points)
}

/// Buffers of one thread.
#[derive(Default)]
struct Work {
    tape: Tape,
    weights: Vec<f64>,
}
