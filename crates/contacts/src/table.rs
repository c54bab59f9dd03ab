//! All that one slot may hold, weighed at once.
//!
//! With the covariance `C = L L'` of everything else, a contact of variance `v` at a patch with columns `J` changes the
//! logarithm of the evidence by
//!
//! ```text
//! -1/2 log|I + v S| + 1/2 v b' (I + v S)^-1 b,     S = J' C^-1 J  (3, 3),     b = J' C^-1 d  (3)
//! ```
//!
//! Its texture is left out here; the chain that draws from the table corrects for that.

use faer::{Mat, MatRef};

use crate::Problem;
use crate::linalg::forward_in_place;
use crate::state::{Configuration, Contact, Evidence};

/// Lanes of a partial sum: a sum over observations has one fixed order.
const LANES: usize = 8;

/// Weights of every content of a slot, normalised.
pub(crate) struct Table {
    /// Logarithm of each probability: patch by patch, size by size, the empty slot last.
    log_probability: Vec<f64>,
    cumulative: Vec<f64>,
    n_sizes: usize,
}

impl Table {
    /// Weigh the contents given everything else: `evidence` is of the covariance without the slot; likelihoods are
    /// raised to the power `sharpness`.
    pub(crate) fn new(problem: &Problem, evidence: &Evidence, sharpness: f64) -> Self {
        let (n_patches, variances) = (problem.dictionary.n_patches(), &problem.prior.variances);
        let mut white = problem.dictionary.columns().get(.., ..3 * n_patches).to_owned();
        forward_in_place(evidence.factor.as_ref(), white.as_mut());
        let mut weights = vec![0.0; n_patches * variances.len() + 1];
        pulp::Arch::new().dispatch(Gains {
            white: &white,
            innovation: &evidence.white,
            variances,
            out: &mut weights,
        });
        let filled =
            problem.prior.log_filled.iter().chain(std::iter::once(&problem.prior.log_empty));
        for (weight, log_prior) in weights.iter_mut().zip(filled) {
            *weight = sharpness * *weight + log_prior;
        }
        Self::normalised(weights, variances.len())
    }

    fn normalised(mut weights: Vec<f64>, n_sizes: usize) -> Self {
        let largest = weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut sum = 0.0;
        let cumulative: Vec<f64> = weights
            .iter()
            .map(|w| {
                // Below this nothing is ever drawn.
                sum += if w - largest > -40.0 { (w - largest).exp() } else { 0.0 };
                sum
            })
            .collect();
        let log_sum = largest + sum.ln();
        weights.iter_mut().for_each(|w| *w -= log_sum);
        Self { log_probability: weights, cumulative, n_sizes }
    }

    /// The content at a share `uniform` of the total weight.
    pub(crate) fn draw(&self, uniform: f64) -> Option<Contact> {
        let total = self.cumulative.last().copied().unwrap_or(0.0);
        let found = self.cumulative.partition_point(|&sum| sum <= uniform * total);
        self.content(found.min(self.cumulative.len() - 1))
    }

    fn content(&self, entry: usize) -> Option<Contact> {
        let filled = entry + 1 < self.cumulative.len();
        filled.then(|| Contact { patch: entry / self.n_sizes, size: entry % self.n_sizes })
    }

    /// Logarithm of the probability with which a content is drawn.
    pub(crate) fn log_probability(&self, slot: Option<Contact>) -> f64 {
        match slot {
            Some(contact) => self.log_probability[contact.patch * self.n_sizes + contact.size],
            None => self.log_probability.last().copied().unwrap_or(f64::NEG_INFINITY),
        }
    }
}

/// Changes of the logarithm of the evidence by every patch and size.
struct Gains<'a> {
    white: &'a Mat<f64>,
    innovation: &'a [f64],
    variances: &'a [f64],
    out: &'a mut [f64],
}

impl pulp::NullaryFnOnce for Gains<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { white, innovation, variances, out } = self;
        let columns = |j: usize| column(white.as_ref(), j);
        for (patch, out) in out.chunks_exact_mut(variances.len()).enumerate() {
            if 3 * patch + 3 > white.ncols() {
                break;
            }
            let [x, y, z] = [0, 1, 2].map(|k| columns(3 * patch + k));
            let s = [dot(x, x), dot(y, y), dot(z, z), dot(x, y), dot(x, z), dot(y, z)];
            let b = [dot(x, innovation), dot(y, innovation), dot(z, innovation)];
            for (gain, &variance) in out.iter_mut().zip(variances) {
                *gain = gain_of(&s, &b, variance);
            }
        }
    }
}

#[inline(always)]
fn column(matrix: MatRef<'_, f64>, j: usize) -> &[f64] {
    matrix.col(j).try_as_col_major().map_or(&[], |c| c.as_slice())
}

#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (a_chunks, a_rest) = a.as_chunks::<LANES>();
    let (b_chunks, b_rest) = b.as_chunks::<LANES>();
    for (x, y) in a_chunks.iter().zip(b_chunks) {
        for lane in 0..LANES {
            sums[lane] += x[lane] * y[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    let halves = [0, 1, 2, 3].map(|k| sums[k] + sums[k + 4]);
    (halves[0] + halves[2]) + (halves[1] + halves[3]) + rest
}

/// The formula above for `S = [xx, yy, zz, xy, xz, yz]`.
#[inline(always)]
fn gain_of(s: &[f64; 6], b: &[f64; 3], variance: f64) -> f64 {
    let [xx, yy, zz] = [1.0 + variance * s[0], 1.0 + variance * s[1], 1.0 + variance * s[2]];
    let [xy, xz, yz] = [variance * s[3], variance * s[4], variance * s[5]];
    let (c0, c1, c2) = (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy);
    let determinant = xx * c0 + xy * c1 + xz * c2;
    let (d1, d2, e2) = (xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy);
    let along = b[0] * (c0 * b[0] + c1 * b[1] + c2 * b[2])
        + b[1] * (c1 * b[0] + d1 * b[1] + d2 * b[2])
        + b[2] * (c2 * b[0] + d2 * b[1] + e2 * b[2]);
    // Rounding may leave next to nothing of a determinant that is at least one.
    0.5 * (variance * along / determinant.max(1.0) - determinant.max(1.0).ln())
}

/// A configuration's covariance without a slot, factored.
pub(crate) fn without(problem: &Problem, state: &Configuration, slot: usize) -> Option<Evidence> {
    Evidence::of(problem, state.covariance(problem, Some(slot)))
}
