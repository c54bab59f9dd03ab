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
//!
//! Rows below `S` are factored along with it: `v'` becomes `w'`, and the identity `L'^-1`. Some pairs are factored side by
//! side, a lane each, because such small factors alone do not fill vector registers.

use faer::{MatRef, Par};
use pulp::{Arch, NullaryFnOnce};

use crate::bordered::{Bordered, Lanes};
use crate::check::{LANES, check_finite, check_setting, check_shape, row_of};
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
/// `n_obs^3 / 6` multiply-adds a pair, three times that with every group; eight pairs at once, and these on threads by
/// `par`, with the same bits.
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
        let first = number * LANES;
        let own = &pairs[first..pairs.len().min(first + LANES)];
        Arch::new().dispatch(Batch { covariances, innovations, pairs: own, noise, groups })
    };
    let scores = linalg::map_in_order(pairs.len().div_ceil(LANES), par, score);
    scores.into_iter().flatten().collect()
}

/// Up to `LANES` pairs, at least one; arguments as for [`score_components`].
struct Batch<'a> {
    covariances: MatRef<'a, f64>,
    innovations: MatRef<'a, f64>,
    pairs: &'a [ScaledComponent],
    noise: MatRef<'a, f64>,
    groups: Groups,
}

impl NullaryFnOnce for Batch<'_> {
    type Output = Vec<Result<ComponentScore, EsmdaError>>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let n = self.noise.nrows();
        let inverse = matches!(self.groups, Groups::Every(_));
        let mut factor = Bordered::new(n, inverse);
        // Lanes that are left over repeat the last pair.
        let pairs: [_; LANES] =
            std::array::from_fn(|lane| self.pairs[lane.min(self.pairs.len() - 1)]);
        let squares = pairs.map(|pair| pair.scale * pair.scale);
        for i in 0..n {
            let own = pairs.map(|pair| row_of(self.covariances, pair.component * n + i));
            let (own, noise) = (own.each_ref().map(|row| &row[..=i]), row_of(self.noise, i));
            for (j, entry) in factor.row_mut(i)[..=i].iter_mut().enumerate() {
                for lane in 0..LANES {
                    entry[lane] = squares[lane] * own[lane][j] + noise[j];
                }
            }
            factor.row_mut(n)[i] = pairs.map(|pair| self.innovations[(pair.component, i)]);
        }
        factor.run();
        let (square, log_det, pulls) = (factor.square(0), factor.log_det(0), factor.solution());
        let mut scores: Vec<_> = (0..self.pairs.len())
            .map(|lane| {
                let pull = pulls.iter().map(|one| one[lane]).collect();
                let (misfits, log_dets) = (Vec::new(), Vec::new());
                let log_density = -0.5 * (square[lane] + log_det[lane]);
                ComponentScore { log_density, pull, misfits, log_dets }
            })
            .collect();
        let mut add = |misfit: Lanes, log_det: Lanes| {
            for (lane, score) in scores.iter_mut().enumerate() {
                score.misfits.push(misfit[lane]);
                score.log_dets.push(log_det[lane]);
            }
        };
        let mut failed = factor.failed;
        match self.groups {
            Groups::Nothing => {}
            // The last of L^-1 v are what the others leave of the last observations, white.
            Groups::Last(size) => {
                add(factor.square(n - size), factor.log_det(n - size).map(|value| -value));
            }
            Groups::Every(size) => {
                for first in (0..n).step_by(size) {
                    let mut block = factor.block_of_inverse(first, size);
                    block.row_mut(size).copy_from_slice(&pulls[first..first + size]);
                    block.run();
                    add(block.square(0), block.log_det(0));
                    for (all, own) in failed.iter_mut().zip(block.failed) {
                        *all = all.or(own.map(|pivot| first + pivot));
                    }
                }
            }
        }
        let refused = |pivot| EsmdaError::NoiseNotPositiveDefinite { pivot };
        let checked = scores.into_iter().zip(failed);
        checked
            .map(|(score, failed)| failed.map_or(Ok(score), |pivot| Err(refused(pivot))))
            .collect()
    }
}
