//! Every configuration of a small case, and its algebra written plainly.

use super::Case;
use tissuereg_contacts::{Configuration, Contact};

pub type Plain = Vec<Vec<f64>>;

/// Every configuration of a case.
pub fn all_of(case: &Case) -> Vec<Configuration> {
    let n_sizes = case.prior.variances.len();
    let mut contents = vec![None];
    for patch in 0..case.patches.len() {
        contents.extend((0..n_sizes).map(|size| Some(Contact { patch, size })));
    }
    let mut slots: Vec<Vec<Option<Contact>>> = vec![Vec::new()];
    for _ in 0..case.prior.n_slots {
        let longer =
            slots.iter().flat_map(|s| contents.iter().map(|&c| [s.clone(), vec![c]].concat()));
        slots = longer.collect();
    }
    let mut all = Vec::new();
    for slots in slots {
        let n_groups = case.prior.wrong.rows.len();
        for (level, bits) in
            (0..2).flat_map(|level| (0..1_u32 << n_groups).map(move |b| (level, b)))
        {
            all.push(Configuration {
                slots: slots.clone(),
                levels: vec![level],
                wrong: (0..n_groups).map(|group| bits >> group & 1 == 1).collect(),
            });
        }
    }
    all
}

/// Variance of every coefficient.
pub fn variances(case: &Case, one: &Configuration) -> Vec<f64> {
    let family = &case.prior.families[0];
    let mut all: Vec<f64> =
        family.variances.iter().map(|v| v * family.factors[one.levels[0]]).collect();
    for contact in one.slots.iter().flatten() {
        let own = case.prior.variances[contact.size];
        for axis in 0..3 {
            all[3 * contact.patch + axis] += own;
            for (inner, ratio) in &case.patches[contact.patch].texture {
                all[3 * inner + axis] += own * ratio * ratio;
            }
        }
    }
    all
}

/// Noise of the observations, that of wrong groups included.
pub fn noise(case: &Case, one: &Configuration) -> Plain {
    let n = case.columns.nrows();
    let mut all: Plain =
        (0..n).map(|i| (0..n).map(|j| case.observed.noise[(i, j)]).collect()).collect();
    for (rows, _) in case.prior.wrong.rows.iter().zip(&one.wrong).filter(|(_, w)| **w) {
        rows.iter().for_each(|&row| all[row][row] += case.prior.wrong.variance);
    }
    all
}

pub fn covariance(case: &Case, one: &Configuration) -> Plain {
    let (variances, mut all) = (variances(case, one), noise(case, one));
    for (i, row) in all.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            for (k, variance) in variances.iter().enumerate() {
                *entry += case.columns[(i, k)] * variance * case.columns[(j, k)];
            }
        }
    }
    all
}

/// Inverse and logarithm of the determinant by Gauss and Jordan.
pub fn inverse(mut a: Plain) -> (Plain, f64) {
    let (n, mut log) = (a.len(), 0.0);
    let mut out: Plain =
        (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
    for k in 0..n {
        let pivot = a[k][k];
        log += pivot.ln();
        for j in 0..n {
            a[k][j] /= pivot;
            out[k][j] /= pivot;
        }
        for i in (0..n).filter(|&i| i != k) {
            let factor = a[i][k];
            for j in 0..n {
                a[i][j] -= factor * a[k][j];
                out[i][j] -= factor * out[k][j];
            }
        }
    }
    (out, log)
}

pub fn log_evidence(case: &Case, one: &Configuration) -> f64 {
    let ((inverse, log), d) = (inverse(covariance(case, one)), &case.observed.innovation);
    let n = d.len();
    let square: f64 =
        (0..n).map(|i| (0..n).map(|j| d[i] * inverse[i][j] * d[j]).sum::<f64>()).sum();
    -0.5 * log - 0.5 * square
}

pub fn log_prior(case: &Case, one: &Configuration) -> f64 {
    let prior = &case.prior;
    let slots = one.slots.iter().map(|slot| match slot {
        None => prior.log_empty,
        Some(c) => prior.log_filled[c.patch * prior.variances.len() + c.size],
    });
    let n_wrong = one.wrong.iter().filter(|wrong| **wrong).count() as f64;
    slots.sum::<f64>() + prior.families[0].log_prior[one.levels[0]] + n_wrong * prior.wrong.log_odds
}

/// The posterior probability of every configuration.
pub fn posterior(case: &Case, all: &[Configuration]) -> Vec<f64> {
    let weights: Vec<f64> =
        all.iter().map(|one| (log_evidence(case, one) + log_prior(case, one)).exp()).collect();
    let total: f64 = weights.iter().sum();
    weights.iter().map(|weight| weight / total).collect()
}

/// Gain `D J' C^-1` and covariance `D - D J' C^-1 J D` of one configuration's coefficients.
pub fn closed_form(case: &Case, one: &Configuration) -> (Plain, Plain) {
    let (d, (inverse, _)) = (variances(case, one), inverse(covariance(case, one)));
    let (n, m) = case.columns.shape();
    let gain: Plain = (0..m)
        .map(|k| {
            let along =
                |j: usize| (0..n).map(|i| case.columns[(i, k)] * inverse[i][j]).sum::<f64>();
            (0..n).map(|j| d[k] * along(j)).collect()
        })
        .collect();
    let covariance = (0..m)
        .map(|k| {
            let taken =
                |l: usize| (0..n).map(|j| gain[k][j] * case.columns[(j, l)]).sum::<f64>() * d[l];
            (0..m).map(|l| if k == l { d[k] } else { 0.0 } - taken(l)).collect()
        })
        .collect();
    (gain, covariance)
}
