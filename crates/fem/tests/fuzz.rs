//! Does anything go in? Random bodies, loads and laws, sound, extreme and broken: an answer that is
//! one, or the right error; no panic, no NaN, and no more work than was allowed.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::cases::LAWS;
use common::{Random, bar_arrays};
use proptest::prelude::*;
use proptest::test_runner::FileFailurePersistence;
use tissuereg_fem::{
    Body, Element, FemError, Load, LoadSteps, Mesh, Method, Solution, SolveSettings, Stiffness,
    Supports, solve,
};

/// Cases of the quick tier; `make test-sturdy` asks for more by `TISSUEREG_CASES`.
const CASES: u64 = 400;

const MAX_ITERATIONS: usize = 60;

/// What is wrong with the input, if anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Damage {
    None,
    NodeNotFinite,
    TetOutOfRange,
    NodeRepeated,
    TetFlat,
    TetInverted,
    NodeUnused,
    TetDoubled,
    HeldOutOfRange,
    HeldRepeated,
    TooFewHeld,
    LoosePart,
    YoungOutOfRange,
    PoissonOutOfRange,
    StiffnessTooShort,
    StiffnessEmpty,
    ForcesTooShort,
    ForceNotFinite,
    BodyForceNotFinite,
    PrescribedTooShort,
    PrescribedNotFinite,
    Tolerance,
    Iterations,
    Steps,
}

const DAMAGES: [Damage; 24] = {
    use Damage as D;
    [
        D::None,
        D::NodeNotFinite,
        D::TetOutOfRange,
        D::NodeRepeated,
        D::TetFlat,
        D::TetInverted,
        D::NodeUnused,
        D::TetDoubled,
        D::HeldOutOfRange,
        D::HeldRepeated,
        D::TooFewHeld,
        D::LoosePart,
        D::YoungOutOfRange,
        D::PoissonOutOfRange,
        D::StiffnessTooShort,
        D::StiffnessEmpty,
        D::ForcesTooShort,
        D::ForceNotFinite,
        D::BodyForceNotFinite,
        D::PrescribedTooShort,
        D::PrescribedNotFinite,
        D::Tolerance,
        D::Iterations,
        D::Steps,
    ]
};

/// All that a solve needs, before any of it is checked.
#[derive(Debug)]
struct Input {
    nodes: Vec<[f64; 3]>,
    tets: Vec<[usize; 4]>,
    element: Element,
    held: Vec<usize>,
    law: usize,
    stiffness: Stiffness,
    load: Load,
    settings: SolveSettings,
}

/// Sound input, with numbers over `decades` powers of ten about the usual.
fn input(seed: u64, decades: f64) -> Input {
    let mut random = Random::new(seed + 1);
    random.skip(8);
    let power = |random: &mut Random| 10f64.powf(decades * random.next());
    let cells = std::array::from_fn(|_| 1 + random.below(3));
    let unit = 20.0 * power(&mut random);
    let size: [f64; 3] = std::array::from_fn(|_| unit * random.within(0.4, 2.0));
    let (mut nodes, tets) = bar_arrays(cells, size);
    for x in &mut nodes {
        for i in 0..3 {
            x[i] += 0.12 * size[i] / cells[i] as f64 * random.next();
        }
    }
    let element = [Element::Tet4, Element::Tet10][random.below(2)];
    let first_layer = (cells[1] + 1) * (cells[2] + 1);
    let mut held: Vec<usize> = (0..first_layer).collect();
    if random.below(3) == 0 {
        held.extend(nodes.len() - first_layer..nodes.len());
    }
    let young = 10.0 * power(&mut random);
    let poisson = [random.within(-0.9, 0.45), random.within(0.45, 0.4999)][random.below(2)];
    let stiffness = if random.below(2) == 0 {
        Stiffness::Uniform { young, poisson }
    } else {
        let young = tets.iter().map(|_| young * 10f64.powf(random.next())).collect();
        Stiffness::PerTet { young, poisson: vec![poisson] }
    };
    let force = young * unit * unit * random.within(0.0, 0.3) * power(&mut random);
    let moved = 0.3 * unit * power(&mut random);
    let n_rows = nodes.len();
    let load = Load {
        nodal_forces: Some((0..n_rows).map(|_| random.vector(force)).collect()),
        body_force: random.vector(0.1 * young / unit),
        prescribed: Some(held.iter().map(|_| random.vector(moved)).collect())
            .filter(|_| random.below(3) == 0),
        ..Load::default()
    };
    let settings = SolveSettings::default()
        .with_n_threads(1)
        .with_max_iterations(MAX_ITERATIONS)
        .with_method(
            [Method::Auto, Method::Auto, Method::Newton, Method::QuasiNewton][random.below(4)],
        )
        .with_load_steps([LoadSteps::Auto, LoadSteps::Auto, LoadSteps::Equal(3)][random.below(3)]);
    let law = random.below(LAWS.len());
    Input { nodes, tets, element, held, law, stiffness, load, settings }
}

impl Input {
    /// Break one thing, in a place and a way that `seed` chooses.
    fn damage(&mut self, damage: Damage, seed: u64) {
        let mut random = Random::new(seed + 77);
        random.skip(8);
        let not_finite = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][random.below(3)];
        let (n, t) = (random.below(self.nodes.len()), random.below(self.tets.len()));
        let (axis, corner) = (random.below(3), random.below(4));
        let out = self.nodes.len() + random.below(3) * random.below(1000);
        let mut forces = vec![[0.0; 3]; self.nodes.len()];
        match damage {
            Damage::None => {}
            Damage::NodeNotFinite => self.nodes[n][axis] = not_finite,
            Damage::TetOutOfRange => self.tets[t][corner] = out,
            Damage::NodeRepeated => self.tets[t][corner] = self.tets[t][(corner + 1) % 4],
            Damage::TetFlat => {
                let tet = self.tets[t];
                self.nodes[tet[corner]] = self.nodes[tet[(corner + 1) % 4]];
            }
            Damage::TetInverted => self.tets[t].swap(corner, (corner + 1) % 4),
            Damage::NodeUnused => self.nodes.push([1.0; 3]),
            Damage::TetDoubled => self.tets.extend([self.tets[t]; 2]),
            Damage::HeldOutOfRange => self.held.push(out),
            Damage::HeldRepeated => self.held.push(self.held[0]),
            Damage::TooFewHeld => self.held.truncate(random.below(3)),
            Damage::LoosePart => {
                let first = self.nodes.len();
                let (nodes, tets) = bar_arrays([1, 1, 1], [3.0; 3]);
                self.nodes.extend(nodes);
                self.tets.extend(tets.iter().map(|tet| tet.map(|k| k + first)));
            }
            Damage::YoungOutOfRange => {
                let young = [0.0, -1.0, f64::NAN, f64::INFINITY][random.below(4)];
                self.stiffness = match random.below(2) {
                    0 => Stiffness::Uniform { young, poisson: 0.3 },
                    _ => {
                        let mut field = vec![1.0; self.tets.len()];
                        field[t] = young;
                        Stiffness::PerTet { young: field, poisson: vec![0.3] }
                    }
                };
            }
            Damage::PoissonOutOfRange => {
                let poisson = [0.5, -1.0, 7.0, f64::NAN, f64::INFINITY][random.below(5)];
                self.stiffness = Stiffness::Uniform { young: 1.0, poisson };
            }
            Damage::StiffnessTooShort => {
                let young = vec![1.0; self.tets.len() - 1];
                self.stiffness = Stiffness::PerTet { young, poisson: vec![0.3] };
            }
            Damage::StiffnessEmpty => {
                self.stiffness = Stiffness::PerTet { young: vec![], poisson: vec![0.3] };
            }
            Damage::ForcesTooShort => {
                forces.pop();
                self.load.nodal_forces = Some(forces);
            }
            Damage::ForceNotFinite => {
                forces[n][axis] = not_finite;
                self.load.nodal_forces = Some(forces);
            }
            Damage::BodyForceNotFinite => self.load.body_force[axis] = not_finite,
            Damage::PrescribedTooShort => {
                self.load.prescribed = Some(vec![[0.0; 3]; self.held.len() - 1]);
            }
            Damage::PrescribedNotFinite => {
                let mut rows = vec![[0.0; 3]; self.held.len()];
                rows[n % self.held.len()][axis] = not_finite;
                self.load.prescribed = Some(rows);
            }
            Damage::Tolerance => {
                self.settings.tolerance = [0.0, -1.0, 1.0, f64::NAN][random.below(4)];
            }
            Damage::Iterations => self.settings.max_iterations = 0,
            Damage::Steps => self.settings.load_steps = LoadSteps::Equal(0),
        }
    }

    fn solve(&self) -> Result<Solution, FemError> {
        let mesh = Mesh::new(self.nodes.clone(), self.tets.clone())?;
        let body = Body::new(mesh, self.element, Supports::from(self.held.clone()))?;
        let material = LAWS[self.law].1(self.stiffness.clone())?;
        solve(&body, &material, &self.load, &self.settings)
    }
}

/// Whether an error is the one that a damage deserves.
fn is_right(damage: Damage, error: &FemError) -> bool {
    use {Damage as D, FemError as E};
    match damage {
        // Sound input may still be too much for the iterations allowed.
        D::None => error.is_recoverable(),
        D::NodeNotFinite => matches!(error, E::NonFiniteNode { .. }),
        D::TetOutOfRange => matches!(error, E::NodeOutOfRange { .. }),
        D::NodeRepeated => matches!(error, E::RepeatedNode { .. }),
        D::TetFlat => matches!(error, E::DegenerateTet { .. }),
        D::TetInverted => matches!(error, E::InvertedTet { n_inverted: 1, .. }),
        D::NodeUnused => matches!(error, E::UnusedNode { n_unused: 1, .. }),
        D::TetDoubled => matches!(error, E::OverlappingTets { .. }),
        D::HeldOutOfRange => matches!(error, E::HeldNodeOutOfRange { .. }),
        D::HeldRepeated => matches!(error, E::HeldNodeRepeated { .. }),
        D::TooFewHeld => matches!(error, E::Unconstrained(modes) if !modes.modes.is_empty()),
        D::LoosePart => matches!(error, E::Unconstrained(modes) if modes.modes.len() == 6),
        D::YoungOutOfRange => matches!(error, E::BadYoung { .. }),
        D::PoissonOutOfRange => matches!(error, E::BadPoisson { .. }),
        D::StiffnessTooShort | D::StiffnessEmpty | D::ForcesTooShort | D::PrescribedTooShort => {
            matches!(error, E::WrongLength { .. })
        }
        D::ForceNotFinite | D::BodyForceNotFinite | D::PrescribedNotFinite => {
            matches!(error, E::NonFinite { .. })
        }
        D::Tolerance => matches!(error, E::BadSetting { name: "tolerance", .. }),
        D::Iterations => matches!(error, E::BadSetting { name: "max_iterations", .. }),
        D::Steps => matches!(error, E::BadSetting { name: "load_steps", .. }),
    }
}

fn finite(rows: &[[f64; 3]]) -> bool {
    rows.iter().flatten().all(|v| v.is_finite())
}

/// Numbers are numbers, the residual is below the tolerance, and work is bounded.
fn check(outcome: &Result<Solution, FemError>) -> Result<(), TestCaseError> {
    match outcome {
        Ok(answer) => {
            let report = &answer.report;
            prop_assert!(finite(&answer.displacement) && finite(&answer.reactions));
            prop_assert!(report.residual <= report.tolerance && report.min_det_f > 0.0);
            prop_assert!(report.strain_energy.is_finite());
            prop_assert!(report.iterations <= MAX_ITERATIONS);
            prop_assert!(report.evaluations <= 40 * (MAX_ITERATIONS + 40), "{:?}", report);
        }
        Err(FemError::NoEquilibrium(end)) => {
            prop_assert!(finite(&end.displacement));
            prop_assert!((0.0..1.0).contains(&end.load_fraction), "{}", end);
            prop_assert!(end.iterations <= MAX_ITERATIONS, "{}", end);
            prop_assert!(end.factorisations <= 6 * MAX_ITERATIONS, "{}", end);
        }
        Err(error) => prop_assert!(!error.to_string().is_empty()),
    }
    Ok(())
}

fn config() -> ProptestConfig {
    ProptestConfig {
        cases: u32::try_from(common::count_or(CASES)).expect("fewer cases"),
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(
            "proptest-regressions/fuzz.txt",
        ))),
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn broken_input_gets_the_error_it_deserves(seed in 0u64..1 << 40, damage in 0..DAMAGES.len()) {
        let damage = DAMAGES[damage];
        let mut input = input(seed, 0.0);
        input.damage(damage, seed);
        let outcome = input.solve();
        match &outcome {
            Ok(_) => prop_assert_eq!(damage, Damage::None),
            Err(error) => prop_assert!(is_right(damage, error), "{:?}: {}", damage, error),
        }
        check(&outcome)?;
    }

    #[test]
    fn any_size_of_anything_has_an_outcome(seed in 0u64..1 << 40, decades in 0.0..60.0) {
        check(&input(seed, decades).solve())?;
    }
}
