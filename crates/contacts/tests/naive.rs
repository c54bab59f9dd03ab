//! Exact: chains, moments and draws against a textbook version that enumerates every configuration.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::textbook::*;
use common::{Case, Numbers};
use faer::{Mat, Par};
use tissuereg_contacts::{ChainSettings, Configuration, Contact, Problem, Wrong};

/// Total variation distance between long chains and the posterior.
fn distance(case: &Case, settings: &ChainSettings) -> f64 {
    let all = all_of(case);
    let wanted = posterior(case, &all);
    let problem = case.problem();
    let uniforms = Numbers::new(9).uniforms(8, problem.n_uniforms(settings));
    let run = problem.run(settings, uniforms.as_ref(), &[], Par::Seq).unwrap();
    let share = 1.0 / run.samples.len() as f64;
    let mut count = vec![0.0; all.len()];
    for sample in &run.samples {
        let found = all.iter().position(|one| one == &sample.configuration).unwrap();
        count[found] += share;
    }
    0.5 * count.iter().zip(&wanted).map(|(c, w)| (c - w).abs()).sum::<f64>()
}

fn long(n_sweeps: usize) -> ChainSettings {
    ChainSettings::default().with_powers(vec![1.0; n_sweeps + 20]).with_n_kept(n_sweeps)
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
        let settings = long(6_000).with_sharpness(sharpness).with_n_local(n_local);
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
    let settings = long(6_000).with_sharpness(0.001).with_n_local(20);
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

/// A group that is off, above a patch that moves hardly anything else: either explains it, both at once are unlikely.
fn beneath() -> Case {
    let mut case = Case::tiny(1);
    for (row, axis) in [0, 3, 4].into_iter().flat_map(|row| [0, 1, 2].map(|axis| (row, axis))) {
        case.columns[(row, axis)] *= 0.05;
    }
    case.prior.log_filled.iter_mut().for_each(|log| *log += 0.01_f64.ln());
    let log_odds = 1.6e-5_f64.ln();
    case.prior.wrong = Wrong { rows: vec![vec![1, 2], vec![0, 4]], variance: 9.0, log_odds };
    case.observed.innovation = vec![0.1, -4.0, 5.0, 0.2, -0.1];
    case
}

/// Probabilities by whether the slot is filled, then by whether the first group is wrong.
fn explained<'a>(each: impl Iterator<Item = (&'a Configuration, f64)>) -> [[f64; 2]; 2] {
    let mut found = [[0.0; 2]; 2];
    for (one, share) in each {
        found[usize::from(one.slots[0].is_some())][usize::from(one.wrong[0])] += share;
    }
    found
}

/// Chains that all begin at the same explanation, and are short, against the posterior; with `others` the groups beside
/// the first are wrong from the start.
fn weigh_both_explanations(case: &Case, others: bool, sharpness: f64) {
    let all = all_of(case);
    let wanted = explained(all.iter().zip(posterior(case, &all)));
    // Two explanations with hardly a way between them but by exchange.
    assert!(wanted[0][1] > 0.2 && wanted[1][0] > 0.2, "{wanted:?}");
    assert!(wanted[0][0] + wanted[1][1] < 0.01, "{wanted:?}");
    let problem = case.problem();
    let short = ChainSettings::default().with_powers(vec![1.0; 30]).with_n_kept(5);
    let settings = short.with_sharpness(sharpness);
    let n_chains = 1000;
    let uniforms = Numbers::new(11).uniforms(n_chains, problem.n_uniforms(&settings));
    for contact in [None, Some(Contact { patch: 0, size: 1 })] {
        let mut start = Configuration::empty(&problem);
        start.wrong.fill(others);
        (start.slots[0], start.wrong[0]) = (contact, contact.is_none());
        let starts = vec![start; n_chains];
        let run = problem.run(&settings, uniforms.as_ref(), &starts, Par::Seq).unwrap();
        let share = 1.0 / run.samples.len() as f64;
        let found = explained(run.samples.iter().map(|sample| (&sample.configuration, share)));
        let gaps = found.as_flattened().iter().zip(wanted.as_flattened());
        // A standard error of a share of one half is 0.016 or less.
        assert!(gaps.clone().all(|(f, w)| (f - w).abs() < 0.05), "{found:?} {wanted:?}");
    }
}

#[test]
fn a_wrong_group_and_a_contact_beneath_it_have_the_probabilities_of_the_posterior() {
    weigh_both_explanations(&beneath(), false, ChainSettings::default().sharpness);
}

#[test]
fn another_group_that_is_wrong_for_sure_does_not_change_how_often_they_are_exchanged() {
    let mut case = beneath();
    // Far off, where nothing else moves anything: more groups to choose from one way than the other.
    for row in [0, 4] {
        case.columns.row_mut(row).fill(0.0);
        for other in (0..5).filter(|&other| other != row) {
            (case.observed.noise[(row, other)], case.observed.noise[(other, row)]) = (0.0, 0.0);
        }
    }
    (case.observed.innovation[0], case.observed.innovation[4]) = (6.0, -6.0);
    // Once the groups are likelier, once the contact: the way there is cut short, or the way back.
    for share in [0.023_f64, 0.21] {
        let mut case = case.clone();
        case.prior.log_filled.iter_mut().for_each(|log| *log += share.ln());
        // Drawn from a table as sharp as the posterior, contacts are taken as often as the number of groups says.
        weigh_both_explanations(&case, true, 1.0);
    }
}

#[test]
fn exchanges_of_two_groups_are_reversible() {
    // Jumps and exchanges from a flat table, and as they are; with groups of which either may lie above the contact.
    for sharpness in [0.01, 0.5] {
        let settings = long(8_000).with_sharpness(sharpness);
        let found = distance(&beneath(), &settings);
        assert!(found < 0.03, "sharpness {sharpness}: {found}");
    }
    let mut case = Case::tiny(2);
    case.prior.wrong.rows = vec![vec![1, 2], vec![0, 4]];
    let found = distance(&case, &long(8_000));
    assert!(found < 0.04, "{found}");
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
    let squares = samples.iter().map(|one| {
        let (inverse, _) = inverse(covariance(&case, one));
        (0..5).map(|i| (0..5).map(|j| d[i] * inverse[i][j] * d[j]).sum::<f64>()).sum::<f64>()
    });
    assert!((found.misfit - share * squares.sum::<f64>()).abs() < 1e-10);
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
