//! The matrix `W` of a step, multiplied out or in factors.

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Accum, Mat, MatMut, MatRef, Par};

use super::settings::{Factorisation, Side, StepReport, StepSettings};
use crate::EsmdaError;
use crate::linalg::{self, product};

/// `W` (n, n).
#[derive(Debug, Clone)]
pub(super) enum Gain {
    /// Multiplied out.
    Whole(Mat<f64>),
    /// `W = A K B`: `A` (n, k), `K` (k, m), and `B'` (n, m).
    Factors { left: Mat<f64>, core: Core, right: Mat<f64> },
}

/// `K'` as something that can be applied.
#[derive(Debug, Clone)]
pub(super) enum Core {
    /// `I`
    Identity,
    /// `(L L')^-1`
    Cholesky(Mat<f64>),
    /// `U^-1`, `U` upper triangular
    Upper(Mat<f64>),
    /// `Q diag(f)`, `Q` (m, k)
    Filter { basis: Mat<f64>, filter: Vec<f64> },
}

impl Core {
    /// `K' t`
    fn apply(&self, mut t: Mat<f64>) -> Mat<f64> {
        match self {
            Self::Identity => t,
            Self::Cholesky(lower) => {
                solve_cholesky(lower, &mut t);
                t
            }
            Self::Upper(upper) => {
                solve_upper_triangular_in_place(upper.as_ref(), t.as_mut(), Par::Seq);
                t
            }
            Self::Filter { basis, filter } => {
                scale_rows(&mut t, filter);
                product(basis.as_ref(), t.as_ref())
            }
        }
    }
}

impl Gain {
    /// `rows <- rows + anomalies' W`, for a batch of parameters (anything, n) and their transposed anomalies.
    pub(super) fn add_to(&self, rows: MatMut<'_, f64>, anomalies: Mat<f64>) {
        let rows = rows.transpose_mut();
        match self {
            Self::Whole(weights) => {
                let weights = weights.transpose();
                matmul(rows, Accum::Add, weights, anomalies.as_ref(), 1.0, Par::Seq);
            }
            Self::Factors { left, core, right } => {
                let t = core.apply(product(left.transpose(), anomalies.as_ref()));
                matmul(rows, Accum::Add, right.as_ref(), t.as_ref(), 1.0, Par::Seq);
            }
        }
    }

    /// `W = S' (S S' + I)^-1 R` from `S'` and `R'`, both (n, m).
    pub(super) fn stochastic(
        anomalies: Mat<f64>,
        innovations: Mat<f64>,
        settings: &StepSettings,
    ) -> Result<(Self, StepReport), EsmdaError> {
        let (n_members, n_obs) = anomalies.shape();
        let members = match settings.side {
            Side::Smaller => n_members < n_obs,
            Side::Observations => false,
            Side::Members => true,
        };
        let side = if members { Side::Members } else { Side::Observations };
        let wanted = settings.factorisation;
        let mut report =
            StepReport { factorisation: wanted, side, condition_bound: None, log_evidence: None };
        if wanted == Factorisation::Svd {
            report.side = Side::Smaller;
            return Ok((Self::by_svd(&anomalies, innovations)?.multiplied_out(n_obs), report));
        }
        if wanted != Factorisation::Qr {
            let mut matrix = if members {
                linalg::outer_product(anomalies.as_ref(), anomalies.as_ref(), settings.par, true)
            } else {
                linalg::gram(anomalies.as_ref(), settings.par)
            };
            matrix.diagonal_mut().column_vector_mut().iter_mut().for_each(|entry| *entry += 1.0);
            let bound = largest_row_sum(&matrix);
            report.condition_bound = Some(bound);
            let allowed = wanted == Factorisation::Cholesky || bound <= settings.condition_limit;
            if allowed && bound.is_finite() && linalg::cholesky_in_place(matrix.as_mut()).is_ok() {
                report.factorisation = Factorisation::Cholesky;
                let gain = if members {
                    let mut weights = linalg::outer_product(
                        anomalies.as_ref(),
                        innovations.as_ref(),
                        settings.par,
                        false,
                    );
                    solve_cholesky(&matrix, &mut weights);
                    Self::Whole(weights)
                } else {
                    let core = Core::Cholesky(matrix);
                    Self::Factors { left: anomalies, core, right: innovations }
                };
                return Ok((gain.multiplied_out(n_obs), report));
            }
        }
        report.factorisation = Factorisation::Qr;
        let gain = if members {
            Self::by_qr_of_members(&anomalies, &innovations, settings.par)
        } else {
            Self::by_qr_of_observations(&anomalies, innovations)
        };
        Ok((gain.multiplied_out(n_obs), report))
    }

    /// `[S'; I] = Q U`, so `S' (S S' + I)^-1 = Q_top U^-T` and `W = Q_top U^-T R`.
    fn by_qr_of_observations(anomalies: &Mat<f64>, innovations: Mat<f64>) -> Self {
        let (n_members, n_obs) = anomalies.shape();
        let (q, upper) = linalg::thin_qr(over_identity(anomalies.as_ref()));
        let left = q.get(..n_members, ..).to_owned();
        debug_assert_eq!(left.ncols(), n_obs);
        Self::Factors { left, core: Core::Upper(upper), right: innovations }
    }

    /// `[S; I] = Q U`, so `(S' S + I)^-1 S' = U^-1 Q_top'` and `W = U^-1 (Q_top' R)`.
    fn by_qr_of_members(anomalies: &Mat<f64>, innovations: &Mat<f64>, par: Par) -> Self {
        let (_, n_obs) = anomalies.shape();
        let (q, upper) = linalg::thin_qr(over_identity(anomalies.transpose()));
        let top = q.get(..n_obs, ..).transpose();
        let mut weights = linalg::outer_product(top, innovations.as_ref(), par, false);
        solve_upper_triangular_in_place(upper.as_ref(), weights.as_mut(), Par::Seq);
        Self::Whole(weights)
    }

    /// `S' = U diag(w) V'` (so `U` belongs to the members), `W = U diag(w / (1 + w^2)) V' R`.
    fn by_svd(anomalies: &Mat<f64>, innovations: Mat<f64>) -> Result<Self, EsmdaError> {
        let svd = decompose(anomalies)?;
        let filter = svd.w.iter().map(|w| w / (1.0 + w * w)).collect();
        let core = Core::Filter { basis: svd.v, filter };
        Ok(Self::Factors { left: svd.u, core, right: innovations })
    }

    /// `W = U (diag(w / (1 + w^2)) V' r 1' + diag(1 / sqrt(1 + w^2) - 1) U')`, with `r` the mean innovation.
    pub(super) fn square_root(
        anomalies: &Mat<f64>,
        innovations: &Mat<f64>,
    ) -> Result<(Self, StepReport), EsmdaError> {
        let (n_members, n_obs) = anomalies.shape();
        let svd = decompose(anomalies)?;
        let mean = Mat::from_fn(n_obs, 1, |obs, _| {
            innovations.col(obs).iter().sum::<f64>() / n_members as f64
        });
        let along = product(svd.v.transpose(), mean.as_ref());
        let right = Mat::from_fn(n_members, svd.w.len(), |member, k| {
            let (w, root) = (svd.w[k], (1.0 + svd.w[k] * svd.w[k]).sqrt());
            // 1 / root - 1, without its cancellation at small w.
            let shrink = -w * w / (root * (1.0 + root));
            along[(k, 0)] * w / (1.0 + w * w) + shrink * svd.u[(member, k)]
        });
        // r' (S S' + I)^-1 r, and log det (S S' + I).
        let length: f64 = mean.col(0).iter().map(|r| r * r).sum();
        let (square, log_det) = svd.w.iter().zip(along.col(0).iter()).fold(
            (length, 0.0),
            |(square, log_det), (w, along)| {
                let squared = w * w;
                (square - along * along * squared / (1.0 + squared), log_det + squared.ln_1p())
            },
        );
        let report = StepReport {
            factorisation: Factorisation::Svd,
            side: Side::Smaller,
            condition_bound: None,
            log_evidence: Some(-0.5 * ((n_members - 1) as f64 * square + log_det)),
        };
        let gain = Self::Factors { left: svd.u, core: Core::Identity, right };
        Ok((gain, report))
    }

    /// Multiplies the factors out where that makes `apply` cheaper: with more observations than half the members.
    fn multiplied_out(self, n_obs: usize) -> Self {
        match self {
            Self::Factors { left, core, right } if 2 * n_obs >= left.nrows() => {
                let t = core.apply(left.transpose().to_owned());
                Self::Whole(product(right.as_ref(), t.as_ref()).transpose().to_owned())
            }
            other => other,
        }
    }
}

fn decompose(anomalies: &Mat<f64>) -> Result<linalg::ThinSvd, EsmdaError> {
    let (n_members, n_obs) = anomalies.shape();
    linalg::thin_svd(anomalies.as_ref()).ok_or(EsmdaError::NoConvergence { n_obs, n_members })
}

fn solve_cholesky(lower: &Mat<f64>, rhs: &mut Mat<f64>) {
    solve_lower_triangular_in_place(lower.as_ref(), rhs.as_mut(), Par::Seq);
    solve_upper_triangular_in_place(lower.transpose(), rhs.as_mut(), Par::Seq);
}

fn scale_rows(matrix: &mut Mat<f64>, factors: &[f64]) {
    for column in matrix.col_iter_mut() {
        column.iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
    }
}

/// `[top; I]`
fn over_identity(top: MatRef<'_, f64>) -> Mat<f64> {
    let (n, k) = top.shape();
    let mut stacked = Mat::zeros(n + k, k);
    stacked.get_mut(..n, ..).copy_from(top);
    stacked
        .get_mut(n.., ..)
        .diagonal_mut()
        .column_vector_mut()
        .iter_mut()
        .for_each(|entry| *entry = 1.0);
    stacked
}

/// Largest absolute row sum of a symmetric matrix given by its lower half: a bound on its largest eigenvalue, and, as
/// the smallest is at least one, on its condition number.
fn largest_row_sum(matrix: &Mat<f64>) -> f64 {
    let n = matrix.nrows();
    let mut sums = vec![0.0_f64; n];
    for column in 0..n {
        let below = &matrix.col_as_slice(column)[column..];
        let mut own = 0.0;
        for (sum, entry) in sums[column..].iter_mut().zip(below) {
            *sum += entry.abs();
            own += entry.abs();
        }
        // The diagonal entry is in both.
        sums[column] += own - below[0].abs();
    }
    // `max` would pass over a NaN.
    sums.into_iter()
        .fold(0.0, |largest, sum| if sum > largest || sum.is_nan() { sum } else { largest })
}
