//! Does it fail well? Every variant with its message, and no panic on random broken input.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use common::{bar, bar_arrays, clamped_at_x0, nodes_where};
use proptest::prelude::*;
use tissuereg_fem::{
    Body, Element, FemError, Load, LoadSteps, Material, Member, Mesh, SolveSettings, Stiffness,
    StopReason, Supports, solve, solve_from, solve_many,
};

const CELLS: [usize; 3] = [2, 1, 1];
const SIZE: [f64; 3] = [20.0, 10.0, 10.0];

fn mesh_error(change: impl Fn(&mut Vec<[f64; 3]>, &mut Vec<[usize; 4]>)) -> String {
    let (mut nodes, mut tets) = bar_arrays(CELLS, SIZE);
    change(&mut nodes, &mut tets);
    let error = Mesh::new(nodes, tets).expect_err("broken");
    assert!(!error.is_recoverable());
    error.to_string()
}

fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "`{message}` must contain `{part}`");
    }
}

#[test]
fn broken_meshes_are_named() {
    assert_says(&mesh_error(|_, t| t.clear()), &["at least one tetrahedron", "0 tetrahedra"]);
    let nan = mesh_error(|n, _| n[3][1] = f64::NAN);
    assert_says(&nan, &["finite", "node 3", "NaN"]);
    assert_says(&mesh_error(|n, _| n[2][0] = f64::INFINITY), &["node 2", "inf"]);
    assert_says(&mesh_error(|_, t| t[5][2] = 99), &["tetrahedron 5", "node 99", "12 nodes"]);
    assert_says(&mesh_error(|_, t| t[4][1] = t[4][0]), &["tetrahedron 4", "more than once"]);
    assert_says(&mesh_error(|_, t| t[1].swap(0, 1)), &["tetrahedron 1 is inverted", "1 of 12"]);
    let flat = mesh_error(|n, t| n[t[0][3]] = n[t[0][0]]);
    assert_says(&flat, &["degenerate", "mm^3"]);
    assert_says(&mesh_error(|n, _| n.push([5.0; 3])), &["node 12", "belongs to none", "1 such"]);
    assert_says(&mesh_error(|_, t| t.extend(t.clone())), &["belongs to", "at most two"]);
}

#[test]
fn a_tiny_but_sound_mesh_is_accepted() {
    let (nodes, tets) = bar_arrays(CELLS, SIZE.map(|s| 1e-7 * s));
    assert!(Mesh::new(nodes, tets).is_ok(), "degenerate is relative to the edges");
}

fn body_error(mesh: Mesh, supports: impl Into<Supports>) -> String {
    let error = Body::new(mesh, Element::Tet4, supports).expect_err("not supported");
    assert!(!error.is_recoverable());
    error.to_string()
}

#[test]
fn free_rigid_modes_are_named() {
    let mesh = || bar(CELLS, SIZE);
    let six = [
        "translation x",
        "translation y",
        "translation z",
        "rotation about x",
        "rotation about y",
        "rotation about z",
        "12 nodes",
    ];
    assert_says(&body_error(mesh(), []), &six);
    let one = body_error(mesh(), [0]);
    assert_says(&one, &["rotation about x", "rotation about y", "rotation about z"]);
    assert!(!one.contains("translation"), "{one}");
    // Two nodes on an edge along z.
    let edge = body_error(mesh(), [0, 1]);
    assert_says(&edge, &["rotation about z"]);
    assert!(!edge.contains("about x") && !edge.contains("about y"), "{edge}");
    let all: Vec<usize> = (0..12).collect();
    let sliding = body_error(mesh(), Supports::new().hold_axes(&all, [false, true, true]));
    assert_says(&sliding, &["still free: translation x"]);
    assert!(!sliding.contains("rotation"), "{sliding}");
    let floor = nodes_where(&mesh(), |x| x[2] < 1e-9);
    let gliding = body_error(mesh(), Supports::new().hold_axes(&floor, [false, false, true]));
    assert_says(&gliding, &["translation x, translation y, rotation about z"]);
    // A diagonal hinge has no axis of its own.
    assert_says(&body_error(mesh(), [0, 3]), &["rotation about (0."]);
}

#[test]
fn loose_parts_are_named() {
    let (mut nodes, mut tets) = bar_arrays(CELLS, SIZE);
    let n = nodes.len();
    let (more, more_tets) = bar_arrays([1, 1, 1], [5.0; 3]);
    nodes.extend(more.iter().map(|x| [x[0] + 100.0, x[1], x[2]]));
    tets.extend(more_tets.iter().map(|t| t.map(|k| k + n)));
    let held = [0, 1, 2, 3];
    let message = body_error(Mesh::new(nodes, tets).expect("sound"), held);
    assert_says(&message, &["loose part of 8 nodes", "node 12", "2 parts", "translation x"]);
}

#[test]
fn a_hinge_between_blocks_is_found() {
    // Two cubes that share an edge only.
    let (mut nodes, mut tets) = bar_arrays([1, 1, 1], [10.0; 3]);
    let (more, more_tets) = bar_arrays([1, 1, 1], [10.0; 3]);
    let mut new = Vec::new();
    for x in more {
        let moved = [x[0] + 10.0, x[1] + 10.0, x[2]];
        let node = nodes.iter().position(|y| *y == moved).unwrap_or(nodes.len());
        if node == nodes.len() {
            nodes.push(moved);
        }
        new.push(node);
    }
    tets.extend(more_tets.iter().map(|t| t.map(|k| new[k])));
    let mesh = Mesh::new(nodes, tets).expect("sound");
    let held = nodes_where(&mesh, |x| x[0] < 1e-9);
    assert_says(&body_error(mesh, held), &["rotation about z"]);
}

#[test]
fn wrong_held_nodes_are_named() {
    assert_says(&body_error(bar(CELLS, SIZE), [0, 1, 12]), &["held node 12", "12 nodes"]);
    assert_says(&body_error(bar(CELLS, SIZE), [0, 1, 0]), &["node 0", "more than once"]);
}

#[test]
fn materials_out_of_range_are_named() {
    for young in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let message = Material::neo_hookean(young, 0.3).expect_err("bad").to_string();
        assert_says(&message, &["Young's modulus must be positive", "kPa"]);
    }
    for poisson in [0.5, 0.7, -1.0, f64::NAN] {
        let message = Material::neo_hookean(1.0, poisson).expect_err("bad").to_string();
        assert_says(&message, &["Poisson's ratio", "-1 and 0.5"]);
    }
    let field = Stiffness::PerTet { young: vec![1.0, 2.0, -3.0], poisson: vec![0.3] };
    assert_says(&Material::new(field).expect_err("bad").to_string(), &["-3 kPa", "entry 2"]);
    let field = Stiffness::PerTet { young: vec![1.0; 3], poisson: vec![0.3; 2] };
    assert_says(&Material::new(field).expect_err("bad").to_string(), &["3 rows", "found 2"]);
}

fn held_bar() -> Body {
    clamped_at_x0(bar(CELLS, SIZE), Element::Tet4)
}

fn soft() -> Material {
    Material::neo_hookean(10.0, 0.45).expect("sound")
}

#[test]
fn wrong_loads_and_settings_are_named() {
    let (body, material) = (held_bar(), soft());
    let fail = |load: &Load, settings: &SolveSettings| {
        let error = solve(&body, &material, load, settings).expect_err("wrong");
        assert!(!error.is_recoverable());
        error.to_string()
    };
    let plain = SolveSettings::default();
    let short = Load::from_forces(vec![[0.0; 3]; 5]);
    assert_says(&fail(&short, &plain), &["nodal forces", "12 rows", "found 5"]);
    let mut rows = vec![[0.0; 3]; 12];
    rows[7][2] = f64::NAN;
    let message = fail(&Load::from_forces(rows), &plain);
    assert_says(&message, &["nodal forces", "finite", "row 7 is (0, 0, NaN)"]);
    let weight = Load { body_force: [0.0, f64::INFINITY, 0.0], ..Load::default() };
    assert_says(&fail(&weight, &plain), &["body force", "finite"]);
    let moved = Load::from_prescribed(vec![[0.0; 3]; 3]);
    assert_says(&fail(&moved, &plain), &["prescribed", "4 rows", "found 3"]);
    for tolerance in [0.0, -1.0, 1.0, f64::NAN] {
        let settings = SolveSettings::default().with_tolerance(tolerance);
        assert_says(&fail(&Load::default(), &settings), &["`tolerance`", "above 0"]);
    }
    let settings = SolveSettings::default().with_max_iterations(0);
    assert_says(&fail(&Load::default(), &settings), &["`max_iterations`", "at least 1"]);
    let settings = SolveSettings::default().with_load_steps(LoadSteps::Equal(0));
    assert_says(&fail(&Load::default(), &settings), &["`load_steps`", "at least 1"]);
    let field = Stiffness::PerTet { young: vec![1.0; 3], poisson: vec![0.3] };
    let error = solve(&body, &Material::new(field).expect("sound"), &Load::default(), &plain);
    assert_says(&error.expect_err("short").to_string(), &["stiffness", "12 rows", "found 3"]);
}

#[test]
fn wrong_tractions_are_named() {
    let body = held_bar();
    let error = body.traction_forces(&[[0, 1, 11]], &[[0.0; 3]]).expect_err("inside");
    assert_says(&error.to_string(), &["triangle 0", "0 1 11", "surface"]);
    let error = body.traction_forces(&[[0, 1, 99]], &[[0.0; 3]]).expect_err("outside");
    assert_says(&error.to_string(), &["no facet"]);
    let facet = body.mesh().surface_triangles()[0];
    let error = body.traction_forces(&[facet], &[]).expect_err("short");
    assert_says(&error.to_string(), &["traction", "1 rows", "found 0"]);
    let error = body.traction_forces(&[facet], &[[f64::NAN; 3]]).expect_err("NaN");
    assert_says(&error.to_string(), &["traction", "finite", "row 0", "NaN"]);
    let [a, b, c] = facet;
    let error = body.traction_forces(&[facet, [c, a, b]], &[[0.0; 3]; 2]).expect_err("twice");
    assert_eq!(error, FemError::RepeatedFacet { row: 1, first: 0, triangle: [c, a, b] });
    assert_says(&error.to_string(), &["triangle 1", "row 0 again", "listed once"]);
}

#[test]
fn a_start_turned_inside_out_is_named() {
    let body = held_bar();
    let start: Vec<[f64; 3]> = body.nodes().iter().map(|x| [-3.0 * x[0], 0.0, 0.0]).collect();
    let settings = SolveSettings::default();
    let error = solve_from(&body, &soft(), &Load::default(), &start, &settings).expect_err("bad");
    assert!(error.is_recoverable());
    assert_says(&error.to_string(), &["inverts tetrahedron", "det F = -2"]);
    let error = solve_from(&body, &soft(), &Load::default(), &start[1..], &settings);
    assert_says(&error.expect_err("short").to_string(), &["start", "12 rows", "found 11"]);
}

/// The end is pushed through the clamped face: no state without inversion has it there.
#[test]
fn prescribed_displacements_beyond_inversion_are_reported() {
    let mesh = bar(CELLS, SIZE);
    let all: Vec<usize> = (0..mesh.n_nodes()).collect();
    let body = Body::new(mesh, Element::Tet4, all).expect("held");
    let rows = body.nodes().iter().map(|x| [-1.5 * x[0], 0.0, 0.0]).collect();
    let error = solve(&body, &soft(), &Load::from_prescribed(rows), &SolveSettings::default())
        .expect_err("inverts");
    assert!(error.is_recoverable());
    let FemError::NoEquilibrium(report) = &error else { panic!("{error}") };
    assert_eq!(report.reason, StopReason::PrescribedInverts);
    // det F = 1 - 1.5 fraction vanishes at two thirds.
    assert!((0.6..=2.0 / 3.0).contains(&report.load_fraction), "{error}");
    assert_says(&error.to_string(), &["load fraction", "would invert", "worst tetrahedra", "(mm)"]);
}

/// What the error hands back is in equilibrium under that share of the load.
#[test]
fn the_last_equilibrium_of_a_failed_search_is_handed_back() {
    let body = clamped_at_x0(bar([4, 2, 2], [20.0, 10.0, 10.0]), Element::Tet4);
    let end = nodes_where(body.mesh(), |x| x[0] > 20.0 - 1e-9);
    let pull = 3e4 / end.len() as f64;
    let load = |fraction: f64| {
        let mut forces = vec![[0.0; 3]; body.n_nodes()];
        for &node in &end {
            forces[node] = [fraction * pull, 0.0, 0.0];
        }
        Load::from_forces(forces)
    };
    let settings =
        SolveSettings::default().with_load_steps(LoadSteps::Equal(20)).with_max_iterations(120);
    let error = solve(&body, &soft(), &load(1.0), &settings).expect_err("too few iterations");
    let FemError::NoEquilibrium(end) = &error else { panic!("{error}") };
    assert!(end.load_fraction >= 0.05 && end.load_fraction < end.tried_fraction, "{error}");
    assert_says(&error.to_string(), &["iterations and", "factorisations"]);
    assert!(end.factorisations >= 1, "{error}");
    let plain = SolveSettings::default();
    let share = load(end.load_fraction);
    let warm = solve_from(&body, &soft(), &share, &end.displacement, &plain).expect("nearly there");
    let moved = common::largest_difference(&warm.displacement, &end.displacement);
    // Steps before the last are solved to 1e-4 of their load.
    assert!(moved < 1e-3 * common::largest(&warm.displacement), "{moved} mm");
}

#[test]
fn a_load_beyond_all_bounds_is_reported() {
    let body = clamped_at_x0(bar([4, 2, 2], [20.0, 10.0, 10.0]), Element::Tet4);
    let tips = nodes_where(body.mesh(), |x| x[0] > 20.0 - 1e-9);
    let mut forces = vec![[0.0; 3]; body.n_nodes()];
    for tip in tips {
        forces[tip] = [-3e4, 0.0, 0.0];
    }
    let settings = SolveSettings::default().with_max_iterations(400);
    let error = solve(&body, &soft(), &Load::from_forces(forces), &settings).expect_err("crushed");
    assert!(error.is_recoverable());
    let FemError::NoEquilibrium(report) = &error else { panic!("{error}") };
    assert!(report.load_fraction < 1.0 && report.iterations > 0);
    assert!(!report.worst_tets.is_empty() && report.worst_tets.len() <= 5);
    assert_eq!(report.worst_tets[0].det_f, report.min_det_f);
    assert_says(&error.to_string(), &["no equilibrium", "residual", "mN", "smallest det F"]);
}

/// Squares of such forces overflow; an infinite tolerance must not pass for equilibrium.
#[test]
fn a_load_beyond_the_range_of_squares_is_no_equilibrium_at_rest() {
    let body = held_bar();
    for force in [1e160, 1e200, -1e300] {
        let load = Load::from_forces(vec![[0.0, force, 0.0]; 12]);
        for load_steps in [LoadSteps::Auto, LoadSteps::Equal(2)] {
            let settings = SolveSettings::default().with_load_steps(load_steps);
            let error = solve(&body, &soft(), &load, &settings).expect_err("absurd");
            let FemError::NoEquilibrium(report) = &error else { panic!("{error}") };
            assert_eq!(report.load_fraction, 0.0, "{error}");
            assert_says(&error.to_string(), &["unit (mN)"]);
        }
    }
}

/// Factors count as the iterations they cost, so that a hopeless search on a large mesh ends.
#[test]
fn factorisations_of_a_hopeless_search_are_bounded() {
    let body = clamped_at_x0(bar([20, 10, 10], [30.0, 15.0, 15.0]), Element::Tet4);
    let end: Vec<[usize; 3]> = (body.mesh().surface_triangles().iter().copied())
        .filter(|t| t.iter().all(|&n| body.nodes()[n][0] > 30.0 - 1e-9))
        .collect();
    let pull = vec![[200.0, 30.0, 0.0]; end.len()];
    let load = Load::from_forces(body.traction_forces(&end, &pull).expect("facets"));
    let settings = SolveSettings::default().with_max_iterations(600);
    let error = solve(&body, &soft(), &load, &settings).expect_err("twenty times its stiffness");
    let FemError::NoEquilibrium(report) = &error else { panic!("{error}") };
    assert_eq!(report.reason, StopReason::IterationsUsedUp, "{error}");
    assert!(report.iterations < 600, "the factors must have counted: {error}");
    assert!(report.load_fraction > 0.0, "{error}");
}

#[test]
fn too_few_iterations_are_reported() {
    let body = held_bar();
    let weight = Load { body_force: [0.0, 0.0, -0.01], ..Load::default() };
    let settings = SolveSettings::default().with_max_iterations(2);
    let error = solve(&body, &soft(), &weight, &settings).expect_err("too few");
    let FemError::NoEquilibrium(report) = &error else { panic!("{error}") };
    assert_eq!((report.reason, report.iterations), (StopReason::IterationsUsedUp, 2));
    assert_says(&error.to_string(), &["after 2 iterations", "allow more iterations"]);
}

#[test]
fn a_failed_member_leaves_the_others_alone() {
    let body = held_bar();
    let (material, wrong) = (soft(), Load::from_forces(vec![[0.0; 3]; 2]));
    let weight = Load { body_force: [0.0, 0.0, -0.001], ..Load::default() };
    let member = |load| Member { material: &material, load, start: None };
    let progress = Arc::new(AtomicUsize::new(0));
    let settings = SolveSettings::default().with_progress(Arc::clone(&progress));
    let members = [member(&weight), member(&wrong), member(&weight)];
    let outcomes = solve_many(&body, &members, &settings);
    assert!(outcomes[0].solution().is_some() && outcomes[2].solution().is_some());
    assert_eq!(
        outcomes[0].solution().map(|s| &s.displacement),
        outcomes[2].solution().map(|s| &s.displacement)
    );
    assert!(matches!(outcomes[1].error(), Some(FemError::WrongLength { .. })));
    assert_eq!(progress.load(Ordering::Relaxed), 3);
}

#[test]
fn a_raised_flag_cancels_within_a_second() {
    let body = clamped_at_x0(bar([20, 10, 10], [40.0, 20.0, 20.0]), Element::Tet4);
    let material = soft();
    let weight = Load { body_force: [0.0, 0.0, -0.01], ..Load::default() };
    let flag = Arc::new(AtomicBool::new(false));
    let settings = SolveSettings::default().with_cancel(Arc::clone(&flag));
    let members = vec![Member { material: &material, load: &weight, start: None }; 400];
    let raised = std::thread::scope(|scope| {
        let solving = scope.spawn(|| solve_many(&body, &members, &settings));
        std::thread::sleep(Duration::from_millis(100));
        flag.store(true, Ordering::Relaxed);
        let raised = Instant::now();
        let outcomes = solving.join().expect("no panic");
        assert_eq!(outcomes.len(), 400);
        assert_eq!(outcomes[399].error(), Some(&FemError::Cancelled));
        raised.elapsed()
    });
    assert!(raised < Duration::from_secs(1), "{raised:?}");
    let error = solve(&body, &material, &weight, &settings).expect_err("the flag is still up");
    assert_eq!((error.clone(), error.is_recoverable()), (FemError::Cancelled, false));
    assert_says(&error.to_string(), &["cancelled"]);
}

fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        10 => -10.0..10.0,
        1 => Just(0.0),
        1 => Just(f64::NAN),
        1 => Just(1e300),
        1 => Just(-1e-300),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_meshes_never_panic(
        nodes in prop::collection::vec([coordinate(), coordinate(), coordinate()], 0..9),
        tets in prop::collection::vec([0usize..9, 0..9, 0..9, 0..9], 0..9),
        held in prop::collection::vec(0usize..9, 0..5),
        young in coordinate(),
        poisson in -1.5..1.0,
    ) {
        if let Ok(mesh) = Mesh::new(nodes, tets)
            && let Ok(body) = Body::new(mesh, Element::Tet10, held)
            && let Ok(material) = Material::neo_hookean(young, poisson)
        {
            let settings = SolveSettings::default().with_max_iterations(50);
            let load = Load { body_force: [0.0, 0.0, 1e-3], ..Load::default() };
            let _ = solve(&body, &material, &load, &settings);
        }
    }

    #[test]
    fn damaged_bars_never_panic(
        node in 0usize..12,
        shift in [-15.0..15.0, -15.0..15.0, -15.0..15.0],
        tet in 0usize..12,
        drop in any::<bool>(),
        force in [-1e4..1e4, -1e4..1e4, -1e4..1e4],
        held in prop::collection::vec(0usize..12, 0..6),
    ) {
        let (mut nodes, mut tets) = bar_arrays(CELLS, SIZE);
        for i in 0..3 {
            nodes[node][i] += shift[i];
        }
        if drop {
            tets.remove(tet);
        }
        if let Ok(mesh) = Mesh::new(nodes, tets) && let Ok(body) = Body::new(mesh, Element::Tet4, held) {
            let mut forces = vec![[0.0; 3]; 12];
            forces[11] = force;
            let settings = SolveSettings::default().with_max_iterations(60);
            match solve(&body, &soft(), &Load::from_forces(forces), &settings) {
                Ok(answer) => prop_assert!(answer.report.residual <= answer.report.tolerance),
                Err(error) => prop_assert!(error.is_recoverable(), "{}", error),
            }
        }
    }
}
