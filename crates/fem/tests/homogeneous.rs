//! Do material tests of one point give what is known in closed form?
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::laws::{Recipe, YOUNG, recipes};
use tissuereg_fem::Material;
use tissuereg_fem::material::homogeneous::{Compressibility, Mode, nominal_stress};
use tissuereg_fem::material::{Law, LawKind};

const LIMIT: Compressibility = Compressibility::Limit;
const OF_LAW: Compressibility = Compressibility::OfLaw;

fn law(kind: LawKind, poisson: f64) -> Law {
    let material = Material::neo_hookean(YOUNG, poisson).and_then(|m| m.with_law(kind));
    material.expect("sound").law_at(0, 0)
}

/// Slopes of the energy in the invariants at a stretch, all at constant volume.
#[test]
fn the_incompressible_limit_has_its_closed_forms() {
    let (share, b) = (0.3, 0.7);
    let (alpha, weight) = ([-19.0, 3.0], [0.8, 0.2]);
    for stretch in [0.6_f64, 0.95, 1.0, 1.3, 2.0] {
        for mode in [Mode::Uniaxial, Mode::Equibiaxial] {
            // Stretch of the free direction, and what one pulled direction sees of it.
            let free = if mode == Mode::Uniaxial { stretch.powf(-0.5) } else { stretch.powi(-2) };
            let pulled_two = mode == Mode::Equibiaxial;
            let (i1, base) = if pulled_two {
                (2.0 * stretch.powi(2) + free.powi(2), stretch - stretch.powi(-5))
            } else {
                (stretch.powi(2) + 2.0 * free.powi(2), stretch - stretch.powi(-2))
            };
            // Factor of ∂ψ/∂I₂ relative to that of ∂ψ/∂I₁.
            let second = if pulled_two { stretch.powi(2) } else { 1.0 / stretch };
            let slopes = |d1: f64, d2: f64| 2.0 * base * (d1 + d2 * second);
            let mu = law(LawKind::NeoHookean, 0.49).moduli.mu;
            let growth = (b * (i1 - 3.0)).exp();
            let a = i1 - 3.0;
            let ogden: f64 = (0..2)
                .map(|p| {
                    let power = stretch.powf(alpha[p]) - free.powf(alpha[p]);
                    2.0 * mu * weight[p] / alpha[p] * power / stretch
                })
                .sum();
            let cases = [
                (LawKind::NeoHookean, slopes(0.5 * mu, 0.0)),
                (
                    LawKind::MooneyRivlin { share },
                    slopes(0.5 * mu * (1.0 - share), 0.5 * mu * share),
                ),
                (
                    LawKind::Yeoh { c2_over_c1: 0.3, c3_over_c1: 0.1 },
                    slopes(0.5 * mu * (1.0 + 0.6 * a + 0.3 * a * a), 0.0),
                ),
                (LawKind::Fung { b }, slopes(0.5 * mu * growth, 0.0)),
                (LawKind::VerondaWestmann { b }, slopes(mu * growth, -0.5 * mu)),
                (LawKind::ogden(&alpha, &weight).expect("sound"), ogden),
            ];
            for (kind, wanted) in cases {
                let own =
                    nominal_stress(&law(kind, 0.49), mode, stretch, LIMIT).expect("stretched");
                let error = (own - wanted).abs();
                assert!(
                    error < 1e-12 * (1.0 + wanted.abs()),
                    "{kind:?} {mode:?} {stretch}: {own} {wanted}"
                );
            }
        }
    }
}

/// The compressible neo-Hookean bar: `μ (λ₂² − 1) + λ ln J = 0` across, to any Poisson's ratio.
#[test]
fn the_free_sides_bear_no_stress() {
    for poisson in [0.0, 0.3, 0.45, 0.4995] {
        let law = law(LawKind::NeoHookean, poisson);
        let (mu, lambda) = (law.moduli.mu, law.moduli.lambda);
        for stretch in [0.4_f64, 0.8, 1.001, 1.7, 2.5] {
            // Bisection on the side stretch, whose stress grows with it.
            let side = |s: f64| mu * (s * s - 1.0) + lambda * (stretch * s * s).ln();
            let (mut low, mut high) = (0.1, 3.0);
            for _ in 0..200 {
                let middle = 0.5 * (low + high);
                if side(middle) < 0.0 { low = middle } else { high = middle }
            }
            let j = stretch * low * low;
            let wanted = (mu * (stretch * stretch - 1.0) + lambda * j.ln()) / stretch;
            let own = nominal_stress(&law, Mode::Uniaxial, stretch, OF_LAW).expect("stretched");
            // Rounding of ln J times λ, 1e-16 * 3e3 kPa at nu = 0.4995.
            assert!((own - wanted).abs() < 1e-11 * (1.0 + wanted.abs()), "{poisson} {stretch}");
        }
    }
}

#[test]
fn every_law_starts_with_youngs_modulus_and_nears_its_limit() {
    let strain = 1e-7;
    for recipe in recipes().into_iter().filter(|recipe| recipe.fibre.is_none()) {
        let stress = |poisson: f64, mode, amount, compressibility| {
            let law = Recipe { poisson, ..recipe.clone() }.law();
            nominal_stress(&law, mode, amount, compressibility)
        };
        let starts: &[f64] =
            if recipe.starts_as_hooke() { &[-0.4, 0.0, 0.3, 0.49, 0.4995] } else { &[] };
        for &poisson in starts {
            let pull = stress(poisson, Mode::Uniaxial, 1.0 + strain, OF_LAW).expect("pulled");
            assert!(
                (pull / (recipe.young * strain) - 1.0).abs() < 1e-5,
                "{} {poisson}",
                recipe.name
            );
            let both = stress(poisson, Mode::Equibiaxial, 1.0 + strain, OF_LAW).expect("pulled");
            let wanted = recipe.young / (1.0 - poisson) * strain;
            assert!((both / wanted - 1.0).abs() < 1e-5, "{} {poisson}", recipe.name);
            let shear = stress(poisson, Mode::SimpleShear, strain, OF_LAW).expect("sheared");
            let wanted = recipe.young / (2.0 * (1.0 + poisson)) * strain;
            assert!((shear / wanted - 1.0).abs() < 1e-5, "{} {poisson}", recipe.name);
        }
        let limited = !["hooke", "st_venant_kirchhoff"].contains(&recipe.name);
        for stretch in [0.8, 1.2] {
            for mode in [Mode::Uniaxial, Mode::Equibiaxial] {
                let limit = stress(0.4995, mode, stretch, LIMIT);
                assert_eq!(limit.is_some(), limited, "{}", recipe.name);
                let Some(limit) = limit else { continue };
                let own = |poisson| stress(poisson, mode, stretch, OF_LAW).expect("stretched");
                let far = (own(0.495) * 2.0 * 1.495 - limit * 2.0 * 1.4995).abs();
                let near = (own(0.4995) - limit).abs() * 2.0 * 1.4995;
                // The error of what is nearly incompressible falls with 1/K, tenfold.
                assert!(near < 0.15 * far, "{} {mode:?} {stretch}: {near} {far}", recipe.name);
            }
        }
    }
}

#[test]
fn fibres_stiffen_along_themselves_and_bulge_unevenly_across() {
    let plain = recipes().swap_remove(0);
    let along =
        |direction| Recipe { fibre: Some((3.0, 1.0, direction, true)), ..plain.clone() }.law();
    let pull = |law: &Law| nominal_stress(law, Mode::Uniaxial, 1.2, OF_LAW).expect("pulled");
    let (base, x) = (pull(&plain.law()), pull(&along([1.0, 0.0, 0.0])));
    let (y, z) = (pull(&along([0.0, 1.0, 0.0])), pull(&along([0.0, 0.0, 1.0])));
    assert!(x > 1.5 * base);
    // Fibres across are shortened by the pull, and slack.
    assert!((y - base).abs() < 1e-12 && (z - base).abs() < 1e-12);
    let push = |law: &Law| nominal_stress(law, Mode::Uniaxial, 0.8, OF_LAW).expect("pushed");
    let (base, y, z) =
        (push(&plain.law()), push(&along([0.0, 1.0, 0.0])), push(&along([0.0, 0.0, 1.0])));
    assert!(y < base && (y - z).abs() < 1e-12 * y.abs());
}

#[test]
fn what_cannot_be_stretched_has_no_stress() {
    let soft = law(LawKind::NeoHookean, 0.45);
    for amount in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(nominal_stress(&soft, Mode::Uniaxial, amount, OF_LAW), None);
        assert_eq!(nominal_stress(&soft, Mode::Equibiaxial, amount, LIMIT), None);
    }
    let steep = law(LawKind::Fung { b: 1e3 }, 0.45);
    assert_eq!(nominal_stress(&steep, Mode::SimpleShear, 10.0, OF_LAW), None);
}

/// Stresses are in the unit of the modulus, however small or large that is.
#[test]
fn a_stress_over_its_modulus_knows_no_unit() {
    for recipe in recipes() {
        for mode in [Mode::Uniaxial, Mode::Equibiaxial] {
            for amount in [0.3, 0.5, 0.8, 1.2, 2.0, 4.0] {
                let over = |young: f64| {
                    let law = Recipe { young, ..recipe.clone() }.law();
                    nominal_stress(&law, mode, amount, OF_LAW).map(|stress| stress / young)
                };
                let what = format!("{} {mode:?} {amount}", recipe.name);
                match (over(1.0), over(1e-3), over(1e6)) {
                    (Some(a), Some(b), Some(c)) => {
                        assert!(
                            (a - b).abs().max((a - c).abs()) < 1e-9 * (1.0 + a.abs()),
                            "{what}"
                        );
                    }
                    (a, b, c) => assert!(a.is_none() && b.is_none() && c.is_none(), "{what}"),
                }
            }
        }
    }
}

/// Exponential laws overflow, where a sheet gets thick.
#[test]
fn what_overflows_is_no_stress() {
    for recipe in recipes() {
        for mode in [Mode::Uniaxial, Mode::Equibiaxial, Mode::SimpleShear] {
            for compressibility in [LIMIT, OF_LAW] {
                for amount in (0..60).map(|k| 0.1 * 1.1_f64.powi(k)) {
                    let found = nominal_stress(&recipe.law(), mode, amount, compressibility);
                    assert!(found.is_none_or(f64::is_finite), "{} {mode:?} {amount}", recipe.name);
                }
            }
        }
    }
}
