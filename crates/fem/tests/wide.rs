//! Many right-hand sides at once: the same as one by one, the same bits in any batch.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{Random, bar, clamped_at_x0, dome, largest_difference, nodes_where};
use tissuereg_fem::material::Parameter;
use tissuereg_fem::{
    Body, Cause, Compliance, Element, FemError, Linearised, Load, Material, Method, Observation,
    Precision, SolveSettings, Springs, Stiffness, Supports, solve, spring_forces,
};

const ALL: [Element; 3] = [Element::Tet4, Element::Tet4Averaged, Element::Tet10];
const BOTH: [Precision; 2] = [Precision::Double, Precision::Single];

fn tight() -> SolveSettings {
    SolveSettings::default().with_tolerance(1e-12).with_method(Method::Newton)
}

fn on_threads(n_threads: usize) -> SolveSettings {
    tight().with_n_threads(n_threads)
}

fn at<'a>(
    body: &'a Body,
    material: &Material,
    load: &Load,
    settings: &SolveSettings,
    precision: Precision,
) -> Linearised<&'a Body> {
    let u = solve(body, material, load, &tight()).expect("stands").displacement;
    Linearised::in_precision(body, material, load, &u, settings, precision).expect("stable")
}

/// A bar on rollers and springs, with a stiffness that varies.
fn rich(element: Element) -> (Body, Material, Load) {
    let mesh = bar([4, 2, 2], [18.0, 6.0, 6.0]);
    let end = nodes_where(&mesh, |x| x[0] < 1e-9);
    let edge = nodes_where(&mesh, |x| x[0] > 18.0 - 1e-9 && x[2] < 1e-9);
    let supports = Supports::new().hold(&end).hold_axes(&edge, [false, true, true]);
    let body = Body::new(mesh, element, supports).expect("held");
    let side = |z: f64| -> Vec<[usize; 3]> {
        let mesh = body.mesh();
        let on = |t: &&[usize; 3]| t.iter().all(|&n| (mesh.nodes()[n][2] - z).abs() < 1e-9);
        mesh.surface_triangles().iter().filter(on).copied().collect()
    };
    let mut random = Random::new(5);
    let n_points = element.n_points();
    let young = (0..body.n_tets() * n_points).map(|_| 10.0 + 4.0 * random.next()).collect();
    let field = Stiffness::PerPoint { n_points, young, poisson: vec![0.42] };
    let material = Material::new(field).expect("sound");
    let bed = Springs { triangles: side(0.0), normal: 0.2, tangential: 0.1, friction: None };
    let rows = body
        .held_nodes()
        .iter()
        .map(|&n| if body.nodes()[n][0] < 1.0 { [0.0; 3] } else { [0.0, 0.3, -0.2] });
    let load = Load {
        body_force: [0.02, -0.01, -0.05],
        prescribed: Some(rows.collect()),
        springs: vec![bed],
        ..Load::default()
    };
    (body, material, load)
}

fn observations(body: &Body, n: usize) -> Vec<Observation> {
    let mut random = Random::new(11);
    let row = |random: &mut Random| (random.below(body.n_nodes()), random.vector(1.0));
    let one = |_| Observation::of_displacement((0..3).map(|_| row(&mut random)));
    (0..n).map(one).collect()
}

fn dot(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(x, y)| x * y).sum()
}

fn size(rows: &[[f64; 3]]) -> f64 {
    rows.as_flattened().iter().fold(0.0, |m, v| m.max(v.abs()))
}

#[test]
fn the_compliance_is_the_part_of_the_adjoints_by_forces_and_supports() {
    for element in ALL {
        let (body, material, load) = rich(element);
        // Two held nodes among those seen, and one that is held along two axes.
        let mut seen = observations(&body, 19);
        seen[4].displacement.push((body.held_nodes()[1], [0.3, -0.2, 0.9]));
        seen[5].displacement.push((*body.held_nodes().last().expect("held"), [0.5, 0.4, 0.1]));
        let reference = at(&body, &material, &load, &tight(), Precision::Double);
        let adjoints = reference.adjoints(&seen).expect("adjoints");
        for (precision, share) in BOTH.into_iter().zip([1e-11, 1e-8]) {
            let here = at(&body, &material, &load, &tight(), precision);
            assert_eq!(here.report().precision, precision, "{element:?}");
            let found = here.compliance(&seen).expect("a compliance");
            let forces = found.nodal_forces.chunks_exact(body.n_nodes());
            let prescribed = found.prescribed.chunks_exact(body.held_nodes().len());
            for (k, ((adjoint, forces), prescribed)) in
                adjoints.iter().zip(forces).zip(prescribed).enumerate()
            {
                for (name, found, wanted) in [
                    ("forces", forces, adjoint.nodal_forces.as_slice()),
                    ("prescribed", prescribed, adjoint.prescribed.as_slice()),
                    ("body force", &found.body_force[k..=k], &[adjoint.body_force]),
                ] {
                    let off = largest_difference(found, wanted);
                    assert!(
                        off <= share * size(wanted),
                        "{element:?} {precision:?} {name}: {off:e}"
                    );
                    assert!(size(wanted) > 0.0);
                }
            }
        }
    }
}

#[test]
fn a_single_factor_serves_derivatives_and_adjoints_too() {
    let (body, material, load) = rich(Element::Tet10);
    let causes = [Cause::Parameter(Parameter::Young), Cause::SpringNormal(0)];
    let seen = observations(&body, 2);
    let [double, single] = BOTH.map(|p| at(&body, &material, &load, &tight(), p));
    let [one, other] = [&double, &single].map(|at| at.derivatives(&causes).expect("derivatives"));
    for (a, b) in one.iter().zip(&other) {
        assert!(
            largest_difference(&a.displacement, &b.displacement) < 1e-8 * size(&a.displacement)
        );
        assert!(largest_difference(&a.reactions, &b.reactions) < 1e-8 * size(&a.reactions));
    }
    let [one, other] = [&double, &single].map(|at| at.adjoints(&seen).expect("adjoints"));
    for (a, b) in one.iter().zip(&other) {
        assert!(
            largest_difference(&a.nodal_forces, &b.nodal_forces) < 1e-8 * size(&a.nodal_forces)
        );
    }
}

#[test]
fn responses_are_the_derivatives_by_loads() {
    for element in ALL {
        let (body, material, load) = rich(element);
        let mut random = Random::new(3);
        let n = 9;
        let forces: Vec<[f64; 3]> = (0..n * body.n_nodes()).map(|_| random.vector(1.0)).collect();
        let causes: Vec<Cause> = forces
            .chunks_exact(body.n_nodes())
            .map(|rows| Cause::Load(Load::from_forces(rows.to_vec())))
            .collect();
        for (precision, share) in BOTH.into_iter().zip([1e-11, 1e-8]) {
            let here = at(&body, &material, &load, &tight(), precision);
            let found = here.responses(&forces).expect("responses");
            let wanted = here.derivatives(&causes).expect("derivatives");
            for (found, wanted) in found.chunks_exact(body.n_nodes()).zip(&wanted) {
                let off = largest_difference(found, &wanted.displacement);
                assert!(off < share * size(&wanted.displacement), "{element:?} {off:e}");
            }
        }
    }
}

/// `−compliance · unbalanced` against derivatives of the same causes.
#[test]
fn unbalanced_forces_times_the_compliance_are_the_derivatives() {
    for element in ALL {
        let (body, material, load) = rich(element);
        let mut random = Random::new(17);
        let n = body.n_tets() * element.n_points();
        let mut field = || (0..n).map(|_| random.next()).collect::<Vec<f64>>();
        let moved = body.held_nodes().iter().map(|&n| [0.1, 0.2, 0.3 + 0.01 * n as f64]);
        let causes = [
            Cause::YoungField(field()),
            Cause::YoungField(field()),
            Cause::PoissonField(field()),
            Cause::Parameter(Parameter::Poisson),
            Cause::SpringTangential(0),
            Cause::Load(Load::from_prescribed(moved.collect())),
        ];
        let here = at(&body, &material, &load, &tight(), Precision::Double);
        let mut free: Vec<usize> = (0..body.n_corner_nodes()).collect();
        free.retain(|n| !body.held_nodes().contains(n));
        let row = |k: usize| (free[(7 * k) % free.len()], [1.0, -0.5, 0.1 * k as f64]);
        let seen: Vec<Observation> =
            (0..5).map(|k| Observation::of_displacement([row(k), row(k + 9)])).collect();
        let Compliance { nodal_forces, .. } = here.compliance(&seen).expect("a compliance");
        let unbalanced = here.unbalanced(&causes).expect("forces");
        let derivatives = here.derivatives(&causes).expect("derivatives");
        for (c, wanted) in derivatives.iter().enumerate() {
            let force = &unbalanced[c * body.n_nodes()..(c + 1) * body.n_nodes()];
            for (o, observation) in seen.iter().enumerate() {
                let by_force = &nodal_forces[o * body.n_nodes()..(o + 1) * body.n_nodes()];
                let found = -dot(by_force, force);
                let rows = observation.displacement.iter();
                let wanted_here: f64 =
                    rows.map(|(n, w)| dot(&[*w], &[wanted.displacement[*n]])).sum();
                let off = (found - wanted_here).abs();
                assert!(off < 1e-9 * size(&wanted.displacement), "{element:?} {c}: {off:e}");
            }
        }
    }
}

/// Large enough that subtrees are worth a second thread.
#[test]
fn the_bits_depend_neither_on_threads_nor_on_the_batch() {
    let mesh = dome(14);
    let held = nodes_where(&mesh, |x| x[2] < 1e-9);
    let body = Body::new(mesh, Element::Tet4, held).expect("held");
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let load = Load { body_force: [4e-3, 0.0, -9.81e-3], ..Load::default() };
    let seen = observations(&body, 37);
    for precision in BOTH {
        let one = at(&body, &material, &load, &on_threads(1), precision);
        let whole = one.compliance(&seen).expect("a compliance");
        assert!(size(&whole.nodal_forces) > 0.0);
        for threads in [2, 3] {
            let other = at(&body, &material, &load, &on_threads(threads), precision);
            assert_eq!(other.compliance(&seen).expect("a compliance"), whole, "{threads} threads");
            assert_eq!(other.report(), one.report());
        }
        for each in [1, 5, 8, 16, 20] {
            let batched = at(&body, &material, &load, &on_threads(2), precision);
            let mut joined =
                Compliance { nodal_forces: vec![], body_force: vec![], prescribed: vec![] };
            for batch in seen.chunks(each) {
                let part = batched.compliance(batch).expect("a compliance");
                joined.nodal_forces.extend(part.nodal_forces);
                joined.body_force.extend(part.body_force);
                joined.prescribed.extend(part.prescribed);
            }
            assert_eq!(joined, whole, "{each} at a time");
            assert_eq!(batched.report(), one.report());
        }
        let responses = one.responses(&whole.nodal_forces).expect("responses");
        let two = at(&body, &material, &load, &on_threads(2), precision);
        let n = 3 * body.n_nodes();
        let parts: Vec<[f64; 3]> = [&whole.nodal_forces[..n], &whole.nodal_forces[n..]]
            .iter()
            .flat_map(|part| two.responses(part).expect("responses"))
            .collect();
        assert_eq!(parts, responses);
    }
}

#[test]
fn work_is_counted() {
    let (body, material, load) = rich(Element::Tet4);
    let seen = observations(&body, 20);
    let double = at(&body, &material, &load, &tight(), Precision::Double);
    double.compliance(&seen).expect("a compliance");
    let report = double.report();
    assert_eq!(report.precision, Precision::Double);
    assert_eq!((report.factorisations, report.right_hand_sides, report.corrections), (1, 20, 0));
    let single = at(&body, &material, &load, &tight(), Precision::Single);
    single.compliance(&seen).expect("a compliance");
    single.responses(&vec![[1.0; 3]; body.n_nodes()]).expect("a response");
    let report = single.report();
    assert_eq!((report.factorisations, report.right_hand_sides), (1, 21));
    // One correction each takes an error of 1e-6 to 1e-12.
    assert_eq!(report.corrections, 21);
}

/// A block that next to nothing holds: single precision knows its tangent too badly.
#[test]
fn a_tangent_close_to_singular_is_factored_in_double() {
    let mesh = bar([3, 2, 2], [18.0, 6.0, 6.0]);
    let triangles = mesh.surface_triangles().to_vec();
    let material = Material::neo_hookean(10.0, 0.4).expect("sound");
    for (stiffness, precision, factorisations) in
        [(1e-4, Precision::Single, 1), (1e-5, Precision::Double, 2), (1e-7, Precision::Double, 2)]
    {
        let triangles = triangles.clone();
        let bed = Springs { triangles, normal: stiffness, tangential: stiffness, friction: None };
        let supports = Supports::new().rest_on(&bed);
        let body = Body::new(mesh.clone(), Element::Tet10, supports).expect("rests");
        let load = Load { springs: vec![bed], ..Load::default() };
        let here = at(&body, &material, &load, &tight(), Precision::Single);
        let report = here.report();
        assert_eq!((report.precision, report.factorisations), (precision, factorisations));
        let exact = at(&body, &material, &load, &tight(), Precision::Double);
        let seen = observations(&body, 3);
        let [found, wanted] = [&here, &exact].map(|at| at.compliance(&seen).expect("found"));
        let off = largest_difference(&found.nodal_forces, &wanted.nodal_forces);
        assert!(off < 1e-7 * size(&wanted.nodal_forces), "{stiffness}: {off:e}");
    }
}

#[test]
fn wrong_input_is_named() {
    let (body, material, load) = rich(Element::Tet4);
    let here = at(&body, &material, &load, &tight(), Precision::Single);
    let pulled = Observation::of_reactions([(body.held_nodes()[0], [1.0; 3])]);
    let error = here.compliance(&[pulled]).expect_err("a reaction").to_string();
    assert!(error.contains("is none of displacements alone"), "{error}");
    let outside = Observation::of_displacement([(9999, [1.0; 3])]);
    let error = here.compliance(&[outside]).expect_err("outside").to_string();
    assert!(error.contains("node 9999, which does not exist"), "{error}");
    let endless = Observation::of_displacement([(1, [f64::NAN; 3])]);
    let error = here.compliance(&[endless]).expect_err("NaN");
    assert!(matches!(error, FemError::NonFinite { .. }), "{error}");
    let error = here.responses(&[[1.0; 3]; 5]).expect_err("five rows");
    assert!(matches!(error, FemError::WrongLength { found: 5, .. }), "{error}");
    let error = here.responses(&vec![[f64::INFINITY; 3]; body.n_nodes()]).expect_err("endless");
    assert!(matches!(error, FemError::NonFinite { .. }), "{error}");
    let error = here.unbalanced(&[Cause::YoungField(vec![1.0])]).expect_err("one");
    assert!(matches!(error, FemError::WrongLength { .. }), "{error}");
    assert!(here.responses(&[]).expect("nothing").is_empty());
    assert!(here.compliance(&[]).expect("nothing").nodal_forces.is_empty());
}

#[test]
fn a_load_near_by_takes_few_iterations_and_no_factor() {
    let body = clamped_at_x0(bar([8, 4, 4], [40.0, 20.0, 20.0]), Element::Tet4);
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let pull = |by: f64| Load { body_force: [0.0, 0.0, -0.02 * by], ..Load::default() };
    let settings = SolveSettings::default().with_n_threads(1);
    for precision in BOTH {
        let here = at(&body, &material, &pull(1.0), &settings, precision);
        for (by, most) in [(1.0, 0), (1.1, 8), (1.5, 13), (0.5, 13)] {
            let near = here.solve_near(&pull(by), &settings).expect("near");
            let alone = solve(&body, &material, &pull(by), &settings).expect("alone");
            let off = largest_difference(&near.displacement, &alone.displacement);
            assert!(off < 1e-6 * size(&alone.displacement), "{by}: {off:e}");
            assert_eq!(near.report.factorisations, 1);
            assert!(near.report.iterations <= most, "{by}: {:?}", near.report);
            // Half the load is as far from here as from rest.
            assert!(by < 1.0 || near.report.iterations < alone.report.iterations);
        }
    }
}

/// A block that nothing holds but springs all over its surface.
#[test]
fn a_body_without_held_nodes_rests_on_springs() {
    for element in ALL {
        let mesh = bar([3, 2, 2], [18.0, 6.0, 6.0]);
        let triangles = mesh.surface_triangles().to_vec();
        let bed = Springs { triangles, normal: 0.2, tangential: 0.1, friction: None };
        let body = Body::new(mesh, element, Supports::new().rest_on(&bed)).expect("rests");
        assert_eq!(body.n_unknowns(), 3 * body.n_nodes());
        let material = Material::neo_hookean(10.0, 0.4).expect("sound");
        let mut forces = vec![[0.0; 3]; body.n_nodes()];
        forces[0] = [3.0, -2.0, 5.0];
        let load = Load { springs: vec![bed.clone()], ..Load::from_forces(forces) };
        let here = at(&body, &material, &load, &tight(), Precision::Single);
        let seen = observations(&body, 3);
        let found = here.compliance(&seen).expect("a compliance");
        assert!(found.prescribed.is_empty());
        let adjoints = here.adjoints(&seen).expect("adjoints");
        for (rows, adjoint) in found.nodal_forces.chunks_exact(body.n_nodes()).zip(&adjoints) {
            let off = largest_difference(rows, &adjoint.nodal_forces);
            assert!(off < 1e-8 * size(rows), "{element:?} {off:e}");
        }
        // Its springs carry the load.
        let u = solve(&body, &material, &load, &tight()).expect("stands").displacement;
        let carried = spring_forces(&body, &[bed], &u).expect("forces");
        for i in 0..3 {
            let sum: f64 = carried[0].iter().map(|row| row[i]).sum();
            assert!((sum + [3.0, -2.0, 5.0][i]).abs() < 1e-9, "{sum}");
        }
    }
}
