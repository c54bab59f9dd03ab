//! Scores of the Gaussians of a mixture. Exact: densities by determinants, a group left out and predicted by the others,
//! bits on any number of threads. Refused: what does not fit together.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::Normals;
use faer::linalg::solvers::DenseSolveCore;
use faer::prelude::Solve;
use faer::{Mat, Par, Side};
use tissuereg_esmda::{ComponentScore, EsmdaError, Groups, ScaledComponent, score_components};

const N_COMPONENTS: usize = 3;
const N_OBS: usize = 12;
const GROUP: usize = 3;
const EVERY: Groups = Groups::Every(GROUP);

/// Covariances on top of each other, innovations, noise, and pairs in no order.
fn problem() -> (Mat<f64>, Mat<f64>, Mat<f64>, Vec<ScaledComponent>) {
    let mut normals = Normals::new(7);
    let mut covariances = Mat::zeros(N_COMPONENTS * N_OBS, N_OBS);
    for component in 0..N_COMPONENTS {
        let root = normals.matrix(N_OBS, N_OBS + 2);
        let own = &root * root.transpose();
        covariances.as_mut().subrows_mut(component * N_OBS, N_OBS).copy_from(own);
    }
    let root = normals.matrix(N_OBS, 2 * N_OBS);
    let noise = &root * root.transpose() * 0.05;
    let pairs = [(2, 0.5), (0, 2.0), (1, 1.0), (0, 0.0), (2, 3.0)];
    let pairs = pairs.map(|(component, scale)| ScaledComponent { component, scale }).to_vec();
    (covariances, normals.matrix(N_COMPONENTS, N_OBS), noise, pairs)
}

fn scores(groups: Groups, par: Par) -> Vec<ComponentScore> {
    let (covariances, innovations, noise, pairs) = problem();
    let (a, v) = (covariances.as_ref(), innovations.as_ref());
    score_components(a, v, &pairs, noise.as_ref(), groups, par).unwrap()
}

/// Covariance of a pair's innovation, and the innovation.
fn total(pair: &ScaledComponent) -> (Mat<f64>, Mat<f64>) {
    let (covariances, innovations, noise, _) = problem();
    let own = covariances.subrows(pair.component * N_OBS, N_OBS);
    let total = Mat::from_fn(N_OBS, N_OBS, |i, j| pair.scale.powi(2) * own[(i, j)] + noise[(i, j)]);
    (total, Mat::from_fn(N_OBS, 1, |i, _| innovations[(pair.component, i)]))
}

fn close(found: f64, wanted: f64) {
    assert!((found - wanted).abs() < 1e-9 * wanted.abs().max(1.0), "{found} is not {wanted}");
}

#[test]
fn densities_are_those_by_determinants() {
    for (score, pair) in scores(Groups::Nothing, Par::Seq).iter().zip(problem().3) {
        let (total, innovation) = total(&pair);
        let pull = total.llt(Side::Lower).unwrap().solve(&innovation);
        let square = (innovation.transpose() * &pull)[(0, 0)];
        close(score.log_density, -0.5 * (square + total.determinant().ln()));
        for (found, wanted) in score.pull.iter().zip(pull.col(0).iter()) {
            close(*found, *wanted);
        }
        assert!(score.misfits.is_empty() && score.log_dets.is_empty());
    }
}

#[test]
fn a_group_is_predicted_by_all_others() {
    for (score, pair) in scores(EVERY, Par::Seq).iter().zip(problem().3) {
        let (total, innovation) = total(&pair);
        assert_eq!(score.misfits.len(), N_OBS / GROUP);
        for group in 0..N_OBS / GROUP {
            let own: Vec<usize> = (GROUP * group..GROUP * (group + 1)).collect();
            let others: Vec<usize> = (0..N_OBS).filter(|obs| !own.contains(obs)).collect();
            let block = |rows: &[usize], columns: &[usize]| {
                Mat::from_fn(rows.len(), columns.len(), |i, j| total[(rows[i], columns[j])])
            };
            let given = block(&others, &others).llt(Side::Lower).unwrap();
            let gain = given.solve(block(&others, &own));
            let seen = Mat::from_fn(others.len(), 1, |i, _| innovation[(others[i], 0)]);
            let off =
                Mat::from_fn(GROUP, 1, |i, _| innovation[(own[i], 0)]) - gain.transpose() * seen;
            let left = block(&own, &own) - block(&own, &others) * &gain;
            let misfit = (off.transpose() * left.llt(Side::Lower).unwrap().solve(&off))[(0, 0)];
            close(score.misfits[group], misfit);
            close(score.log_dets[group], left.partial_piv_lu().inverse().determinant().ln());
        }
    }
}

#[test]
fn the_last_group_alone_is_as_among_all() {
    for (last, every) in scores(Groups::Last(GROUP), Par::Seq).iter().zip(scores(EVERY, Par::Seq)) {
        assert_eq!((last.misfits.len(), last.log_dets.len()), (1, 1));
        close(last.misfits[0], every.misfits[N_OBS / GROUP - 1]);
        close(last.log_dets[0], every.log_dets[N_OBS / GROUP - 1]);
        assert_eq!((last.log_density, &last.pull), (every.log_density, &every.pull));
    }
}

#[test]
fn threads_and_groups_change_no_bit() {
    let (one, many) = (scores(EVERY, Par::Seq), scores(EVERY, Par::rayon(3)));
    assert_eq!(one, many);
    for (with, without) in one.iter().zip(scores(Groups::Nothing, Par::Seq)) {
        assert_eq!((with.log_density, &with.pull), (without.log_density, &without.pull));
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let (covariances, innovations, noise, pairs) = problem();
    let (a, v, c) = (covariances.as_ref(), innovations.as_ref(), noise.as_ref());
    let refused = |pairs: &[ScaledComponent], groups| {
        score_components(a, v, pairs, c, groups, Par::Seq).unwrap_err()
    };
    let beyond = [ScaledComponent { component: 3, scale: 1.0 }];
    assert!(matches!(
        refused(&beyond, Groups::Nothing),
        EsmdaError::Setting { name: "component", .. }
    ));
    let endless = [ScaledComponent { component: 0, scale: f64::INFINITY }];
    assert!(matches!(
        refused(&endless, Groups::Nothing),
        EsmdaError::Setting { name: "scale", .. }
    ));
    for groups in [Groups::Every(5), Groups::Every(0), Groups::Last(5), Groups::Last(0)] {
        assert!(matches!(refused(&pairs, groups), EsmdaError::Setting { name: "group", .. }));
    }
    let fewer = a.subrows(1, 5);
    let error = score_components(fewer, v, &pairs, c, Groups::Nothing, Par::Seq).unwrap_err();
    assert!(matches!(error, EsmdaError::Shape { argument: "covariances", .. }));
    let negative = c * faer::Scale(-1000.0);
    let error =
        score_components(a, v, &pairs, negative.as_ref(), Groups::Nothing, Par::Seq).unwrap_err();
    assert_eq!(error, EsmdaError::NoiseNotPositiveDefinite { pivot: 0 });
    let mut spoilt = covariances.clone();
    spoilt[(4, 1)] = f64::NAN;
    let error =
        score_components(spoilt.as_ref(), v, &pairs, c, Groups::Nothing, Par::Seq).unwrap_err();
    assert!(matches!(error, EsmdaError::NotFinite { argument: "covariances", row: 4, .. }));
}
