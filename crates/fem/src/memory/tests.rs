//! Is the mathematics consistent? Stress against energy, tangent against stress, of every
//! behaviour, at points that have been through something.
#![allow(clippy::expect_used)]

use std::sync::Arc;

use super::behaviour::{
    Behaviour, Drainage, Part, Relaxation, Set, Softening, SofteningForm, Swelling,
};
use super::state::{StepModel, StepState, fresh_states};
use crate::assembly::{PointModel, internal_force_into};
use crate::body::Body;
use crate::element::Element;
use crate::material::{Material, Matrix3};
use crate::mesh::Mesh;

/// The behaviours of this file, one by one and all together.
fn behaviours() -> Vec<(&'static str, Behaviour)> {
    let none = Behaviour::default;
    let relaxation = |part| Some(Relaxation { g: vec![0.3, 0.25], tau_s: vec![0.4, 6.0], part });
    let softening =
        Some(Softening { form: SofteningForm::OgdenRoxburgh, r: 1.7, m_kpa: 0.4, beta: 0.2 });
    let damage = Some(Softening { form: SofteningForm::Damage, r: 1.7, m_kpa: 0.6, beta: 0.0 });
    let set = Some(Set { fraction: 0.3 });
    let drainage = Some(Drainage { share: 0.35, tau_s: 2.0 });
    let swelling = Some(Swelling { linear_strain: 0.1, from_time_s: 0.0, to_time_s: 3.0 });
    vec![
        ("none", none()),
        ("whole", Behaviour { relaxation: relaxation(Part::Whole), ..none() }),
        ("isochoric", Behaviour { relaxation: relaxation(Part::Isochoric), ..none() }),
        ("rate", Behaviour { viscosity_kpa_s: 2.5, ..none() }),
        ("softening", Behaviour { softening, ..none() }),
        ("damage", Behaviour { softening: damage, ..none() }),
        ("set", Behaviour { set, ..none() }),
        ("drainage", Behaviour { drainage, ..none() }),
        ("swelling", Behaviour { swelling, ..none() }),
        (
            "all",
            Behaviour {
                relaxation: relaxation(Part::Whole),
                viscosity_kpa_s: 2.5,
                softening,
                set,
                drainage,
                swelling,
            },
        ),
        (
            "damage and all others",
            Behaviour {
                relaxation: relaxation(Part::Isochoric),
                viscosity_kpa_s: 2.5,
                softening: damage,
                set,
                drainage,
                swelling,
            },
        ),
    ]
}

/// A random displacement gradient of the size given.
fn gradient(seed: u64, size: f64) -> Matrix3 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    std::array::from_fn(|_| {
        std::array::from_fn(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            size * ((state >> 11) as f64 / (1u64 << 52) as f64 - 1.0)
        })
    })
}

fn moved(h: &Matrix3, place: usize, by: f64) -> Matrix3 {
    let mut h = *h;
    h[place / 3][place % 3] += by;
    h
}

#[test]
fn stress_and_tangent_are_derivatives_of_every_behaviour() {
    let material = Material::neo_hookean(9.0, 0.4).expect("sound");
    for (name, behaviour) in behaviours() {
        behaviour.check().expect(name);
        let mut states = Arc::new(fresh_states(&behaviour, 1));
        let mut room = Vec::new();
        for (k, time) in [0.0, 0.5, 2.0].into_iter().enumerate() {
            let length = if k == 0 { 0.0 } else { 0.7 };
            let step = StepState::new(&material, &behaviour, &states, 1, length, time, false);
            let h = gradient(k as u64 + 3, 0.25);
            let updated = |room| step.updated(&material, &[h], room, false).expect("upright");
            let next = updated(Vec::new());
            assert_eq!(next, updated(room), "{name}: whatever was in the room");
            room = states.to_vec();
            states = Arc::new(next);
        }
        let step = StepState::new(&material, &behaviour, &states, 1, 0.3, 2.3, false);
        let model = StepModel { elastic: &material, step: &step };
        // Below and above the largest load so far.
        for (seed, size) in [(20, 0.05), (21, 0.15), (22, 0.4)] {
            let h = gradient(seed, size);
            let answer = model.response(0, 0, &h).expect("upright");
            let tangent = model.tangent(0, 0, &h).expect("upright");
            for place in 0..9 {
                let at = |by: f64| model.response(0, 0, &moved(&h, place, by)).expect("upright");
                // Central differences: truncation ~ step², rounding ~ 1e-16 / step.
                let (plus, minus) = (at(1e-5), at(-1e-5));
                let slope = (plus.energy - minus.energy) / 2e-5;
                let own = answer.stress[place / 3][place % 3];
                assert!((slope - own).abs() < 2e-7 * (1.0 + own.abs()), "{name}: {slope} {own}");
                for row in 0..9 {
                    let (p, m) = (plus.stress[row / 3][row % 3], minus.stress[row / 3][row % 3]);
                    let (slope, own) = ((p - m) / 2e-5, tangent[row][place]);
                    assert!(
                        (slope - own).abs() < 1e-6 * (10.0 + own.abs()),
                        "{name} {row} {place}: {slope} {own}"
                    );
                    assert!(
                        (own - tangent[place][row]).abs() < 1e-11 * (1.0 + own.abs()),
                        "{name}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_rotation_before_or_after_changes_nothing_but_the_frame() {
    let (sin, cos) = 0.6_f64.sin_cos();
    let turn = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
    let turned = |h: &Matrix3| -> Matrix3 {
        let f = super::tensor::product(&turn, &super::tensor::plus_identity(h));
        std::array::from_fn(|i| std::array::from_fn(|j| f[i][j] - f64::from(u8::from(i == j))))
    };
    let material = Material::neo_hookean(9.0, 0.4).expect("sound");
    for (name, behaviour) in behaviours() {
        let run = |rotate: bool| {
            let mut states = Arc::new(fresh_states(&behaviour, 1));
            let mut energy = 0.0_f64;
            for (k, time) in [0.0, 0.5, 2.0].into_iter().enumerate() {
                let h = gradient(k as u64 + 3, 0.25);
                // The body turns from the second frame on.
                let h = if rotate && k > 0 { turned(&h) } else { h };
                let step = StepState::new(&material, &behaviour, &states, 1, time, time, false);
                let model = StepModel { elastic: &material, step: &step };
                energy += model.response(0, 0, &h).expect("upright").energy;
                states =
                    Arc::new(step.updated(&material, &[h], Vec::new(), false).expect("upright"));
            }
            energy
        };
        let (still, rotated) = (run(false), run(true));
        assert!((still - rotated).abs() < 1e-11 * (1.0 + still.abs()), "{name}");
    }
}

#[test]
fn an_inverted_point_has_no_energy() {
    let material = Material::neo_hookean(9.0, 0.4).expect("sound");
    let turned = [[-1.5, 0.0, 0.0], [0.0; 3], [0.0; 3]];
    for (_, behaviour) in behaviours() {
        let states = Arc::new(fresh_states(&behaviour, 1));
        let step = StepState::new(&material, &behaviour, &states, 1, 0.0, 0.0, false);
        let model = StepModel { elastic: &material, step: &step };
        assert_eq!(model.response(0, 0, &turned), None);
        assert_eq!(model.tangent(0, 0, &turned), None);
        if behaviour.relaxation.is_some() || behaviour.softening.is_some() {
            assert!(step.updated(&material, &[turned], Vec::new(), false).is_none());
        }
    }
}

#[test]
fn a_set_keeps_its_share_of_the_largest_logarithmic_strain() {
    let material = Material::neo_hookean(9.0, 0.4).expect("sound");
    let fraction = 0.3;
    let behaviour = Behaviour { set: Some(Set { fraction }), ..Behaviour::default() };
    let (sin, cos) = 0.6_f64.sin_cos();
    let turn = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]];
    let mut states = Arc::new(fresh_states(&behaviour, 1));
    let mut largest = [1.0; 3];
    let norm = |stretches: &[f64; 3]| stretches.iter().map(|v| v.ln() * v.ln()).sum::<f64>();
    let mut grown = 0;
    // Pulled and compressed by turns, so that the norms are close; the last two are far beyond.
    for one in [1.1_f64, 1.2, 1.199, 1.201, 0.84, 0.83, 1.2, 1.204, 1.205, 1.0, 1.206, 0.3, 3.4] {
        let stretches = [one, 1.0 / one.sqrt(), 1.01];
        if norm(&stretches) > norm(&largest) {
            (largest, grown) = (stretches, grown + 1);
        }
        let h: Matrix3 = std::array::from_fn(|i| {
            std::array::from_fn(|j| turn[i][j] * stretches[j] - f64::from(u8::from(i == j)))
        });
        let step = StepState::new(&material, &behaviour, &states, 1, 1.0, 1.0, false);
        states = Arc::new(step.updated(&material, &[h], Vec::new(), false).expect("upright"));
        // At rest there is no stress in what remains: F = exp(fraction · ln U).
        let step = StepState::new(&material, &behaviour, &states, 1, 1.0, 2.0, false);
        let model = StepModel { elastic: &material, step: &step };
        let stays: Matrix3 = std::array::from_fn(|i| {
            std::array::from_fn(|j| if i == j { largest[i].powf(fraction) - 1.0 } else { 0.0 })
        });
        let rest = model.response(0, 0, &stays).expect("upright");
        assert!(rest.stress.as_flattened().iter().all(|v| v.abs() < 1e-12), "{one}: {rest:?}");
    }
    assert_eq!(grown, 8);
}

/// Nineteen tets on a ring of corners: packs of eight, the last one not full.
fn ring() -> Body {
    let corner = |k: usize| {
        let (s, c) = (k as f64 * 0.3).sin_cos();
        [10.0 * c, 10.0 * s, 0.5 * (k % 3) as f64]
    };
    let mut nodes = vec![[0.0, 0.0, -4.0], [0.0, 0.0, 5.0]];
    nodes.extend((0..20).map(corner));
    let tets = (0..19).map(|k| [0, k + 2, k + 3, 1]).collect();
    Body::new(Mesh::new(nodes, tets).expect("sound"), Element::Tet4, [0, 1, 2]).expect("sound")
}

#[test]
fn points_side_by_side_say_what_they_say_alone() {
    let body = ring();
    let geometry = body.geometry();
    let material = Material::neo_hookean(9.0, 0.4).expect("sound");
    let field = |seed: u64, size: f64| -> Vec<f64> {
        (0..body.n_nodes()).flat_map(|n| gradient(seed + 7 * n as u64, size)[0]).collect()
    };
    let mut packed = 0;
    for (name, behaviour) in behaviours() {
        let states = Arc::new(fresh_states(&behaviour, body.n_tets()));
        let through = crate::assembly::gradients_at_points(geometry, &field(5, 0.3));
        let first = StepState::new(&material, &behaviour, &states, 1, 0.0, 0.0, false);
        let states = Arc::new(first.updated(&material, &through, Vec::new(), false).expect(name));
        let mut step = StepState::new(&material, &behaviour, &states, 1, 0.7, 0.7, false);
        packed += usize::from(step.remembered.is_some());
        // The last is beyond the series of the logarithm in some tets.
        for size in [1e-6, 0.05, 0.5, 1.5] {
            let u = field(11, size);
            let answer = |step: &StepState| {
                let model = StepModel { elastic: &material, step };
                let mut force = vec![0.0; u.len()];
                internal_force_into(geometry, &model, &u, &mut force, &mut Vec::new(), false)
                    .map(|energy| (energy.total, energy.min_det_f, force))
            };
            let together = answer(&step);
            let kept = step.remembered.take();
            let alone = answer(&step);
            step.remembered = kept;
            let (Some((e, det, f)), Some((e_alone, det_alone, f_alone))) = (together, alone) else {
                panic!("{name}: inverted at {size}");
            };
            assert!((e - e_alone).abs() <= 1e-12 * e_alone.abs(), "{name} {size}: {e} {e_alone}");
            assert!((det - det_alone).abs() < 1e-13, "{name}");
            let largest = f_alone.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            for (one, other) in f.iter().zip(&f_alone) {
                assert!((one - other).abs() <= 1e-12 * largest, "{name} {size}: {one} {other}");
            }
        }
    }
    assert_eq!(packed, 4, "none, whole, isochoric and drainage");
}
