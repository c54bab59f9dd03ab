//! Springs on the surface: closed forms, derivatives, equilibrium of forces.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{Random, bar, dome, largest, nodes_where};
use tissuereg_fem::{
    Body, Element, FemError, Load, Material, Mesh, SolveSettings, Springs, Supports, resultant,
    solve,
};

const BOTH: [Element; 2] = [Element::Tet4, Element::Tet10];

fn settings() -> SolveSettings {
    SolveSettings::default().with_tolerance(1e-11)
}

/// Facets of the surface all of whose corners satisfy a condition.
fn facets(mesh: &Mesh, holds: impl Fn(&[f64; 3]) -> bool) -> Vec<[usize; 3]> {
    let all = mesh.surface_triangles().iter();
    all.filter(|t| t.iter().all(|&n| holds(&mesh.nodes()[n]))).copied().collect()
}

/// Mean displacement over facets of equal area: the mean of corners, or of mid-edge nodes.
fn mean_over(body: &Body, facets: &[[usize; 3]], u: &[[f64; 3]]) -> [f64; 3] {
    let carriers = |t: &[usize; 3]| -> Vec<usize> {
        let pairs = [[t[0], t[1]], [t[1], t[2]], [t[0], t[2]]].map(|[a, b]| [a.min(b), a.max(b)]);
        let edges = body.mid_edges();
        if edges.is_empty() {
            return t.to_vec();
        }
        let own = (0..edges.len()).filter(|&e| pairs.contains(&edges[e]));
        own.map(|e| body.n_corner_nodes() + e).collect()
    };
    let nodes: Vec<usize> = facets.iter().flat_map(carriers).collect();
    std::array::from_fn(|i| nodes.iter().map(|&n| u[n][i]).sum::<f64>() / nodes.len() as f64)
}

#[test]
fn a_block_on_springs_sinks_by_weight_over_stiffness() {
    for element in BOTH {
        let mesh = bar([3, 2, 2], [30.0, 20.0, 10.0]);
        let bed = Springs {
            triangles: facets(&mesh, |x| x[2] < 1e-9),
            normal: 0.05,
            tangential: 0.02,
            friction: None,
        };
        let body =
            Body::new(mesh, element, Supports::new().rest_on(&bed)).expect("stands on springs");
        let material = Material::neo_hookean(500.0, 0.3).expect("sound");
        let weight = [2e-3, 0.0, -9.81e-3];
        let load = Load { body_force: weight, springs: vec![bed.clone()], ..Load::default() };
        let answer = solve(&body, &material, &load, &settings()).expect("stands");
        let volume = 6000.0;
        let sunk = mean_over(&body, &bed.triangles, &answer.displacement);
        assert!((sunk[2] - weight[2] * volume / (0.05 * 600.0)).abs() < 1e-7, "{element:?}");
        assert!((sunk[0] - weight[0] * volume / (0.02 * 600.0)).abs() < 1e-7, "{element:?}");
        let held = resultant(body.nodes(), &answer.spring_forces[0], [0.0; 3]);
        for i in 0..3 {
            assert!((held.force[i] + weight[i] * volume).abs() < 1e-6, "{:?}", held.force);
        }
    }
}

/// A pressure all round has no resultant; on one face it is pressure times area.
#[test]
fn a_dead_pressure_pushes_against_the_outward_normal() {
    for element in BOTH {
        let mesh = dome(6);
        let base = nodes_where(&mesh, |x| x[2] < 1e-9);
        let flat = facets(&mesh, |x| x[2] < 1e-9);
        let body = Body::new(mesh, element, base).expect("held");
        let all = body.mesh().surface_triangles().to_vec();
        let round = body.pressure_forces(&all, &vec![2.0; all.len()]).expect("on the surface");
        let sum = resultant(body.nodes(), &round, [0.0; 3]);
        assert!(sum.force.iter().all(|f| f.abs() < 1e-8), "{sum:?}");
        // Triangles may be given in any order of their corners.
        let turned: Vec<[usize; 3]> = flat.iter().map(|t| [t[1], t[0], t[2]]).collect();
        let below = body.pressure_forces(&turned, &vec![2.0; flat.len()]).expect("on the surface");
        let sum = resultant(body.nodes(), &below, [0.0; 3]);
        assert!(sum.force[2] > 2.0 * 0.9 * 3.1 * 3600.0 && sum.force[0].abs() < 1e-8, "{sum:?}");
        let short = body.pressure_forces(&flat, &[1.0]).expect_err("one pressure");
        assert!(matches!(short, FemError::WrongLength { .. }), "{short}");
        let inside = body.pressure_forces(&[[0, 1, 2]], &[1.0]).expect_err("no facet");
        assert!(matches!(inside, FemError::NotOnSurface { row: 0, .. }), "{inside}");
    }
}

#[test]
fn springs_that_leave_a_rigid_motion_free_are_named() {
    let mesh = bar([2, 2, 2], [10.0; 3]);
    let triangles = facets(&mesh, |x| x[2] < 1e-9);
    let gliding =
        Springs { triangles: triangles.clone(), normal: 1.0, tangential: 0.0, friction: None };
    let error = Body::new(mesh, Element::Tet4, Supports::new().rest_on(&gliding))
        .expect_err("glides")
        .to_string();
    assert!(error.contains("translation x, translation y, rotation about z"), "{error}");

    let mesh = bar([2, 2, 2], [10.0; 3]);
    let bed = Springs { triangles, normal: 1.0, tangential: 1.0, friction: None };
    let body = Body::new(mesh, Element::Tet4, Supports::new().rest_on(&bed)).expect("stands");
    let material = Material::neo_hookean(10.0, 0.3).expect("sound");
    let error = solve(&body, &material, &Load::default(), &settings()).expect_err("no springs");
    assert!(matches!(error, FemError::MissingSprings { .. }), "{error}");
    assert!(error.to_string().contains("no such springs"));
}

#[test]
fn wrong_springs_are_named() {
    let mesh = bar([2, 2, 2], [10.0; 3]);
    let body = common::clamped_at_x0(mesh, Element::Tet4);
    let material = Material::neo_hookean(10.0, 0.3).expect("sound");
    let with = |springs: Springs| {
        let load = Load { springs: vec![springs], ..Load::default() };
        solve(&body, &material, &load, &settings()).expect_err("wrong").to_string()
    };
    let negative =
        with(Springs { triangles: vec![], normal: -1.0, tangential: 0.0, friction: None });
    assert!(negative.contains("`springs.normal`") && negative.contains("-1"), "{negative}");
    let nan =
        with(Springs { triangles: vec![], normal: 0.0, tangential: f64::NAN, friction: None });
    assert!(nan.contains("`springs.tangential`"), "{nan}");
    let inside =
        with(Springs { triangles: vec![[0, 1, 26]], normal: 1.0, tangential: 1.0, friction: None });
    assert!(inside.contains("no facet"), "{inside}");
}

/// Forces of springs against differences of the energy, and quadratic convergence of Newton's
/// method, which only the right tangent has.
#[test]
fn forces_and_tangent_of_springs_are_derivatives() {
    for element in BOTH {
        let mesh = bar([2, 1, 1], [20.0, 10.0, 10.0]);
        let top = facets(&mesh, |x| x[2] > 9.0);
        let springs = Springs { triangles: top, normal: 0.8, tangential: 0.3, friction: None };
        let all: Vec<usize> = (0..mesh.n_nodes()).collect();
        let body = Body::new(mesh, element, all).expect("held");
        let material = Material::neo_hookean(10.0, 0.4).expect("sound");
        let mut random = Random::new(5);
        let u: Vec<[f64; 3]> = (0..body.n_corner_nodes())
            .map(|_| std::array::from_fn(|_| 1.5 * random.next()))
            .collect();
        let at = |u: Vec<[f64; 3]>| {
            let load =
                Load { prescribed: Some(u), springs: vec![springs.clone()], ..Load::default() };
            solve(&body, &material, &load, &settings()).expect("upright")
        };
        let forces = at(u.clone()).reactions;
        for (node, i) in [(1, 0), (3, 2), (5, 1), (7, 2), (11, 0)] {
            let energy = |d: f64| {
                let mut moved = u.clone();
                moved[node][i] += d;
                at(moved).report.strain_energy
            };
            let slope = (energy(1e-4) - energy(-1e-4)) / 2e-4;
            assert!((slope - forces[node][i]).abs() < 1e-5 * (1.0 + slope.abs()), "{element:?}");
        }
    }
}

#[test]
fn newton_converges_on_springs() {
    for element in BOTH {
        let mesh = dome(6);
        let base = facets(&mesh, |x| x[2] < 1e-9);
        let bed = Springs { triangles: base, normal: 0.1, tangential: 0.05, friction: None };
        let body = Body::new(mesh, element, Supports::new().rest_on(&bed)).expect("stands");
        let material = Material::neo_hookean(5.0, 0.45).expect("sound");
        let load =
            Load { body_force: [5e-3, 0.0, -9.81e-3], springs: vec![bed], ..Load::default() };
        let newton = settings().with_method(tissuereg_fem::Method::Newton);
        let by_newton = solve(&body, &material, &load, &newton).expect("stands");
        assert!(by_newton.report.iterations <= 12, "{:?}", by_newton.report);
        let by_default = solve(&body, &material, &load, &settings()).expect("stands");
        let apart = common::largest_difference(&by_newton.displacement, &by_default.displacement);
        assert!(apart < 1e-6 * largest(&by_default.displacement), "{apart}");
        let carried = resultant(body.nodes(), &by_default.spring_forces[0], [0.0; 3]).force;
        let weight = body.mesh().volume() * 9.81e-3;
        assert!((carried[2] - weight).abs() < 1e-6 * weight, "{carried:?} {weight}");
    }
}

#[test]
fn springs_of_members_count_in_an_ensemble() {
    let mesh = bar([2, 2, 2], [10.0; 3]);
    let triangles = facets(&mesh, |x| x[0] > 10.0 - 1e-9);
    let body = common::clamped_at_x0(mesh, Element::Tet4);
    let material = Material::neo_hookean(10.0, 0.3).expect("sound");
    let loads = [0.0, 1.0, 50.0].map(|normal| Load {
        body_force: [0.05, 0.0, 0.0],
        springs: vec![Springs {
            triangles: triangles.clone(),
            normal,
            tangential: 0.0,
            friction: None,
        }],
        ..Load::default()
    });
    let members: Vec<tissuereg_fem::Member> = loads
        .iter()
        .map(|load| tissuereg_fem::Member { material: &material, load, start: None })
        .collect();
    let many = tissuereg_fem::solve_many(&body, &members, &settings());
    for (load, outcome) in loads.iter().zip(&many) {
        let alone = solve(&body, &material, load, &settings()).expect("stands");
        let solved = outcome.solution().expect("stands");
        assert!(common::largest_difference(&alone.displacement, &solved.displacement) < 1e-9);
    }
    let ends: Vec<f64> =
        many.iter().filter_map(|o| o.solution()).map(|s| s.displacement[26][0]).collect();
    assert!(ends[0] > 1.5 * ends[1] && ends[1] > 10.0 * ends[2], "{ends:?}");
}
