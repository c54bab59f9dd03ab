//! Which Gaussian of a mixture observations came from, and how each group of them agrees with the others.
//!
//! A prior that is a mixture, with a linear model, says of the innovation `v` (observed minus predicted) under one of its
//! Gaussians `c` with its standard deviations times `s`
//!
//! ```text
//! v ~ N(0, S),      S = s^2 A_c + C_d,
//! ```
//!
//! where `A_c` is the covariance of the predictions. With the Cholesky factor `S = L L'`, `w = L^-1 v` and `u = L'^-1 w`,
//!
//! ```text
//! log N(v; 0, S) = -w'w / 2 - sum_i log L_ii     (but for a constant),
//! q_g = u_g' B^-1 u_g,    B = (S^-1)_gg,
//! ```
//!
//! and `q_g` is the squared distance of the observations `g` from their prediction by all others, in its own standard
//! deviations. Their density given the others is `N(B^-1 u_g; 0, B^-1)`.

use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Mat, MatRef, Par};

use crate::check::{check_finite, check_setting, check_shape};
use crate::{EsmdaError, linalg};

/// A Gaussian of the mixture, by its number, with a factor on its standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledComponent {
    /// Which covariance and innovation.
    pub component: usize,
    /// Factor on standard deviations.
    pub scale: f64,
}

/// Groups of observations that follow each other, of one size, which are compared with all other observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Groups {
    /// None.
    Nothing,
    /// All of them; the size divides the number of observations.
    Every(usize),
    /// The last one alone, which costs nothing more.
    Last(usize),
}

/// What the observations say of one scaled component.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ComponentScore {
    /// `log N(v; 0, S)` but for a constant.
    pub log_density: f64,
    /// `u = S^-1 v`, (n_obs).
    pub pull: Vec<f64>,
    /// `q` of each group that was asked for.
    pub misfits: Vec<f64>,
    /// `log det (S^-1)_gg` of each.
    pub log_dets: Vec<f64>,
}

/// Scores scaled components; see the [module documentation](self).
///
/// # Shapes
///
/// `covariances` (`n_components n_obs`, `n_obs`) are the `A_c` on top of each other, `innovations` (`n_components`, `n_obs`)
/// the `v` of each, `noise` (`n_obs`, `n_obs`) is `C_d`; of all, the lower halves are read.
///
/// # Errors
///
/// [`EsmdaError::Shape`], [`EsmdaError::NotFinite`], [`EsmdaError::Setting`] for a component or a group that there is
/// not, [`EsmdaError::NoiseNotPositiveDefinite`] if `S` has no Cholesky factor.
///
/// # Cost
///
/// `n_obs^3 / 6` multiply-adds a pair, three times that with every group; pairs on threads by `par`, with the same bits.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::{Groups, ScaledComponent, faer::{Mat, Par, mat}, score_components};
///
/// let (unit, v) = (Mat::<f64>::identity(2, 2), mat![[2.0, 0.0]]);
/// let pairs = [1.0, 3.0].map(|scale| ScaledComponent { component: 0, scale });
/// let scores = score_components(unit.as_ref(), v.as_ref(), &pairs, unit.as_ref(), Groups::Every(1), Par::Seq)?;
/// // S = 2: the first observation lies sqrt(2) deviations from where the second has it.
/// assert!((scores[0].misfits[0] - 2.0).abs() < 1e-14);
/// assert!((scores[0].log_density - (-1.0 - 2.0_f64.ln())).abs() < 1e-14);
/// # Ok::<(), tissuereg_esmda::EsmdaError>(())
/// ```
pub fn score_components(
    covariances: MatRef<'_, f64>,
    innovations: MatRef<'_, f64>,
    pairs: &[ScaledComponent],
    noise: MatRef<'_, f64>,
    groups: Groups,
    par: Par,
) -> Result<Vec<ComponentScore>, EsmdaError> {
    let (n_components, n_obs) = innovations.shape();
    check_shape("covariances", covariances.shape(), (n_components * n_obs, n_obs))?;
    check_shape("noise", noise.shape(), (n_obs, n_obs))?;
    check_finite("covariances", covariances)?;
    check_finite("innovations", innovations)?;
    check_finite("noise", noise)?;
    if let Groups::Every(size) | Groups::Last(size) = groups {
        let whole = size > 0 && n_obs > 0 && n_obs.is_multiple_of(size);
        check_setting("group", size as f64, "a divisor of the number of observations", whole)?;
    }
    for pair in pairs {
        let (number, known) = (pair.component as f64, pair.component < n_components);
        check_setting("component", number, "less than the number of components", known)?;
        let usable = pair.scale.is_finite();
        check_setting("scale", pair.scale, "finite", usable)?;
    }
    let score = |number: usize| {
        let ScaledComponent { component, scale } = pairs[number];
        let own = covariances.subrows(component * n_obs, n_obs);
        let square = scale * scale;
        let total = Mat::from_fn(n_obs, n_obs, |i, j| {
            if i < j { 0.0 } else { square * own[(i, j)] + noise[(i, j)] }
        });
        let innovation = Mat::from_fn(n_obs, 1, |i, _| innovations[(component, i)]);
        scored(total, innovation, groups)
    };
    linalg::map_in_order(pairs.len(), par, score).into_iter().collect()
}

/// Scores one innovation (n_obs, 1) under its covariance, of which the upper half is zero.
fn scored(
    mut lower: Mat<f64>,
    mut innovation: Mat<f64>,
    groups: Groups,
) -> Result<ComponentScore, EsmdaError> {
    let n_obs = lower.nrows();
    linalg::cholesky_in_place(lower.as_mut())
        .map_err(|pivot| EsmdaError::NoiseNotPositiveDefinite { pivot })?;
    solve_lower_triangular_in_place(lower.as_ref(), innovation.as_mut(), Par::Seq);
    let square: f64 = innovation.col(0).iter().map(|w| w * w).sum();
    let log_roots: Vec<f64> = lower.diagonal().column_vector().iter().map(|l| l.ln()).collect();
    let log_root: f64 = log_roots.iter().sum();
    let (mut misfits, mut log_dets) = (Vec::new(), Vec::new());
    if let Groups::Last(size) = groups {
        // The last rows of L^-1 v are what the others leave of the last observations, white.
        let first = n_obs - size;
        misfits.push(innovation.col(0).iter().skip(first).map(|w| w * w).sum());
        log_dets.push(-2.0 * log_roots[first..].iter().sum::<f64>());
    }
    solve_upper_triangular_in_place(lower.transpose(), innovation.as_mut(), Par::Seq);
    let pull: Vec<f64> = innovation.col(0).iter().copied().collect();
    if let Groups::Every(group) = groups {
        let mut root = Mat::identity(n_obs, n_obs);
        solve_lower_triangular_in_place(lower.as_ref(), root.as_mut(), Par::Seq);
        for first in (0..n_obs).step_by(group) {
            // Rows of L^-1 above the first column of a group are zero there.
            let own = root.get(first.., first..first + group);
            let mut block = own.transpose() * own;
            linalg::cholesky_in_place(block.as_mut())
                .map_err(|pivot| EsmdaError::NoiseNotPositiveDefinite { pivot: first + pivot })?;
            let mut white = Mat::from_fn(group, 1, |i, _| pull[first + i]);
            solve_lower_triangular_in_place(block.as_ref(), white.as_mut(), Par::Seq);
            misfits.push(white.col(0).iter().map(|w| w * w).sum());
            let log_root: f64 = block.diagonal().column_vector().iter().map(|l| l.ln()).sum();
            log_dets.push(2.0 * log_root);
        }
    }
    Ok(ComponentScore { log_density: -0.5 * square - log_root, pull, misfits, log_dets })
}
