//! Groups of observations tested after the fit. Exact: the residual's covariance and the equality with leaving a group
//! out. Reference: the tail of the chi-square law. Statistical: wrong markers found, good ones kept.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{LinearGaussian, Normals, column, relative_difference};
use faer::linalg::solvers::DenseSolveCore;
use faer::prelude::Solve;
use faer::{Mat, MatRef, Side, mat};
use tissuereg_esmda::{
    GaussNewton, Gaussian, GroupScore, NoiseCovariance, SearchSettings, score_groups, wrong_groups,
};

const N_MARKERS: usize = 15;
const N_PARAMETERS: usize = 26;

/// The fit of a linear model to the markers that are kept: residual, noise, what was absorbed, marker of every row.
struct Fit {
    residual: Vec<f64>,
    noise: Mat<f64>,
    absorbed: Mat<f64>,
    groups: Vec<usize>,
}

fn fit(problem: &LinearGaussian, kept: &[usize]) -> Fit {
    let rows: Vec<usize> = kept.iter().flat_map(|marker| 3 * marker..3 * marker + 3).collect();
    let n = problem.operator.ncols();
    let operator = Mat::from_fn(rows.len(), n, |i, j| problem.operator[(rows[i], j)]);
    let observed: Vec<f64> = rows.iter().map(|&row| problem.observed[row]).collect();
    let noise = Mat::from_fn(rows.len(), rows.len(), |i, j| problem.covariance[(rows[i], rows[j])]);
    let prior = Gaussian::new(&vec![0.0; n], Mat::<f64>::identity(n, n).as_ref()).unwrap();
    let covariance = NoiseCovariance::dense(noise.as_ref()).unwrap();
    let settings = SearchSettings::default();
    let mut search = GaussNewton::new(prior, &observed, covariance, settings).unwrap();
    loop {
        let predicted = &operator * column(search.point());
        let predicted: Vec<f64> = predicted.col(0).iter().copied().collect();
        assert!(search.evaluate(&predicted).unwrap().accepted);
        if search.linearise(operator.as_ref()).unwrap().converged {
            let root = search.predicted_root().unwrap();
            let residual = observed.iter().zip(&predicted).map(|(d, y)| d - y).collect();
            let groups = rows.iter().map(|row| row / 3).collect();
            return Fit { residual, noise, absorbed: &root * root.transpose(), groups };
        }
    }
}

fn scores(fit: &Fit) -> Vec<GroupScore> {
    score_groups(&fit.residual, fit.noise.as_ref(), fit.absorbed.as_ref(), &fit.groups, N_MARKERS)
        .unwrap()
}

/// Markers dropped, one at a time with a fit between.
fn dropped(problem: &LinearGaussian, level: f64) -> Vec<usize> {
    let mut kept: Vec<usize> = (0..N_MARKERS).collect();
    let mut dropped = Vec::new();
    while let Some(&worst) = wrong_groups(&scores(&fit(problem, &kept)), level).first() {
        kept.retain(|&marker| marker != worst);
        dropped.push(worst);
    }
    dropped
}

/// Predictions with about the spread of one over the latents, noise a tenth of that.
fn problem(seed: u64) -> LinearGaussian {
    let mut problem = LinearGaussian::new(N_PARAMETERS, 3 * N_MARKERS, 0.5, seed);
    // A spectrum that falls, as that of deformations does: the first few latents carry most.
    for column in 0..N_PARAMETERS {
        let scale = 0.8_f64.powi(column as i32);
        problem.operator.col_mut(column).iter_mut().for_each(|value| *value *= scale);
    }
    let mut normals = Normals::new(7000 + seed);
    let truth = normals.matrix(N_PARAMETERS, 1);
    let clean = &problem.operator * truth;
    problem.observed = (0..3 * N_MARKERS).map(|i| clean[(i, 0)] + 0.5 * normals.draw()).collect();
    problem
}

#[test]
fn the_covariance_of_the_fitted_residual_is_the_noise_less_what_the_fit_absorbed() {
    let noise = Mat::from_fn(9, 9, |i, j| 0.2 * 0.5_f64.powi((i as i32 - j as i32).abs()));
    let problem = LinearGaussian::with_covariance(4, noise.clone(), 5);
    let fit = fit(&problem, &[0, 1, 2]);
    let innovation = &problem.operator * problem.operator.transpose() + &noise;
    let wanted = &noise * innovation.llt(Side::Lower).unwrap().solve(&noise);
    // Rounding of numbers of order one.
    assert!(relative_difference(&(&noise - &fit.absorbed), &wanted) < 1e-12);
}

#[test]
fn a_score_is_the_misfit_to_the_prediction_from_all_others() {
    let correlated = |length: f64| {
        let far = |i: usize, j: usize| (i as f64 - j as f64).abs() / length;
        Mat::from_fn(3 * N_MARKERS, 3 * N_MARKERS, |i, j| 0.25 * (-far(i, j)).exp())
    };
    // Independent, and correlated across markers.
    for length in [1e-3, 4.0] {
        let mut problem = problem(3);
        problem.covariance = correlated(length);
        let all: Vec<usize> = (0..N_MARKERS).collect();
        let found = scores(&fit(&problem, &all));
        let spread = &problem.operator * problem.operator.transpose() + &problem.covariance;
        for marker in 0..N_MARKERS {
            let mine: Vec<usize> = (3 * marker..3 * marker + 3).collect();
            let others: Vec<usize> = (0..3 * N_MARKERS).filter(|row| row / 3 != marker).collect();
            let block = |rows: &[usize], columns: &[usize]| {
                Mat::from_fn(rows.len(), columns.len(), |i, j| spread[(rows[i], columns[j])])
            };
            let data =
                |rows: &[usize]| Mat::from_fn(rows.len(), 1, |i, _| problem.observed[rows[i]]);
            let inverse = block(&others, &others).llt(Side::Lower).unwrap().inverse();
            let gain = block(&mine, &others) * inverse;
            let away = data(&mine) - &gain * data(&others);
            let covariance = block(&mine, &mine) - &gain * block(&others, &mine);
            let solved = covariance.llt(Side::Lower).unwrap().solve(&away);
            let wanted = (away.transpose() * solved)[(0, 0)];
            // The two ways differ by rounding times the condition number of the spread, about 1e4.
            let ratio = found[marker].chi_square / wanted;
            assert!((ratio - 1.0).abs() < 1e-9, "length {length}, marker {marker}: {ratio}");
        }
    }
}

#[test]
fn p_values_are_the_tails_of_the_chi_square_law() {
    // scipy.stats.chi2.sf(x, n_obs)
    let known = [
        (1, 3.84, 0.05004352124870519),
        (2, 9.0, 0.011108996538242308),
        (3, 0.1, 0.9918374237318764),
        (3, 16.27, 0.0009982232399054186),
        (4, 7.0, 0.13588822540043327),
        (6, 60.0, 4.501016648012131e-11),
        (3, 900.0, 8.851690237125443e-195),
    ];
    for (n_obs, x, tail) in known {
        let mut residual = vec![0.0; n_obs];
        residual[0] = f64::sqrt(x);
        let (noise, absorbed) = (Mat::<f64>::identity(n_obs, n_obs), Mat::zeros(n_obs, n_obs));
        let groups = vec![0; n_obs];
        let scores =
            score_groups(&residual, noise.as_ref(), absorbed.as_ref(), &groups, 1).unwrap();
        // A rounding of x changes the tail by x times as much.
        let found = scores[0].p_value;
        assert!((found / tail - 1.0).abs() < 1e-12, "{n_obs} {x}: {found:e}");
    }
}

#[test]
fn a_marker_ten_deviations_off_is_found_and_good_markers_are_kept() {
    let level = 0.005;
    let alarms = (0..300).filter(|&seed| !dropped(&problem(seed), level).is_empty()).count();
    // 1.5 are expected at most: more than three with a probability of 0.07, and the seeds are fixed.
    assert!(alarms <= 3, "{alarms} of 300");
    let mut found = 0;
    for seed in 0..60 {
        let mut problem = problem(1000 + seed);
        let marker = (seed % 15) as usize;
        problem.observed[3 * marker + (seed % 3) as usize] += 10.0 * 0.5;
        found += usize::from(dropped(&problem, level) == [marker]);
    }
    assert!(found >= 58, "{found} of 60");
}

#[test]
fn p_values_of_good_data_are_uniform() {
    let mut p: Vec<f64> = (0..400)
        .map(|seed| scores(&fit(&problem(seed), &[0, 1, 2, 3, 4, 5, 6]))[3].p_value)
        .collect();
    p.sort_by(f64::total_cmp);
    let n = p.len() as f64;
    let distance = p.iter().enumerate().map(|(i, p)| (p - (i as f64 + 0.5) / n).abs());
    // The 1 % point of Kolmogorov's law is 1.63 / sqrt(n).
    assert!(distance.fold(0.0, f64::max) < 1.63 / n.sqrt());
}

#[test]
fn a_change_of_axes_within_a_marker_changes_no_score() {
    let problem = problem(4);
    let all: Vec<usize> = (0..N_MARKERS).collect();
    let plain = fit(&problem, &all);
    let turn = mat![[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 2.0]];
    let n = 3 * N_MARKERS;
    let block = Mat::from_fn(n, n, |i, j| if i / 3 == j / 3 { turn[(i % 3, j % 3)] } else { 0.0 });
    let turned = |matrix: &Mat<f64>| &block * matrix * block.transpose();
    let residual = &block * column(&plain.residual);
    let changed = Fit {
        residual: residual.col(0).iter().copied().collect(),
        noise: turned(&plain.noise),
        absorbed: turned(&plain.absorbed),
        groups: plain.groups.clone(),
    };
    for (a, b) in scores(&plain).iter().zip(scores(&changed)) {
        // Rounding of three by three numbers.
        assert!((a.chi_square / b.chi_square - 1.0).abs() < 1e-11);
        assert!((a.leverage - b.leverage).abs() < 1e-12);
    }
}

#[test]
fn a_fit_that_claims_to_have_absorbed_everything_leaves_a_twentieth() {
    let identity = Mat::<f64>::identity(1, 1);
    let scores = score_groups(&[1.0], identity.as_ref(), identity.as_ref(), &[0], 1).unwrap();
    assert_eq!(scores[0].chi_square, 1.0 / 0.05);
    assert_eq!(scores[0].leverage, 1.0);
}

#[test]
fn groups_without_observations_count_for_nothing() {
    let (noise, absorbed) = (Mat::<f64>::identity(2, 2), Mat::zeros(2, 2));
    let score = |residual: &[f64]| {
        score_groups(residual, noise.as_ref(), absorbed.as_ref(), &[2, 0], 3).unwrap()
    };
    let scores = score(&[4.0, 0.0]);
    assert_eq!(scores.iter().map(|score| score.n_obs).collect::<Vec<_>>(), [1, 0, 1]);
    assert_eq!((scores[1].chi_square, scores[1].p_value), (0.0, 1.0));
    // The level is shared by two groups, not three: the chance of 4 deviations is 6.33e-5.
    assert_eq!(wrong_groups(&scores, 2.1 * 6.33e-5), [2]);
    assert!(wrong_groups(&scores, 1.9 * 6.33e-5).is_empty());
    // Where both tails are too small to be told apart, the larger misfit is the worse.
    assert_eq!(wrong_groups(&score(&[50.0, 60.0]), 0.01), [0, 2]);
    let none = score_groups(&[], Mat::new().as_ref(), Mat::new().as_ref(), &[], 2).unwrap();
    assert_eq!(none.len(), 2);
    assert!(wrong_groups(&none, 1.0).is_empty());
}

#[test]
fn a_misfit_beyond_the_range_of_numbers_is_wrong() {
    let absorbed = Mat::from_fn(3, 3, |i, j| if i == j { 1e-7 } else { 1e-8 });
    for (size, std) in [(1e160, 1.0), (1e300, 1e-3), (f64::MAX, 1e-3)] {
        let noise = Mat::from_fn(3, 3, |i, j| if i == j { std * std } else { 0.0 });
        for residual in [[size, 0.0, 0.0], [size, -size, size]] {
            let score = |groups: &[usize]| {
                score_groups(&residual, noise.as_ref(), absorbed.as_ref(), groups, 3).unwrap()
            };
            for groups in [[0, 0, 0], [0, 1, 2]] {
                let found = score(&groups);
                assert_eq!((found[0].chi_square, found[0].p_value), (f64::INFINITY, 0.0));
                assert!(wrong_groups(&found, 0.01).contains(&0));
            }
        }
    }
}

#[test]
fn bad_arguments_are_refused_by_name() {
    let (one, nan) = (Mat::<f64>::identity(2, 2), mat![[1.0, 0.0], [0.0, f64::NAN]]);
    let try_with =
        |residual: &[f64], noise: MatRef<'_, f64>, absorbed: MatRef<'_, f64>, groups: &[usize]| {
            score_groups(residual, noise, absorbed, groups, 2).expect_err("must be refused")
        };
    let (ones, nans) = (one.as_ref(), nan.as_ref());
    let small = one.get(..1, ..1);
    for (error, start) in [
        (try_with(&[1.0; 2], small, ones, &[0, 0]), "`noise` must have shape (2, 2), got (1, 1)"),
        (try_with(&[1.0; 2], ones, small, &[0, 0]), "`absorbed` must have shape (2, 2)"),
        (try_with(&[1.0; 2], ones, ones, &[0, 2]), "`groups` must be less than `n_groups`, got 2"),
        (try_with(&[1.0; 2], ones, ones, &[0]), "`groups` must have shape (2, 1), got (1, 1)"),
        (
            try_with(&[1.0, f64::NAN], ones, ones, &[0, 0]),
            "`residual` must be finite, got NaN at row 1",
        ),
        (try_with(&[1.0; 2], nans, ones, &[0, 0]), "`noise` must be finite"),
        (try_with(&[1.0; 2], ones, nans, &[0, 0]), "`absorbed` must be finite"),
        (
            try_with(&[1.0; 2], mat![[1.0, 0.0], [0.0, -1.0]].as_ref(), ones, &[0, 1]),
            "the noise covariance must be positive definite; its factorisation fails at pivot 1",
        ),
    ] {
        assert!(error.to_string().starts_with(start), "{error}");
    }
}
