//! The weights of all contents of one slot, computed at once.
//!
//! With the covariance `C = L L'` of everything else, a contact of variance `v` at a patch with columns `J` changes the
//! logarithm of the evidence by
//!
//! ```text
//! -1/2 log|I + v S| + 1/2 v b' (I + v S)^-1 b,     S = J' C^-1 J  (3, 3),     b = J' C^-1 d  (3)
//! ```
//!
//! Its texture is left out here, and `L^-1 J` is computed in single precision, many patches in SIMD lanes: the
//! table only proposes. It depends on everything but the slot's own content, so that the chain that draws from it
//! corrects for both exactly.

use pulp::Simd;

use crate::elementary::{exp, ln};
use crate::gain::gain_of;
use crate::packed::{LANES, Packed, ROWS};
use crate::prior::Problem;
use crate::state::{Contact, Evidence};

/// Logarithm of a weight over the largest below which all weights are alike.
const LEAST: f64 = -60.0;

/// Weights of every content of a slot: patch by patch, size by size, the empty slot last.
#[derive(Debug, Default)]
pub(crate) struct Table {
    log_weight: Vec<f64>,
    cumulative: Vec<f64>,
    log_sum: f64,
    n_sizes: usize,
    factor: Vec<[f32; ROWS]>,
    innovation: Vec<f32>,
    white: Vec<[f32; LANES]>,
}

impl Table {
    /// Weigh the contents given everything else: `rest` is of the covariance without the slot; likelihoods are raised
    /// to the power `sharpness`.
    pub(crate) fn fill(&mut self, problem: &Problem, rest: &Evidence, sharpness: f64) {
        let (packed, prior) = (&problem.packed, &problem.prior);
        self.n_sizes = prior.variances.len();
        self.pack(rest, packed.n_rows);
        self.white.resize(3 * packed.n_rows, [0.0; LANES]);
        self.log_weight.resize(packed.n_patches * self.n_sizes + 1, 0.0);
        pulp::Arch::new().dispatch(Gains {
            packed,
            factor: &self.factor,
            innovation: &self.innovation,
            variances: &prior.variances,
            white: &mut self.white,
            out: &mut self.log_weight,
        });
        let filled = prior.log_filled.iter().chain(std::iter::once(&prior.log_empty));
        if let Some(empty) = self.log_weight.last_mut() {
            *empty = 0.0;
        }
        let mut largest = f64::NEG_INFINITY;
        for (weight, log_prior) in self.log_weight.iter_mut().zip(filled) {
            *weight = sharpness * *weight + log_prior;
            largest = largest.max(*weight);
        }
        self.cumulative.resize(self.log_weight.len(), 0.0);
        let (log_weight, cumulative) = (&self.log_weight, &mut self.cumulative);
        pulp::Arch::new().dispatch(|| shares(log_weight, largest, cumulative));
        let mut sum = 0.0;
        for share in &mut self.cumulative {
            sum += *share;
            *share = sum;
        }
        self.log_sum = largest + sum.ln();
    }

    /// The factor by steps of `ROWS` rows, in single precision: for each step the columns before it and its own, the
    /// diagonal inverted.
    fn pack(&mut self, rest: &Evidence, n_rows: usize) {
        let n_obs = rest.white.len();
        self.factor.clear();
        for first in (0..n_rows).step_by(ROWS) {
            for j in 0..first + ROWS {
                self.factor.push(std::array::from_fn(|r| match first + r {
                    i if i >= n_obs || j >= n_obs => f32::from(i == j),
                    i if i == j => (1.0 / rest.factor[(i, j)]) as f32,
                    i if i > j => rest.factor[(i, j)] as f32,
                    _ => 0.0,
                }));
            }
        }
        self.innovation.clear();
        self.innovation.extend(rest.white.iter().map(|&x| x as f32));
        self.innovation.resize(n_rows, 0.0);
    }

    /// The content at a share `uniform` of the total weight.
    pub(crate) fn draw(&self, uniform: f64) -> Option<Contact> {
        let total = self.cumulative.last().copied().unwrap_or(0.0);
        let found = self.cumulative.partition_point(|&sum| sum <= uniform * total);
        let filled = found + 1 < self.cumulative.len();
        filled.then(|| Contact { patch: found / self.n_sizes, size: found % self.n_sizes })
    }

    /// Logarithm of the probability with which a content is drawn.
    pub(crate) fn log_probability(&self, slot: Option<Contact>) -> f64 {
        let weight = match slot {
            Some(contact) => Some(&self.log_weight[contact.patch * self.n_sizes + contact.size]),
            None => self.log_weight.last(),
        };
        weight.map_or(f64::NEG_INFINITY, |weight| weight - self.log_sum)
    }
}

/// `exp` of every weight over the largest.
#[inline(always)]
fn shares(log_weight: &[f64], largest: f64, out: &mut [f64]) {
    for (share, weight) in out.iter_mut().zip(log_weight) {
        *share = exp((weight - largest).max(LEAST));
    }
}

/// Changes of the logarithm of the evidence by every patch and size.
struct Gains<'a> {
    packed: &'a Packed,
    factor: &'a [[f32; ROWS]],
    innovation: &'a [f32],
    variances: &'a [f64],
    white: &'a mut [[f32; LANES]],
    out: &'a mut [f64],
}

impl pulp::WithSimd for Gains<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { packed, factor, innovation, variances, white, out } = self;
        let blocks = packed.blocks.chunks_exact(3 * packed.n_rows);
        let n_sizes = variances.len();
        for (columns, out) in blocks.zip(out.chunks_mut(LANES * n_sizes)) {
            let mut sums = [[0.0_f32; LANES]; 9];
            for part in 0..LANES / S::F32_LANES {
                let given = Part { simd, columns, factor, innovation, part };
                for (sum, value) in sums.iter_mut().zip(given.sums(white)) {
                    S::as_mut_simd_f32s(sum).0[part] = value;
                }
            }
            for (size, &variance) in variances.iter().enumerate() {
                let (mut exponent, mut determinant) = ([0.0_f64; LANES], [0.0_f64; LANES]);
                for lane in 0..LANES {
                    let s = std::array::from_fn(|k| f64::from(sums[k][lane]));
                    let b = std::array::from_fn(|k| f64::from(sums[6 + k][lane]));
                    (exponent[lane], determinant[lane]) = gain_of(&s, &b, variance);
                }
                let mut logs = [0.0_f64; LANES];
                for lane in 0..LANES {
                    logs[lane] = ln(determinant[lane]);
                }
                for (lane, out) in out.chunks_exact_mut(n_sizes).enumerate() {
                    out[size] = 0.5 * (exponent[lane] - logs[lane]);
                }
            }
        }
    }
}

/// Some lanes of a block.
struct Part<'a, S> {
    simd: S,
    columns: &'a [[f32; LANES]],
    factor: &'a [[f32; ROWS]],
    innovation: &'a [f32],
    part: usize,
}

impl<S: Simd> Part<'_, S> {
    /// `S = [xx, yy, zz, xy, xz, yz]` and `b` of every lane; `white` is overwritten by `L^-1 J`.
    #[inline(always)]
    fn sums(&self, white: &mut [[f32; LANES]]) -> [S::f32s; 9] {
        let (simd, part) = (self.simd, self.part);
        let zero = simd.splat_f32s(0.0);
        let mut sums = [zero; 9];
        let mut factor = self.factor;
        for (step, columns) in self.columns.chunks_exact(3 * ROWS).enumerate() {
            let first = step * ROWS;
            let (before, rest) = factor.split_at(first);
            let (own, rest) = rest.split_at(ROWS);
            factor = rest;
            let mut x = [[zero; 3]; ROWS];
            for (r, row) in columns.chunks_exact(3).enumerate() {
                for k in 0..3 {
                    x[r][k] = S::as_simd_f32s(&row[k]).0[part];
                }
            }
            for (l, solved) in before.iter().zip(white.chunks_exact(3)) {
                let solved = [0, 1, 2].map(|k| S::as_simd_f32s(&solved[k]).0[part]);
                for r in 0..ROWS {
                    let l = simd.splat_f32s(l[r]);
                    for k in 0..3 {
                        x[r][k] = simd.negate_mul_add_e_f32s(l, solved[k], x[r][k]);
                    }
                }
            }
            for r in 0..ROWS {
                let inverse = simd.splat_f32s(own[r][r]);
                let data = simd.splat_f32s(self.innovation[first + r]);
                for k in 0..3 {
                    for before in 0..r {
                        let l = simd.splat_f32s(own[before][r]);
                        x[r][k] = simd.negate_mul_add_e_f32s(l, x[before][k], x[r][k]);
                    }
                    x[r][k] = simd.mul_f32s(x[r][k], inverse);
                    S::as_mut_simd_f32s(&mut white[3 * (first + r) + k]).0[part] = x[r][k];
                    sums[6 + k] = simd.mul_add_e_f32s(x[r][k], data, sums[6 + k]);
                }
                for (sum, [i, j]) in
                    [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]].iter().enumerate()
                {
                    sums[sum] = simd.mul_add_e_f32s(x[r][*i], x[r][*j], sums[sum]);
                }
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use faer::Mat;

    use super::*;
    use crate::dictionary::Dictionary;
    use crate::{Configuration, Observed, Patch, Prior, Wrong};

    /// Seven observations of 20 patches: numbers of the golden ratio.
    fn problem() -> Problem {
        let number = |k: usize| (0.618_033_988_75 * k as f64).fract() - 0.5;
        let columns = Mat::from_fn(7, 60, |i, j| number(1 + i + 7 * j));
        let dictionary = Dictionary::new(columns, vec![Patch::default(); 20]).unwrap();
        let prior = Prior {
            n_slots: 2,
            variances: vec![0.01, 1.0, 900.0],
            log_empty: -0.3,
            log_filled: (0..60).map(|k| -4.0 + number(k)).collect(),
            families: Vec::new(),
            wrong: Wrong { rows: Vec::new(), variance: 1.0, log_odds: 0.0 },
        };
        let noise = Mat::from_fn(7, 7, |i, j| if i == j { 0.01 } else { 0.002 });
        let innovation = (0..7).map(|i| 3.0 * number(11 * i)).collect();
        Problem::new(dictionary, prior, Observed { innovation, noise }).unwrap()
    }

    #[test]
    fn weights_are_differences_of_evidences_with_the_prior() {
        let problem = problem();
        let mut state = Configuration::empty(&problem);
        state.slots[1] = Some(Contact { patch: 17, size: 1 });
        let rest = Evidence::of_state(&problem, &state).unwrap();
        let mut table = Table::default();
        table.fill(&problem, &rest, 0.7);
        let of_empty = table.log_probability(None);
        for (patch, size) in (0..20).flat_map(|patch| (0..3).map(move |size| (patch, size))) {
            let contact = Some(Contact { patch, size });
            state.slots[0] = contact;
            let evidence = Evidence::of_state(&problem, &state).unwrap();
            let prior = problem.prior.log_filled[3 * patch + size] - problem.prior.log_empty;
            let wanted = 0.7 * (evidence.value - rest.value) + prior;
            let found = table.log_probability(contact) - of_empty;
            // Single precision of numbers that sum to a few hundred.
            assert!((found - wanted).abs() < 2e-4 * (1.0 + wanted.abs()), "{found} {wanted}");
        }
    }

    #[test]
    fn contents_are_drawn_as_often_as_their_probabilities_say() {
        let problem = problem();
        let rest = Evidence::of_state(&problem, &Configuration::empty(&problem)).unwrap();
        let mut table = Table::default();
        // Filled twice: nothing of the first weights stays.
        table.fill(&problem, &rest, 1.0);
        table.fill(&problem, &rest, 0.02);
        let (n, mut count) = (100_000, vec![0.0; 61]);
        for k in 0..n {
            let drawn = table.draw((f64::from(k) + 0.5) / f64::from(n));
            count[drawn.map_or(60, |c| 3 * c.patch + c.size)] += 1.0 / f64::from(n);
        }
        for (entry, share) in count.iter().enumerate() {
            let contact = (entry < 60).then_some(Contact { patch: entry / 3, size: entry % 3 });
            assert!((share - table.log_probability(contact).exp()).abs() < 2.0 / f64::from(n));
        }
    }
}
