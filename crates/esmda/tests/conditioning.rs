//! Small noise: a sweep of the standard deviation from 1e-2 to 1e-6.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, LinearGaussian, Normals, moments, relative_difference};
use faer::Mat;
use tissuereg_esmda::{Factorisation, Schedule, StepSettings};

const SWEEP: [f64; 5] = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6];

/// How far the posterior mean is off, in posterior standard deviations, and the covariance, relative.
fn errors(problem: &LinearGaussian, ensemble: &Mat<f64>) -> (f64, f64) {
    let (mean, covariance) = problem.posterior(1.0);
    let (found_mean, found_covariance) = moments(ensemble);
    let off = (0..4).map(|i| (found_mean[(i, 0)] - mean[(i, 0)]).abs() / covariance[(i, i)].sqrt());
    (off.fold(0.0, f64::max), relative_difference(&found_covariance, &covariance))
}

#[test]
fn the_posterior_stays_right_down_to_a_millionth_of_the_spread() {
    for std in SWEEP {
        let problem = LinearGaussian::new(4, 7, std, 3);
        let schedule = Schedule::constant(4).unwrap();
        let mut normals = Normals::new(5);
        let mut stochastic = normals.exact(4, 20, &[]);
        let mut square_root = stochastic.clone();
        let draws = |current: &Mat<f64>| normals.exact(7, 20, &[current.as_ref()]);
        let settings = StepSettings::default();
        problem.run_stochastic(&mut stochastic, &schedule, &settings, draws).unwrap();
        problem.run_square_root(&mut square_root, &schedule).unwrap();
        // Data rounded in the last bit move the mean by 1e-16 / std standard deviations; four steps and a prior of
        // spread one lose two digits more.
        let allowed = 1e-13 / std;
        for (form, ensemble) in [("stochastic", &stochastic), ("square root", &square_root)] {
            let (mean, covariance) = errors(&problem, ensemble);
            assert!(
                mean < allowed && covariance < allowed,
                "std {std:e} {form}: {mean:e} {covariance:e}"
            );
        }
    }
}

#[test]
fn cholesky_is_left_where_it_would_lose_digits() {
    let used = |std: f64| {
        let step = Case::new(26, 45, 100, std, 1).step(4.0, &StepSettings::default()).unwrap();
        (step.report().factorisation, step.report().condition_bound.unwrap())
    };
    assert_eq!(used(0.3).0, Factorisation::Cholesky);
    assert!(used(0.3).1 < 1e6);
    assert_eq!(used(1e-4).0, Factorisation::Qr);
    assert!(used(1e-4).1 > 1e6);
}

#[test]
fn the_bound_on_the_condition_number_holds_and_is_not_far_off() {
    for (n_obs, n_members) in [(12, 30), (30, 12)] {
        let case = Case::new(5, n_obs, n_members, 0.1, 2);
        let bound =
            case.step(1.0, &StepSettings::default()).unwrap().report().condition_bound.unwrap();
        let (_, covariance) = moments(&case.predicted);
        let whitened =
            Mat::from_fn(n_obs, n_obs, |i, j| covariance[(i, j)] / case.std[i] / case.std[j]);
        let largest = whitened.singular_values().unwrap()[0];
        assert!(bound >= (1.0 + largest) * (1.0 - 1e-12), "{bound} {largest}");
        assert!(bound <= (1.0 + largest) * 30.0_f64.sqrt() * (1.0 + 1e-12));
    }
}

#[test]
fn every_route_survives_tiny_noise() {
    for (n_obs, n_members) in [(45, 100), (80, 30)] {
        for std in SWEEP {
            let case = Case::new(26, n_obs, n_members, std, 2);
            let run = |factorisation| {
                let settings = StepSettings::default().with_factorisation(factorisation);
                case.updated(1.0, &settings).unwrap()
            };
            let (qr, svd) = (run(Factorisation::Qr), run(Factorisation::Svd));
            let error = relative_difference(&qr, &svd);
            // 45 observations of 26 parameters contradict each other by 1 / std standard deviations.
            assert!(error < 1e-13 / std, "{n_obs} x {n_members}, std {std:e}: {error:e}");
        }
    }
}
