//! The most probable parameters and a Gaussian about them: Gauss-Newton with a Laplace covariance.
//!
//! Beside the ensemble there is, for few parameters and a smooth model, the minimum of
//!
//! ```text
//! J(x) = (d - g(x))' C_d^-1 (d - g(x)) + (x - m)' C^-1 (x - m),     C_d = L L',  C = M M'
//! ```
//!
//! whose curvature there gives the posterior `N(x^, (C^-1 + G' C_d^-1 G)^-1)`, `G` the model's Jacobian at `x^` (the second
//! derivatives of the model left out). It needs no random numbers and a few dozen evaluations, and has no sampling error;
//! it sees one minimum, and of a curved posterior no more than the ellipsoid.
//!
//! In `w = M^-1 (x - m)` and with `A = L^-1 G M`, `b = L^-1 (d - g(x))`, each step solves
//!
//! ```text
//! min |A s - b|^2 + |w + s|^2 + c |s|^2
//! ```
//!
//! by QR of `[A; sqrt(1 + c) I]`: the normal equations, whose condition number is the square, are never formed. The damping
//! `c` is that of Levenberg and Marquardt in the metric of the prior, so the iteration does not depend on the units of the
//! parameters, nor on any affine change of them. It is zero as long as the misfit falls about as much as the linear model says.
//!
//! A [`GaussNewton`] calls nothing: it names a point, takes the predictions there, and says what it makes of them.
//!
//! # References
//!
//! D. S. Oliver, A. C. Reynolds and N. Liu, "Inverse theory for petroleum reservoir characterization and history
//! matching", Cambridge University Press, 2008, chapter 8. J. Nocedal and S. J. Wright, "Numerical optimization", 2nd edition,
//! Springer, 2006, section 10.3.

mod differences;
mod linear;

use faer::{Mat, MatRef, Par};

use self::linear::{Damped, Linear};
use crate::check::{check_finite, check_setting, check_shape};
use crate::linalg::product;
use crate::{EsmdaError, Gaussian, NoiseCovariance};

/// Share of the decrease of the linear model that a step must bring.
const LEAST_SHARE: f64 = 1e-4;

/// Shares from which on the linear model is good, and the damping falls, and below which it is poor, and the damping grows.
const GOOD_SHARE: f64 = 0.75;
const POOR_SHARE: f64 = 0.25;

/// First damping after a step that failed, in units of the prior's precision, and the damping below which there is none.
const FIRST_DAMPING: f64 = 1.0;
const LEAST_DAMPING: f64 = 0.1;

/// Factor by which the damping grows or falls.
const DAMPING_FACTOR: f64 = 8.0;

/// A decrease of less than this share of the misfit may be the rounding of the model, even one in `f32`. Steps that promise
/// no more are taken unless they do more harm than that, and judged by the next one.
const ROUNDING_SHARE: f64 = 1e-5;

/// Share of a step that the next one may take back, and may repeat, before it is said to be too long or too short.
const TAKEN_BACK: f64 = 0.5;
const REPEATED: f64 = 0.25;

/// What a caller may choose about a search.
///
/// Further settings may come: start from the default and change what differs.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SearchSettings {
    /// The search ends where the next step is shorter than this many standard deviations of the posterior.
    pub tolerance: f64,
    /// Points at which the model may be evaluated, neighbours for derivatives not counted.
    pub max_evaluations: usize,
    /// Distance of neighbours for derivatives by differences, in standard deviations of the prior.
    pub difference: f64,
    /// Largest absolute prediction taken for the work of a sane model, in the unit of the observations.
    pub largest: f64,
}

impl Default for SearchSettings {
    fn default() -> Self {
        Self { tolerance: 1e-3, max_evaluations: 50, difference: 1e-4, largest: 1e12 }
    }
}

impl SearchSettings {
    /// The same with another [`tolerance`](Self::tolerance).
    #[must_use]
    pub fn with_tolerance(self, tolerance: f64) -> Self {
        Self { tolerance, ..self }
    }

    /// The same with another [`max_evaluations`](Self::max_evaluations).
    #[must_use]
    pub fn with_max_evaluations(self, max_evaluations: usize) -> Self {
        Self { max_evaluations, ..self }
    }

    /// The same with another [`difference`](Self::difference): about `1e-2` for a model in `f32`.
    #[must_use]
    pub fn with_difference(self, difference: f64) -> Self {
        Self { difference, ..self }
    }

    /// The same with another largest prediction: [`largest`](Self::largest).
    #[must_use]
    pub fn with_largest(self, largest: f64) -> Self {
        Self { largest, ..self }
    }

    fn check(&self) -> Result<(), EsmdaError> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        let rule = "positive and finite";
        check_setting("tolerance", self.tolerance, rule, positive(self.tolerance))?;
        check_setting("difference", self.difference, rule, positive(self.difference))?;
        check_setting("largest", self.largest, rule, positive(self.largest))?;
        let most = self.max_evaluations;
        check_setting("max_evaluations", most as f64, "at least one", most > 0)
    }
}

/// What became of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Evaluation {
    /// Whether the search goes on from here. If not, [`GaussNewton::point`] is already the next, closer one.
    pub accepted: bool,
    /// Whether the model failed here: predictions not finite or too large.
    pub failed: bool,
    /// `J` here; infinite where the model failed.
    pub misfit: f64,
    /// By how much `J` is below that of the point before; zero at the first.
    pub decrease: f64,
    /// By how much the linear model said it would be.
    pub expected: f64,
}

/// What is known at an accepted point.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Linearised {
    /// Whether the search is over: the point is the mean of the [`posterior`](GaussNewton::posterior).
    pub converged: bool,
    /// Length of the undamped step from here, in standard deviations of the posterior.
    pub step: f64,
    /// Damping of the next step, in units of the prior's precision.
    pub damping: f64,
    /// Prior directions whose derivative is one-sided, because the model failed on the other side.
    pub one_sided: Vec<usize>,
}

/// A search for the most probable parameters; see the [module documentation](self).
///
/// # Examples
///
/// One parameter with the prior N(0, 1), of which the exponential is observed:
///
/// ```
/// use tissuereg_esmda::faer::mat;
/// use tissuereg_esmda::{EsmdaError, GaussNewton, Gaussian, NoiseCovariance, SearchSettings};
///
/// let prior = Gaussian::new(&[0.0], mat![[1.0]].as_ref())?;
/// let noise = NoiseCovariance::diagonal(&[0.1])?;
/// let mut search = GaussNewton::new(prior, &[3.0], noise, SearchSettings::default())?;
/// loop {
///     let predicted = search.point()[0].exp(); // the model
///     if search.evaluate(&[predicted])?.accepted {
///         let jacobian = mat![[predicted]];
///         if search.linearise(jacobian.as_ref())?.converged {
///             break;
///         }
///     }
/// }
/// let posterior = search.posterior()?;
/// assert!((posterior.mean()[0] - 3.0_f64.ln()).abs() < 2e-3); // the prior pulls it down a little
/// assert!((posterior.root()[(0, 0)] - 0.1 / 3.0).abs() < 1e-3);
/// # Ok::<(), EsmdaError>(())
/// ```
#[derive(Debug, Clone)]
pub struct GaussNewton {
    prior: Gaussian,
    observed: Vec<f64>,
    noise: NoiseCovariance,
    settings: SearchSettings,
    trial: Trial,
    best: Option<Best>,
    damping: Damping,
    evaluations: usize,
}

/// Damping of the next step, in units of the prior's precision.
#[derive(Debug, Clone, Copy)]
struct Damping(f64);

impl Damping {
    fn raise(&mut self) {
        self.0 = FIRST_DAMPING.max(self.0 * DAMPING_FACTOR);
    }

    fn lower(&mut self) {
        let less = self.0 / DAMPING_FACTOR;
        self.0 = if less < LEAST_DAMPING { 0.0 } else { less };
    }
}

/// A point at which the model is to be evaluated.
#[derive(Debug, Clone)]
struct Trial {
    point: Vec<f64>,
    /// `w` (n, 1)
    place: Mat<f64>,
    expected: f64,
}

/// The last accepted point.
#[derive(Debug, Clone)]
struct Best {
    point: Vec<f64>,
    place: Mat<f64>,
    /// `b` (n_obs, 1)
    residual: Mat<f64>,
    /// The undamped step before this point, if the one taken could not be judged by its decrease.
    before: Option<Mat<f64>>,
    linear: Option<Linear>,
}

impl GaussNewton {
    /// A search that begins at the prior's mean.
    ///
    /// # Shapes
    ///
    /// `observed` (`n_obs`) and the root of `noise` share one unit; the prior is over `n` parameters in any units.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::NoObservations`], [`EsmdaError::Shape`], [`EsmdaError::NotFinite`], [`EsmdaError::Setting`].
    pub fn new(
        prior: Gaussian,
        observed: &[f64],
        noise: NoiseCovariance,
        settings: SearchSettings,
    ) -> Result<Self, EsmdaError> {
        let n_obs = observed.len();
        if n_obs == 0 {
            return Err(EsmdaError::NoObservations);
        }
        check_shape("noise", (noise.n_obs(), 1), (n_obs, 1))?;
        check_finite("observed", MatRef::from_column_major_slice(observed, n_obs, 1))?;
        settings.check()?;
        let place = Mat::zeros(prior.n(), 1);
        let trial = Trial { point: prior.mean().to_vec(), place, expected: 0.0 };
        let observed = observed.to_vec();
        Ok(Self {
            prior,
            observed,
            noise,
            settings,
            trial,
            best: None,
            damping: Damping(0.0),
            evaluations: 0,
        })
    }

    /// The same search from another point, (n).
    ///
    /// # Errors
    ///
    /// [`EsmdaError::Shape`], [`EsmdaError::NotFinite`]; [`EsmdaError::OutOfOrder`] after an evaluation.
    pub fn starting_at(mut self, point: &[f64]) -> Result<Self, EsmdaError> {
        if self.evaluations > 0 {
            let needed = "a search without evaluations";
            return Err(EsmdaError::OutOfOrder { call: "starting_at", needed });
        }
        let n = self.prior.n();
        check_shape("start", (point.len(), 1), (n, 1))?;
        check_finite("start", MatRef::from_column_major_slice(point, n, 1))?;
        self.trial =
            Trial { point: point.to_vec(), place: self.prior.whitened(point), expected: 0.0 };
        Ok(self)
    }

    /// Where the model is to be evaluated next, (n).
    pub fn point(&self) -> &[f64] {
        &self.trial.point
    }

    /// The point with its neighbours for derivatives by differences, (n, 2 n + 1): column zero is the point, columns
    /// `2 k + 1` and `2 k + 2` lie [`difference`](SearchSettings::difference) on either side along column `k` of the prior's root.
    pub fn stencil(&self) -> Mat<f64> {
        differences::stencil(&self.trial.point, &self.prior, self.settings.difference)
    }

    /// Judges the point by the predictions there, (`n_obs`).
    ///
    /// A step is accepted if it brings at least a small share of the decrease that the linear model promised; otherwise,
    /// and where the model failed, the next point is closer to the last accepted one.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::Shape`]; [`EsmdaError::NotFinite`], [`EsmdaError::TooLarge`] or [`EsmdaError::Overflow`] at the first
    /// point, from which there is no way back; [`EsmdaError::NoMinimum`] where a rejected point was the last evaluation
    /// allowed; [`EsmdaError::OutOfOrder`] if an accepted point was not linearised.
    pub fn evaluate(&mut self, predicted: &[f64]) -> Result<Evaluation, EsmdaError> {
        let n_obs = self.observed.len();
        check_shape("predicted", (predicted.len(), 1), (n_obs, 1))?;
        let Some(best) = &self.best else {
            return self.evaluate_first(predicted);
        };
        let Some(linear) = &best.linear else {
            let needed = "`linearise` of the accepted point";
            return Err(EsmdaError::OutOfOrder { call: "evaluate", needed });
        };
        self.evaluations += 1;
        let expected = self.trial.expected;
        let before = best.residual.squared_norm_l2() + best.place.squared_norm_l2();
        let residual = self.residual(predicted);
        let (misfit, decrease) =
            residual.as_ref().map_or((f64::INFINITY, f64::NEG_INFINITY), |new| {
                // Differences of squares as products: exact where the points are close.
                let decrease = difference_of_squares(&best.residual, new)
                    + difference_of_squares(&best.place, &self.trial.place);
                (new.squared_norm_l2() + self.trial.place.squared_norm_l2(), decrease)
            });
        let rounding = ROUNDING_SHARE * before;
        let tiny = expected <= rounding && decrease >= -rounding;
        let accepted = tiny || decrease >= LEAST_SHARE * expected;
        let failed = residual.is_none();
        let step = if tiny { Some(linear.step().clone()) } else { None };
        if !tiny && decrease >= GOOD_SHARE * expected {
            self.damping.lower();
        } else if !tiny && decrease < POOR_SHARE * expected {
            self.damping.raise();
        }
        if accepted {
            if let Some(residual) = residual {
                self.accept(residual, step);
            }
        } else {
            if self.evaluations >= self.settings.max_evaluations {
                return Err(self.no_minimum(linear.length()));
            }
            let damped = linear.damped(&best.residual, &best.place, self.damping.0);
            self.trial = self.prior.after(best, damped);
        }
        Ok(Evaluation { accepted, failed, misfit, decrease, expected })
    }

    fn evaluate_first(&mut self, predicted: &[f64]) -> Result<Evaluation, EsmdaError> {
        check_finite("predicted", MatRef::from_column_major_slice(predicted, predicted.len(), 1))?;
        let limit = self.settings.largest;
        if let Some(row) = predicted.iter().position(|value| value.abs() > limit) {
            return Err(EsmdaError::TooLarge { row, column: 0, value: predicted[row], limit });
        }
        let residual = self.residual(predicted).ok_or(EsmdaError::Overflow)?;
        self.evaluations += 1;
        let misfit = residual.squared_norm_l2() + self.trial.place.squared_norm_l2();
        self.accept(residual, None);
        Ok(Evaluation { accepted: true, failed: false, misfit, decrease: 0.0, expected: 0.0 })
    }

    /// `b` (n_obs, 1); `None` where the model failed.
    fn residual(&self, predicted: &[f64]) -> Option<Mat<f64>> {
        if !predicted.iter().all(|value| value.abs() <= self.settings.largest) {
            return None;
        }
        let mut row =
            Mat::from_fn(1, predicted.len(), |_, obs| self.observed[obs] - predicted[obs]);
        self.noise.whiten_in_place(row.as_mut(), Par::Seq);
        let residual = row.transpose().to_owned();
        residual.squared_norm_l2().is_finite().then_some(residual)
    }

    fn accept(&mut self, residual: Mat<f64>, before: Option<Mat<f64>>) {
        let Trial { point, place, .. } = self.trial.clone();
        self.best = Some(Best { point, place, residual, before, linear: None });
    }

    /// Linearises the model at the point just accepted and moves [`point`](Self::point) on by a step.
    ///
    /// # Shapes
    ///
    /// `jacobian` is (`n_obs`, n): derivative of every prediction by every parameter.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::Shape`], [`EsmdaError::NotFinite`], [`EsmdaError::Overflow`]; [`EsmdaError::NoMinimum`] where the search
    /// has not converged and no evaluation is left; [`EsmdaError::OutOfOrder`] if no point was just accepted.
    ///
    /// # Cost
    ///
    /// About `4 (n_obs + n) n^2` multiply-adds.
    pub fn linearise(&mut self, jacobian: MatRef<'_, f64>) -> Result<Linearised, EsmdaError> {
        check_shape("jacobian", jacobian.shape(), (self.observed.len(), self.prior.n()))?;
        check_finite("jacobian", jacobian)?;
        self.linearise_by(product(jacobian, self.prior.root()), Vec::new())
    }

    /// The same by central differences, from the predictions (`n_obs`, 2 n + 1) of the [`stencil`](Self::stencil).
    ///
    /// Where a neighbour failed, the difference to the other one is taken, and its direction listed in
    /// [`one_sided`](Linearised::one_sided).
    ///
    /// # Errors
    ///
    /// As [`linearise`](Self::linearise); [`EsmdaError::NoDifference`] where both neighbours failed.
    pub fn linearise_by_differences(
        &mut self,
        predicted: MatRef<'_, f64>,
    ) -> Result<Linearised, EsmdaError> {
        let wanted = (self.observed.len(), 2 * self.prior.n() + 1);
        check_shape("predicted", predicted.shape(), wanted)?;
        let SearchSettings { difference, largest, .. } = self.settings;
        let (sensitivity, one_sided) = differences::sensitivity(predicted, difference, largest)?;
        self.linearise_by(sensitivity, one_sided)
    }

    fn linearise_by(
        &mut self,
        sensitivity: Mat<f64>,
        one_sided: Vec<usize>,
    ) -> Result<Linearised, EsmdaError> {
        let Some(mut best) = self.best.take_if(|best| best.linear.is_none()) else {
            let needed = "an accepted point";
            return Err(EsmdaError::OutOfOrder { call: "linearise", needed });
        };
        let linear = Linear::new(sensitivity, &self.noise, &best.residual, &best.place);
        let Some(linear) = linear else {
            self.best = Some(best);
            return Err(EsmdaError::Overflow);
        };
        let step = linear.length();
        let converged = step <= self.settings.tolerance;
        if let Some(before) = &best.before {
            match linear.repeated(before) {
                share if share < -TAKEN_BACK => self.damping.raise(),
                share if share > REPEATED => self.damping.lower(),
                _ => (),
            }
        }
        let damped = linear.damped(&best.residual, &best.place, self.damping.0);
        best.linear = Some(linear);
        self.trial = self.prior.after(&best, damped);
        self.best = Some(best);
        if !converged && self.evaluations >= self.settings.max_evaluations {
            return Err(self.no_minimum(step));
        }
        Ok(Linearised { converged, step, damping: self.damping.0, one_sided })
    }

    fn no_minimum(&self, step: f64) -> EsmdaError {
        let (evaluations, tolerance) = (self.evaluations, self.settings.tolerance);
        EsmdaError::NoMinimum { evaluations, step, tolerance }
    }

    /// Points evaluated so far.
    pub fn evaluations(&self) -> usize {
        self.evaluations
    }

    /// The Laplace approximation at the last linearised point: that of the posterior, if the search has converged.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::OutOfOrder`] before the first linearisation.
    pub fn posterior(&self) -> Result<Gaussian, EsmdaError> {
        let (best, linear) = self.linearised("posterior")?;
        let root = linear.posterior_root(self.prior.root());
        Ok(Gaussian::from_root(best.point.clone(), root.as_ref()))
    }

    /// A root (`n_obs`, n) of the posterior covariance of the predictions, `G P G'`: what the fit absorbs of the noise, as
    /// [`score_groups`](crate::score_groups) asks for it.
    ///
    /// # Errors
    ///
    /// As [`posterior`](Self::posterior).
    pub fn predicted_root(&self) -> Result<Mat<f64>, EsmdaError> {
        Ok(self.linearised("predicted_root")?.1.predicted_root())
    }

    fn linearised(&self, call: &'static str) -> Result<(&Best, &Linear), EsmdaError> {
        let needed = "a linearised point";
        self.best
            .as_ref()
            .and_then(|best| best.linear.as_ref().map(|linear| (best, linear)))
            .ok_or(EsmdaError::OutOfOrder { call, needed })
    }
}

impl Gaussian {
    /// The point a step away.
    fn after(&self, best: &Best, damped: Damped) -> Trial {
        let place = &best.place + &damped.step;
        let moved = product(self.root(), place.as_ref());
        let point = self.mean().iter().zip(moved.col(0).iter()).map(|(m, w)| m + w).collect();
        Trial { point, place, expected: damped.expected }
    }
}

/// `|a|^2 - |b|^2`
fn difference_of_squares(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    a.col(0).iter().zip(b.col(0).iter()).map(|(a, b)| (a - b) * (a + b)).sum()
}
