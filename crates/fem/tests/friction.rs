//! Dry friction of a bed: Coulomb's law in closed form, what sticks, what is refused.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{bar, largest_difference, nodes_where};
use tissuereg_fem::{
    Behaviour, Body, Element, FemError, Friction, History, Linearised, Load, Material, Mesh,
    SolveSettings, Springs, Supports, resultant,
};

const BOTH: [Element; 2] = [Element::Tet4, Element::Tet10];
const NORMAL: f64 = 2.0;
const STICK: f64 = 1.5;
const AREA: f64 = 600.0;

fn settings() -> SolveSettings {
    SolveSettings::default().with_tolerance(1e-10)
}

fn bed(mesh: &Mesh, friction: Option<Friction>) -> Springs {
    let below = |t: &&[usize; 3]| t.iter().all(|&n| mesh.nodes()[n][2] < 1e-9);
    let triangles = mesh.surface_triangles().iter().filter(below).copied().collect();
    Springs { triangles, normal: NORMAL, tangential: STICK, friction }
}

/// A block on a bed, held at its top.
fn block(element: Element, friction: Option<Friction>) -> (Body, Springs) {
    let mesh = bar([3, 2, 1], [30.0, 20.0, 5.0]);
    let springs = bed(&mesh, friction);
    let top = nodes_where(&mesh, |x| x[2] > 5.0 - 1e-9);
    let supports = Supports::new().hold(&top).rest_on(&springs);
    (Body::new(mesh, element, supports).expect("held"), springs)
}

/// The same motion of all held nodes, over a bed.
fn moved(body: &Body, springs: &Springs, motion: [f64; 3]) -> Load {
    let rows = vec![motion; body.held_nodes().len()];
    Load { springs: vec![springs.clone()], ..Load::from_prescribed(rows) }
}

#[test]
fn a_rigid_block_slides_by_coulombs_law() {
    let friction = Friction { coefficient: 0.4, cohesion: 0.2 };
    // Down and aside, under a growing load, back, round a corner, and lifted off.
    let path = [
        [0.0, 0.0, -0.1],
        [0.2, 0.0, -0.1],
        [1.0, 0.0, -0.4],
        [0.9, 0.0, -0.4],
        [-0.5, 0.0, -0.4],
        [-0.5, 0.8, -0.2],
        [-0.1, 0.8, 0.2],
        [0.4, 0.8, 0.6],
    ];
    for element in BOTH {
        let (body, springs) = block(element, Some(friction));
        let rigid = Material::neo_hookean(1e8, 0.3).expect("sound");
        let mut history = History::new(&body, rigid, Behaviour::default()).expect("sound");
        let mut anchor = [0.0; 2];
        for (frame, motion) in path.iter().enumerate() {
            let load = moved(&body, &springs, *motion);
            let answer = history.advance(&body, &load, frame as f64, &settings()).expect("stands");
            let found = resultant(body.nodes(), &answer.spring_forces[0], [0.0; 3]).force;
            let stretch = [motion[0] - anchor[0], motion[1] - anchor[1]];
            let size = stretch[0].hypot(stretch[1]);
            let pressure = (-NORMAL * motion[2]).max(0.0);
            let holds = friction.cohesion + friction.coefficient * pressure;
            let pulls = (STICK * size).min(holds);
            let slipped = 1.0 - pulls / (STICK * size).max(f64::MIN_POSITIVE);
            for i in 0..2 {
                let expected = -AREA * pulls * stretch[i] / size.max(f64::MIN_POSITIVE);
                let off = (found[i] - expected).abs();
                assert!(
                    off < 2e-3 * AREA * holds + 0.3,
                    "{element:?} {frame}: {found:?} {expected}"
                );
                anchor[i] += slipped * stretch[i];
            }
            assert!((found[2] + AREA * NORMAL * motion[2]).abs() < 1e-2, "{found:?}");
        }
    }
}

/// Plain springs, bit for bit up to the tolerance, where they are never overcome.
#[test]
fn a_bed_that_holds_is_one_of_springs() {
    for element in BOTH {
        let soft = Material::neo_hookean(20.0, 0.4).expect("sound");
        let reached = [None, Some(Friction { coefficient: 1.0, cohesion: 1e6 })].map(|friction| {
            let (body, springs) = block(element, friction);
            let mut history =
                History::new(&body, soft.clone(), Behaviour::default()).expect("sound");
            for (frame, x) in [0.5, 1.5, -0.3].into_iter().enumerate() {
                let load = moved(&body, &springs, [x, 0.2, -0.2]);
                history.advance(&body, &load, frame as f64, &settings()).expect("stands");
            }
            history.displacement().to_vec()
        });
        assert!(largest_difference(&reached[0], &reached[1]) < 1e-7, "{element:?}");
    }
}

#[test]
fn a_soft_block_is_left_sheared_where_it_has_slid() {
    for element in BOTH {
        let (body, springs) = block(element, Some(Friction { coefficient: 0.1, cohesion: 0.3 }));
        let soft = Material::neo_hookean(20.0, 0.4).expect("sound");
        let mut history = History::new(&body, soft, Behaviour::default()).expect("sound");
        let mut pull = |x: f64, time: f64| {
            let load = moved(&body, &springs, [x, 0.0, 0.0]);
            let answer = history.advance(&body, &load, time, &settings()).expect("stands");
            resultant(body.nodes(), &answer.spring_forces[0], [0.0; 3]).force[0]
        };
        let (there, back) = (pull(3.0, 0.0), pull(0.0, 1.0));
        // What pressing down adds at the edges of the sheared block is small.
        assert!((there + 0.3 * AREA).abs() < 0.1 * AREA, "{there}");
        assert!((back - 0.3 * AREA).abs() < 0.1 * AREA, "{back}");
        assert!((pull(0.0, 2.0) - back).abs() < 1e-3 * back, "nothing creeps");
    }
}

#[test]
fn friction_has_no_derivatives_and_sound_numbers() {
    let (body, springs) = block(Element::Tet4, Some(Friction { coefficient: 0.1, cohesion: 0.3 }));
    let material = Material::neo_hookean(20.0, 0.4).expect("sound");
    let load = moved(&body, &springs, [0.1, 0.0, 0.0]);
    let still = vec![[0.0; 3]; body.n_nodes()];
    let error = Linearised::new(&body, &material, &load, &still, &settings()).expect_err("none");
    assert!(matches!(error, FemError::BadParameter { name: "springs.friction", .. }), "{error}");
    for (coefficient, cohesion) in [(-0.1, 1.0), (0.1, f64::NAN)] {
        let friction = Some(Friction { coefficient, cohesion });
        let wrong = moved(&body, &Springs { friction, ..springs.clone() }, [0.0; 3]);
        let mut history =
            History::new(&body, material.clone(), Behaviour::default()).expect("sound");
        let error = history.advance(&body, &wrong, 0.0, &settings()).expect_err("out of range");
        assert!(matches!(error, FemError::BadParameter { .. }), "{error}");
    }
}
