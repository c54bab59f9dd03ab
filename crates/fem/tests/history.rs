//! Is it right where the answer is known? Homogeneous blocks through time.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{bar, largest, largest_difference, nodes_where};
use tissuereg_fem::material::{Hyperelastic, NeoHookean};
use tissuereg_fem::{
    Behaviour, Body, Drainage, Element, History, Load, Material, Part, Relaxation, Set, Softening,
    SofteningForm, Solution, SolveSettings, Supports, Swelling, solve,
};

const YOUNG: f64 = 8.0;
const POISSON: f64 = 0.4;

fn law() -> NeoHookean {
    NeoHookean::from_young(YOUNG, POISSON)
}

fn material() -> Material {
    Material::neo_hookean(YOUNG, POISSON).expect("sound")
}

/// A cube of 10 mm all of whose corner nodes are held, for homogeneous deformation.
fn held_cube(element: Element) -> Body {
    let mesh = bar([2, 2, 2], [10.0; 3]);
    let all: Vec<usize> = (0..mesh.n_nodes()).collect();
    Body::new(mesh, element, all).expect("held")
}

/// Load that gives a body whose nodes are all held the displacement `h X`.
fn affine(body: &Body, h: [[f64; 3]; 3]) -> Load {
    let rows = body.held_nodes().iter().map(|&n| {
        let x = body.nodes()[n];
        std::array::from_fn(|i| (0..3).map(|j| h[i][j] * x[j]).sum())
    });
    Load::from_prescribed(rows.collect())
}

/// Nominal stress on the face at `axis` = 10 mm, kPa: row `i` of the traction.
fn nominal(body: &Body, answer: &Solution, axis: usize) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (&node, r) in body.held_nodes().iter().zip(&answer.reactions) {
        if body.nodes()[node][axis] > 10.0 - 1e-9 {
            (0..3).for_each(|i| sum[i] += r[i] / 100.0);
        }
    }
    sum
}

fn history(body: &Body, behaviour: Behaviour) -> History {
    History::new(body, material(), behaviour).expect("sound")
}

fn settings() -> SolveSettings {
    SolveSettings::default().with_tolerance(1e-11)
}

const STRETCHED: [[f64; 3]; 3] = [[0.3, 0.1, 0.0], [0.0, -0.1, 0.0], [0.0, 0.05, -0.05]];

#[test]
fn without_behaviour_every_frame_is_the_elastic_answer() {
    let mesh = bar([4, 2, 2], [20.0, 10.0, 10.0]);
    let body = common::clamped_at_x0(mesh, Element::Tet10);
    let mut history = history(&body, Behaviour::default());
    for (time, force) in [(0.0, 1e-3), (1.0, 4e-3), (2.0, -2e-3)] {
        let load = Load { body_force: [0.0, 0.0, force], ..Load::default() };
        let frame = history.advance(&body, &load, time, &settings()).expect("stands");
        let alone = solve(&body, &material(), &load, &settings()).expect("stands");
        assert!(largest_difference(&frame.displacement, &alone.displacement) < 1e-7);
        assert!(largest_difference(&frame.reactions, &alone.reactions) < 1e-7);
    }
}

#[test]
fn a_held_stretch_relaxes_as_its_series_says() {
    for element in [Element::Tet4, Element::Tet10] {
        let body = held_cube(element);
        let relaxation = Relaxation { g: vec![0.3, 0.2], tau_s: vec![0.5, 7.0], part: Part::Whole };
        let behaviour = Behaviour { relaxation: Some(relaxation), ..Behaviour::default() };
        let mut history = history(&body, behaviour);
        let load = affine(&body, STRETCHED);
        let elastic = law().stress(&STRETCHED).expect("upright");
        for time in [0.0, 0.1, 0.5, 3.0, 20.0] {
            let answer = history.advance(&body, &load, time, &settings()).expect("held");
            let left = 0.5 + 0.3 * (-time / 0.5_f64).exp() + 0.2 * (-time / 7.0_f64).exp();
            for axis in 0..3 {
                let found = nominal(&body, &answer, axis);
                for i in 0..3 {
                    let wanted = left * elastic[i][axis];
                    assert!((found[i] - wanted).abs() < 1e-6 * (1.0 + wanted.abs()), "{time}");
                }
            }
        }
    }
}

/// A frame at the time of the last one is reached at once: nothing relaxes, nothing flows.
#[test]
fn a_frame_at_the_same_time_is_instantaneous() {
    let body = held_cube(Element::Tet4);
    let relaxation = Relaxation { g: vec![0.5], tau_s: vec![1e-3], part: Part::Whole };
    let behaviour =
        Behaviour { relaxation: Some(relaxation), viscosity_kpa_s: 50.0, ..Behaviour::default() };
    let mut history = history(&body, behaviour);
    history.advance(&body, &Load::default(), 2.0, &settings()).expect("at rest");
    let load = affine(&body, STRETCHED);
    let at_once = history.advance(&body, &load, 2.0, &settings()).expect("held");
    let elastic = law().stress(&STRETCHED).expect("upright");
    let found = nominal(&body, &at_once, 0);
    assert!((0..3).all(|i| (found[i] - elastic[i][0]).abs() < 1e-9), "{found:?}");
    let later = history.advance(&body, &load, 3.0, &settings()).expect("held");
    assert!((nominal(&body, &later, 0)[0] - 0.5 * elastic[0][0]).abs() < 1e-9);
}

/// A ramp whose second Piola-Kirchhoff stress grows linearly has an exact integral; here small
/// strains make it linear to 1e-6 of itself.
#[test]
fn a_ramp_relaxes_as_its_integral_says() {
    let body = held_cube(Element::Tet4);
    let relaxation = Relaxation { g: vec![0.6], tau_s: vec![2.0], part: Part::Whole };
    let behaviour = Behaviour { relaxation: Some(relaxation), ..Behaviour::default() };
    let mut history = history(&body, behaviour);
    let strain = |time: f64| [[1e-7 * time, 0.0, 0.0], [0.0; 3], [0.0; 3]];
    let modulus = law().lambda + 2.0 * law().mu;
    for time in [0.0, 0.3, 1.7, 5.0_f64] {
        let load = affine(&body, strain(time));
        let answer = history.advance(&body, &load, time, &settings()).expect("held");
        let wanted = 1e-7 * modulus * (0.4 * time + 0.6 * 2.0 * -(-time / 2.0).exp_m1());
        let found = nominal(&body, &answer, 0)[0];
        assert!((found - wanted).abs() <= 2e-6 * wanted, "{found} {wanted}");
    }
}

/// Simple shear has isochoric stress alone to first order, pressure has none.
#[test]
fn isochoric_relaxation_and_drainage_leave_the_other_part() {
    let body = held_cube(Element::Tet4);
    let relaxation = Relaxation { g: vec![0.4], tau_s: vec![1.0], part: Part::Isochoric };
    let drainage = Drainage { share: 0.7, tau_s: 1.0 };
    let shear = [[0.0, 1e-6, 0.0], [0.0; 3], [0.0; 3]];
    let squeeze = [[-1e-6, 0.0, 0.0], [0.0, -1e-6, 0.0], [0.0, 0.0, -1e-6]];
    for (relaxes, drains, left) in [(true, false, [0.6, 1.0]), (false, true, [1.0, 0.3])] {
        let behaviour = Behaviour {
            relaxation: relaxes.then(|| relaxation.clone()),
            drainage: drains.then_some(drainage),
            ..Behaviour::default()
        };
        for (h, at, left) in [(shear, [0, 1], left[0]), (squeeze, [0, 0], left[1])] {
            let mut history = history(&body, behaviour.clone());
            let load = affine(&body, h);
            let mut frame = |time: f64| {
                let answer = history.advance(&body, &load, time, &settings()).expect("held");
                nominal(&body, &answer, at[1])[at[0]]
            };
            let (first, last) = (frame(0.0), frame(60.0));
            assert!((last / first - left).abs() < 1e-5, "{last} {first} {left}");
        }
    }
}

#[test]
fn shear_at_a_rate_has_twice_viscosity_times_rate() {
    let body = held_cube(Element::Tet4);
    let viscosity_kpa_s = 3.0;
    let (gamma, rate) = (0.2, 0.5);
    let shear = |g: f64| [[0.0, g, 0.0], [0.0; 3], [0.0; 3]];
    // Cauchy stress 2 η D with D = rate/2 (e1 e2 + e2 e1); nominal P = J σ F⁻ᵀ.
    let elastic = law().stress(&shear(gamma)).expect("upright");
    let wanted = [-viscosity_kpa_s * rate * gamma, viscosity_kpa_s * rate];
    let mut last_error = f64::INFINITY;
    for step in [1e-2, 1e-3, 1e-4] {
        let mut history = history(&body, Behaviour { viscosity_kpa_s, ..Behaviour::default() });
        let frames = [(0.0, gamma - rate * step), (step, gamma)];
        let mut found = [0.0; 2];
        for (time, g) in frames {
            let load = affine(&body, shear(g));
            let answer = history.advance(&body, &load, time, &settings()).expect("held");
            found = [nominal(&body, &answer, 0)[0], nominal(&body, &answer, 1)[0]];
        }
        let error = (found[0] - elastic[0][0] - wanted[0])
            .abs()
            .max((found[1] - elastic[0][1] - wanted[1]).abs());
        // First order in the step.
        assert!(error < 0.2 * last_error, "{error} after {last_error}");
        last_error = error;
    }
    assert!(last_error < 1e-4 * wanted[1], "{last_error}");
}

/// A bar between rollers, free to contract, pulled by its end.
fn pulled_bar() -> (Body, Vec<usize>) {
    let mesh = bar([2, 2, 2], [10.0; 3]);
    let on = |axis: usize, at: f64| nodes_where(&mesh, |x| (x[axis] - at).abs() < 1e-9);
    let mut axes = vec![[false; 3]; mesh.n_nodes()];
    for axis in 0..3 {
        on(axis, 0.0).into_iter().for_each(|n| axes[n][axis] = true);
    }
    let end = on(0, 10.0);
    let mut supports = Supports::new();
    for (node, axes) in axes.iter().enumerate() {
        if axes.contains(&true) {
            supports = supports.hold_axes(&[node], *axes);
        }
    }
    let body = Body::new(mesh, Element::Tet4, supports).expect("held");
    (body, end)
}

fn pull(body: &Body, end: &[usize], stress: f64) -> Load {
    let triangles: Vec<[usize; 3]> = body
        .mesh()
        .surface_triangles()
        .iter()
        .copied()
        .filter(|t| t.iter().all(|n| end.contains(n)))
        .collect();
    let traction = vec![[stress, 0.0, 0.0]; triangles.len()];
    Load::from_forces(body.traction_forces(&triangles, &traction).expect("on the surface"))
}

#[test]
fn a_set_leaves_its_share_of_the_largest_strain() {
    let (body, end) = pulled_bar();
    let behaviour = Behaviour { set: Some(Set { fraction: 0.25 }), ..Behaviour::default() };
    let mut history = history(&body, behaviour);
    let pulled = history.advance(&body, &pull(&body, &end, 3.0), 0.0, &settings()).expect("pulled");
    let released = history.advance(&body, &Load::default(), 1.0, &settings()).expect("released");
    let log = |answer: &Solution, axis: usize| {
        (1.0 + answer.displacement[body.n_nodes() - 1][axis] / 10.0).ln()
    };
    for axis in 0..3 {
        let (largest, stays) = (log(&pulled, axis), log(&released, axis));
        assert!(largest.abs() > 0.05);
        assert!((stays - 0.25 * largest).abs() < 1e-9, "axis {axis}: {stays} of {largest}");
    }
}

#[test]
fn a_free_block_swells_without_stress() {
    for element in [Element::Tet4, Element::Tet10] {
        let mesh = bar([2, 2, 2], [10.0; 3]);
        let supports = Supports::new()
            .hold(&[0])
            .hold_axes(
                &nodes_where(&mesh, |x| x[2] > 9.0 && x[0] + x[1] < 1e-9),
                [true, true, false],
            )
            .hold_axes(
                &nodes_where(&mesh, |x| x[1] > 9.0 && x[0] + x[2] < 1e-9),
                [true, false, false],
            );
        let body = Body::new(mesh, element, supports).expect("held");
        let swelling = Swelling { linear_strain: 0.2, from_time_s: 1.0, to_time_s: 3.0 };
        let mut history =
            history(&body, Behaviour { swelling: Some(swelling), ..Behaviour::default() });
        for (time, stretch) in [(0.0, 0.0), (2.0, 0.1), (3.0, 0.2), (9.0, 0.2)] {
            let answer =
                history.advance(&body, &Load::default(), time, &settings()).expect("swells");
            let wanted: Vec<[f64; 3]> =
                body.nodes().iter().map(|x| x.map(|v| stretch * v)).collect();
            assert!(largest_difference(&answer.displacement, &wanted) < 1e-8, "{time}");
            assert!(largest(&answer.reactions) < 1e-7, "no stress");
        }
    }
}

/// Simple shear keeps the volume, so the energy is isochoric, `μ γ²/2`, and the shear stress of the
/// softened body `η μ γ`, with `η` of the energy and the largest one before it.
fn assert_softened(softening: Softening, eta: impl Fn(f64, f64) -> f64) {
    let body = held_cube(Element::Tet4);
    let mut history =
        history(&body, Behaviour { softening: Some(softening), ..Behaviour::default() });
    let mu = law().mu;
    let mut largest: f64 = 0.0;
    for (frame, gamma) in [0.0, 0.2, 0.4, 0.3, 0.1, -0.2, 0.0, 0.4, 0.5].into_iter().enumerate() {
        let load = affine(&body, [[0.0, gamma, 0.0], [0.0; 3], [0.0; 3]]);
        let answer = history.advance(&body, &load, frame as f64, &settings()).expect("held");
        let energy = 0.5 * mu * gamma * gamma;
        let wanted = eta(energy, largest) * mu * gamma;
        largest = largest.max(energy);
        let found = nominal(&body, &answer, 1)[0];
        assert!((found - wanted).abs() < 1e-9, "{gamma}: {found} {wanted}");
    }
}

#[test]
fn unloading_follows_ogden_and_roxburgh() {
    let softening =
        Softening { form: SofteningForm::OgdenRoxburgh, r: 2.0, m_kpa: 0.05, beta: 0.3 };
    assert_softened(softening, |energy, largest| {
        if energy >= largest {
            1.0
        } else {
            1.0 - libm::erf((largest - energy) / (0.05 + 0.3 * largest)) / 2.0
        }
    });
}

/// Damage softens a first load too: `η = 1 − (1 − 1/r) (1 − exp(−Wm/m))`.
#[test]
fn damage_goes_with_the_largest_energy() {
    let softening = Softening { form: SofteningForm::Damage, r: 2.5, m_kpa: 0.15, beta: 0.0 };
    assert_softened(softening, |energy, largest| {
        1.0 - 0.6 * (1.0 - (-energy.max(largest) / 0.15).exp())
    });
}

#[test]
fn steps_are_halved_where_one_does_not_do() {
    let mesh = bar([6, 2, 2], [60.0, 10.0, 10.0]);
    let end = nodes_where(&mesh, |x| x[0] > 59.0);
    let clamped = nodes_where(&mesh, |x| x[0] < 1.0);
    let body =
        Body::new(mesh, Element::Tet4, Supports::new().hold(&clamped).hold(&end)).expect("held");
    let bend = |size: f64| {
        let rows = body
            .held_nodes()
            .iter()
            .map(|n| if end.contains(n) { [-0.5 * size, 0.0, size] } else { [0.0; 3] });
        Load::from_prescribed(rows.collect())
    };
    let mut history = history(&body, Behaviour { viscosity_kpa_s: 0.1, ..Behaviour::default() });
    history.advance(&body, &bend(0.0), 0.0, &settings()).expect("at rest");
    let few = SolveSettings::default().with_max_iterations(11);
    let answer = history.advance(&body, &bend(40.0), 1.0, &few).expect("in parts");
    assert!(answer.report.load_steps > 1, "{:?}", answer.report);
    assert_eq!(history.time_s(), Some(1.0));
}
