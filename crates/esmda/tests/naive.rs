//! Equivalence: the step against the textbook's, and every route against every other.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, moments, relative_difference};
use faer::prelude::Solve;
use faer::{Mat, Par};
use tissuereg_esmda::{Factorisation, NoiseCovariance, Side, Step, StepSettings};

/// `x_i + C_xy (C_yy + alpha C_d)^-1 (d + sqrt(alpha) C_d^1/2 e_i - y_i)`, term by term.
fn textbook(case: &Case, alpha: f64) -> Mat<f64> {
    let n = case.parameters.nrows();
    let both = Mat::from_fn(n + case.predicted.nrows(), case.predicted.ncols(), |i, j| {
        if i < n { case.parameters[(i, j)] } else { case.predicted[(i - n, j)] }
    });
    let (_, covariance) = moments(&both);
    let mut of_data = covariance.get(n.., n..).to_owned();
    let innovations = Mat::from_fn(case.predicted.nrows(), case.predicted.ncols(), |i, j| {
        case.observed[i] + alpha.sqrt() * case.std[i] * case.draws[(i, j)] - case.predicted[(i, j)]
    });
    for (obs, std) in case.std.iter().enumerate() {
        of_data[(obs, obs)] += alpha * std * std;
    }
    &case.parameters + covariance.get(..n, n..) * of_data.partial_piv_lu().solve(innovations)
}

const SIZES: [(usize, usize); 5] = [(45, 100), (60, 100), (30, 30), (90, 40), (1, 2)];

fn routes() -> Vec<StepSettings> {
    let mut routes = Vec::new();
    for factorisation in [Factorisation::Cholesky, Factorisation::Qr, Factorisation::Svd] {
        for side in [Side::Observations, Side::Members] {
            routes.push(StepSettings::default().with_factorisation(factorisation).with_side(side));
        }
    }
    routes
}

#[test]
fn every_route_is_the_textbook_update() {
    for (n_obs, n_members) in SIZES {
        let case = Case::new(7, n_obs, n_members, 0.3, 11);
        let wanted = textbook(&case, 4.0);
        for settings in [routes(), vec![StepSettings::default()]].concat() {
            let found = case.updated(4.0, &settings).unwrap();
            let error = relative_difference(&found, &wanted);
            assert!(error < 1e-11, "{n_obs} x {n_members}, {settings:?}: {error:e}");
        }
    }
}

#[test]
fn data_space_ensemble_space_singular_values_and_qr_agree_where_the_noise_is_small() {
    for (n_obs, n_members) in SIZES {
        // The condition number is near 1e5: Cholesky loses as many digits, the others half of them.
        let case = Case::new(7, n_obs, n_members, 1e-2, 11);
        let svd = StepSettings::default().with_factorisation(Factorisation::Svd);
        let wanted = case.updated(1.0, &svd).unwrap();
        for settings in routes() {
            let error = relative_difference(&case.updated(1.0, &settings).unwrap(), &wanted);
            assert!(error < 1e-9, "{n_obs} x {n_members}, {settings:?}: {error:e}");
        }
    }
}

#[test]
fn a_dense_covariance_without_correlations_is_a_diagonal_one() {
    let case = Case::surgical();
    let n_obs = case.std.len();
    let squares = Mat::from_fn(n_obs, n_obs, |i, j| if i == j { case.std[i].powi(2) } else { 0.0 });
    let dense = NoiseCovariance::dense(squares.as_ref()).unwrap();
    let (y, d, e) = (case.predicted.as_ref(), &case.observed, case.draws.as_ref());
    let mut parameters = case.parameters.clone();
    let step = Step::prepare(y, d, &dense, 4.0, e, &StepSettings::default()).unwrap();
    step.apply(parameters.as_mut()).unwrap();
    let wanted = case.updated(4.0, &StepSettings::default()).unwrap();
    assert!(relative_difference(&parameters, &wanted) < 1e-13);
}

#[test]
fn correlated_noise_is_whitened_noise() {
    // Observations mixed by L have the covariance L L'; unmixed they are independent.
    let case = Case::new(5, 12, 40, 1.0, 4);
    let lower =
        Mat::from_fn(12, 12, |i, j| if i >= j { 0.5_f64.powi((i - j) as i32) } else { 0.0 });
    let covariance = &lower * lower.transpose();
    let independent = NoiseCovariance::diagonal(&[1.0; 12]).unwrap();
    let correlated = NoiseCovariance::dense(covariance.as_ref()).unwrap();
    let mixed = &lower * &case.predicted;
    let observed: Vec<f64> =
        (&lower * common::column(&case.observed)).col(0).iter().copied().collect();
    let (e, settings) = (case.draws.as_ref(), StepSettings::default());
    let mut a = case.parameters.clone();
    let y = case.predicted.as_ref();
    let step = Step::prepare(y, &case.observed, &independent, 2.0, e, &settings).unwrap();
    step.apply(a.as_mut()).unwrap();
    let mut b = case.parameters.clone();
    let step = Step::prepare(mixed.as_ref(), &observed, &correlated, 2.0, e, &settings).unwrap();
    step.apply(b.as_mut()).unwrap();
    assert!(relative_difference(&b, &a) < 1e-12);
}

#[test]
fn one_step_with_alpha_one_is_an_ensemble_smoother() {
    let case = Case::surgical();
    let found = case.updated(1.0, &StepSettings::default()).unwrap();
    assert!(relative_difference(&found, &textbook(&case, 1.0)) < 1e-12);
}

#[test]
fn batches_of_rows_are_the_whole() {
    for (n_obs, n_members) in SIZES {
        let case = Case::new(200, n_obs, n_members, 0.3, 6);
        for settings in routes() {
            let step = case.step(2.0, &settings).unwrap();
            let mut whole = case.parameters.clone();
            step.apply(whole.as_mut()).unwrap();
            let mut batched = case.parameters.clone();
            for (from, to) in [(150, 200), (0, 1), (1, 3), (3, 150)] {
                step.apply(batched.get_mut(from..to, ..)).unwrap();
            }
            assert!(relative_difference(&batched, &whole) < 1e-13, "{settings:?}");
        }
    }
}

#[test]
fn the_layout_of_the_arrays_does_not_matter() {
    let case = Case::surgical();
    let settings = StepSettings::default();
    let wanted = case.updated(2.0, &settings).unwrap();
    // The same numbers, rows first.
    let (y, e) = (case.predicted.transpose().to_owned(), case.draws.transpose().to_owned());
    let mut x = case.parameters.transpose().to_owned();
    let (y, e) = (y.transpose(), e.transpose());
    let step = Step::prepare(y, &case.observed, &case.noise(), 2.0, e, &settings).unwrap();
    step.apply(x.as_mut().transpose_mut()).unwrap();
    assert_eq!(x.transpose(), wanted);
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    for (n_parameters, n_obs, n_members, std) in
        [(26, 45, 100, 0.3), (1000, 300, 400, 0.3), (200, 2500, 60, 0.3), (300, 200, 300, 1e-6)]
    {
        let case = Case::new(n_parameters, n_obs, n_members, std, 6);
        let alone = case.updated(2.0, &StepSettings::default()).unwrap();
        for n_threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
            let settings = StepSettings::default().with_par(Par::rayon(n_threads));
            let together = pool.install(|| case.updated(2.0, &settings)).unwrap();
            assert_eq!(alone, together, "{n_obs} x {n_members} on {n_threads} threads");
        }
    }
}
