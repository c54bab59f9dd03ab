//! What must not matter: the frame, the order of nodes and tetrahedra, the unit system, the
//! number of threads, the other members, the path to the load.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{
    Random, bar, bar_arrays, clamped_at_x0, dome, largest, largest_difference, nodes_where,
};
use tissuereg_fem::{
    Body, Element, Load, LoadSteps, Material, Member, Mesh, Method, SolveSettings, Stiffness,
    solve, solve_from, solve_many,
};

fn tip_load(body: &Body, force: [f64; 3]) -> Load {
    let far = body.mesh().nodes().iter().map(|x| x[0]).fold(0.0, f64::max);
    let tips = nodes_where(body.mesh(), |x| x[0] > far - 1e-9);
    let mut forces = vec![[0.0; 3]; body.n_corner_nodes()];
    for &tip in &tips {
        forces[tip] = force.map(|v| v / tips.len() as f64);
    }
    Load::from_forces(forces)
}

#[test]
fn a_rigid_motion_costs_no_energy() {
    for element in [Element::Tet4, Element::Tet10] {
        let body = clamped_at_x0(bar([3, 2, 2], [15.0, 10.0, 10.0]), element);
        let material = Material::neo_hookean(10.0, 0.45).expect("sound");
        // A quarter of a turn about z and a shift, in steps that no element survives otherwise.
        let (s, c) = 0.5_f64.sin_cos();
        let rigid = |x: &[f64; 3]| {
            [c * x[0] - s * x[1] - x[0] + 3.0, s * x[0] + c * x[1] - x[1] - 2.0, 1.0]
        };
        let rows = body.held_nodes().iter().map(|&n| rigid(&body.nodes()[n])).collect();
        let answer =
            solve(&body, &material, &Load::from_prescribed(rows), &SolveSettings::default())
                .expect("a rigid motion");
        let exact: Vec<[f64; 3]> = body.nodes().iter().map(rigid).collect();
        assert!(largest_difference(&answer.displacement, &exact) < 1e-9);
        assert!(answer.report.strain_energy.abs() < 1e-12);
        assert!(largest(&answer.reactions) < 1e-8);
    }
}

#[test]
fn the_order_of_nodes_and_tetrahedra_does_not_matter() {
    let (nodes, tets) = bar_arrays([4, 2, 2], [20.0, 10.0, 10.0]);
    let n = nodes.len();
    // Multiplication by a number prime to n permutes.
    let new = |node: usize| (node * 7 + 3) % n;
    let mut moved = vec![[0.0; 3]; n];
    for (node, x) in nodes.iter().enumerate() {
        moved[new(node)] = *x;
    }
    let turned: Vec<[usize; 4]> =
        tets.iter().rev().map(|&[a, b, c, d]| [new(b), new(c), new(a), new(d)]).collect();
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    for element in [Element::Tet4, Element::Tet10] {
        let run = |mesh: Mesh| {
            let body = clamped_at_x0(mesh, element);
            let load = tip_load(&body, [5.0, 0.0, -10.0]);
            solve(&body, &material, &load, &SolveSettings::default()).expect("bends").displacement
        };
        let first = run(Mesh::new(nodes.clone(), tets.clone()).expect("sound"));
        let second = run(Mesh::new(moved.clone(), turned.clone()).expect("sound"));
        for node in 0..n {
            let error = largest_difference(&[first[node]], &[second[new(node)]]);
            assert!(error < 1e-7, "{element:?} node {node}: {error}");
        }
    }
}

#[test]
fn metres_and_pascals_give_the_same_shape() {
    let run = |length: f64, stiffness: f64| {
        let mesh = bar([4, 2, 2], [20.0 * length, 10.0 * length, 10.0 * length]);
        let held = nodes_where(&mesh, |x| x[0] < 1e-12);
        let body = Body::new(mesh, Element::Tet4, held).expect("held");
        let tips = nodes_where(body.mesh(), |x| x[0] > 19.99 * length);
        let mut forces = vec![[0.0; 3]; body.n_nodes()];
        for &t in &tips {
            forces[t] = [0.0, 0.0, -3.0 * stiffness * length * length];
        }
        let material = Material::neo_hookean(10.0 * stiffness, 0.45).expect("sound");
        let answer = solve(&body, &material, &Load::from_forces(forces), &SolveSettings::default())
            .expect("bends");
        answer.displacement.iter().map(|u| u.map(|v| v / length)).collect::<Vec<_>>()
    };
    let reference = run(1.0, 1.0);
    for (length, stiffness) in [(1e-3, 1e3), (1e3, 1e-9), (25.4, 1e9)] {
        let error = largest_difference(&reference, &run(length, stiffness));
        assert!(error < 1e-7 * largest(&reference), "{length} {stiffness}: {error}");
    }
}

#[test]
fn methods_steps_and_starts_lead_to_the_same_equilibrium() {
    let body = clamped_at_x0(bar([6, 2, 2], [30.0, 10.0, 10.0]), Element::Tet4);
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let load = tip_load(&body, [5.0, 5.0, -30.0]);
    let with = |method, load_steps| {
        SolveSettings::default().with_method(method).with_load_steps(load_steps)
    };
    let reference =
        solve(&body, &material, &load, &with(Method::Auto, LoadSteps::Auto)).expect("bends");
    assert!(largest(&reference.displacement) > 5.0, "{}", largest(&reference.displacement));
    for method in [Method::Auto, Method::Newton, Method::QuasiNewton] {
        for steps in [LoadSteps::Auto, LoadSteps::Equal(5)] {
            let settings = with(method, steps);
            let other = solve(&body, &material, &load, &settings).expect("bends");
            let error = largest_difference(&reference.displacement, &other.displacement);
            assert!(error < 1e-6, "{method:?} {steps:?}: {error}");
            let start: Vec<[f64; 3]> =
                reference.displacement.iter().map(|u| u.map(|v| 0.9 * v)).collect();
            let again = solve_from(&body, &material, &load, &start, &settings).expect("bends");
            let error = largest_difference(&reference.displacement, &again.displacement);
            assert!(error < 1e-6, "{method:?} {steps:?} from a start: {error}");
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let mesh = dome(14);
    assert!(mesh.n_tets() > 4000, "large enough to be solved in parallel");
    let held = nodes_where(&mesh, |x| x[2] < 1e-9);
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let load = Load { body_force: [2e-3, 0.0, -9.81e-3], ..Load::default() };
    for element in [Element::Tet4] {
        let answers: Vec<_> = [1, 2, 3]
            .map(|n_threads| {
                let body = Body::new(mesh.clone(), element, &held).expect("held");
                let settings = SolveSettings::default().with_n_threads(n_threads);
                solve(&body, &material, &load, &settings).expect("sinks")
            })
            .into();
        for other in &answers[1..] {
            assert_eq!(answers[0].displacement, other.displacement);
            assert_eq!(answers[0].reactions, other.reactions);
            assert_eq!(answers[0].report.evaluations, other.report.evaluations);
        }
    }
}

#[test]
fn a_member_depends_neither_on_its_batch_nor_on_the_threads() {
    let body = clamped_at_x0(bar([6, 3, 3], [30.0, 10.0, 10.0]), Element::Tet4);
    let mut random = Random::new(9);
    let field: Vec<f64> = (0..body.n_tets()).map(|_| 10.0 + 5.0 * random.next()).collect();
    let per_tet = |scale: f64| {
        let young = field.iter().map(|v| scale * v).collect();
        Material::new(Stiffness::PerTet { young, poisson: vec![0.4] }).expect("sound")
    };
    let materials: Vec<Material> = [5.0, 10.0, 30.0]
        .map(|young| Material::neo_hookean(young, 0.45).expect("sound"))
        .into_iter()
        .chain([per_tet(1.0), per_tet(3.7), Material::neo_hookean(8.0, 0.3).expect("sound")])
        .collect();
    let loads: Vec<Load> =
        (0..6).map(|k| tip_load(&body, [0.0, f64::from(k), -6.0 - f64::from(k)])).collect();
    let members: Vec<Member> = materials
        .iter()
        .zip(&loads)
        .map(|(material, load)| Member { material, load, start: None })
        .collect();
    let run = |n_threads, members: &[Member]| {
        let settings = SolveSettings::default().with_n_threads(n_threads);
        solve_many(&body, members, &settings)
            .into_iter()
            .map(|o| o.solution().expect("bends").displacement.clone())
            .collect::<Vec<_>>()
    };
    let reference = run(1, &members);
    assert_eq!(reference, run(2, &members));
    assert_eq!(reference, run(4, &members));
    let backwards: Vec<Member> = members.iter().rev().copied().collect();
    let mut turned = run(2, &backwards);
    turned.reverse();
    assert_eq!(reference, turned);
    for (member, whole) in members.iter().zip(&reference) {
        let alone = solve(&body, member.material, member.load, &SolveSettings::default());
        assert_eq!(&alone.expect("bends").displacement, whole);
    }
}

#[test]
fn a_field_of_equal_values_is_a_uniform_material() {
    let body = clamped_at_x0(bar([4, 2, 2], [20.0, 10.0, 10.0]), Element::Tet10);
    let load = tip_load(&body, [0.0, 0.0, -5.0]);
    let uniform = Material::neo_hookean(10.0, 0.45).expect("sound");
    let n = body.n_tets();
    let field = Stiffness::PerTet { young: vec![10.0; n], poisson: vec![0.45; n] };
    let field = Material::new(field).expect("sound");
    let settings = SolveSettings::default();
    let answers =
        [&uniform, &field].map(|m| solve(&body, m, &load, &settings).expect("bends").displacement);
    assert_eq!(answers[0], answers[1]);
}

/// A quarter of a turn of one end against the other in load steps: far beyond what one step survives.
#[test]
fn a_bar_can_be_twisted_by_its_ends() {
    let mesh = bar([8, 2, 2], [40.0, 10.0, 10.0]);
    let ends = nodes_where(&mesh, |x| x[0] < 1e-9 || x[0] > 40.0 - 1e-9);
    let body = Body::new(mesh, Element::Tet4, &ends).expect("held");
    let (s, c) = 1.5_f64.sin_cos();
    let turn = |x: &[f64; 3]| {
        let (y, z) = (x[1] - 5.0, x[2] - 5.0);
        [0.0, c * y - s * z - y, s * y + c * z - z]
    };
    let rows = ends.iter().map(|&n| match body.nodes()[n] {
        x if x[0] > 20.0 => turn(&x),
        _ => [0.0; 3],
    });
    let load = Load::from_prescribed(rows.collect());
    let material = Material::neo_hookean(10.0, 0.4).expect("sound");
    let moment = |method, load_steps| {
        let settings = SolveSettings::default().with_method(method).with_load_steps(load_steps);
        let answer = solve(&body, &material, &load, &settings).expect("twists");
        let moment: f64 = ends
            .iter()
            .zip(&answer.reactions)
            .filter(|(n, _)| body.nodes()[**n][0] > 20.0)
            .map(|(&n, r)| {
                let x: [f64; 3] =
                    std::array::from_fn(|i| body.nodes()[n][i] + answer.displacement[n][i] - 5.0);
                x[1] * r[2] - x[2] * r[1]
            })
            .sum();
        moment
    };
    let reference = moment(Method::Auto, LoadSteps::Auto);
    assert!(reference > 100.0, "{reference} mN mm");
    for method in [Method::Auto, Method::Newton] {
        let other = moment(method, LoadSteps::Equal(8));
        assert!((other / reference - 1.0).abs() < 1e-6, "{method:?}: {other} {reference}");
    }
}
