//! Derivatives of the points of a recorded step by a cause, and of their stresses by their memory.

use rayon::prelude::*;

use super::behaviour::Behaviour;
use super::common::{Common, PointState};
use super::numbers::BehaviourParameter;
use super::point::Answer;
use super::prony::Memory;
use super::record::StepRecord;
use super::scalar::{Dual, LANES, Matrix, Scalar, constant, values};
use crate::material::{Hyperelastic, Law, Material, Matrix3, Parameter};

/// What a body is made of, apart from what covers it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Substance<'a> {
    pub(crate) material: &'a Material,
    pub(crate) behaviour: &'a Behaviour,
    /// Quadrature points of an element.
    pub(crate) n_points: usize,
}

/// What moves at the points of a step.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Moved<'a> {
    /// A parameter of the law, everywhere or along a field of rates.
    pub(crate) parameter: Option<(Parameter, Option<&'a [f64]>)>,
    pub(crate) behaviour: Option<BehaviourParameter>,
    /// Rates of the memory before the step, as [`PointState::for_each`] has them, point after point;
    /// empty where it does not move.
    pub(crate) memory: &'a [f64],
}

impl Moved<'_> {
    /// Whether nothing moves.
    pub(crate) fn is_nothing(&self) -> bool {
        self.parameter.is_none() && self.behaviour.is_none() && self.memory.is_empty()
    }
}

impl<S: Scalar> PointState<S> {
    /// The same numbers, each as another one; always in the same order.
    pub(super) fn map<T: Scalar>(&self, mut to: impl FnMut(S) -> T) -> PointState<T> {
        let mut matrix = |m: &Matrix<S>| m.map(|row| row.map(&mut to));
        let gradient = matrix(&self.gradient);
        let mut memory = |memory: &Memory<S>| Memory {
            elastic: matrix(&memory.elastic),
            terms: memory.terms.iter().map(&mut matrix).collect(),
        };
        let volumetric = self.volumetric.as_ref().map(&mut memory);
        let isochoric = self.isochoric.as_ref().map(&mut memory);
        let largest_strain = matrix(&self.largest_strain);
        let largest_energy = to(self.largest_energy);
        PointState { gradient, volumetric, isochoric, largest_energy, largest_strain }
    }

    /// Hand over all numbers in that order.
    pub(super) fn for_each(&self, mut take: impl FnMut(S)) {
        self.map(|v| {
            take(v);
            0.0
        });
    }

    /// Number of numbers.
    pub(super) fn len(&self) -> usize {
        let matrices = |memory: &Memory<S>| 1 + memory.terms.len();
        let memories = [&self.volumetric, &self.isochoric];
        let n: usize = memories.iter().filter_map(|m| m.as_ref()).map(matrices).sum();
        9 * (2 + n) + 1
    }
}

/// The response of a law, with its parameters.
pub(super) fn follow_law<S: Scalar>(
    law: &Law,
    parameters: &[(Parameter, S)],
    he: &Matrix<S>,
) -> Option<Answer<S>> {
    let h = values(he);
    let response = law.response(&h)?;
    let still = he.as_flattened().iter().all(|v| v.is_constant());
    let tangent = match still {
        true => [[0.0; 9]; 9],
        false => law.tangent(&h)?,
    };
    let mut by = Vec::with_capacity(parameters.len());
    for &(parameter, number) in parameters {
        by.push((number, law.response_by(&h, parameter)?));
    }
    let along = |slopes: [f64; 9]| {
        let moving = if still { 0 } else { 9 };
        he.as_flattened().iter().copied().zip(slopes).take(moving)
    };
    let stress = response.stress;
    let energy_slopes: [f64; 9] = std::array::from_fn(|k| stress[k / 3][k % 3]);
    let by_energy = by.iter().map(|(number, (energy, _))| (*number, *energy));
    let energy = S::chain(response.energy, along(energy_slopes).chain(by_energy));
    let entry = |i: usize, j: usize| {
        let by_stress = by.iter().map(|(number, (_, stress))| (*number, stress[i][j]));
        S::chain(stress[i][j], along(tangent[3 * i + j]).chain(by_stress))
    };
    let stress = std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)));
    Some(Answer { energy, stress, det_f: response.det_f })
}

impl StepRecord {
    fn common(&self, substance: Substance, moved: &[Moved]) -> Common<Dual> {
        let numbers = substance.behaviour.numbers(|name, value| Dual {
            value,
            rates: lanes(moved, |one| f64::from(u8::from(one.behaviour == Some(name)))),
        });
        Common::new(&numbers, substance.behaviour.is_split(), self.length, self.time)
    }

    /// `Ṗ` at all points at fixed displacement along up to [`LANES`] causes, `[point][cause]`; none
    /// where a point is inverted.
    pub(crate) fn stress_rates(
        &self,
        substance: Substance,
        gradients: &[Matrix3],
        moved: &[Moved],
    ) -> Option<Vec<[Matrix3; LANES]>> {
        let common = self.common(substance, moved);
        let laws = Laws::new(substance, moved);
        let one = |(index, h): (usize, &Matrix3)| {
            let state = self.dual(index, moved);
            let at = common.point(&state);
            let answer = common.response(&at, &constant(h), laws.at(index))?;
            let lane = |k: usize| answer.stress.map(|row| row.map(|v| v.rates[k]));
            Some(std::array::from_fn(lane))
        };
        gradients.par_iter().with_min_len(256).enumerate().map(one).collect()
    }

    /// Rates of the memory after the step, `[point][number][cause]`, while displacement gradients
    /// move at `rates`, `[cause][point]`.
    pub(crate) fn memory_rates(
        &self,
        substance: Substance,
        gradients: &[Matrix3],
        rates: &[Vec<Matrix3>],
        moved: &[Moved],
    ) -> Option<Vec<[f64; LANES]>> {
        let common = self.common(substance, moved);
        let laws = Laws::new(substance, moved);
        let width = self.memory_len();
        let mut all = vec![[0.0; LANES]; width * gradients.len()];
        let one = |(index, out): (usize, &mut [[f64; LANES]])| {
            let mut state = self.dual(index, moved);
            let at = common.point(&state);
            let h = &gradients[index];
            let entry = |i: usize, j: usize| Dual {
                value: h[i][j],
                rates: lanes(rates, |own| own[index][i][j]),
            };
            let h: Matrix<Dual> = std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)));
            common.update(&at, &h, laws.at(index), &mut state)?;
            let mut entries = out.iter_mut();
            state.for_each(|v| {
                if let Some(entry) = entries.next() {
                    *entry = v.rates;
                }
            });
            Some(())
        };
        let done: Option<Vec<()>> =
            all.par_chunks_mut(width).with_min_len(256).enumerate().map(one).collect();
        done.map(|_| all)
    }

    /// Memory of a point before the step, with its rates.
    fn dual(&self, index: usize, moved: &[Moved]) -> PointState<Dual> {
        let state = &self.before[index];
        let mut place = index * state.len();
        state.map(|value| {
            let rates = lanes(moved, |one| one.memory.get(place).copied().unwrap_or(0.0));
            place += 1;
            Dual { value, rates }
        })
    }
}

/// A number of each cause; 0 where there are fewer than lanes.
fn lanes<T>(causes: &[T], of: impl Fn(&T) -> f64) -> [f64; LANES] {
    std::array::from_fn(|k| causes.get(k).map_or(0.0, &of))
}

/// Laws at all points, with the parameters that causes move.
struct Laws<'a> {
    substance: Substance<'a>,
    moved: &'a [Moved<'a>],
    parameters: Vec<Parameter>,
}

impl<'a> Laws<'a> {
    fn new(substance: Substance<'a>, moved: &'a [Moved<'a>]) -> Self {
        let mut parameters = Vec::new();
        for (parameter, _) in moved.iter().filter_map(|one| one.parameter) {
            if !parameters.contains(&parameter) {
                parameters.push(parameter);
            }
        }
        Self { substance, moved, parameters }
    }

    /// What the law at a point answers.
    fn at(&self, index: usize) -> impl Fn(&Matrix<Dual>) -> Option<Answer<Dual>> {
        let n_points = self.substance.n_points;
        let law = self.substance.material.law_at(index / n_points, index % n_points);
        let number = |parameter: &Parameter| {
            let rate = |one: &Moved| match one.parameter {
                Some((own, field)) if own == *parameter => field.map_or(1.0, |field| field[index]),
                _ => 0.0,
            };
            (*parameter, Dual { value: 0.0, rates: lanes(self.moved, rate) })
        };
        let parameters: Vec<(Parameter, Dual)> = self.parameters.iter().map(number).collect();
        move |he: &Matrix<Dual>| follow_law(&law, &parameters, he)
    }
}
