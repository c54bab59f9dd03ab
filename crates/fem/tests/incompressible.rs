//! Near incompressibility: linear tets whose volume ratios are averaged at the nodes, and quadratic
//! ones, against published values. `measure/incompressible.rs` has the whole tables.
#![allow(clippy::expect_used)]

mod common;

use std::path::Path;

use common::incompressible::evenness;
use common::incompressible::{BLOCK, BLOCK_POISSON, COOK, Problem, block as pressed_block, cook};
use common::laws::recipes;
use common::npz;
use common::{Random, bar, largest, largest_difference, nodes_where};
use tissuereg_fem::{
    Behaviour, Body, Element, History, Load, Material, Method, SolveSettings, Springs,
    internal_forces, is_stable, solve,
};

const AVERAGED: Element = Element::Tet4Averaged;

fn block(cells: usize, element: Element) -> Body {
    let mesh = bar([cells; 3], [10.0, 9.0, 8.0]);
    let held = nodes_where(&mesh, |x| x[2] < 1e-9);
    Body::new(mesh, element, held).expect("supported")
}

fn noise(body: &Body, size: f64, seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    (0..body.n_nodes()).map(|_| std::array::from_fn(|_| size * random.next())).collect()
}

fn along(u: &[[f64; 3]], d: &[[f64; 3]], by: f64) -> Vec<[f64; 3]> {
    u.iter().zip(d).map(|(u, d)| std::array::from_fn(|i| u[i] + by * d[i])).collect()
}

/// Work of the internal forces on the way from rest, by Gauss's rule of five points on `pieces`.
fn work(body: &Body, material: &Material, u: &[[f64; 3]], pieces: usize) -> f64 {
    const POINTS: [(f64, f64); 3] = [
        (0.0, 0.568_888_888_888_888_9),
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
        (0.906_179_845_938_664, 0.236_926_885_056_189_08),
    ];
    let zero = vec![[0.0; 3]; u.len()];
    let mut sum = 0.0;
    for piece in 0..pieces {
        for (x, w) in POINTS {
            for x in if x == 0.0 { vec![0.0] } else { vec![-x, x] } {
                let t = (piece as f64 + 0.5 + 0.5 * x) / pieces as f64;
                let f = internal_forces(body, material, &along(&zero, u, t)).expect("upright");
                let power: f64 =
                    f.iter().zip(u).map(|(f, u)| (0..3).map(|i| f[i] * u[i]).sum::<f64>()).sum();
                sum += 0.5 * w * power / pieces as f64;
            }
        }
    }
    sum
}

#[test]
fn forces_are_the_derivative_of_the_reported_energy() {
    // Solved to equilibrium under its own internal forces, a field reports its energy; the forces
    // integrated along a straight way from rest must give the same.
    let body = block(2, AVERAGED);
    for recipe in recipes() {
        let material = recipe.material().expect("valid");
        let u = body
            .nodes()
            .iter()
            .zip(noise(&body, 0.02, 5))
            .map(|(x, r)| {
                let z = x[2] / 8.0;
                [0.3 * z + z * r[0], 0.2 * z * z + z * r[1], 0.4 * z + z * r[2]]
            })
            .collect::<Vec<_>>();
        let load = Load::from_forces(internal_forces(&body, &material, &u).expect("upright"));
        let settings = SolveSettings::default().with_tolerance(1e-11);
        let answer = solve(&body, &material, &load, &settings).expect("an equilibrium");
        assert!(largest_difference(&answer.displacement, &u) < 1e-6, "{}", recipe.name);
        let (own, integrated) = (answer.report.strain_energy, work(&body, &material, &u, 3));
        assert!((own / integrated - 1.0).abs() < 1e-7, "{}: {own} {integrated}", recipe.name);
    }
}

#[test]
fn newtons_method_converges_quadratically_for_every_law() {
    // Only with the exact tangent, of a state far from rest, does the residual fall to 1e-11 within
    // a few steps.
    let body = block(2, AVERAGED);
    for recipe in recipes() {
        let material = recipe.material().expect("valid");
        let load = Load { body_force: [0.05, 0.0, -0.1], ..Load::default() };
        let settings = SolveSettings::default().with_method(Method::Newton).with_tolerance(1e-11);
        let answer = solve(&body, &material, &load, &settings).expect("an equilibrium");
        assert!(answer.report.iterations <= 8, "{}: {:?}", recipe.name, answer.report);
        assert!(is_stable(&body, &material, &answer.displacement).expect("upright"));
    }
}

#[test]
fn affine_fields_are_met_exactly_and_cost_nothing_to_turn() {
    let body = block(3, AVERAGED);
    let material = Material::neo_hookean(10.0, 0.4995).expect("valid");
    let h = [[0.02, 0.05, -0.01], [0.03, -0.04, 0.02], [0.01, 0.0, 0.021]];
    let affine: Vec<[f64; 3]> = body
        .nodes()
        .iter()
        .map(|x| std::array::from_fn(|i| (0..3).map(|j| h[i][j] * x[j]).sum()))
        .collect();
    let ours = internal_forces(&body, &material, &affine).expect("upright");
    let plain = internal_forces(&block(3, Element::Tet4), &material, &affine).expect("upright");
    assert!(largest_difference(&ours, &plain) < 1e-11 * largest(&plain));

    let (c, s) = (0.6, 0.8);
    let turned: Vec<[f64; 3]> = body
        .nodes()
        .iter()
        .zip(noise(&body, 0.1, 3))
        .map(|(x, r)| [x[0] + r[0], x[1] + r[1], x[2] + r[2]])
        .collect();
    let before: Vec<[f64; 3]> = turned
        .iter()
        .zip(body.nodes())
        .map(|(y, x)| std::array::from_fn(|i| y[i] - x[i]))
        .collect();
    let after: Vec<[f64; 3]> = turned
        .iter()
        .zip(body.nodes())
        .map(|(y, x)| [c * y[0] - s * y[1] - x[0], s * y[0] + c * y[1] - x[1], y[2] - x[2]])
        .collect();
    let own = internal_forces(&body, &material, &before).expect("upright");
    let other = internal_forces(&body, &material, &after).expect("upright");
    let carried: Vec<[f64; 3]> =
        own.iter().map(|f| [c * f[0] - s * f[1], s * f[0] + c * f[1], f[2]]).collect();
    assert!(largest_difference(&carried, &other) < 1e-10 * largest(&own));
}

/// Tip displacement and iterations of a bar of 30 x 10 x 10 mm under its weight, clamped at x = 0.
fn sag(cells: usize, element: Element, poisson: f64) -> (f64, usize) {
    let mesh = bar([3 * cells, cells, cells], [30.0, 10.0, 10.0]);
    let tip = nodes_where(&mesh, |x| (x[0] - 30.0).abs() < 1e-9);
    let held = nodes_where(&mesh, |x| x[0] < 1e-9);
    let body = Body::new(mesh, element, held).expect("supported");
    let material = Material::neo_hookean(10.0, poisson).expect("valid");
    let load = Load { body_force: [0.0, 0.0, -2e-3], ..Load::default() };
    let answer = solve(&body, &material, &load, &SolveSettings::default()).expect("an equilibrium");
    let sum: f64 = tip.iter().map(|&n| -answer.displacement[n][2]).sum();
    (sum / tip.len() as f64, answer.report.iterations)
}

#[test]
fn averaging_does_not_lock_where_linear_tets_do() {
    // Both linear elements bend too little on coarse meshes; locking is that refinement does not
    // help. Reference: the quadratic element at the same Poisson's ratio.
    for poisson in [0.45, 0.49, 0.499, 0.4995] {
        let (coarse_reference, _) = sag(2, Element::Tet10, poisson);
        let (reference, _) = sag(4, Element::Tet10, poisson);
        let missing = |cells, element| {
            let (found, iterations) = sag(cells, element, poisson);
            (1.0 - found / reference, iterations)
        };
        let (coarse, _) = missing(4, AVERAGED);
        let (fine, iterations) = missing(8, AVERAGED);
        let (plain, _) = missing(8, Element::Tet4);
        println!(
            "nu {poisson}: quadratic {coarse_reference} {reference}, averaged lacks {coarse} \
             {fine} ({iterations} iterations), linear {plain}"
        );
        assert!(iterations < 60, "{iterations} iterations at nu {poisson}");
        // Halving the elements leaves less than half of what was missing.
        assert!(fine < 0.5 * coarse, "nu {poisson}: {coarse} {fine}");
        if poisson > 0.498 {
            assert!(plain > 5.0 * fine, "nu {poisson}: {plain} {fine}");
        }
    }
}

#[test]
fn springs_and_histories_work_on_patches() {
    let body = block(2, AVERAGED);
    let material = Material::neo_hookean(10.0, 0.499).expect("valid");
    let top: Vec<[usize; 3]> = body
        .mesh()
        .surface_triangles()
        .iter()
        .copied()
        .filter(|t| t.iter().all(|&n| body.nodes()[n][2] > 7.9))
        .collect();
    let springs = Springs { triangles: top, normal: 3.0, tangential: 1.0, friction: None };
    let weight = Load { body_force: [0.02, 0.0, -0.05], ..Load::default() };
    let held = Load { springs: vec![springs], ..weight.clone() };
    let newton = SolveSettings::default().with_method(Method::Newton);
    let answer = solve(&body, &material, &held, &newton).expect("an equilibrium");
    assert!(answer.report.iterations <= 6, "{:?}", answer.report);

    // Without a past a history gives the elastic answer.
    let settings = SolveSettings::default();
    let elastic = solve(&body, &material, &weight, &settings).expect("an equilibrium");
    let mut history = History::new(&body, material, Behaviour::default()).expect("a history");
    let frame = history.advance(&body, &weight, 1.0, &settings).expect("an equilibrium");
    assert!(largest_difference(&frame.displacement, &elastic.displacement) < 1e-6);
}

#[test]
fn linear_tets_are_said_to_lock_from_where_they_do() {
    let locks = |nu| Material::neo_hookean(10.0, nu).expect("valid").locks_linear_tets();
    assert_eq!([0.3, 0.45, 0.47, 0.49, 0.499].map(locks), [false, false, false, true, true]);
}

/// Displacement of a published problem where it is measured, mm, and the answer.
fn measured(problem: &Problem) -> (f64, Vec<[f64; 3]>) {
    let Problem { body, material, load, node, axis } = problem;
    let settings = SolveSettings::default().with_tolerance(1e-6);
    let answer = solve(body, material, load, &settings).expect("an equilibrium");
    (answer.displacement[*node][*axis].abs(), answer.displacement)
}

#[test]
fn cooks_membrane_rises_as_published() {
    // 0.4995 lies between two published values that differ by 0.05 %.
    let limit = (0.4995, 0.5 * (COOK[3].1 + COOK[4].1));
    for (poisson, published) in [COOK[2], limit] {
        let (quadratic, _) = measured(&cook(8, Element::Tet10, poisson));
        let off = quadratic / published - 1.0;
        assert!(off.abs() < 0.01, "quadratic tets at nu {poisson}: {quadratic} of {published} mm");
        // Too stiff, and half as much on a mesh twice as fine.
        let errors = [8, 16].map(|n| 1.0 - measured(&cook(n, AVERAGED, poisson)).0 / published);
        println!("nu {poisson}: quadratic {off}, averaged {errors:?}");
        assert!(errors[1] > 0.0 && errors[1] < 0.4 * errors[0], "nu {poisson}: {errors:?}");
    }
    let (averaged, _) = measured(&cook(24, AVERAGED, limit.0));
    assert!((averaged / limit.1 - 1.0).abs() < 0.01, "averaged: {averaged} of {} mm", limit.1);
    let (linear, _) = measured(&cook(16, Element::Tet4, limit.0));
    assert!(linear < 0.96 * limit.1, "linear tets lock: {linear}");
}

#[test]
fn a_pressed_block_gives_way_as_published() {
    for (n, element) in [(4, Element::Tet10), (4, AVERAGED), (8, AVERAGED)] {
        let (found, _) = measured(&pressed_block(n, element, BLOCK_POISSON));
        assert!((found / BLOCK - 1.0).abs() < 0.01, "{element:?}, {n} cells: {found} mm");
    }
    let (linear, _) = measured(&pressed_block(4, Element::Tet4, BLOCK_POISSON));
    assert!(linear < 0.9 * BLOCK, "linear tets lock: {linear}");
}

#[test]
fn a_pressed_block_at_the_limit_gives_way_as_bricks_of_felupe_say() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/incompressible_felupe.npz");
    let bricks = npz::read(&path).expect("stored");
    let finest = |name: &str| bricks[name].values.last().copied().expect("an entry");
    // The bricks meet the published value, so the problem is the same.
    assert!((finest("published") / BLOCK - 1.0).abs() < 0.003);
    for element in [AVERAGED, Element::Tet10] {
        let (found, _) = measured(&pressed_block(4, element, 0.4995));
        let expected = finest("nu_04995");
        assert!((found / expected - 1.0).abs() < 0.01, "{element:?}: {found} of {expected} mm");
    }
}

#[test]
fn averaged_volume_ratios_are_as_uneven_as_the_documentation_says() {
    let of = |n, element| {
        let problem = cook(n, element, 0.4995);
        let (_, displacement) = measured(&problem);
        evenness(&problem.body, &displacement)
    };
    let (averaged, quadratic) = (of(16, AVERAGED), of(8, Element::Tet10));
    println!("{:?} {}", averaged.range, averaged.roughness);
    println!("{:?} {}", quadratic.range, quadratic.roughness);
    // A weakness of the element, measured: should it go, the documentation must change.
    assert!(averaged.roughness > 0.8 && averaged.roughness < 1.0);
    assert!(quadratic.roughness < 0.4);
    assert!(averaged.range[0] > 0.95 && averaged.range[0] < 0.98);
    assert!(quadratic.range[0] > 0.998 && quadratic.range[1] < 1.002);
}
