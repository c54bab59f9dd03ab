//! Invariance and limits: what must not matter, and what happens at the edge.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, moments, relative_difference};
use faer::{Mat, Par};
use tissuereg_esmda::{NoiseCovariance, Step, StepSettings};

/// A fixed permutation of `0..n`.
fn shuffled(n: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in 0..n {
        order.swap(i, (i * 7919 + 13) % n);
    }
    order
}

fn columns(matrix: &Mat<f64>, order: &[usize]) -> Mat<f64> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, order[j])])
}

fn rows(matrix: &Mat<f64>, order: &[usize]) -> Mat<f64> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(order[i], j)])
}

fn updated(case: &Case) -> Mat<f64> {
    case.updated(4.0, &StepSettings::default()).unwrap()
}

fn updated_by_square_root(case: &Case) -> Mat<f64> {
    let (y, settings) = (case.predicted.as_ref(), StepSettings::default());
    let mut parameters = case.parameters.clone();
    let step = Step::prepare_square_root(y, &case.observed, &case.noise(), 4.0, &settings).unwrap();
    step.apply(parameters.as_mut()).unwrap();
    parameters
}

const FORMS: [fn(&Case) -> Mat<f64>; 2] = [updated, updated_by_square_root];

#[test]
fn the_order_of_members_does_not_matter() {
    for (n_obs, n_members) in [(45, 100), (80, 30)] {
        let case = Case::new(9, n_obs, n_members, 0.3, 3);
        let order = shuffled(n_members);
        let permuted = Case {
            predicted: columns(&case.predicted, &order),
            draws: columns(&case.draws, &order),
            parameters: columns(&case.parameters, &order),
            observed: case.observed.clone(),
            std: case.std.clone(),
        };
        for form in FORMS {
            let error = relative_difference(&form(&permuted), &columns(&form(&case), &order));
            assert!(error < 1e-12, "{error:e}");
        }
    }
}

#[test]
fn the_order_of_observations_does_not_matter() {
    for (n_obs, n_members) in [(45, 100), (80, 30)] {
        let case = Case::new(9, n_obs, n_members, 0.3, 3);
        let order = shuffled(n_obs);
        let permuted = Case {
            predicted: rows(&case.predicted, &order),
            draws: rows(&case.draws, &order),
            parameters: case.parameters.clone(),
            observed: order.iter().map(|&i| case.observed[i]).collect(),
            std: order.iter().map(|&i| case.std[i]).collect(),
        };
        for form in FORMS {
            let error = relative_difference(&form(&permuted), &form(&case));
            assert!(error < 1e-12, "{error:e}");
        }
    }
}

#[test]
fn the_unit_of_the_observations_does_not_matter() {
    let case = Case::surgical();
    let in_micrometres = Case {
        predicted: &case.predicted * faer::Scale(1e3),
        draws: case.draws.clone(),
        parameters: case.parameters.clone(),
        observed: case.observed.iter().map(|d| d * 1e3).collect(),
        std: case.std.iter().map(|s| s * 1e3).collect(),
    };
    for form in FORMS {
        assert!(relative_difference(&form(&in_micrometres), &form(&case)) < 1e-12);
    }
}

#[test]
fn a_shift_of_predictions_and_observations_does_not_matter() {
    let case = Case::surgical();
    let shift = |obs: usize| 10.0 * obs as f64;
    let shifted = Case {
        predicted: Mat::from_fn(45, 100, |i, j| case.predicted[(i, j)] + shift(i)),
        draws: case.draws.clone(),
        parameters: case.parameters.clone(),
        observed: case.observed.iter().enumerate().map(|(i, d)| d + shift(i)).collect(),
        std: case.std.clone(),
    };
    for form in FORMS {
        // The shift of up to 440 takes three digits from the anomalies.
        assert!(relative_difference(&form(&shifted), &form(&case)) < 1e-10);
    }
}

#[test]
fn an_affine_change_of_parameters_commutes_with_the_update() {
    let case = Case::surgical();
    let mix = common::Normals::new(9).matrix(26, 26);
    let change = |x: &Mat<f64>| {
        let mixed = &mix * x;
        Mat::from_fn(26, 100, |i, j| mixed[(i, j)] + i as f64)
    };
    let changed = Case {
        predicted: case.predicted.clone(),
        draws: case.draws.clone(),
        parameters: change(&case.parameters),
        observed: case.observed.clone(),
        std: case.std.clone(),
    };
    for form in FORMS {
        assert!(relative_difference(&form(&changed), &change(&form(&case))) < 1e-12);
    }
}

#[test]
fn the_update_stays_in_the_span_of_the_anomalies() {
    // 26 parameters, 8 members: the change has nothing outside the 7 directions of the anomalies.
    let case = Case::new(26, 45, 8, 0.3, 3);
    let mean = moments(&case.parameters).0;
    let anomalies = Mat::from_fn(26, 8, |i, j| case.parameters[(i, j)] - mean[(i, 0)]);
    let q = anomalies.get(.., ..7).to_owned().qr().compute_thin_Q();
    for form in FORMS {
        let change = form(&case) - &case.parameters;
        let outside = &change - &q * (q.transpose() * &change);
        assert!(outside.norm_max() < 1e-12 * change.norm_max());
    }
}

#[test]
fn without_spread_there_is_no_update() {
    let case = Case::surgical();
    let same_predictions = Case {
        predicted: Mat::from_fn(45, 100, |i, _| case.predicted[(i, 0)]),
        parameters: case.parameters.clone(),
        draws: case.draws.clone(),
        observed: case.observed.clone(),
        std: case.std.clone(),
    };
    let same_parameters =
        Case { parameters: Mat::from_fn(26, 100, |i, _| case.parameters[(i, 0)]), ..case };
    for form in FORMS {
        assert_eq!(form(&same_predictions), same_predictions.parameters);
        assert_eq!(form(&same_parameters), same_parameters.parameters);
    }
}

#[test]
fn huge_noise_leaves_the_prior() {
    let case = Case::new(9, 20, 50, 1e9, 3);
    for form in FORMS {
        assert!(relative_difference(&form(&case), &case.parameters) < 1e-8);
    }
}

#[test]
fn tiny_noise_on_linear_data_reproduces_it() {
    // Nine parameters, nine observations: known exactly.
    let case = Case::new(9, 9, 50, 1e-6, 3);
    for form in FORMS {
        // Whatever linear map took parameters to predictions, it takes the update to the observations.
        let stacked = Case {
            parameters: case.predicted.clone(),
            predicted: case.predicted.clone(),
            draws: case.draws.clone(),
            observed: case.observed.clone(),
            std: case.std.clone(),
        };
        let updated = form(&stacked);
        for obs in 0..9 {
            for member in 0..50 {
                assert!((updated[(obs, member)] - case.observed[obs]).abs() < 1e-4);
            }
        }
    }
}

#[test]
fn an_observation_repeated_with_root_two_noise_is_one_observation() {
    let case = Case::new(5, 4, 30, 0.5, 3);
    let (y, d, settings) = (case.predicted.as_ref(), &case.observed, StepSettings::default());
    let single = updated_by_square_root(&case);
    let doubled = Mat::from_fn(8, 30, |i, j| y[(i % 4, j)]);
    let observed: Vec<f64> = d.iter().chain(d).copied().collect();
    let std: Vec<f64> = case.std.iter().chain(&case.std).map(|s| s * 2.0_f64.sqrt()).collect();
    let noise = NoiseCovariance::diagonal(&std).unwrap();
    let mut parameters = case.parameters.clone();
    let step =
        Step::prepare_square_root(doubled.as_ref(), &observed, &noise, 4.0, &settings).unwrap();
    step.apply(parameters.as_mut()).unwrap();
    assert!(relative_difference(&parameters, &single) < 1e-12);
}

/// One pass into other memory, in whichever order that memory holds its entries, and two passes in place.
#[test]
fn an_update_into_other_memory_has_the_bits_of_one_in_place() {
    for (n_parameters, n_obs, n_members) in [(9, 45, 100), (150, 80, 30), (65, 3, 7)] {
        let case = Case::new(n_parameters, n_obs, n_members, 0.3, 3);
        let by_rows = case.parameters.transpose().to_owned();
        for threads in [Par::Seq, Par::rayon(2)] {
            let settings = StepSettings::default().with_par(threads);
            let wanted = case.updated(4.0, &settings).unwrap();
            let step = case.step(4.0, &settings).unwrap();
            let mut by_columns = Mat::from_fn(n_parameters, n_members, |_, _| f64::NAN);
            step.apply_to(case.parameters.as_ref(), by_columns.as_mut()).unwrap();
            assert_eq!(by_columns, wanted);
            let mut transposed = Mat::zeros(n_members, n_parameters);
            step.apply_to(by_rows.transpose(), transposed.transpose_mut()).unwrap();
            assert!(relative_difference(&transposed.transpose().to_owned(), &wanted) < 1e-13);
        }
    }
}
