//! Failure: every error, raised once, with its message.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::Case;
use faer::{Mat, mat};
use tissuereg_esmda::{
    EsmdaError, NoiseCovariance, Reason, Schedule, Step, StepSettings, screen_members,
};

#[track_caller]
fn refuses<T: std::fmt::Debug>(result: Result<T, EsmdaError>, message: &str) -> EsmdaError {
    let error = result.expect_err("must be refused");
    assert!(error.to_string().contains(message), "`{error}` does not contain `{message}`");
    error
}

#[test]
fn schedules_are_checked() {
    let below = f64::MIN_POSITIVE / 8.0;
    refuses(Schedule::constant(0), "at least one step, got none");
    refuses(Schedule::from_alphas(&[]), "at least one step");
    refuses(Schedule::from_alphas(&[2.0, -2.0]), "positive and finite, got -2 at step 1");
    refuses(Schedule::from_alphas(&[f64::NAN]), "got NaN at step 0");
    refuses(Schedule::from_alphas(&[f64::INFINITY]), "got inf at step 0");
    refuses(Schedule::from_alphas(&[below]), "positive and finite");
    refuses(Schedule::from_alphas(&[4.0, 2.0, 1.0]), "add up to 1 within 1e-9, got 1.75");
    refuses(Schedule::from_alphas(&[2.0, 2.0 + 1e-8]), "add up to 1");
    refuses(Schedule::with_total(&[2.0, 2.0], f64::NAN), "add up to NaN");
    for decrease in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e200] {
        refuses(Schedule::geometric(4, decrease), "decrease of a geometric schedule");
    }
    assert!(Schedule::from_alphas(&[2.0, 2.0 + 1e-10]).is_ok(), "nine digits are enough");
}

#[test]
fn one_step_too_many_is_refused() {
    let schedule = Schedule::geometric(3, 2.0).unwrap();
    assert_eq!(schedule.alpha(2), Ok(1.75));
    refuses(schedule.alpha(3), "step 3 was requested, but the schedule has 3 steps");
}

#[test]
fn noise_is_checked() {
    refuses(NoiseCovariance::diagonal(&[0.1, 0.0]), "got 0 at observation 1");
    refuses(NoiseCovariance::diagonal(&[f64::NAN]), "got NaN at observation 0");
    refuses(
        NoiseCovariance::dense(Mat::zeros(2, 3).as_ref()),
        "`covariance` must have shape (2, 2), got (2, 3)",
    );
    let nan = mat![[1.0, f64::NAN], [0.0, 1.0]];
    refuses(NoiseCovariance::dense(nan.as_ref()), "finite, got NaN at row 0, column 1");
    let lopsided = mat![[1.0, 0.5], [0.4, 1.0]];
    refuses(
        NoiseCovariance::dense(lopsided.as_ref()),
        "symmetric, got 0.5 at row 0, column 1 and 0.4",
    );
    let indefinite = mat![[1.0, 2.0], [2.0, 1.0]];
    let error = refuses(NoiseCovariance::dense(indefinite.as_ref()), "fails at pivot 1");
    assert!(!error.is_recoverable());
}

/// A good case with one thing changed.
fn with(change: impl FnOnce(&mut Case)) -> Result<Step, EsmdaError> {
    let mut case = Case::new(3, 4, 10, 0.3, 5);
    change(&mut case);
    case.step(2.0, &StepSettings::default())
}

#[test]
fn a_step_is_refused_for_bad_numbers_by_place() {
    let error = refuses(
        with(|c| c.predicted[(1, 3)] = f64::NAN),
        "`predicted` must be finite, got NaN at row 1, column 3",
    );
    assert!(error.is_recoverable());
    refuses(
        with(|c| c.predicted[(0, 9)] = f64::INFINITY),
        "`predicted` must be finite, got inf at row 0, column 9",
    );
    let error =
        refuses(with(|c| c.predicted[(2, 1)] = -1e19), "within 1e12 in absolute value, got -1e19");
    assert!(error.is_recoverable());
    refuses(with(|c| c.observed[2] = f64::NAN), "`observed` must be finite, got NaN at row 2");
    refuses(with(|c| c.draws[(0, 0)] = f64::NAN), "`draws` must be finite");
    let error = refuses(with(|c| c.std = vec![1e-310; 4]), "leave the range of f64");
    assert!(error.is_recoverable());
}

#[test]
fn a_prediction_is_refused_from_just_beyond_the_limit_on() {
    let limit = StepSettings::default().largest;
    assert!(with(|c| c.predicted[(2, 9)] = -limit).is_ok());
    refuses(
        with(|c| c.predicted[(2, 9)] = -1.01 * limit),
        "must stay within 1e12 in absolute value, got -1.01e12 at observation 2, member 9",
    );
}

#[test]
fn a_step_is_refused_for_wrong_shapes_by_name() {
    refuses(with(|c| c.observed.truncate(3)), "`observed` must have shape (4, 1), got (3, 1)");
    refuses(with(|c| c.std.truncate(3)), "`noise` must have shape (4, 1), got (3, 1)");
    refuses(with(|c| c.draws = Mat::zeros(4, 9)), "`draws` must have shape (4, 10), got (4, 9)");
    let nothing =
        |c: &mut Case| (c.predicted, c.observed, c.std) = (Mat::zeros(0, 10), vec![], vec![]);
    refuses(with(nothing), "at least one observation");
    let one_member = |c: &mut Case| c.predicted = Mat::zeros(4, 1);
    refuses(with(one_member), "at least 2 ensemble members must be left, got 1");
    for alpha in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        refuses(Case::surgical().step(alpha, &StepSettings::default()), "positive and finite");
    }
}

#[test]
fn the_square_root_form_is_refused_for_the_same_reasons() {
    let mut case = Case::new(3, 4, 10, 0.3, 5);
    case.predicted[(1, 3)] = 1e19;
    let (y, d, noise) = (case.predicted.as_ref(), &case.observed, case.noise());
    let settings = StepSettings::default();
    refuses(Step::prepare_square_root(y, d, &noise, 1.0, &settings), "within 1e12");
    refuses(Step::prepare_square_root(y, d, &noise, 0.0, &settings), "positive and finite");
    refuses(
        Step::prepare_square_root(y, &d[1..], &noise, 1.0, &settings),
        "`observed` must have shape",
    );
}

#[test]
fn refused_parameters_stay_as_they_were() {
    let case = Case::new(3, 4, 10, 0.3, 5);
    let step = case.step(2.0, &StepSettings::default()).unwrap();
    let mut parameters = case.parameters.clone();
    parameters[(2, 9)] = f64::INFINITY;
    let before = parameters.clone();
    refuses(
        step.apply(parameters.as_mut()),
        "`parameters` must be finite, got inf at row 2, column 9",
    );
    assert_eq!(parameters, before);
    refuses(
        step.apply(Mat::zeros(3, 9).as_mut()),
        "`parameters` must have shape (3, 10), got (3, 9)",
    );
    assert!(step.apply(Mat::zeros(0, 10).as_mut()).is_ok(), "no rows, nothing to do");
}

#[test]
fn an_update_into_other_memory_is_refused_by_name_and_place() {
    let case = Case::new(70, 4, 10, 0.3, 5);
    let step = case.step(2.0, &StepSettings::default()).unwrap();
    let (mut good, mut narrow) = (Mat::zeros(70, 10), Mat::zeros(70, 9));
    let prior = &case.parameters;
    refuses(
        step.apply_to(prior.as_ref(), narrow.as_mut()),
        "`updated` must have shape (70, 10), got (70, 9)",
    );
    refuses(
        step.apply_to(prior.get(.., ..9), good.as_mut()),
        "`parameters` must have shape (70, 10), got (70, 9)",
    );
    let mut spoilt = prior.clone();
    spoilt[(66, 3)] = f64::NAN;
    refuses(
        step.apply_to(spoilt.as_ref(), good.as_mut()),
        "`parameters` must be finite, got NaN at row 66, column 3",
    );
}

#[test]
fn lost_members_are_dropped_with_their_reason_and_too_few_are_an_error() {
    let mut case = Case::new(3, 4, 6, 0.3, 5);
    case.predicted[(1, 0)] = f64::NAN;
    case.predicted[(2, 3)] = f64::NEG_INFINITY;
    case.predicted[(0, 5)] = 1e19;
    let screening = screen_members(case.predicted.as_ref(), 1e6);
    assert_eq!(screening.kept, [1, 2, 4]);
    let reasons: Vec<String> = screening.dropped.iter().map(|(m, r)| format!("{m}: {r}")).collect();
    assert_eq!(
        reasons,
        [
            "0: prediction 1 is not a number",
            "3: prediction 2 is infinite",
            "5: prediction 0 is 1e19, beyond 1e6"
        ]
    );
    assert!(screening.clone().at_least(3).is_ok());
    match refuses(screening.at_least(4), "at least 4 ensemble members must be left, got 3") {
        EsmdaError::TooFewMembers { dropped, .. } => {
            assert_eq!(dropped[0], (0, Reason::NotANumber { obs: 1 }));
        }
        other => panic!("{other:?}"),
    }
}
