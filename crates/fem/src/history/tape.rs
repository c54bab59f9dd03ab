//! Numbers that write down how they were made, so that derivatives can be taken backwards.

use std::cell::RefCell;
use std::ops::{Add, Div, Mul, Neg, Sub};

use super::scalar::{LANES, Scalar};

/// What numbers were made from: of each, the numbers before it and its slopes by them.
#[derive(Debug, Default)]
pub(super) struct Tape {
    entries: RefCell<Entries>,
}

#[derive(Debug, Default)]
struct Entries {
    /// End of each number's edges.
    ends: Vec<usize>,
    edges: Vec<(usize, f64)>,
}

/// A number on a tape, or a constant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Var<'t> {
    value: f64,
    place: Option<(&'t Tape, usize)>,
}

impl Tape {
    /// A number that nothing on the tape moves.
    pub(super) fn input(&self, value: f64) -> Var<'_> {
        Var { value, place: Some((self, self.end())) }
    }

    /// Begin anew, with the memory kept.
    pub(super) fn clear(&mut self) {
        let entries = self.entries.get_mut();
        entries.ends.clear();
        entries.edges.clear();
    }

    fn push(&self, by: usize, slope: f64) {
        self.entries.borrow_mut().edges.push((by, slope));
    }

    /// End a number whose edges have been pushed; its place.
    fn end(&self) -> usize {
        let mut entries = self.entries.borrow_mut();
        let n_edges = entries.edges.len();
        entries.ends.push(n_edges);
        entries.ends.len() - 1
    }

    /// Number of numbers.
    pub(super) fn len(&self) -> usize {
        self.entries.borrow().ends.len()
    }

    /// Turn weights of all numbers into the derivatives of the weighted sum by all numbers, for several
    /// sums at once.
    pub(super) fn sweep(&self, weights: &mut [[f64; LANES]]) {
        let entries = self.entries.borrow();
        for place in (0..entries.ends.len().min(weights.len())).rev() {
            let weight = weights[place];
            if weight == [0.0; LANES] {
                continue;
            }
            let begin = if place == 0 { 0 } else { entries.ends[place - 1] };
            for &(by, slope) in &entries.edges[begin..entries.ends[place]] {
                let sum = &mut weights[by];
                for k in 0..LANES {
                    sum[k] += slope * weight[k];
                }
            }
        }
    }
}

impl Var<'_> {
    /// Where it stands on the tape; none for a constant.
    pub(super) fn place(&self) -> Option<usize> {
        self.place.map(|(_, place)| place)
    }
}

impl Scalar for Var<'_> {
    const FOLLOWS: bool = true;

    fn constant(value: f64) -> Self {
        Self { value, place: None }
    }

    fn value(self) -> f64 {
        self.value
    }

    fn is_constant(self) -> bool {
        self.place.is_none()
    }

    fn chain(value: f64, slopes: impl IntoIterator<Item = (Self, f64)>) -> Self {
        let mut on = None;
        for (by, slope) in slopes {
            if let Some((tape, place)) = by.place {
                tape.push(place, slope);
                on = Some(tape);
            }
        }
        Self { value, place: on.map(|tape| (tape, tape.end())) }
    }
}

impl Add for Var<'_> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::chain(self.value + other.value, [(self, 1.0), (other, 1.0)])
    }
}

impl Sub for Var<'_> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self::chain(self.value - other.value, [(self, 1.0), (other, -1.0)])
    }
}

impl Mul for Var<'_> {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let slopes = [(self, other.value), (other, self.value)];
        Self::chain(self.value * other.value, slopes)
    }
}

impl Div for Var<'_> {
    type Output = Self;

    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        let slopes = [(self, 1.0 / other.value), (other, -value / other.value)];
        Self::chain(value, slopes)
    }
}

impl Neg for Var<'_> {
    type Output = Self;

    fn neg(self) -> Self {
        Self::chain(-self.value, [(self, -1.0)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sweep_finds_the_derivatives_of_a_formula() {
        let tape = Tape::default();
        let (x, y) = (tape.input(1.3), tape.input(-0.7));
        let sine = (x * y).apply((1.3 * -0.7_f64).sin(), (1.3 * -0.7_f64).cos());
        let z = -(sine / (x - Var::constant(2.0)) + y * y);
        let mut weights = vec![[0.0; LANES]; tape.len()];
        weights[z.place().unwrap_or_default()][3] = 2.0;
        tape.sweep(&mut weights);
        let (product, less) = (1.3 * -0.7_f64, 1.3 - 2.0);
        let by_x = -2.0 * (-0.7 * product.cos() / less - product.sin() / (less * less));
        let by_y = -2.0 * (1.3 * product.cos() / less + 2.0 * -0.7);
        assert!((weights[0][3] - by_x).abs() < 1e-15 && (weights[1][3] - by_y).abs() < 1e-15);
        assert_eq!(weights[0][2], 0.0);
        assert!((Var::constant(2.0) * Var::constant(3.0)).is_constant());
    }
}
