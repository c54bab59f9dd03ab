//! Is every law what it claims to be? Against textbook energies in 60 digits, against another code, in its
//! limits, and at input that it must refuse.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use std::path::Path;

use common::laws::{Recipe, recipes};
use common::{Random, clamped_at_x0, dome, npz};
use tissuereg_fem::material::{
    Directions, Fibres, Hyperelastic, Law, LawKind, Matrix3, Parameter, Volumetric, det_f_minus_one,
};
use tissuereg_fem::{Element, FemError, Load, Material, SolveSettings, Stiffness, solve};

fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn largest_entry(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

fn largest_error(own: &[f64], wanted: &[f64]) -> f64 {
    assert_eq!(own.len(), wanted.len());
    own.iter().zip(wanted).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}

/// Gradients of sizes from 1e-10 to 0.6: energies from their textbook form, in 60 digits.
#[test]
fn every_law_has_the_digits_of_its_textbook_energy() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/laws_reference.npz");
    let arrays = npz::read(&path).expect("committed");
    let gradients = arrays["h"].values.as_chunks::<9>().0;
    for law in LawKind::declarations() {
        assert!(recipes().iter().any(|recipe| recipe.declared == law.name), "{}", law.name);
    }
    for recipe in recipes() {
        let law = recipe.law();
        let stresses = arrays[&format!("{}_stress", recipe.name)].values.as_chunks::<9>().0;
        let energies = &arrays[&format!("{}_energy", recipe.name)].values;
        for ((flat, stress), energy) in gradients.iter().zip(stresses).zip(energies) {
            let h: Matrix3 = std::array::from_fn(|i| std::array::from_fn(|j| flat[3 * i + j]));
            let own = law.response(&h).expect("upright");
            let (error, size) =
                (largest_error(own.stress.as_flattened(), stress), largest_entry(stress));
            assert!(error < 2e-14 * size, "{} {h:?}: stress off by {error} of {size}", recipe.name);
            let error = (own.energy / energy - 1.0).abs();
            assert!(error < 1e-13, "{} {h:?}: energy off by {error}", recipe.name);
        }
    }
}

/// felupe 11.3 with tensortrax 0.29, where its forms are the same.
#[test]
fn six_laws_agree_with_felupe() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/laws_felupe.npz");
    let arrays = npz::read(&path).expect("committed");
    let gradients = arrays["h"].values.as_chunks::<9>().0;
    let mut compared = 0;
    for mut recipe in recipes() {
        let Some(stresses) = arrays.get(&format!("{}_stress", recipe.name)) else { continue };
        let tangents = &arrays[&format!("{}_tangent", recipe.name)].values;
        compared += 1;
        if recipe.name == "yeoh" {
            recipe.volumetric = Volumetric::Quadratic;
        }
        // tensortrax moves eigenvalues apart before it differentiates them.
        let tolerance = if recipe.name == "ogden" { 1e-6 } else { 1e-12 };
        let law = recipe.law();
        for (k, flat) in gradients.iter().enumerate() {
            let h: Matrix3 = std::array::from_fn(|i| std::array::from_fn(|j| flat[3 * i + j]));
            let wanted = &stresses.values[9 * k..9 * k + 9];
            let own = law.stress(&h).expect("upright");
            let error = largest_error(own.as_flattened(), wanted);
            assert!(error < tolerance * largest_entry(wanted), "{} stress {error}", recipe.name);
            let wanted = &tangents[81 * k..81 * k + 81];
            let own = law.tangent(&h).expect("upright");
            let error = largest_error(own.as_flattened(), wanted);
            assert!(error < tolerance * largest_entry(wanted), "{} tangent {error}", recipe.name);
        }
    }
    assert_eq!(compared, 6);
}

#[test]
fn every_law_starts_as_hooke() {
    let mut random = Random::new(4);
    for recipe in recipes().into_iter().filter(Recipe::starts_as_hooke) {
        let (law, hooke) = (recipe.law(), Law { kind: LawKind::Hooke, ..recipe.law() });
        for _ in 0..5 {
            let h = random.matrix(1e-8);
            let (own, wanted) = (law.stress(&h).expect("upright"), hooke.stress(&h).expect("any"));
            let error = largest_error(own.as_flattened(), wanted.as_flattened());
            // What a law adds is of second order: 1e-8 of the stress, times its coefficients.
            assert!(error < 1e-6 * largest_entry(wanted.as_flattened()), "{}", recipe.name);
        }
        let rest = [[0.0; 3]; 3];
        assert_eq!(law.stress(&rest).map(|p| largest_entry(p.as_flattened())), Some(0.0));
        let (own, wanted) =
            (law.tangent(&rest).expect("rest"), hooke.tangent(&rest).expect("rest"));
        let error = largest_error(own.as_flattened(), wanted.as_flattened());
        assert!(error < 1e-13 * largest_entry(wanted.as_flattened()), "{}", recipe.name);
    }
}

#[test]
fn a_rotation_turns_the_stress_and_leaves_the_energy() {
    let rotation = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]];
    let mut random = Random::new(5);
    for recipe in recipes().into_iter().filter(|recipe| !recipe.name.starts_with("hooke")) {
        let law = recipe.law();
        for _ in 0..10 {
            let h = random.matrix(0.25);
            let f: Matrix3 = std::array::from_fn(|i| {
                std::array::from_fn(|j| h[i][j] + if i == j { 1.0 } else { 0.0 })
            });
            let mut turned = product(&rotation, &f);
            (0..3).for_each(|i| turned[i][i] -= 1.0);
            let (own, other) = (law.response(&h).expect("up"), law.response(&turned).expect("up"));
            assert!((own.energy - other.energy).abs() < 1e-13 * own.energy, "{}", recipe.name);
            let wanted = product(&rotation, &own.stress);
            let error = largest_error(other.stress.as_flattened(), wanted.as_flattened());
            assert!(
                error < 1e-13 * (1.0 + largest_entry(wanted.as_flattened())),
                "{}",
                recipe.name
            );
        }
    }
}

/// Isotropic laws do not see a rotation before the deformation; fibres do.
#[test]
fn only_fibres_know_a_direction() {
    let rotation = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]];
    let h = [[0.2, 0.1, 0.0], [-0.05, -0.1, 0.3], [0.0, 0.02, 0.15]];
    for recipe in recipes() {
        let before = product(&h, &rotation);
        // F Q − I = (h + I) Q − I; Hooke's law takes Qᵀ h Q instead, its only invariance.
        let mut turned: Matrix3 = std::array::from_fn(|i| {
            std::array::from_fn(|j| before[i][j] + rotation[i][j] - if i == j { 1.0 } else { 0.0 })
        });
        if recipe.name.starts_with("hooke") {
            let back = std::array::from_fn(|i| std::array::from_fn(|j| rotation[j][i]));
            turned = product(&back, &before);
        }
        let law = recipe.law();
        let (own, other) = (law.energy(&h).expect("up"), law.energy(&turned).expect("up"));
        let same = (own - other).abs() < 1e-13 * own;
        assert_eq!(same, recipe.fibre.is_none(), "{}: {own} {other}", recipe.name);
    }
}

#[test]
fn laws_contain_each_other() {
    let h = [[0.3, 0.2, 0.0], [0.1, -0.2, 0.3], [0.0, 0.1, 0.15]];
    let stress = |kind: LawKind| {
        let material = Material::neo_hookean(10.0, 0.4).expect("sound").with_law(kind);
        material.expect("sound").law_at(0, 0).stress(&h).expect("upright")
    };
    let plain = stress(LawKind::MooneyRivlin { share: 0.0 });
    for kind in [
        LawKind::Yeoh { c2_over_c1: 0.0, c3_over_c1: 0.0 },
        LawKind::Fung { b: 0.0 },
        LawKind::ogden(&[2.0], &[1.0]).expect("sound"),
        LawKind::ogden(&[2.0, 2.0], &[3.0, 1.0]).expect("sound"),
    ] {
        let other = stress(kind);
        assert!(
            largest_error(other.as_flattened(), plain.as_flattened()) < 1e-14 * 60.0,
            "{kind:?}"
        );
    }
    // Mooney–Rivlin is Ogden's law with exponents 2 and −2.
    let own = stress(LawKind::MooneyRivlin { share: 0.3 });
    let other = stress(LawKind::ogden(&[2.0, -2.0], &[0.7, 0.3]).expect("sound"));
    assert!(largest_error(own.as_flattened(), other.as_flattened()) < 1e-14 * 60.0);
    // The exponent may pass through zero.
    let [below, at, above] =
        [-1e-7, 0.0, 1e-7].map(|alpha| stress(LawKind::ogden(&[alpha], &[1.0]).expect("sound")));
    let mean: Vec<f64> =
        (0..9).map(|k| 0.5 * (below[k / 3][k % 3] + above[k / 3][k % 3])).collect();
    assert!(largest_error(at.as_flattened(), &mean) < 1e-12);
}

#[test]
fn coupled_laws_without_shape_are_the_neo_hookean_law() {
    let h = [[0.3, 0.2, 0.0], [0.1, -0.2, 0.3], [0.0, 0.1, 0.15]];
    let stress = |kind: LawKind, volumetric: Volumetric| {
        let material = Material::neo_hookean(10.0, 0.4).and_then(|m| m.with_law(kind));
        let material = material.and_then(|m| m.with_volumetric(volumetric)).expect("sound");
        material.law_at(0, 0).stress(&h).expect("upright")
    };
    let plain = stress(LawKind::NeoHookean, Volumetric::Log);
    assert_eq!(stress(LawKind::NeoHookean, Volumetric::Coupled), plain);
    let error = |kind, volumetric| {
        largest_error(stress(kind, volumetric).as_flattened(), plain.as_flattened())
    };
    for kind in [
        LawKind::MooneyRivlin { share: 0.0 },
        LawKind::Yeoh { c2_over_c1: 0.0, c3_over_c1: 0.0 },
        LawKind::Fung { b: 0.0 },
        LawKind::ogden(&[2.0], &[1.0]).expect("sound"),
    ] {
        assert!(error(kind, Volumetric::Coupled) < 1e-14 * 60.0, "{kind:?}");
        assert!(error(kind, Volumetric::Log) > 0.05, "{kind:?}");
    }
}

/// Pulled along one axis at small strain: that axis has the excess, those across do not.
#[test]
fn a_bimodular_law_is_stiffer_where_it_is_stretched() {
    let recipe = recipes().into_iter().find(|r| r.name == "bimodular").expect("listed");
    let law = recipe.law();
    let stress = |e: f64| {
        let h = [[e, 0.0, 0.0], [0.0, -0.3 * e, 0.0], [0.0, 0.0, -0.3 * e]];
        law.stress(&h).expect("upright")[0][0]
    };
    let (pulled, pushed) = (stress(1e-6), -stress(-1e-6));
    let wanted = 2.0 * law.moduli.mu * 0.7 * 1e-6;
    assert!(((pulled - pushed) / wanted - 1.0).abs() < 1e-4, "{pulled} {pushed}");
}

/// Strains of two signs whose squared stretches are equal to rounding.
#[test]
fn a_bimodular_law_has_a_tangent_at_the_smallest_strains() {
    let recipe = recipes().into_iter().find(|r| r.name == "bimodular").expect("listed");
    let law = recipe.law();
    let at =
        |e: f64| law.tangent(&[[e, 0.0, 0.0], [0.0, -e, 0.0], [0.0, 0.0, 0.0]]).expect("upright");
    for (small, smallest) in at(1e-9).as_flattened().iter().zip(at(1e-17).as_flattened()) {
        assert!((small - smallest).abs() < 1e-6, "{small} {smallest}");
    }
}

#[test]
fn slack_fibres_bear_nothing() {
    let along = |tension_only| {
        let fibre = Some((2.5, 0.8, [0.0, 0.0, 1.0], tension_only));
        Recipe { fibre, ..recipes().swap_remove(0) }.law()
    };
    let plain = recipes().swap_remove(0).law();
    let mut h = [[0.0; 3]; 3];
    h[2][2] = -0.2;
    assert_eq!(along(true).stress(&h), plain.stress(&h));
    assert_ne!(along(false).stress(&h), plain.stress(&h));
    h[2][2] = 0.2;
    assert_eq!(along(true).stress(&h), along(false).stress(&h));
    assert_ne!(along(true).stress(&h), plain.stress(&h));
}

#[test]
fn an_inverted_or_broken_point_has_no_energy() {
    for recipe in recipes() {
        let law = recipe.law();
        for bad in [-1.0, -1.5, f64::NAN, f64::INFINITY] {
            // Small strain knows no inversion.
            let holds = recipe.name == "hooke" && bad.is_finite();
            let h = [[bad, 0.0, 0.0], [0.0; 3], [0.0; 3]];
            assert_eq!(law.energy(&h).is_some(), holds, "{} {bad}", recipe.name);
            assert_eq!(law.stress(&h).is_some(), holds, "{} {bad}", recipe.name);
            assert_eq!(law.tangent(&h).is_some(), holds, "{} {bad}", recipe.name);
            assert_eq!(law.response(&h).is_some(), holds, "{} {bad}", recipe.name);
            for parameter in recipe.material().expect("sound").parameters() {
                let by = law.stress_by(&h, parameter);
                assert_eq!(by.is_some(), holds, "{} {parameter:?} {bad}", recipe.name);
            }
        }
    }
}

#[test]
fn an_exponential_that_overflows_is_too_far() {
    let law = Material::neo_hookean(10.0, 0.45)
        .and_then(|m| m.with_law(LawKind::Fung { b: 100.0 }))
        .expect("sound")
        .law_at(0, 0);
    let h = [[0.0, 4.0, 0.0], [0.0; 3], [0.0; 3]];
    assert!(det_f_minus_one(&h) == 0.0);
    assert_eq!((law.energy(&h), law.stress(&h), law.tangent(&h)), (None, None, None));
    assert_eq!(law.stress_by(&h, Parameter::shape("b")), None);
}

#[test]
fn bad_shapes_name_the_parameter() {
    let soft = || Material::neo_hookean(10.0, 0.45).expect("sound");
    let nan = f64::NAN;
    let fibres = |k1_over_mu, k2, directions| {
        soft().with_fibres(Fibres { k1_over_mu, k2, tension_only: true, directions })
    };
    let up = Directions::Uniform([0.0, 0.0, 1.0]);
    let cases = [
        (soft().with_law(LawKind::Bimodular { excess: -1.0 }), "`excess`"),
        (soft().with_law(LawKind::MooneyRivlin { share: nan }), "`share`"),
        (soft().with_law(LawKind::Yeoh { c2_over_c1: nan, c3_over_c1: 0.0 }), "`c2_over_c1`"),
        (soft().with_law(LawKind::Yeoh { c2_over_c1: 0.0, c3_over_c1: nan }), "`c3_over_c1`"),
        (soft().with_law(LawKind::Fung { b: -1.0 }), "`b`"),
        (soft().with_law(LawKind::VerondaWestmann { b: f64::INFINITY }), "`b`"),
        (LawKind::ogden(&[], &[]).map(|_| soft()), "`alpha`"),
        (LawKind::ogden(&[1.0; 4], &[1.0; 4]).map(|_| soft()), "`alpha`"),
        (LawKind::ogden(&[nan], &[1.0]).map(|_| soft()), "`alpha`"),
        (LawKind::ogden(&[1.0], &[1.0, 2.0]).map(|_| soft()), "`weight`"),
        (LawKind::ogden(&[1.0, 2.0], &[1.0, -1.0]).map(|_| soft()), "`weight`"),
        (fibres(-1.0, 1.0, up.clone()), "`k1_over_mu`"),
        (fibres(1.0, nan, up), "`k2`"),
        (fibres(1.0, 1.0, Directions::PerTet(vec![[1.0; 3], [0.0; 3]])), "at entry 1"),
    ];
    for (made, name) in cases {
        let message = made.expect_err(name).to_string();
        assert!(message.contains(name), "{message}");
    }
    for volumetric in [Volumetric::Quadratic, Volumetric::Coupled] {
        let material = soft().with_volumetric(volumetric).expect("sound");
        let refused = material.with_law(LawKind::Hooke);
        assert!(matches!(refused, Err(FemError::BadLaw { name: "volumetric", .. })));
    }
}

/// A dome pushed down by its weight: every law finds its equilibrium, fields of one value a point
/// give what a uniform one gives, and what does not fit the body is refused.
#[test]
fn every_law_solves_and_fields_may_vary_inside_a_tetrahedron() {
    let body = clamped_at_x0(dome(4), Element::Tet10);
    let load = Load { body_force: [0.0, 0.0, -9.81e-3], ..Load::default() };
    let settings = SolveSettings::default();
    for recipe in recipes() {
        let material = Recipe { young: 20.0, ..recipe.clone() }.material().expect("sound");
        let answer = solve(&body, &material, &load, &settings).expect(recipe.name);
        assert!(answer.report.residual <= answer.report.tolerance, "{}", recipe.name);
        let n = body.n_tets() * 4;
        let spread = |count: usize, n_points: usize| {
            let field = Stiffness::PerPoint {
                n_points,
                young: vec![20.0; count],
                poisson: vec![recipe.poisson; count],
            };
            let material = Material::new(field)
                .and_then(|m| m.with_law(recipe.kind()))
                .and_then(|m| m.with_volumetric(recipe.volumetric))
                .expect("sound");
            match recipe.fibre {
                None => material,
                Some((k1_over_mu, k2, direction, tension_only)) => {
                    let directions =
                        Directions::PerPoint { n_points, directions: vec![direction; count] };
                    material
                        .with_fibres(Fibres { k1_over_mu, k2, tension_only, directions })
                        .expect("sound")
                }
            }
        };
        let again = solve(&body, &spread(n, 4), &load, &settings).expect(recipe.name);
        let error = common::largest_difference(&again.displacement, &answer.displacement);
        assert!(error < 1e-6 * common::largest(&answer.displacement), "{}: {error}", recipe.name);
        for (count, n_points) in [(n - 4, 4), (n / 4, 1)] {
            let refused = solve(&body, &spread(count, n_points), &load, &settings);
            assert!(matches!(refused, Err(FemError::WrongLength { .. })), "{}", recipe.name);
        }
    }
}

/// Points of one tetrahedron with their own moduli change the answer, and only there.
#[test]
fn moduli_of_points_are_taken_point_by_point() {
    let material = Material::new(Stiffness::PerPoint {
        n_points: 4,
        young: (1..=8).map(f64::from).collect(),
        poisson: vec![0.3],
    })
    .expect("sound");
    for tet in 0..2 {
        for point in 0..4 {
            let wanted = Material::neo_hookean((4 * tet + point + 1) as f64, 0.3).expect("sound");
            assert_eq!(material.law_at(tet, point), wanted.law_at(0, 0));
        }
    }
}
