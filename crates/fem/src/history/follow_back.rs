//! What observations feel of the points of a recorded step, backwards.

use rayon::prelude::*;

use super::common::{Common, PointState};
use super::follow::{Substance, follow_law};
use super::record::StepRecord;
use super::scalar::{LANES, Matrix, constant};
use super::tape::{Tape, Var};
use crate::material::{Matrix3, Parameter};

/// Derivatives of several observations by what the points remember and by their moduli.
pub(crate) struct Backward {
    /// Number of observations.
    pub(crate) n: usize,
    pub(crate) points: Vec<PointBack>,
}

/// Derivatives of all observations at one point.
#[derive(Clone)]
pub(crate) struct PointBack {
    /// By the memory, `[observation][number]`; empty where nothing is remembered.
    memory: Vec<f64>,
    /// By Young's modulus and Poisson's ratio.
    pub(crate) moduli: Vec<[f64; 2]>,
}

impl Backward {
    pub(crate) fn new(n: usize, n_points: usize, memory_len: usize) -> Self {
        let one = PointBack { memory: vec![0.0; n * memory_len], moduli: vec![[0.0; 2]; n] };
        Self { n, points: vec![one; n_points] }
    }
}

/// Numbers that a point depends on, on a tape: moduli, memory, and the displacement gradient where
/// it moves.
struct Inputs<'t> {
    moduli: [(Parameter, Var<'t>); 2],
    state: PointState<Var<'t>>,
    h: Matrix<Var<'t>>,
}

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
    /// those by the displacement gradients, `[point][observation]`; nothing where none are felt.
    pub(crate) fn memory_back(
        &self,
        substance: Substance,
        gradients: &[Matrix3],
        back: &mut Backward,
    ) -> Option<Vec<Vec<Matrix3>>> {
        let plain = self.plain(substance);
        let (n, width) = (back.n, self.memory_len());
        let one = |Work { tape, weights }: &mut Work, (index, point): (usize, &mut PointBack)| {
            if point.memory.iter().all(|&v| v == 0.0) {
                return Some(Vec::new());
            }
            tape.clear();
            let inputs = Inputs::new(tape, &self.before[index], &gradients[index], true);
            let common = plain.lifted();
            let at = common.point(&inputs.state);
            let law = law_of(substance, index);
            let mut after = inputs.state.clone();
            common.update(&at, &inputs.h, |he| follow_law(&law, &inputs.moduli, he), &mut after)?;
            let mut places = Vec::with_capacity(width);
            after.for_each(|number: Var| places.push(number.place()));
            let mut by_gradient = vec![[[0.0; 3]; 3]; n];
            for first in (0..n).step_by(LANES) {
                begin(tape, weights);
                let some = first..n.min(first + LANES);
                for (lane, k) in some.clone().enumerate() {
                    for (place, weight) in places.iter().zip(&point.memory[k * width..]) {
                        if let Some(place) = place {
                            weights[*place][lane] += weight;
                        }
                    }
                }
                tape.sweep(weights);
                for (lane, k) in some.enumerate() {
                    let mut found = weights.iter().map(|lanes| lanes[lane]);
                    let mut next = || found.next().unwrap_or(0.0);
                    point.moduli[k].iter_mut().for_each(|sum| *sum += next());
                    point.memory[k * width..(k + 1) * width].fill_with(&mut next);
                    by_gradient[k].as_flattened_mut().fill_with(&mut next);
                }
            }
            Some(by_gradient)
        };
        let points = back.points.par_iter_mut().enumerate().with_min_len(64);
        points.map_init(Work::default, one).collect()
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
        let plain = self.plain(substance);
        let (n, width) = (back.n, self.memory_len());
        let one = |Work { tape, weights }: &mut Work, (index, point): (usize, &mut PointBack)| {
            tape.clear();
            let inputs = Inputs::new(tape, &self.before[index], &gradients[index], false);
            let common = plain.lifted();
            let at = common.point(&inputs.state);
            let law = law_of(substance, index);
            let answer =
                common.response(&at, &inputs.h, |he| follow_law(&law, &inputs.moduli, he))?;
            for first in (0..n).step_by(LANES) {
                begin(tape, weights);
                let some = first..n.min(first + LANES);
                for (lane, k) in some.clone().enumerate() {
                    let pull = pulls[k][index].as_flattened();
                    for (number, weight) in answer.stress.as_flattened().iter().zip(pull) {
                        if let Some(place) = number.place() {
                            weights[place][lane] += weight;
                        }
                    }
                }
                tape.sweep(weights);
                for (lane, k) in some.enumerate() {
                    let mut found = weights.iter().map(|lanes| lanes[lane]);
                    let own = &mut point.moduli[k];
                    own.iter_mut().zip(&mut found).for_each(|(sum, v)| *sum += v);
                    let own = point.memory.iter_mut().skip(k * width).take(width);
                    own.zip(&mut found).for_each(|(sum, v)| *sum += v);
                }
            }
            Some(())
        };
        let points = back.points.par_iter_mut().enumerate().with_min_len(64);
        let done: Option<Vec<()>> = points.map_init(Work::default, one).collect();
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
    weights: Vec<[f64; LANES]>,
}

/// Weights of nothing yet.
fn begin(tape: &Tape, weights: &mut Vec<[f64; LANES]>) {
    weights.clear();
    weights.resize(tape.len(), [0.0; LANES]);
}
