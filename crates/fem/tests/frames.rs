//! Derivatives of frames through a history against central differences of the whole history.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{Random, bar, nodes_where};
use tissuereg_fem::material::{LawKind, Parameter};
use tissuereg_fem::{
    Behaviour, BehaviourParameter, Body, Cause, Drainage, Element, FemError, FrameCause,
    FrameDerivative, FrameObservation, History, Load, Material, Method, Observation, Pad, Part,
    Relaxation, Rig, Set, Skin, Softening, SofteningForm, SolveSettings, Springs, Stiffness,
    Swelling,
};

const ALL: [Element; 3] = [Element::Tet4, Element::Tet4Averaged, Element::Tet10];

fn tight() -> SolveSettings {
    SolveSettings::default().with_tolerance(1e-12).with_method(Method::Newton)
}

/// A bar that hangs at one end, sags, is pushed by a pad that comes, goes and comes again.
#[derive(Clone)]
struct Story {
    element: Element,
    behaviour: Behaviour,
    material: Material,
    springs: [f64; 2],
    /// One per frame.
    loads: Vec<Load>,
    motions: Vec<Option<[f64; 3]>>,
}

const TIMES: [f64; 6] = [0.0, 0.5, 1.1, 1.5, 2.5, 3.0];

impl Story {
    fn new(element: Element, behaviour: Behaviour) -> Self {
        let weight = |share: f64| Load {
            body_force: [0.004 * share, 0.0, -0.01 * share],
            ..Load::default()
        };
        Self {
            element,
            behaviour,
            material: Material::neo_hookean(9.0, 0.4).expect("sound"),
            springs: [0.0, 0.0],
            loads: [0.5, 1.0, 1.0, 0.9, 0.7, 0.8].map(weight).to_vec(),
            motions: vec![
                None,
                Some([0.8, 0.3, 1.2]),
                Some([1.5, 0.5, 2.0]),
                Some([0.4, 0.0, 0.7]),
                None,
                Some([-0.5, 0.4, 0.6]),
            ],
        }
    }

    fn body(&self) -> Body {
        let mesh = bar([3, 1, 1], [18.0, 6.0, 6.0]);
        let wall = nodes_where(&mesh, |x| x[0] < 1e-9);
        Body::new(mesh, self.element, wall).expect("held")
    }

    fn run(&self) -> (Rig, Vec<FrameDerivative>) {
        let body = self.body();
        let top: Vec<[usize; 3]> = on_top(&body);
        let pad = nodes_where(body.mesh(), |x| x[0] > 18.0 - 1e-9);
        let history = History::recorded(&body, self.material.clone(), self.behaviour.clone());
        let mut rig =
            Rig::new(body, history.expect("sound"), vec![Pad { nodes: pad }]).expect("sound");
        let mut frames = Vec::new();
        for (frame, time) in TIMES.into_iter().enumerate() {
            let mut load = self.loads[frame].clone();
            if self.springs != [0.0, 0.0] {
                let [normal, tangential] = self.springs;
                load.springs.push(Springs {
                    triangles: top.clone(),
                    normal,
                    tangential,
                    friction: None,
                });
            }
            let found = rig.advance(&load, &self.motions[frame..=frame], time, &tight());
            let found = found.expect("stands");
            frames.push(FrameDerivative {
                displacement: found.solution.displacement,
                reactions: found.solution.reactions,
                pads: found.pads.iter().map(|pad| pad.map(|pad| pad.force)).collect(),
            });
        }
        (rig, frames)
    }

    fn derivative(&self, cause: FrameCause) -> Vec<FrameDerivative> {
        self.run().0.derivatives(&[cause], &tight()).expect("a derivative").remove(0)
    }
}

/// A story by how far a number is moved.
type Mover<'a> = &'a dyn Fn(f64) -> Story;

fn on_top(body: &Body) -> Vec<[usize; 3]> {
    let mesh = body.mesh();
    let high = |n: &usize| mesh.nodes()[*n][2] > 6.0 - 1e-9;
    mesh.surface_triangles().iter().filter(|t| t.iter().all(high)).copied().collect()
}

fn rows_of(frame: &FrameDerivative, name: &str) -> Vec<[f64; 3]> {
    match name {
        "displacement" => frame.displacement.clone(),
        "reactions" => frame.reactions.clone(),
        _ => frame.pads.iter().flatten().copied().collect(),
    }
}

/// Compare with the fourth-order central difference of a story that a number moves. Steps are small:
/// a point that switches within one (a new largest strain) makes the difference jump.
fn assert_follows(found: &[FrameDerivative], step: f64, words: &str, moved: impl Fn(f64) -> Story) {
    let [a, b, c, d] = [-2.0, -1.0, 1.0, 2.0].map(|k| moved(k * step).run().1);
    for name in ["displacement", "reactions", "pads"] {
        let wanted: Vec<Vec<[f64; 3]>> = (0..TIMES.len())
            .map(|frame| {
                let [a, b, c, d] = [&a, &b, &c, &d].map(|run| rows_of(&run[frame], name));
                let at = |n: usize, i: usize| {
                    (8.0 * (c[n][i] - b[n][i]) - (d[n][i] - a[n][i])) / (12.0 * step)
                };
                (0..a.len()).map(|n| std::array::from_fn(|i| at(n, i))).collect()
            })
            .collect();
        let most = wanted.iter().map(|rows| common::largest(rows)).fold(0.0, f64::max);
        assert!(most > 0.0, "{words}, {name}: nothing moves");
        for (frame, wanted) in wanted.iter().enumerate() {
            let own = rows_of(&found[frame], name);
            assert_eq!(own.len(), wanted.len());
            if own.is_empty() {
                continue;
            }
            let off = common::largest_difference(&own, wanted);
            let limit = 1e-5 * common::largest(wanted).max(1e-2 * most);
            assert!(off < limit, "{words}, frame {frame}, {name}: off by {off:.1e} of {most:.1e}");
        }
    }
}

fn behaviours() -> Vec<(&'static str, Behaviour)> {
    let none = Behaviour::default;
    let relaxation = |part| Some(Relaxation { g: vec![0.3, 0.25], tau_s: vec![0.4, 3.0], part });
    let softening =
        Some(Softening { form: SofteningForm::OgdenRoxburgh, r: 1.7, m_kpa: 0.1, beta: 0.2 });
    let damage = Some(Softening { form: SofteningForm::Damage, r: 1.7, m_kpa: 0.1, beta: 0.0 });
    let set = Some(Set { fraction: 0.3 });
    let drainage = Some(Drainage { share: 0.35, tau_s: 1.0 });
    let swelling = Some(Swelling { linear_strain: 0.06, from_time_s: 0.2, to_time_s: 2.1 });
    vec![
        ("none", none()),
        ("whole", Behaviour { relaxation: relaxation(Part::Whole), ..none() }),
        ("isochoric", Behaviour { relaxation: relaxation(Part::Isochoric), ..none() }),
        ("rate", Behaviour { viscosity_kpa_s: 1.5, ..none() }),
        ("softening", Behaviour { softening, ..none() }),
        ("damage", Behaviour { softening: damage, ..none() }),
        ("set", Behaviour { set, ..none() }),
        ("drainage", Behaviour { drainage, ..none() }),
        ("swelling", Behaviour { swelling, ..none() }),
        (
            "all",
            Behaviour {
                relaxation: relaxation(Part::Isochoric),
                viscosity_kpa_s: 0.5,
                softening,
                set,
                drainage,
                swelling,
            },
        ),
        (
            "damage and others",
            Behaviour {
                relaxation: relaxation(Part::Whole),
                softening: damage,
                set,
                drainage,
                ..none()
            },
        ),
    ]
}

/// All of them on plain elements, and all at once on the others.
fn cases() -> Vec<(Element, &'static str, Behaviour)> {
    let chosen = |element: Element| {
        let all = behaviours().into_iter();
        all.filter(move |(name, _)| element == Element::Tet4 || *name == "all")
            .map(move |(name, behaviour)| (element, name, behaviour))
    };
    ALL.into_iter().flat_map(chosen).collect()
}

/// All numbers of a behaviour, with the step of a difference.
fn numbers(behaviour: &Behaviour) -> Vec<(BehaviourParameter, f64)> {
    use BehaviourParameter as P;
    let mut all = Vec::new();
    if behaviour.relaxation.is_some() {
        all.extend([(P::RelaxationShare(0), 1e-5), (P::RelaxationShare(1), 1e-5)]);
        all.extend([(P::RelaxationTime(0), 1e-5), (P::RelaxationTime(1), 1e-4)]);
    }
    if behaviour.viscosity_kpa_s > 0.0 {
        all.push((P::Viscosity, 1e-5));
    }
    if behaviour.softening.is_some() {
        all.extend([(P::SofteningR, 1e-5), (P::SofteningM, 1e-6)]);
    }
    if behaviour.softening.is_some_and(|s| s.form == SofteningForm::OgdenRoxburgh) {
        all.push((P::SofteningBeta, 1e-5));
    }
    if behaviour.set.is_some() {
        all.push((P::SetFraction, 1e-5));
    }
    if behaviour.drainage.is_some() {
        all.extend([(P::DrainageShare, 1e-5), (P::DrainageTime, 1e-5)]);
    }
    if behaviour.swelling.is_some() {
        all.extend([(P::SwellingStrain, 1e-6), (P::SwellingFrom, 1e-5), (P::SwellingTo, 1e-5)]);
    }
    all
}

fn with_number(behaviour: &Behaviour, parameter: BehaviourParameter, by: f64) -> Behaviour {
    use BehaviourParameter as P;
    let mut other = behaviour.clone();
    let Behaviour { relaxation, viscosity_kpa_s, softening, set, drainage, swelling } = &mut other;
    let number = match parameter {
        P::RelaxationShare(k) => &mut relaxation.as_mut().expect("relaxes").g[k],
        P::RelaxationTime(k) => &mut relaxation.as_mut().expect("relaxes").tau_s[k],
        P::Viscosity => viscosity_kpa_s,
        P::SofteningR => &mut softening.as_mut().expect("softens").r,
        P::SofteningM => &mut softening.as_mut().expect("softens").m_kpa,
        P::SofteningBeta => &mut softening.as_mut().expect("softens").beta,
        P::SetFraction => &mut set.as_mut().expect("sets").fraction,
        P::DrainageShare => &mut drainage.as_mut().expect("drains").share,
        P::DrainageTime => &mut drainage.as_mut().expect("drains").tau_s,
        P::SwellingStrain => &mut swelling.as_mut().expect("swells").linear_strain,
        P::SwellingFrom => &mut swelling.as_mut().expect("swells").from_time_s,
        P::SwellingTo => &mut swelling.as_mut().expect("swells").to_time_s,
        other => panic!("{other:?} is not tested"),
    };
    *number += by;
    other
}

#[test]
fn numbers_of_every_behaviour_agree_with_differences() {
    for (element, name, behaviour) in cases() {
        let story = Story::new(element, behaviour.clone());
        for (parameter, step) in numbers(&behaviour) {
            let found = story.derivative(FrameCause::Behaviour(parameter));
            let words = format!("{element:?} {name} {parameter:?}");
            assert_follows(&found, step, &words, |by| {
                let behaviour = with_number(&behaviour, parameter, by);
                Story { behaviour, ..story.clone() }
            });
        }
    }
}

#[test]
fn the_law_and_fields_of_moduli_agree_with_differences_under_every_behaviour() {
    for (element, name, behaviour) in cases() {
        let kind = |b| LawKind::Fung { b };
        let n = 18 * element.n_points();
        let mut random = Random::new(4);
        let rates: Vec<f64> = (0..n).map(|_| random.next()).collect();
        let make = |b: f64, young: f64, poisson: f64| {
            let field = |value: f64, by: f64| rates.iter().map(|r| value + by * r).collect();
            let n_points = element.n_points();
            let (young, poisson) = (field(9.0, young), field(0.4, poisson));
            let field = Stiffness::PerPoint { n_points, young, poisson };
            Material::new(field).and_then(|m| m.with_law(kind(b))).expect("sound")
        };
        let story = Story { material: make(1.5, 0.0, 0.0), ..Story::new(element, behaviour) };
        let causes = [
            FrameCause::Always(Cause::Parameter(Parameter::shape("b"))),
            FrameCause::Always(Cause::YoungField(rates.clone())),
            FrameCause::Always(Cause::PoissonField(rates.clone())),
        ];
        let found = story.run().0.derivatives(&causes, &tight()).expect("derivatives");
        let moves: [(f64, &dyn Fn(f64) -> Material); 3] = [
            (1e-5, &|by| make(1.5 + by, 0.0, 0.0)),
            (1e-5, &|by| make(1.5, by, 0.0)),
            (1e-6, &|by| make(1.5, 0.0, by)),
        ];
        for ((found, (step, moved)), k) in found.iter().zip(moves).zip(0..) {
            assert_follows(found, step, &format!("{element:?} {name} {k}"), |by| Story {
                material: moved(by),
                ..story.clone()
            });
        }
    }
}

#[test]
fn loads_motions_springs_and_skin_agree_with_differences() {
    for element in ALL {
        let (_, behaviour) = behaviours().pop().expect("all of them");
        let mut story = Story::new(element, behaviour);
        let top = on_top(&story.body());
        let skinned = |young: f64, thickness: f64| {
            let skin = Skin { triangles: top.clone(), thickness, young, poisson: 0.3 };
            Material::neo_hookean(9.0, 0.4).and_then(|m| m.with_skin(skin)).expect("sound")
        };
        story.material = skinned(30.0, 0.4);
        story.springs = [0.05, 0.03];
        let mut random = Random::new(8);
        let body = story.body();
        let rates: Vec<Load> = (0..TIMES.len())
            .map(|_| Load {
                nodal_forces: Some((0..body.n_nodes()).map(|_| random.vector(0.5)).collect()),
                body_force: random.vector(0.002),
                prescribed: Some(body.held_nodes().iter().map(|_| random.vector(0.3)).collect()),
                springs: vec![],
            })
            .collect();
        let motion: Vec<[f64; 3]> = TIMES.iter().map(|_| random.vector(1.0)).collect();
        let plus = |a: [f64; 3], by: f64, b: [f64; 3]| std::array::from_fn(|i| a[i] + by * b[i]);
        let along = |by: f64| {
            let each = |(load, rate): (&Load, &Load)| {
                let scaled = |rows: &Vec<[f64; 3]>| -> Vec<[f64; 3]> {
                    rows.iter().map(|row| row.map(|v| by * v)).collect()
                };
                Load {
                    nodal_forces: rate.nodal_forces.as_ref().map(scaled),
                    body_force: plus(load.body_force, by, rate.body_force),
                    prescribed: rate.prescribed.as_ref().map(scaled),
                    springs: vec![],
                }
            };
            Story { loads: story.loads.iter().zip(&rates).map(each).collect(), ..story.clone() }
        };
        let moved = |by: f64| {
            let each = |(motion, rate): (&Option<[f64; 3]>, &[f64; 3])| {
                motion.map(|motion| plus(motion, by, *rate))
            };
            Story {
                motions: story.motions.iter().zip(&motion).map(each).collect(),
                ..story.clone()
            }
        };
        let [normal, tangential] = story.springs;
        let always = FrameCause::Always;
        let cases: [(FrameCause, f64, Mover); 6] = [
            (FrameCause::Loads(rates.clone()), 1e-5, &along),
            (FrameCause::Motion { pad: 0, rates: motion.clone() }, 1e-5, &moved),
            (always(Cause::SpringNormal(0)), 1e-6, &|by| Story {
                springs: [normal + by, tangential],
                ..story.clone()
            }),
            (always(Cause::SpringTangential(0)), 1e-6, &|by| Story {
                springs: [normal, tangential + by],
                ..story.clone()
            }),
            (always(Cause::SkinYoung(0)), 1e-4, &|by| Story {
                material: skinned(30.0 + by, 0.4),
                ..story.clone()
            }),
            (always(Cause::SkinThickness(0)), 1e-6, &|by| Story {
                material: skinned(30.0, 0.4 + by),
                ..story.clone()
            }),
        ];
        for (k, (cause, step, moved)) in cases.into_iter().enumerate() {
            let found = story.derivative(cause);
            assert_follows(&found, step, &format!("{element:?} case {k}"), moved);
        }
    }
}

/// What a body that does not flow would do if it began to: the viscosity may be 0.
#[test]
fn a_body_without_viscosity_has_the_derivative_of_its_beginning() {
    let story = Story::new(Element::Tet4, Behaviour::default());
    let found = story.derivative(FrameCause::Behaviour(BehaviourParameter::Viscosity));
    let moved = |eta: f64| {
        let behaviour = Behaviour { viscosity_kpa_s: eta, ..Behaviour::default() };
        Story { behaviour, ..story.clone() }.run().1
    };
    // One-sided, of second order.
    let (at, near, far) = (moved(0.0), moved(1e-4), moved(2e-4));
    for frame in 0..TIMES.len() {
        let rows = |run: &[FrameDerivative]| run[frame].displacement.clone();
        let (a, b, c) = (rows(&at), rows(&near), rows(&far));
        let slope = |n: usize, i: usize| (4.0 * b[n][i] - 3.0 * a[n][i] - c[n][i]) / 2e-4;
        let wanted: Vec<[f64; 3]> =
            (0..a.len()).map(|n| std::array::from_fn(|i| slope(n, i))).collect();
        let off = common::largest_difference(&found[frame].displacement, &wanted);
        assert!(off < 1e-5 * (0.1 + common::largest(&wanted)), "{frame}: {off}");
    }
    assert!(common::largest(&found[2].displacement) > 0.05);
}

#[test]
fn what_a_rig_does_not_have_is_named() {
    let story = Story::new(Element::Tet4, Behaviour::default());
    let (rig, _) = story.run();
    let rows = |n: usize| vec![[0.0; 3]; n];
    let sprung = Springs { triangles: vec![], normal: 1.0, tangential: 0.0, friction: None };
    let sprung = Load { springs: vec![sprung], ..Load::default() };
    for (cause, words) in [
        (FrameCause::Always(Cause::Parameter(Parameter::FibreK1)), "FibreK1"),
        (FrameCause::Always(Cause::SpringNormal(0)), "springs 0 of 0"),
        (FrameCause::Behaviour(BehaviourParameter::SetFraction), "SetFraction of this behaviour"),
        (FrameCause::Motion { pad: 3, rates: rows(6) }, "the motion of pad 3 of 1"),
        (FrameCause::Motion { pad: 0, rates: rows(2) }, "must have 6 rows; found 2"),
        (FrameCause::Loads(vec![Load::default()]), "must have 6 rows; found 1"),
        (FrameCause::Always(Cause::Load(sprung)), "name them one by one"),
        (FrameCause::Always(Cause::YoungField(vec![1.0])), "must have 18 rows; found 1"),
    ] {
        let error = rig.derivatives(&[cause], &tight()).expect_err("none").to_string();
        assert!(error.contains(words), "`{error}` must contain `{words}`");
    }
    let seen = |frame, pads: &[usize], held: &[usize]| FrameObservation {
        frame,
        observation: Observation::of_reactions(held.iter().map(|&node| (node, [1.0; 3]))),
        pads: pads.iter().map(|&pad| (pad, [1.0; 3])).collect(),
    };
    let pad_node = nodes_where(rig.body().mesh(), |x| x[0] > 18.0 - 1e-9)[0];
    for (observation, words) in [
        (seen(6, &[], &[]), "`frame` must be the number of a recorded frame; found 6".to_owned()),
        (seen(1, &[1], &[]), "`pad` must be the number of a pad; found 1".to_owned()),
        (seen(0, &[0], &[]), format!("the reaction of node {pad_node}, which is not held")),
        (seen(0, &[], &[5000]), "the reaction of node 5000, which is not held".to_owned()),
    ] {
        let error = rig.adjoints(&[observation], &tight()).expect_err("none").to_string();
        assert!(error.contains(&words), "`{error}` must contain `{words}`");
    }
    let body = story.body();
    let history = History::new(&body, story.material, Behaviour::default()).expect("sound");
    let rig = Rig::new(body, history, vec![]).expect("sound");
    assert_eq!(rig.derivatives(&[], &tight()), Err(FemError::NothingRecorded));
    assert_eq!(rig.adjoints(&[], &tight()), Err(FemError::NothingRecorded));
}

/// The derivatives do not depend on the number of threads.
#[test]
fn threads_change_no_bit() {
    let (_, behaviour) = behaviours().pop().expect("all of them");
    let (rig, _) = Story::new(Element::Tet10, behaviour).run();
    let causes = [
        FrameCause::Always(Cause::Parameter(Parameter::Young)),
        FrameCause::Behaviour(BehaviourParameter::Viscosity),
    ];
    let run = |n_threads| rig.derivatives(&causes, &tight().with_n_threads(n_threads));
    assert_eq!(run(1), run(2));
    let seen = FrameObservation {
        frame: 5,
        observation: Observation::of_displacement([(9, [1.0; 3])]),
        pads: vec![],
    };
    let seen = std::slice::from_ref(&seen);
    let back = |n_threads| rig.adjoints(seen, &tight().with_n_threads(n_threads));
    assert_eq!(back(1), back(2));
}

/// A frame that is reached in parts: the parts take their shares of loads and of motions.
#[test]
fn frames_that_are_reached_in_parts_agree_with_differences() {
    let mesh = bar([6, 2, 2], [60.0, 10.0, 10.0]);
    let end = nodes_where(&mesh, |x| x[0] > 59.0);
    let held = || common::clamped_at_x0(mesh.clone(), Element::Tet4);
    let body = held();
    let relaxation = Relaxation { g: vec![0.4], tau_s: vec![0.7], ..Relaxation::default() };
    let behaviour =
        Behaviour { relaxation: Some(relaxation), viscosity_kpa_s: 0.1, ..Behaviour::default() };
    let run = |force: f64, lift: f64| {
        let material = Material::neo_hookean(9.0, 0.4).expect("sound");
        let history = History::recorded(&body, material, behaviour.clone()).expect("sound");
        let pads = vec![Pad { nodes: end.clone() }];
        let mut rig = Rig::new(held(), history, pads).expect("sound");
        let few = tight().with_max_iterations(8);
        let weight = |share: f64| Load { body_force: [0.0, share * force, 0.0], ..Load::default() };
        rig.advance(&weight(0.2), &[None], 0.0, &tight()).expect("stands");
        let motion = Some([-0.4 * lift, 0.0, lift]);
        let answer = rig.advance(&weight(1.0), &[motion], 1.0, &few).expect("in parts");
        (rig, answer)
    };
    let (rig, answer) = run(0.01, 40.0);
    assert!(answer.solution.report.load_steps > 1, "{:?}", answer.solution.report);
    let weight = |share: f64| Load { body_force: [0.0, share, 0.0], ..Load::default() };
    let causes = [
        FrameCause::Loads(vec![weight(0.2), weight(1.0)]),
        FrameCause::Motion { pad: 0, rates: vec![[0.0; 3], [-0.4, 0.0, 1.0]] },
    ];
    let found = rig.derivatives(&causes, &tight()).expect("derivatives");
    // The adjoint goes back through the parts as well.
    let seen = FrameObservation {
        frame: 1,
        observation: Observation::of_displacement([(20, [0.3, -1.0, 0.5])]),
        pads: vec![(0, [0.01, 0.0, -0.02])],
    };
    let young = FrameCause::Always(Cause::Parameter(Parameter::Young));
    let by_young = &rig.derivatives(&[young], &tight()).expect("a derivative")[0][1];
    let (moved, force) = (by_young.displacement[20], by_young.pads[0].expect("there"));
    let wanted = 0.3 * moved[0] - moved[1] + 0.5 * moved[2] + 0.01 * force[0] - 0.02 * force[2];
    let adjoint = rig.adjoints(&[seen], &tight()).expect("an adjoint").remove(0);
    let total: f64 = adjoint.young.iter().sum();
    assert!((total - wanted).abs() < 1e-9 * wanted.abs(), "{total} {wanted}");

    let moves: [(f64, [f64; 2]); 2] = [(1e-5, [1.0, 0.0]), (1e-3, [0.0, 1.0])];
    for (found, (step, [by_force, by_lift])) in found.iter().zip(moves) {
        let at = |k: f64| run(0.01 + k * step * by_force, 40.0 + k * step * by_lift).1;
        let (plus, minus) = (at(1.0), at(-1.0));
        assert_eq!(plus.solution.report.load_steps, answer.solution.report.load_steps);
        let (plus, minus) = (plus.solution.displacement, minus.solution.displacement);
        let wanted: Vec<[f64; 3]> = (0..plus.len())
            .map(|n| std::array::from_fn(|i| (plus[n][i] - minus[n][i]) / (2.0 * step)))
            .collect();
        let off = common::largest_difference(&found[1].displacement, &wanted);
        assert!(off < 1e-5 * common::largest(&wanted), "{off}");
    }
}

/// Random observations of frames against random fields of stiffness.
#[test]
fn adjoints_are_the_transpose_of_the_derivatives() {
    for (element, name, behaviour) in cases() {
        let mut story = Story::new(element, behaviour);
        story.springs = [0.05, 0.03];
        story.material = story.material.with_law(LawKind::Fung { b: 1.5 }).expect("sound");
        let (rig, _) = story.run();
        let mut random = Random::new(21);
        let n = rig.body().n_tets() * element.n_points();
        let young: Vec<f64> = (0..n).map(|_| random.next()).collect();
        let poisson: Vec<f64> = (0..n).map(|_| random.next()).collect();
        let causes = [
            FrameCause::Always(Cause::YoungField(young.clone())),
            FrameCause::Always(Cause::PoissonField(poisson.clone())),
        ];
        let derivatives = rig.derivatives(&causes, &tight()).expect("derivatives");
        let held = rig.body().held_nodes().to_vec();
        let observations: Vec<FrameObservation> = (0..TIMES.len())
            .map(|frame| {
                let node = random.below(rig.body().n_nodes());
                let place = random.below(held.len());
                FrameObservation {
                    frame,
                    observation: Observation {
                        displacement: vec![(node, random.vector(1.0)), (7, random.vector(1.0))],
                        reactions: vec![(held[place], random.vector(1.0))],
                    },
                    pads: match story.motions[frame] {
                        Some(_) => vec![(0, random.vector(0.1))],
                        None => vec![],
                    },
                }
            })
            .collect();
        let adjoints = rig.adjoints(&observations, &tight()).expect("adjoints");
        let inner = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        for (seen, adjoint) in observations.iter().zip(&adjoints) {
            let found = [dot(&adjoint.young, &young), dot(&adjoint.poisson, &poisson)];
            for (derivative, found) in derivatives.iter().zip(found) {
                let frame = &derivative[seen.frame];
                let mut wanted = 0.0;
                for (node, weights) in &seen.observation.displacement {
                    wanted += inner(weights, &frame.displacement[*node]);
                }
                for (node, weights) in &seen.observation.reactions {
                    let place = held.iter().position(|n| n == node).expect("held");
                    wanted += inner(weights, &frame.reactions[place]);
                }
                for (pad, weights) in &seen.pads {
                    wanted += inner(weights, &frame.pads[*pad].expect("there"));
                }
                let size =
                    common::largest(&frame.displacement).max(common::largest(&frame.reactions));
                let words = format!("{element:?} {name}, frame {}", seen.frame);
                assert!(wanted != 0.0, "{words}");
                assert!((found - wanted).abs() < 1e-9 * size, "{words}: {found} {wanted}");
            }
        }
    }
}
