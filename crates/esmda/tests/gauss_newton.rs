//! Gauss-Newton with a Laplace covariance. Exact: the linear case. Derivative and rate: differences and the last steps.
//! Invariance: affine changes of the parameters. Failure: every refusal.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{LinearGaussian, Normals, column, relative_difference};
use faer::{Mat, MatRef, mat};
use tissuereg_esmda::{EsmdaError, GaussNewton, Gaussian, NoiseCovariance, SearchSettings};

/// A model and its Jacobian.
type Model<'a> = dyn Fn(&[f64]) -> (Vec<f64>, Mat<f64>) + 'a;

fn standard(n: usize) -> Gaussian {
    Gaussian::new(&vec![0.0; n], Mat::<f64>::identity(n, n).as_ref()).unwrap()
}

/// Runs a search to its end; the points accepted and whether any was rejected.
fn run(search: &mut GaussNewton, model: &Model<'_>) -> Result<(Vec<Vec<f64>>, bool), EsmdaError> {
    let (mut accepted, mut rejected) = (Vec::new(), false);
    loop {
        let point = search.point().to_vec();
        let (predicted, jacobian) = model(&point);
        if search.evaluate(&predicted)?.accepted {
            accepted.push(point);
            if search.linearise(jacobian.as_ref())?.converged {
                return Ok((accepted, rejected));
            }
        } else {
            rejected = true;
        }
    }
}

fn values(matrix: &Mat<f64>) -> Vec<f64> {
    matrix.col(0).iter().copied().collect()
}

/// Three numbers that bend: `g_i = exp(a_i . z / 2) + (b_i . z)^2 / 10 + c_i . z`, six of them.
struct Bent {
    rows: [Mat<f64>; 3],
}

impl Bent {
    fn new() -> Self {
        let mut normals = Normals::new(21);
        Self { rows: [(); 3].map(|()| normals.matrix(6, 3)) }
    }

    fn at(&self, z: &[f64]) -> (Vec<f64>, Mat<f64>) {
        let [a, b, c] = self.rows.each_ref().map(|rows| values(&(rows * column(z))));
        let predicted = (0..6).map(|i| (0.5 * a[i]).exp() + 0.1 * b[i] * b[i] + c[i]).collect();
        let jacobian = Mat::from_fn(6, 3, |i, j| {
            0.5 * (0.5 * a[i]).exp() * self.rows[0][(i, j)]
                + 0.2 * b[i] * self.rows[1][(i, j)]
                + self.rows[2][(i, j)]
        });
        (predicted, jacobian)
    }

    fn search(&self, truth: &[f64], settings: SearchSettings) -> GaussNewton {
        let noise = NoiseCovariance::diagonal(&[0.2; 6]).unwrap();
        GaussNewton::new(standard(3), &self.at(truth).0, noise, settings).unwrap()
    }
}

#[test]
fn a_linear_model_gives_the_kalman_posterior_in_two_evaluations() {
    // As for the square-root form: the spread of the data over the noise costs digits.
    for (std, tolerance) in [(0.3, 1e-12), (1e-3, 1e-10)] {
        let problem = LinearGaussian::new(4, 7, std, 3);
        let (mean, covariance) = problem.posterior(1.0);
        let model =
            |z: &[f64]| (values(&(&problem.operator * column(z))), problem.operator.clone());
        let settings = SearchSettings::default();
        let mut search =
            GaussNewton::new(standard(4), &problem.observed, problem.noise(), settings).unwrap();
        run(&mut search, &model).unwrap();
        assert_eq!(search.evaluations(), 2);
        let found = search.posterior().unwrap();
        assert!(relative_difference(&column(found.mean()), &mean) < tolerance);
        assert!(relative_difference(&found.covariance(), &covariance) < tolerance);
        let root = search.predicted_root().unwrap();
        let predicted = &problem.operator * &covariance * problem.operator.transpose();
        assert!(relative_difference(&(&root * root.transpose()), &predicted) < tolerance);
    }
}

#[test]
fn the_posterior_stays_right_down_to_a_millionth_of_the_spread() {
    for std in [1e-2, 1e-3, 1e-4, 1e-5, 1e-6] {
        let problem = LinearGaussian::new(4, 7, std, 3);
        let (mean, covariance) = problem.posterior(1.0);
        let model =
            |z: &[f64]| (values(&(&problem.operator * column(z))), problem.operator.clone());
        let settings = SearchSettings::default();
        let mut search =
            GaussNewton::new(standard(4), &problem.observed, problem.noise(), settings).unwrap();
        run(&mut search, &model).unwrap();
        let found = search.posterior().unwrap();
        // Data rounded in the last bit move the mean by 1e-16 / std standard deviations; one digit more for the model.
        let allowed = 1e-14 / std;
        let off =
            (0..4).map(|i| (found.mean()[i] - mean[(i, 0)]).abs() / covariance[(i, i)].sqrt());
        let off = off.fold(0.0, f64::max);
        let spread = relative_difference(&found.covariance(), &covariance);
        assert!(off < allowed && spread < allowed, "std {std:e}: {off:e} {spread:e}");
    }
}

#[test]
fn correlated_noise_and_prior_give_the_kalman_posterior_too() {
    let noise = Mat::from_fn(7, 7, |i, j| 0.09 * 0.6_f64.powi((i as i32 - j as i32).abs()));
    let problem = LinearGaussian::with_covariance(4, noise, 8);
    let (mean, covariance) = problem.posterior(1.0);
    // z = m + M w, so that the posterior of z is that of w, mapped.
    let root = mat![
        [2.0, 0.0, 0.0, 0.0],
        [-1.0, 0.5, 0.0, 0.0],
        [0.3, 0.1, 1.0, 0.0],
        [0.0, 2.0, 0.4, 3.0]
    ];
    let inverse = root.as_ref().partial_piv_lu_inverse();
    let centre = [1.0, -2.0, 0.5, 10.0];
    let prior = Gaussian::new(&centre, (&root * root.transpose()).as_ref()).unwrap();
    let operator = &problem.operator * &inverse;
    let model = |z: &[f64]| {
        let away: Vec<f64> = z.iter().zip(centre).map(|(z, m)| z - m).collect();
        (values(&(&operator * column(&away))), operator.clone())
    };
    let settings = SearchSettings::default();
    let mut search = GaussNewton::new(prior, &problem.observed, problem.noise(), settings).unwrap();
    run(&mut search, &model).unwrap();
    let found = search.posterior().unwrap();
    let wanted = &root * mean + column(&centre);
    assert!(relative_difference(&column(found.mean()), &wanted) < 1e-12);
    let wanted = &root * covariance * root.transpose();
    assert!(relative_difference(&found.covariance(), &wanted) < 1e-12);
}

trait Inverse {
    fn partial_piv_lu_inverse(&self) -> Mat<f64>;
}

impl Inverse for MatRef<'_, f64> {
    fn partial_piv_lu_inverse(&self) -> Mat<f64> {
        use faer::linalg::solvers::DenseSolveCore;
        self.partial_piv_lu().inverse()
    }
}

#[test]
fn fewer_observations_than_parameters_leave_the_prior_where_nothing_was_seen() {
    let noise = NoiseCovariance::diagonal(&[1.0]).unwrap();
    let mut search =
        GaussNewton::new(standard(3), &[2.0], noise, SearchSettings::default()).unwrap();
    let model = |z: &[f64]| (vec![z[0]], mat![[1.0, 0.0, 0.0]]);
    run(&mut search, &model).unwrap();
    let found = search.posterior().unwrap();
    let wanted = mat![[0.5, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    // Rounding of numbers near one.
    assert!((found.covariance() - wanted).norm_max() < 1e-14);
    assert!((column(found.mean()) - column(&[1.0, 0.0, 0.0])).norm_max() < 1e-14);
}

#[test]
fn differences_approach_the_jacobian_with_the_square_of_their_distance() {
    let model = Bent::new();
    let start = [0.3, -0.2, 0.5];
    let root_at = |difference: Option<f64>| {
        let settings = SearchSettings::default().with_difference(difference.unwrap_or(1.0));
        let mut search = model.search(&[1.0, 0.5, -0.5], settings).starting_at(&start).unwrap();
        let (predicted, jacobian) = model.at(&start);
        search.evaluate(&predicted).unwrap();
        if difference.is_some() {
            let stencil = search.stencil();
            let columns: Vec<Vec<f64>> = stencil
                .col_iter()
                .map(|z| model.at(&z.iter().copied().collect::<Vec<_>>()).0)
                .collect();
            let predicted = Mat::from_fn(6, 7, |obs, column| columns[column][obs]);
            search.linearise_by_differences(predicted.as_ref()).unwrap();
        } else {
            search.linearise(jacobian.as_ref()).unwrap();
        }
        let root = search.predicted_root().unwrap();
        &root * root.transpose()
    };
    let exact = root_at(None);
    let error = |h: f64| relative_difference(&root_at(Some(h)), &exact);
    let (wide, narrow) = (error(1e-2), error(5e-3));
    // The next term is of relative order h^2.
    assert!((wide / narrow - 4.0).abs() < 1e-2, "{wide:e} {narrow:e}");
    assert!(error(1e-4) < 1e-8, "{:e}", error(1e-4));
}

#[test]
fn near_a_solution_without_residual_each_step_squares_the_error() {
    // With d = g(m) the minimum is the prior's mean, where residual and prior term are zero.
    let model = Bent::new();
    let settings = SearchSettings::default().with_tolerance(1e-13);
    let mut search = model.search(&[0.0; 3], settings).starting_at(&[0.3, 0.2, -0.3]).unwrap();
    let (points, rejected) = run(&mut search, &|z| model.at(z)).unwrap();
    assert!(!rejected);
    let errors: Vec<f64> = points.iter().map(|z| column(z).norm_l2()).collect();
    let constants: Vec<f64> = errors
        .windows(2)
        .filter(|pair| pair[0] < 0.1 && pair[1] > 1e-13)
        .map(|pair| pair[1] / (pair[0] * pair[0]))
        .collect();
    assert!(constants.len() >= 2, "{errors:?}");
    // |g''| |g'|^-1 / 2 is of order one here; linear convergence would let these grow without bound.
    assert!(constants.iter().all(|&constant| constant < 2.0), "{errors:?} {constants:?}");
}

#[test]
fn a_start_from_which_plain_steps_diverge_converges_damped() {
    // The undamped iteration for the arctangent diverges beyond 1.39.
    let noise = NoiseCovariance::diagonal(&[1e-3]).unwrap();
    let prior = Gaussian::new(&[0.0], mat![[100.0]].as_ref()).unwrap();
    let search = GaussNewton::new(prior, &[0.5], noise, SearchSettings::default()).unwrap();
    let mut search = search.starting_at(&[20.0]).unwrap();
    let model = |z: &[f64]| (vec![z[0].atan()], mat![[1.0 / (1.0 + z[0] * z[0])]]);
    let (_, rejected) = run(&mut search, &model).unwrap();
    assert!(rejected, "the test must need the damping");
    // The default tolerance is a thousandth of the posterior deviation, which is 1e-3 (1 + z^2).
    let error = (search.posterior().unwrap().mean()[0] - 0.5_f64.tan()).abs();
    assert!(error < 1e-5, "{error:e}");
}

#[test]
fn steps_that_overshoot_by_less_than_the_rounding_of_the_misfit_are_damped_too() {
    // At the minimum, z = 0, the second derivative is 30 without and 60.6 with the curvature of the model times its
    // residual: a plain step goes from z to -1.02 z, and changes a misfit of 400 by a few thousandths.
    let noise = NoiseCovariance::diagonal(&[1.0, 1.0]).unwrap();
    let search = GaussNewton::new(standard(1), &[0.0, -20.0], noise, SearchSettings::default());
    let mut search = search.unwrap().starting_at(&[4e-3]).unwrap();
    let slope = 29.0_f64.sqrt();
    let model =
        |z: &[f64]| (vec![slope * z[0], 0.5 * 1.53 * z[0] * z[0]], mat![[slope], [1.53 * z[0]]]);
    let (points, _) = run(&mut search, &model).unwrap();
    // One step of 1.02 is needed to see it; undamped ones would go on to several times the distance.
    assert!(points.iter().all(|z| z[0].abs() < 4.2e-3), "{points:?}");
    // The tolerance is 1e-3 of the posterior's deviation, 30^-1/2, for a step of twice the distance.
    assert!(search.posterior().unwrap().mean()[0].abs() < 1e-3 / 30.0_f64.sqrt());
}

#[test]
fn an_affine_change_of_the_parameters_changes_nothing_else() {
    // Arctangents flatten out: plain steps from far away are much too long.
    let rows = Normals::new(21).matrix(6, 3);
    let model = |z: &[f64]| {
        let along = values(&(&rows * column(z)));
        let jacobian = Mat::from_fn(6, 3, |i, j| rows[(i, j)] / (1.0 + along[i] * along[i]));
        (along.iter().map(|a| a.atan()).collect::<Vec<f64>>(), jacobian)
    };
    let change = mat![[1e3, 0.0, 20.0], [-2.0, 1e-2, 0.0], [0.0, 0.5, 3.0]];
    let shift = [5.0, -1.0, 100.0];
    let inverse = change.as_ref().partial_piv_lu_inverse();
    let start = [2.0, -2.0, 2.0];
    let observed = model(&[1.0, 0.5, -0.5]).0;
    let noise = NoiseCovariance::diagonal(&[0.01; 6]).unwrap();
    let settings = SearchSettings::default().with_tolerance(1e-8);

    let search = GaussNewton::new(standard(3), &observed, noise.clone(), settings).unwrap();
    let mut plain = search.starting_at(&start).unwrap();
    let (points, rejected) = run(&mut plain, &model).unwrap();
    assert!(rejected, "the damping must be part of the test");

    let prior = Gaussian::new(&shift, (&change * change.transpose()).as_ref()).unwrap();
    let moved_start = values(&(&change * column(&start) + column(&shift)));
    let search = GaussNewton::new(prior, &observed, noise, settings).unwrap();
    let mut moved = search.starting_at(&moved_start).unwrap();
    let back = |z: &[f64]| values(&(&inverse * (column(z) - column(&shift))));
    let moved_model = |z: &[f64]| {
        let (predicted, jacobian) = model(&back(z));
        (predicted, jacobian * &inverse)
    };
    let (moved_points, _) = run(&mut moved, &moved_model).unwrap();
    assert_eq!(points.len(), moved_points.len());
    for (point, moved) in points.iter().zip(&moved_points) {
        // Rounding times the condition number of the change, 1e5, and what the steps make of it.
        assert!((column(&back(moved)) - column(point)).norm_max() < 1e-8);
    }
    let mapped = &change * plain.posterior().unwrap().covariance() * change.transpose();
    assert!(relative_difference(&moved.posterior().unwrap().covariance(), &mapped) < 1e-8);
}

#[test]
fn the_posterior_root_is_triangular_with_a_positive_diagonal() {
    let model = Bent::new();
    let mut search = model.search(&[1.0, 0.5, -0.5], SearchSettings::default());
    run(&mut search, &|z| model.at(z)).unwrap();
    let posterior = search.posterior().unwrap();
    let (root, covariance) = (posterior.root(), posterior.covariance());
    for row in 0..3 {
        assert!(root[(row, row)] > 0.0);
        assert!((row + 1..3).all(|column| root[(row, column)] == 0.0));
    }
    // Cholesky's root is the only such one.
    let again = Gaussian::new(posterior.mean(), covariance.as_ref()).unwrap();
    assert!(relative_difference(&again.root().to_owned(), &root.to_owned()) < 1e-12);
}

#[test]
fn a_point_where_the_model_fails_is_stepped_back_from() {
    // The logarithm has no value beyond a step that is too long.
    let noise = NoiseCovariance::diagonal(&[0.01]).unwrap();
    let prior = Gaussian::new(&[3.0], mat![[4.0]].as_ref()).unwrap();
    let settings = SearchSettings::default();
    let mut search = GaussNewton::new(prior, &[0.1_f64.ln()], noise, settings).unwrap();
    let mut failed = 0;
    loop {
        let z = search.point()[0];
        let evaluation = search.evaluate(&[z.ln()]).unwrap();
        assert_eq!(evaluation.failed, z.ln().is_nan());
        failed += usize::from(evaluation.failed);
        assert!(evaluation.accepted || evaluation.failed || evaluation.decrease < 0.0);
        if evaluation.accepted && search.linearise(mat![[1.0 / z]].as_ref()).unwrap().converged {
            break;
        }
    }
    assert!(failed > 0, "the test must meet a failure");
    assert!((search.posterior().unwrap().mean()[0] - 0.1).abs() < 1e-3);
}

#[test]
fn a_neighbour_that_failed_leaves_a_one_sided_derivative_and_is_named() {
    let noise = NoiseCovariance::diagonal(&[1.0, 1.0]).unwrap();
    let settings = SearchSettings::default().with_difference(0.5);
    let mut search = GaussNewton::new(standard(2), &[1.0, 1.0], noise, settings).unwrap();
    assert_eq!(search.stencil(), mat![[0.0, 0.5, -0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5, -0.5]]);
    search.evaluate(&[0.0, 0.0]).unwrap();
    let nan = f64::NAN;
    // Along the second direction, minus failed; the first prediction is twice, the second thrice the parameter.
    let predicted = mat![[0.0, 1.0, -1.0, 0.0, nan], [0.0, 0.0, 0.0, 1.5, nan]];
    let both = mat![[0.0, 1.0, -1.0, 1e19, nan], [0.0, 0.0, 0.0, 1.5, nan]];
    assert_eq!(
        search.clone().linearise_by_differences(both.as_ref()),
        Err(EsmdaError::NoDifference { direction: 1 })
    );
    let linearised = search.linearise_by_differences(predicted.as_ref()).unwrap();
    assert_eq!(linearised.one_sided, [1]);
    // Precision I + diag(4, 9).
    let wanted = mat![[0.2, 0.0], [0.0, 0.1]];
    assert!((search.posterior().unwrap().covariance() - wanted).norm_max() < 1e-14);
}

#[track_caller]
fn refuses<T: std::fmt::Debug>(result: Result<T, EsmdaError>, message: &str) -> EsmdaError {
    let error = result.expect_err("must be refused");
    assert!(error.to_string().contains(message), "`{error}` does not contain `{message}`");
    error
}

#[test]
fn a_prior_is_checked() {
    let identity = Mat::<f64>::identity(2, 2);
    refuses(Gaussian::new(&[0.0; 3], identity.as_ref()), "`covariance` must have shape (3, 3)");
    refuses(Gaussian::new(&[0.0, f64::NAN], identity.as_ref()), "`mean` must be finite, got NaN");
    let nan = mat![[1.0, f64::NAN], [0.0, 1.0]];
    refuses(
        Gaussian::new(&[0.0; 2], nan.as_ref()),
        "`covariance` must be finite, got NaN at row 0",
    );
    let lopsided = mat![[1.0, 0.5], [0.4, 1.0]];
    refuses(Gaussian::new(&[0.0; 2], lopsided.as_ref()), "symmetric, got 0.5 at row 0, column 1");
    let indefinite = mat![[1.0, 2.0], [2.0, 1.0]];
    let error = refuses(Gaussian::new(&[0.0; 2], indefinite.as_ref()), "fails at pivot 1");
    assert!(!error.is_recoverable());
    refuses(standard(2).at(identity.get(..1, ..)), "`normals` must have shape (2, 2)");
}

#[test]
fn a_search_is_checked_before_it_begins() {
    let noise = || NoiseCovariance::diagonal(&[1.0, 1.0]).unwrap();
    let with =
        |observed: &[f64], settings| GaussNewton::new(standard(1), observed, noise(), settings);
    let plain = SearchSettings::default();
    refuses(with(&[], plain), "at least one observation");
    refuses(with(&[1.0], plain), "`noise` must have shape (1, 1), got (2, 1)");
    refuses(with(&[1.0, f64::INFINITY], plain), "`observed` must be finite, got inf at row 1");
    for (settings, name) in [
        (plain.with_tolerance(0.0), "`tolerance` must be positive and finite, got 0"),
        (plain.with_difference(f64::NAN), "`difference` must be positive and finite, got NaN"),
        (plain.with_largest(-1.0), "`largest` must be positive and finite, got -1"),
        (plain.with_max_evaluations(0), "`max_evaluations` must be at least one, got 0"),
    ] {
        refuses(with(&[1.0, 1.0], settings), name);
    }
    let search = with(&[1.0, 1.0], plain).unwrap();
    refuses(search.clone().starting_at(&[1.0, 2.0]), "`start` must have shape (1, 1)");
    refuses(search.starting_at(&[f64::NAN]), "`start` must be finite");
}

#[test]
fn predictions_and_jacobians_are_checked_by_name() {
    let noise = NoiseCovariance::diagonal(&[1.0, 1.0]).unwrap();
    let settings = SearchSettings::default();
    let mut search = GaussNewton::new(standard(1), &[1.0, 1.0], noise, settings).unwrap();
    refuses(search.evaluate(&[1.0]), "`predicted` must have shape (2, 1)");
    let error = refuses(search.evaluate(&[0.0, f64::NAN]), "`predicted` must be finite, got NaN");
    assert!(error.is_recoverable());
    refuses(search.evaluate(&[0.0, -1e19]), "within 1e12 in absolute value, got -1e19");
    refuses(search.posterior(), "`posterior` needs a linearised point first");
    refuses(search.linearise(mat![[1.0], [1.0]].as_ref()), "`linearise` needs an accepted point");
    search.evaluate(&[0.0, 0.0]).unwrap();
    refuses(search.evaluate(&[0.0, 0.0]), "`evaluate` needs `linearise` of the accepted point");
    refuses(search.clone().starting_at(&[1.0]), "`starting_at` needs a search without evaluations");
    refuses(search.linearise(mat![[1.0, 1.0]].as_ref()), "`jacobian` must have shape (2, 1)");
    refuses(search.linearise(mat![[1.0], [f64::NAN]].as_ref()), "`jacobian` must be finite");
    refuses(
        search.linearise_by_differences(mat![[1.0, 1.0], [1.0, 1.0]].as_ref()),
        "`predicted` must have shape (2, 3)",
    );
    search.linearise(mat![[1.0], [1.0]].as_ref()).unwrap();
    refuses(search.linearise(mat![[1.0], [1.0]].as_ref()), "`linearise` needs an accepted point");

    let tiny = NoiseCovariance::diagonal(&[1e-310]).unwrap();
    let mut search = GaussNewton::new(standard(1), &[1.0], tiny, settings).unwrap();
    refuses(search.evaluate(&[0.0]), "leave the range of f64");
}

#[test]
fn a_search_that_finds_no_minimum_says_how_far_it_is() {
    // A Jacobian of the wrong sign: no step brings what it promises.
    let noise = NoiseCovariance::diagonal(&[0.1]).unwrap();
    let settings = SearchSettings::default().with_max_evaluations(7);
    let mut search = GaussNewton::new(standard(1), &[1.0], noise, settings).unwrap();
    let error = run(&mut search, &|z| (vec![z[0]], mat![[-1.0]])).unwrap_err();
    let EsmdaError::NoMinimum { evaluations, step, tolerance } = error else {
        panic!("{error}");
    };
    assert_eq!((evaluations, tolerance), (7, 1e-3));
    // s = -A b / (A^2 + 1) with A = -10 and b = 10; times sqrt(101).
    assert!((step - 100.0 / 101.0_f64.sqrt()).abs() < 1e-12);
    assert!(error.is_recoverable());
    // Too few evaluations for a model that is merely bent.
    let model = Bent::new();
    let settings = SearchSettings::default().with_max_evaluations(2);
    let mut search = model.search(&[1.0, 0.5, -0.5], settings);
    refuses(run(&mut search, &|z| model.at(z)), "no minimum was found in 2 evaluations");
}
