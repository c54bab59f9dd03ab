//! Exact: the linear Gaussian case, whose posterior is known.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, LinearGaussian, Normals, moments, relative_difference};
use faer::Mat;
use faer::prelude::Solve;
use tissuereg_esmda::{Schedule, StepSettings};

fn schedules() -> Vec<Schedule> {
    vec![
        Schedule::constant(4).unwrap(),
        Schedule::geometric(5, 2.0).unwrap(),
        Schedule::from_alphas(&[28.0 / 3.0, 7.0, 4.0, 2.0]).unwrap(),
    ]
}

/// Noise standard deviations and how exactly the posterior is met: the spread of the data over the noise costs digits.
const EXACTNESS: [(f64, f64); 2] = [(0.3, 1e-12), (1e-3, 1e-10)];

#[test]
fn the_square_root_form_with_a_moment_matched_prior_is_the_kalman_posterior() {
    for (std, tolerance) in EXACTNESS {
        let problem = LinearGaussian::new(4, 7, std, 3);
        let (mean, covariance) = problem.posterior(1.0);
        for schedule in schedules() {
            let mut ensemble = Normals::new(5).exact(4, 20, &[]);
            problem.run_square_root(&mut ensemble, &schedule).unwrap();
            let (found_mean, found_covariance) = moments(&ensemble);
            let errors = (
                relative_difference(&found_mean, &mean),
                relative_difference(&found_covariance, &covariance),
            );
            assert!(
                errors.0 < tolerance && errors.1 < tolerance,
                "std {std}, {schedule:?}: {errors:?}"
            );
        }
    }
}

#[test]
fn the_stochastic_form_with_second_order_exact_draws_is_the_kalman_posterior() {
    for (std, tolerance) in EXACTNESS {
        let problem = LinearGaussian::new(4, 7, std, 3);
        let (mean, covariance) = problem.posterior(1.0);
        for schedule in schedules() {
            let mut normals = Normals::new(5);
            let mut ensemble = normals.exact(4, 20, &[]);
            let settings = StepSettings::default();
            // Uncorrelated with the ensemble of the moment: needs n_members > n_parameters + n_obs.
            let draws = |current: &Mat<f64>| normals.exact(7, 20, &[current.as_ref()]);
            problem.run_stochastic(&mut ensemble, &schedule, &settings, draws).unwrap();
            let (found_mean, found_covariance) = moments(&ensemble);
            let errors = (
                relative_difference(&found_mean, &mean),
                relative_difference(&found_covariance, &covariance),
            );
            assert!(
                errors.0 < tolerance && errors.1 < tolerance,
                "std {std}, {schedule:?}: {errors:?}"
            );
        }
    }
}

#[test]
fn correlated_noise_gives_the_kalman_posterior_too() {
    let covariance = Mat::from_fn(7, 7, |i, j| 0.09 * 0.6_f64.powi((i as i32 - j as i32).abs()));
    let problem = LinearGaussian::with_covariance(4, covariance, 8);
    let (mean, covariance) = problem.posterior(1.0);
    let mut ensemble = Normals::new(5).exact(4, 20, &[]);
    problem.run_square_root(&mut ensemble, &Schedule::constant(3).unwrap()).unwrap();
    let (found_mean, found_covariance) = moments(&ensemble);
    assert!(relative_difference(&found_mean, &mean) < 1e-12);
    assert!(relative_difference(&found_covariance, &covariance) < 1e-12);
}

#[test]
fn the_steps_of_a_schedule_add_up_to_the_log_evidence() {
    let covariance = Mat::from_fn(7, 7, |i, j| 0.09 * 0.6_f64.powi((i as i32 - j as i32).abs()));
    for problem in
        [LinearGaussian::new(4, 7, 1e-3, 3), LinearGaussian::with_covariance(4, covariance, 8)]
    {
        // log [N(d; 0, H H' + C_d) / N(0; 0, C_d)]
        let total = &problem.operator * problem.operator.transpose() + &problem.covariance;
        let data = Mat::from_fn(7, 1, |obs, _| problem.observed[obs]);
        let square = (data.transpose() * total.partial_piv_lu().solve(&data))[(0, 0)];
        let ratio = (total.determinant() / problem.covariance.determinant()).ln();
        let wanted = -0.5 * (square + ratio);
        for schedule in schedules() {
            let mut ensemble = Normals::new(5).exact(4, 20, &[]);
            let found = problem.run_square_root(&mut ensemble, &schedule).unwrap();
            assert!((found - wanted).abs() < 1e-7 * wanted.abs(), "{found} is not {wanted}");
        }
    }
    let case = Case::surgical();
    let stochastic = case.step(2.0, &StepSettings::default()).unwrap();
    assert!(stochastic.report().log_evidence.is_none());
}

#[test]
fn inverses_that_add_up_to_c_count_the_data_c_times() {
    let problem = LinearGaussian::new(4, 7, 0.3, 3);
    let alphas = [4.0, 2.0, 1.0];
    assert!(Schedule::from_alphas(&alphas).is_err(), "refused unless requested");
    let schedule = Schedule::with_total(&alphas, 1.75).unwrap();
    let (mean, covariance) = problem.posterior(1.75);
    let mut ensemble = Normals::new(5).exact(4, 20, &[]);
    problem.run_square_root(&mut ensemble, &schedule).unwrap();
    let (found_mean, found_covariance) = moments(&ensemble);
    assert!(relative_difference(&found_mean, &mean) < 1e-12);
    assert!(relative_difference(&found_covariance, &covariance) < 1e-12);
    assert!(relative_difference(&found_covariance, &problem.posterior(1.0).1) > 0.1);
}

/// Root mean square error of the mean, and the mean shortfall of the variance, over repeated runs of one step each.
fn errors_of_random_ensembles(n_members: usize, n_runs: u64) -> (f64, f64) {
    let problem = LinearGaussian::new(8, 8, 2.0, 3);
    let (mean, covariance) = problem.posterior(1.0);
    let (mut squares, mut shortfall) = (0.0, 0.0);
    for run in 0..n_runs {
        let mut normals = Normals::new(1000 + run);
        let mut ensemble = normals.matrix(8, n_members);
        let schedule = Schedule::constant(1).unwrap();
        let draws = |_: &Mat<f64>| normals.matrix(8, n_members);
        problem.run_stochastic(&mut ensemble, &schedule, &StepSettings::default(), draws).unwrap();
        let (found_mean, found_covariance) = moments(&ensemble);
        squares += (found_mean - &mean).squared_norm_l2();
        let share = |i: usize| found_covariance[(i, i)] / covariance[(i, i)];
        shortfall += 1.0 - (0..8).map(share).sum::<f64>() / 8.0;
    }
    ((squares / n_runs as f64).sqrt(), shortfall / n_runs as f64)
}

#[test]
fn the_mean_error_falls_like_the_root_and_the_lost_spread_like_the_number_of_members() {
    let small = errors_of_random_ensembles(40, 3000);
    let large = errors_of_random_ensembles(160, 3000);
    // Four times the members: half the error, a quarter of the shortfall, each known to a few percent.
    let ratios = (small.0 / large.0, small.1 / large.1);
    assert!((ratios.0 - 2.0).abs() < 0.2, "mean error {small:?} {large:?}");
    assert!(small.1 > 0.0 && (ratios.1 - 4.0).abs() < 1.0, "shortfall {small:?} {large:?}");
}
