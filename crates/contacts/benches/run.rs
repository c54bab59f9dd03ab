//! A run of chains and what becomes of its samples. `cargo bench -p tissuereg-contacts`; under `cargo test` everything
//! runs once.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;

use common::{Case, Numbers, run};
use criterion::{Criterion, criterion_group, criterion_main};
use faer::{Mat, Par};
use tissuereg_contacts::{ChainSettings, Configuration};

fn organ(criterion: &mut Criterion) {
    let case = Case::organ(15);
    let (problem, settings) = (case.problem(), ChainSettings::default());
    let mut group = criterion.benchmark_group("organ");
    group.sample_size(10);
    group.bench_function("problem", |b| b.iter(|| black_box(&case).problem()));
    for (name, powers, n_local, n_level) in [
        // 48 tables of all patches and sizes with hardly anything else.
        ("tables", vec![1.0], 0, 0),
        ("steps", vec![1.0], 20, 0),
        ("levels", vec![1.0], 0, 20),
    ] {
        let alone = settings
            .clone()
            .with_powers(powers)
            .with_n_kept(1)
            .with_n_local(n_local)
            .with_n_level(n_level);
        group.bench_function(name, |b| b.iter(|| run(black_box(&problem), &alone, 16, Par::Seq)));
    }
    group.bench_function("run", |b| b.iter(|| run(&problem, black_box(&settings), 16, Par::Seq)));
    let samples: Vec<Configuration> = run(&problem, &settings, 16, Par::Seq)
        .samples
        .into_iter()
        .map(|sample| sample.configuration)
        .collect();
    let points = Mat::from_fn(60, case.columns.ncols(), |i, j| case.columns[(i % 45, j)]);
    group.bench_function("moments", |b| {
        b.iter(|| problem.moments(&samples, points.as_ref(), Par::Seq).unwrap())
    });
    let normals = Numbers::new(2).normals(case.columns.ncols() + 45, 64);
    group.bench_function("draws", |b| {
        b.iter(|| problem.draws(&samples, normals.as_ref(), Par::Seq).unwrap())
    });
    group.finish();
}

criterion_group!(benches, organ);
criterion_main!(benches);
