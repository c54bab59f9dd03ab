//! Is the mathematics consistent? Stress against energy, tangent against stress, forces against
//! the energy of a whole body.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{Random, bar};
use tissuereg_fem::material::{Hyperelastic, NeoHookean, det_f_minus_one};
use tissuereg_fem::{Body, Element, Load, Material, SolveSettings, solve};

const LAW: NeoHookean = NeoHookean { mu: 3.4, lambda: 31.0 };

/// Random gradients with det F > 0.2.
fn gradients() -> Vec<[[f64; 3]; 3]> {
    let mut random = Random::new(11);
    (0..60).map(|_| random.matrix(0.5)).filter(|h| det_f_minus_one(h) > -0.8).collect()
}

#[test]
fn stress_is_the_derivative_of_energy() {
    let step = 1e-6;
    for h in gradients() {
        let stress = LAW.stress(&h).expect("upright");
        for i in 0..3 {
            for j in 0..3 {
                let energy = |d: f64| {
                    let mut moved = h;
                    moved[i][j] += d;
                    LAW.energy(&moved).expect("upright")
                };
                let slope = (energy(step) - energy(-step)) / (2.0 * step);
                // Central differences: truncation ~ step^2 and rounding ~ 1e-16 / step.
                assert!((slope - stress[i][j]).abs() < 1e-6 * (1.0 + slope.abs()), "{h:?}");
            }
        }
    }
}

#[test]
fn tangent_is_the_derivative_of_stress_and_symmetric() {
    let step = 1e-6;
    for h in gradients() {
        let tangent = LAW.tangent(&h).expect("upright");
        for kl in 0..9 {
            let stress = |d: f64| {
                let mut moved = h;
                moved[kl / 3][kl % 3] += d;
                LAW.stress(&moved).expect("upright")
            };
            let (plus, minus) = (stress(step), stress(-step));
            for ij in 0..9 {
                let slope = (plus[ij / 3][ij % 3] - minus[ij / 3][ij % 3]) / (2.0 * step);
                let own = tangent[ij][kl];
                assert!((slope - own).abs() < 1e-5 * (10.0 + slope.abs()), "{slope} {own}");
                assert!((own - tangent[kl][ij]).abs() < 1e-12 * (1.0 + own.abs()));
            }
        }
    }
}

#[test]
fn the_law_is_that_of_the_text_books() {
    for h in gradients() {
        let j = 1.0 + det_f_minus_one(&h);
        let square: f64 = (0..9)
            .map(|k| h[k / 3][k % 3] + if k % 4 == 0 { 1.0 } else { 0.0 })
            .map(|f| f * f)
            .sum();
        let energy =
            LAW.mu / 2.0 * (square - 3.0) - LAW.mu * j.ln() + LAW.lambda / 2.0 * j.ln().powi(2);
        let own = LAW.energy(&h).expect("upright");
        assert!((own - energy).abs() < 1e-12 * (1.0 + energy.abs()), "{own} {energy}");
    }
}

#[test]
fn response_is_energy_and_stress() {
    for h in gradients() {
        let both = LAW.response(&h).expect("upright");
        assert_eq!(Some(both.energy), LAW.energy(&h));
        assert_eq!(Some(both.stress), LAW.stress(&h));
        assert!((both.det_f - 1.0 - det_f_minus_one(&h)).abs() < 1e-15);
    }
}

#[test]
fn tiny_strains_keep_their_digits() {
    let mut h = [[0.0; 3]; 3];
    h[0][1] = 1e-12;
    let stress = LAW.stress(&h).expect("upright");
    assert!((stress[0][1] / (LAW.mu * 1e-12) - 1.0).abs() < 1e-12);
    let energy = LAW.energy(&h).expect("upright");
    assert!((energy / (0.5 * LAW.mu * 1e-24) - 1.0).abs() < 1e-10);
}

#[test]
fn an_inverted_or_broken_point_has_no_energy() {
    for bad in [-1.0, -1.5, f64::NAN, f64::INFINITY] {
        let h = [[bad, 0.0, 0.0], [0.0; 3], [0.0; 3]];
        assert_eq!(LAW.energy(&h), None);
        assert_eq!(LAW.stress(&h), None);
        assert_eq!(LAW.tangent(&h), None);
        assert_eq!(LAW.response(&h), None);
    }
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
