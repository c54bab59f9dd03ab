//! Low-rank noise against the dense covariance that it stands for.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, LinearGaussian, Normals, column, moments, relative_difference};
use faer::{Mat, Side, mat};
use tissuereg_esmda::{EsmdaError, NoiseCovariance, Schedule, Step, StepSettings};

/// Shared errors over the standard deviations (0.3): small, as large, much larger; and their number.
const SHAPES: [(f64, usize); 4] = [(0.01, 2), (0.3, 3), (30.0, 2), (0.3, 17)];

fn dense(std: &[f64], columns: &Mat<f64>) -> Mat<f64> {
    let shared = columns * columns.transpose();
    Mat::from_fn(std.len(), std.len(), |i, j| {
        shared[(i, j)] + if i == j { std[i] * std[i] } else { 0.0 }
    })
}

#[test]
fn the_square_root_form_is_that_of_the_dense_covariance() {
    for (size, n_columns) in SHAPES {
        let case = Case::new(5, 12, 40, 0.3, 4);
        let columns = Normals::new(8).matrix(12, n_columns) * faer::Scale(size);
        let update = |noise: &NoiseCovariance| {
            let (y, settings) = (case.predicted.as_ref(), StepSettings::default());
            let mut parameters = case.parameters.clone();
            Step::prepare_square_root(y, &case.observed, noise, 2.0, &settings)
                .unwrap()
                .apply(parameters.as_mut())
                .unwrap();
            parameters
        };
        let low_rank = NoiseCovariance::low_rank(&case.std, columns.as_ref()).unwrap();
        let whole = NoiseCovariance::dense(dense(&case.std, &columns).as_ref()).unwrap();
        let error = relative_difference(&update(&low_rank), &update(&whole));
        // The dense form squares the ratio of largest to smallest error, 300 at most.
        assert!(error < 1e-10, "{size} x {n_columns}: {error:e}");
    }
}

#[test]
fn the_stochastic_form_is_that_of_the_dense_covariance_with_the_draws_turned() {
    for (size, n_columns) in SHAPES {
        let case = Case::new(5, 12, 40, 0.3, 4);
        let columns = Normals::new(8).matrix(12, n_columns) * faer::Scale(size);
        let covariance = dense(&case.std, &columns);
        // D^-1 C_d D^-1 = H H with H symmetric; the perturbations are D H E = L T with L the Cholesky factor.
        let scaled = Mat::from_fn(12, 12, |i, j| covariance[(i, j)] / case.std[i] / case.std[j]);
        let eigen = scaled.self_adjoint_eigen(Side::Lower).unwrap();
        let root = Mat::from_fn(12, 12, |i, j| {
            let entry = |k: usize| eigen.U()[(i, k)] * eigen.S()[k].sqrt() * eigen.U()[(j, k)];
            (0..12).map(entry).sum::<f64>()
        });
        let stretched = root * &case.draws;
        let perturbations = Mat::from_fn(12, 40, |i, j| case.std[i] * stretched[(i, j)]);
        let mut turned = perturbations.clone();
        let lower = covariance.llt(Side::Lower).unwrap().L().to_owned();
        lower.solve_lower_triangular_in_place(&mut turned);
        let update = |noise: &NoiseCovariance, draws: &Mat<f64>| {
            let (y, settings) = (case.predicted.as_ref(), StepSettings::default());
            let mut parameters = case.parameters.clone();
            Step::prepare(y, &case.observed, noise, 2.0, draws.as_ref(), &settings)
                .unwrap()
                .apply(parameters.as_mut())
                .unwrap();
            parameters
        };
        let low_rank = NoiseCovariance::low_rank(&case.std, columns.as_ref()).unwrap();
        let whole = NoiseCovariance::dense(covariance.as_ref()).unwrap();
        let error = relative_difference(&update(&low_rank, &case.draws), &update(&whole, &turned));
        assert!(error < 1e-10, "{size} x {n_columns}: {error:e}");
    }
}

#[test]
fn a_linear_model_with_shared_errors_has_the_kalman_posterior() {
    let (std, columns) = ([0.3; 7], Normals::new(2).matrix(7, 2));
    let problem = LinearGaussian::with_covariance(4, dense(&std, &columns), 8);
    let noise = NoiseCovariance::low_rank(&std, columns.as_ref()).unwrap();
    let mut ensemble = Normals::new(5).exact(4, 20, &[]);
    for &alpha in Schedule::constant(3).unwrap().alphas() {
        let predicted = &problem.operator * &ensemble;
        let (y, settings) = (predicted.as_ref(), StepSettings::default());
        Step::prepare_square_root(y, &problem.observed, &noise, alpha, &settings)
            .unwrap()
            .apply(ensemble.as_mut())
            .unwrap();
    }
    let (wanted_mean, wanted_covariance) = problem.posterior(1.0);
    let (mean, covariance) = moments(&ensemble);
    assert!(relative_difference(&mean, &wanted_mean) < 1e-12);
    assert!(relative_difference(&covariance, &wanted_covariance) < 1e-12);
}

#[test]
fn without_columns_the_noise_is_independent() {
    let case = Case::surgical();
    let noise = NoiseCovariance::low_rank(&case.std, Mat::zeros(45, 0).as_ref()).unwrap();
    let (y, e, settings) = (case.predicted.as_ref(), case.draws.as_ref(), StepSettings::default());
    let mut parameters = case.parameters.clone();
    let step = Step::prepare(y, &case.observed, &noise, 4.0, e, &settings).unwrap();
    step.apply(parameters.as_mut()).unwrap();
    assert_eq!(parameters, case.updated(4.0, &settings).unwrap());
}

#[test]
fn a_shift_that_the_columns_explain_hardly_moves_the_parameters() {
    // A model that may be off by metres along one shape: that shape of the innovations counts for nothing.
    let case = Case::new(5, 12, 40, 0.3, 4);
    let columns = Normals::new(8).matrix(12, 1);
    let noise = NoiseCovariance::low_rank(&case.std, (&columns * faer::Scale(1e6)).as_ref());
    let noise = noise.unwrap();
    let update = |observed: &[f64]| {
        let (y, settings) = (case.predicted.as_ref(), StepSettings::default());
        let mut parameters = case.parameters.clone();
        Step::prepare_square_root(y, observed, &noise, 1.0, &settings)
            .unwrap()
            .apply(parameters.as_mut())
            .unwrap();
        parameters
    };
    let observed = column(&case.observed) + &columns * faer::Scale(5.0);
    let observed: Vec<f64> = observed.col(0).iter().copied().collect();
    let before = update(&case.observed);
    assert!(relative_difference(&update(&observed), &before) < 1e-8);
}

#[test]
fn wrong_arguments_are_refused() {
    let refused = |std: &[f64], columns: Mat<f64>| {
        NoiseCovariance::low_rank(std, columns.as_ref()).unwrap_err()
    };
    let error = refused(&[0.1, 0.0], Mat::zeros(2, 1));
    assert_eq!(error, EsmdaError::NoiseStd { obs: 1, std: 0.0 });
    let error = refused(&[0.1, 0.1], Mat::zeros(3, 1));
    assert!(error.to_string().contains("`columns` must have shape (2, 1), got (3, 1)"));
    let error = refused(&[0.1, 0.1], mat![[0.0], [f64::NAN]]);
    assert!(error.to_string().contains("`columns` must be finite, got NaN at row 1, column 0"));
    assert_eq!(refused(&[1e-200, 0.1], mat![[1e200], [0.0]]), EsmdaError::Overflow);
}
