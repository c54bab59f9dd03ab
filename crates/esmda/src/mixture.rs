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
use pulp::{Arch, Simd, WithSimd};

use crate::bordered::Bordered;
use crate::check::{check_finite, check_setting, check_shape, row_of};
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
/// `n_obs^3 / 6` multiply-adds a pair, three times that with every group; several pairs at once, and these on threads by
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
    let n_batches = pairs.len().div_ceil(BATCH);
    let scores = linalg::map_in_order(n_batches, par, |number| {
        let pairs = &pairs[number * BATCH..pairs.len().min((number + 1) * BATCH)];
        Arch::new().dispatch(Batch { covariances, innovations, pairs, noise, groups })
    });
    scores.into_iter().flatten().collect()
}

/// Pairs that a thread takes at once: a multiple of the lanes of any processor.
const BATCH: usize = 16;

/// Some pairs; other arguments as for [`score_components`].
struct Batch<'a> {
    covariances: MatRef<'a, f64>,
    innovations: MatRef<'a, f64>,
    pairs: &'a [ScaledComponent],
    noise: MatRef<'a, f64>,
    groups: Groups,
}

impl WithSimd for Batch<'_> {
    type Output = Vec<Result<ComponentScore, EsmdaError>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let mut scores = Vec::with_capacity(self.pairs.len());
        for pairs in self.pairs.chunks(S::F64_LANES) {
            scores.extend(self.scored(simd, pairs));
        }
        scores
    }
}

impl Batch<'_> {
    /// Scores of as many pairs as there are lanes, or fewer.
    #[inline(always)]
    fn scored<S: Simd>(
        &self,
        simd: S,
        pairs: &[ScaledComponent],
    ) -> Vec<Result<ComponentScore, EsmdaError>> {
        let n = self.noise.nrows();
        let inverse = matches!(self.groups, Groups::Every(_));
        let mut factor = self.joined(simd, pairs, inverse);
        factor.run();
        let (square, log_det, pulls) = (factor.square(0), factor.log_det(0), factor.solution());
        let mut scores: Vec<_> = (0..pairs.len())
            .map(|lane| ComponentScore {
                log_density: -0.5 * (square[lane] + log_det[lane]),
                pull: pulls.iter().skip(lane).step_by(S::F64_LANES).copied().collect(),
                misfits: Vec::new(),
                log_dets: Vec::new(),
            })
            .collect();
        let mut add = |misfits: Vec<f64>, log_dets: Vec<f64>| {
            for (score, (misfit, log_det)) in
                scores.iter_mut().zip(misfits.into_iter().zip(log_dets))
            {
                score.misfits.push(misfit);
                score.log_dets.push(log_det);
            }
        };
        let mut failed = factor.failed.clone();
        match self.groups {
            Groups::Nothing => {}
            // The last of L^-1 v are what the others leave of the last observations, white.
            Groups::Last(size) => {
                let log_dets = factor.log_det(n - size).into_iter().map(|value| -value);
                add(factor.square(n - size), log_dets.collect());
            }
            Groups::Every(size) => {
                for first in (0..n).step_by(size) {
                    let mut block = factor.block_of_inverse(first, size);
                    let own = pulls.chunks_exact(S::F64_LANES).skip(first).take(size);
                    own.enumerate()
                        .for_each(|(j, own)| block.lanes_mut(size, j).copy_from_slice(own));
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

    /// Covariances of the innovations of some pairs and the innovations, a lane each; lanes that are left over repeat the
    /// last pair.
    #[inline(always)]
    fn joined<S: Simd>(&self, simd: S, pairs: &[ScaledComponent], inverse: bool) -> Bordered<S> {
        let n = self.noise.nrows();
        let mut joined = Bordered::new(simd, n, inverse);
        for i in 0..n {
            let noise = row_of(self.noise, i);
            for lane in 0..S::F64_LANES {
                let ScaledComponent { component, scale } = pairs[lane.min(pairs.len() - 1)];
                let (own, square) = (row_of(self.covariances, component * n + i), scale * scale);
                for (j, (own, noise)) in own[..=i].iter().zip(&*noise).enumerate() {
                    joined.lanes_mut(i, j)[lane] = square * own + noise;
                }
                joined.lanes_mut(n, i)[lane] = self.innovations[(component, i)];
            }
        }
        joined
    }
}
