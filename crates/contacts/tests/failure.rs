//! Failure: every error by its cause, with its numbers; nothing panics.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, Numbers};
use faer::{Mat, Par};
use tissuereg_contacts::{ChainSettings, Configuration, Contact, ContactsError};

/// The error of a case after a change.
fn error(change: impl FnOnce(&mut Case)) -> ContactsError {
    let mut case = Case::tiny(1);
    change(&mut case);
    case.try_problem().expect_err("this must be refused")
}

/// The error of a run with changed settings, uniforms and starts.
fn error_of_run(
    change: impl FnOnce(&mut ChainSettings, &mut Mat<f64>, &mut Vec<Configuration>),
) -> ContactsError {
    let problem = Case::tiny(1).problem();
    let mut settings = ChainSettings::default();
    let mut uniforms = Numbers::new(1).uniforms(2, problem.n_uniforms(&settings));
    let mut starts = vec![Configuration::empty(&problem)];
    change(&mut settings, &mut uniforms, &mut starts);
    problem.run(&settings, uniforms.as_ref(), &starts, Par::Seq).expect_err("must be refused")
}

fn shape(argument: &'static str, wanted: usize, found: usize) -> ContactsError {
    ContactsError::Shape { argument, wanted, found }
}

fn is_range(error: &ContactsError, name: &str, place: usize) -> bool {
    matches!(error, ContactsError::Range { argument, entry, .. } if *argument == name && *entry == place)
}

fn is_not_finite(error: &ContactsError, name: &str, place: usize) -> bool {
    matches!(error, ContactsError::NotFinite { argument, entry, .. } if *argument == name && *entry == place)
}

#[test]
fn arrays_that_do_not_fit_are_refused() {
    assert_eq!(error(|c| c.columns = Mat::zeros(5, 11)), shape("columns", 12, 11));
    assert_eq!(error(|c| c.observed.innovation.truncate(4)), shape("innovation", 5, 4));
    assert_eq!(error(|c| c.observed.noise = Mat::identity(4, 4)), shape("noise", 5, 4));
    assert_eq!(error(|c| c.observed.noise = Mat::identity(5, 6)), shape("noise", 5, 6));
    assert_eq!(error(|c| c.prior.log_filled.truncate(7)), shape("log_filled", 8, 7));
    let family =
        |change: fn(&mut tissuereg_contacts::Family)| error(|c| change(&mut c.prior.families[0]));
    assert_eq!(family(|f| f.variances.truncate(12)), shape("variances of a family", 13, 12));
    assert_eq!(family(|f| f.log_prior.truncate(1)), shape("log_prior", 2, 1));
}

#[test]
fn empty_lists_are_refused() {
    let none = error(|c| (c.prior.variances, c.prior.log_filled) = (Vec::new(), Vec::new()));
    assert_eq!(none, shape("variances", 1, 0));
    let none = error(|c| {
        (c.prior.families[0].factors, c.prior.families[0].log_prior) = (Vec::new(), Vec::new())
    });
    assert_eq!(none, shape("factors", 1, 0));
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    assert!(is_not_finite(&error(|c| c.columns[(3, 2)] = f64::NAN), "columns", 13));
    assert!(is_not_finite(&error(|c| c.observed.innovation[1] = f64::INFINITY), "innovation", 1));
    assert!(is_not_finite(&error(|c| c.observed.noise[(2, 1)] = f64::NAN), "noise", 7));
    assert!(is_not_finite(&error(|c| c.prior.log_filled[6] = f64::NAN), "log_filled", 6));
    assert!(is_not_finite(&error(|c| c.prior.log_filled[2] = f64::INFINITY), "log_filled", 2));
    assert!(is_not_finite(&error(|c| c.prior.log_empty = f64::NEG_INFINITY), "log_empty", 0));
    assert!(is_not_finite(&error(|c| c.prior.families[0].log_prior[1] = f64::NAN), "log_prior", 1));
    assert!(is_not_finite(&error(|c| c.prior.wrong.log_odds = f64::NAN), "log_odds", 0));
    assert!(is_not_finite(&error(|c| c.patches[3].texture[1].1 = f64::NAN), "texture", 1));
}

#[test]
fn numbers_out_of_range_are_refused() {
    assert!(is_range(&error(|c| c.prior.variances[1] = 0.0), "variances", 1));
    assert!(is_range(&error(|c| c.prior.families[0].factors[0] = -1.0), "factors", 0));
    assert!(is_range(
        &error(|c| c.prior.families[0].variances[4] = -1.0),
        "variances of a family",
        4
    ));
    assert!(is_range(&error(|c| c.prior.wrong.variance = 0.0), "variance of a wrong group", 0));
    let impossible = error(|c| c.prior.families[0].log_prior = vec![f64::NEG_INFINITY; 2]);
    assert!(is_range(&impossible, "log_prior", 0), "{impossible}");
}

#[test]
fn indices_out_of_range_are_refused() {
    let index =
        |argument, patch, index, limit| ContactsError::Index { argument, patch, index, limit };
    assert_eq!(error(|c| c.patches[1].neighbours.push(4)), index("neighbours", 1, 4, 4));
    assert_eq!(
        error(|c| c.patches[2].texture.push((usize::MAX, 0.5))),
        index("texture", 2, usize::MAX, 4)
    );
    assert_eq!(error(|c| c.prior.wrong.rows[0].push(5)), index("rows", 2, 5, 5));
    let slot = |patch, size| {
        error_of_run(|_, _, starts| starts[0].slots[0] = Some(Contact { patch, size }))
    };
    assert_eq!(slot(4, 0), index("slots", 0, 4, 4));
    assert_eq!(slot(0, 2), index("sizes", 0, 2, 2));
    assert_eq!(error_of_run(|_, _, starts| starts[0].levels[0] = 2), index("levels", 0, 2, 2));
}

#[test]
fn noise_that_is_no_covariance_is_refused_with_its_pivot() {
    let found = error(|c| c.observed.noise[(3, 3)] = -1.0);
    assert_eq!(found, ContactsError::NotPositiveDefinite { pivot: 3 });
    assert!(found.to_string().contains("pivot 3"), "{found}");
}

#[test]
fn a_covariance_that_overflows_is_refused() {
    let mut case = Case::tiny(1);
    case.prior.variances = vec![f64::MAX, f64::MAX];
    let problem = case.problem();
    let mut start = Configuration::empty(&problem);
    start.slots[0] = Some(Contact { patch: 0, size: 0 });
    let settings = ChainSettings::default();
    let uniforms = Numbers::new(1).uniforms(1, problem.n_uniforms(&settings));
    let found = problem.run(&settings, uniforms.as_ref(), &[start.clone()], Par::Seq);
    assert!(matches!(found, Err(ContactsError::NotPositiveDefinite { .. })), "{found:?}");
    // From an empty slot the chain only never goes there.
    let found = problem.run(&settings, uniforms.as_ref(), &[], Par::Seq).unwrap();
    assert!(found.samples.iter().all(|s| s.configuration.slots[0].is_none()));
    let found = problem.moments(&[start], Mat::zeros(0, 13).as_ref(), Par::Seq);
    assert!(matches!(found, Err(ContactsError::NotPositiveDefinite { .. })), "{found:?}");
}

#[test]
fn settings_uniforms_and_starts_are_checked() {
    assert_eq!(error_of_run(|s, _, _| s.n_kept = 0), shape("powers", 1, 9));
    assert_eq!(error_of_run(|s, _, _| s.n_kept = 10), shape("powers", 10, 9));
    assert!(is_range(&error_of_run(|s, _, _| s.powers[8] = 0.5), "powers", 8));
    assert!(is_range(&error_of_run(|s, _, _| s.powers[0] = 0.0), "powers", 0));
    assert!(is_range(&error_of_run(|s, _, _| s.sharpness = 0.0), "sharpness", 0));
    assert!(is_range(&error_of_run(|_, u, _| u[(0, 5)] = 1.0), "uniforms", 5));
    assert!(is_not_finite(&error_of_run(|_, u, _| u[(0, 4)] = f64::NAN), "uniforms", 4));
    let n = Case::tiny(1).problem().n_uniforms(&ChainSettings::default());
    assert_eq!(error_of_run(|_, u, _| *u = Mat::zeros(1, n + 1)), shape("uniforms", n, n + 1));
    assert_eq!(error_of_run(|_, _, starts| starts[0].slots.push(None)), shape("slots", 1, 2));
    assert_eq!(error_of_run(|_, _, starts| starts[0].levels.clear()), shape("levels", 1, 0));
    assert_eq!(error_of_run(|_, _, starts| starts[0].wrong.clear()), shape("wrong", 1, 0));
}

#[test]
fn a_start_that_cannot_be_is_refused() {
    let mut case = Case::tiny(1);
    case.prior.log_filled[0] = f64::NEG_INFINITY;
    let problem = case.problem();
    let mut start = Configuration::empty(&problem);
    start.slots[0] = Some(Contact { patch: 0, size: 0 });
    let settings = ChainSettings::default();
    let uniforms = Numbers::new(1).uniforms(1, problem.n_uniforms(&settings));
    let found = problem.run(&settings, uniforms.as_ref(), &[start], Par::Seq).unwrap_err();
    assert!(is_range(&found, "prior probability of a start", 0), "{found}");
    // What cannot be is never visited either.
    let uniforms = Numbers::new(1).uniforms(50, problem.n_uniforms(&settings));
    let run = problem.run(&settings, uniforms.as_ref(), &[], Par::Seq).unwrap();
    let impossible = Some(Contact { patch: 0, size: 0 });
    assert!(run.samples.iter().all(|s| s.configuration.slots[0] != impossible));
}

#[test]
fn moments_and_draws_check_what_they_are_given() {
    let problem = Case::tiny(1).problem();
    let samples = [Configuration::empty(&problem)];
    let moments = |samples: &[Configuration], points: Mat<f64>| {
        problem.moments(samples, points.as_ref(), Par::Seq).unwrap_err()
    };
    assert_eq!(moments(&[], Mat::zeros(3, 13)), shape("samples", 1, 0));
    assert_eq!(moments(&samples, Mat::zeros(3, 12)), shape("points", 13, 12));
    assert_eq!(moments(&samples, Mat::zeros(4, 13)), shape("points", 3, 4));
    let nan = Mat::from_fn(3, 13, |i, j| if (i, j) == (1, 2) { f64::NAN } else { 0.0 });
    assert!(is_not_finite(&moments(&samples, nan), "points", 7));
    let draws = |samples: &[Configuration], normals: Mat<f64>| {
        problem.draws(samples, normals.as_ref(), Par::Seq).unwrap_err()
    };
    assert_eq!(draws(&[], Mat::zeros(18, 1)), shape("samples", 1, 0));
    assert_eq!(draws(&samples, Mat::zeros(17, 1)), shape("normals", 18, 17));
    let nan = Mat::from_fn(18, 2, |i, j| if (i, j) == (0, 1) { f64::NAN } else { 0.0 });
    assert!(is_not_finite(&draws(&samples, nan), "normals", 18));
    let mut bad = samples[0].clone();
    bad.levels[0] = 7;
    assert!(matches!(draws(&[bad.clone()], Mat::zeros(18, 1)), ContactsError::Index { .. }));
    assert!(matches!(moments(&[bad], Mat::zeros(3, 13)), ContactsError::Index { .. }));
}

#[test]
fn a_problem_without_patches_slots_or_families_runs() {
    let mut case = Case::tiny(1);
    case.patches.clear();
    case.prior.log_filled.clear();
    case.prior.families.clear();
    case.prior.wrong.rows.clear();
    for n_slots in [0, 2] {
        case.prior.n_slots = n_slots;
        let found = common::run(&case.problem(), &ChainSettings::default(), 2, Par::Seq);
        assert!(found.samples.iter().all(|s| s.configuration.slots == vec![None; n_slots]));
    }
}

#[test]
fn messages_say_what_must_hold_and_what_was_found() {
    let found = error(|c| c.prior.variances[1] = -2.0).to_string();
    assert_eq!(found, "`variances` must be finite and positive, got -2 at entry 1");
    let found = error(|c| c.patches[1].neighbours.push(9)).to_string();
    assert_eq!(found, "`neighbours` must be below 4, got 9 in patch 1");
    let found = error(|c| c.observed.innovation.truncate(4)).to_string();
    assert_eq!(found, "`innovation` must have 5 entries along its free axis, got 4");
    let found = error(|c| c.observed.innovation[1] = f64::NAN).to_string();
    assert_eq!(found, "`innovation` must be finite, got NaN at entry 1");
}
