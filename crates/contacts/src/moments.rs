//! Moments of the samples: coefficients, and means and covariances of anything linear in the causes.
//!
//! Given a configuration everything is Gaussian. With `D` the variances of the coefficients, `J` the columns, `C` the
//! covariance of the observations and `d` the innovation,
//!
//! ```text
//! coefficients:  D J' C^-1 d                 (n_columns)
//! points:        X C^-1 d,                   X = T D J'      (3 n_points, n_obs)
//! covariance:    T D T' - X C^-1 X'
//! ```
//!
//! with `T` the points' responses. The posterior is the mixture over samples. Its mean gain, the average of `D J' C^-1`
//! over samples, maps an error of the observations to the coefficients.

use faer::{Mat, MatRef, Par};
use rayon::prelude::*;

use crate::dictionary::check_finite;
use crate::linalg::{
    add_outer, add_scaled, backward, column, forward, forward_in_place, inverse, product,
};
use crate::prior::{check_length, covariance};
use crate::state::Evidence;
use crate::{Configuration, ContactsError, Problem};

/// Moments of the mixture over samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Moments {
    /// Mean of every column's coefficient.
    pub coefficients: Vec<f64>,
    /// Mean gain (`n_columns`, `n_obs`): coefficients by observations.
    pub gain: Mat<f64>,
    /// Mean of every point.
    pub means: Vec<[f64; 3]>,
    /// Covariance of every point.
    pub covariances: Vec<[[f64; 3]; 3]>,
    /// Mean over samples of each point's covariance before anything was observed.
    pub prior_covariances: Vec<[[f64; 3]; 3]>,
    /// Mean over samples of `d' C^-1 d`: about `n_obs` where prior and noise are what they claim.
    pub misfit: f64,
}

impl Problem {
    /// Variances of all coefficients under a configuration.
    pub fn variances(&self, one: &Configuration) -> Vec<f64> {
        let mut all = vec![0.0; self.dictionary.n_columns()];
        for (family, &level) in self.prior.families.iter().zip(&one.levels) {
            for (sum, variance) in all.iter_mut().zip(&family.variances) {
                *sum += family.factors[level] * variance;
            }
        }
        self.add_slots(one, &mut all);
        all
    }

    /// Variances of the slots' coefficients, added to those of all.
    fn add_slots(&self, one: &Configuration, all: &mut [f64]) {
        for contact in one.slots.iter().flatten() {
            let variance = self.prior.variances[contact.size];
            for (patch, ratio) in self.dictionary.shares(contact.patch) {
                for sum in &mut all[3 * patch..3 * patch + 3] {
                    *sum += variance * ratio * ratio;
                }
            }
        }
    }

    /// Moments of coefficients and of points over samples that count alike; `points` (`3 n_points`, `n_columns`) are the
    /// responses of three rows per point.
    ///
    /// # Errors
    ///
    /// [`ContactsError::Shape`], [`ContactsError::NotFinite`], [`ContactsError::NotPositiveDefinite`].
    ///
    /// # Cost
    ///
    /// A sample costs one factorisation and inverse of size `n_obs` and one triangular solve for the points.
    pub fn moments(
        &self,
        samples: &[Configuration],
        points: MatRef<'_, f64>,
        par: Par,
    ) -> Result<Moments, ContactsError> {
        self.check_points(points)?;
        if samples.is_empty() {
            return Err(ContactsError::Shape { argument: "samples", wanted: 1, found: 0 });
        }
        for one in samples {
            self.check_configuration(one)?;
        }
        let families = self.prior.families.iter().map(|family| OfFamily {
            cross: covariance(points, self.dictionary.columns(), &family.variances),
            prior: prior_of_points(points, &family.variances),
        });
        let families: Vec<OfFamily> = families.collect();
        let one = |sample| self.conditional(sample, points, &families);
        let each: Vec<Result<Conditional, ContactsError>> = match par {
            Par::Seq => samples.iter().map(one).collect(),
            _ => samples.par_iter().map(one).collect(),
        };
        let each = each.into_iter().collect::<Result<Vec<_>, _>>()?;
        let gain = self.gain(samples, &each);
        let innovation = &self.observed.innovation;
        let coefficients =
            (0..gain.nrows()).map(|j| dot(gain.row(j).iter(), innovation.iter())).collect();
        Ok(mixture(&each, gain, coefficients, points.nrows() / 3))
    }

    fn check_points(&self, points: MatRef<'_, f64>) -> Result<(), ContactsError> {
        check_length("points", self.dictionary.n_columns(), points.ncols())?;
        check_length("points", 3 * (points.nrows() / 3), points.nrows())?;
        for j in 0..points.ncols() {
            for i in 0..points.nrows() {
                check_finite("points", i + j * points.nrows(), points[(i, j)])?;
            }
        }
        Ok(())
    }

    fn conditional(
        &self,
        sample: &Configuration,
        points: MatRef<'_, f64>,
        families: &[OfFamily],
    ) -> Result<Conditional, ContactsError> {
        let evidence = Evidence::of_state(self, sample)
            .map_err(|pivot| ContactsError::NotPositiveDefinite { pivot })?;
        let dual = backward(evidence.factor.as_ref(), &evidence.white);
        let x = self.cross(sample, points, families);
        let mean = (0..x.nrows()).map(|i| dot(x.row(i).iter(), dual.iter())).collect();
        let prior = self.prior_of_sample(sample, points, families);
        // L^-1 X': its columns' inner products are what the observations take away.
        let mut taken = x.transpose().to_owned();
        forward_in_place(evidence.factor.as_ref(), taken.as_mut());
        let covariance = prior.iter().enumerate().map(|(point, prior)| {
            let mut left = *prior;
            for a in 0..3 {
                for b in 0..3 {
                    let (p, q) = (taken.col(3 * point + a), taken.col(3 * point + b));
                    left[a][b] -= dot(p.iter(), q.iter());
                }
            }
            left
        });
        let covariance = covariance.collect();
        let misfit = evidence.white.iter().map(|x| x * x).sum();
        let inverse = inverse(evidence.factor.as_ref());
        Ok(Conditional { inverse, mean, covariance, prior, misfit })
    }

    /// Mean of `D J' C^-1` over samples: families share their columns, so that only their inverses are averaged.
    fn gain(&self, samples: &[Configuration], each: &[Conditional]) -> Mat<f64> {
        let (columns, share) = (self.dictionary.columns(), 1.0 / each.len() as f64);
        let mut gain = Mat::zeros(self.dictionary.n_columns(), self.dictionary.n_obs());
        for (index, family) in self.prior.families.iter().enumerate() {
            let mut mean = Mat::zeros(columns.nrows(), columns.nrows());
            for (sample, conditional) in samples.iter().zip(each) {
                let factor = family.factors[sample.levels[index]];
                add_scaled(mean.as_mut(), conditional.inverse.as_ref(), share * factor);
            }
            // Few families hold more than a few columns.
            let some: Vec<usize> =
                (0..columns.ncols()).filter(|&j| family.variances[j] > 0.0).collect();
            let scaled = Mat::from_fn(columns.nrows(), some.len(), |i, k| {
                columns[(i, some[k])] * family.variances[some[k]]
            });
            let part = product(mean.transpose(), scaled.as_ref());
            for (k, &j) in some.iter().enumerate() {
                for i in 0..gain.ncols() {
                    gain[(j, i)] += part[(i, k)];
                }
            }
        }
        for (sample, conditional) in samples.iter().zip(each) {
            for contact in sample.slots.iter().flatten() {
                let variance = share * self.prior.variances[contact.size];
                for (patch, ratio) in self.dictionary.shares(contact.patch) {
                    let part = product(
                        self.dictionary.own(patch).transpose(),
                        conditional.inverse.as_ref(),
                    );
                    let rows = gain.get_mut(3 * patch..3 * patch + 3, ..);
                    add_scaled(rows, part.as_ref(), variance * ratio * ratio);
                }
            }
        }
        gain
    }

    /// `T D J'`.
    fn cross(
        &self,
        sample: &Configuration,
        points: MatRef<'_, f64>,
        families: &[OfFamily],
    ) -> Mat<f64> {
        let mut sum = Mat::zeros(points.nrows(), self.dictionary.n_obs());
        let by_family = families.iter().zip(&self.prior.families).zip(&sample.levels);
        for ((own, family), &level) in by_family {
            add_scaled(sum.as_mut(), own.cross.as_ref(), family.factors[level]);
        }
        for contact in sample.slots.iter().flatten() {
            let variance = self.prior.variances[contact.size];
            for (patch, ratio) in self.dictionary.shares(contact.patch) {
                let theirs = points.get(.., 3 * patch..3 * patch + 3);
                let ours = self.dictionary.own(patch);
                add_outer(sum.as_mut(), theirs, ours, variance * ratio * ratio);
            }
        }
        sum
    }

    /// Covariance of every point before anything was observed.
    fn prior_of_sample(
        &self,
        sample: &Configuration,
        points: MatRef<'_, f64>,
        families: &[OfFamily],
    ) -> Vec<[[f64; 3]; 3]> {
        let mut slots = vec![0.0; self.dictionary.n_columns()];
        self.add_slots(sample, &mut slots);
        let mut sum = prior_of_points(points, &slots);
        for ((own, family), &level) in families.iter().zip(&self.prior.families).zip(&sample.levels)
        {
            let entries = own.prior.as_flattened().as_flattened();
            for (sum, value) in sum.as_flattened_mut().as_flattened_mut().iter_mut().zip(entries) {
                *sum += family.factors[level] * value;
            }
        }
        sum
    }

    /// Coefficients drawn from the posterior, one column of `normals` a draw, samples in turn.
    ///
    /// # Shapes
    ///
    /// `normals` (`n_columns + n_obs`, `n_draws`), standard normal. Returned are (`n_columns`, `n_draws`).
    ///
    /// # Errors
    ///
    /// [`ContactsError::Shape`], [`ContactsError::NotFinite`], [`ContactsError::NotPositiveDefinite`].
    pub fn draws(
        &self,
        samples: &[Configuration],
        normals: MatRef<'_, f64>,
        par: Par,
    ) -> Result<Mat<f64>, ContactsError> {
        let (n_obs, n_columns) = (self.dictionary.n_obs(), self.dictionary.n_columns());
        check_length("normals", n_columns + n_obs, normals.nrows())?;
        if samples.is_empty() {
            return Err(ContactsError::Shape { argument: "samples", wanted: 1, found: 0 });
        }
        for one in samples {
            self.check_configuration(one)?;
        }
        for (entry, &value) in normals.col_iter().flat_map(|column| column.iter()).enumerate() {
            check_finite("normals", entry, value)?;
        }
        let one = |draw: usize| {
            let own: Vec<f64> = normals.col(draw).iter().copied().collect();
            self.draw(&samples[draw % samples.len()], &own)
        };
        let each: Vec<Result<Vec<f64>, ContactsError>> = match par {
            Par::Seq => (0..normals.ncols()).map(one).collect(),
            _ => (0..normals.ncols()).into_par_iter().map(one).collect(),
        };
        let each = each.into_iter().collect::<Result<Vec<_>, _>>()?;
        Ok(Mat::from_fn(n_columns, each.len(), |i, j| each[j][i]))
    }

    /// Matheron's rule: a draw from the prior, corrected by what it does not explain.
    fn draw(&self, sample: &Configuration, normals: &[f64]) -> Result<Vec<f64>, ContactsError> {
        let bad = |pivot| ContactsError::NotPositiveDefinite { pivot };
        let evidence = Evidence::of_state(self, sample).map_err(bad)?;
        let (columns, variances) = (self.dictionary.columns(), self.variances(sample));
        let (for_causes, for_noise) = normals.split_at(columns.ncols());
        let mut drawn: Vec<f64> =
            variances.iter().zip(for_causes).map(|(v, z)| v.sqrt() * z).collect();
        let mut noise = self.observed.noise.clone();
        for (rows, _) in self.prior.wrong.rows.iter().zip(&sample.wrong).filter(|(_, w)| **w) {
            rows.iter().for_each(|&row| noise[(row, row)] += self.prior.wrong.variance);
        }
        crate::linalg::cholesky_in_place(noise.as_mut()).map_err(bad)?;
        let mut left = self.observed.innovation.clone();
        let subtract = |left: &mut [f64], column: &[f64], factor: f64| {
            left.iter_mut().zip(column).for_each(|(left, entry)| *left -= factor * entry);
        };
        for (j, &factor) in for_noise.iter().enumerate() {
            subtract(&mut left[j..], &column(noise.as_ref(), j)[j..], factor);
        }
        for (j, &factor) in drawn.iter().enumerate().filter(|(_, factor)| **factor != 0.0) {
            subtract(&mut left, column(columns, j), factor);
        }
        let factor = evidence.factor.as_ref();
        let dual = backward(factor, &forward(factor, &left));
        for (j, coefficient) in drawn.iter_mut().enumerate().filter(|(j, _)| variances[*j] > 0.0) {
            *coefficient += variances[j] * dot(column(columns, j).iter(), dual.iter());
        }
        Ok(drawn)
    }
}

/// What samples share of one family, at factor one.
struct OfFamily {
    /// `T D J'` (`3 n_points`, `n_obs`)
    cross: Mat<f64>,
    /// `T D T'`, each point's own block.
    prior: Vec<[[f64; 3]; 3]>,
}

/// One sample's part.
struct Conditional {
    /// `C^-1`
    inverse: Mat<f64>,
    mean: Vec<f64>,
    covariance: Vec<[[f64; 3]; 3]>,
    prior: Vec<[[f64; 3]; 3]>,
    /// `d' C^-1 d`
    misfit: f64,
}

fn prior_of_points(points: MatRef<'_, f64>, variances: &[f64]) -> Vec<[[f64; 3]; 3]> {
    let mut all = vec![[[0.0; 3]; 3]; points.nrows() / 3];
    for (j, &variance) in variances.iter().enumerate().filter(|(_, v)| **v > 0.0) {
        for (point, sum) in all.iter_mut().enumerate() {
            let own: [f64; 3] = [0, 1, 2].map(|a| points[(3 * point + a, j)]);
            for a in 0..3 {
                for b in 0..3 {
                    sum[a][b] += variance * own[a] * own[b];
                }
            }
        }
    }
    all
}

/// Mean of the conditionals, and their mean covariance with the covariance of their means.
fn mixture(
    each: &[Conditional],
    gain: Mat<f64>,
    coefficients: Vec<f64>,
    n_points: usize,
) -> Moments {
    let share = 1.0 / each.len() as f64;
    let mut means = vec![[0.0; 3]; n_points];
    let mut covariances = vec![[[0.0; 3]; 3]; n_points];
    let mut prior_covariances = covariances.clone();
    for one in each {
        for (sum, value) in means.as_flattened_mut().iter_mut().zip(&one.mean) {
            *sum += share * value;
        }
    }
    for one in each {
        for point in 0..n_points {
            let off = [0, 1, 2].map(|a| one.mean[3 * point + a] - means[point][a]);
            for a in 0..3 {
                for b in 0..3 {
                    let spread = one.covariance[point][a][b] + off[a] * off[b];
                    covariances[point][a][b] += share * spread;
                    prior_covariances[point][a][b] += share * one.prior[point][a][b];
                }
            }
        }
    }
    let misfit = share * each.iter().map(|one| one.misfit).sum::<f64>();
    Moments { coefficients, gain, means, covariances, prior_covariances, misfit }
}

fn dot<'a>(a: impl Iterator<Item = &'a f64>, b: impl Iterator<Item = &'a f64>) -> f64 {
    a.zip(b).map(|(x, y)| x * y).sum()
}
