//! Stages of a solve, apart: `cargo bench -p tissuereg-fem`. Run once each by `cargo test --benches`.
#![allow(clippy::expect_used, clippy::panic)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{bar, clamped_at_x0, dome, nodes_where};
use criterion::{Criterion, criterion_group, criterion_main};
use tissuereg_fem::{
    Body, Element, Load, Material, Member, Method, SolveSettings, solve, solve_many,
};

/// Named problems: a body, its material and a load of about a tenth of its size.
fn problems() -> Vec<(&'static str, Body, Material, Load)> {
    let material = || Material::neo_hookean(10.0, 0.45).expect("sound");
    let weight = || Load { body_force: [4e-3, 0.0, -9.81e-3], ..Load::default() };
    let on_floor = |n: usize, element| {
        let mesh = dome(n);
        let held = nodes_where(&mesh, |x| x[2] < 1e-9);
        Body::new(mesh, element, held).expect("held")
    };
    let beam = clamped_at_x0(bar([24, 8, 8], [60.0, 20.0, 20.0]), Element::Tet4);
    vec![
        ("dome_3k", on_floor(18, Element::Tet4), material(), weight()),
        ("dome_3k_tet10", on_floor(10, Element::Tet10), material(), weight()),
        ("bar_2k", beam, material(), Load { body_force: [0.0, 0.0, -1e-3], ..Load::default() }),
    ]
}

fn stages(criterion: &mut Criterion) {
    for (name, body, material, load) in problems() {
        let mut group = criterion.benchmark_group(name);
        group.sample_size(10);
        let mesh = body.mesh().clone();
        group.bench_function("analyse", |b| {
            b.iter(|| Body::new(mesh.clone(), body.element(), body.supports().clone()));
        });
        let one = SolveSettings::default().with_n_threads(1);
        let newton = one.clone().with_method(Method::Newton);
        group.bench_function("solve_warm", |b| b.iter(|| solve(&body, &material, &load, &one)));
        group.bench_function("solve_newton", |b| {
            b.iter(|| solve(&body, &material, &load, &newton));
        });
        let all = SolveSettings::default();
        group.bench_function("solve_warm_all_threads", |b| {
            b.iter(|| solve(&body, &material, &load, &all));
        });
        let members = vec![Member { material: &material, load: &load, start: None }; 8];
        group.bench_function("solve_many_8", |b| b.iter(|| solve_many(&body, &members, &all)));
        group.finish();
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
