//! Truncation: what is kept, and what a cut costs.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, LinearGaussian, Normals, column, moments, relative_difference};
use faer::Mat;
use tissuereg_esmda::{EsmdaError, Factorisation, Step, StepSettings, Truncation};

fn cut(truncation: Truncation) -> StepSettings {
    StepSettings::default().with_truncation(Some(truncation))
}

/// `S` (n_obs, n_members) for independent noise and a coefficient.
fn whitened(case: &Case, alpha: f64) -> Mat<f64> {
    let (n_obs, n) = case.predicted.shape();
    let mean = moments(&case.predicted).0;
    let scale = 1.0 / ((n as f64 - 1.0) * alpha).sqrt();
    Mat::from_fn(n_obs, n, |i, j| (case.predicted[(i, j)] - mean[(i, 0)]) / case.std[i] * scale)
}

#[test]
fn keeping_all_directions_changes_nothing() {
    for (n_obs, n_members) in [(45, 100), (80, 30)] {
        let case = Case::new(7, n_obs, n_members, 0.3, 11);
        let wanted = case.updated(2.0, &StepSettings::default()).unwrap();
        for truncation in [Truncation::Energy(1.0), Truncation::Rank(1000)] {
            assert_eq!(case.updated(2.0, &cut(truncation)).unwrap(), wanted, "{truncation:?}");
        }
    }
}

#[test]
fn a_rank_is_the_formula_with_the_leading_singular_vectors() {
    let case = Case::new(7, 12, 40, 0.3, 11);
    let s = whitened(&case, 2.0);
    let svd = s.thin_svd().unwrap();
    let (u, v) = (svd.U().get(.., ..3), svd.V().get(.., ..3));
    // W = V diag(w / (1 + w^2)) U' R
    let scale = 1.0 / (39.0 * 2.0_f64).sqrt();
    let r = Mat::from_fn(12, 40, |i, j| {
        (case.observed[i] - case.predicted[(i, j)]) / case.std[i] * scale
            + case.draws[(i, j)] / 39.0_f64.sqrt()
    });
    let mut along = u.transpose() * r;
    for k in 0..3 {
        let w = svd.S()[k];
        along.row_mut(k).iter_mut().for_each(|value| *value *= w / (1.0 + w * w));
    }
    let mean = moments(&case.parameters).0;
    let anomalies = Mat::from_fn(7, 40, |i, j| case.parameters[(i, j)] - mean[(i, 0)]);
    let wanted = &case.parameters + anomalies * v * along;
    for factorisation in [Factorisation::Auto, Factorisation::Qr, Factorisation::Svd] {
        let settings = cut(Truncation::Rank(3)).with_factorisation(factorisation);
        let error = relative_difference(&case.updated(2.0, &settings).unwrap(), &wanted);
        assert!(error < 1e-12, "{factorisation:?}: {error:e}");
    }
}

#[test]
fn an_energy_keeps_the_smallest_rank_that_holds_it() {
    let case = Case::new(7, 12, 40, 0.3, 11);
    let singular = whitened(&case, 2.0).singular_values().unwrap();
    let total: f64 = singular.iter().map(|w| w * w).sum();
    for rank in 1..7 {
        let held: f64 = singular[..rank].iter().map(|w| w * w).sum::<f64>() / total;
        let wanted = case.updated(2.0, &cut(Truncation::Rank(rank))).unwrap();
        let found = case.updated(2.0, &cut(Truncation::Energy(held * (1.0 - 1e-9)))).unwrap();
        assert_eq!(found, wanted, "rank {rank}");
        let more = case.updated(2.0, &cut(Truncation::Energy(held * (1.0 + 1e-6)))).unwrap();
        assert!(relative_difference(&more, &wanted) > 1e-6, "rank {rank} is not enough");
    }
}

#[test]
fn the_square_root_form_is_cut_too() {
    let case = Case::new(7, 12, 40, 0.3, 11);
    let update = |settings: &StepSettings| {
        let (y, noise) = (case.predicted.as_ref(), case.noise());
        let mut parameters = case.parameters.clone();
        Step::prepare_square_root(y, &case.observed, &noise, 2.0, settings)
            .unwrap()
            .apply(parameters.as_mut())
            .unwrap();
        moments(&parameters).1
    };
    let prior = moments(&case.parameters).1;
    let trace = |m: &Mat<f64>| (0..7).map(|i| m[(i, i)]).sum::<f64>();
    let traces = [1, 3, 7].map(|rank| trace(&update(&cut(Truncation::Rank(rank)))));
    assert!(trace(&prior) > traces[0] && traces[0] > traces[1] && traces[1] > traces[2]);
    // Seven parameters: S has seven directions.
    let whole = update(&StepSettings::default());
    assert!(relative_difference(&update(&cut(Truncation::Rank(7))), &whole) < 1e-12);
}

#[test]
fn where_the_noise_is_small_a_cut_costs_much_more_than_it_hides() {
    // Why it is off by default. Each parameter shows half as much as the one before, the last still eight deviations.
    let mut problem = LinearGaussian::new(8, 12, 1e-3, 3);
    for (parameter, shown) in problem.operator.col_iter_mut().enumerate() {
        let scale = 0.5_f64.powi(parameter as i32);
        shown.iter_mut().for_each(|value| *value *= scale);
    }
    let exact = &problem.operator * column(&problem.truth);
    problem.observed = exact.col(0).iter().copied().collect();
    let mean = problem.posterior(1.0).0;
    let error = |settings: &StepSettings| {
        let mut ensemble = Normals::new(5).exact(8, 40, &[]);
        let predicted = &problem.operator * &ensemble;
        let (y, noise) = (predicted.as_ref(), problem.noise());
        Step::prepare_square_root(y, &problem.observed, &noise, 1.0, settings)
            .unwrap()
            .apply(ensemble.as_mut())
            .unwrap();
        (moments(&ensemble).0 - &mean).norm_l2()
    };
    let whole = error(&StepSettings::default());
    assert!(whole < 1e-9, "{whole:e}");
    assert!(error(&cut(Truncation::Energy(0.99))) > 0.1);
}

#[test]
fn a_truncation_that_keeps_nothing_is_refused() {
    let case = Case::new(3, 4, 10, 0.3, 5);
    for truncation in [
        Truncation::Rank(0),
        Truncation::Energy(0.0),
        Truncation::Energy(-0.5),
        Truncation::Energy(1.5),
        Truncation::Energy(f64::NAN),
    ] {
        let error = case.step(2.0, &cut(truncation)).unwrap_err();
        assert!(matches!(error, EsmdaError::Truncation { .. }), "{truncation:?}: {error}");
    }
}
