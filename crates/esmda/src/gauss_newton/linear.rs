//! The model linearised at a point, in whitened numbers.

use faer::linalg::triangular_solve::{
    solve_lower_triangular_in_place, solve_upper_triangular_in_place,
};
use faer::{Mat, MatRef, Par};

use crate::NoiseCovariance;
use crate::linalg::{self, product};

/// `A = L^-1 G M` and what follows from it: steps, and the root of the posterior covariance.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    /// `G M` (n_obs, n): change of the predictions by a prior standard deviation along each column of `M`.
    sensitivity: Mat<f64>,
    /// `A` (n_obs, n)
    whitened: Mat<f64>,
    /// `R` of `[A; I] = Q R`, so `R' R = A' A + I`.
    upper: Mat<f64>,
    /// Undamped step in whitened parameters, (n, 1).
    step: Mat<f64>,
}

/// A step from a point.
#[derive(Debug, Clone)]
pub(super) struct Damped {
    /// In whitened parameters, (n, 1).
    pub(super) step: Mat<f64>,
    /// Decrease of the misfit if the model were linear.
    pub(super) expected: f64,
}

impl Linear {
    /// Linearises where whitened residual and parameters are `residual` (n_obs, 1) and `place` (n, 1); `None` where whitened
    /// numbers leave the range of `f64`.
    pub(super) fn new(
        sensitivity: Mat<f64>,
        noise: &NoiseCovariance,
        residual: &Mat<f64>,
        place: &Mat<f64>,
    ) -> Option<Self> {
        // One observation a column, as the noise wants it.
        let mut columns = sensitivity.transpose().to_owned();
        noise.whiten_in_place(columns.as_mut(), Par::Seq);
        let whitened = columns.transpose().to_owned();
        if !whitened.is_all_finite() {
            return None;
        }
        let (upper, step) = solve(&whitened, residual, place, 1.0);
        let finite = upper.is_all_finite() && step.is_all_finite();
        finite.then_some(Self { sensitivity, whitened, upper, step })
    }

    /// Length of the undamped step, in standard deviations of the posterior: `sqrt(s' (A' A + I) s)`.
    pub(super) fn length(&self) -> f64 {
        self.squares(&self.step).sqrt()
    }

    /// The undamped step, (n, 1).
    pub(super) fn step(&self) -> &Mat<f64> {
        &self.step
    }

    /// Share of another step that the undamped one repeats, in the metric of the posterior; negative where it takes it back.
    pub(super) fn repeated(&self, other: &Mat<f64>) -> f64 {
        let theirs = product(self.whitened.as_ref(), other.as_ref());
        let mine = product(self.whitened.as_ref(), self.step.as_ref());
        let dot = |a: &Mat<f64>, b: &Mat<f64>| {
            a.col(0).iter().zip(b.col(0).iter()).map(|(a, b)| a * b).sum::<f64>()
        };
        (dot(&mine, &theirs) + dot(&self.step, other)) / self.squares(other)
    }

    /// The step that minimises `|A s - b|^2 + |w + s|^2 + damping |s|^2`.
    pub(super) fn damped(&self, residual: &Mat<f64>, place: &Mat<f64>, damping: f64) -> Damped {
        let step = if damping > 0.0 {
            solve(&self.whitened, residual, place, 1.0 + damping).1
        } else {
            self.step.clone()
        };
        // From the normal equations: a sum of squares, where the difference of two misfits would cancel.
        let expected = self.squares(&step) + 2.0 * damping * step.squared_norm_l2();
        Damped { step, expected }
    }

    fn squares(&self, step: &Mat<f64>) -> f64 {
        product(self.whitened.as_ref(), step.as_ref()).squared_norm_l2() + step.squared_norm_l2()
    }

    /// `M R^-1`, a root of the posterior covariance `M (A' A + I)^-1 M'`.
    pub(super) fn posterior_root(&self, prior_root: MatRef<'_, f64>) -> Mat<f64> {
        self.times_inverse(prior_root)
    }

    /// `G M R^-1` (n_obs, n), a root of the posterior covariance of the predictions.
    pub(super) fn predicted_root(&self) -> Mat<f64> {
        self.times_inverse(self.sensitivity.as_ref())
    }

    /// `B R^-1 = (R^-T B')'`
    fn times_inverse(&self, rows: MatRef<'_, f64>) -> Mat<f64> {
        let mut columns = rows.transpose().to_owned();
        solve_lower_triangular_in_place(self.upper.transpose(), columns.as_mut(), Par::Seq);
        columns.transpose().to_owned()
    }
}

/// `R` and the step of `[A; sqrt(c) I] s = [b; -w / sqrt(c)]` by QR: the square of `A` is never formed.
fn solve(
    whitened: &Mat<f64>,
    residual: &Mat<f64>,
    place: &Mat<f64>,
    c: f64,
) -> (Mat<f64>, Mat<f64>) {
    let (n_obs, n) = whitened.shape();
    let root = c.sqrt();
    let mut stacked = Mat::zeros(n_obs + n, n);
    stacked.get_mut(..n_obs, ..).copy_from(whitened);
    for k in 0..n {
        stacked[(n_obs + k, k)] = root;
    }
    let right = Mat::from_fn(n_obs + n, 1, |row, _| {
        if row < n_obs { residual[(row, 0)] } else { -place[(row - n_obs, 0)] / root }
    });
    let (q, upper) = linalg::thin_qr(stacked);
    let mut step = product(q.transpose(), right.as_ref());
    solve_upper_triangular_in_place(upper.as_ref(), step.as_mut(), Par::Seq);
    (upper, step)
}
