//! Derivatives of equilibria against central differences of solves, and adjoints against them.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{Random, bar, clamped_at_x0, largest, laws, nodes_where};
use tissuereg_fem::material::{Directions, Fibres, Parameter};
use tissuereg_fem::{
    Body, Cause, Derivative, Element, FemError, Linearised, Load, Material, Method, Observation,
    Solution, SolveSettings, Springs, Stiffness, Supports, solve,
};

const ALL: [Element; 3] = [Element::Tet4, Element::Tet4Averaged, Element::Tet10];

fn tight() -> SolveSettings {
    SolveSettings::default().with_tolerance(1e-12).with_method(Method::Newton)
}

fn answer(body: &Body, material: &Material, load: &Load) -> Solution {
    solve(body, material, load, &tight()).expect("stands")
}

fn at<'a>(body: &'a Body, material: &Material, load: &Load) -> Linearised<&'a Body> {
    let displacement = answer(body, material, load).displacement;
    Linearised::new(body, material, load, &displacement, &tight()).expect("an equilibrium")
}

fn derivative(at: &Linearised<&Body>, cause: Cause) -> Derivative {
    at.derivatives(&[cause]).expect("a derivative").remove(0)
}

/// Fourth-order central difference of solves, as rows of displacement and of reactions.
fn difference(step: f64, solved: impl Fn(f64) -> Solution) -> Derivative {
    let [a, b, c, d] = [-2.0, -1.0, 1.0, 2.0].map(|k| solved(k * step));
    let rows = |pick: fn(&Solution) -> &Vec<[f64; 3]>| {
        let at = |n: usize, i: usize| {
            let far = pick(&d)[n][i] - pick(&a)[n][i];
            (8.0 * (pick(&c)[n][i] - pick(&b)[n][i]) - far) / (12.0 * step)
        };
        (0..pick(&a).len()).map(|n| std::array::from_fn(|i| at(n, i))).collect()
    };
    Derivative { displacement: rows(|s| &s.displacement), reactions: rows(|s| &s.reactions) }
}

fn assert_close(found: &Derivative, wanted: &Derivative, words: &str) {
    for (name, a, b) in [
        ("displacement", &found.displacement, &wanted.displacement),
        ("reactions", &found.reactions, &wanted.reactions),
    ] {
        let off = common::largest_difference(a, b) / largest(b);
        assert!(largest(b) > 0.0 && off < 1e-5, "{words}, {name}: off by {off:.1e}");
    }
}

/// Own weight and an end that is pushed and turned a little: all of the stress counts.
fn pushed(body: &Body, push: f64) -> Load {
    let row = |&n: &usize| {
        let x = body.nodes()[n];
        if x[0] < 1e-9 { [0.0; 3] } else { [push, 0.15 * x[2], 0.5 - 0.1 * x[1]] }
    };
    let prescribed = Some(body.held_nodes().iter().map(row).collect());
    Load { body_force: [0.02, -0.01, -0.05], prescribed, ..Load::default() }
}

/// A bar held at both ends.
fn held_bar(element: Element) -> Body {
    let mesh = bar([3, 1, 1], [18.0, 6.0, 6.0]);
    let ends = nodes_where(&mesh, |x| x[0] < 1e-9 || x[0] > 18.0 - 1e-9);
    Body::new(mesh, element, ends).expect("held")
}

/// Triangles of its upper side.
fn top_of(body: &Body) -> Vec<[usize; 3]> {
    let mesh = body.mesh();
    let above = |t: &&[usize; 3]| t.iter().all(|&n| mesh.nodes()[n][2] > 6.0 - 1e-9);
    mesh.surface_triangles().iter().filter(above).copied().collect()
}

#[test]
fn every_parameter_of_every_law_agrees_with_differences() {
    for element in ALL {
        let body = held_bar(element);
        let load = pushed(&body, 2.0);
        for recipe in laws::recipes() {
            let material = recipe.material().expect("sound");
            let here = at(&body, &material, &load);
            for parameter in material.parameters() {
                let found = derivative(&here, Cause::Parameter(parameter));
                let step = if parameter == Parameter::Poisson { 1e-4 } else { 1e-3 };
                let wanted = difference(step, |by| {
                    answer(&body, &recipe.moved(parameter, by).material().expect("sound"), &load)
                });
                assert_close(
                    &found,
                    &wanted,
                    &format!("{element:?} {} {parameter:?}", recipe.name),
                );
            }
        }
    }
}

#[test]
fn loads_and_springs_agree_with_differences() {
    for element in ALL {
        let body = held_bar(element);
        let top = top_of(&body);
        let material = Material::neo_hookean(10.0, 0.4).expect("sound");
        let springs = |normal, tangential| Springs {
            triangles: top.clone(),
            normal,
            tangential,
            friction: None,
        };
        let base = Load { springs: vec![springs(0.3, 0.2)], ..pushed(&body, 1.5) };
        let here = at(&body, &material, &base);
        let sprung = |normal, tangential| {
            let load = Load { springs: vec![springs(normal, tangential)], ..base.clone() };
            answer(&body, &material, &load)
        };
        for (cause, wanted) in [
            (Cause::SpringNormal(0), difference(1e-3, |d| sprung(0.3 + d, 0.2))),
            (Cause::SpringTangential(0), difference(1e-3, |d| sprung(0.3, 0.2 + d))),
        ] {
            let words = format!("{element:?} {cause:?}");
            assert_close(&derivative(&here, cause), &wanted, &words);
        }
        // Forces, a pressure, a body force and moved supports, together.
        let mut random = Random::new(3);
        let mut forces = body.pressure_forces(&top, &vec![0.4; top.len()]).expect("on the surface");
        forces.iter_mut().flatten().for_each(|f| *f += 0.1 * random.next());
        let rate = Load {
            nodal_forces: Some(forces.clone()),
            body_force: [0.01, 0.02, -0.01],
            prescribed: Some(body.held_nodes().iter().map(|_| random.vector(0.3)).collect()),
            springs: vec![],
        };
        let moved = |d: f64| {
            let add = |a: &[[f64; 3]], b: &[[f64; 3]]| -> Vec<[f64; 3]> {
                let pairs = a.iter().zip(b);
                pairs.map(|(x, y)| std::array::from_fn(|i| x[i] + d * y[i])).collect()
            };
            let held = base.prescribed.as_ref().expect("moved");
            let load = Load {
                nodal_forces: Some(add(&vec![[0.0; 3]; body.n_nodes()], &forces)),
                body_force: add(&[base.body_force], &[rate.body_force])[0],
                prescribed: Some(add(held, rate.prescribed.as_ref().expect("moved"))),
                springs: base.springs.clone(),
            };
            answer(&body, &material, &load)
        };
        let found = derivative(&here, Cause::Load(rate.clone()));
        assert_close(&found, &difference(1e-3, moved), &format!("{element:?} load"));
    }
}

/// Random observations of displacements and reactions against random fields of everything.
#[test]
fn the_adjoint_is_the_transpose_of_the_derivatives() {
    for element in ALL {
        let body = held_bar(element);
        let top = top_of(&body);
        let mut random = Random::new(11);
        let n_points = element.n_points();
        let n = body.n_tets() * n_points;
        let young = (0..n).map(|_| 10.0 + 4.0 * random.next()).collect();
        let field = Stiffness::PerPoint { n_points, young, poisson: vec![0.42] };
        let material = Material::new(field).expect("sound");
        let bed = Springs { triangles: top, normal: 0.2, tangential: 0.1, friction: None };
        let load = Load { springs: vec![bed], ..pushed(&body, 1.5) };
        let here = at(&body, &material, &load);

        let observations: Vec<Observation> = (0..3)
            .map(|_| Observation {
                displacement: (0..4)
                    .map(|_| (random.below(body.n_nodes()), random.vector(1.0)))
                    .collect(),
                reactions: (0..3)
                    .map(|_| {
                        (
                            body.held_nodes()[random.below(body.held_nodes().len())],
                            random.vector(1.0),
                        )
                    })
                    .collect(),
            })
            .collect();
        let rate = Load {
            nodal_forces: Some((0..body.n_nodes()).map(|_| random.vector(1.0)).collect()),
            body_force: random.vector(0.01),
            prescribed: Some(body.held_nodes().iter().map(|_| random.vector(0.3)).collect()),
            springs: vec![],
        };
        let young: Vec<f64> = (0..n).map(|_| random.next()).collect();
        let poisson: Vec<f64> = (0..n).map(|_| random.next()).collect();
        let causes = [
            Cause::Parameter(Parameter::Young),
            Cause::YoungField(young.clone()),
            Cause::PoissonField(poisson.clone()),
            Cause::Load(rate.clone()),
            Cause::SpringNormal(0),
            Cause::SpringTangential(0),
        ];
        let derivatives = here.derivatives(&causes).expect("derivatives");
        let adjoints = here.adjoints(&observations).expect("adjoints");
        let inner = |a: &[[f64; 3]], b: &[[f64; 3]]| -> f64 {
            a.iter().flatten().zip(b.iter().flatten()).map(|(x, y)| x * y).sum()
        };
        for (observation, adjoint) in observations.iter().zip(&adjoints) {
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
            let by_load = inner(&adjoint.nodal_forces, rate.nodal_forces.as_ref().expect("given"))
                + inner(&[adjoint.body_force], &[rate.body_force])
                + inner(&adjoint.prescribed, rate.prescribed.as_ref().expect("given"));
            let found = [
                adjoint.young.iter().sum(),
                dot(&adjoint.young, &young),
                dot(&adjoint.poisson, &poisson),
                by_load,
                adjoint.springs[0][0],
                adjoint.springs[0][1],
            ];
            for ((derivative, found), cause) in derivatives.iter().zip(found).zip(&causes) {
                let mut wanted = 0.0;
                for (node, w) in &observation.displacement {
                    wanted += inner(&[*w], &[derivative.displacement[*node]]);
                }
                for (node, w) in &observation.reactions {
                    let place = body.held_nodes().iter().position(|n| n == node).expect("held");
                    wanted += inner(&[*w], &[derivative.reactions[place]]);
                }
                let size = largest(&derivative.displacement).max(largest(&derivative.reactions));
                assert!((found - wanted).abs() < 1e-10 * size, "{cause:?}: {found} {wanted}");
            }
        }
    }
}

/// Fibres across a stretched bar are slack and count for nothing; along it they are taut. Both
/// sides of the switch have the derivative of their side.
#[test]
fn fibres_that_bear_tension_alone_have_the_derivative_of_their_side() {
    for (push, taut) in [(3.0, true), (-2.0, false)] {
        let mesh = bar([3, 1, 1], [18.0, 6.0, 6.0]);
        let body = held_bar_free_across(mesh);
        let make = |k1_over_mu| {
            let directions = Directions::Uniform([1.0, 0.0, 0.0]);
            let fibres = Fibres { k1_over_mu, k2: 0.5, tension_only: true, directions };
            Material::neo_hookean(10.0, 0.3).and_then(|m| m.with_fibres(fibres)).expect("sound")
        };
        let row = |&n: &usize| [push * body.nodes()[n][0] / 18.0, 0.0, 0.0];
        let load = Load::from_prescribed(body.held_nodes().iter().map(row).collect());
        let here = at(&body, &make(2.0), &load);
        let found = derivative(&here, Cause::Parameter(Parameter::FibreK1));
        if taut {
            let wanted = difference(1e-3, |d| answer(&body, &make(2.0 + d), &load));
            assert_close(&found, &wanted, "taut");
        } else {
            assert_eq!((largest(&found.displacement), largest(&found.reactions)), (0.0, 0.0));
        }
    }
}

/// Held along x at both ends, and otherwise only as far as it must.
fn held_bar_free_across(mesh: tissuereg_fem::Mesh) -> Body {
    let ends = nodes_where(&mesh, |x| x[0] < 1e-9 || x[0] > 18.0 - 1e-9);
    let mut supports = Supports::new();
    for node in ends {
        let x = mesh.nodes()[node];
        supports = supports.hold_axes(&[node], [true, x[1] < 1e-9, x[2] < 1e-9]);
    }
    Body::new(mesh, Element::Tet4, supports).expect("held")
}

#[test]
fn what_is_no_stable_equilibrium_is_refused() {
    let body = clamped_at_x0(bar([3, 1, 1], [18.0, 6.0, 6.0]), Element::Tet4);
    let material = Material::neo_hookean(10.0, 0.3).expect("sound");
    let load = Load { body_force: [0.0, 0.0, -0.02], ..Load::default() };
    let rest = vec![[0.0; 3]; body.n_nodes()];
    let error = Linearised::new(&body, &material, &load, &rest, &tight()).expect_err("falls");
    let FemError::NotInEquilibrium { residual, limit } = error else { panic!("{error}") };
    assert!(residual > 1e3 * limit, "{residual} {limit}");

    // A column under twice its own critical load that is kept straight by symmetry alone.
    let straight = bar([12, 1, 1], [60.0, 2.0, 2.0]);
    let column = clamped_at_x0(straight, Element::Tet10);
    let pressed: Vec<[f64; 3]> = column.nodes().iter().map(|x| [-0.15 * x[0], 0.0, 0.0]).collect();
    let forces = tissuereg_fem::internal_forces(&column, &material, &pressed).expect("upright");
    let load = Load::from_forces(forces);
    let error = Linearised::new(&column, &material, &load, &pressed, &tight()).expect_err("falls");
    assert!(matches!(error, FemError::NotStable { .. }), "{error}");

    let displacement = answer(&body, &material, &Load::default()).displacement;
    let here = Linearised::new(&body, &material, &Load::default(), &displacement, &tight())
        .expect("rest is an equilibrium");
    for (cause, words) in [
        (Cause::Parameter(Parameter::FibreK1), "FibreK1"),
        (Cause::SpringNormal(0), "springs 0 of 0"),
    ] {
        let error = here.derivatives(&[cause]).expect_err("none").to_string();
        assert!(error.contains(words), "{error}");
    }
    let loose = Observation::of_reactions([(15, [1.0; 3])]);
    let error = here.adjoints(&[loose]).expect_err("free").to_string();
    assert!(error.contains("the reaction of node 15, which is not held"), "{error}");
    let outside = Observation::of_displacement([(99, [1.0; 3])]);
    let error = here.adjoints(&[outside]).expect_err("outside").to_string();
    assert!(error.contains("node 99, which does not exist"), "{error}");
    let short = here.derivatives(&[Cause::YoungField(vec![1.0])]).expect_err("one");
    assert!(matches!(short, FemError::WrongLength { .. }), "{short}");
}
