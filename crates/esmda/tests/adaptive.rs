//! Adaptive schedules: the rules' formulas, and the posterior they lead to.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, LinearGaussian, Normals, moments, relative_difference};
use faer::{Mat, mat};
use tissuereg_esmda::{
    AdaptiveRule, EsmdaError, NoiseCovariance, Schedule, Step, StepSettings, largest_change,
    next_alpha,
};

const RULES: [AdaptiveRule; 2] = [AdaptiveRule::DataMisfit, AdaptiveRule::RestrictedStep];

/// Runs a rule to its end with square-root steps; the coefficients.
fn run(
    problem: &LinearGaussian,
    ensemble: &mut Mat<f64>,
    rule: AdaptiveRule,
    max_steps: usize,
) -> Vec<f64> {
    let std = vec![1.0; ensemble.nrows()];
    let (mut alphas, mut assimilated) = (Vec::new(), 0.0);
    while alphas.len() < max_steps {
        let left = max_steps - alphas.len();
        let (predicted, noise) = (&problem.operator * &*ensemble, problem.noise());
        let (y, d) = (predicted.as_ref(), &problem.observed);
        let mut alpha = next_alpha(rule, y, d, &noise, assimilated, left).unwrap();
        let updated = loop {
            let settings = StepSettings::default();
            let step = Step::prepare_square_root(y, d, &noise, alpha, &settings).unwrap();
            let mut updated = ensemble.clone();
            step.apply(updated.as_mut()).unwrap();
            let change = largest_change(ensemble.as_ref(), updated.as_ref(), &std).unwrap();
            if rule == AdaptiveRule::DataMisfit || left == 1 || change <= 2.0 {
                break updated;
            }
            alpha *= 2.0;
        };
        *ensemble = updated;
        alphas.push(alpha);
        assimilated += 1.0 / alpha;
        if 1.0 - assimilated < 1e-12 {
            break;
        }
    }
    alphas
}

#[test]
fn every_rule_closes_the_sum_and_gives_the_kalman_posterior() {
    for (std, tolerance) in [(0.3, 1e-12), (1e-3, 1e-9)] {
        let problem = LinearGaussian::new(4, 7, std, 3);
        let (mean, covariance) = problem.posterior(1.0);
        for rule in RULES {
            let mut ensemble = Normals::new(5).exact(4, 20, &[]);
            let alphas = run(&problem, &mut ensemble, rule, 50);
            assert!(alphas.len() > 1 && alphas.len() < 50, "{rule:?}, std {std}: {alphas:?}");
            Schedule::from_alphas(&alphas).unwrap();
            let (found_mean, found_covariance) = moments(&ensemble);
            let errors = (
                relative_difference(&found_mean, &mean),
                relative_difference(&found_covariance, &covariance),
            );
            // Ten and more steps at the small noise: a digit more is lost than with four.
            assert!(errors.0 < tolerance && errors.1 < tolerance, "{rule:?} {std}: {errors:?}");
        }
    }
}

#[test]
fn the_rules_are_their_formulas() {
    let noise = NoiseCovariance::diagonal(&[2.0, 0.5]).unwrap();
    let predicted = mat![[8.0, 12.0, 10.0], [3.0, 1.0, 2.5]];
    let propose =
        |rule| next_alpha(rule, predicted.as_ref(), &[0.0, 0.0], &noise, 0.0, 60).unwrap();
    // Half the squares of (4, 6), (6, 2), (5, 5).
    let phi = [26.0, 20.0, 25.0];
    let mean = phi.iter().sum::<f64>() / 3.0;
    let variance = phi.iter().map(|p| (p - mean) * (p - mean)).sum::<f64>() / 2.0;
    let wanted = (2.0 * mean / 2.0).min((2.0 * variance / 2.0_f64).sqrt());
    assert!((propose(AdaptiveRule::DataMisfit) - wanted).abs() < 1e-13 * wanted);
    let wanted = 0.25 * mean / 2.0;
    assert!((propose(AdaptiveRule::RestrictedStep) - wanted).abs() < 1e-13 * wanted);
}

#[test]
fn no_share_exceeds_what_is_left() {
    let noise = NoiseCovariance::diagonal(&[1.0]).unwrap();
    for rule in RULES {
        // Data met exactly: an infinite share is proposed.
        let alpha = next_alpha(rule, mat![[0.0, 0.0]].as_ref(), &[0.0], &noise, 0.75, 5).unwrap();
        assert_eq!(alpha, 4.0);
    }
}

#[test]
fn a_model_that_cannot_explain_its_data_still_ends_in_time() {
    let noise = NoiseCovariance::diagonal(&[1e-3]).unwrap();
    let predicted = mat![[10.0, 11.0, 12.0]];
    for rule in RULES {
        for max_steps in [1, 3, 20] {
            let (mut alphas, mut sum) = (Vec::new(), 0.0);
            for left in (1..=max_steps).rev() {
                let alpha =
                    next_alpha(rule, predicted.as_ref(), &[0.0], &noise, sum, left).unwrap();
                alphas.push(alpha);
                sum += 1.0 / alpha;
            }
            assert!(Schedule::from_alphas(&alphas).is_ok(), "{rule:?} {max_steps}: {alphas:?}");
            assert_eq!(alphas.len(), max_steps);
        }
    }
}

#[test]
fn wrong_arguments_are_refused_by_name() {
    let case = Case::new(3, 4, 10, 0.3, 5);
    let call = |y: &Mat<f64>, d: &[f64], sum, left| {
        next_alpha(AdaptiveRule::DataMisfit, y.as_ref(), d, &case.noise(), sum, left)
            .unwrap_err()
            .to_string()
    };
    let (y, d) = (&case.predicted, &case.observed);
    for sum in [1.0, -0.1, f64::NAN] {
        assert!(call(y, d, sum, 3).contains("add up to 1"), "{sum}");
    }
    assert!(call(y, d, 0.0, 0).contains("at least one step"));
    assert!(call(y, &d[1..], 0.0, 3).contains("`observed` must have shape"));
    assert!(call(&Mat::zeros(4, 1), d, 0.0, 3).contains("at least 2 ensemble members"));
    assert!(call(&Mat::zeros(0, 9), &[], 0.0, 3).contains("at least one observation"));
    let mut broken = y.clone();
    broken[(2, 1)] = f64::NAN;
    assert!(call(&broken, d, 0.0, 3).contains("`predicted` must be finite, got NaN at row 2"));
    assert!(call(y, &[f64::NAN; 4], 0.0, 3).contains("`observed` must be finite"));
    broken[(2, 1)] = 1e200;
    assert_eq!(
        next_alpha(AdaptiveRule::DataMisfit, broken.as_ref(), d, &case.noise(), 0.0, 3),
        Err(EsmdaError::Overflow)
    );
}

#[test]
fn the_largest_change_counts_in_deviations() {
    let (before, after) = (mat![[0.0, 1.0], [0.0, 0.0]], mat![[0.5, 1.0], [0.0, -30.0]]);
    assert_eq!(largest_change(before.as_ref(), after.as_ref(), &[0.1, 10.0]), Ok(5.0));
    let error = largest_change(before.as_ref(), after.as_ref(), &[1.0, 0.0]).unwrap_err();
    assert!(error.to_string().contains("got 0 at row 1"));
    let error = largest_change(before.as_ref(), after.as_ref(), &[1.0]).unwrap_err();
    assert!(error.to_string().contains("`before` must have shape (1, 2), got (2, 2)"));
}
