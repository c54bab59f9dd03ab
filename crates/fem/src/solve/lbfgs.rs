//! Limited-memory BFGS: the last pairs of steps and residual changes correct a metric.

use std::collections::VecDeque;

use super::problem::{dot, norm};

/// Pairs kept. More than ten changed nothing in measurements.
const PAIRS: usize = 10;

/// One accepted step `s`, the change of the residual `y` and `1 / sᵀy`.
#[derive(Debug)]
struct Pair {
    step: Vec<f64>,
    change: Vec<f64>,
    inverse_curvature: f64,
}

/// The pairs that correct the metric, oldest first.
#[derive(Debug, Default)]
pub(super) struct Memory {
    pairs: VecDeque<Pair>,
    spare: Vec<Pair>,
}

impl Memory {
    /// Forget all pairs (their storage is kept).
    pub(super) fn clear(&mut self) {
        self.spare.extend(self.pairs.drain(..));
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Remember `step = alpha direction` and `change = after − before`, unless the curvature
    /// between them is not clearly positive.
    pub(super) fn push(&mut self, alpha: f64, direction: &[f64], before: &[f64], after: &[f64]) {
        let mut pair = match self.spare.pop() {
            Some(pair) => pair,
            None if self.pairs.len() >= PAIRS => match self.pairs.pop_front() {
                Some(pair) => pair,
                None => return,
            },
            None => Pair { step: Vec::new(), change: Vec::new(), inverse_curvature: 0.0 },
        };
        pair.step.clear();
        pair.step.extend(direction.iter().map(|d| alpha * d));
        pair.change.clear();
        pair.change.extend(after.iter().zip(before).map(|(a, b)| a - b));
        let curvature = dot(&pair.step, &pair.change);
        if curvature > 1e-12 * norm(&pair.step) * norm(&pair.change) {
            pair.inverse_curvature = 1.0 / curvature;
            if self.pairs.len() >= PAIRS {
                self.spare.extend(self.pairs.pop_front());
            }
            self.pairs.push_back(pair);
        } else {
            self.spare.push(pair);
        }
    }

    /// Write the quasi-Newton direction `−H residual` to `direction`, where `metric` applies the
    /// inverse that the pairs correct and `scratch` has the same length.
    pub(super) fn direction_into(
        &self,
        residual: &[f64],
        scratch: &mut [f64],
        direction: &mut [f64],
        metric: impl FnOnce(&[f64], &mut [f64]),
    ) {
        let mut weights = [0.0; PAIRS];
        scratch.copy_from_slice(residual);
        for (pair, weight) in self.pairs.iter().zip(&mut weights).rev() {
            *weight = pair.inverse_curvature * dot(&pair.step, scratch);
            add_scaled(scratch, -*weight, &pair.change);
        }
        metric(scratch, direction);
        for (pair, weight) in self.pairs.iter().zip(&weights) {
            let back = pair.inverse_curvature * dot(&pair.change, direction);
            add_scaled(direction, weight - back, &pair.step);
        }
        for d in direction {
            *d = -*d;
        }
    }
}

fn add_scaled(target: &mut [f64], factor: f64, source: &[f64]) {
    for (t, s) in target.iter_mut().zip(source) {
        *t += factor * s;
    }
}
