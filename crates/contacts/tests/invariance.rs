//! Invariance: what must not matter.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, Numbers, run};
use faer::{Mat, Par};
use tissuereg_contacts::{ChainSettings, Configuration, Contact, Moments};

fn configurations(case: &Case) -> Vec<Configuration> {
    let found = run(&case.problem(), &ChainSettings::default(), 8, Par::Seq).samples;
    found.into_iter().map(|sample| sample.configuration).collect()
}

fn points(case: &Case) -> Mat<f64> {
    Numbers::new(6).normals(6, case.columns.ncols())
}

fn moments(case: &Case, samples: &[Configuration], points: &Mat<f64>) -> Moments {
    case.problem().moments(samples, points.as_ref(), Par::Seq).unwrap()
}

fn near(a: &[f64], b: &[f64]) {
    let size = a.iter().fold(1e-3, |size: f64, x| size.max(x.abs()));
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).for_each(|(x, y)| assert!((x - y).abs() < 1e-9 * size, "{x} {y}"));
}

fn same_points(a: &Moments, b: &Moments) {
    near(a.means.as_flattened(), b.means.as_flattened());
    let flat = |all: &[[[f64; 3]; 3]]| all.as_flattened().as_flattened().to_vec();
    near(&flat(&a.covariances), &flat(&b.covariances));
    near(&flat(&a.prior_covariances), &flat(&b.prior_covariances));
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let case = Case::organ(6);
    let (problem, settings) = (case.problem(), ChainSettings::default());
    let alone = run(&problem, &settings, 5, Par::Seq);
    let samples: Vec<Configuration> =
        alone.samples.iter().map(|s| s.configuration.clone()).collect();
    let (points, normals) = (points(&case), Numbers::new(7).normals(case.columns.ncols() + 18, 9));
    let of = |par| {
        let drawn = problem.draws(&samples, normals.as_ref(), par).unwrap();
        (problem.moments(&samples, points.as_ref(), par).unwrap(), drawn)
    };
    for n_threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        let par = Par::rayon(n_threads);
        // A problem of its own: what one run leaves in it must not matter either.
        assert_eq!(alone, pool.install(|| run(&case.problem(), &settings, 5, par)));
        assert_eq!(of(Par::Seq), pool.install(|| of(par)));
    }
}

#[test]
fn chains_do_not_know_each_other() {
    let case = Case::tiny(2);
    let (problem, settings) = (case.problem(), ChainSettings::default());
    let uniforms = Numbers::new(1).uniforms(6, problem.n_uniforms(&settings));
    let order = [4, 0, 5, 2, 1, 3];
    let mixed = Mat::from_fn(6, uniforms.ncols(), |i, j| uniforms[(order[i], j)]);
    let all = problem.run(&settings, uniforms.as_ref(), &[], Par::Seq).unwrap().samples;
    let other = problem.run(&settings, mixed.as_ref(), &[], Par::Seq).unwrap().samples;
    for (place, chain) in order.iter().enumerate() {
        let n = settings.n_kept;
        assert_eq!(other[n * place..n * (place + 1)], all[n * chain..n * (chain + 1)]);
    }
}

#[test]
fn the_order_of_observations_does_not_matter() {
    let case = Case::organ(6);
    let order: Vec<usize> = (0..18).map(|i| (7 * i + 5) % 18).collect();
    let mut other = case.clone();
    other.columns = Mat::from_fn(18, case.columns.ncols(), |i, j| case.columns[(order[i], j)]);
    other.observed.noise = Mat::from_fn(18, 18, |i, j| case.observed.noise[(order[i], order[j])]);
    other.observed.innovation = order.iter().map(|&i| case.observed.innovation[i]).collect();
    for rows in &mut other.prior.wrong.rows {
        rows.iter_mut().for_each(|row| *row = order.iter().position(|i| i == row).unwrap());
    }
    let samples = configurations(&case);
    assert_eq!(samples, configurations(&other));
    let points = points(&case);
    let (a, b) = (moments(&case, &samples, &points), moments(&other, &samples, &points));
    same_points(&a, &b);
    near(&a.coefficients, &b.coefficients);
    for (i, &from) in order.iter().enumerate() {
        let column = |m: &Mat<f64>, j: usize| m.col(j).iter().copied().collect::<Vec<f64>>();
        near(&column(&b.gain, i), &column(&a.gain, from));
    }
}

#[test]
fn the_order_of_patches_changes_only_their_order() {
    let case = Case::tiny(2);
    let order = [2, 0, 3, 1];
    let place = |patch: usize| order.iter().position(|&p| p == patch).unwrap();
    let columns = |m: &Mat<f64>| {
        Mat::from_fn(m.nrows(), 13, |i, j| {
            m[(i, if j < 12 { 3 * order[j / 3] + j % 3 } else { j })]
        })
    };
    let mut other = case.clone();
    other.columns = columns(&case.columns);
    for (patch, &from) in order.iter().enumerate() {
        let old = &case.patches[from];
        other.patches[patch].texture = old.texture.iter().map(|&(p, r)| (place(p), r)).collect();
        other.patches[patch].neighbours = old.neighbours.iter().map(|&p| place(p)).collect();
        other.prior.log_filled[2 * patch..2 * patch + 2]
            .copy_from_slice(&case.prior.log_filled[2 * from..2 * from + 2]);
    }
    let samples = configurations(&case);
    let moved: Vec<Configuration> = samples
        .iter()
        .map(|one| {
            let slot = |c: &Option<Contact>| c.map(|c| Contact { patch: place(c.patch), ..c });
            Configuration { slots: one.slots.iter().map(slot).collect(), ..one.clone() }
        })
        .collect();
    let points = points(&case);
    let a = moments(&case, &samples, &points);
    let b = moments(&other, &moved, &columns(&points));
    same_points(&a, &b);
    for (patch, &from) in order.iter().enumerate() {
        near(&b.coefficients[3 * patch..3 * patch + 3], &a.coefficients[3 * from..3 * from + 3]);
    }
}

#[test]
fn the_unit_of_observations_does_not_matter() {
    let case = Case::organ(6);
    let mut other = case.clone();
    // A power of two: nothing is rounded, so that every decision is the same.
    let scale = 1024.0;
    other.columns = &case.columns * faer::Scale(scale);
    other.observed.noise = &case.observed.noise * faer::Scale(scale * scale);
    other.observed.innovation.iter_mut().for_each(|d| *d *= scale);
    other.prior.wrong.variance *= scale * scale;
    let samples = configurations(&case);
    assert_eq!(samples, configurations(&other));
    let points = points(&case);
    let (a, b) = (moments(&case, &samples, &points), moments(&other, &samples, &points));
    same_points(&a, &b);
    near(&a.coefficients, &b.coefficients);
}

#[test]
fn huge_noise_leaves_the_prior() {
    let mut case = Case::tiny(1);
    case.observed.noise = Mat::from_fn(5, 5, |i, j| if i == j { 1e12 } else { 0.0 });
    let samples = configurations(&case);
    let found = moments(&case, &samples, &points(&case));
    assert!(found.coefficients.iter().all(|c| c.abs() < 1e-6));
    let (mean, n) = (&found.means, samples.len() as f64);
    assert!(mean.as_flattened().iter().all(|x| x.abs() < 1e-6) && n > 0.0);
    near(
        found.covariances.as_flattened().as_flattened(),
        found.prior_covariances.as_flattened().as_flattened(),
    );
}

#[test]
fn a_run_goes_on_from_where_it_was() {
    let case = Case::tiny(2);
    let problem = case.problem();
    let settings = ChainSettings::default().with_powers(vec![1.0; 6]).with_n_kept(6);
    let uniforms = Numbers::new(3).uniforms(2, problem.n_uniforms(&settings));
    let whole = problem.run(&settings, uniforms.as_ref(), &[], Par::Seq).unwrap().samples;
    let half = settings.with_powers(vec![1.0; 3]).with_n_kept(3);
    let n = problem.n_uniforms(&half);
    let first = problem.run(&half, uniforms.get(.., ..n), &[], Par::Seq).unwrap().samples;
    let starts = [first[2].configuration.clone(), first[5].configuration.clone()];
    let second = problem.run(&half, uniforms.get(.., n..), &starts, Par::Seq).unwrap().samples;
    let joined = [&first[..3], &second[..3], &first[3..], &second[3..]].concat();
    assert_eq!(whole, joined);
}
