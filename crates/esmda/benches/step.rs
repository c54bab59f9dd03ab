//! One update by stage. `cargo bench -p tissuereg-esmda`; under `cargo test` everything runs once.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;

use common::Case;
use criterion::{Criterion, criterion_group, criterion_main};
use faer::Par;
use tissuereg_esmda::{Factorisation, Schedule, Step, StepSettings};

fn updates(criterion: &mut Criterion) {
    for (name, case) in [("surgical", Case::surgical()), ("wide", Case::wide())] {
        let mut group = criterion.benchmark_group(name);
        let settings = StepSettings::default();
        let step = case.step(4.0, &settings).unwrap();
        group.bench_function("update", |b| b.iter(|| case.updated(black_box(4.0), &settings)));
        group.bench_function("prepare", |b| b.iter(|| case.step(black_box(4.0), &settings)));
        group.bench_function("apply", |b| {
            let mut parameters = case.parameters.clone();
            b.iter(|| {
                parameters.copy_from(&case.parameters);
                step.apply(parameters.as_mut())
            });
        });
        let threads = settings.with_par(Par::rayon(0));
        group.bench_function("update_all_threads", |b| {
            b.iter(|| case.updated(black_box(4.0), &threads))
        });
        let qr = settings.with_factorisation(Factorisation::Qr);
        group.bench_function("update_qr", |b| b.iter(|| case.updated(black_box(4.0), &qr)));
        if name == "surgical" {
            let svd = settings.with_factorisation(Factorisation::Svd);
            group.bench_function("update_svd", |b| b.iter(|| case.updated(black_box(4.0), &svd)));
            group
                .bench_function("update_square_root", |b| b.iter(|| square_root(&case, &settings)));
            group.bench_function("loop_of_five", |b| b.iter(|| loop_of_five(&case, &settings)));
        }
        group.finish();
    }
}

fn square_root(case: &Case, settings: &StepSettings) -> faer::Mat<f64> {
    let (y, d, noise) = (case.predicted.as_ref(), &case.observed, case.noise());
    let step = Step::prepare_square_root(y, d, &noise, black_box(4.0), settings).unwrap();
    let mut parameters = case.parameters.clone();
    step.apply(parameters.as_mut()).unwrap();
    parameters
}

/// Five updates as in a registration, the forward model left out.
fn loop_of_five(case: &Case, settings: &StepSettings) -> faer::Mat<f64> {
    let noise = case.noise();
    let mut parameters = case.parameters.clone();
    for &alpha in Schedule::geometric(5, 2.0).unwrap().alphas() {
        let (y, e) = (case.predicted.as_ref(), case.draws.as_ref());
        let step = Step::prepare(y, &case.observed, &noise, alpha, e, settings).unwrap();
        step.apply(parameters.as_mut()).unwrap();
    }
    parameters
}

criterion_group!(benches, updates);
criterion_main!(benches);
