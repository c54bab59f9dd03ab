//! What samples mean: coefficients, and means and covariances of whatever follows the causes linearly.
//!
//! Given a configuration everything is Gaussian. With `D` the variances of the coefficients, `J` the columns, `C` the
//! covariance of the observations and `d` the innovation,
//!
//! ```text
//! coefficients:  D J' C^-1 d                 (n_columns)
//! targets:       X C^-1 d,                   X = T D J' + N      (n_targets, n_obs)
//! covariance:    T D T' + M - X C^-1 X'
//! ```
//!
//! with `T` the targets' responses, `N` the covariance of targets and observations by what is uncertain besides the
//! causes, and `M` that of the targets by it. The posterior is the mixture over samples.

use faer::{Mat, MatRef, Par};
use rayon::prelude::*;

use crate::dictionary::check_finite;
use crate::linalg::{add_outer, add_scaled, backward, forward_in_place, product};
use crate::prior::{check_length, scaled_columns};
use crate::state::Evidence;
use crate::{Configuration, ContactsError, Problem};

/// Points that follow the causes, three rows each.
#[derive(Debug, Clone)]
pub struct Targets {
    /// Responses (`3 n_points`, `n_columns`).
    pub columns: Mat<f64>,
    /// Covariance with the observations by what is uncertain besides the causes, (`3 n_points`, `n_obs`).
    pub with_observed: Mat<f64>,
    /// Covariance (3, 3) of each point by what is uncertain besides the causes, (`n_points`).
    pub own: Vec<[[f64; 3]; 3]>,
}

/// Moments of the mixture over samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Moments {
    /// Mean of every column's coefficient.
    pub coefficients: Vec<f64>,
    /// Mean of every point.
    pub means: Vec<[f64; 3]>,
    /// Covariance of every point.
    pub covariances: Vec<[[f64; 3]; 3]>,
    /// Mean over samples of each point's covariance before anything was observed.
    pub prior_covariances: Vec<[[f64; 3]; 3]>,
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
        for contact in one.slots.iter().flatten() {
            let variance = self.prior.variances[contact.size];
            for (patch, ratio) in self.dictionary.shares(contact.patch) {
                for sum in &mut all[3 * patch..3 * patch + 3] {
                    *sum += variance * ratio * ratio;
                }
            }
        }
        all
    }

    /// Moments of coefficients and points over samples that count alike.
    ///
    /// # Errors
    ///
    /// [`ContactsError::Shape`], [`ContactsError::NotFinite`], [`ContactsError::NotPositiveDefinite`].
    pub fn moments(
        &self,
        samples: &[Configuration],
        targets: &Targets,
        par: Par,
    ) -> Result<Moments, ContactsError> {
        self.check_targets(targets)?;
        if samples.is_empty() {
            return Err(ContactsError::Shape { argument: "samples", wanted: 1, found: 0 });
        }
        for one in samples {
            self.check_configuration(one)?;
        }
        let families = self.prior.families.iter().map(|family| {
            let scaled = scaled_columns(targets.columns.as_ref(), &family.variances);
            product(scaled.as_ref(), self.dictionary.columns().transpose())
        });
        let families: Vec<Mat<f64>> = families.collect();
        let one = |sample| self.conditional(sample, targets, &families);
        let each: Vec<Result<Conditional, ContactsError>> = match par {
            Par::Seq => samples.iter().map(one).collect(),
            _ => samples.par_iter().map(one).collect(),
        };
        let each = each.into_iter().collect::<Result<Vec<_>, _>>()?;
        Ok(mixture(&each, self.dictionary.n_columns(), targets.own.len()))
    }

    fn check_targets(&self, targets: &Targets) -> Result<(), ContactsError> {
        let (n_rows, n_obs) = (3 * targets.own.len(), self.dictionary.n_obs());
        check_length("columns of targets", n_rows, targets.columns.nrows())?;
        check_length("columns of targets", self.dictionary.n_columns(), targets.columns.ncols())?;
        check_length("with_observed", n_rows, targets.with_observed.nrows())?;
        check_length("with_observed", n_obs, targets.with_observed.ncols())?;
        let matrices =
            [("columns of targets", &targets.columns), ("with_observed", &targets.with_observed)];
        for (argument, matrix) in matrices {
            for j in 0..matrix.ncols() {
                for i in 0..n_rows {
                    check_finite(argument, i + j * n_rows, matrix[(i, j)])?;
                }
            }
        }
        let own = targets.own.as_flattened().as_flattened().iter().enumerate();
        own.into_iter().try_for_each(|(entry, &value)| check_finite("own", entry, value))
    }

    fn conditional(
        &self,
        sample: &Configuration,
        targets: &Targets,
        families: &[Mat<f64>],
    ) -> Result<Conditional, ContactsError> {
        let evidence = Evidence::of_state(self, sample)
            .ok_or(ContactsError::NotPositiveDefinite { pivot: 0 })?;
        let variances = self.variances(sample);
        let dual = backward(evidence.factor.as_ref(), &evidence.white);
        let columns = self.dictionary.columns();
        let coefficients = (0..columns.ncols()).map(|j| match variances[j] {
            0.0 => 0.0,
            variance => variance * dot(columns.col(j).iter(), dual.iter()),
        });
        let coefficients = coefficients.collect();
        let mut x = self.cross(sample, targets, families);
        let mean = (0..x.nrows()).map(|i| dot(x.row(i).iter(), dual.iter())).collect();
        let prior = prior_of_points(targets, &variances);
        // L^-1 X': its columns' inner products are what the observations take away.
        let mut taken = x.as_mut().transpose().to_owned();
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
        Ok(Conditional { coefficients, mean, covariance, prior })
    }

    /// `T D J' + N`.
    fn cross(&self, sample: &Configuration, targets: &Targets, families: &[Mat<f64>]) -> Mat<f64> {
        let mut sum = targets.with_observed.clone();
        let by_family = families.iter().zip(&self.prior.families).zip(&sample.levels);
        for ((matrix, family), &level) in by_family {
            add_scaled(sum.as_mut(), matrix.as_ref(), family.factors[level]);
        }
        for contact in sample.slots.iter().flatten() {
            let variance = self.prior.variances[contact.size];
            for (patch, ratio) in self.dictionary.shares(contact.patch) {
                let columns = 3 * patch..3 * patch + 3;
                let (theirs, ours) = (targets.columns.get(.., columns), self.dictionary.own(patch));
                add_outer(sum.as_mut(), theirs, ours, variance * ratio * ratio);
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
        let bad = || ContactsError::NotPositiveDefinite { pivot: 0 };
        let evidence = Evidence::of_state(self, sample).ok_or_else(bad)?;
        let (columns, variances) = (self.dictionary.columns(), self.variances(sample));
        let (for_causes, for_noise) = normals.split_at(columns.ncols());
        let mut drawn: Vec<f64> =
            variances.iter().zip(for_causes).map(|(v, z)| v.sqrt() * z).collect();
        let mut noise = self.observed.noise.clone();
        for (rows, _) in self.prior.wrong.rows.iter().zip(&sample.wrong).filter(|(_, w)| **w) {
            rows.iter().for_each(|&row| noise[(row, row)] += self.prior.wrong.variance);
        }
        crate::linalg::cholesky_in_place(noise.as_mut())
            .map_err(|pivot| ContactsError::NotPositiveDefinite { pivot })?;
        let mut left = self.observed.innovation.clone();
        for i in 0..left.len() {
            let made: f64 = (0..=i).map(|j| noise[(i, j)] * for_noise[j]).sum();
            left[i] -= made + dot(columns.row(i).iter(), drawn.iter());
        }
        let factor = evidence.factor.as_ref();
        let dual = backward(factor, &crate::linalg::forward(factor, &left));
        for (j, coefficient) in drawn.iter_mut().enumerate().filter(|(j, _)| variances[*j] > 0.0) {
            *coefficient += variances[j] * dot(columns.col(j).iter(), dual.iter());
        }
        Ok(drawn)
    }
}

/// One sample's part.
struct Conditional {
    coefficients: Vec<f64>,
    mean: Vec<f64>,
    covariance: Vec<[[f64; 3]; 3]>,
    prior: Vec<[[f64; 3]; 3]>,
}

fn prior_of_points(targets: &Targets, variances: &[f64]) -> Vec<[[f64; 3]; 3]> {
    let mut all = targets.own.clone();
    for (j, &variance) in variances.iter().enumerate().filter(|(_, v)| **v > 0.0) {
        for (point, sum) in all.iter_mut().enumerate() {
            let own: [f64; 3] = [0, 1, 2].map(|a| targets.columns[(3 * point + a, j)]);
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
fn mixture(each: &[Conditional], n_columns: usize, n_points: usize) -> Moments {
    let share = 1.0 / each.len() as f64;
    let mut all = Moments {
        coefficients: vec![0.0; n_columns],
        means: vec![[0.0; 3]; n_points],
        covariances: vec![[[0.0; 3]; 3]; n_points],
        prior_covariances: vec![[[0.0; 3]; 3]; n_points],
    };
    for one in each {
        for (sum, value) in all.coefficients.iter_mut().zip(&one.coefficients) {
            *sum += share * value;
        }
        for (sum, value) in all.means.as_flattened_mut().iter_mut().zip(&one.mean) {
            *sum += share * value;
        }
    }
    for one in each {
        for point in 0..n_points {
            let off = [0, 1, 2].map(|a| one.mean[3 * point + a] - all.means[point][a]);
            for a in 0..3 {
                for b in 0..3 {
                    let spread = one.covariance[point][a][b] + off[a] * off[b];
                    all.covariances[point][a][b] += share * spread;
                    all.prior_covariances[point][a][b] += share * one.prior[point][a][b];
                }
            }
        }
    }
    all
}

fn dot<'a>(a: impl Iterator<Item = &'a f64>, b: impl Iterator<Item = &'a f64>) -> f64 {
    a.zip(b).map(|(x, y)| x * y).sum()
}
