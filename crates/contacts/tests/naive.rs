//! Exact: chains, moments and draws beside a textbook that lists every configuration and writes its algebra plainly.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, Numbers};
use faer::{Mat, Par};
use tissuereg_contacts::{ChainSettings, Configuration, Contact, Problem};

type Plain = Vec<Vec<f64>>;

/// Every configuration of a case.
fn all_of(case: &Case) -> Vec<Configuration> {
    let n_sizes = case.prior.variances.len();
    let mut contents = vec![None];
    for patch in 0..case.patches.len() {
        contents.extend((0..n_sizes).map(|size| Some(Contact { patch, size })));
    }
    let mut slots: Vec<Vec<Option<Contact>>> = vec![Vec::new()];
    for _ in 0..case.prior.n_slots {
        let longer =
            slots.iter().flat_map(|s| contents.iter().map(|&c| [s.clone(), vec![c]].concat()));
        slots = longer.collect();
    }
    let mut all = Vec::new();
    for slots in slots {
        for (level, wrong) in [(0, false), (0, true), (1, false), (1, true)] {
            all.push(Configuration {
                slots: slots.clone(),
                levels: vec![level],
                wrong: vec![wrong],
            });
        }
    }
    all
}

/// Variance of every coefficient.
fn variances(case: &Case, one: &Configuration) -> Vec<f64> {
    let family = &case.prior.families[0];
    let mut all: Vec<f64> =
        family.variances.iter().map(|v| v * family.factors[one.levels[0]]).collect();
    for contact in one.slots.iter().flatten() {
        let own = case.prior.variances[contact.size];
        for axis in 0..3 {
            all[3 * contact.patch + axis] += own;
            for (inner, ratio) in &case.patches[contact.patch].texture {
                all[3 * inner + axis] += own * ratio * ratio;
            }
        }
    }
    all
}

/// Noise of the observations, that of wrong groups included.
fn noise(case: &Case, one: &Configuration) -> Plain {
    let n = case.columns.nrows();
    let mut all: Plain =
        (0..n).map(|i| (0..n).map(|j| case.observed.noise[(i, j)]).collect()).collect();
    for (rows, _) in case.prior.wrong.rows.iter().zip(&one.wrong).filter(|(_, w)| **w) {
        rows.iter().for_each(|&row| all[row][row] += case.prior.wrong.variance);
    }
    all
}

fn covariance(case: &Case, one: &Configuration) -> Plain {
    let (variances, mut all) = (variances(case, one), noise(case, one));
    for (i, row) in all.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            for (k, variance) in variances.iter().enumerate() {
                *entry += case.columns[(i, k)] * variance * case.columns[(j, k)];
            }
        }
    }
    all
}

/// Inverse and logarithm of the determinant by Gauss and Jordan.
fn inverse(mut a: Plain) -> (Plain, f64) {
    let (n, mut log) = (a.len(), 0.0);
    let mut out: Plain =
        (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
    for k in 0..n {
        let pivot = a[k][k];
        log += pivot.ln();
        for j in 0..n {
            a[k][j] /= pivot;
            out[k][j] /= pivot;
        }
        for i in (0..n).filter(|&i| i != k) {
            let factor = a[i][k];
            for j in 0..n {
                a[i][j] -= factor * a[k][j];
                out[i][j] -= factor * out[k][j];
            }
        }
    }
    (out, log)
}

fn log_evidence(case: &Case, one: &Configuration) -> f64 {
    let ((inverse, log), d) = (inverse(covariance(case, one)), &case.observed.innovation);
    let n = d.len();
    let square: f64 =
        (0..n).map(|i| (0..n).map(|j| d[i] * inverse[i][j] * d[j]).sum::<f64>()).sum();
    -0.5 * log - 0.5 * square
}

fn log_prior(case: &Case, one: &Configuration) -> f64 {
    let prior = &case.prior;
    let slots = one.slots.iter().map(|slot| match slot {
        None => prior.log_empty,
        Some(c) => prior.log_filled[c.patch * prior.variances.len() + c.size],
    });
    let wrong = if one.wrong[0] { prior.wrong.log_odds } else { 0.0 };
    slots.sum::<f64>() + prior.families[0].log_prior[one.levels[0]] + wrong
}

/// Total variation distance between long chains and the posterior, and its largest gap in one group of contents.
fn distance(case: &Case, settings: &ChainSettings) -> f64 {
    let all = all_of(case);
    let weights: Vec<f64> =
        all.iter().map(|one| (log_evidence(case, one) + log_prior(case, one)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let problem = case.problem();
    let uniforms = Numbers::new(9).uniforms(8, problem.n_uniforms(settings));
    let run = problem.run(settings, uniforms.as_ref(), &[], Par::Seq).unwrap();
    let share = 1.0 / run.samples.len() as f64;
    let mut count = vec![0.0; all.len()];
    for sample in &run.samples {
        let found = all.iter().position(|one| one == &sample.configuration).unwrap();
        count[found] += share;
    }
    0.5 * count.iter().zip(&weights).map(|(c, w)| (c - w / total).abs()).sum::<f64>()
}

fn long(n_sweeps: usize) -> ChainSettings {
    ChainSettings { powers: vec![1.0; n_sweeps + 20], n_kept: n_sweeps, ..ChainSettings::default() }
}

#[test]
fn long_chains_visit_configurations_as_often_as_the_posterior_says() {
    // 60,000 nearly independent visits of 36 configurations: a distance of 0.01 by chance.
    let found = distance(&Case::tiny(1), &long(8_000));
    assert!(found < 0.015, "{found}");
    // 324 configurations of two slots.
    let found = distance(&Case::tiny(2), &long(8_000));
    assert!(found < 0.03, "{found}");
}

#[test]
fn every_move_alone_is_reversible() {
    // Jumps from the flattest and the sharpest table, without steps; then hardly anything but steps.
    for (sharpness, n_local, limit) in [(0.01, 0, 0.03), (1.0, 0, 0.03), (0.001, 20, 0.03)] {
        let settings = ChainSettings { sharpness, n_local, ..long(6_000) };
        let found = distance(&Case::tiny(1), &settings);
        assert!(found < limit, "sharpness {sharpness}, {n_local} steps: {found}");
    }
}

#[test]
fn a_neighbour_without_a_way_back_is_never_stepped_to() {
    let mut case = Case::tiny(1);
    case.patches[0].neighbours = vec![1, 2, 2, 3];
    case.patches[2].neighbours = vec![0];
    case.patches[3].neighbours = Vec::new();
    let settings = ChainSettings { sharpness: 0.001, n_local: 20, ..long(6_000) };
    let found = distance(&case, &settings);
    assert!(found < 0.03, "{found}");
}

#[test]
fn groups_of_more_rows_than_the_closed_form_takes_are_turned_as_well() {
    let mut case = Case::tiny(1);
    for rows in [vec![0, 1, 2, 3], vec![4], vec![]] {
        case.prior.wrong.rows = vec![rows];
        let found = distance(&case, &long(4_000));
        assert!(found < 0.02, "{found}");
    }
}

#[test]
fn scores_of_samples_are_the_textbooks() {
    let case = Case::tiny(2);
    let settings = long(50);
    let problem = case.problem();
    let uniforms = Numbers::new(2).uniforms(4, problem.n_uniforms(&settings));
    for sample in problem.run(&settings, uniforms.as_ref(), &[], Par::Seq).unwrap().samples {
        let one = &sample.configuration;
        assert!((sample.log_evidence - log_evidence(&case, one)).abs() < 1e-10);
        assert!((sample.log_prior - log_prior(&case, one)).abs() < 1e-12);
    }
}

/// Gain `D J' C^-1` and covariance `D - D J' C^-1 J D` of one configuration's coefficients.
fn closed_form(case: &Case, one: &Configuration) -> (Plain, Plain) {
    let (d, (inverse, _)) = (variances(case, one), inverse(covariance(case, one)));
    let (n, m) = case.columns.shape();
    let gain: Plain = (0..m)
        .map(|k| {
            let along =
                |j: usize| (0..n).map(|i| case.columns[(i, k)] * inverse[i][j]).sum::<f64>();
            (0..n).map(|j| d[k] * along(j)).collect()
        })
        .collect();
    let covariance = (0..m)
        .map(|k| {
            let taken =
                |l: usize| (0..n).map(|j| gain[k][j] * case.columns[(j, l)]).sum::<f64>() * d[l];
            (0..m).map(|l| if k == l { d[k] } else { 0.0 } - taken(l)).collect()
        })
        .collect();
    (gain, covariance)
}

/// A few configurations that differ in everything.
fn samples(case: &Case) -> Vec<Configuration> {
    all_of(case).into_iter().step_by(23).collect()
}

#[test]
fn moments_are_the_closed_form_of_the_mixture() {
    let case = Case::tiny(2);
    let (samples, points) = (samples(&case), Numbers::new(8).normals(6, 13));
    let found = case.problem().moments(&samples, points.as_ref(), Par::Seq).unwrap();
    let share = 1.0 / samples.len() as f64;
    let each: Vec<(Plain, Plain)> = samples.iter().map(|one| closed_form(&case, one)).collect();
    let d = &case.observed.innovation;
    let mean_of = |gain: &Plain, k: usize| (0..5).map(|j| gain[k][j] * d[j]).sum::<f64>();
    let place_of = |gain: &Plain, row: usize| {
        (0..13).map(|k| points[(row, k)] * mean_of(gain, k)).sum::<f64>()
    };
    for k in 0..13 {
        let wanted: f64 = each.iter().map(|(gain, _)| share * mean_of(gain, k)).sum();
        assert!((found.coefficients[k] - wanted).abs() < 1e-10);
        for j in 0..5 {
            let wanted: f64 = each.iter().map(|(gain, _)| share * gain[k][j]).sum();
            assert!((found.gain[(k, j)] - wanted).abs() < 1e-10);
        }
    }
    for (a, b) in (0..6).flat_map(|a| (0..3).map(move |b| (a, 3 * (a / 3) + b))) {
        let mean =
            |row: usize| each.iter().map(|(gain, _)| share * place_of(gain, row)).sum::<f64>();
        let mut wanted = 0.0;
        let mut prior = 0.0;
        for (one, (gain, covariance)) in samples.iter().zip(&each) {
            let within = (0..13).map(|k| {
                (0..13).map(|l| points[(a, k)] * covariance[k][l] * points[(b, l)]).sum::<f64>()
            });
            wanted += share * within.sum::<f64>();
            wanted += share * (place_of(gain, a) - mean(a)) * (place_of(gain, b) - mean(b));
            let before = variances(&case, one);
            prior +=
                share * (0..13).map(|k| points[(a, k)] * before[k] * points[(b, k)]).sum::<f64>();
        }
        assert!((found.means[a / 3][a % 3] - mean(a)).abs() < 1e-10);
        assert!((found.covariances[a / 3][a % 3][b % 3] - wanted).abs() < 1e-10);
        assert!((found.prior_covariances[a / 3][a % 3][b % 3] - prior).abs() < 1e-10);
    }
}

#[test]
fn draws_have_the_mean_and_the_covariance_of_the_closed_form() {
    let case = Case::tiny(2);
    let problem: Problem = case.problem();
    let n = 40_000;
    let normals = Numbers::new(4).normals(18, n);
    for one in [&samples(&case)[3], &samples(&case)[9]] {
        let drawn = problem.draws(std::slice::from_ref(one), normals.as_ref(), Par::Seq).unwrap();
        let (gain, covariance) = closed_form(&case, one);
        let mean: Vec<f64> =
            (0..13).map(|k| (0..n).map(|i| drawn[(k, i)]).sum::<f64>() / n as f64).collect();
        for k in 0..13 {
            let wanted: f64 = (0..5).map(|j| gain[k][j] * case.observed.innovation[j]).sum();
            // Five standard errors.
            assert!((mean[k] - wanted).abs() < 5.0 * (covariance[k][k] / n as f64).sqrt() + 1e-12);
            for l in 0..=k {
                let found: f64 =
                    (0..n).map(|i| (drawn[(k, i)] - mean[k]) * (drawn[(l, i)] - mean[l])).sum();
                let size =
                    (covariance[k][k] * covariance[l][l] + covariance[k][l].powi(2)) / n as f64;
                let error = (found / n as f64 - covariance[k][l]).abs();
                assert!(error < 5.0 * size.sqrt() + 1e-12, "{k} {l}: {error}");
            }
        }
    }
}

#[test]
fn draws_take_samples_in_turn() {
    let case = Case::tiny(2);
    let (problem, samples) = (case.problem(), samples(&case));
    let normals = Numbers::new(4).normals(18, 2 * samples.len());
    let together = problem.draws(&samples, normals.as_ref(), Par::Seq).unwrap();
    for draw in 0..normals.ncols() {
        let one = &samples[draw % samples.len()];
        let own: Mat<f64> = normals.get(.., draw..draw + 1).to_owned();
        let alone = problem.draws(std::slice::from_ref(one), own.as_ref(), Par::Seq).unwrap();
        assert_eq!(alone.col(0), together.col(draw));
    }
}
