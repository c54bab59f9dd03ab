//! Parameters in batches are parameters at once, for every option.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, relative_difference};
use faer::Mat;
use tissuereg_esmda::{Factorisation, NoiseCovariance, Side, Step, StepSettings};

#[test]
fn batched_is_unbatched_for_every_option() {
    let case = Case::new(200, 45, 60, 0.3, 6);
    let n_obs = case.std.len();
    let dense = Mat::from_fn(n_obs, n_obs, |i, j| {
        case.std[i] * case.std[j] * 0.6_f64.powi((i as i32 - j as i32).abs())
    });
    let noises = [case.noise(), NoiseCovariance::dense(dense.as_ref()).unwrap()];
    let routes =
        [Factorisation::Auto, Factorisation::Cholesky, Factorisation::Qr, Factorisation::Svd];
    for noise in &noises {
        for side in [Side::Observations, Side::Members] {
            for factorisation in routes {
                let settings =
                    StepSettings::default().with_factorisation(factorisation).with_side(side);
                let (y, e) = (case.predicted.as_ref(), case.draws.as_ref());
                let d = &case.observed;
                for step in [
                    Step::prepare(y, d, noise, 2.0, e, &settings).unwrap(),
                    Step::prepare_square_root(y, d, noise, 2.0, &settings).unwrap(),
                ] {
                    let mut whole = case.parameters.clone();
                    step.apply(whole.as_mut()).unwrap();
                    let mut batched = case.parameters.clone();
                    for (from, to) in [(150, 200), (0, 1), (1, 3), (3, 150)] {
                        step.apply(batched.get_mut(from..to, ..)).unwrap();
                    }
                    let error = relative_difference(&batched, &whole);
                    assert!(error < 1e-13, "{settings:?}: {error:e}");
                }
            }
        }
    }
}
