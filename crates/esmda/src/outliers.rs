//! Observations that contradict the others, tested after the fit: one chi-square a group.
//!
//! A group holds the observations of one instrument, such as the three components of a marker: they are right or wrong
//! together. What a group differs from the fit by is not judged by the noise alone, for the fit has followed its own
//! data: the residual of a wrong observation is the smaller, the more the fit leans on it.
//!
//! # Derivation
//!
//! Let `d = H x + e` with `e ~ N(0, C_d)`, the prior `x ~ N(m, C)`, and `S = H C H' + C_d`. The fit that minimises prior
//! and data terms is `x^ = m + C H' S^-1 (d - H m)`, so its residual and the residual's covariance are
//!
//! ```text
//! r = d - H x^ = (I - H C H' S^-1) (d - H m) = C_d S^-1 (d - H m)
//! cov(r) = C_d S^-1 S S^-1 C_d = C_d S^-1 C_d = C_d - H P H',      P = (C^-1 + H' C_d^-1 H)^-1
//! ```
//!
//! `H P H'`, the posterior covariance of the predictions, is what the fit has absorbed of the noise; with the noise
//! whitened it is the hat matrix, and its diagonal the leverages. Where the noise of different groups is correlated, the
//! residual of one shows in the others too. So it is weighted first, `u = C_d^-1 r`, with the covariance
//! `U = C_d^-1 (C_d - H P H') C_d^-1`, which is `S^-1`. For a group with the rows `g`,
//!
//! ```text
//! q = u_g' (U_gg)^-1 u_g
//! ```
//!
//! follows a chi-square law with as many degrees of freedom as the group has rows, if prior and noise are as stated. As
//! `(S^-1)_gg` is the inverse of the covariance of `d_g` given all other observations, `q` is the misfit of the group to
//! the prediction from all others. If the noise of the group is independent of the others, this is
//! `r_g' (C_d - H P H')_gg^-1 r_g`, the residual with its own covariance.
//!
//! # Use
//!
//! Score, drop the group with the smallest p-value if it is below the level over the number of groups (Bonferroni:
//! then some good group is lost from good data at most at the rate of the level), fit again without it, and repeat. One
//! at a time: a wrong group spoils the residuals of the good ones.
//!
//! # Reference
//!
//! W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission, Publications on
//! Geodesy 2(5), 1968, for one observation at a time without a prior ("data snooping").

use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Mat, MatRef, Par, Side};

use crate::check::{check_finite, check_setting, check_shape};
use crate::{EsmdaError, chi_square, linalg};

/// Least share of a group's noise that a fit is taken to leave, along any direction: the posterior covariance is an
/// estimate, and a residual without any spread left could not be judged.
pub const LEAST_SHARE: f64 = 0.05;

/// How far one group of observations lies from the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct GroupScore {
    /// `q` of the module's documentation.
    pub chi_square: f64,
    /// Observations of the group.
    pub n_obs: usize,
    /// Probability of a `chi_square` at least this large where nothing is wrong; one for a group without observations.
    pub p_value: f64,
    /// Mean leverage: the share of the group's noise, 0 to 1, that the fit has absorbed.
    pub leverage: f64,
}

/// Scores groups of observations by their fitted residuals; see the [module documentation](self).
///
/// # Shapes
///
/// `residual` (`n_obs`) is observed minus fitted. `noise` and `absorbed` are (`n_obs`, `n_obs`), the covariances `C_d` and
/// `H P H'` in the unit of the residual squared; of both, the lower halves are read.
/// `groups` (`n_obs`) names the group of every observation, below `n_groups`; a group may have none.
///
/// # Errors
///
/// [`EsmdaError::Shape`], [`EsmdaError::NotFinite`], [`EsmdaError::Setting`] for a group that there is not,
/// [`EsmdaError::NoiseNotPositiveDefinite`] with the observation.
///
/// # Cost
///
/// About `2 n_obs^3` multiply-adds.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::{faer::Mat, score_groups, wrong_groups};
///
/// // Two markers of two components; the fit has absorbed half the noise, and the second is three deviations off.
/// let noise = Mat::<f64>::identity(4, 4);
/// let absorbed = Mat::from_fn(4, 4, |i, j| if i == j { 0.5 } else { 0.0 });
/// let (residual, groups) = ([0.5, -0.5, 3.0, 3.0], [0, 0, 1, 1]);
/// let scores = score_groups(&residual, noise.as_ref(), absorbed.as_ref(), &groups, 2)?;
/// assert!((scores[1].chi_square - 36.0).abs() < 1e-12);
/// assert!((scores[1].p_value - (-18.0_f64).exp()).abs() < 1e-20);
/// assert_eq!(wrong_groups(&scores, 0.01), [1]);
/// # Ok::<(), tissuereg_esmda::EsmdaError>(())
/// ```
pub fn score_groups(
    residual: &[f64],
    noise: MatRef<'_, f64>,
    absorbed: MatRef<'_, f64>,
    groups: &[usize],
    n_groups: usize,
) -> Result<Vec<GroupScore>, EsmdaError> {
    let n_obs = residual.len();
    check_shape("noise", noise.shape(), (n_obs, n_obs))?;
    check_shape("absorbed", absorbed.shape(), (n_obs, n_obs))?;
    check_shape("groups", (groups.len(), 1), (n_obs, 1))?;
    check_finite("residual", MatRef::from_column_major_slice(residual, n_obs, 1))?;
    check_finite("noise", noise)?;
    check_finite("absorbed", absorbed)?;
    let mut rows = vec![Vec::new(); n_groups];
    for (obs, &group) in groups.iter().enumerate() {
        let value = group as f64;
        check_setting("groups", value, "less than `n_groups`", group < n_groups)?;
        rows[group].push(obs);
    }
    let weighted = Weighted::new(residual, noise, absorbed)?;
    rows.iter().map(|rows| weighted.score(rows)).collect()
}

/// Groups whose p-value is below `level` over the number of groups that have observations, the worst first.
///
/// `level` is the rate at which some group is found although none is wrong (at most; Bonferroni's bound). A wrong group
/// may take good ones with it: drop the first alone, fit again, and ask again.
pub fn wrong_groups(scores: &[GroupScore], level: f64) -> Vec<usize> {
    let n_groups = scores.iter().filter(|score| score.n_obs > 0).count();
    let beyond = |group: &usize| {
        let score = scores[*group];
        score.n_obs > 0 && score.p_value * (n_groups as f64) < level
    };
    let mut wrong: Vec<usize> = (0..scores.len()).filter(beyond).collect();
    wrong.sort_by(|&a, &b| {
        let (a, b) = (scores[a], scores[b]);
        // Tails below the smallest number are all zero: the larger misfit is then the worse one.
        a.p_value.total_cmp(&b.p_value).then(b.chi_square.total_cmp(&a.chi_square))
    });
    wrong
}

/// Residuals and covariances, weighted by the noise.
struct Weighted {
    /// `C_d^-1 r`, (n_obs, 1)
    residual: Mat<f64>,
    /// `C_d^-1`, (n_obs, n_obs)
    precision: Mat<f64>,
    /// `C_d^-1 H P H' C_d^-1`, (n_obs, n_obs)
    absorbed: Mat<f64>,
}

impl Weighted {
    fn new(
        residual: &[f64],
        noise: MatRef<'_, f64>,
        absorbed: MatRef<'_, f64>,
    ) -> Result<Self, EsmdaError> {
        let n_obs = residual.len();
        let mut lower = noise.to_owned();
        linalg::cholesky_in_place(lower.as_mut())
            .map_err(|pivot| EsmdaError::NoiseNotPositiveDefinite { pivot })?;
        let weigh = |matrix: &mut Mat<f64>| {
            solve_lower_triangular_in_place(lower.as_ref(), matrix.as_mut(), Par::Seq);
            solve_upper_triangular_in_place(lower.transpose(), matrix.as_mut(), Par::Seq);
        };
        let mut residual = Mat::from_fn(n_obs, 1, |obs, _| residual[obs]);
        weigh(&mut residual);
        let mut precision = Mat::identity(n_obs, n_obs);
        weigh(&mut precision);
        let mut half = Mat::from_fn(n_obs, n_obs, |i, j| absorbed[(i.max(j), i.min(j))]);
        weigh(&mut half);
        let mut absorbed = half.transpose().to_owned();
        weigh(&mut absorbed);
        Ok(Self { residual, precision, absorbed })
    }

    fn score(&self, rows: &[usize]) -> Result<GroupScore, EsmdaError> {
        let n_obs = rows.len();
        if n_obs == 0 {
            return Ok(GroupScore { chi_square: 0.0, n_obs, p_value: 1.0, leverage: 0.0 });
        }
        let block = |matrix: &Mat<f64>| {
            Mat::from_fn(n_obs, n_obs, |i, j| matrix[(rows[i.max(j)], rows[i.min(j)])])
        };
        // The group's covariance without a fit, whitened away, leaves the share that the fit has left.
        let mut lower = block(&self.precision);
        linalg::cholesky_in_place(lower.as_mut())
            .map_err(|pivot| EsmdaError::NoiseNotPositiveDefinite { pivot: rows[pivot] })?;
        let whiten = |matrix: &mut Mat<f64>| {
            solve_lower_triangular_in_place(lower.as_ref(), matrix.as_mut(), Par::Seq);
        };
        let mut whitened = Mat::from_fn(n_obs, 1, |i, _| self.residual[(rows[i], 0)]);
        whiten(&mut whitened);
        let mut half = block(&self.absorbed);
        whiten(&mut half);
        let mut hat = half.transpose().to_owned();
        whiten(&mut hat);
        let leverage = hat.diagonal().column_vector().iter().sum::<f64>() / n_obs as f64;
        let left = Mat::from_fn(n_obs, n_obs, |i, j| f64::from(u8::from(i == j)) - hat[(i, j)]);
        let eigen = left
            .self_adjoint_eigen(Side::Lower)
            .map_err(|_| EsmdaError::NoConvergence { n_obs, n_members: n_obs })?;
        let shares = eigen.S().column_vector();
        let chi_square: f64 = (0..n_obs)
            .map(|k| {
                let axis = eigen.U().col(k);
                let along: f64 = axis.iter().zip(whitened.col(0).iter()).map(|(u, r)| u * r).sum();
                along * along / shares[k].max(LEAST_SHARE)
            })
            .sum();
        // Infinity less infinity, in a residual beyond all numbers.
        let chi_square = if chi_square.is_nan() { f64::INFINITY } else { chi_square };
        let p_value = chi_square::tail(chi_square, n_obs);
        Ok(GroupScore { chi_square, n_obs, p_value, leverage })
    }
}
