//! Is the mathematics consistent? Stress against energy, tangent against stress, forces against
//! the energy of a whole body; for every law.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::laws::recipes;
use common::{Random, bar};
use tissuereg_fem::material::{Hyperelastic, Law, Matrix3, det_f_minus_one};
use tissuereg_fem::{Body, Element, Load, Material, SolveSettings, solve};

/// Random gradients with det F > 0.2.
fn gradients() -> Vec<Matrix3> {
    let mut random = Random::new(11);
    (0..60).map(|_| random.matrix(0.5)).filter(|h| det_f_minus_one(h) > -0.8).collect()
}

/// Every law at every gradient.
fn for_all(test: impl Fn(&str, Law, &Matrix3)) {
    for recipe in recipes() {
        for h in gradients() {
            test(recipe.name, recipe.law(), &h);
        }
    }
}

fn moved(h: &Matrix3, entry: usize, by: f64) -> Matrix3 {
    let mut other = *h;
    other[entry / 3][entry % 3] += by;
    other
}

fn largest_entry(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

// Central differences: truncation ~ step^2 and rounding ~ 1e-16 / step, both of the largest entry.
const STEP: f64 = 1e-6;

#[test]
fn stress_is_the_derivative_of_energy() {
    for_all(|name, law, h| {
        let stress = law.stress(h).expect("upright");
        let scale = 1.0 + largest_entry(stress.as_flattened());
        for (ij, own) in stress.as_flattened().iter().enumerate() {
            let energy = |by: f64| law.energy(&moved(h, ij, by)).expect("upright");
            let slope = (energy(STEP) - energy(-STEP)) / (2.0 * STEP);
            assert!((slope - own).abs() < 1e-7 * scale, "{name} {ij}: {slope} {own} {h:?}");
        }
    });
}

#[test]
fn tangent_is_the_derivative_of_stress_and_symmetric() {
    for_all(|name, law, h| {
        let tangent = law.tangent(h).expect("upright");
        let scale = largest_entry(tangent.as_flattened());
        for kl in 0..9 {
            let stress = |by: f64| law.stress(&moved(h, kl, by)).expect("upright");
            let (plus, minus) = (stress(STEP), stress(-STEP));
            for ij in 0..9 {
                let slope = (plus[ij / 3][ij % 3] - minus[ij / 3][ij % 3]) / (2.0 * STEP);
                let own = tangent[ij][kl];
                assert!((slope - own).abs() < 1e-7 * scale, "{name} {ij} {kl}: {slope} {own}");
                assert!((own - tangent[kl][ij]).abs() < 1e-14 * scale, "{name} {ij} {kl}");
            }
        }
    });
}

#[test]
fn stress_by_a_parameter_is_the_derivative_of_stress() {
    for recipe in recipes() {
        let parameters = recipe.material().expect("sound").parameters();
        for parameter in parameters {
            for h in gradients() {
                let own = recipe.law().stress_by(&h, parameter).expect("upright");
                let at = |by: f64| recipe.moved(parameter, by).law().stress(&h).expect("upright");
                let (plus, minus) = (at(STEP), at(-STEP));
                let scale = 1.0 + largest_entry(own.as_flattened());
                let rounding = 1e-9 * largest_entry(plus.as_flattened());
                for ij in 0..9 {
                    let slope = (plus[ij / 3][ij % 3] - minus[ij / 3][ij % 3]) / (2.0 * STEP);
                    let error = (slope - own[ij / 3][ij % 3]).abs();
                    assert!(
                        error < 1e-8 * scale + rounding,
                        "{} {parameter:?}: {slope} {own:?}",
                        recipe.name
                    );
                }
            }
        }
    }
}

#[test]
fn energy_by_a_parameter_is_the_derivative_of_energy() {
    for recipe in recipes() {
        for parameter in recipe.material().expect("sound").parameters() {
            for h in gradients() {
                let (own, stress) = recipe.law().response_by(&h, parameter).expect("upright");
                assert_eq!(recipe.law().stress_by(&h, parameter), Some(stress));
                let at = |by: f64| recipe.moved(parameter, by).law().energy(&h).expect("upright");
                let (plus, minus) = (at(STEP), at(-STEP));
                let slope = (plus - minus) / (2.0 * STEP);
                let error = (slope - own).abs();
                assert!(
                    error < 1e-8 * (1.0 + own.abs()) + 1e-9 * plus.abs(),
                    "{} {parameter:?}: {slope} {own}",
                    recipe.name
                );
            }
        }
    }
}

#[test]
fn the_ogden_tangent_holds_at_equal_stretches() {
    let law = recipes().into_iter().find(|r| r.name == "ogden").expect("listed").law();
    let rotation = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]];
    for gap in [0.0, 1e-16, 1e-13, 1e-9, 1e-6] {
        let stretches = [1.3, 1.3 + gap, 1.3 - 2.0 * gap];
        for two in [false, true] {
            let mut h = [[0.0; 3]; 3];
            for i in 0..3 {
                for j in 0..3 {
                    let stretch = |a: usize| if two && a == 2 { 0.7 } else { stretches[a] };
                    h[i][j] = (0..3).map(|a| stretch(a) * rotation[i][a] * rotation[j][a]).sum();
                }
                h[i][i] -= 1.0;
            }
            let tangent = law.tangent(&h).expect("upright");
            for kl in 0..9 {
                let stress = |by: f64| law.stress(&moved(&h, kl, by)).expect("upright");
                let (plus, minus) = (stress(STEP), stress(-STEP));
                for ij in 0..9 {
                    let slope = (plus[ij / 3][ij % 3] - minus[ij / 3][ij % 3]) / (2.0 * STEP);
                    let own = tangent[ij][kl];
                    assert!((slope - own).abs() < 1e-6, "gap {gap}: {slope} {own}");
                }
            }
        }
    }
}

#[test]
fn response_is_energy_and_stress() {
    for_all(|_, law, h| {
        let both = law.response(h).expect("upright");
        assert_eq!(Some(both.energy), law.energy(h));
        assert_eq!(Some(both.stress), law.stress(h));
        assert!((both.det_f - 1.0 - det_f_minus_one(h)).abs() < 1e-15);
    });
}

/// The reactions of a body whose nodes are all held are its internal forces.
#[test]
fn forces_of_a_body_are_the_derivative_of_its_energy() {
    for element in [Element::Tet4, Element::Tet10] {
        let mesh = bar([2, 1, 1], [20.0, 10.0, 10.0]);
        let all: Vec<usize> = (0..mesh.n_nodes()).collect();
        let body = Body::new(mesh, element, all).expect("held");
        let material = Material::neo_hookean(10.0, 0.4).expect("sound");
        let mut random = Random::new(3);
        let u: Vec<[f64; 3]> = (0..body.n_corner_nodes())
            .map(|_| std::array::from_fn(|_| 0.4 * random.next()))
            .collect();
        let at = |u: Vec<[f64; 3]>| {
            solve(&body, &material, &Load::from_prescribed(u), &SolveSettings::default())
                .expect("upright")
        };
        let forces = at(u.clone()).reactions;
        let free_edges = body.n_unknowns() > 0;
        for (node, i) in [(0, 0), (4, 1), (7, 2), (11, 0)] {
            let energy = |d: f64| {
                let mut moved = u.clone();
                moved[node][i] += d;
                at(moved).report.strain_energy
            };
            let slope = (energy(1e-4) - energy(-1e-4)) / 2e-4;
            // Inner mid-edge nodes of the ten-node body relax, which the derivative does not see
            // (envelope theorem); held surface nodes pass their forces on to corners.
            assert!(
                (slope - forces[node][i]).abs() < 1e-5 * (1.0 + slope.abs()),
                "{element:?} {free_edges}"
            );
        }
    }
}
