//! Localization: against the plain step and the formula, and what it is for.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, Normals, moments, relative_difference};
use faer::prelude::Solve;
use faer::{Mat, Par};
use tissuereg_esmda::{
    LocalizedStep, NoiseCovariance, Step, StepSettings, Taper, Truncation, gaspari_cohn,
};

/// Independent, correlated and shared noise for a case, each with the covariance it stands for.
fn noises(case: &Case) -> Vec<(NoiseCovariance, Mat<f64>)> {
    let n = case.std.len();
    let diagonal = Mat::from_fn(n, n, |i, j| if i == j { case.std[i].powi(2) } else { 0.0 });
    let dense = Mat::from_fn(n, n, |i, j| {
        case.std[i] * case.std[j] * 0.6_f64.powi((i as i32 - j as i32).abs())
    });
    let columns = Normals::new(8).matrix(n, 2);
    let shared = &columns * columns.transpose() + &diagonal;
    vec![
        (case.noise(), diagonal),
        (NoiseCovariance::dense(dense.as_ref()).unwrap(), dense),
        (NoiseCovariance::low_rank(&case.std, columns.as_ref()).unwrap(), shared),
    ]
}

fn localized(
    case: &Case,
    noise: &NoiseCovariance,
    taper: Taper<'_>,
    settings: &StepSettings,
) -> Mat<f64> {
    let (y, e) = (case.predicted.as_ref(), case.draws.as_ref());
    let mut parameters = case.parameters.clone();
    let step = LocalizedStep::prepare(y, &case.observed, noise, 2.0, e, settings).unwrap();
    step.apply(parameters.as_mut(), taper).unwrap();
    parameters
}

fn plain(case: &Case, noise: &NoiseCovariance, settings: &StepSettings) -> Mat<f64> {
    let (y, e) = (case.predicted.as_ref(), case.draws.as_ref());
    let mut parameters = case.parameters.clone();
    let step = Step::prepare(y, &case.observed, noise, 2.0, e, settings).unwrap();
    step.apply(parameters.as_mut()).unwrap();
    parameters
}

/// Sample correlations of parameters and predictions.
fn correlations(case: &Case) -> Mat<f64> {
    let n = case.parameters.nrows();
    let both = Mat::from_fn(n + case.predicted.nrows(), case.predicted.ncols(), |i, j| {
        if i < n { case.parameters[(i, j)] } else { case.predicted[(i - n, j)] }
    });
    let c = moments(&both).1;
    Mat::from_fn(n, case.predicted.nrows(), |i, j| {
        c[(i, n + j)] / (c[(i, i)] * c[(n + j, n + j)]).sqrt()
    })
}

#[test]
fn a_taper_of_ones_is_the_plain_step() {
    for (n_obs, n_members) in [(45, 100), (80, 30)] {
        let case = Case::new(150, n_obs, n_members, 0.3, 3);
        let ones = Mat::from_fn(150, n_obs, |_, _| 1.0);
        let cut = StepSettings::default().with_truncation(Some(Truncation::Rank(5)));
        for (noise, _) in noises(&case) {
            for settings in [StepSettings::default(), cut] {
                let wanted = plain(&case, &noise, &settings);
                for taper in [Taper::Given(ones.as_ref()), Taper::Threshold(0.0)] {
                    let error =
                        relative_difference(&localized(&case, &noise, taper, &settings), &wanted);
                    assert!(error < 1e-12, "{n_obs} x {n_members}, {settings:?}: {error:e}");
                }
            }
        }
    }
}

#[test]
fn any_taper_damps_the_gain_entry_by_entry() {
    let case = Case::new(9, 12, 40, 0.3, 4);
    let factors = Mat::from_fn(9, 12, |i, j| ((i * 12 + j) as f64 * 0.37).fract());
    let both = Mat::from_fn(21, 40, |i, j| {
        if i < 9 { case.parameters[(i, j)] } else { case.predicted[(i - 9, j)] }
    });
    let c = moments(&both).1;
    for (index, (noise, covariance)) in noises(&case).iter().enumerate().take(2) {
        let of_data = c.get(9.., 9..) + covariance * faer::Scale(2.0);
        let gain = of_data.partial_piv_lu().solve(c.get(9.., ..9)).transpose().to_owned();
        let gain = Mat::from_fn(9, 12, |i, j| gain[(i, j)] * factors[(i, j)]);
        let root = covariance.llt(faer::Side::Lower).unwrap().L().to_owned();
        let perturbed = root * &case.draws * faer::Scale(2.0_f64.sqrt());
        let innovations = Mat::from_fn(12, 40, |i, j| {
            case.observed[i] + perturbed[(i, j)] - case.predicted[(i, j)]
        });
        let wanted = &case.parameters + gain * innovations;
        let taper = Taper::Given(factors.as_ref());
        let found = localized(&case, noise, taper, &StepSettings::default());
        let error = relative_difference(&found, &wanted);
        assert!(error < 1e-11, "noise {index}: {error:e}");
    }
}

#[test]
fn an_observation_does_not_move_a_parameter_where_the_taper_is_zero() {
    let mut case = Case::new(9, 12, 40, 0.3, 4);
    let factors = Mat::from_fn(9, 12, |i, j| if i < 4 && j == 3 { 0.0 } else { 1.0 });
    let dense = noises(&case).remove(1).0;
    let run = |case: &Case| {
        localized(case, &dense, Taper::Given(factors.as_ref()), &StepSettings::default())
    };
    let before = run(&case);
    case.observed[3] += 100.0;
    let change = run(&case) - before;
    // Correlated noise: whitening mixes observations, by rounding of the 100 only.
    assert!(change.get(..4, ..).norm_max() < 1e-11, "{:e}", change.get(..4, ..).norm_max());
    assert!(change.get(4.., ..).norm_max() > 0.1);
}

#[test]
fn correlations_make_the_taper_that_they_should() {
    let case = Case::new(150, 12, 40, 0.3, 4);
    let (r, threshold) = (correlations(&case), Taper::default_threshold(40));
    assert!((threshold - 3.0 / 40.0_f64.sqrt()).abs() < 1e-15);
    let hard = Mat::from_fn(150, 12, |i, j| f64::from(u8::from(r[(i, j)].abs() > threshold)));
    let smooth =
        Mat::from_fn(150, 12, |i, j| gaspari_cohn((1.0 - r[(i, j)].abs()) / (1.0 - threshold)));
    let (noise, settings) = (case.noise(), StepSettings::default());
    for (factors, taper) in
        [(hard, Taper::Threshold(threshold)), (smooth, Taper::Smooth(threshold))]
    {
        let wanted = localized(&case, &noise, Taper::Given(factors.as_ref()), &settings);
        let error = relative_difference(&localized(&case, &noise, taper, &settings), &wanted);
        assert!(error < 1e-12, "{error:e}");
    }
}

#[test]
fn a_parameter_or_prediction_without_spread_is_left_alone() {
    let mut case = Case::new(9, 12, 40, 0.3, 4);
    for member in 0..40 {
        case.parameters[(2, member)] = 1.5;
        case.predicted[(5, member)] = -1.0;
    }
    let (noise, settings) = (case.noise(), StepSettings::default());
    for taper in [Taper::Threshold(0.3), Taper::Smooth(0.3)] {
        let found = localized(&case, &noise, taper, &settings);
        assert!(found.is_all_finite());
        assert_eq!(found.row(2), case.parameters.row(2));
    }
}

#[test]
fn gaspari_and_cohn_is_smooth_falling_and_of_compact_support() {
    let at = |k: i32| gaspari_cohn(f64::from(k) * 1e-3);
    for k in 0..2000 {
        assert!(at(k + 1) <= at(k), "{k}");
    }
    assert_eq!((at(0), at(2000), at(5000)), (1.0, 0.0, 0.0));
    // Curvature on both sides of the joint at one: the pieces meet with three derivatives.
    let curvature = |k: i32| (at(k + 1) - 2.0 * at(k) + at(k - 1)) * 1e6;
    assert!((curvature(999) - curvature(1001)).abs() < 0.05);
    assert_eq!(gaspari_cohn(-0.7), gaspari_cohn(0.7));
}

/// Rows of mean zero and variance one.
fn standardised(rows: Mat<f64>) -> Mat<f64> {
    let (mean, covariance) = moments(&rows);
    Mat::from_fn(rows.nrows(), rows.ncols(), |i, j| {
        (rows[(i, j)] - mean[(i, 0)]) / covariance[(i, i)].sqrt()
    })
}

#[test]
fn few_members_and_many_local_observations_need_it() {
    // 60 independent parameters of variance one, each observed on its own with as much noise, 20 members: with a
    // coefficient of two the mean moves by a third of the observation.
    for seed in 0..10 {
        let mut normals = Normals::new(seed);
        let parameters = standardised(normals.matrix(60, 20));
        let case = Case {
            predicted: parameters.clone(),
            draws: standardised(normals.matrix(60, 20)),
            parameters,
            std: vec![1.0; 60],
            observed: normals.vector(60),
        };
        let error = |found: &Mat<f64>| {
            let mean = moments(found).0;
            let off = |i: usize| (mean[(i, 0)] - case.observed[i] / 3.0).powi(2);
            ((0..60).map(off).sum::<f64>() / 60.0).sqrt()
        };
        let (noise, settings) = (case.noise(), StepSettings::default());
        let identity = Mat::<f64>::identity(60, 60);
        let without = error(&plain(&case, &noise, &settings));
        let threshold = Taper::default_threshold(20);
        for taper in
            [Taper::Given(identity.as_ref()), Taper::Threshold(threshold), Taper::Smooth(threshold)]
        {
            // About half: what chance correlations add to the mean is gone, what they add to C_yy is not.
            let with = error(&localized(&case, &noise, taper, &settings));
            assert!(with < 0.65 * without, "seed {seed}: {with} {without}");
        }
    }
}

#[test]
fn bits_depend_neither_on_threads_nor_on_aligned_batches() {
    let case = Case::new(300, 45, 60, 0.3, 6);
    let factors = Mat::from_fn(300, 45, |i, j| ((i * 45 + j) as f64 * 0.37).fract());
    let noise = case.noise();
    for given in [true, false] {
        let taper = |from: usize, to: usize| {
            if given { Taper::Given(factors.get(from..to, ..)) } else { Taper::Smooth(0.4) }
        };
        let alone = localized(&case, &noise, taper(0, 300), &StepSettings::default());
        for n_threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
            let settings = StepSettings::default().with_par(Par::rayon(n_threads));
            let together = pool.install(|| localized(&case, &noise, taper(0, 300), &settings));
            assert_eq!(alone, together, "{n_threads} threads");
        }
        let (y, e) = (case.predicted.as_ref(), case.draws.as_ref());
        let settings = StepSettings::default();
        let step = LocalizedStep::prepare(y, &case.observed, &noise, 2.0, e, &settings).unwrap();
        let mut batched = case.parameters.clone();
        for (from, to) in [(150, 300), (0, 1), (1, 3), (3, 150)] {
            step.apply(batched.get_mut(from..to, ..), taper(from, to)).unwrap();
        }
        // Products of other widths sum in another order.
        assert!(relative_difference(&batched, &alone) < 1e-13);
    }
}

#[test]
fn wrong_tapers_are_refused_and_parameters_stay_as_they_were() {
    let case = Case::new(3, 4, 10, 0.3, 5);
    let (y, e, settings) = (case.predicted.as_ref(), case.draws.as_ref(), StepSettings::default());
    let noise = case.noise();
    let step = LocalizedStep::prepare(y, &case.observed, &noise, 2.0, e, &settings).unwrap();
    let mut parameters = case.parameters.clone();
    let mut refuse = |taper: Taper<'_>, message: &str| {
        let error = step.apply(parameters.as_mut(), taper).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
        assert_eq!(parameters, case.parameters);
    };
    let mut factors = Mat::from_fn(3, 4, |_, _| 1.0);
    refuse(Taper::Given(Mat::zeros(4, 3).as_ref()), "`taper` must have shape (3, 4), got (4, 3)");
    for wrong in [1.1, -0.1, f64::NAN] {
        factors[(1, 2)] = wrong;
        refuse(Taper::Given(factors.as_ref()), "at parameter 1, observation 2");
    }
    for wrong in [-0.1, 1.1, f64::NAN] {
        refuse(Taper::Threshold(wrong), "correlation threshold must lie in [0, 1]");
    }
    refuse(Taper::Smooth(1.0), "below 1 for a smooth taper");
    let mut broken = case.parameters.clone();
    broken[(1, 1)] = f64::NAN;
    let error = step.apply(broken.as_mut(), Taper::Threshold(0.3)).unwrap_err().to_string();
    assert!(error.contains("`parameters` must be finite"), "{error}");
}
