//! Pads, detachment and prestress: what changes between frames, and what may not.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use common::{bar, clamped_at_x0, dome, largest, largest_difference, nodes_where};
use tissuereg_fem::{
    Behaviour, Body, Drainage, Element, FemError, History, Load, Material, Pad, Relaxation, Rig,
    Set, Softening, SofteningForm, SolveSettings, Springs, Supports, Swelling, rest_shape,
    resultant, solve,
};

const BOTH: [Element; 2] = [Element::Tet4, Element::Tet10];

fn material() -> Material {
    Material::neo_hookean(8.0, 0.45).expect("sound")
}

fn settings() -> SolveSettings {
    SolveSettings::default().with_tolerance(1e-11)
}

/// A dome on its base, and the nodes of its cap.
fn dome_with_cap(element: Element) -> (Body, Vec<usize>) {
    let mesh = dome(6);
    let base = nodes_where(&mesh, |x| x[2] < 1e-9);
    let cap = nodes_where(&mesh, |x| x[2] > 55.0);
    (Body::new(mesh, element, base).expect("held"), cap)
}

fn rig(body: Body, behaviour: Behaviour, pads: Vec<Vec<usize>>) -> Rig {
    let history = History::new(&body, material(), behaviour).expect("sound");
    let pads = pads.into_iter().map(|nodes| Pad { nodes }).collect();
    Rig::new(body, history, pads).expect("sound")
}

#[test]
fn an_elastic_body_returns_when_its_pad_is_released() {
    for element in BOTH {
        let (body, cap) = dome_with_cap(element);
        let weight = Load { body_force: [0.0, 0.0, -9.81e-3], ..Load::default() };
        let sagged = solve(&body, &material(), &weight, &settings()).expect("stands");
        let all = body.nodes().to_vec();
        let volume = body.mesh().volume();
        let mut rig = rig(body, Behaviour::default(), vec![cap.clone()]);
        let none = rig.advance(&weight, &[None], 0.0, &settings()).expect("stands");
        assert!(none.pads[0].is_none());
        // Bonded where it is: nothing changes, and the pad carries nothing.
        let bonded = rig.advance(&weight, &[Some([0.0; 3])], 1.0, &settings()).expect("bonded");
        let moved = largest_difference(&bonded.solution.displacement, &sagged.displacement);
        assert!(moved < 1e-7, "{moved}");
        assert!(largest(&[bonded.pads[0].expect("there").force]) < 1e-4);
        let motion = [3.0, 0.0, -6.0];
        let pushed = rig.advance(&weight, &[Some(motion)], 2.0, &settings()).expect("pushed");
        for &node in &cap {
            for i in 0..3 {
                let wanted = sagged.displacement[node][i] + motion[i];
                assert!((pushed.solution.displacement[node][i] - wanted).abs() < 1e-7);
            }
        }
        // Pad, base and weight balance, in force and (with the deformed places) in moment.
        let pad = pushed.pads[0].expect("there");
        let base = resultant(&all, &pushed.solution.reactions, [0.0; 3]);
        assert!((pad.force[2] + base.force[2] - 9.81e-3 * volume).abs() < 1e-4);
        assert!((pad.force[0] + base.force[0]).abs() < 1e-4 && pad.force[0] > 10.0);
        let free = rig.advance(&weight, &[None], 3.0, &settings()).expect("released");
        let back = largest_difference(&free.solution.displacement, &sagged.displacement);
        assert!(back < 1e-6, "{element:?}: {back}");
    }
}

/// The forces of pad and base have no moment together where nothing else acts.
#[test]
fn pad_and_base_balance_in_moment() {
    let (body, cap) = dome_with_cap(Element::Tet10);
    let (nodes, held) = (body.nodes().to_vec(), body.held_nodes().to_vec());
    let mut rig = rig(body, Behaviour::default(), vec![cap.clone()]);
    let frame =
        rig.advance(&Load::default(), &[Some([4.0, 1.0, -5.0])], 0.0, &settings()).expect("pushed");
    let pad = frame.pads[0].expect("there");
    let base_places: Vec<[f64; 3]> = held.iter().map(|&n| nodes[n]).collect();
    let centre: [f64; 3] = std::array::from_fn(|i| {
        cap.iter().map(|&n| nodes[n][i] + frame.solution.displacement[n][i]).sum::<f64>()
            / cap.len() as f64
    });
    let base = resultant(&base_places, &frame.solution.reactions, centre);
    for i in 0..3 {
        assert!((pad.force[i] + base.force[i]).abs() < 1e-5, "{pad:?} {base:?}");
        assert!((pad.moment[i] + base.moment[i]).abs() < 1e-3, "{pad:?} {base:?}");
    }
}

/// A pad that comes late is bonded to the shape of that time: a relaxing body has crept on.
#[test]
fn a_pad_that_comes_late_is_bonded_to_the_shape_of_then() {
    let relaxation = Relaxation { g: vec![0.5], tau_s: vec![1.0], ..Relaxation::default() };
    let behaviour = Behaviour { relaxation: Some(relaxation), ..Behaviour::default() };
    let weight = Load { body_force: [0.0, 0.0, -9.81e-3], ..Load::default() };
    let (body, cap) = dome_with_cap(Element::Tet4);
    let mut alone = History::new(&body, material(), behaviour.clone()).expect("sound");
    let first = alone.advance(&body, &weight, 0.0, &settings()).expect("stands");
    let crept = alone.advance(&body, &weight, 4.0, &settings()).expect("stands");
    let mut rig = rig(body, behaviour, vec![cap.clone()]);
    rig.advance(&weight, &[None], 0.0, &settings()).expect("stands");
    let bonded = rig.advance(&weight, &[Some([0.0; 3])], 4.0, &settings()).expect("bonded");
    assert!(largest_difference(&first.displacement, &crept.displacement) > 0.5);
    let apart = largest_difference(&bonded.solution.displacement, &crept.displacement);
    assert!(apart < 1e-6, "{apart}");
}

#[test]
fn a_detached_part_of_the_base_is_free() {
    for element in BOTH {
        let mesh = dome(6);
        let base = nodes_where(&mesh, |x| x[2] < 1e-9);
        let stays: Vec<usize> =
            base.iter().copied().filter(|&n| mesh.nodes()[n][0] < 10.0).collect();
        let whole = Body::new(mesh, element, base.clone()).expect("held");
        let partly = whole.with_supports(stays.clone()).expect("held");
        let load = Load { body_force: [0.0, 0.0, 9.81e-3], ..Load::default() };
        let held = solve(&whole, &material(), &load, &settings()).expect("stands");
        let loose = solve(&partly, &material(), &load, &settings()).expect("stands");
        let edges = whole.mid_edges();
        // Middles of edges with a free end are free as well.
        let lifted = |u: &[[f64; 3]]| {
            let corner = base.iter().filter(|n| !stays.contains(n)).map(|&n| u[n][2].abs());
            let middle = edges.iter().enumerate().filter(|(_, [a, b])| {
                base.contains(a) && base.contains(b) && !(stays.contains(a) && stays.contains(b))
            });
            let middle = middle.map(|(e, _)| u[whole.n_corner_nodes() + e][2].abs());
            corner.chain(middle).fold(f64::INFINITY, f64::min)
        };
        assert_eq!(lifted(&held.displacement), 0.0);
        assert!(lifted(&loose.displacement) > 1e-3, "{element:?}");
        let fresh = Body::new(whole.mesh().clone(), element, stays).expect("held");
        let same = solve(&fresh, &material(), &load, &settings()).expect("stands");
        assert_eq!(same.displacement, loose.displacement, "sharing the mesh changes no bit");
    }
}

#[test]
fn a_body_hangs_as_it_was_given() {
    for element in BOTH {
        let mesh = dome(6);
        let base = nodes_where(&mesh, |x| x[2] < 1e-9);
        let given = mesh.nodes().to_vec();
        let body = Body::new(mesh, element, base).expect("held");
        for direction in [[0.0, 0.0, 9.81e-3], [9.81e-3, 0.0, 0.0]] {
            let weight = Load { body_force: direction, ..Load::default() };
            let soft = Material::neo_hookean(3.0, 0.48).expect("sound");
            let settings = SolveSettings::default();
            let rest = rest_shape(&body, &soft, &weight, &settings).expect("found");
            let moved = largest_difference(rest.body.mesh().nodes(), &given);
            assert!(moved > 1.0, "the weight counts: {moved}");
            let hangs = solve(&rest.body, &soft, &weight, &settings).expect("stands");
            let places: Vec<[f64; 3]> = (0..given.len())
                .map(|n| {
                    std::array::from_fn(|i| rest.body.nodes()[n][i] + hangs.displacement[n][i])
                })
                .collect();
            assert!(largest_difference(&places, &given) < 1.01e-6, "{element:?}");
            assert!(rest.iterations < 25, "{}", rest.iterations);
        }
    }
}

#[test]
fn a_rest_shape_on_springs_is_found() {
    let mesh = bar([4, 4, 2], [40.0, 40.0, 20.0]);
    let facets = |z: f64| -> Vec<[usize; 3]> {
        let on = |n: &usize| (mesh.nodes()[*n][2] - z).abs() < 1e-9;
        mesh.surface_triangles().iter().filter(|t| t.iter().all(on)).copied().collect()
    };
    let bed = Springs { triangles: facets(0.0), normal: 0.2, tangential: 0.1, friction: None };
    let body =
        Body::new(mesh.clone(), Element::Tet4, Supports::new().rest_on(&bed)).expect("stands");
    let material = material();
    let load = Load { body_force: [1e-3, 0.0, -9.81e-3], springs: vec![bed], ..Load::default() };
    let rest = rest_shape(&body, &material, &load, &SolveSettings::default()).expect("found");
    let places: Vec<[f64; 3]> = (0..mesh.n_nodes())
        .map(|n| std::array::from_fn(|i| rest.body.nodes()[n][i] + rest.loaded.displacement[n][i]))
        .collect();
    assert!(largest_difference(&places, mesh.nodes()) < 1.01e-6);
}

#[test]
fn a_weight_that_has_no_rest_shape_is_an_error() {
    let body = clamped_at_x0(bar([8, 2, 2], [80.0, 10.0, 10.0]), Element::Tet4);
    let load = Load { body_force: [0.0, 0.0, -0.5], ..Load::default() };
    let soft = Material::neo_hookean(1.0, 0.45).expect("sound");
    let error = rest_shape(&body, &soft, &load, &SolveSettings::default()).expect_err("too heavy");
    assert!(matches!(error, FemError::NoRestShape { .. }), "{error}");
    assert!(error.is_recoverable() && error.to_string().contains("no unloaded shape"), "{error}");
    let cancel = Some(Arc::new(AtomicBool::new(true)));
    let settings = SolveSettings::default().with_cancel(cancel);
    assert_eq!(rest_shape(&body, &soft, &load, &settings).err(), Some(FemError::Cancelled));
}

/// Message of a behaviour that is outside its range.
fn refused(behaviour: Behaviour) -> String {
    let body = clamped_at_x0(bar([1, 1, 1], [10.0; 3]), Element::Tet4);
    let error = History::new(&body, material(), behaviour).expect_err("out of range");
    assert!(!error.is_recoverable());
    error.to_string()
}

#[test]
fn behaviours_out_of_range_are_named() {
    let relaxation = |g: &[f64], tau_s: &[f64]| Behaviour {
        relaxation: Some(Relaxation { g: g.into(), tau_s: tau_s.into(), ..Relaxation::default() }),
        ..Behaviour::default()
    };
    let softening = |r, m_kpa, beta| Behaviour {
        softening: Some(Softening { form: SofteningForm::OgdenRoxburgh, r, m_kpa, beta }),
        ..Behaviour::default()
    };
    let damage = |r, m_kpa, beta| Behaviour {
        softening: Some(Softening { form: SofteningForm::Damage, r, m_kpa, beta }),
        ..Behaviour::default()
    };
    let set = |fraction| Behaviour { set: Some(Set { fraction }), ..Behaviour::default() };
    let drainage = |share, tau_s| Behaviour {
        drainage: Some(Drainage { share, tau_s }),
        ..Behaviour::default()
    };
    let swelling = |linear_strain, from_time_s, to_time_s| Behaviour {
        swelling: Some(Swelling { linear_strain, from_time_s, to_time_s }),
        ..Behaviour::default()
    };
    let both = Behaviour { drainage: drainage(0.6, 1.0).drainage, ..relaxation(&[0.5], &[1.0]) };
    let rate = |viscosity_kpa_s| Behaviour { viscosity_kpa_s, ..Behaviour::default() };
    for (behaviour, words) in [
        (relaxation(&[0.5, 0.2], &[1.0]), ["relaxation.tau", "must have 2 rows; found 1"]),
        (relaxation(&[0.5, -0.2], &[1.0, 2.0]), ["`relaxation.g`", "found -0.2"]),
        (relaxation(&[f64::NAN], &[1.0]), ["`relaxation.g`", "NaN"]),
        (relaxation(&[0.7, 0.5], &[1.0, 2.0]), ["`relaxation.g`", "found 1.2"]),
        (relaxation(&[0.7], &[0.0]), ["`relaxation.tau`", "found 0"]),
        (both, ["with the share that drains", "found 1.1"]),
        (rate(-1.0), ["`viscosity`", "found -1"]),
        (softening(0.9, 1.0, 0.0), ["`softening.r`", "found 0.9"]),
        (softening(2.0, 0.0, 0.0), ["`softening.m`", "above 0 where beta is 0"]),
        (softening(2.0, 1.0, -0.1), ["`softening.beta`", "found -0.1"]),
        (damage(2.0, 0.0, 0.0), ["`softening.m`", "found 0"]),
        (damage(2.0, 1.0, 0.1), ["`softening.beta`", "0 for damage"]),
        (set(1.0), ["`set.fraction`", "found 1"]),
        (drainage(0.0, 1.0), ["`drainage.share`", "found 0"]),
        (drainage(0.5, f64::INFINITY), ["`drainage.tau`", "found inf"]),
        (swelling(-1.0, 0.0, 1.0), ["`swelling.linear_strain`", "found -1"]),
        (swelling(0.1, f64::NAN, 1.0), ["`swelling.from_time`", "NaN"]),
        (swelling(0.1, 2.0, 1.0), ["`swelling.to_time`", "found 1"]),
    ] {
        let message = refused(behaviour);
        assert!(words.iter().all(|w| message.contains(w)), "`{message}` must say {words:?}");
    }
}

#[test]
fn a_frame_that_fails_leaves_the_history_as_it_was() {
    let body = clamped_at_x0(bar([4, 2, 2], [40.0, 10.0, 10.0]), Element::Tet4);
    let other = clamped_at_x0(bar([2, 2, 2], [40.0, 10.0, 10.0]), Element::Tet4);
    let behaviour = Behaviour { viscosity_kpa_s: 1.0, ..Behaviour::default() };
    let mut history = History::new(&body, material(), behaviour).expect("sound");
    let push = |f: f64| {
        let mut rows = vec![[0.0; 3]; body.n_nodes()];
        rows[body.n_nodes() - 1][0] = f;
        Load::from_forces(rows)
    };
    let settings = SolveSettings::default().with_max_iterations(40);
    history.advance(&body, &push(5.0), 1.0, &settings).expect("stands");
    let before = (history.displacement().to_vec(), history.time_s());
    let fails = [
        history.advance(&body, &push(-1e9), 2.0, &settings).expect_err("too much"),
        history.advance(&body, &push(5.0), 0.5, &settings).expect_err("earlier"),
        history.advance(&body, &push(5.0), f64::NAN, &settings).expect_err("no time"),
        history.advance(&other, &Load::default(), 2.0, &settings).expect_err("other nodes"),
    ];
    assert!(matches!(fails[0], FemError::NoEquilibrium(_)), "{}", fails[0]);
    assert_eq!(fails[1], FemError::TimeRunsBack { time_s: 0.5, last_s: 1.0 });
    assert!(fails[1].to_string().contains("must not run backwards"));
    assert!(matches!(fails[2], FemError::BadParameter { name: "time_s", .. }));
    assert!(matches!(fails[3], FemError::WrongLength { .. }));
    assert_eq!(before, (history.displacement().to_vec(), history.time_s()));
    history.advance(&body, &push(5.0), 2.0, &settings).expect("goes on");
}

#[test]
fn wrong_pads_are_named() {
    let make = |nodes: Vec<usize>| {
        let body = clamped_at_x0(bar([2, 1, 1], [20.0, 10.0, 10.0]), Element::Tet4);
        let history = History::new(&body, material(), Behaviour::default()).expect("sound");
        Rig::new(body, history, vec![Pad { nodes: nodes.clone() }, Pad { nodes }])
    };
    let beyond = make(vec![10, 40]).expect_err("no such node").to_string();
    assert!(beyond.contains("node 40"), "{beyond}");
    let twice = make(vec![10, 10]).expect_err("twice").to_string();
    assert!(twice.contains("node 10") && twice.contains("more than once"), "{twice}");
    let mut rig = make(vec![10, 11]).expect("sound");
    let (nothing, there) = (Load::default(), Some([0.0; 3]));
    let both = rig.advance(&nothing, &[there, there], 0.0, &settings()).expect_err("shared");
    assert!(matches!(both, FemError::HeldNodeRepeated { node: 10 }), "{both}");
    let few = rig.advance(&nothing, &[there], 0.0, &settings()).expect_err("one motion");
    assert!(matches!(few, FemError::WrongLength { .. }), "{few}");
    let nan = rig.advance(&nothing, &[Some([f64::NAN; 3]), None], 0.0, &settings());
    assert!(matches!(nan, Err(FemError::NonFinite { .. })));
    assert_eq!(rig.history().time_s(), None, "nothing has happened");
}

/// The bits of a frame do not depend on the number of threads.
#[test]
fn threads_change_no_bit() {
    let run = |n_threads: usize| {
        let (body, cap) = dome_with_cap(Element::Tet10);
        let relaxation = Relaxation { g: vec![0.5], tau_s: vec![1.0], ..Relaxation::default() };
        let behaviour = Behaviour {
            relaxation: Some(relaxation),
            softening: Some(Softening {
                form: SofteningForm::OgdenRoxburgh,
                r: 1.5,
                m_kpa: 0.1,
                beta: 0.1,
            }),
            ..Behaviour::default()
        };
        let mut rig = rig(body, behaviour, vec![cap]);
        let settings = SolveSettings::default().with_n_threads(n_threads);
        let mut last = Vec::new();
        for (time, z) in [(0.0, 0.0), (1.0, -4.0), (2.0, -1.0)] {
            let frame = rig.advance(&Load::default(), &[Some([0.0, 1.0, z])], time, &settings);
            last = frame.expect("stands").solution.displacement;
        }
        last
    };
    assert_eq!(run(1), run(2));
}

/// Pushed caps of a dome that relaxes, at a share of the relaxation.
fn pushes(rig: &mut Rig, near: Option<&[Vec<[f64; 3]>]>) -> (Vec<Vec<[f64; 3]>>, usize) {
    let (mut found, mut work) = (Vec::new(), 0);
    for k in 0..6 {
        let change: Option<Vec<[f64; 3]>> = near.filter(|_| k > 0).map(|near| {
            let pairs = near[k].iter().zip(&near[k - 1]);
            pairs.map(|(a, b)| std::array::from_fn(|i| a[i] - b[i])).collect()
        });
        let motion = [Some([0.0, 0.0, -2.0 * (k.min(3)) as f64])];
        let frame = rig
            .advance_by(&Load::default(), &motion, change.as_deref(), k as f64, &settings())
            .expect("equilibrium");
        work += frame.solution.report.iterations;
        found.push(frame.solution.displacement);
    }
    (found, work)
}

fn relaxing(share: f64) -> Behaviour {
    let relaxation = Relaxation { g: vec![share], tau_s: vec![2.0], ..Relaxation::default() };
    Behaviour { relaxation: Some(relaxation), ..Behaviour::default() }
}

#[test]
fn a_similar_history_saves_work_and_changes_nothing() {
    let (body, cap) = dome_with_cap(Element::Tet4);
    let mut first = rig(body, relaxing(0.3), vec![cap]);
    let (near, _) = pushes(&mut first, None);
    let mut plain = first.afresh(material(), relaxing(0.32)).expect("sound");
    let (expected, alone) = pushes(&mut plain, None);
    let mut led = first.afresh(material(), relaxing(0.32)).expect("sound");
    let (found, with_guess) = pushes(&mut led, Some(&near));
    assert!(5 * with_guess < 4 * alone, "{with_guess} iterations for {alone}");
    for (one, other) in found.iter().flatten().zip(expected.iter().flatten()) {
        (0..3).for_each(|i| assert!((one[i] - other[i]).abs() < 1e-5, "{one:?} {other:?}"));
    }
    // A guess that inverts the body is none.
    let absurd: Vec<Vec<[f64; 3]>> = near
        .iter()
        .enumerate()
        .map(|(k, rows)| rows.iter().map(|u| u.map(|v| v * (1.0 + 300.0 * k as f64))).collect())
        .collect();
    let mut misled = first.afresh(material(), relaxing(0.32)).expect("sound");
    let (found, _) = pushes(&mut misled, Some(&absurd));
    for (one, other) in found.iter().flatten().zip(expected.iter().flatten()) {
        (0..3).for_each(|i| assert!((one[i] - other[i]).abs() < 1e-5, "{one:?} {other:?}"));
    }
}

#[test]
fn a_rig_afresh_is_a_new_one() {
    let (body, cap) = dome_with_cap(Element::Tet10);
    let mut used = rig(body, relaxing(0.3), vec![cap]);
    pushes(&mut used, None);
    let mut afresh = used.afresh(material(), relaxing(0.5)).expect("sound");
    let (body, cap) = dome_with_cap(Element::Tet10);
    let mut new = rig(body, relaxing(0.5), vec![cap]);
    assert_eq!(pushes(&mut afresh, None), pushes(&mut new, None));
}
