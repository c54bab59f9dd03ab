//! Does a test piece through time give what is known in closed form, and what a body gives?
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::laws::{Recipe, recipes};
use common::{bar, nodes_where};
use tissuereg_fem::material::homogeneous::{Compressibility, Mode, nominal_stress};
use tissuereg_fem::material::{Hyperelastic, Law};
use tissuereg_fem::{
    Behaviour, Body, Drainage, Element, FemError, History, Load, Part, Relaxation, Set, Softening,
    SofteningForm, SolveSettings, Supports, Swelling, stress_history,
};

const MODES: [Mode; 3] = [Mode::Uniaxial, Mode::Equibiaxial, Mode::SimpleShear];
/// From nearly none to the whole resistance to a change of volume.
const POISSONS: [f64; 4] = [0.0, 0.3, 0.45, 0.4995];

fn recipe(declared: &'static str, shape: &[f64], poisson: f64) -> Recipe {
    let shape = shape.iter().map(|&number| vec![number]).collect();
    Recipe { declared, shape, poisson, ..recipes().swap_remove(0) }
}

fn law(declared: &'static str, shape: &[f64], poisson: f64) -> Law {
    recipe(declared, shape, poisson).law()
}

fn relaxation(part: Part) -> Option<Relaxation> {
    Some(Relaxation { g: vec![0.3, 0.2], tau_s: vec![0.5, 7.0], part })
}

fn softening(form: SofteningForm) -> Option<Softening> {
    let beta = if form == SofteningForm::Damage { 0.0 } else { 0.2 };
    Some(Softening { form, r: 1.7, m_kpa: 0.2, beta })
}

fn history(
    law: &Law,
    behaviour: &Behaviour,
    mode: Mode,
    amounts: &[f64],
    times: &[f64],
) -> Vec<f64> {
    stress_history(law, behaviour, mode, amounts, times).expect("sound")
}

fn elastic(law: &Law, mode: Mode, amount: f64) -> f64 {
    nominal_stress(law, mode, amount, Compressibility::OfLaw).expect("stretched")
}

fn assert_near(found: f64, wanted: f64, tolerance: f64, what: &str) {
    assert!((found - wanted).abs() <= tolerance * (1.0 + wanted.abs()), "{what}: {found} {wanted}");
}

/// Coarse and fine steps, there and back, across the state of rest.
fn path(mode: Mode) -> Vec<f64> {
    let rest = if mode == Mode::SimpleShear { 0.0 } else { 1.0 };
    let fine = (0..40).map(|k| 0.3 * (0.25 * f64::from(k)).sin());
    let coarse = [0.0, 0.3, 0.3, -0.25, 0.0, 0.1, 1e-9, 0.0];
    fine.chain(coarse).map(|v| rest + v).collect()
}

#[test]
fn without_memory_every_row_is_elastic() {
    for recipe in recipes() {
        let law = recipe.law();
        for mode in MODES {
            let amounts = path(mode);
            let times = vec![0.0; amounts.len()];
            let found = history(&law, &Behaviour::default(), mode, &amounts, &times);
            for (found, &amount) in found.iter().zip(&amounts) {
                let what = format!("{} {mode:?} {amount}", recipe.name);
                match nominal_stress(&law, mode, amount, Compressibility::OfLaw) {
                    Some(wanted) => assert_near(*found, wanted, 1e-11, &what),
                    // St. Venant and Kirchhoff's sheet gets no thinner.
                    None => {
                        assert!(found.is_nan() && recipe.name == "st_venant_kirchhoff", "{what}");
                        break;
                    }
                }
            }
        }
    }
}

/// The stress that is held relaxes as a whole, so the sides stay where they are.
#[test]
fn a_hold_relaxes_as_its_series_says() {
    let behaviour = Behaviour { relaxation: relaxation(Part::Whole), ..Behaviour::default() };
    let times = [2.0, 2.1, 2.5, 5.0, 25.0];
    for (declared, shape) in [("neo-hookean", vec![]), ("fung", vec![2.0])] {
        for poisson in POISSONS {
            let law = law(declared, &shape, poisson);
            for (mode, amount) in MODES.into_iter().zip([1.3, 0.8, 0.4]) {
                let found = history(&law, &behaviour, mode, &[amount; 5], &times);
                for (found, time) in found.iter().zip(times) {
                    let held = time - times[0];
                    let left = 0.5 + 0.3 * (-held / 0.5).exp() + 0.2 * (-held / 7.0).exp();
                    let wanted = left * elastic(&law, mode, amount);
                    assert_near(*found, wanted, 1e-10, &format!("{mode:?} {poisson} {time}"));
                }
            }
        }
    }
}

/// `P = P_e(λ/λp)/λp` with `λp` the share of the largest strain before the step.
#[test]
fn a_set_moves_the_rest_of_a_bar() {
    let behaviour = Behaviour { set: Some(Set { fraction: 0.2 }), ..Behaviour::default() };
    let stretches = [1.0_f64, 1.2, 1.5, 1.3, 1.5_f64.powf(0.2), 0.5, 1.0];
    for poisson in POISSONS {
        let law = law("mooney-rivlin", &[0.3], poisson);
        let found = history(&law, &behaviour, Mode::Uniaxial, &stretches, &[0.0; 7]);
        // Sizes of strain: 1.5 below, and 0.5 above it in the end.
        for (row, largest) in [1.0, 1.0, 1.2, 1.5, 1.5, 1.5, 0.5].into_iter().enumerate() {
            let stays = f64::powf(largest, 0.2);
            let wanted = elastic(&law, Mode::Uniaxial, stretches[row] / stays) / stays;
            assert_near(found[row], wanted, 1e-9, &format!("{poisson} row {row}"));
        }
        assert!(found[4].abs() < 1e-9, "no stress at the new rest");
    }
}

/// The whole stress is multiplied, so the sides are the elastic ones.
#[test]
fn damage_of_a_bar_goes_with_its_largest_energy() {
    let softening = softening(SofteningForm::Damage);
    let behaviour = Behaviour { softening, ..Behaviour::default() };
    let stretches = [1.0, 1.2, 1.4, 1.1, 0.7, 1.4, 1.6];
    for poisson in POISSONS {
        let law = law("neo-hookean", &[], poisson);
        let (mu, lambda) = (law.moduli.mu, law.moduli.lambda);
        let found = history(&law, &behaviour, Mode::Uniaxial, &stretches, &[0.0; 7]);
        let mut largest = 0.0_f64;
        for (found, stretch) in found.iter().zip(stretches) {
            // Bisection on the side stretch, whose stress grows with it.
            let (mut low, mut high) = (0.1_f64, 3.0);
            for _ in 0..100 {
                let side = 0.5 * (low + high);
                let pull = mu * (side * side - 1.0) + lambda * (stretch * side * side).ln();
                if pull < 0.0 { low = side } else { high = side }
            }
            let h = [[stretch - 1.0, 0.0, 0.0], [0.0, low - 1.0, 0.0], [0.0, 0.0, low - 1.0]];
            largest = largest.max(law.energy(&h).expect("upright"));
            let left = 1.0 - (1.0 - 1.0 / 1.7) * (1.0 - (-largest / 0.2).exp());
            let wanted = left * elastic(&law, Mode::Uniaxial, stretch);
            assert_near(*found, wanted, 1e-9, &format!("{poisson} {stretch}"));
        }
    }
}

/// Simple shear keeps the volume: the energy `μ γ²/2` is isochoric, and its stress is softened below
/// the largest one. Loading again is not, from there on.
#[test]
fn unloading_and_loading_again_follow_ogden_and_roxburgh() {
    let softening = softening(SofteningForm::OgdenRoxburgh);
    let behaviour = Behaviour { softening, ..Behaviour::default() };
    let law = law("neo-hookean", &[], 0.4);
    let mu = law.moduli.mu;
    let shears = [0.0, 0.2, 0.4, 0.3, 0.1, -0.2, 0.3, 0.4, 0.5];
    let found = history(&law, &behaviour, Mode::SimpleShear, &shears, &[0.0; 9]);
    let mut largest = 0.0_f64;
    for (found, shear) in found.iter().zip(shears) {
        let energy = 0.5 * mu * shear * shear;
        let below = (largest - energy).max(0.0);
        let left = 1.0 - libm::erf(below / (0.2 + 0.2 * largest)) / 1.7;
        assert_near(*found, left * mu * shear, 1e-12, &format!("{shear}"));
        largest = largest.max(energy);
    }
}

/// `2 η ΔE/Δt` in the first step, whose metric is that of rest: `P₀₁ = η (γ + γ³)/Δt`.
#[test]
fn a_step_of_shear_flows() {
    let behaviour = Behaviour { viscosity_kpa_s: 3.0, ..Behaviour::default() };
    let law = law("neo-hookean", &[], 0.4);
    let found =
        history(&law, &behaviour, Mode::SimpleShear, &[0.0, 0.3, 0.3, 0.3], &[0.0, 0.5, 0.5, 1.0]);
    let elastic = law.moduli.mu * 0.3;
    assert_near(found[1], elastic + 3.0 * (0.3 + 0.027) / 0.5, 1e-13, "while it flows");
    assert_near(found[2], elastic, 1e-13, "in no time");
    assert_near(found[3], elastic, 1e-13, "held");
}

/// Every behaviour, and all of them.
fn behaviours() -> Vec<(&'static str, Behaviour)> {
    let none = Behaviour::default;
    let all = |part, form| Behaviour {
        relaxation: relaxation(part),
        viscosity_kpa_s: 0.5,
        softening: softening(form),
        set: Some(Set { fraction: 0.2 }),
        drainage: Some(Drainage { share: 0.3, tau_s: 2.0 }),
        swelling: Some(Swelling { linear_strain: 0.05, from_time_s: 0.0, to_time_s: 3.0 }),
    };
    let (unloaded, damage) = (SofteningForm::OgdenRoxburgh, SofteningForm::Damage);
    let every = all(Part::Whole, unloaded);
    vec![
        ("whole", Behaviour { relaxation: relaxation(Part::Whole), ..none() }),
        ("isochoric", Behaviour { relaxation: relaxation(Part::Isochoric), ..none() }),
        ("rate", Behaviour { viscosity_kpa_s: 0.5, ..none() }),
        ("unloaded", Behaviour { softening: softening(unloaded), ..none() }),
        ("damage", Behaviour { softening: softening(damage), ..none() }),
        ("set", Behaviour { set: every.set, ..none() }),
        ("drainage", Behaviour { drainage: every.drainage, ..none() }),
        ("swelling", Behaviour { swelling: every.swelling, ..none() }),
        ("all", every),
        ("all, with damage", all(Part::Isochoric, damage)),
    ]
}

/// A cube between rollers, free to contract, and its end.
fn cube() -> (Body, Vec<usize>) {
    let mesh = bar([1, 1, 1], [10.0; 3]);
    let mut supports = Supports::new();
    for (node, x) in mesh.nodes().iter().enumerate() {
        supports = supports.hold_axes(&[node], x.map(|v| v < 1e-9));
    }
    let end = nodes_where(&mesh, |x| x[0] > 10.0 - 1e-9);
    (Body::new(mesh, Element::Tet4, supports).expect("held"), end)
}

/// Pulled by the stresses that the piece says, a body has its stretches, in every behaviour, at any
/// Poisson's ratio, and with fibres that make its sides unlike.
#[test]
fn a_body_pulled_by_these_stresses_has_these_stretches() {
    let (body, end) = cube();
    let on_end = |t: &&[usize; 3]| t.iter().all(|n| end.contains(n));
    let triangles: Vec<_> =
        body.mesh().surface_triangles().iter().filter(on_end).copied().collect();
    let plain = recipes().swap_remove(0);
    let recipes = [
        plain.clone(),
        Recipe { poisson: 0.2, ..plain.clone() },
        recipe("fung", &[0.5], 0.495),
        Recipe { fibre: Some((2.0, 0.5, [0.0, 1.0, 0.0], false)), ..plain },
    ];
    let times = [0.0, 1.0, 2.0, 3.5, 3.5, 6.0, 7.0, 8.0];
    let stretches = [1.0, 1.15, 1.3, 1.3, 1.25, 1.1, 0.95, 1.35];
    for recipe in recipes {
        let (law, material) = (recipe.law(), recipe.material().expect("sound"));
        for (name, behaviour) in behaviours() {
            let stress = history(&law, &behaviour, Mode::Uniaxial, &stretches, &times);
            let mut frames = History::new(&body, material.clone(), behaviour).expect("sound");
            for ((&stress, stretch), time) in stress.iter().zip(stretches).zip(times) {
                let traction = vec![[stress, 0.0, 0.0]; triangles.len()];
                let force = body.traction_forces(&triangles, &traction).expect("on the surface");
                let settings = SolveSettings::default().with_tolerance(1e-11);
                let answer = frames
                    .advance(&body, &Load::from_forces(force), time, &settings)
                    .expect("pulled");
                let found = 1.0 + answer.displacement[end[0]][0] / 10.0;
                assert_near(found, stretch, 1e-8, &format!("{name} {recipe:?} at {time} s"));
            }
        }
    }
}

#[test]
fn a_body_sheared_by_these_amounts_has_these_stresses() {
    let mesh = bar([1, 1, 1], [10.0; 3]);
    let all: Vec<usize> = (0..mesh.n_nodes()).collect();
    let body = Body::new(mesh, Element::Tet4, all).expect("held");
    let times = [0.0, 1.0, 2.0, 3.5, 3.5, 6.0, 7.0, 8.0];
    let shears = [0.0, 0.2, 0.5, 0.5, 0.4, 0.1, -0.2, 0.6];
    for recipe in recipes() {
        let (law, material) = (recipe.law(), recipe.material().expect("sound"));
        for (name, behaviour) in behaviours() {
            let stress = history(&law, &behaviour, Mode::SimpleShear, &shears, &times);
            let mut frames = History::new(&body, material.clone(), behaviour).expect("sound");
            for ((&stress, shear), time) in stress.iter().zip(shears).zip(times) {
                let rows = body.nodes().iter().map(|x| [shear * x[1], 0.0, 0.0]).collect();
                let load = Load::from_prescribed(rows);
                let answer =
                    frames.advance(&body, &load, time, &SolveSettings::default()).expect("held");
                let top = body.nodes().iter().zip(&answer.reactions).filter(|(x, _)| x[1] > 9.0);
                let found = top.map(|(_, r)| r[0]).sum::<f64>() / 100.0;
                assert_near(stress, found, 1e-11, &format!("{} {name} {time}", recipe.name));
            }
        }
    }
}

#[test]
fn a_row_without_stress_ends_the_history() {
    let behaviour = Behaviour { relaxation: relaxation(Part::Whole), ..Behaviour::default() };
    let law = law("neo-hookean", &[], 0.4);
    for bad in [0.0, -0.5, f64::NAN, f64::INFINITY] {
        let found = history(&law, &behaviour, Mode::Uniaxial, &[1.0, 1.1, bad, 1.1], &[0.0; 4]);
        let there: Vec<bool> = found.iter().map(|v| v.is_finite()).collect();
        assert_eq!(there, [true, true, false, false], "{bad}");
    }
    assert_eq!(history(&law, &behaviour, Mode::Uniaxial, &[], &[]), Vec::<f64>::new());
}

#[test]
fn what_is_no_history_is_refused() {
    let law = law("neo-hookean", &[], 0.4);
    let run = |behaviour: &Behaviour, times: &[f64]| {
        stress_history(&law, behaviour, Mode::Uniaxial, &[1.0, 1.1], times)
    };
    let none = Behaviour::default();
    assert!(matches!(run(&none, &[0.0]), Err(FemError::WrongLength { expected: 2, found: 1, .. })));
    assert!(matches!(run(&none, &[1.0, 0.5]), Err(FemError::TimeRunsBack { .. })));
    assert!(matches!(run(&none, &[0.0, f64::NAN]), Err(FemError::NonFinite { row: 1, .. })));
    let worn = Behaviour { viscosity_kpa_s: -1.0, ..none };
    assert!(matches!(run(&worn, &[0.0, 1.0]), Err(FemError::BadParameter { .. })));
}

/// St. Venant and Kirchhoff's bar that softens on the way back finds no stable width, however fine
/// the way is.
#[test]
fn a_bar_without_a_stable_width_has_no_stress_from_there_on() {
    let softening = softening(SofteningForm::OgdenRoxburgh);
    let behaviour = Behaviour { softening, ..Behaviour::default() };
    for poisson in [0.3, 0.45, 0.49] {
        let law = law("st-venant-kirchhoff", &[], poisson);
        let mut first = Vec::new();
        for n in [40_u32, 400, 4_000] {
            let up = (0..=n).map(|k| 1.0 + 0.4 * f64::from(k) / f64::from(n));
            let down = (0..n).rev().map(|k| 1.0 + 0.4 * f64::from(k) / f64::from(n));
            let stretches: Vec<f64> = up.chain(down).collect();
            let times = vec![0.0; stretches.len()];
            let found = history(&law, &behaviour, Mode::Uniaxial, &stretches, &times);
            let row = found.iter().position(|stress| stress.is_nan()).expect("unstable");
            assert!(found[row..].iter().all(|stress| stress.is_nan()), "{poisson} {n}");
            assert!(row > n as usize, "{poisson} {n}: stable while it is pulled");
            first.push(stretches[row]);
        }
        // One coarse row, in which it may be lost.
        assert!(first.iter().all(|at| (at - first[2]).abs() < 0.011), "{poisson} {first:?}");
    }
}

/// A step of hardly any time makes the sides stiff; the next one must not believe it.
#[test]
fn a_step_of_hardly_any_time_is_forgotten() {
    let behaviour = Behaviour { viscosity_kpa_s: 33.0, ..Behaviour::default() };
    let law = law("neo-hookean", &[], 0.3);
    let stretches = [1.0, 1.1, 1.2, 1.2 + 1e-16, 1.25, 1.3, 1.2, 1.1];
    let times = [0.0, 1.0, 2.0, 2.0 + 1e-12, 3.0, 4.0, 5.0, 6.0];
    let found = history(&law, &behaviour, Mode::Uniaxial, &stretches, &times);
    let without = |values: [f64; 8]| -> Vec<f64> {
        (0..8).filter(|&row| row != 3).map(|row| values[row]).collect()
    };
    let plain = history(&law, &behaviour, Mode::Uniaxial, &without(stretches), &without(times));
    for (row, (found, wanted)) in found.iter().skip(4).zip(&plain[3..]).enumerate() {
        assert_near(*found, *wanted, 1e-7, &format!("row {row}"));
    }
}

/// Fibres across let the sides go far from where a prolonged change of volume puts them.
#[test]
fn a_coarse_way_back_with_fibres_across_ends_where_a_fine_one_does() {
    let behaviour = Behaviour { relaxation: relaxation(Part::Whole), ..Behaviour::default() };
    for (poisson, k1_over_mu, coarse) in
        [(0.495, 10.0, vec![1.0, 0.8, 0.5, 1.6]), (0.45, 2.0, vec![1.0, 1.5, 3.4])]
    {
        let fibre = Some((k1_over_mu, 0.5, [0.0, 1.0, 0.0], false));
        let law = Recipe { fibre, ..recipe("neo-hookean", &[], poisson) }.law();
        for mode in [Mode::Uniaxial, Mode::Equibiaxial] {
            let times = vec![0.0; coarse.len()];
            let found = history(&law, &behaviour, mode, &coarse, &times);
            for (found, amount) in found.iter().zip(&coarse) {
                assert_near(
                    *found,
                    elastic(&law, mode, *amount),
                    1e-9,
                    &format!("{mode:?} {amount}"),
                );
            }
        }
    }
}

/// Nothing is finite at an overflowing rate, and nothing after it is.
#[test]
fn a_shear_without_a_stress_has_none_after_it() {
    let behaviour = Behaviour { viscosity_kpa_s: 1e300, ..Behaviour::default() };
    let law = law("neo-hookean", &[], 0.3);
    let found = history(&law, &behaviour, Mode::SimpleShear, &[0.0, 0.5, 0.5], &[0.0, 1e-12, 1.0]);
    assert!(found[0].is_finite() && found[1..].iter().all(|stress| stress.is_nan()), "{found:?}");
}
